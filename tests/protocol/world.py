"""A small world in which nodes trade while every invariant is checked after every message."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from covey.faults.table import SIGMA, TablePlanner, pose_at, random_partition, random_planner
from covey.protocol import (
    AgentState,
    Event,
    GoTo,
    Heartbeat,
    LandmarkRecords,
    Lock,
    Message,
    Node,
    NodeOptions,
    Output,
    PoseRecords,
    Publish,
    Send,
    TerminationDetector,
    WaypointAbandoned,
    judge,
)


class Violation(AssertionError):
    """An invariant does not hold."""


def require(holds: bool, invariant: str, detail: str) -> None:
    """Raise `Violation` unless it holds."""
    if not holds:
        raise Violation(f"{invariant}: {detail}")


@dataclass(frozen=True)
class Weather:
    """How the network treats messages, and what else happens.

    Parameters
    ----------
    loss, duplicates : float
        Probabilities, for each message.
    calm_after : float
        From this time on nothing is lost; seconds.
    spread : float
        Longest delay, seconds; the shortest is a hundredth of it.
    flying, unreachable : float
        Probability that a waypoint takes time to reach, and that it cannot be reached.
    proofs : float
        Probability, at each message, that somebody is handed the best pose for its landmarks.
    lag : float
        Heartbeats take up to this many times longer than other messages.
    twice : bool
        Every message arrives exactly twice.
    """

    loss: float = 0.0
    duplicates: float = 0.0
    calm_after: float = 30.0
    spread: float = 0.02
    flying: float = 0.0
    unreachable: float = 0.0
    proofs: float = 0.0
    lag: float = 1.0
    twice: bool = False


FAIR = Weather()


class World:
    """Nodes, an unreliable network under one seed, and the invariants.

    Parameters
    ----------
    seed : int
    weather : Weather
    pairwise : bool
    node : type
        The class under test: `Node`, or a mutant.
    agents, poses, landmarks : int
    eager : bool
        See `TablePlanner`.
    """

    def __init__(
        self,
        seed: int,
        weather: Weather = FAIR,
        *,
        pairwise: bool = True,
        node: type[Node] = Node,
        detector: type[TerminationDetector] = TerminationDetector,
        agents: int = 4,
        poses: int = 4,
        landmarks: int = 12,
        eager: bool = True,
    ) -> None:
        scene, self.rng, *own = np.random.default_rng(seed).spawn(agents + 2)
        self.weather, self.now, self.count = weather, 0.0, 0
        self.rngs: Sequence[np.random.Generator] = own
        self.planner: TablePlanner = random_planner(
            scene, agents=agents, poses=poses, landmarks=landmarks, pairwise=pairwise, eager=eager
        )
        records = LandmarkRecords.initial(landmarks, random_partition(scene, agents=agents, landmarks=landmarks))
        start = {agent: pose_at(int(scene.integers(poses))) for agent in range(agents)}
        # Time-outs are drawn against the delays, so that every order of the two happens.
        options = NodeOptions(
            backoff=0.01,
            pause=float(scene.choice([0.0, 0.02])),
            resend_after=float(scene.uniform(0.3, 5.0)) * max(weather.spread, 1e-3),
            give_up_after=float(scene.uniform(0.3, 20.0)) * max(weather.spread, 1e-3),
        )
        team = list(range(agents))
        self.nodes = [node(agent, team, records, start, self.planner, options=options) for agent in team]
        self.detector = detector(team)
        self.queue: list[tuple[float, int, int, Message | str | float]] = []
        self.log: list[Event] = []
        self.messages: list[tuple[int, Message]] = []
        self.polls: list[float | None] = [None] * agents
        self.checked: list[object] = []
        self.score = -np.inf
        self.newest_poses = PoseRecords.initial(start)
        self.seen = [n.records.values.copy() for n in self.nodes]

    def run(self, limit: int = 20_000) -> None:
        """Run until the detector says it is over, checking everything all the time; then check the end."""
        for node, rng in zip(self.nodes, self.rngs, strict=True):
            self.carry_out(node.agent, node.start(self.now, rng))
        for _ in range(limit):
            self.check()
            if self.detector.terminated:
                break
            require(bool(self.queue), "termination", "nothing will happen any more, and nobody said so")
            self.step()
        require(self.detector.terminated, "termination", f"not within {limit} steps")
        self.check_end()

    def step(self) -> None:
        """Let the next thing happen."""
        self.now, _, agent, what = heapq.heappop(self.queue)
        if self.rng.random() < self.weather.proofs:
            self.prove(int(self.rng.integers(len(self.nodes))))
        if agent < 0:
            assert isinstance(what, Heartbeat)
            self.detector.receive(what)
            return
        node, rng = self.nodes[agent], self.rngs[agent]
        if what == "arrived":
            if self.rng.random() < self.weather.unreachable and self.now < self.weather.calm_after:
                held = pose_at(int(self.rng.integers(self.planner.table.shape[1])))
                self.carry_out(agent, node.waypoint_unreachable(self.now, held))
            else:
                self.carry_out(agent, node.waypoint_reached(self.now))
        elif isinstance(what, float):
            if what == self.polls[agent]:
                self.polls[agent] = None
                self.carry_out(agent, node.poll(self.now, rng))
        elif not isinstance(what, str):
            self.messages.append((agent, what))
            self.carry_out(agent, node.receive(self.now, what, rng))

    def prove(self, agent: int) -> None:
        """Hand an agent the best pose for its landmarks, as a proof would, at any moment."""
        node = self.nodes[agent]
        best = int(self.planner.scores(agent, node.landmarks).argmax())
        if self.now < self.weather.calm_after:
            outputs = node.adopt_pose(self.now, pose_at(best))
            for output in outputs:
                if isinstance(output, Publish):
                    self.detector.receive(output.heartbeat)
            self.carry_out(agent, outputs)

    def carry_out(self, agent: int, outputs: list[Output]) -> None:
        """Do what a node asks."""
        for output in outputs:
            match output:
                case Send():
                    self.post(output.to, output.message)
                case Publish():
                    self.post(-1, output.heartbeat)
                case GoTo():
                    flying = self.rng.random() < self.weather.flying
                    self.push(0.3 * self.rng.random() if flying else 0.0, agent, "arrived")
                case _:
                    self.log.append(output)
                    if isinstance(output, WaypointAbandoned):
                        self.score = -np.inf
        deadline = self.nodes[agent].next_deadline()
        if deadline is not None and deadline != self.polls[agent]:
            self.polls[agent] = deadline
            self.push(max(0.0, deadline - self.now), agent, deadline)

    def post(self, to: int, message: Message) -> None:
        """Give a message to the network; heartbeats are sent again for ever, so none of theirs is lost."""
        calm = self.now >= self.weather.calm_after or to < 0
        copies = 1
        if self.weather.twice:
            copies = 2
        elif not calm:
            copies = int(self.rng.random() >= self.weather.loss) + int(self.rng.random() < self.weather.duplicates)
        for _ in range(copies):
            spread = self.weather.spread * (self.weather.lag if to < 0 else 1.0)
            self.push(spread * float(self.rng.uniform(0.01, 1.0)), to, message)

    def push(self, delay: float, agent: int, what: Message | str | float) -> None:
        """Put something on the queue."""
        self.count += 1
        heapq.heappush(self.queue, (self.now + delay, self.count, agent, what))

    # The invariants.

    def newest(self) -> LandmarkRecords:
        """Return the newest record of each landmark, over all maps."""
        newest = self.nodes[0].records.copy()
        everything = np.arange(len(newest))
        for node in self.nodes[1:]:
            newest.merge(node.records.slice(everything))
        return newest

    def check(self) -> None:
        """Check I2, I3, I5 and what follows from Q at this instant."""
        state: list[object] = [(node.epoch, node.escrow, node.lock, node.partners) for node in self.nodes]
        if state == self.checked:
            return  # nothing that is checked here has changed
        self.checked = state
        claims = np.zeros(self.planner.table.shape[2], dtype=np.int64)
        for node in self.nodes:
            claims[node.claims()] += 1
            before, after = self.seen[node.agent], node.records.values
            if not np.array_equal(before, after):
                shrunk = [k for k in range(len(before)) if tuple(after[k]) < tuple(before[k])]
                require(not shrunk, "I5", f"the records of landmarks {shrunk} shrank at agent {node.agent}")
                self.seen[node.agent] = after.copy()
            for agent in node.poses:
                self.newest_poses.merge(agent, node.poses[agent])
        twice = np.flatnonzero(claims > 1)
        require(len(twice) == 0, "I2", f"landmarks {twice} are claimed twice at {self.now}")
        owner = self.newest().values[:, 2]
        score = sum(
            float(self.planner.scores(a, np.flatnonzero(owner == a))[round(self.newest_poses.pose(a).x)])
            for a in range(len(self.nodes))
        )
        require(score >= self.score - 1e-9, "I3", f"the score fell from {self.score} to {score} at {self.now}")
        self.score = score
        self.check_partners()

    def check_partners(self) -> None:
        """Check that two agents that have dropped each other have nothing to trade (V6)."""
        for a, b in itertools.combinations(self.nodes, 2):
            if a.lock is b.lock is Lock.IDLE and a.agent not in b.partners and b.agent not in a.partners:
                states = [AgentState(node.agent, node.pose, node.landmarks, node.avoid) for node in (a, b)]
                proposal = self.planner.propose(states[0], states[1])
                if proposal is not None:
                    accepted = judge(self.planner, states[0], states[1], proposal).accepted
                    require(not accepted, "V6", f"agents {a.agent} and {b.agent} dropped each other too early")

    def check_end(self) -> None:
        """Check that what was declared over is over, complete, disjoint, and meets Definition 3."""
        newest, owned = self.newest(), np.zeros(self.planner.table.shape[2], dtype=np.int64)
        for node in self.nodes:
            require(node.quiescent and node.lock is Lock.IDLE, "V10", f"agent {node.agent} is not quiescent")
            owned[node.claims()] += 1
            require(
                np.array_equal(node.landmarks, newest.owned_by(node.agent, 1)), "I4", f"agent {node.agent}: old map"
            )
            require(self.newest_poses.pose(node.agent) == node.pose, "I4", f"agent {node.agent}: old pose")
        require(bool((owned == 1).all()), "I1", f"landmarks {np.flatnonzero(owned != 1)} have not one owner")
        for node in self.nodes:
            scores = self.planner.scores(node.agent, node.landmarks)
            unreachable = any(isinstance(event, WaypointAbandoned) for event in self.log)
            if self.planner.eager and not unreachable:
                gap = float(scores.max() - scores[round(node.pose.x)])
                require(gap <= SIGMA, "Definition 3", f"agent {node.agent} could see {gap} more")
            mine = self.planner.visibility(node.agent, node.pose)[node.landmarks]
            for other in self.nodes:
                theirs = self.planner.visibility(other.agent, other.pose)[node.landmarks]
                worse = node.landmarks[mine < theirs - SIGMA]
                require(len(worse) == 0, "Definition 3", f"agent {other.agent} sees {worse} of {node.agent} better")
