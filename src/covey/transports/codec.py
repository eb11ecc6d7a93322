"""Messages, events and telemetry as bytes, and back.

::

    offset  bytes
    0       2       "cv"
    2       1       version of this format
    3       1       what it is, the number in `LAYOUTS`
    4       16      digest of the mission
    20      8       sender
    28      8       incarnation of the sender
    36      8       to whom; 2^64 - 1: to whoever listens
    44      8       number, which rises with everything that one life of an agent sends
    52      n       the body, field by field
    52 + n  4       CRC-32 of all before

Everything is little-endian.  Whatever is not exactly what `Codec.encode` writes raises `CodecError`.
"""

from __future__ import annotations

import enum
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

from covey.errors import ArgumentError, CodecError, Drop
from covey.protocol import (
    OPERATOR,
    Abort,
    Ack,
    AgentBuried,
    AgentJoined,
    AgentLeft,
    AgentReturned,
    Busy,
    Change,
    Commit,
    Event,
    Heartbeat,
    LandmarksAdopted,
    LandmarksChanged,
    Map,
    Message,
    Nothing,
    Offer,
    OfferDeclined,
    OfferStands,
    PoseOptimized,
    Request,
    Sender,
    TradeCommitted,
    WaypointAbandoned,
)
from covey.protocol.records import difference
from covey.transports.layout import (
    AGENT,
    CATALOGUE,
    CAUSE,
    COUNT,
    DIGEST,
    FLAG,
    FLOAT,
    LANDMARKS,
    LARGEST,
    POSE,
    POSE_RECORD,
    POSE_RECORDS,
    POSES,
    REASON,
    RECORDS,
    SENDER,
    SHARE,
    TALLY,
    TRADE,
    VEHICLE_STATE,
    Kind,
    Reader,
    malformed,
)
from covey.transports.telemetry import Telemetry

MAGIC = b"cv"
VERSION = 2
DIGEST_BYTES = 16
EVERYBODY = 2**64 - 1
"""Addressee of what is published."""
OPERATOR_ON_THE_WIRE = 2**64 - 2
"""The agent `OPERATOR` as sender; only of a `Change`."""

_HEADER = struct.Struct(f"<2sBB{DIGEST_BYTES}sQQQQ")
_CHECKSUM = struct.Struct("<I")

Content: TypeAlias = Message | Event | Telemetry
"""What an envelope can hold."""


@dataclass(frozen=True, slots=True)
class Envelope:
    """What arrived, and from whom.

    Parameters
    ----------
    sender : Sender
    to : int
        An agent, or `EVERYBODY`.
    number : int
        Rises with everything that one life of an agent sends.
    content : Message, Event or Telemetry
    """

    sender: Sender
    to: int
    number: int
    content: Content


class Channel(enum.Enum):
    """How something travels."""

    TRADE = "trade"
    """To one agent."""
    STATE = "state"
    """To whoever listens; the newest wins."""
    LOG = "log"
    """To whoever listens; every one counts."""
    CHANGE = "change"
    """From an operator to all agents."""
    TELEMETRY = "telemetry"
    """To observers alone; the newest wins."""


LATEST = frozenset({Channel.STATE, Channel.TELEMETRY})
"""Where the newest of an agent makes the earlier ones void."""


@dataclass(frozen=True)
class Layout:
    """How one type of message, event or telemetry is laid out.

    Parameters
    ----------
    type : type
        A dataclass; its field `sender`, if it has one, is the envelope's.
    kinds : mapping of str to Kind
        Its other fields, in the order of the bytes.
    channel : Channel
    check : callable, optional
        ``check(content)``: whether the fields go together.
    """

    type: type[Any]
    kinds: Mapping[str, Kind[Any]]
    channel: Channel = Channel.TRADE
    check: Callable[[Any], bool] = lambda content: True


def _is_the_clients(content: Request | Commit | Abort) -> bool:
    return content.trade.client == content.sender.agent


def _offers_its_own(offer: Offer) -> bool:
    own = offer.records.indices
    return not len(difference(offer.give, own)) and len(difference(offer.want, own)) == len(offer.want)


_TRADE: Mapping[str, Kind[Any]] = {"trade": TRADE}
LAYOUTS: Mapping[int, Layout] = {
    1: Layout(
        Request,
        {**_TRADE, "pose": POSE_RECORD, "records": RECORDS, "avoid": POSES},
        check=_is_the_clients,
    ),
    2: Layout(Busy, _TRADE),
    3: Layout(Nothing, {**_TRADE, "pose": POSE_RECORD}),
    4: Layout(
        Offer,
        {
            **_TRADE,
            "pose": POSE_RECORD,
            "records": RECORDS,
            "give": LANDMARKS,
            "want": LANDMARKS,
            "server_pose": POSE,
            "client_pose": POSE,
        },
        check=_offers_its_own,
    ),
    5: Layout(
        Commit,
        {**_TRADE, "records": RECORDS, "server_pose": POSE_RECORD, "client_pose": POSE_RECORD},
        check=_is_the_clients,
    ),
    6: Layout(Abort, {**_TRADE, "reason": REASON}, check=_is_the_clients),
    7: Layout(Ack, _TRADE),
    8: Layout(
        Heartbeat,
        {
            "sequence": COUNT,
            "quiescent": FLAG,
            "epoch": COUNT,
            "pose": POSE_RECORD,
            "committed": TALLY,
            "served": TALLY,
            "digest": DIGEST,
        },
        Channel.STATE,
    ),
    9: Layout(Map, {"records": RECORDS, "poses": POSE_RECORDS, "catalogue": CATALOGUE}),
    10: Layout(Change, {"catalogue": CATALOGUE}, Channel.CHANGE),
    11: Layout(Telemetry, {"state": VEHICLE_STATE, "battery": SHARE}, Channel.TELEMETRY),
    65: Layout(
        PoseOptimized,
        {"agent": AGENT, "pose": POSE, "before": FLOAT, "after": FLOAT, "cause": CAUSE},
        Channel.LOG,
    ),
    66: Layout(
        TradeCommitted,
        {
            **_TRADE,
            "client": AGENT,
            "server": AGENT,
            "client_pose": POSE,
            "server_pose": POSE,
            "client_landmarks": LANDMARKS,
            "server_landmarks": LANDMARKS,
            "moved": COUNT,
            "before": FLOAT,
            "after": FLOAT,
        },
        Channel.LOG,
    ),
    67: Layout(
        WaypointAbandoned,
        {"agent": AGENT, "abandoned": POSE, "held": POSE, "before": FLOAT, "after": FLOAT},
        Channel.LOG,
    ),
    68: Layout(OfferDeclined, {**_TRADE, "client": AGENT, "server": AGENT, "reason": REASON}, Channel.LOG),
    69: Layout(AgentBuried, {"agent": AGENT, "dead": AGENT}, Channel.LOG),
    70: Layout(AgentReturned, {"agent": AGENT, "returned": SENDER}, Channel.LOG),
    71: Layout(LandmarksAdopted, {"agent": AGENT, "records": RECORDS}, Channel.LOG),
    72: Layout(
        LandmarksChanged, {"agent": AGENT, "landmarks": LANDMARKS, "before": FLOAT, "after": FLOAT}, Channel.LOG
    ),
    73: Layout(AgentJoined, {"agent": AGENT, "joined": AGENT}, Channel.LOG),
    74: Layout(AgentLeft, {"agent": AGENT, "left": AGENT}, Channel.LOG),
    75: Layout(
        OfferStands,
        {**_TRADE, "client": AGENT, "server": AGENT, "give": LANDMARKS, "want": LANDMARKS, "stands": FLAG},
        Channel.LOG,
    ),
}
"""Every type by its number on the wire, which never changes: messages and telemetry from 1, events from 65."""

_NUMBERS = {layout.type: number for number, layout in LAYOUTS.items()}
_HAS_SENDER = {layout.type: any(field.name == "sender" for field in fields(layout.type)) for layout in LAYOUTS.values()}


class Codec:
    """Turns the messages, events and telemetry of one mission into bytes and back.

    Parameters
    ----------
    digest : bytes, shape (16,)
        The mission's identity; see `covey.mission.mission_digest`.
    agents, landmarks : int, keyword-only
        How many the mission has.
    more_agents, more_landmarks : int, keyword-only
        How many may join and be added while it runs.
    max_bytes : int, keyword-only
        Nothing longer is written or read.

    Raises
    ------
    ArgumentError
        If the digest has another length or a number is out of range.

    Examples
    --------
    >>> from covey.protocol import TradeId
    >>> codec = Codec(bytes(16), agents=2, landmarks=10)
    >>> data = codec.encode(Busy(Sender(1, 1), TradeId(0, 1, 7)), sender=Sender(1, 1), to=0, number=5)
    >>> len(data), codec.decode(data).content.trade.number
    (80, 7)
    >>> codec.decode(data[:-1])
    Traceback (most recent call last):
    covey.errors.CodecError: malformed: the checksum is wrong
    """

    def __init__(
        self,
        digest: bytes,
        *,
        agents: int,
        landmarks: int,
        more_agents: int = 0,
        more_landmarks: int = 0,
        max_bytes: int = 16 * 2**20,
    ) -> None:
        if len(digest) != DIGEST_BYTES:
            raise ArgumentError(f"digest: expected {DIGEST_BYTES} bytes, got {len(digest)}")
        first, agents, landmarks = landmarks, agents + more_agents, landmarks + more_landmarks
        for name, value in (("agents", agents), ("landmarks", landmarks), ("max_bytes", max_bytes)):
            if not 0 <= value <= LARGEST:
                raise ArgumentError(f"{name}: expected a number in [0, 2^63), got {value}")
        self.digest = digest
        self.agents, self.landmarks, self.max_bytes = agents, landmarks, max_bytes
        self.first_landmarks = first
        """How many landmarks the mission began with; `landmarks` counts those as well that may be added."""

    def encode(self, content: Content, *, sender: Sender, to: int = EVERYBODY, number: int) -> bytes:
        """Return a message, an event or telemetry as bytes.

        Raises
        ------
        ArgumentError
            If it is longer than `max_bytes`, or holds a number that does not fit.
        """
        kind = _NUMBERS[type(content)]
        try:
            agent, incarnation = sender
            if isinstance(content, Change) and agent == OPERATOR:
                agent = OPERATOR_ON_THE_WIRE
            parts = [_HEADER.pack(MAGIC, VERSION, kind, self.digest, agent, incarnation, to, number)]
        except struct.error:
            raise ArgumentError(f"message: expected numbers in [0, 2^64), got {(*sender, to, number)}") from None
        parts += [layout.write(getattr(content, name)) for name, layout in LAYOUTS[kind].kinds.items()]
        data = b"".join(parts)
        if len(data) + _CHECKSUM.size > self.max_bytes:
            raise ArgumentError(f"message: expected at most max_bytes = {self.max_bytes}, got {len(data)}")
        return data + _CHECKSUM.pack(zlib.crc32(data))

    def decode(self, data: bytes) -> Envelope:
        """Return what the bytes say.

        Raises
        ------
        CodecError
            If they are not exactly what `encode` writes for a message of this mission; `CodecError.cause` tells why.
        """
        if len(data) > self.max_bytes:
            raise CodecError(Drop.TOO_LONG, f"expected at most {self.max_bytes} bytes, got {len(data)}")
        if len(data) < _HEADER.size + _CHECKSUM.size:
            malformed(f"expected at least {_HEADER.size + _CHECKSUM.size} bytes, got {len(data)}")
        magic, version, kind, digest, agent, incarnation, to, number = _HEADER.unpack_from(data)
        if magic != MAGIC:
            malformed("it does not begin as a message does")
        if version != VERSION:
            raise CodecError(Drop.VERSION, f"expected version {VERSION}, got {version}")
        if _CHECKSUM.unpack_from(data, len(data) - _CHECKSUM.size)[0] != zlib.crc32(data[: -_CHECKSUM.size]):
            malformed("the checksum is wrong")
        if digest != self.digest:
            raise CodecError(Drop.MISSION, f"expected mission {self.digest.hex()}, got {digest.hex()}")
        if kind == _NUMBERS[Change]:
            agent = OPERATOR if agent == OPERATOR_ON_THE_WIRE else self.agents  # nobody else may send one
        if agent >= self.agents or incarnation > LARGEST or number > LARGEST:
            malformed(f"expected a sender in [0, {self.agents}), got {agent} in its life {incarnation}, {number}")
        if kind not in LAYOUTS:
            malformed(f"expected a known type, got {kind}")
        sender = Sender(agent, incarnation)
        layout = LAYOUTS[kind]
        reader = Reader(data[_HEADER.size : -_CHECKSUM.size], agents=self.agents, landmarks=self.landmarks)
        values = {name: field.read(reader) for name, field in layout.kinds.items()}
        reader.finish()
        if _HAS_SENDER[layout.type]:
            values["sender"] = sender
        content = layout.type(**values)
        if not layout.check(content):
            malformed(f"the fields of this {layout.type.__name__} do not go together")
        return Envelope(sender, to, number, content)


__all__ = ["EVERYBODY", "LATEST", "LAYOUTS", "VERSION", "Channel", "Codec", "Content", "Envelope", "Layout"]
