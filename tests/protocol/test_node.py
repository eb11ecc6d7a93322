"""One node, message by message."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.faults.table import TablePlanner, pose_at
from covey.geometry import Pose2
from covey.protocol import (
    Abort,
    Ack,
    AgentState,
    Busy,
    Cause,
    Commit,
    GoTo,
    LandmarkRecords,
    Lock,
    Message,
    Node,
    NodeOptions,
    Nothing,
    Offer,
    OfferDeclined,
    Order,
    Output,
    PoseOptimized,
    Proposal,
    Publish,
    Reason,
    Request,
    Send,
    Sender,
    TradeCommitted,
    TradeId,
    WaypointAbandoned,
    coverage_score,
    judge,
)

T = TypeVar("T")
RNG = np.random.default_rng(0)
RESEND, GIVE_UP = 1.0, 2.5
OPTIONS = NodeOptions(backoff=0.0, pause=0.0, resend_after=RESEND, give_up_after=GIVE_UP)

# At pose 0 agent 0 sees landmarks 1 and 2 best, agent 1 sees 0 and 3 best.  Pose 1 is worse for all, pose 2 is better.
TABLE = np.array([[[0.2, 0.8, 0.8, 0.1]], [[0.8, 0.1, 0.2, 0.8]], [[0.0, 0.0, 0.0, 0.0]]])
TABLE = np.concatenate([TABLE, TABLE / 2.0, TABLE * 1.1], axis=1)
PARTITION: dict[int, list[int]] = {0: [0, 1], 1: [2, 3], 2: []}


class Scripted(TablePlanner):
    """A table planner whose `improve` finds the pose that it is told to."""

    finds: int | None = None

    def improve(self, agent: int, pose: Pose2, landmarks: NDArray[np.int64]) -> Pose2 | None:
        assert len(landmarks) > 0
        return None if self.finds is None else pose_at(self.finds)


def first_to_last(agent: int, poses: object, candidates: Sequence[int], rng: object) -> Sequence[int]:
    return candidates


def make(
    agent: int,
    *,
    planner: TablePlanner | None = None,
    start: bool = True,
    order: Order = first_to_last,
    partition: dict[int, list[int]] = PARTITION,
) -> Node:
    """Return a node of the team 0, 1, 2, all at pose 0, that has started."""
    records = LandmarkRecords.initial(4, {a: np.array(ks, dtype=np.int64) for a, ks in partition.items()})
    poses = {a: pose_at(0) for a in PARTITION}
    node = Node(agent, [0, 1, 2], records, poses, planner or scripted(), order=order, options=OPTIONS)
    if start:
        node.start(0.0, RNG)
    return node


def scripted() -> Scripted:
    return Scripted(TABLE, np.ones(4), pairwise=False)


def sent(outputs: Iterable[Output], kind: type[T]) -> list[T]:
    """Return the messages of one kind among the outputs."""
    return [output.message for output in outputs if isinstance(output, Send) and isinstance(output.message, kind)]


def of(outputs: Iterable[Output], kind: type[T]) -> list[T]:
    """Return the outputs of one kind."""
    return [output for output in outputs if isinstance(output, kind)]


def give(node: Node, message: Message, now: float = 0.0) -> list[Output]:
    return node.receive(now, message, RNG)


def asked(client: Node, now: float = 0.0) -> Request:
    (request,) = sent(client.poll(now, RNG), Request)
    return request


def prepared() -> tuple[Node, Node, Request, Offer]:
    """Return a client that waits and a server that has offered landmark 2 for landmark 0."""
    client, server = make(0), make(1)
    request = asked(client)
    (offer,) = sent(give(server, request), Offer)
    return client, server, request, offer


def committed() -> tuple[Node, Node, Request, Offer, Commit]:
    """Return the two after the commit point, before the server knows."""
    client, server, request, offer = prepared()
    (commit,) = sent(give(client, offer), Commit)
    return client, server, request, offer, commit


def test_a_trade_from_request_to_acknowledgement() -> None:
    client, server, request, offer = prepared()
    assert (client.lock, server.lock) == (Lock.CLIENT_WAIT, Lock.SERVER_PREPARED)
    assert request.records.indices.tolist() == [0, 1]
    assert (offer.give.tolist(), offer.want.tolist()) == ([2], [0])
    assert (server.landmarks.tolist(), server.claims().tolist()) == ([2, 3], [3])

    outputs = give(client, offer)
    (commit,), (event,) = sent(outputs, Commit), of(outputs, TradeCommitted)
    assert (client.lock, client.claims().tolist()) == (Lock.CLIENT_DONE, [1, 2])
    assert (event.client_landmarks.tolist(), event.server_landmarks.tolist()) == ([1, 2], [0, 3])
    assert event.moved == 2
    assert [event.before, event.after] == pytest.approx([2.0, 3.2])

    (ack,) = sent(give(server, commit), Ack)
    assert (server.lock, server.claims().tolist(), server.escrow) == (Lock.IDLE, [0, 3], None)
    assert server.poses[0].version == server.poses[1].version == 1
    give(client, ack)
    assert client.lock is Lock.IDLE
    assert client.partners == {1, 2}
    assert server.partners == {0, 2}
    assert server.records.values.tolist() == client.records.values.tolist()


def test_each_copy_gets_the_same_answer_and_changes_nothing() -> None:
    client, server, request, offer, commit = committed()
    assert sent(give(client, offer), Commit) == [commit]
    (ack,) = sent(give(server, commit), Ack)
    epochs = client.epoch, server.epoch
    assert sent(give(server, commit), Ack) == [ack]
    assert sent(give(server, request), Ack) == [ack]
    give(client, ack)
    assert give(client, ack) == []
    assert sent(give(client, offer), Abort) == [Abort(client.sender, offer.trade, Reason.STALE)]
    assert give(server, Abort(client.sender, offer.trade, Reason.STALE)) == []
    assert (client.epoch, server.epoch) == epochs
    assert (client.lock, server.lock) == (Lock.IDLE, Lock.IDLE)


def test_nothing_to_trade_drops_both_from_q() -> None:
    settled = {0: [1, 2], 1: [0, 3], 2: []}
    client, server = make(0, partition=settled), make(1, partition=settled)
    request = asked(client)
    (nothing,) = sent(give(server, request), Nothing)
    give(client, nothing)
    assert client.partners == server.partners == {2}
    assert sent(give(server, request), Nothing) == [nothing]
    assert give(client, nothing) == []


def test_an_agent_is_quiescent_when_q_is_empty_and_says_so() -> None:
    settled = {0: [1, 2], 1: [0, 3], 2: []}
    nodes = {agent: make(agent, partition=settled) for agent in PARTITION}
    outputs: list[Output] = []
    for server in (1, 2):
        (nothing,) = sent(give(nodes[server], asked(nodes[0])), Nothing)
        outputs = give(nodes[0], nothing)
    (heartbeat,) = [output.heartbeat for output in of(outputs, Publish)]
    assert nodes[0].quiescent
    assert heartbeat.quiescent
    assert nodes[0].next_deadline() is None
    assert sent(nodes[0].poll(9.0, RNG), Request) == []


def test_busy_is_no_failure() -> None:
    a, b = make(0), make(1)
    to_b, to_a = asked(a), asked(b)
    assert to_a.trade == TradeId(1, 1, 1)
    (busy_a,), (busy_b,) = sent(give(b, to_b), Busy), sent(give(a, to_a), Busy)
    give(a, busy_a)
    give(b, busy_b)
    assert a.lock is b.lock is Lock.IDLE
    assert a.partners == {1, 2}
    assert b.partners == {0, 2}
    assert sent(give(b, to_b), Busy) == [busy_a]


def test_the_next_in_line_is_asked_after_a_busy_one() -> None:
    client = make(0)
    order = []
    for _ in range(4):
        (send,) = of(client.poll(0.0, RNG), Send)
        order.append(send.to)
        give(client, Busy(Sender(send.to, 1), send.message.trade), 0.0) if isinstance(send.message, Request) else None
    assert order == [1, 2, 1, 2]


def test_a_server_in_a_trade_is_busy() -> None:
    _, server, _, _ = prepared()
    third = make(2)
    give(third, Busy(Sender(0, 1), asked(third).trade))
    assert sent(give(server, asked(third)), Busy)
    assert server.lock is Lock.SERVER_PREPARED


def test_an_agent_on_its_way_is_busy_and_does_not_ask() -> None:
    planner = scripted()
    planner.finds = 2
    server = make(1, planner=planner)
    assert not server.at_waypoint
    assert server.next_deadline() is None
    assert server.poll(0.0, RNG) == []
    assert sent(give(server, asked(make(0))), Busy)
    server.waypoint_reached(0.0)
    assert sent(server.poll(0.0, RNG), Request)


def test_a_client_gives_up_before_the_commit_and_the_server_lets_go() -> None:
    client, server, request, offer = prepared()
    assert sent(client.poll(RESEND / 2, RNG), Request) == []
    assert sent(client.poll(RESEND, RNG), Request) == [request]
    (abort,) = sent(client.poll(GIVE_UP + RESEND, RNG), Abort)
    assert client.lock is Lock.IDLE
    assert client.partners == {1, 2}
    give(server, abort)
    assert (server.lock, server.escrow, server.claims().tolist()) == (Lock.IDLE, None, [2, 3])
    assert give(server, request) == []
    assert sent(give(client, offer), Abort) == [abort]


def test_an_abort_that_overtakes_its_request_is_remembered() -> None:
    client, server = make(0), make(1)
    request = asked(client)
    give(server, Abort(client.sender, request.trade, Reason.STALE))
    assert give(server, request) == []
    assert server.lock is Lock.IDLE


def test_the_client_s_next_request_closes_the_trade_before() -> None:
    client, server, _, _ = prepared()
    client.poll(GIVE_UP + RESEND, RNG)
    (send,) = of(client.poll(99.0, RNG), Send)
    assert send.to == 2
    give(client, Busy(Sender(2, 1), TradeId(0, 1, 2)), 99.0)
    (again,) = sent(give(server, asked(client, 999.0)), Offer)
    assert again.trade.number == 3
    assert server.escrow is not None
    assert server.escrow.trade == again.trade


def test_a_server_never_gives_up_and_a_client_not_after_the_commit() -> None:
    client, server, _, offer, commit = committed()
    for now in np.arange(1.0, 50.0):
        assert sent(server.poll(now, RNG), Offer) == [offer]
        assert sent(client.poll(now, RNG), Commit) == [commit]
    assert (client.lock, server.lock) == (Lock.CLIENT_DONE, Lock.SERVER_PREPARED)


def test_a_request_that_counts_the_server_s_landmarks_is_an_old_one() -> None:
    _, server, request, _, commit = committed()
    give(server, commit)
    old = replace(request, trade=TradeId(0, 1, 7))
    assert sent(give(server, old), Busy)
    assert server.lock is Lock.IDLE


def test_an_offer_is_checked_by_the_client() -> None:
    client, server, _, offer = prepared()
    lies = replace(offer, give=np.array([3]), want=np.array([1]))
    outputs = give(client, lies)
    (abort,), (declined,) = sent(outputs, Abort), of(outputs, OfferDeclined)
    assert abort.reason is declined.reason is Reason.NO_GAIN
    assert client.landmarks.tolist() == [0, 1]
    give(server, abort)
    assert client.partners == server.partners == {2}


def test_an_offer_on_records_that_have_changed_is_stale() -> None:
    client, server, _, offer = prepared()
    client.records.merge(server.records.slice(np.array([2])).next(2, 1))
    outputs = give(client, offer)
    assert [abort.reason for abort in sent(outputs, Abort)] == [Reason.STALE]
    assert client.lock is Lock.IDLE
    assert client.partners == {1, 2}


def test_a_better_pose_is_committed_only_when_idle_and_at_the_waypoint() -> None:
    client, server, _, offer = prepared()
    for node in (client, server):
        assert node.adopt_pose(0.0, pose_at(2)) == []
    (commit,) = sent(give(client, offer), Commit)
    assert client.adopt_pose(0.0, pose_at(2)) == []
    give(server, commit)
    outputs = server.adopt_pose(0.0, pose_at(2))
    (event,), (goto,) = of(outputs, PoseOptimized), of(outputs, GoTo)
    assert (event.cause, event.pose, goto.pose) == (Cause.PROOF, pose_at(2), pose_at(2))
    assert event.after > event.before
    assert server.adopt_pose(0.0, pose_at(2)) == []


def test_a_pose_that_is_not_better_is_not_committed() -> None:
    planner = scripted()
    for found in (0, 1):
        planner.finds = found
        node = make(1, planner=planner, start=False)
        assert of(node.start(0.0, RNG), GoTo) == []
        assert node.adopt_pose(0.0, pose_at(found)) == []
        assert node.pose == pose_at(0)


def test_after_a_trade_each_side_optimises() -> None:
    client, server, _, _, commit = committed()
    for node in (client, server):
        assert isinstance(node._planner, Scripted)
        node._planner.finds = 2
    outputs = give(server, commit)
    assert of(outputs, PoseOptimized)
    assert of(outputs, GoTo) == [GoTo(pose_at(2))]
    (ack,) = sent(outputs, Ack)
    outputs = give(client, ack)
    assert [event.cause for event in of(outputs, PoseOptimized)] == [Cause.OPTIMIZER]
    assert of(outputs, GoTo) == [GoTo(pose_at(2))]


def test_an_agent_without_landmarks_keeps_its_pose_and_trades() -> None:
    node = make(2)
    assert node.pose == pose_at(0)
    assert node.adopt_pose(0.0, pose_at(2)) == []
    assert asked(node).records.indices.tolist() == []


def test_a_waypoint_that_cannot_be_reached() -> None:
    planner = scripted()
    planner.finds = 2
    node = make(1, planner=planner)
    outputs = node.waypoint_unreachable(1.0, pose_at(1))
    (event,) = of(outputs, WaypointAbandoned)
    assert (event.abandoned, event.held, node.pose) == (pose_at(2), pose_at(1), pose_at(1))
    assert event.before == pytest.approx(coverage_score(planner, 1, pose_at(2), node.landmarks))
    assert event.after == pytest.approx(coverage_score(planner, 1, pose_at(1), node.landmarks))
    assert node.at_waypoint
    assert node.partners == {0, 2}
    assert node.avoid == (pose_at(2),)
    assert node.adopt_pose(1.0, Pose2(2.01, 0.0, 0.01)) == []
    assert asked(node).avoid == (pose_at(2),)
    assert node.waypoint_unreachable(2.0, pose_at(1)) == []


def test_a_waypoint_that_cannot_be_kept() -> None:
    node = make(1)
    (event,) = of(node.waypoint_unreachable(2.0, pose_at(1)), WaypointAbandoned)
    assert (event.abandoned, node.pose, node.at_waypoint) == (pose_at(0), pose_at(1), True)


def test_the_pose_stays_while_a_trade_goes_on() -> None:
    node = make(1)
    asked(node)
    assert node.lock is not Lock.IDLE
    assert node.waypoint_unreachable(2.0, pose_at(1)) == []
    assert node.pose == pose_at(0)


def test_a_pose_that_a_partner_could_not_reach_is_not_proposed_to_it() -> None:
    class Stubborn(Scripted):
        def propose(self, server: AgentState, client: AgentState) -> Proposal | None:
            return Proposal(server.pose, pose_at(2), server.landmarks, client.landmarks)

    planner = Stubborn(TABLE, np.ones(4), pairwise=False)
    client, server = make(0), make(1, planner=planner)
    request = asked(client)
    assert sent(give(make(1, planner=planner), request), Offer)
    assert sent(give(server, replace(request, avoid=(pose_at(2),))), Nothing)


def test_a_proposal_is_judged_by_the_joint_score_or_by_definition_3() -> None:
    weightless = Scripted(TABLE, np.zeros(4), pairwise=False)
    server, client = AgentState(1, pose_at(0), np.array([2, 3])), AgentState(0, pose_at(0), np.array([0, 1]))
    repair = Proposal(pose_at(0), pose_at(0), np.array([0, 3]), np.array([1, 2]))
    assert judge(scripted(), server, client, repair).accepted
    assert judge(weightless, server, client, repair).accepted
    assert not judge(weightless, server, client, replace(repair, client_pose=pose_at(2))).accepted
    same = Proposal(pose_at(0), pose_at(0), server.landmarks, client.landmarks)
    assert not judge(scripted(), server, client, same).accepted
    loses = replace(repair, server_landmarks=np.array([0]), client_landmarks=np.array([1, 2]))
    doubles = replace(repair, server_landmarks=np.array([0, 1, 3]))
    assert not judge(scripted(), server, client, loses).accepted
    assert not judge(scripted(), server, client, doubles).accepted


def test_landmarks_that_are_seen_no_better_than_sigma_stay() -> None:
    class Generous(Scripted):
        def propose(self, server: AgentState, client: AgentState) -> Proposal | None:
            return Proposal(server.pose, client.pose, np.array([3]), np.array([0, 1, 2]))

    table = TABLE.copy()
    table[0, 0, 2] = table[1, 0, 2] - 0.001
    planner = Generous(table, np.ones(4), pairwise=False)
    assert sent(give(make(1, planner=planner), asked(make(0, planner=planner))), Nothing)


def test_a_single_agent_is_quiescent_at_once() -> None:
    records = LandmarkRecords.initial(4, {0: np.arange(4)})
    node = Node(0, [0], records, {0: pose_at(0)}, scripted())
    (publish,) = of(node.start(0.0, RNG), Publish)
    assert publish.heartbeat.quiescent
    assert node.next_deadline() is None


def test_an_order_must_return_its_candidates() -> None:
    node = make(0, order=lambda agent, poses, candidates, rng: [1])
    with pytest.raises(ArgumentError, match=r"order: expected the candidates \[1, 2\], got \[1\]"):
        node.poll(0.0, RNG)


@pytest.mark.parametrize(("agent", "team"), [(3, [0, 1]), (0, [0, 0])])
def test_an_agent_is_in_its_team_once(agent: int, team: list[int]) -> None:
    records = LandmarkRecords.initial(4, {0: np.arange(4)})
    with pytest.raises(ArgumentError, match=f"team: expected agent {agent} once"):
        Node(agent, team, records, {agent: pose_at(0)}, scripted())


def test_an_agent_has_a_pose() -> None:
    records = LandmarkRecords.initial(4, {0: np.arange(4)})
    with pytest.raises(ArgumentError, match="poses: expected the pose of agent 0"):
        Node(0, [0, 1], records, {1: pose_at(0)}, scripted())


def test_options_are_checked() -> None:
    with pytest.raises(ArgumentError, match=r"backoff: expected at least 0, got -1"):
        NodeOptions(backoff=-1.0)
    with pytest.raises(ArgumentError, match="resend_after: expected more than 0"):
        NodeOptions(resend_after=0.0)
