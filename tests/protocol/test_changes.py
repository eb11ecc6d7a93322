"""Landmarks and agents that come and go: the catalogue, and what one node does when it hears of a change."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covey.errors import ArgumentError
from covey.faults.table import TablePlanner, pose_at
from covey.protocol import (
    EMPTY,
    OPERATOR,
    Abort,
    AgentChange,
    AgentJoined,
    AgentLeft,
    Busy,
    Catalogue,
    Change,
    Commit,
    LandmarkChange,
    LandmarkRecords,
    LandmarksAdopted,
    LandmarksChanged,
    Map,
    MembershipOptions,
    Node,
    NodeOptions,
    Offer,
    Output,
    RecordSlice,
    Request,
    Send,
    Sender,
    Status,
    TradeId,
)
from covey.protocol.records import NOBODY, OWNER

RNG = np.random.default_rng(0)
OPTIONS = NodeOptions(membership=MembershipOptions(heartbeat_every=1.0, dead_after=4.0))
SENDER = Sender(OPERATOR, 1)

weights = st.sampled_from([0.0, 2.0])
changes = st.builds(
    Catalogue,
    st.dictionaries(
        st.integers(0, 4),
        st.builds(LandmarkChange, st.integers(1, 3), st.booleans(), weights, *[st.just(0.0)] * 4),
        max_size=3,
    ),
    st.dictionaries(st.integers(0, 3), st.builds(AgentChange, st.integers(1, 3), st.booleans()), max_size=3),
)


@given(changes, changes, changes)
def test_a_catalogue_is_a_semilattice(a: Catalogue, b: Catalogue, c: Catalogue) -> None:
    assert a.merged(b) == b.merged(a)
    assert a.merged(b).merged(c) == a.merged(b.merged(c))
    assert a.merged(a) is a
    assert a.merged(b).merged(b) == a.merged(b)
    assert (a.digest == b.digest) == (a == b)
    assert a.merged(EMPTY) is a


def planner() -> TablePlanner:
    """Three agents that see seven landmarks, the first four of which the mission begins with."""
    table = np.array([[[0.9, 0.9, 0.1, 0.1, 0.9, 0.2, 0.2]], [[0.1, 0.1, 0.9, 0.9, 0.2, 0.9, 0.2]], [[0.5] * 7]])
    return TablePlanner(table, np.array([1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]), pairwise=False)


def make(agent: int, catalogue: Catalogue = EMPTY) -> Node:
    records = LandmarkRecords.initial(4, {0: np.array([0, 1]), 1: np.array([2, 3])})
    if agent == 2:
        records = LandmarkRecords.unknown(4)
    node = Node(
        agent,
        [0, 1],
        records,
        {0: pose_at(0), 1: pose_at(0), agent: pose_at(0)},
        planner(),
        options=OPTIONS,
        catalogue=catalogue,
    )
    node.start(0.0, RNG)
    return node


def met() -> tuple[Node, Node]:
    """Two nodes that have each other's maps."""
    nodes = make(0), make(1)
    for node, other in (nodes, nodes[::-1]):
        node.receive(0.0, Map(other.sender, other.records.all(), other.poses.as_mapping()), RNG)
    return nodes


def added(k: int = 4, version: int = 1) -> Catalogue:
    return Catalogue({k: LandmarkChange(version, True, 1.0, 0.0, 0.0)})


def removed(k: int, version: int = 1) -> Catalogue:
    return Catalogue({k: LandmarkChange(version, False, 0.0, 0.0, 0.0)})


def told(node: Node, catalogue: Catalogue) -> list[Output]:
    return node.receive(0.0, Change(SENDER, catalogue), RNG)


def test_an_added_landmark_goes_to_who_sees_it_best() -> None:
    first, second = met()
    outputs = told(first, added())
    changed = next(output for output in outputs if isinstance(output, LandmarksChanged))
    assert changed.landmarks.tolist() == [4]
    assert any(isinstance(output, LandmarksAdopted) for output in outputs)
    assert first.landmarks.tolist() == [0, 1, 4]
    told(second, added())
    assert second.landmarks.tolist() == [2, 3]
    assert not second.quiescent  # nobody owns landmark 4, as far as it knows
    tell = next(o.message for o in outputs if isinstance(o, Send) and isinstance(o.message, Map) and o.to == 1)
    second.receive(0.0, tell, RNG)
    assert second.records.values[4, OWNER] == 0


def test_a_removed_landmark_is_nobodys_and_does_not_come_back() -> None:
    first, second = met()
    told(first, removed(0))
    assert first.landmarks.tolist() == first.claims().tolist() == [1]
    first.receive(0.0, Map(second.sender, second.records.all(), second.poses.as_mapping()), RNG)
    assert first.landmarks.tolist() == [1]
    assert told(first, removed(0)) == []
    told(first, added(0, version=2))
    assert first.landmarks.tolist() == [0, 1]


def test_a_change_fills_q() -> None:
    first, second = met()
    first._partners.drop(1)
    told(first, Catalogue({1: LandmarkChange(1, True, 5.0, 0.0, 0.0)}))
    assert first.partners == {1}
    assert second.catalogue == EMPTY
    second.receive(0.0, Map(first.sender, first.records.all(), first.poses.as_mapping(), first.catalogue), RNG)
    assert second.catalogue == first.catalogue


def test_who_knows_less_of_the_mission_is_not_traded_with() -> None:
    first, second = met()
    told(first, added())
    request = Request(first.sender, TradeId(0, 1, 1), first.poses[0], first.records.slice(first.landmarks))
    (answer,) = (o.message for o in second.receive(0.0, request, RNG) if isinstance(o, Send))
    assert isinstance(answer, Busy)
    told(second, removed(3))
    request = Request(second.sender, TradeId(1, 1, 1), second.poses[1], second.records.slice(np.array([2, 3])))
    told(first, removed(3))
    assert any(isinstance(o, Send) and isinstance(o.message, Busy) for o in first.receive(0.0, request, RNG))


def test_an_offer_of_what_has_been_removed_meanwhile_is_declined() -> None:
    first, second = met()
    (asked,) = (o for o in first.poll(1.0, RNG) if isinstance(o, Send) and isinstance(o.message, Request))
    assert asked.to == 1
    assert isinstance(asked.message, Request)
    told(first, removed(2))
    offer = Offer(
        second.sender, asked.message.trade, second.poses[1], second.records.slice(np.array([2, 3])), np.array([2]),
        np.array([], dtype=np.int64), pose_at(0), pose_at(0),
    )  # fmt: skip
    outputs = first.receive(1.0, offer, RNG)
    assert any(isinstance(o, Send) and isinstance(o.message, Abort) for o in outputs)
    assert not any(isinstance(o, Send) and isinstance(o.message, Commit) for o in outputs)


def test_what_a_leaver_owned_is_adopted_at_once() -> None:
    first, second = met()
    outputs = second.leave(0.0)
    assert second.left
    assert second.quiescent
    assert len(second.claims()) == 0
    assert second.next_deadline() is None
    assert second.poll(9.0, RNG) == second.receive(9.0, Change(SENDER, added()), RNG) == []
    farewell = next(o.message for o in outputs if isinstance(o, Send) and isinstance(o.message, Map))
    heard = first.receive(0.0, farewell, RNG)
    assert AgentLeft(0, 1) in heard
    assert first.status(1) is Status.DEAD
    assert first.landmarks.tolist() == [0, 1, 2, 3]
    assert first.partners == frozenset()
    first.receive(0.0, Map(second.sender, second.records.all(), second.poses.as_mapping()), RNG)
    assert first.landmarks.tolist() == [0, 1, 2, 3]


def test_who_does_not_know_that_it_has_left_is_told() -> None:
    first, second = met()
    told(first, Catalogue(agents={1: AgentChange(1, False)}))
    (reply,) = (o for o in first.receive(0.0, second.heartbeat(), RNG) if isinstance(o, Send))
    assert reply.to == 1
    second.receive(0.0, reply.message, RNG)
    assert second.left


def test_who_joins_counts_from_when_it_is_heard() -> None:
    first, second = met()
    joins = Catalogue(agents={2: AgentChange(1, True)})
    assert AgentJoined(0, 2) in told(first, joins)
    assert first.status(2) is Status.DEAD
    third = make(2, joins)
    first.receive(0.0, third.heartbeat(), RNG)
    assert first.status(2) is Status.ALIVE
    assert 2 in first.partners
    # Its own map introduces it to who has not heard of it.
    second.receive(0.0, third.heartbeat(), RNG)
    assert second.status(2) is Status.DEAD
    second.receive(0.0, Map(third.sender, third.records.known(), third.poses.as_mapping(), joins), RNG)
    assert second.status(2) is Status.ALIVE


def test_records_of_landmarks_that_are_not_known_yet_wait_for_the_change() -> None:
    first, _ = met()
    records = RecordSlice(np.array([6]), np.array([[1, 0, 0, 1]]))
    first.receive(0.0, Map(Sender(1, 1), records, {}), RNG)
    assert first.landmarks.tolist() == [0, 1]
    assert first.records.values[5, OWNER] == NOBODY
    told(first, added(6))
    assert first.landmarks.tolist() == [0, 1, 6]


def test_a_memory_keeps_the_changes() -> None:
    first, _ = met()
    told(first, added())
    told(first, removed(0, version=2))
    again = Node.restart(0, [0, 1], first.memory(), planner(), incarnation=2, options=OPTIONS)
    assert again.catalogue == first.catalogue
    assert len(again.records) == 5
    assert again.records.first == 4


def test_changes_need_a_team_that_survives_crashes() -> None:
    records = LandmarkRecords.initial(4, {0: np.arange(4)})
    node = Node(0, [0], records, {0: pose_at(0)}, planner())
    with pytest.raises(ArgumentError, match="membership"):
        node.change(0.0, added())
