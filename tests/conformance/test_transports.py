"""The conformance suite for transports, over the in-process bus, the network of the fault simulator and Zenoh; and
transports with one fault, which it must find.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from tests.net import connect_team, free_endpoint, settle_team

from covey.faults import draw
from covey.faults.scenario import Mode
from covey.faults.simulator import Simulation
from covey.protocol import Busy, Heartbeat, Message, Node, Output, Publish, RecordSlice, Request, Send
from covey.testing.transports import Connect, check_real_transport, check_transport
from covey.transports import Loopback, LoopbackEndpoint, Transport, network
from covey.transports.codec import Codec
from covey.transports.zenoh import ZenohTransport


class Network:
    """Opens a bus whose endpoints may be faulty."""

    def __init__(self, seed: int = 0, endpoint: type[LoopbackEndpoint] = LoopbackEndpoint) -> None:
        self.seed, self.endpoint = seed, endpoint

    def __call__(self, agents: Sequence[int]) -> tuple[Sequence[Transport], Callable[[], None]]:
        bus = Loopback(rng=np.random.default_rng(self.seed))
        endpoints = [bus.endpoint(agent) for agent in agents]
        for endpoint in endpoints:
            endpoint.__class__ = self.endpoint

        def settle() -> None:
            while bus.step() is not None:
                pass

        return endpoints, settle


@pytest.mark.parametrize("seed", range(5))
def test_the_loopback_conforms(seed: int) -> None:
    check_transport(Network(seed))


class Mailbox(Node):
    """In the place of a node: it keeps what the simulated network brings it."""

    mail: list[Message]

    def receive(self, now: float, message: Message, rng: np.random.Generator) -> list[Output]:
        self.mail.append(message)
        return []

    def next_deadline(self) -> float | None:
        return None


class SimulatedEndpoint:
    """One agent's access to the network of a fault simulator."""

    def __init__(self, simulation: Simulation, agent: int) -> None:
        self.agent = agent
        self._simulation = simulation
        self._mailbox = mailbox = simulation.nodes[agent]
        assert isinstance(mailbox, Mailbox)
        self._mail = mailbox.mail = []

    @property
    def _closed(self) -> bool:
        return self.agent not in self._simulation.nodes

    def send(self, to: int, message: Message) -> None:
        if not self._closed:
            self._simulation._act(self.agent, [Send(to, message)])

    def publish(self, heartbeat: Heartbeat) -> None:
        if not self._closed:
            self._simulation._act(self.agent, [Publish(heartbeat)])

    def receive(self) -> list[Message]:
        mail = list(self._mail)
        self._mail.clear()
        return mail

    def close(self) -> None:
        self._simulation.nodes.pop(self.agent, None)
        self._mail.clear()


def simulated_network(seed: int, *, loss: float = 0.0, duplicates: float = 0.0) -> Connect:
    """Return the network of a fault simulator in which nothing happens but these faults."""

    def connect(agents: Sequence[int]) -> tuple[Sequence[Transport], Callable[[], None]]:
        calm = replace(
            draw(seed), mode=Mode.SAFETY, agents=max(agents) + 1, faults=(), changes=(), proofs=0.0, calm_after=math.inf
        )
        simulation = Simulation(replace(calm, loss=loss, duplicates=duplicates), Mailbox, traced=False)
        for node in simulation.nodes.values():
            assert isinstance(node, Mailbox)
            node.mail = []

        def settle() -> None:
            while simulation._queue:
                simulation._step()

        return [SimulatedEndpoint(simulation, agent) for agent in agents], settle

    return connect


@pytest.mark.parametrize("seed", range(5))
def test_the_fault_simulator_without_faults_conforms(seed: int) -> None:
    check_transport(simulated_network(seed))


def test_the_fault_simulators_faults_are_found() -> None:
    with pytest.raises(AssertionError):
        check_transport(simulated_network(0, loss=0.3))
    with pytest.raises(AssertionError):
        check_transport(simulated_network(0, duplicates=0.3))


class ZenohNetwork:
    """Opens a transport for each agent, all in this process; through a router or directly."""

    CODEC = Codec(bytes(16), agents=100, landmarks=2**40)

    def __init__(self, *, routed: bool) -> None:
        self.routed = routed
        self.open: list[ZenohTransport] = []
        self.router: network.Router | None = None

    def __call__(self, agents: Sequence[int]) -> tuple[Sequence[ZenohTransport], Callable[[], None]]:
        self.close()
        meeting_point = free_endpoint()
        if self.routed:
            self.router = network.Router(
                network.NetworkOptions(mode=network.Mode.ROUTER, listen=(meeting_point,)), self.CODEC.digest
            )
        mode = network.Mode.CLIENT if self.routed else network.Mode.PEER
        self.open = connect_team(agents, self.CODEC, meeting_point, mode)
        return self.open, lambda: settle_team(self.open)

    def close(self) -> None:
        """Close what the last check opened."""
        for transport in self.open:
            transport.close()
        if self.router is not None:
            self.router.close()


@pytest.fixture(params=[False, True], ids=["peers", "router"])
def zenoh_network(request: pytest.FixtureRequest) -> Iterator[ZenohNetwork]:
    network = ZenohNetwork(routed=request.param)
    yield network
    network.close()


def test_zenoh_conforms(zenoh_network: ZenohNetwork) -> None:
    check_real_transport(zenoh_network)


def test_an_endpoint_is_a_transport() -> None:
    assert isinstance(Loopback(rng=np.random.default_rng(0)).endpoint(0), Transport)


class Loses(LoopbackEndpoint):
    def send(self, to: int, message: Message) -> None:
        if not (isinstance(message, Busy) and message.trade.number == 50):
            super().send(to, message)


class Doubles(LoopbackEndpoint):
    def send(self, to: int, message: Message) -> None:
        super().send(to, message)
        super().send(to, message)


class Broadcasts(LoopbackEndpoint):
    def send(self, to: int, message: Message) -> None:
        for agent in range(10):
            super().send(agent, message)


class Narrows(LoopbackEndpoint):
    def send(self, to: int, message: Message) -> None:
        if isinstance(message, Request):
            narrow = RecordSlice(message.records.indices.astype(np.int32).astype(np.int64), message.records.values)
            message = Request(message.sender, message.trade, message.pose, narrow, message.avoid)
        super().send(to, message)


class KeepsTheOldest(LoopbackEndpoint):
    def publish(self, heartbeat: Heartbeat) -> None:
        if heartbeat.sequence == 1:
            super().publish(heartbeat)


class TalksAfterClosing(LoopbackEndpoint):
    def close(self) -> None:
        super().close()
        self.closed = False


class HandsOutTwice(LoopbackEndpoint):
    def receive(self) -> list[Message]:
        return list(self.inbox)


@pytest.mark.parametrize(
    "endpoint", [Loses, Doubles, Broadcasts, Narrows, KeepsTheOldest, TalksAfterClosing, HandsOutTwice]
)
def test_a_faulty_transport_is_found(endpoint: type[LoopbackEndpoint]) -> None:
    with pytest.raises(AssertionError):
        check_transport(Network(endpoint=endpoint))
