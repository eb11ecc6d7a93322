"""Lives, silences, adoption and restarts of single nodes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

import numpy as np
import pytest

from covey.errors import ArgumentError
from covey.faults.table import TablePlanner, pose_at
from covey.protocol import (
    Ack,
    Adopt,
    AgentBuried,
    AgentReturned,
    Commit,
    GoTo,
    LandmarkRecords,
    LandmarksAdopted,
    Links,
    Lock,
    Map,
    MembershipOptions,
    Message,
    Node,
    NodeOptions,
    Nothing,
    Offer,
    Output,
    Publish,
    Request,
    Send,
    Status,
    between,
    within,
)

T = TypeVar("T")
RNG = np.random.default_rng(0)
DEAD_AFTER = 4.0

# Agent 0 sees landmarks 1 and 2 best, agent 1 sees 0 and 3 best, agent 2 is second everywhere.
TABLE = np.array([[[0.2, 0.8, 0.8, 0.1]], [[0.8, 0.1, 0.2, 0.8]], [[0.5, 0.5, 0.5, 0.5]]])
PARTITION = {0: [0, 1], 1: [2, 3], 2: []}


def make(agent: int, *, adopt: Adopt = Adopt.ALL, links: Links | None = None) -> Node:
    records = LandmarkRecords.initial(4, {a: np.array(ks, dtype=np.int64) for a, ks in PARTITION.items()})
    node = Node(
        agent,
        [0, 1, 2],
        records,
        {a: pose_at(0) for a in PARTITION},
        planner(),
        order=lambda a, p, candidates, rng: candidates,
        options=options(adopt),
        links=links,
    )
    node.start(0.0, RNG)
    return node


def planner() -> TablePlanner:
    return TablePlanner(TABLE, np.ones(4), pairwise=False)


def options(adopt: Adopt = Adopt.ALL) -> NodeOptions:
    membership = MembershipOptions(heartbeat_every=1.0, dead_after=DEAD_AFTER, map_every=1.0, adopt=adopt)
    return NodeOptions(backoff=0.0, pause=0.0, membership=membership)


def sent(outputs: Iterable[Output], kind: type[T]) -> list[T]:
    return [out.message for out in outputs if isinstance(out, Send) and isinstance(out.message, kind)]


def of(outputs: Iterable[Output], kind: type[T]) -> list[T]:
    return [output for output in outputs if isinstance(output, kind)]


def give(node: Node, message: Message, now: float = 0.0) -> list[Output]:
    return node.receive(now, message, RNG)


def map_of(node: Node) -> Map:
    return Map(node.sender, node.records.all(), node.poses.as_mapping())


def prepared() -> tuple[Node, Node, Offer]:
    """A client that has asked, and a server that holds landmark 2 in escrow for landmark 0."""
    client, server = make(0), make(1)
    (request,) = sent(client.poll(0.0, RNG), Request)
    (offer,) = sent(give(server, request), Offer)
    return client, server, offer


def test_silence_is_suspect_and_then_death() -> None:
    node = make(0)
    give(node, make(1).heartbeat(), 1.0)
    node.poll(2.5, RNG)
    assert (node.status(1), node.status(2)) == (Status.ALIVE, Status.SUSPECT)
    outputs = node.poll(DEAD_AFTER, RNG)
    assert [event.dead for event in of(outputs, AgentBuried)] == [2]
    assert 2 not in node.partners
    assert of(give(node, make(2).heartbeat(), 5.0), AgentReturned)[0].returned == (2, 1)
    assert 2 in node.partners


def test_a_lost_connection_makes_suspect_until_the_next_word() -> None:
    node = make(0)
    node.suspect(1)
    assert node.status(1) is Status.SUSPECT
    assert [out.to for out in of(node.poll(0.5, RNG), Send) if isinstance(out.message, Request)] == [2]
    give(node, make(1).heartbeat(), 0.6)
    assert node.status(1) is Status.ALIVE


def test_heartbeats_and_maps_come_when_due() -> None:
    node = make(0)
    outputs = node.poll(1.0, RNG)
    assert len(of(outputs, Publish)) == 1
    assert len(sent(outputs, Map)) == 1
    assert (node.next_deadline() or 0.0) <= 2.0


def test_the_landmarks_of_the_dead_go_to_who_sees_them_best() -> None:
    nodes = [make(0), make(2)]
    for node, other in (nodes, nodes[::-1]):
        give(node, map_of(other), 0.0)
    adopted = {node.agent: of(node.bury(0.0, 1), LandmarksAdopted) for node in nodes}
    assert [event.records.indices.tolist() for event in adopted[0]] == [[2]]
    assert [event.records.indices.tolist() for event in adopted[2]] == [[3]]
    assert adopted[0][0].records.values.tolist() == [[2, 0, 0, 1]]
    for node, other in (nodes, nodes[::-1]):
        give(node, map_of(other))
    assert nodes[0].records.values.tolist() == nodes[1].records.values.tolist()


def test_nobody_adopts_before_it_has_heard_what_the_others_know() -> None:
    node = make(0)
    assert not of(node.bury(0.0, 1), LandmarksAdopted)
    assert not node.quiescent
    assert of(give(node, map_of(make(2))), LandmarksAdopted)


def test_a_minority_declares_nobody_dead_where_the_majority_decides() -> None:
    node = make(0, adopt=Adopt.MAJORITY)
    assert not of(node.poll(DEAD_AFTER, RNG), AgentBuried)
    give(node, make(1).heartbeat(), DEAD_AFTER)
    assert [event.dead for event in of(node.poll(2.0 * DEAD_AFTER - 1.0, RNG), AgentBuried)] == [2]


def test_who_was_buried_yields_what_was_adopted() -> None:
    buried, adopter = make(1), make(0)
    give(adopter, map_of(make(2)))
    adopter.bury(0.0, 1)
    assert give(buried, map_of(adopter)) is not None
    assert buried.landmarks.tolist() == [3]
    assert 0 in buried.partners


def test_a_server_takes_back_what_it_offered_to_the_dead() -> None:
    client, server, offer = prepared()
    outputs = server.bury(0.0, 0)
    assert server.lock is Lock.IDLE
    assert server.escrow is None
    assert of(outputs, LandmarksAdopted)[0].records.values.tolist() == [[2, 0, 1, 1]]
    (commit,) = sent(give(client, offer), Commit)
    assert sent(give(server, commit), Ack)
    assert server.landmarks.tolist() == [0, 2, 3]
    assert server.poses[1].generation == 2
    give(client, map_of(server))
    assert client.landmarks.tolist() == [1]


def test_a_new_life_of_the_client_ends_the_trade_of_the_old() -> None:
    client, server, offer = prepared()
    (commit,) = sent(give(client, offer), Commit)
    again = Node.restart(0, [0, 1, 2], client.memory(), planner(), incarnation=2, options=options())
    give(server, again.heartbeat())
    assert server.lock is Lock.IDLE
    assert not sent(give(server, commit), Ack)
    assert 0 not in server.landmarks


def test_a_commit_reaches_a_server_without_memory() -> None:
    client, _, offer = prepared()
    (commit,) = sent(give(client, offer), Commit)
    server = Node(
        1, [0, 1, 2], LandmarkRecords.unknown(4), {1: pose_at(0)}, planner(), incarnation=2, options=options()
    )
    server.start(0.0, RNG)
    (ack,) = sent(give(server, commit), Ack)
    assert server.records.values[2].tolist() == [1, 1, 0, 1]
    assert len(server.landmarks) == 0
    give(client, ack)
    assert client.lock is Lock.IDLE


def test_a_client_keeps_the_commit_for_a_server_that_comes_back() -> None:
    client, server, offer = prepared()
    give(client, offer)
    client.bury(0.0, 1)
    assert client.lock is Lock.IDLE
    assert len(sent(give(client, offer), Commit)) == 1
    assert client.lock is Lock.IDLE
    client.suspect(2)
    (commit,) = sent(client.poll(0.5, RNG), Commit)
    (ack,) = sent(give(server, commit, 0.5), Ack)
    give(client, ack, 0.5)
    assert client.lock is Lock.IDLE
    assert not sent(give(client, offer, 0.5), Commit)


def test_a_restarted_agent_goes_to_the_pose_it_remembers_and_owns_nothing_yet() -> None:
    again = Node.restart(0, [0, 1, 2], make(0).memory(), planner(), incarnation=2, options=options())
    outputs = again.start(10.0, RNG)
    assert [output.pose for output in of(outputs, GoTo)] == [pose_at(0)]
    assert len(again.landmarks) == 0
    assert not again.quiescent


def test_agents_out_of_reach_do_not_trade() -> None:
    assert make(0, links=within(0.0)).poll(0.0, RNG)
    far = make(0, links=between([]))
    assert not sent(far.poll(0.0, RNG), Request)
    assert far.quiescent
    (request,) = sent(make(1).poll(0.0, RNG), Request)
    assert sent(give(far, request), Nothing)


def test_links_need_heartbeats() -> None:
    records = LandmarkRecords.initial(1, {0: np.array([0])})
    with pytest.raises(ArgumentError, match="links"):
        Node(0, [0], records, {0: pose_at(0)}, planner(), links=within(1.0))


def test_times_are_checked() -> None:
    with pytest.raises(ArgumentError, match="dead_after"):
        MembershipOptions(heartbeat_every=1.0, dead_after=2.9)
    with pytest.raises(ArgumentError, match="map_every"):
        MembershipOptions(map_every=0.0)
