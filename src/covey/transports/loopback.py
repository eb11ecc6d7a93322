"""Agents in one process, joined by a bus with virtual time and a seeded order."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from covey.errors import ArgumentError
from covey.protocol import Event, GoTo, Heartbeat, Message, Node, Output, Publish, Send

Observer: TypeAlias = Callable[[Heartbeat], object]
"""Called with each heartbeat when it arrives."""

_BLOCK = 1024


@dataclass(frozen=True, slots=True)
class Step:
    """What happened in one step.

    Parameters
    ----------
    now : float
        Virtual time, seconds.
    agent : int or None
        Whose node did something; None when a heartbeat reached the observers.
    received : Message or None
        The message that was delivered; None when the node was polled.
    outputs : tuple
        What the node asks of its surroundings: waypoints and events, in order.  Messages are already on their way.
    """

    now: float
    agent: int | None
    received: Message | None
    outputs: tuple[GoTo | Event, ...]


@dataclass(eq=False)
class _Member:
    node: Node
    rng: np.random.Generator
    hears_heartbeats: bool
    wake_at: float = math.inf


@dataclass(eq=False)
class _Wake:
    agent: int


@dataclass(eq=False)
class _Delivery:
    to: int | None  # None: the observers
    message: Message


class Loopback:
    """The in-process bus.

    A message takes a random time, so messages overtake each other, on one link too.  None is doubled, and none is lost
    unless `loss` says so.  The same seed gives the same run, whatever the machine does.

    Parameters
    ----------
    rng : numpy.random.Generator, keyword-only
        Delays, and the order of what happens at the same instant.
    delay : (float, float), keyword-only
        Shortest and longest time that a message takes, seconds.

    Attributes
    ----------
    loss : float
        Share of the messages between agents that is lost, from 0 to 1.

    Raises
    ------
    ArgumentError
        If the delays are not in order or negative.

    Examples
    --------
    Two agents with a planner that sees nothing to gain; the observer is the only one who learns that it is over.

    >>> from covey.geometry import Pose2
    >>> from covey.protocol import LandmarkRecords, TerminationDetector
    >>> class Content:
    ...     sigma, weights = 0.01, np.ones(2)
    ...     def visibility(self, agent, pose): return np.ones(2)
    ...     def improve(self, agent, pose, landmarks): return None
    ...     def propose(self, server, client): return None
    >>> records = LandmarkRecords.initial(2, {0: np.array([0]), 1: np.array([1])})
    >>> poses = {0: Pose2(0.0, 0.0, 0.0), 1: Pose2(1.0, 0.0, 0.0)}
    >>> nodes = {agent: Node(agent, [0, 1], records, poses, Content()) for agent in (0, 1)}
    >>> bus_rng, *node_rngs = np.random.default_rng(7).spawn(3)
    >>> bus, detector = Loopback(rng=bus_rng), TerminationDetector(nodes)
    >>> bus.observe(detector.receive)
    >>> for node, rng in zip(nodes.values(), node_rngs):
    ...     bus.attach(node, rng)
    >>> def act(agent, outputs):
    ...     for output in outputs:
    ...         if isinstance(output, GoTo):  # planning: the vehicle is there at once
    ...             act(agent, bus.apply(agent, nodes[agent].waypoint_reached(bus.now)))
    >>> for agent in nodes:
    ...     act(agent, bus.start(agent))
    >>> while not detector.terminated:
    ...     step = bus.step()
    ...     act(step.agent, step.outputs)
    >>> all(node.quiescent for node in nodes.values())
    True
    """

    def __init__(self, *, rng: np.random.Generator, delay: tuple[float, float] = (0.5e-3, 1.5e-3)) -> None:
        shortest, longest = delay
        if not 0.0 <= shortest <= longest < math.inf:
            raise ArgumentError(f"delay: expected 0 <= shortest <= longest, got {delay}")
        self.now = 0.0
        self.loss = 0.0
        self.messages = 0
        """How many messages have been sent, heartbeats not counted."""
        self._rng = rng
        self._shortest, self._spread = shortest, longest - shortest
        self._random: list[float] = []
        self._queue: list[tuple[float, float, int, _Delivery | _Wake]] = []
        self._count = 0
        self._members: dict[int, _Member] = {}
        self._endpoints: dict[int, LoopbackEndpoint] = {}
        self._observers: list[Observer] = []

    # Who is on the bus.

    def attach(self, node: Node, rng: np.random.Generator, *, hears_heartbeats: bool = False) -> None:
        """Put a node on the bus, with the generator that it is given in each call; `step` then drives it.

        Raises
        ------
        ArgumentError
            If an agent of that number is there already.
        """
        self._check_new(node.agent)
        self._members[node.agent] = _Member(node, rng, hears_heartbeats)

    def detach(self, agent: int) -> None:
        """Take a node off the bus: its agent is dead, and what was on its way to it vanishes unless it comes back."""
        del self._members[agent]

    def endpoint(self, agent: int) -> LoopbackEndpoint:
        """Open an agent's access to the bus, for one that is driven from outside; it hears heartbeats.

        Raises
        ------
        ArgumentError
            If an agent of that number is there already.
        """
        self._check_new(agent)
        endpoint = LoopbackEndpoint(self, agent)
        self._endpoints[agent] = endpoint
        return endpoint

    def observe(self, observer: Observer) -> None:
        """Have each heartbeat delivered to an observer as well."""
        self._observers.append(observer)

    # What happens.

    def start(self, agent: int) -> tuple[GoTo | Event, ...]:
        """Start an attached node."""
        member = self._members[agent]
        return self.apply(agent, member.node.start(self.now, member.rng))

    def apply(self, agent: int, outputs: Iterable[Output]) -> tuple[GoTo | Event, ...]:
        """Carry out what a direct call to an attached node returned; return what is not for the bus."""
        rest: list[GoTo | Event] = []
        member = self._members[agent]
        self._route(agent, outputs, rest)
        self._schedule(member)
        return tuple(rest)

    def step(self) -> Step | None:
        """Let the next thing happen and move the time to it; None when nothing is on its way.

        A message is delivered to its node, endpoint or observers, or a node whose deadline has come is polled.
        """
        while self._queue:
            time, _, _, item = heapq.heappop(self._queue)
            self.now = time
            if isinstance(item, _Wake):
                member = self._members.get(item.agent)
                if member is not None and time == member.wake_at:
                    member.wake_at = math.inf
                    deadline = member.node.next_deadline()
                    if deadline is not None and deadline <= time:
                        return self._act(member, None)
                    self._schedule(member)
            elif item.to is None:
                for observer in self._observers:
                    if isinstance(item.message, Heartbeat):
                        observer(item.message)
                return Step(time, None, item.message, ())
            elif item.to in self._members:
                return self._act(self._members[item.to], item.message)
            elif item.to in self._endpoints:
                self._endpoints[item.to].inbox.append(item.message)
                return Step(time, item.to, item.message, ())
        return None

    def next_agent(self) -> int | None:
        """Return whom the next step concerns; None: an observer, or nothing is on its way."""
        while self._queue:
            time, _, _, item = self._queue[0]
            if isinstance(item, _Delivery):
                return item.to
            member = self._members.get(item.agent)
            deadline = None if member is None else member.node.next_deadline()
            if member is not None and time == member.wake_at and deadline is not None and deadline <= time:
                return item.agent
            heapq.heappop(self._queue)  # `step` would pass over it as well
            self.now = time
            if member is not None and time == member.wake_at:
                member.wake_at = math.inf
                self._schedule(member)
        return None

    def send(self, to: int, message: Message) -> None:
        """Put a message on its way; one to nobody vanishes."""
        self.messages += 1
        if self._is_lost():
            return
        self._push(self.now + self._shortest + self._spread * self._draw(), _Delivery(to, message))

    def publish(self, heartbeat: Heartbeat) -> None:
        """Put a heartbeat on its way to the observers, the endpoints, and the nodes that asked for it."""
        sender = heartbeat.sender.agent
        listeners: list[int | None] = [agent for agent in self._endpoints if agent != sender]
        listeners += [agent for agent, member in self._members.items() if member.hears_heartbeats and agent != sender]
        if self._observers:
            listeners.append(None)
        for to in listeners:
            if to is not None and self._is_lost():
                continue
            self._push(self.now + self._shortest + self._spread * self._draw(), _Delivery(to, heartbeat))

    def remove(self, endpoint: LoopbackEndpoint) -> None:
        """Take an endpoint off the bus."""
        if self._endpoints.get(endpoint.agent) is endpoint:
            del self._endpoints[endpoint.agent]

    def _check_new(self, agent: int) -> None:
        if agent in self._members or agent in self._endpoints:
            raise ArgumentError(f"agent: expected one that is not on the bus yet, got {agent}")

    def _act(self, member: _Member, message: Message | None) -> Step:
        node, rest = member.node, list[GoTo | Event]()
        now, rng = self.now, member.rng
        outputs = node.poll(now, rng) if message is None else node.receive(now, message, rng)
        self._route(node.agent, outputs, rest)
        self._schedule(member)
        return Step(self.now, node.agent, message, tuple(rest))

    def _route(self, agent: int, outputs: Iterable[Output], rest: list[GoTo | Event]) -> None:
        for output in outputs:
            if isinstance(output, Send):
                self.send(output.to, output.message)
            elif isinstance(output, Publish):
                self.publish(output.heartbeat)
            else:
                rest.append(output)

    def _schedule(self, member: _Member) -> None:
        deadline = member.node.next_deadline()
        if deadline is not None and deadline < member.wake_at:
            member.wake_at = max(deadline, self.now)
            self._push(member.wake_at, _Wake(member.node.agent))

    def _push(self, time: float, item: _Delivery | _Wake) -> None:
        self._count += 1
        heapq.heappush(self._queue, (time, self._draw(), self._count, item))

    def _is_lost(self) -> bool:
        return self.loss > 0.0 and self._draw() < self.loss

    def _draw(self) -> float:
        if not self._random:
            self._random = self._rng.random(_BLOCK).tolist()
        return self._random.pop()


@dataclass(eq=False)
class LoopbackEndpoint:
    """One agent's access to a `Loopback`; a `covey.transports.Transport`.

    Parameters
    ----------
    bus : Loopback
    agent : int
    """

    bus: Loopback
    agent: int
    inbox: list[Message] = field(default_factory=list, init=False)
    closed: bool = field(default=False, init=False)

    def send(self, to: int, message: Message) -> None:
        """Send a message to one agent."""
        if not self.closed:
            self.bus.send(to, message)

    def publish(self, heartbeat: Heartbeat) -> None:
        """Publish the newest state to all others that listen."""
        if not self.closed:
            self.bus.publish(heartbeat)

    def receive(self) -> list[Message]:
        """Take what `Loopback.step` has delivered, in the order of arrival."""
        messages, self.inbox = self.inbox, []
        return messages

    def close(self) -> None:
        """Leave the bus."""
        self.closed = True
        self.inbox = []
        self.bus.remove(self)
