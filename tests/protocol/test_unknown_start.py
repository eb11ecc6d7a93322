"""A team of which nobody knows anything begins from its assignment; who must be proved waits for the proof."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from covey.faults import draw, run
from covey.faults.table import TablePlanner, pose_at
from covey.geometry import Pose2
from covey.protocol import (
    Catalogue,
    GoTo,
    LandmarkRecords,
    Links,
    MembershipOptions,
    Message,
    Node,
    NodeOptions,
    Order,
    Output,
    Planner,
    PoseRecords,
    Publish,
    Send,
    random_order,
)
from covey.protocol.catalogue import EMPTY
from covey.protocol.records import GENERATION, OWNER

RNG = np.random.default_rng(0)
TABLE = np.array([[[0.2, 0.8, 0.8, 0.1]], [[0.8, 0.1, 0.2, 0.8]], [[0.5, 0.5, 0.5, 0.5]]])
ASSIGNED = np.array([2, 0, 1, 2])
OPTIONS = NodeOptions(
    backoff=0.3, pause=0.3, membership=MembershipOptions(heartbeat_every=1.0, dead_after=4.0, map_every=1.0)
)


def make(agent: int, options: NodeOptions = OPTIONS) -> Node:
    return Node(
        agent,
        [0, 1, 2],
        LandmarkRecords.unknown(4),
        {a: pose_at(0) for a in range(3)},
        TablePlanner(TABLE, np.ones(4), pairwise=False),
        options=options,
        assigned=ASSIGNED,
    )


class Room:
    """Nodes that hear each other at once, until nothing is left to say."""

    def __init__(self, *nodes: Node) -> None:
        self.nodes = {node.agent: node for node in nodes}
        self.now = 0.0
        self.said: list[tuple[int, Message]] = []
        for node in nodes:
            self.act(node, node.start(self.now, RNG))

    def act(self, node: Node, outputs: Sequence[Output]) -> None:
        for output in outputs:
            match output:
                case Send():
                    self.said.append((output.to, output.message))
                case Publish():
                    self.said += [(other, output.heartbeat) for other in self.nodes if other != node.agent]
                case GoTo():
                    self.act(node, node.waypoint_reached(self.now))

    def pass_time(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += 0.05
            for node in self.nodes.values():
                deadline = node.next_deadline()
                if deadline is not None and deadline <= self.now:
                    self.act(node, node.poll(self.now, RNG))
            while self.said:
                to, message = self.said.pop(0)
                if to in self.nodes:
                    self.act(self.nodes[to], self.nodes[to].receive(self.now, message, RNG))


def test_nobody_takes_anything_before_all_are_heard() -> None:
    room = Room(make(0), make(1))
    room.pass_time(3.0)
    assert all(len(node.landmarks) == 0 and not node.quiescent and not node.over for node in room.nodes.values())


def test_each_takes_what_is_assigned_to_it_and_the_mission_goes_on_from_there() -> None:
    nodes = [make(agent) for agent in range(3)]
    taken: dict[int, list[int]] = {}
    room = Room(*nodes)
    for _ in range(400):
        room.pass_time(0.05)
        for node in nodes:
            if len(node.landmarks):
                taken.setdefault(node.agent, node.landmarks.tolist())
    assert sorted(k for own in taken.values() for k in own) == [0, 1, 2, 3]
    assert all(node.over for node in nodes)
    # by trades every landmark has come to who sees it best
    assert [node.landmarks.tolist() for node in nodes] == [[1, 2], [0, 3], []]


def test_what_is_assigned_to_somebody_who_is_not_there_goes_to_who_sees_it_best() -> None:
    nodes = [make(0), make(1)]
    Room(*nodes).pass_time(20.0)
    assert [node.landmarks.tolist() for node in nodes] == [[1, 2], [0, 3]]
    assert all(node.over for node in nodes)


def test_a_map_tells_only_what_is_known() -> None:
    records = LandmarkRecords.unknown(4)
    assert len(records.known().indices) == 0
    records.merge(LandmarkRecords.initial(4, {0: np.arange(4)}).slice(np.array([1, 3])))
    assert records.known().indices.tolist() == [1, 3]


def unknowing() -> type[Node]:
    """Return the node of a team of which nobody knows anything at first, whatever it is told."""
    first: list[NDArray[np.int64]] = []

    class Unknowing(Node):
        def __init__(
            self,
            agent: int,
            team: Sequence[int],
            records: LandmarkRecords,
            poses: Mapping[int, Pose2] | PoseRecords,
            planner: Planner,
            *,
            incarnation: int = 1,
            order: Order = random_order,
            options: NodeOptions | None = None,
            links: Links | None = None,
            avoid: tuple[Pose2, ...] = (),
            catalogue: Catalogue = EMPTY,
            assigned: NDArray[np.int64] | None = None,
        ) -> None:
            if incarnation == 1:
                first.append(records.values[:, OWNER].copy())
                records = LandmarkRecords.unknown(records.first)
            super().__init__(
                agent,
                team,
                records,
                poses,
                planner,
                incarnation=incarnation,
                order=order,
                options=options,
                links=links,
                avoid=avoid,
                catalogue=catalogue,
                assigned=first[0],
            )

    return Unknowing


def test_a_team_that_knows_nothing_survives_what_others_survive(seeds: Callable[[int, int], range]) -> None:
    for seed in seeds(100, 3000):
        outcome = run(draw(seed), unknowing())
        assert outcome.violation is None, f"seed {seed}: {outcome.violation}"


def proving(agent: int = 0) -> Node:
    return make(agent, replace(OPTIONS, prove=True))


def test_an_agent_is_quiescent_only_when_its_pose_is_proved() -> None:
    nodes = [proving(agent) for agent in range(3)]
    room = Room(*nodes)
    room.pass_time(20.0)
    assert all(node.unproved and not node.quiescent and not node.over for node in nodes)
    for node in nodes:
        room.act(node, node.pose_proved(room.now, node.epoch))
        assert node.quiescent
    room.pass_time(2.0)
    assert all(node.over for node in nodes)


def test_a_proof_of_what_has_changed_since_is_none() -> None:
    nodes = [proving(agent) for agent in range(3)]
    room = Room(*nodes)
    room.pass_time(20.0)
    nodes[0].pose_proved(room.now, nodes[0].epoch - 1)
    assert nodes[0].unproved
    assert not nodes[0].quiescent


def test_a_first_record_is_of_the_first_generation() -> None:
    nodes = [make(agent) for agent in range(3)]
    Room(*nodes).pass_time(5.0)
    assert (nodes[0].records.values[:, GENERATION] >= 1).all()
