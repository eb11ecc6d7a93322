"""One agent of a mission in a process of its own: a node, a transport and the time of day."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from covey.errors import ArgumentError, InputError
from covey.mission import Mission, mission_digest
from covey.protocol import (
    Event,
    GoTo,
    Heartbeat,
    LandmarkRecords,
    Node,
    Output,
    Publish,
    Send,
    TerminationDetector,
)
from covey.runtime.agent import TeamPlanner, build_models, nearest_first
from covey.runtime.streams import Stream, generator
from covey.runtime.team import initial_owners
from covey.transports import RealTransport
from covey.transports.codec import Codec

HEARTBEAT_EVERY = 0.5
"""Seconds between two heartbeats when nothing changes: on a network one may be lost."""

MOST_JOINING, MOST_ADDED = 1000, 100_000
"""How many agents may join a mission that runs, and how many landmarks may be added to it."""


class RemoteAgent:
    """Drives one node over a transport in real time; it plans, and its vehicle is at each waypoint at once.

    Parameters
    ----------
    node : Node
    team : sequence of int
        All agents, this one among them.
    transport : RealTransport
        Of the same agent.
    rng : numpy.random.Generator, keyword-only
    on_event : callable, keyword-only
        Called with each event of this agent; `ZenohTransport.log` tells observers.
    heartbeat_every : float, keyword-only
        Seconds.
    clock : callable, keyword-only
        Seconds that only rise.

    Raises
    ------
    ArgumentError
        If the transport is another agent's, or the heartbeat's period is not above 0.

    Notes
    -----
    Each agent judges by itself, from everybody's heartbeats, whether the mission is over.  Who leaves as soon as it
    knows may leave before the others do: let `run` linger.
    """

    def __init__(
        self,
        node: Node,
        team: Sequence[int],
        transport: RealTransport,
        *,
        rng: np.random.Generator,
        on_event: Callable[[Event], object] = lambda event: None,
        heartbeat_every: float = HEARTBEAT_EVERY,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if transport.agent != node.agent:
            raise ArgumentError(f"transport: expected that of agent {node.agent}, got that of agent {transport.agent}")
        if not heartbeat_every > 0.0:
            raise ArgumentError(f"heartbeat_every: expected more than 0, got {heartbeat_every}")
        self.node = node
        self._transport = transport
        self._rng = rng
        self._on_event = on_event
        self._heartbeat_every = heartbeat_every
        self._clock = clock
        self._detector = TerminationDetector(team)
        self._beat_at = -math.inf

    @property
    def over(self) -> bool:
        """Whether the mission is over, as far as this agent has heard."""
        return self._detector.terminated

    def start(self) -> None:
        """Begin the mission; once, before `step`."""
        self._carry_out(self.node.start(self._clock(), self._rng))

    def step(self, timeout: float) -> None:
        """Wait for a message or for what is due, `timeout` seconds at most, and act on it."""
        deadline = self.node.next_deadline()
        due = self._beat_at if deadline is None else min(deadline, self._beat_at)
        self._transport.wait(min(timeout, max(0.0, due - self._clock())))
        for message in self._transport.receive():
            if isinstance(message, Heartbeat):
                self._detector.receive(message)
            self._carry_out(self.node.receive(self._clock(), message, self._rng))
        deadline = self.node.next_deadline()
        if deadline is not None and deadline <= self._clock():
            self._carry_out(self.node.poll(self._clock(), self._rng))
        if self._beat_at <= self._clock():
            self._publish(self.node.heartbeat())

    def run(self, *, timeout: float = math.inf, linger: float = 3.0 * HEARTBEAT_EVERY) -> bool:
        """Take part until the mission is over, then stay while others may still have to hear of it.

        Parameters
        ----------
        timeout : float, keyword-only
            Seconds after which to give up.
        linger : float, keyword-only
            How long the mission must have been over, seconds.

        Returns
        -------
        bool
            Whether the mission is over.
        """
        begun = self._clock()
        self.start()
        over_since = math.inf
        while self._clock() < begun + timeout:
            self.step(self._heartbeat_every)
            over_since = min(over_since, self._clock()) if self.over else math.inf
            if self._clock() >= over_since + linger:
                break
        return self.over

    def _carry_out(self, outputs: Sequence[Output]) -> None:
        for output in outputs:
            if isinstance(output, Send):
                self._transport.send(output.to, output.message)
            elif isinstance(output, Publish):
                self._publish(output.heartbeat)
            elif isinstance(output, GoTo):
                self._carry_out(self.node.waypoint_reached(self._clock()))
            else:
                self._on_event(output)

    def _publish(self, heartbeat: Heartbeat) -> None:
        self._beat_at = self._clock() + self._heartbeat_every
        self._detector.receive(heartbeat)
        self._transport.publish(heartbeat)


def mission_codec(mission: Mission) -> Codec:
    """Return the codec of a mission, which tells its messages from those of any other."""
    return Codec(
        mission_digest(mission),
        agents=len(mission.agents),
        landmarks=len(mission.landmarks),
        more_agents=MOST_JOINING,
        more_landmarks=MOST_ADDED,
    )


def join_mission(
    mission: Mission,
    agent: int,
    transport: RealTransport,
    *,
    on_event: Callable[[Event], object] = lambda event: None,
) -> RemoteAgent:
    """Build the agent of a mission that starts together with all others.

    Parameters
    ----------
    mission : Mission
        The same in every process; see `covey.mission.mission_digest`.
    agent : int
        Its place in the mission's list.
    transport : RealTransport
        Of this agent, in its first life.
    on_event : callable, keyword-only
        As for `RemoteAgent`.

    Raises
    ------
    InputError
        If a sensor cannot be built, or agents share a layer.
    """
    if mission.separation is not None:
        raise InputError(
            f"{mission.path or mission.name}: flight: expected a layer for each agent: those that share one need an "
            "airspace that all see, which agents in processes of their own do not have; raise ceiling_m or layers"
        )
    coverage, seed = mission.coverage, mission.seed
    planner = TeamPlanner(mission, build_models(mission), trade=coverage.trade, optimizer=coverage.optimizer, seed=seed)
    team = range(len(mission.agents))
    owner = initial_owners(mission, seed)
    records = LandmarkRecords.initial(len(mission.landmarks), {other: np.flatnonzero(owner == other) for other in team})
    poses = {other: specification.pose for other, specification in enumerate(mission.agents)}
    node = Node(agent, team, records, poses, planner, order=nearest_first)
    return RemoteAgent(node, team, transport, rng=generator(seed, Stream.NODE, agent), on_event=on_event)
