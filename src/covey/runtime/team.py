"""A team that trades on the in-process bus: nodes, planner, bus, and the log of what happened."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from covey.coverage import agent_scores, team_visibility
from covey.geometry import Pose2
from covey.mission import Assignment, Mission
from covey.protocol import (
    Cause,
    Event,
    GoTo,
    LandmarkRecords,
    Lock,
    MembershipOptions,
    Node,
    NodeOptions,
    Output,
    PoseOptimized,
    Publish,
    TerminationDetector,
    TradeCommitted,
    WaypointAbandoned,
)
from covey.runtime.agent import TeamPlanner, nearest_first
from covey.runtime.airspace import Airspace, check_clear_starts
from covey.runtime.links import build_links
from covey.runtime.result import AgentResult, HistoryEntry, Scores, Snapshot
from covey.runtime.streams import Stream, generator
from covey.sensing import VisibilityModel
from covey.transports import Loopback

MEMBERSHIP = MembershipOptions(heartbeat_every=1.0, dead_after=1e6, map_every=0.1)
"""Where agents must hear each other's poses and maps: on the bus nobody is lost, so nobody is declared dead."""


class Travel(Protocol):
    """How agents get to their waypoints."""

    def go_to(self, agent: int, pose: Pose2) -> None:
        """Send an agent's vehicle to a pose."""
        ...

    def make_way(self, agent: int, pose: Pose2) -> None:
        """Let an agent's vehicle leave for a pose that a trade has committed; `go_to` follows when that is through.

        Others may have been committed to the place that it leaves.
        """
        ...

    def under_way(self, agent: int) -> bool:
        """Whether an agent's vehicle has not arrived yet."""
        ...

    def wait(self, agent: int) -> Pose2 | None:
        """Let time pass until an agent is not under way; return the pose it holds instead if it cannot get there."""
        ...


class Teleport:
    """Planning without flying: the vehicle is at its waypoint at once."""

    def go_to(self, agent: int, pose: Pose2) -> None:
        """Do nothing."""

    def make_way(self, agent: int, pose: Pose2) -> None:
        """Do nothing."""

    def under_way(self, agent: int) -> bool:
        """Return False."""
        return False

    def wait(self, agent: int) -> Pose2 | None:
        """Return None."""
        return None


@dataclass(frozen=True, eq=False)
class Standing:
    """A team at one moment.

    Parameters
    ----------
    mission : Mission
        With the landmarks and agents of that moment.
    models : tuple of VisibilityModel
        Each agent's sensor.
    agents : tuple of int
        The number of each agent in its team.
    poses : tuple of Pose2
    scores : tuple of float
    sets : tuple of array, shape (k,)
        The sorted landmarks of each agent.
    """

    mission: Mission
    models: tuple[VisibilityModel, ...]
    agents: tuple[int, ...]
    poses: tuple[Pose2, ...]
    scores: tuple[float, ...]
    sets: tuple[NDArray[np.int64], ...]


def standing_results(standing: Standing) -> tuple[AgentResult, ...]:
    """Return where each agent is and what it watches."""
    return tuple(
        AgentResult(specification.name, pose, score, landmarks)
        for specification, pose, score, landmarks in zip(
            standing.mission.agents, standing.poses, standing.scores, standing.sets, strict=True
        )
    )


class Onlooker(Protocol):
    """Wants to know what happens in a team, the moment it happens."""

    def changed(self, event: str, agents: tuple[int, ...]) -> None:
        """Take notice of a new entry of the history, with the indices of the agents."""
        ...

    def acted(self, agent: int) -> None:
        """Take notice of an agent that has done something, perhaps only answered."""
        ...

    def reshaped(self, event: str, agents: tuple[int, ...], landmarks: NDArray[np.int64], detail: str) -> None:
        """Take notice of a new entry of the history: landmarks or agents were changed from outside."""
        ...


def initial_owners(mission: Mission, seed: int) -> NDArray[np.int64]:
    """Return the index of each landmark's first owner, shape (n,).

    Notes
    -----
    Source: Sposato (2016), Algorithm 2.
    """
    rule = mission.coverage.assignment
    n, m = len(mission.landmarks), len(mission.agents)
    if isinstance(rule, Mapping):
        owner = np.empty(n, dtype=np.int64)
        for index, agent in enumerate(mission.agents):
            owner[list(rule.get(agent.name, ()))] = index
        return owner
    if rule is Assignment.NEAREST:
        positions = np.array([agent.pose.position_W for agent in mission.agents])
        away = ((mission.landmarks.positions_W[:, None, :] - positions[None, :, :]) ** 2).sum(axis=2)
        return np.asarray(away.argmin(axis=1), dtype=np.int64)
    return generator(seed, Stream.ASSIGNMENT).integers(0, m, n)


class Team:
    """The agents of a mission, from the first assignment to the last trade.

    Parameters
    ----------
    mission : Mission
    planner : TeamPlanner
    seed : int
        Root of all randomness.
    travel : Travel, optional
        How agents get to their waypoints; at once by default.
    options : NodeOptions, optional
        Of the agents.
    delay : (float, float)
        Shortest and longest time that a message takes, seconds.

    Raises
    ------
    InputError
        If agents that share a layer start too close to each other.

    Notes
    -----
    What is addressed to an agent under way waits until it has arrived, and so does all that comes after it on the bus.
    So the order of events, and with it the outcome, is the same however long the way takes; nothing tells a node
    apart from one that hears of its arrival in time, and therefore it is told at once.

    The state kept here (poses, owner, history) is that of the newest committed records, as an observer sees it that
    hears each event the moment it happens; the nodes themselves know only what messages told them.
    """

    def __init__(
        self,
        mission: Mission,
        planner: TeamPlanner,
        *,
        seed: int,
        travel: Travel | None = None,
        options: NodeOptions | None = None,
        delay: tuple[float, float] = (0.5e-3, 1.5e-3),
    ) -> None:
        check_clear_starts(mission)
        self.mission = mission
        self.travel = travel or Teleport()
        self.onlooker: Onlooker | None = None
        self.planner = planner
        self.poses: list[Pose2] = [agent.pose for agent in mission.agents]
        self.owner = initial_owners(mission, seed)
        self.trades = 0
        agents = range(len(mission.agents))
        self.scores = self._all_scores()
        self.history = [HistoryEntry("initial", (), self.score)]
        self.snapshots = [self._snapshot("initial")]
        self.bus = Loopback(rng=generator(seed, Stream.BUS), delay=delay)
        records = LandmarkRecords.initial(
            len(mission.landmarks), {agent: np.flatnonzero(self.owner == agent) for agent in agents}
        )
        poses = dict(enumerate(self.poses))
        links = build_links(mission)
        if options is None and (links is not None or mission.changes):
            options = NodeOptions(membership=MEMBERSHIP)
        self._links, self._options = links, options
        self.nodes = [
            Node(agent, list(agents), records, poses, planner, order=nearest_first, options=options, links=links)
            for agent in agents
        ]
        self.airspace = None if mission.separation is None else Airspace(self)
        planner.airspace = self.airspace
        self._detector = TerminationDetector(agents)
        self.bus.observe(self._detector.receive)
        for agent, node in enumerate(self.nodes):
            mortal = options is not None and options.membership is not None
            self.bus.attach(node, generator(seed, Stream.NODE, agent), hears_heartbeats=mortal)
        self._first_client: int | None = None

    @property
    def score(self) -> float:
        """Team score at the committed poses, eq. (4.5)."""
        return float(self.scores.sum())

    @property
    def settled(self) -> bool:
        """Whether every agent is quiescent and no trade is in flight, as an observer detects it."""
        return self._detector.terminated

    def start(self) -> Iterator[None]:
        """Optimise every agent's first pose, one an iteration."""
        for agent in range(len(self.nodes)):
            self._act(agent, self.bus.start(agent))
            self._show(agent)
            yield
        self._take_snapshot("after_first_optimization")

    def advance(self) -> bool:
        """Let the next thing happen; False when nothing is left to do.

        That is when every agent is quiescent and no trade is in flight, as an observer detects it, and everybody has
        arrived.
        """
        if self.settled:
            for agent in range(len(self.nodes)):
                self._await(agent)
            return not self.settled
        concerned = self.bus.next_agent()
        if concerned is not None and self._await(concerned):
            return True
        self._step()
        return True

    def _await(self, agent: int) -> bool:
        """Let an agent arrive; whether it turned out that it cannot."""
        if not self.travel.under_way(agent):
            return False
        held = self.travel.wait(agent)
        if held is not None:
            self.hold(agent, held)
        return held is not None

    def free(self, agent: int, pose: Pose2) -> Pose2:
        """Return the pose if an agent may be committed there now, or else the nearest where it may."""
        if self.airspace is None:
            return pose
        region = self.airspace.room(agent, self.mission.agents[agent].region)
        return Pose2(*region.project(pose.x, pose.y), pose.yaw)

    def hold(self, agent: int, pose: Pose2) -> None:
        """Commit the pose that an agent holds because it cannot reach or keep its waypoint (V8)."""
        self._carry_out(agent, self.nodes[agent].waypoint_unreachable(self.bus.now, pose))

    def _step(self) -> None:
        step = self.bus.step()
        assert step is not None, "the bus ran dry before termination was detected"
        if step.agent is not None:
            self._act(step.agent, step.outputs)
            self._show(step.agent)
        if self._first_client is not None and self.nodes[self._first_client].lock is not Lock.CLIENT_DONE:
            # the client is through when the server has acknowledged: by then both have optimised their poses
            self._first_client = None
            self._take_snapshot("after_first_trade")

    def adopt(self, agent: int, pose: Pose2) -> bool:
        """Offer an agent a better pose that a proof found; whether it is still free and the agent took it."""
        if self.airspace is not None and not self.airspace.is_free(agent, pose):
            return False
        outputs = self.nodes[agent].adopt_pose(self.bus.now, pose)
        self._carry_out(agent, outputs)
        return any(isinstance(output, PoseOptimized) for output in outputs)

    def _carry_out(self, agent: int, outputs: Sequence[Output]) -> None:
        """Do what a node asks for after a direct call; the observer hears of it at once."""
        for output in outputs:
            if isinstance(output, Publish):
                self._detector.receive(output.heartbeat)
        self._act(agent, self.bus.apply(agent, outputs))
        self._show(agent)

    def note(self, event: str, agent: int) -> None:
        """Score an agent anew and put into the history why."""
        self._log(event, (agent,))

    def rescore(self) -> None:
        """Compute every score anew."""
        self.scores = self._all_scores()

    def sets(self) -> list[NDArray[np.int64]]:
        """Return the sorted landmarks of each agent."""
        return [np.flatnonzero(self.owner == agent) for agent in range(len(self.nodes))]

    def standing(self) -> Standing:
        """Return the team as it is now."""
        scores = tuple(float(score) for score in self.scores)
        agents = tuple(range(len(self.nodes)))
        return Standing(self.mission, tuple(self.planner.models), agents, tuple(self.poses), scores, tuple(self.sets()))

    def summary(self) -> Scores:
        """Return the scores at the four moments; NaN for one that was not reached."""
        known = {snapshot.label: snapshot.score for snapshot in self.snapshots}
        after_first = known.get("after_first_optimization", math.nan)
        return Scores(
            initial=known["initial"],
            after_first_optimization=after_first,
            after_first_trade=known.get("after_first_trade", math.nan),
            final=self.score,
        )

    def _all_scores(self) -> NDArray[np.float64]:
        landmarks = self.mission.landmarks
        return agent_scores(team_visibility(self.planner.models, self.poses, landmarks), self.owner, landmarks.weights)

    def _act(self, agent: int, outputs: Sequence[GoTo | Event]) -> None:
        for output in outputs:
            if isinstance(output, GoTo):
                self.travel.go_to(agent, output.pose)
                self._act(agent, self.bus.apply(agent, self.nodes[agent].waypoint_reached(self.bus.now)))
            elif isinstance(output, TradeCommitted):
                self._on_trade(output)
            elif isinstance(output, PoseOptimized):
                self.poses[output.agent] = output.pose
                kind = "proof" if output.cause is Cause.PROOF else "optimization"
                self._log(kind, (output.agent,))
            elif isinstance(output, WaypointAbandoned):
                self.poses[output.agent] = output.held
                self._log("abandoned", (output.agent,))

    def _on_trade(self, trade: TradeCommitted) -> None:
        for agent, pose in ((trade.client, trade.client_pose), (trade.server, trade.server_pose)):
            if self.airspace is not None and pose != self.poses[agent]:
                self.travel.make_way(agent, pose)
            self.poses[agent] = pose
        self.owner[trade.client_landmarks] = trade.client
        self.owner[trade.server_landmarks] = trade.server
        self.trades += 1
        if self.trades == 1:
            self._first_client = trade.client
        self._log("trade", (trade.client, trade.server))

    def _score_of(self, agent: int) -> float:
        own = np.flatnonzero(self.owner == agent)
        return float(self.planner.visibility(agent, self.poses[agent])[own] @ self.mission.landmarks.weights[own])

    def _log(self, event: str, agents: tuple[int, ...]) -> None:
        for agent in agents:
            self.scores[agent] = self._score_of(agent)
        names = tuple(self.mission.agents[agent].name for agent in agents)
        self.history.append(HistoryEntry(event, names, self.score))
        if self.onlooker is not None:
            self.onlooker.changed(event, agents)

    def _show(self, agent: int) -> None:
        if self.onlooker is not None:
            self.onlooker.acted(agent)

    def _snapshot(self, label: str) -> Snapshot:
        return Snapshot(label, tuple(self.poses), self.owner.copy(), self.score)

    def _take_snapshot(self, label: str) -> None:
        self.snapshots.append(self._snapshot(label))

    def finish(self) -> tuple[Snapshot, ...]:
        """Return the snapshots with the state as it is now as the last."""
        return (*self.snapshots, self._snapshot("final"))
