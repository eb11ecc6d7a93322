"""Agents that plan over Zenoh, in real time: the outcome is that of a team on the bus, whatever the order of trades."""

from __future__ import annotations

import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from tests.net import connect_team, free_endpoint, wait_until
from tests.unit.runtime.small import small

from covey.errors import ArgumentError, Drop
from covey.mission import Mission
from covey.protocol import AgentBuried, AgentState, Event, MembershipOptions, Node, Sender, TradeCommitted
from covey.runtime.agent import TeamPlanner, build_models
from covey.runtime.network.agent_state import AgentDirectory
from covey.runtime.network.prover import Prover
from covey.runtime.network.remote_agent import REPORT_EVERY, RemoteAgent, build_node, join_mission, mission_codec
from covey.runtime.network.remote_vehicle import build_vehicle
from covey.runtime.streams import Stream, generator
from covey.runtime.team import initial_owners
from covey.transports import RealTransport
from covey.transports.network import NetworkOptions
from covey.transports.telemetry import Telemetry
from covey.transports.zenoh import ZenohTransport

AGENTS = 2


@pytest.fixture
def mission() -> Mission:
    return small(agents={"count": AGENTS})


def planner_of(mission: Mission) -> TeamPlanner:
    return TeamPlanner(
        mission,
        build_models(mission),
        trade=mission.coverage.trade,
        optimizer=mission.coverage.optimizer,
        seed=mission.seed,
    )


def score(planner: TeamPlanner, nodes: list[Node]) -> float:
    return sum(
        float(planner.visibility(node.agent, node.pose)[node.landmarks] @ planner.weights[node.landmarks])
        for node in nodes
    )


def test_two_agents_plan_a_mission(mission: Mission) -> None:
    events: list[Event] = []
    with ExitStack() as stack:
        meeting_point = free_endpoint()
        transports = connect_team(range(AGENTS), mission_codec(mission), meeting_point)
        for transport in transports:
            stack.callback(transport.close)
        agents = [join_mission(mission, transport, on_event=events.append) for transport in transports]
        for agent in agents:
            agent.start()
        while not all(agent.over for agent in agents):
            for agent in agents:
                agent.step(0.01)
    nodes = [agent.node for agent in agents]
    assert all(node.quiescent and node.escrow is None for node in nodes)
    owned = np.concatenate([node.landmarks for node in nodes])
    assert np.sort(owned).tolist() == list(range(len(mission.landmarks)))
    assert len([event for event in events if isinstance(event, TradeCommitted)]) >= 1
    assert all(set(transport.dropped) <= {Drop.OUTDATED} for transport in transports)

    planner = planner_of(mission)
    states = [AgentState(node.agent, node.pose, node.landmarks) for node in nodes]
    assert planner.propose(*states) is None
    assert all(planner.improve(state.agent, state.pose, state.landmarks) is None for state in states)
    owner = initial_owners(mission, mission.seed)
    first = sum(
        float(planner.visibility(agent, mission.agents[agent].pose)[owner == agent] @ planner.weights[owner == agent])
        for agent in range(AGENTS)
    )
    assert score(planner, nodes) > first


def test_an_agent_alone_ends_when_the_others_stay_away(mission: Mission) -> None:
    codec = mission_codec(mission)
    times = MembershipOptions(heartbeat_every=0.05, dead_after=0.2, map_every=0.1)
    with closing(ZenohTransport(Sender(0, 1), codec, NetworkOptions())) as transport:
        agent = join_mission(mission, transport, times=times)
        assert not agent.assemble(1, 0.1)
        assert agent.run(timeout=60.0, linger=0.0)
    assert len(agent.node.landmarks) == len(mission.landmarks)
    planner = planner_of(mission)
    assert planner.improve(0, agent.node.pose, agent.node.landmarks) is None


class Clock:
    """A clock that jumps when told to."""

    def __init__(self) -> None:
        self.ahead = 0.0

    def __call__(self) -> float:
        return time.monotonic() + self.ahead


class Sleepy:
    """A transport during whose next wait the process is stopped for a while."""

    def __init__(self, transport: ZenohTransport, clock: Clock) -> None:
        self._transport = transport
        self._clock = clock
        self.stop_for = 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def wait(self, timeout: float) -> bool:
        self._clock.ahead += self.stop_for
        self.stop_for = 0.0
        return self._transport.wait(min(timeout, 0.01))


def test_who_was_stopped_does_not_take_the_others_for_dead(mission: Mission) -> None:
    """Half an hour passes while its process is stopped; it cannot know who was silent meanwhile."""
    clock = Clock()
    with ExitStack() as stack:
        codec = mission_codec(mission)
        first, second = connect_team(range(AGENTS), codec, free_endpoint())
        stack.callback(first.close)
        stack.callback(second.close)
        sleepy = Sleepy(first, clock)
        planner = planner_of(mission)
        node = build_node(mission, 0, planner, incarnation=1)
        events: list[Event] = []
        stopped = RemoteAgent(
            node,
            cast("RealTransport", sleepy),
            rng=generator(1, Stream.NODE, 0),
            prover=stack.enter_context(closing(Prover(mission, 0, planner))),
            on_event=events.append,
            clock=clock,
        )
        other = join_mission(mission, second)
        stopped.start()
        other.start()

        def go_on() -> bool:
            for agent in (stopped, other):
                agent.step(0.01)
            return stopped.over and other.over

        wait_until(go_on, "the mission is over")
        sleepy.stop_for = 1800.0
        for _ in range(10):
            stopped.step(0.01)
        assert not [event for event in events if isinstance(event, AgentBuried)]
        assert stopped.over


def test_an_agent_tells_where_its_vehicle_is_and_no_oftener_than_it_must(mission: Mission) -> None:
    clock, said = Clock(), list[Event | Telemetry]()
    codec = mission_codec(mission)
    with closing(ZenohTransport(Sender(0, 7), codec, NetworkOptions())) as transport:
        planner = planner_of(mission)
        vehicle = build_vehicle(mission, 0, "kinematic", mission.agents[0].pose, clock())
        agent = RemoteAgent(
            build_node(mission, 0, planner, incarnation=7),
            transport,
            rng=generator(1, Stream.NODE, 0),
            prover=Prover(mission, 0, planner),
            vehicle=vehicle,
            on_event=said.append,
            on_telemetry=said.append,
            clock=clock,
        )
        agent.start()
        first = said[0]
        assert isinstance(first, Telemetry)  # before any event
        assert first.sender == Sender(0, 7)
        assert first.state[:2].tolist() == [vehicle.pose.x, vehicle.pose.y]
        began = clock()
        for _ in range(100):
            agent.step(0.0)
        reports = [item for item in said if isinstance(item, Telemetry)]
        assert len(reports) <= 2 + (clock() - began) / REPORT_EVERY
        clock.ahead += REPORT_EVERY
        agent.step(0.0)
        assert len([item for item in said if isinstance(item, Telemetry)]) == len(reports) + 1
        agent.close()


def test_an_agent_without_a_vehicle_tells_nothing_of_one(mission: Mission) -> None:
    reports: list[Telemetry] = []
    with closing(ZenohTransport(Sender(0, 1), mission_codec(mission), NetworkOptions())) as transport:
        agent = join_mission(mission, transport, on_telemetry=reports.append)
        agent.run(timeout=0.5)
        agent.close()
    assert reports == []


def test_a_newer_life_of_an_agent_ends_the_older(mission: Mission) -> None:
    codec = mission_codec(mission)
    endpoint = free_endpoint()
    with closing(ZenohTransport(Sender(0, 1), codec, NetworkOptions(listen=(endpoint,)))) as old:
        agent = join_mission(mission, old)
        with closing(ZenohTransport(Sender(0, 2), codec, NetworkOptions(connect=(endpoint,)))) as new:
            assert not agent.run(timeout=60.0)
            assert agent.superseded
            assert not new.superseded


def test_a_life_that_remembers_takes_over_what_there_is(mission: Mission, tmp_path: Path) -> None:
    rng, said = np.random.default_rng(0), list[str]()
    directory = AgentDirectory(tmp_path, 0, mission_codec(mission), said.append)
    first = build_node(mission, 0, planner_of(mission), incarnation=1)
    directory.keep(first.sender, first.memory(), first.pose)
    found = directory.recall()
    assert found is not None
    assert said == []
    node = build_node(mission, 0, planner_of(mission), incarnation=2, memory=found.memory)
    node.start(0.0, rng)
    for other in range(1, len(mission.agents)):
        node.bury(0.0, other)
    assert node.landmarks.tolist() == list(range(len(mission.landmarks)))


def test_the_transport_must_be_the_agents_own(mission: Mission) -> None:
    with closing(ZenohTransport(Sender(1, 1), mission_codec(mission), NetworkOptions())) as transport:
        agent = join_mission(mission, transport)
        assert not agent.over
        assert not agent.run(timeout=0.0)
        planner = planner_of(mission)
        rng, prover = generator(1, Stream.NODE, 0), Prover(mission, 0, planner)
        with pytest.raises(ArgumentError, match="transport"):
            RemoteAgent(build_node(mission, 0, planner, incarnation=1), transport, rng=rng, prover=prover)
        bare = Node(1, [0, 1], agent.node.records, agent.node.poses, planner)
        with pytest.raises(ArgumentError, match="membership and prove"):
            RemoteAgent(bare, transport, rng=rng, prover=prover)
        prover.close()
