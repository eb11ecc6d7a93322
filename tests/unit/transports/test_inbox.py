"""The inbox of a real transport: what is handed out, what is dropped, and what is counted."""

from __future__ import annotations

import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.contents import AGENTS, CODEC, LANDMARKS, telemetry

from covey.errors import ArgumentError, Drop
from covey.geometry import Pose2
from covey.protocol import (
    OPERATOR,
    Busy,
    Catalogue,
    Change,
    Heartbeat,
    LandmarkChange,
    OfferDeclined,
    PoseRecord,
    Reason,
    Sender,
    TradeId,
)
from covey.transports.codec import EVERYBODY, Channel, Codec, Content
from covey.transports.inbox import MOST_OPERATORS, WINDOW, Arrival, Inbox, ReplayGuard
from covey.transports.telemetry import Telemetry


def busy(number: int, agent: int = 1) -> Busy:
    return Busy(Sender(agent, 1), TradeId(0, 1, number))


def beat(sequence: int, *, agent: int = 1, incarnation: int = 1) -> Heartbeat:
    pose = PoseRecord(1, 1, Pose2(0.0, 0.0, 0.0))
    return Heartbeat(Sender(agent, incarnation), sequence, True, 1, pose, {}, {})


def arrival(
    content: Content, number: int, *, to: int = 0, key: int = 1, channel: Channel = Channel.TRADE, incarnation: int = 1
) -> Arrival:
    """Something from agent 1 by the key of some agent."""
    data = CODEC.encode(content, sender=Sender(1, incarnation), to=to, number=number)
    return Arrival(data, key, channel)


def state(sequence: int, number: int, *, incarnation: int = 1) -> Arrival:
    content = beat(sequence, incarnation=incarnation)
    return arrival(content, number, to=EVERYBODY, channel=Channel.STATE, incarnation=incarnation)


@pytest.fixture
def inbox() -> Inbox:
    return Inbox(CODEC, 0)


def test_each_message_is_handed_out_once_and_in_order(inbox: Inbox) -> None:
    for number in (4, 2, 9):
        inbox.put(arrival(busy(number), number))
    assert inbox.take() == [busy(4), busy(2), busy(9)]
    assert inbox.take() == []
    assert inbox.dropped == {}


def test_a_message_that_was_here_before_is_dropped(inbox: Inbox) -> None:
    inbox.put(arrival(busy(1), 7))
    assert len(inbox.take()) == 1
    for number in (7, 7, 8):
        inbox.put(arrival(busy(1), number))
    assert len(inbox.take()) == 1
    assert inbox.dropped == {Drop.REPLAYED: 2}


def test_an_earlier_life_is_dropped(inbox: Inbox) -> None:
    for incarnation, number in ((2, 1), (1, 50), (2, 2)):
        inbox.put(arrival(busy(number), number, incarnation=incarnation))
    assert [content.trade.number for content in inbox.take() if isinstance(content, Busy)] == [1, 2]
    assert inbox.dropped == {Drop.REPLAYED: 1}


def test_of_heartbeats_only_the_newest_is_handed_out(inbox: Inbox) -> None:
    for sequence, number in ((1, 1), (3, 3), (2, 2)):
        inbox.put(state(sequence, number))
    inbox.put(arrival(busy(1), 9))
    first, second = inbox.take()
    assert isinstance(first, Heartbeat)
    assert (first.sequence, second) == (3, busy(1))
    inbox.put(state(1, 30, incarnation=2))
    restarted = inbox.take()[0]
    assert isinstance(restarted, Heartbeat)
    assert restarted.sequence == 1
    assert inbox.dropped == {Drop.OUTDATED: 2}


def test_what_comes_by_a_way_not_its_own_is_dropped(inbox: Inbox) -> None:
    declined = OfferDeclined(TradeId(0, 1, 1), 0, 1, Reason.STALE)
    inbox.put(arrival(busy(1), 1, key=2))
    inbox.put(arrival(busy(1), 2, to=3))
    inbox.put(arrival(busy(1), 3, to=EVERYBODY))
    inbox.put(arrival(busy(1), 4, to=EVERYBODY, channel=Channel.STATE))
    inbox.put(arrival(beat(1), 5))
    inbox.put(arrival(declined, 6))
    assert inbox.take() == []
    assert inbox.dropped == {Drop.IMPOSTOR: 6}


def change(life: int, number: int, *, key: int = OPERATOR, channel: Channel = Channel.CHANGE) -> Arrival:
    news = Catalogue({1: LandmarkChange(life, True, 2.0, 0.0, 0.0)})
    content = Change(Sender(OPERATOR, life), news)
    return Arrival(CODEC.encode(content, sender=content.sender, number=number), key, channel)


def test_a_change_comes_by_its_own_way_alone_and_each_operator_counts_for_itself(inbox: Inbox) -> None:
    for arrived in (change(7, 1), change(5, 1), change(7, 2), change(7, 2), change(5, 1)):
        inbox.put(arrived)
    heard = [content for content in inbox.take() if isinstance(content, Change)]
    assert [content.sender.incarnation for content in heard] == [7, 5, 7]
    assert inbox.dropped == {Drop.REPLAYED: 2}
    inbox.put(change(9, 1, key=1, channel=Channel.STATE))
    inbox.put(change(9, 2, key=1))
    inbox.put(arrival(busy(1), 1, to=EVERYBODY, key=OPERATOR, channel=Channel.CHANGE))
    assert inbox.take() == []
    assert inbox.dropped[Drop.IMPOSTOR] == 3


def report(number: int, *, key: int = 1, incarnation: int = 1, channel: Channel = Channel.TELEMETRY) -> Arrival:
    content = telemetry(x=float(number), incarnation=incarnation)
    return arrival(content, number, to=EVERYBODY, key=key, channel=channel, incarnation=incarnation)


def places(inbox: Inbox) -> list[float]:
    return [float(content.state[0]) for content in inbox.take() if isinstance(content, Telemetry)]


def test_of_the_reports_of_a_vehicle_the_newest_counts(inbox: Inbox) -> None:
    for number in (3, 1, 5, 4):
        inbox.put(report(number))
    inbox.put(state(9, 6))  # the two have nothing to do with each other
    assert [type(content) for content in inbox.take()] == [Telemetry, Heartbeat]
    assert inbox.dropped == {Drop.OUTDATED: 3}
    inbox.put(report(2))
    inbox.put(report(5))
    assert places(inbox) == []
    assert inbox.dropped == {Drop.OUTDATED: 4, Drop.REPLAYED: 1}
    inbox.put(report(1, incarnation=2))
    inbox.put(report(7, incarnation=1))
    assert places(inbox) == [1.0]
    assert inbox.dropped == {Drop.OUTDATED: 4, Drop.REPLAYED: 2}


def test_a_report_counts_only_by_the_key_of_its_agent_and_its_own_way(inbox: Inbox) -> None:
    for number, wrong in enumerate(
        [
            report(1, key=2),
            report(2, channel=Channel.STATE),
            report(3, channel=Channel.LOG),
            arrival(beat(1), 4, to=EVERYBODY, channel=Channel.TELEMETRY),
        ],
        start=1,
    ):
        inbox.put(wrong)
        assert inbox.take() == []
        assert inbox.dropped == {Drop.IMPOSTOR: number}


def test_only_so_many_operators_are_told_apart(inbox: Inbox) -> None:
    for life in range(MOST_OPERATORS + 1):
        inbox.put(change(life, 1))
    assert len(inbox.take()) == MOST_OPERATORS + 1
    inbox.put(change(MOST_OPERATORS, 1))
    assert inbox.take() == []
    inbox.put(change(0, 1))  # long forgotten; to hear the same again changes nothing
    assert len(inbox.take()) == 1


def test_garbage_and_strangers_are_dropped_and_counted(inbox: Inbox) -> None:
    stranger = Codec(bytes(16), agents=AGENTS, landmarks=LANDMARKS)
    inbox.put(Arrival(b"garbage", 1, Channel.TRADE))
    inbox.put(Arrival(b"", 1, Channel.STATE))
    inbox.put(Arrival(stranger.encode(busy(1), sender=Sender(1, 1), to=0, number=1), 1, Channel.TRADE))
    inbox.put(arrival(busy(1), 1))
    assert inbox.take() == [busy(1)]
    assert inbox.dropped == {Drop.MALFORMED: 2, Drop.MISSION: 1}


def test_what_becomes_of_an_arrival_is_told_once() -> None:
    inbox = Inbox(CODEC, 0, capacity=3)
    told: list[tuple[int, bool]] = []

    def put(number: int, data: bytes) -> None:
        inbox.put(Arrival(data, 1, Channel.TRADE, lambda accepted: told.append((number, accepted))))

    put(0, arrival(busy(0), 1).data)
    put(1, b"garbage")
    put(2, arrival(busy(0), 1).data)
    put(3, arrival(busy(0), 4).data)
    assert told == [(3, False)]
    inbox.take()
    assert told == [(3, False), (0, True), (1, False), (2, False)]
    put(4, arrival(busy(0), 5).data)
    inbox.close()
    put(5, arrival(busy(0), 6).data)
    assert told[4:] == [(4, False), (5, False)]
    assert inbox.take() == []
    assert inbox.dropped == {Drop.FULL: 1, Drop.MALFORMED: 1, Drop.REPLAYED: 1}


def test_only_so_many_bytes_may_wait() -> None:
    inbox = Inbox(Codec(CODEC.digest, agents=AGENTS, landmarks=LANDMARKS, max_bytes=100), 0)
    for _ in range(6):
        inbox.put(Arrival(bytes(80), 1, Channel.TRADE))
    assert inbox.dropped == {Drop.FULL: 1}


def test_a_capacity_of_nothing_is_refused() -> None:
    with pytest.raises(ArgumentError, match="capacity"):
        Inbox(CODEC, 0, capacity=0)


def test_waiting_ends_when_something_comes_or_the_inbox_closes(inbox: Inbox) -> None:
    assert not inbox.wait(0.0)
    timers = [
        threading.Timer(0.05, inbox.put, [arrival(busy(1), 1)]),
        threading.Timer(0.05, inbox.close),
    ]
    timers[0].start()
    assert inbox.wait(60.0)
    inbox.take()
    timers[1].start()
    assert not inbox.wait(60.0)
    for timer in timers:
        timer.join()


def test_many_threads_put_and_take_and_each_message_is_handed_out_once(inbox: Inbox) -> None:
    arrivals = [arrival(busy(number), number) for number in range(800)]
    got: list[Content] = []
    done = threading.Event()

    def take() -> None:
        while not done.is_set():
            got.extend(inbox.take())
            time.sleep(0)

    def put(part: list[Arrival]) -> None:
        for one in part:
            inbox.put(one)

    takers = [threading.Thread(target=take) for _ in range(2)]
    putters = [threading.Thread(target=put, args=[arrivals[start::4]]) for start in range(4)]
    for thread in (*takers, *putters):
        thread.start()
    for thread in putters:
        thread.join()
    done.set()
    for thread in takers:
        thread.join()
    got.extend(inbox.take())
    assert sorted(content.trade.number for content in got if isinstance(content, Busy)) == list(range(800))


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 3 * WINDOW)), max_size=60))
def test_a_guard_lets_each_number_of_the_newest_life_pass_once(arrivals: list[tuple[int, int]]) -> None:
    guard = ReplayGuard()
    seen: set[tuple[int, int]] = set()
    newest, highest = -1, -1
    for incarnation, number in arrivals:
        if incarnation > newest:
            newest, highest = incarnation, -1
        fresh = (incarnation, number) not in seen and number > highest - WINDOW
        assert guard.passes(incarnation, number) == (incarnation == newest and fresh)
        if incarnation == newest:
            seen.add((incarnation, number))
            highest = max(highest, number)
