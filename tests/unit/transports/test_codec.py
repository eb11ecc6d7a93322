"""The codec, by hand: what it refuses and why, how long messages are, and that the table is complete."""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import fields
from typing import get_args

import numpy as np
import pytest
from tests.contents import AGENTS, CODEC, DIGEST, LANDMARKS, array, telemetry

from covey.errors import ArgumentError, CodecError, Drop
from covey.flight.layout import OBSERVATION, QUAT
from covey.geometry import Pose2
from covey.protocol import (
    OPERATOR,
    Abort,
    Ack,
    AgentChange,
    Busy,
    Catalogue,
    Change,
    Commit,
    Event,
    Heartbeat,
    LandmarkChange,
    Message,
    Nothing,
    Offer,
    PoseRecord,
    Reason,
    RecordSlice,
    Request,
    Sender,
    TradeId,
)
from covey.transports.codec import LAYOUTS, Channel, Codec, Content
from covey.transports.telemetry import Telemetry

SENDER = Sender(1, 3)
TRADE = TradeId(1, 3, 9)
HERE = Pose2(1.0, 2.0, 0.5)
POSE = PoseRecord(1, 4, HERE)
NAN = struct.pack("<d", math.nan)


def records(*landmarks: int, owner: int = 1) -> RecordSlice:
    """Records of some landmarks."""
    return RecordSlice(array(*landmarks), np.tile(np.array([1, 7, owner, 3], dtype=np.int64), (len(landmarks), 1)))


def offer(give: tuple[int, ...], want: tuple[int, ...]) -> Offer:
    return Offer(SENDER, TRADE, POSE, records(2, 3, 5), array(*give), array(*want), HERE, HERE)


def encode(content: Content, codec: Codec = CODEC) -> bytes:
    return codec.encode(content, sender=SENDER, to=0, number=1)


def replaced(data: bytes, old: bytes, new: bytes) -> bytes:
    """The bytes with one part of the body exchanged, and a right checksum."""
    assert data[52:-4].count(old) >= 1
    body = data[:52] + data[52:-4].replace(old, new, 1)
    return body + struct.pack("<I", zlib.crc32(body))


def cause_of(data: bytes, codec: Codec = CODEC) -> Drop:
    with pytest.raises(CodecError) as raised:
        codec.decode(data)
    return raised.value.cause


def test_every_message_and_event_is_in_the_table() -> None:
    table = {layout.type: layout for layout in LAYOUTS.values()}
    assert set(table) == {*get_args(Message), *get_args(Event), Telemetry}
    for kind, layout in table.items():
        assert list(layout.kinds) == [field.name for field in fields(kind) if field.name != "sender"], kind.__name__


def test_messages_and_events_have_numbers_and_channels_of_their_own() -> None:
    for number, layout in LAYOUTS.items():
        if layout.type in get_args(Event):
            assert (number >= 65, layout.channel) == (True, Channel.LOG)
        else:
            assert (number < 65, layout.channel is Channel.STATE) == (True, layout.type is Heartbeat)
            assert (layout.channel is Channel.TELEMETRY) == (layout.type is Telemetry)


def test_a_record_takes_few_bytes() -> None:
    empty = len(encode(Request(SENDER, TRADE, POSE, records())))
    full = len(encode(Request(SENDER, TRADE, POSE, records(*range(100)))))
    assert full - empty == 5 * 100


def test_a_message_too_long_is_not_written_nor_read() -> None:
    small = Codec(DIGEST, agents=AGENTS, landmarks=LANDMARKS, max_bytes=200)
    message = Request(SENDER, TRADE, POSE, records(*range(100)))
    with pytest.raises(ArgumentError, match="at most max_bytes = 200"):
        encode(message, small)
    assert cause_of(encode(message), small) is Drop.TOO_LONG


def test_offers_must_give_their_own_and_want_the_others() -> None:
    content = CODEC.decode(encode(offer((2, 5), (7,)))).content
    assert isinstance(content, Offer)
    assert content.give.tolist() == [2, 5]
    assert cause_of(encode(offer((2, 4), (7,)))) is Drop.MALFORMED
    assert cause_of(encode(offer((2,), (5,)))) is Drop.MALFORMED


@pytest.mark.parametrize(
    "content",
    [
        Request(SENDER, TradeId(0, 3, 9), POSE, records()),
        Commit(SENDER, TradeId(0, 3, 9), records(), POSE, POSE),
        Abort(SENDER, TradeId(0, 3, 9), Reason.STALE),
        Request(SENDER, TRADE, POSE, records(3, 2)),
        Request(SENDER, TRADE, POSE, records(2, 2)),
        Request(SENDER, TRADE, POSE, records(0, LANDMARKS)),
        Request(SENDER, TRADE, POSE, records(0, owner=AGENTS)),
        Busy(SENDER, TradeId(AGENTS, 3, 9)),
        Heartbeat(SENDER, 1, True, 1, POSE, {AGENTS: 1}, {}),
    ],
    ids=lambda content: type(content).__name__,
)
def test_what_no_agent_would_say_is_refused(content: Content) -> None:
    assert cause_of(encode(content)) is Drop.MALFORMED


@pytest.mark.parametrize("wrong", [NAN, struct.pack("<d", math.inf), struct.pack("<d", -math.inf)])
@pytest.mark.parametrize("right", [1.0, 2.0, 0.5])
def test_poses_must_be_finite(wrong: bytes, right: float) -> None:
    assert cause_of(replaced(encode(Nothing(SENDER, TRADE, POSE)), struct.pack("<d", right), wrong)) is Drop.MALFORMED


def test_a_yaw_must_be_wrapped() -> None:
    data = replaced(encode(Nothing(SENDER, TRADE, POSE)), struct.pack("<d", 0.5), struct.pack("<d", 4.0))
    assert cause_of(data) is Drop.MALFORMED


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -2e9])
@pytest.mark.parametrize("column", range(OBSERVATION))
def test_a_vehicle_must_be_somewhere(column: int, wrong: float) -> None:
    report = telemetry()
    report.state[column] = wrong
    assert cause_of(encode(report)) is Drop.MALFORMED


@pytest.mark.parametrize("scale", [0.0, 0.99, 1.01])
def test_an_attitude_must_be_a_rotation(scale: float) -> None:
    report = telemetry()
    report.state[QUAT : QUAT + 4] *= scale
    assert cause_of(encode(report)) is Drop.MALFORMED


@pytest.mark.parametrize("battery", [-0.01, 1.01, math.inf, -math.inf])
def test_no_battery_holds_more_than_all_or_less_than_nothing(battery: float) -> None:
    assert cause_of(encode(telemetry(battery=battery))) is Drop.MALFORMED


@pytest.mark.parametrize("length", [2**31, 2**62, 2**63, 2**64 - 1])
def test_a_huge_length_is_refused_at_once(length: int) -> None:
    data = encode(Request(SENDER, TRADE, POSE, records(*range(100))))
    assert cause_of(replaced(data, struct.pack("<Q", 100), struct.pack("<Q", length))) is Drop.MALFORMED


@pytest.mark.parametrize("sender", [(AGENTS, 1), (2**63, 1), (0, 2**63)])
def test_a_sender_must_be_of_the_team(sender: tuple[int, int]) -> None:
    data = CODEC.encode(Ack(SENDER, TRADE), sender=Sender(*sender), number=1)
    assert cause_of(data) is Drop.MALFORMED


def test_numbers_that_do_not_fit_are_the_callers_mistake() -> None:
    with pytest.raises(ArgumentError, match="2\\^63"):
        encode(Busy(SENDER, TradeId(1, 3, -1)))
    with pytest.raises(ArgumentError, match="2\\^64"):
        CODEC.encode(Busy(SENDER, TRADE), sender=SENDER, number=-1)
    with pytest.raises(ArgumentError, match="at least 0"):
        encode(Request(SENDER, TRADE, POSE, records(-1)))


@pytest.mark.parametrize("arguments", [(bytes(15), 1, 1, 1), (bytes(16), -1, 1, 1), (bytes(16), 1, 2**63, 1)])
def test_a_codec_checks_its_arguments(arguments: tuple[bytes, int, int, int]) -> None:
    digest, agents, landmarks, max_bytes = arguments
    with pytest.raises(ArgumentError):
        Codec(digest, agents=agents, landmarks=landmarks, max_bytes=max_bytes)


def test_only_an_operator_announces_changes() -> None:
    change = Change(Sender(OPERATOR, 1), Catalogue(agents={1: AgentChange(1, False)}))
    came = CODEC.decode(CODEC.encode(change, sender=change.sender, number=1)).content
    assert isinstance(came, Change)
    assert (came.sender, came.catalogue) == (change.sender, change.catalogue)
    with pytest.raises(CodecError):
        CODEC.decode(CODEC.encode(change, sender=Sender(0, 1), number=1))
    with pytest.raises(ArgumentError):
        CODEC.encode(Ack(Sender(OPERATOR, 1), TradeId(0, 1, 1)), sender=Sender(OPERATOR, 1), number=1)


def test_a_mission_may_grow_within_limits() -> None:
    grown = Codec(bytes(16), agents=2, landmarks=3, more_agents=1, more_landmarks=2)
    for agent, landmark, fits in ((2, 4, True), (3, 4, False), (2, 5, False)):
        news = Catalogue({landmark: LandmarkChange(1, True, 1.0, 0.0, 0.0)}, {agent: AgentChange(1, True, "{}")})
        data = grown.encode(Change(Sender(OPERATOR, 1), news), sender=Sender(OPERATOR, 1), number=1)
        if fits:
            content = grown.decode(data).content
            assert isinstance(content, Change)
            assert content.catalogue == news
        else:
            with pytest.raises(CodecError):
                grown.decode(data)


def test_what_describes_an_agent_has_a_longest_length() -> None:
    news = Catalogue(agents={1: AgentChange(1, True, "x" * 70_000)})
    with pytest.raises(ArgumentError, match="text"):
        CODEC.encode(Change(Sender(OPERATOR, 1), news), sender=Sender(OPERATOR, 1), number=1)
