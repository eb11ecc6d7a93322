"""One agent of a mission in a process of its own: a node, a transport, a vehicle, a prover and the time of day."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from covey.errors import ArgumentError, InputError
from covey.geometry import Pose2
from covey.mission import Mission, mission_digest
from covey.protocol import (
    EMPTY,
    Adopt,
    Catalogue,
    Event,
    GoTo,
    Heartbeat,
    LandmarkRecords,
    Map,
    MembershipOptions,
    Memory,
    Message,
    Node,
    NodeOptions,
    Output,
    PoseOptimized,
    PoseRecords,
    Publish,
    Send,
)
from covey.runtime.agent import TeamPlanner, build_planner, nearest_first
from covey.runtime.airspace import check_processes
from covey.runtime.links import build_links
from covey.runtime.network.prover import Prover
from covey.runtime.network.remote_vehicle import AtOnce, Leg, Vehicle
from covey.runtime.streams import Stream, generator
from covey.runtime.team import initial_owners
from covey.transports import RealTransport
from covey.transports.codec import Codec
from covey.transports.telemetry import Telemetry

NETWORK_TIMES = MembershipOptions(heartbeat_every=0.5, dead_after=3.0, map_every=0.3)
"""On a network: who is silent for six heartbeats is dead."""

LEASE = 2.0
"""Lease of a transport that goes with `NETWORK_TIMES`, seconds: less than it takes to be declared dead."""

RESEND_AFTER, GIVE_UP_AFTER = 0.5, 2.0
"""Waiting times of a node on a network, seconds: see `NodeOptions`."""

LINGER = 1.5
"""How long a mission must have been over before an agent leaves by itself, seconds."""

SLEPT = 0.25
"""An agent that comes back so much of `dead_after` later than it meant to has slept, or its process was stopped."""

MORE_AGENTS, MORE_LANDMARKS = 1_000, 1_000_000
"""How many agents may join a mission on a network, and landmarks be added."""

REPORT_EVERY = 0.1
"""Seconds between two reports of where the vehicle is, at least; one that rests reports when its node is due."""

PROOF_TICK = 0.01
"""How often to look whether a proof is done, seconds."""


class RemoteAgent:
    """Drives one node over a transport in real time.

    Parameters
    ----------
    node : Node
        With ``options.membership`` and ``options.prove``.
    transport : RealTransport
        Of the same agent.
    rng : numpy.random.Generator, keyword-only
    prover : Prover, keyword-only
    vehicle : Vehicle, keyword-only
        At each waypoint at once by default.
    on_event : callable, keyword-only
        Called with each event of this agent; `ZenohTransport.log` tells observers.
    on_telemetry : callable, keyword-only
        Called with where the vehicle is, ten times a second at most; `ZenohTransport.report` tells observers.
    on_change : callable, keyword-only
        Called after whatever may have changed what there is to remember.
    on_trouble : callable, keyword-only
        Called with what is wrong with a change of the mission that this agent cannot take in.
    clock : callable, keyword-only
        Seconds that only rise.

    Raises
    ------
    ArgumentError
        If the transport is another agent's, or the node lacks one of the two options.

    Notes
    -----
    Each agent judges by itself, from everybody's heartbeats, whether the mission is over: all poses are proved by then,
    each by its own agent.  Who leaves as soon as it knows may leave before the others do: let `run` linger.

    Time through which the process was stopped does not pass for the node: whoever could not listen cannot tell who was
    silent.
    """

    def __init__(
        self,
        node: Node,
        transport: RealTransport,
        *,
        rng: np.random.Generator,
        prover: Prover,
        vehicle: Vehicle | None = None,
        on_event: Callable[[Event], object] = lambda event: None,
        on_telemetry: Callable[[Telemetry], object] = lambda telemetry: None,
        on_change: Callable[[], object] = lambda: None,
        on_trouble: Callable[[str], object] = lambda text: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if transport.agent != node.agent:
            raise ArgumentError(f"transport: expected that of agent {node.agent}, got that of agent {transport.agent}")
        if node.options.membership is None or not node.options.prove:
            raise ArgumentError("node: expected one whose options have membership and prove")
        self.node = node
        self.vehicle: Vehicle = AtOnce(node.pose) if vehicle is None else vehicle
        self.longest_silence = 0.0
        """The longest time that this agent was too busy to speak, seconds."""
        self.unreadable = 0
        """How many messages described an agent that cannot be built; they were dropped."""
        self._dead_after = node.options.membership.dead_after
        self._beat = node.options.membership.heartbeat_every
        self._transport = transport
        self._rng = rng
        self._prover = prover
        self._on_event = on_event
        self._on_telemetry = on_telemetry
        self._report_at = -math.inf
        self._on_change = on_change
        self._on_trouble = on_trouble
        self._wall = clock
        self._slept = 0.0
        self._early: list[Message] = []
        self._roll_call_at = math.inf
        self._spoken: set[int] = set()
        self._lost: frozenset[object] = frozenset()
        self._stuck_at: Pose2 | None = None

    @property
    def over(self) -> bool:
        """Whether the mission is over, as far as this agent has heard."""
        return self.node.over

    @property
    def superseded(self) -> bool:
        """Whether a newer life of this agent has begun elsewhere: this one must end."""
        return self._transport.superseded

    def assemble(self, others: float, patience: float, stop: Callable[[], bool] = lambda: False) -> bool:
        """Wait before the start until all are there, or somebody has begun.

        Parameters
        ----------
        others : float
            How many others there are; infinitely many to wait for somebody who has begun.
        patience : float
            Seconds to wait at most.
        stop : callable
            Asked now and then whether to wait no longer.

        Returns
        -------
        bool
            Whether they are all there or somebody has begun.
        """
        end = self._clock() + patience
        while True:
            self._early += self._transport.receive()
            if len(self._transport.peers) >= others or self._has_begun:
                return True
            left = end - self._clock()
            if left <= 0.0 or stop():
                return False
            self._transport.wait(min(0.1, left))

    @property
    def _has_begun(self) -> bool:
        return any(isinstance(message, Heartbeat) for message in self._early)

    def start(self) -> None:
        """Begin the mission; once, before `step`.

        Who comes into a mission that has begun looks after a heartbeat who is there, and does not wait until those who
        are not have been silent for long: they have been before.
        """
        membership = self.node.options.membership
        if self._has_begun and membership is not None and membership.adopt is Adopt.ALL:
            self._roll_call_at = self._clock() + self._beat
        self._report()  # before any event says where it is bound for
        self._carry_out(self.node.start(self._clock(), self._rng))
        early, self._early = self._early, []
        self._take_in(early)

    def step(self, timeout: float) -> None:
        """Wait for a message or for what is due, `timeout` seconds at most, and act on it."""
        begun = self._clock()
        dues = [begun + timeout, self.node.next_deadline(), self.vehicle.due(begun)]
        if self._prover.busy:
            dues.append(begun + PROOF_TICK)
        pause = max(0.0, min(due for due in dues if due is not None) - begun)
        self._transport.wait(pause)
        self._note_sleep(begun, pause)
        awake = self._clock()
        self._take_in(self._transport.receive())
        lost: frozenset[object] = self._transport.suspects
        for sender in self._transport.suspects - self._lost:
            self.node.suspect(sender.agent)
        self._lost = lost
        deadline = self.node.next_deadline()
        if deadline is not None and deadline <= self._clock():
            self._carry_out(self.node.poll(self._clock(), self._rng))
        if self._roll_call_at <= self._clock():
            self._call_the_roll()
        self._fly()
        self._report()
        self._prove()
        if self._transport.map_wanted:
            own = self.node
            self._transport.show_map(Map(own.sender, own.records.known(), own.poses.as_mapping(), own.catalogue))
        self._on_change()
        self.longest_silence = max(self.longest_silence, self._note_sleep(awake, 0.0))

    def run(
        self,
        *,
        timeout: float = math.inf,
        linger: float = LINGER,
        stop: Callable[[], bool] = lambda: False,
        on_step: Callable[[], object] = lambda: None,
    ) -> bool:
        """Take part until the mission is over, then stay while others may still have to hear of it.

        Parameters
        ----------
        timeout : float, keyword-only
            Seconds after which to give up.
        linger : float, keyword-only
            How long the mission must have been over, seconds; infinite to stay until told.
        stop : callable, keyword-only
            Asked twice a second or more often whether to leave.
        on_step : callable, keyword-only
            Called as often.

        Returns
        -------
        bool
            Whether the mission is over.
        """
        begun = self._clock()
        self.start()
        over_since = math.inf
        while self._clock() < begun + timeout and not stop() and not self.superseded:
            self.step(self._beat)
            on_step()
            left = self.node.left  # to stay for ever would be no leaving; its last words must get through
            over_since = min(over_since, self._clock()) if self.over or left else math.inf
            if self._clock() >= over_since + (min(linger, LINGER) if left else linger):
                break
        return self.over

    def close(self) -> None:
        """Give up a proof that is going on."""
        self._prover.close()

    def _clock(self) -> float:
        """Return the node's time, seconds."""
        return self._wall() - self._slept

    def _note_sleep(self, since: float, expected: float) -> float:
        """Take out of the node's time what passed since a moment beyond what was expected, if it is much; return it."""
        extra = self._clock() - since - expected
        if extra > SLEPT * self._dead_after:
            self._slept += extra
        return extra

    def _take_in(self, messages: Sequence[Message]) -> None:
        for message in messages:
            self._spoken.add(message.sender.agent)
            try:
                outputs = self.node.receive(self._clock(), message, self._rng)
            except InputError as error:  # it describes an agent that this one cannot build: nothing was taken in
                self.unreadable += 1
                self._on_trouble(str(error))
                continue
            self._carry_out(outputs)

    def _call_the_roll(self) -> None:
        """Take those for dead that are neither connected nor heard."""
        self._roll_call_at = math.inf
        here = {peer.agent for peer in self._transport.peers} | self._spoken | {self.node.agent}
        for agent in sorted(set(self.node.poses) - here):
            self._carry_out(self.node.bury(self._clock(), agent))

    def _fly(self) -> None:
        leg = self.vehicle.advance(self._clock())
        if self.node.at_waypoint:
            return
        if leg is Leg.ARRIVED:
            self._carry_out(self.node.waypoint_reached(self._clock()))
        elif leg is Leg.STUCK:
            held = self.vehicle.hold()
            self._carry_out(self.node.waypoint_unreachable(self._clock(), held))

    def _report(self) -> None:
        """Tell where the vehicle is, if there is one and it is time to."""
        now = self._clock()
        state = self.vehicle.state if now >= self._report_at else None
        if state is not None and np.isfinite(state).all():
            self._report_at = now + REPORT_EVERY
            self._on_telemetry(Telemetry(self.node.sender, state, self.vehicle.battery))

    def _prove(self) -> None:
        """Have the pose proved when there is nothing else to do, and go on if the proof finds a better one."""
        node, prover = self.node, self._prover
        if prover.epoch is not None and prover.epoch != node.epoch:
            prover.cancel()
        if not node.unproved:
            return
        if prover.epoch is None:
            prover.begin(node.epoch, node.pose, node.landmarks)
        if prover.busy:
            return
        epoch, better = prover.result()
        outputs = [] if better is None else node.adopt_pose(self._clock(), better)
        if not any(isinstance(output, PoseOptimized) for output in outputs):
            outputs = node.pose_proved(self._clock(), epoch)
        self._carry_out(outputs)

    def _carry_out(self, outputs: Sequence[Output]) -> None:
        for output in outputs:
            if isinstance(output, Send):
                self._transport.send(output.to, output.message)
            elif isinstance(output, Publish):
                self._transport.publish(output.heartbeat)
            elif isinstance(output, GoTo):
                self.vehicle.go_to(self._clock(), output.pose)
                self._fly()
            else:
                self._on_event(output)


def mission_codec(mission: Mission) -> Codec:
    """Return the codec of a mission, which tells its messages from those of any other."""
    return Codec(
        mission_digest(mission),
        agents=len(mission.agents),
        landmarks=len(mission.landmarks),
        more_agents=MORE_AGENTS,
        more_landmarks=MORE_LANDMARKS,
    )


def node_options(times: MembershipOptions = NETWORK_TIMES) -> NodeOptions:
    """Return the options of a node on a network."""
    return NodeOptions(resend_after=RESEND_AFTER, give_up_after=GIVE_UP_AFTER, membership=times, prove=True)


def build_node(
    mission: Mission,
    agent: int,
    planner: TeamPlanner,
    *,
    incarnation: int,
    memory: Memory | None = None,
    times: MembershipOptions = NETWORK_TIMES,
    catalogue: Catalogue = EMPTY,
) -> Node:
    """Build the node of one life of an agent.

    Parameters
    ----------
    mission : Mission
        The same in every process; see `covey.mission.mission_digest`.
    agent : int
        Its place in the mission's list, or the number that it has in the catalogue.
    planner : TeamPlanner
    incarnation : int, keyword-only
        Above that of every earlier life.
    memory : Memory, keyword-only
        Of an earlier life.  Without one, in a first life or one that has lost its memory, it owns nothing until it has
        heard from all that live.
    times : MembershipOptions, keyword-only
    catalogue : Catalogue, keyword-only
        What is known to have changed since the mission began; an agent that joins finds itself there.
    """
    team = range(len(mission.agents))
    planner.learn(catalogue)
    assigned = initial_owners(mission, mission.seed)
    options, links = node_options(times), build_links(mission)
    if memory is not None:
        memory = replace(memory, catalogue=memory.catalogue.merged(catalogue))
        return Node.restart(
            agent,
            team,
            memory,
            planner,
            incarnation=incarnation,
            order=nearest_first,
            options=options,
            links=links,
            assigned=assigned,
        )
    return Node(
        agent,
        team,
        LandmarkRecords.unknown(len(mission.landmarks)),
        PoseRecords.initial({other: specification.pose for other, specification in enumerate(mission.agents)})
        if agent < len(mission.agents)
        else {agent: planner.agents[agent].pose},
        planner,
        incarnation=incarnation,
        order=nearest_first,
        options=options,
        links=links,
        assigned=assigned,
        catalogue=catalogue,
    )


def join_mission(
    mission: Mission,
    transport: RealTransport,
    *,
    incarnation: int = 1,
    planner: TeamPlanner | None = None,
    memory: Memory | None = None,
    times: MembershipOptions = NETWORK_TIMES,
    catalogue: Catalogue = EMPTY,
    vehicle: Vehicle | None = None,
    on_event: Callable[[Event], object] = lambda event: None,
    on_telemetry: Callable[[Telemetry], object] = lambda telemetry: None,
    on_trouble: Callable[[str], object] = lambda text: None,
) -> RemoteAgent:
    """Build one life of one agent of a mission.

    Parameters
    ----------
    mission : Mission
        The same in every process; see `covey.mission.mission_digest`.
    transport : RealTransport
        Of this agent, in this life.
    incarnation, memory, times, catalogue : keyword-only
        As for `build_node`.
    planner : TeamPlanner, keyword-only
        Made from the mission by default.
    vehicle, on_event, on_telemetry, on_trouble : keyword-only
        As for `RemoteAgent`.

    Raises
    ------
    InputError
        If a sensor cannot be built, or agents share a layer.
    """
    check_processes(mission)
    agent = transport.agent
    planner = build_planner(mission) if planner is None else planner
    node = build_node(mission, agent, planner, incarnation=incarnation, memory=memory, times=times, catalogue=catalogue)
    return RemoteAgent(
        node,
        transport,
        rng=generator(mission.seed, Stream.NODE, agent),
        prover=Prover(mission, agent, planner),
        vehicle=vehicle,
        on_event=on_event,
        on_telemetry=on_telemetry,
        on_trouble=on_trouble,
    )
