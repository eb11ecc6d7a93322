"""How each kind of value is laid out in bytes: little-endian, nothing left to chance, everything checked on reading.

A `Kind` writes a value and reads it back; `covey.transports.codec` composes messages of them.  A reader raises
`CodecError` for anything that no writer would have written.
"""

from __future__ import annotations

import enum
import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Generic, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError, CodecError, Drop
from covey.flight.layout import OBSERVATION, QUAT
from covey.geometry import Pose2
from covey.protocol import (
    EMPTY,
    AgentChange,
    Catalogue,
    Cause,
    LandmarkChange,
    PoseRecord,
    Reason,
    RecordSlice,
    Sender,
    TradeId,
)
from covey.protocol.records import OWNER

_T = TypeVar("_T")
_E = TypeVar("_E", bound=enum.Enum)

LONGEST_BLOB = 255
LONGEST_TEXT = 65_536
LARGEST = 2**63 - 1
"""The largest number on the wire; what an int64 holds."""

LARGEST_STATE = 1e9
"""Metres, m/s and rad/s beyond which nobody flies; sums of their squares are still numbers."""

NOT_UNIT = 1e-3
"""How far the norm of a unit quaternion may be off."""

_WIDTHS = tuple(np.dtype(name) for name in ("<u1", "<u2", "<u4", "<u8"))
_POSE = struct.Struct("<3d")
_LANDMARK = struct.Struct("<5d")
_STATE = struct.Struct(f"<{OBSERVATION}d")


class Reader:
    """Takes a message apart from its beginning.

    Parameters
    ----------
    data : bytes
    agents, landmarks : int
        How many there are: the bounds of what names one.
    """

    def __init__(self, data: bytes, *, agents: int, landmarks: int) -> None:
        self.agents, self.landmarks = agents, landmarks
        self._data = data
        self._at = 0

    def take(self, size: int) -> bytes:
        """Return the next bytes."""
        if size > len(self._data) - self._at:
            malformed(f"expected {size} bytes more, got {len(self._data) - self._at}")
        self._at += size
        return self._data[self._at - size : self._at]

    def unpack(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Return the next numbers."""
        return layout.unpack(self.take(layout.size))

    def finish(self) -> None:
        """Require that nothing is left."""
        if self._at != len(self._data):
            malformed(f"expected the end, got {len(self._data) - self._at} bytes more")


def malformed(text: str) -> NoReturn:
    """Raise the error of a message that no writer would have written."""
    raise CodecError(Drop.MALFORMED, text)


@dataclass(frozen=True)
class Kind(Generic[_T]):
    """One kind of value.

    Parameters
    ----------
    write : callable
        ``write(value)``: its bytes.
    read : callable
        ``read(reader)``: the value; raises `CodecError` when there is none.
    """

    write: Callable[[_T], bytes]
    read: Callable[[Reader], _T]


# Numbers.

_COUNT = struct.Struct("<Q")
_FLOAT = struct.Struct("<d")
_BYTE = struct.Struct("<B")


def _write_count(value: int) -> bytes:
    if not 0 <= value <= LARGEST:
        raise ArgumentError(f"message: expected numbers in [0, 2^63), got {value}")
    return _COUNT.pack(value)


def _read_count(reader: Reader) -> int:
    value: int = reader.unpack(_COUNT)[0]
    if value > LARGEST:
        malformed(f"expected a number in [0, 2^63), got {value}")
    return value


def _read_agent(reader: Reader) -> int:
    agent = _read_count(reader)
    if agent >= reader.agents:
        malformed(f"expected an agent in [0, {reader.agents}), got {agent}")
    return agent


def _read_flag(reader: Reader) -> bool:
    value: int = reader.unpack(_BYTE)[0]
    if value > 1:
        malformed(f"expected 0 or 1, got {value}")
    return bool(value)


def _read_float(reader: Reader) -> float:
    value: float = reader.unpack(_FLOAT)[0]
    if not math.isfinite(value):
        malformed(f"expected a finite number, got {value}")
    return value


def _read_share(reader: Reader) -> float:
    value: float = reader.unpack(_FLOAT)[0]
    if not (math.isnan(value) or 0.0 <= value <= 1.0):
        malformed(f"expected a share from 0 to 1, or NaN, got {value}")
    return value


COUNT: Kind[int] = Kind(_write_count, _read_count)
AGENT: Kind[int] = Kind(_write_count, _read_agent)
FLAG: Kind[bool] = Kind(lambda value: _BYTE.pack(value), _read_flag)
FLOAT: Kind[float] = Kind(lambda value: _FLOAT.pack(value), _read_float)
SHARE: Kind[float] = Kind(lambda value: _FLOAT.pack(value), _read_share)


def choice(kind: type[_E]) -> Kind[_E]:
    """Return the kind of an enum's members, by their order."""
    members = list(kind)

    def read(reader: Reader) -> _E:
        index: int = reader.unpack(_BYTE)[0]
        if index >= len(members):
            malformed(f"expected one of {len(members)} values of {kind.__name__}, got number {index}")
        return members[index]

    return Kind(lambda value: _BYTE.pack(members.index(value)), read)


REASON: Kind[Reason] = choice(Reason)
CAUSE: Kind[Cause] = choice(Cause)


def _write_blob(value: bytes) -> bytes:
    if len(value) > LONGEST_BLOB:
        raise ArgumentError(f"message: expected at most {LONGEST_BLOB} bytes, got {len(value)}")
    return _BYTE.pack(len(value)) + value


DIGEST: Kind[bytes] = Kind(_write_blob, lambda reader: reader.take(*reader.unpack(_BYTE)))


# Poses and names.


def _write_pose(pose: Pose2) -> bytes:
    return _POSE.pack(pose.x, pose.y, pose.yaw)


def _read_pose(reader: Reader) -> Pose2:
    x, y, yaw = reader.unpack(_POSE)
    if not (math.isfinite(x) and math.isfinite(y) and -math.pi <= yaw < math.pi):
        malformed(f"expected a finite pose with its yaw in [-pi, pi), got ({x}, {y}, {yaw})")
    return Pose2(x, y, yaw)


def _read_poses(reader: Reader) -> tuple[Pose2, ...]:
    return tuple(_read_pose(reader) for _ in range(_read_count(reader)))


POSE: Kind[Pose2] = Kind(_write_pose, _read_pose)
POSES: Kind[tuple[Pose2, ...]] = Kind(
    lambda poses: _write_count(len(poses)) + b"".join(_write_pose(pose) for pose in poses), _read_poses
)
POSE_RECORD: Kind[PoseRecord] = Kind(
    lambda record: _write_count(record.generation) + _write_count(record.version) + _write_pose(record.pose),
    lambda reader: PoseRecord(_read_count(reader), _read_count(reader), _read_pose(reader)),
)
TRADE: Kind[TradeId] = Kind(
    lambda trade: b"".join(_write_count(number) for number in trade),
    lambda reader: TradeId(_read_agent(reader), _read_count(reader), _read_count(reader)),
)


def _read_state(reader: Reader) -> NDArray[np.float64]:
    state = np.array(reader.unpack(_STATE))
    if not (np.abs(state) <= LARGEST_STATE).all():
        malformed(f"expected a state of numbers from -{LARGEST_STATE:g} to {LARGEST_STATE:g}, got {state}")
    if abs(float(np.linalg.norm(state[QUAT : QUAT + 4])) - 1.0) > NOT_UNIT:
        malformed(f"expected a unit quaternion, got {state[QUAT : QUAT + 4]}")
    state.setflags(write=False)
    return state


VEHICLE_STATE: Kind[NDArray[np.float64]] = Kind(lambda state: _STATE.pack(*state), _read_state)


# Arrays: the number of bytes an entry takes, then the entries; as few bytes as hold the largest.


def _write_numbers(values: NDArray[np.int64]) -> bytes:
    largest = int(values.view(np.uint64).max(initial=0))  # a negative number is a huge one here
    if largest > LARGEST:
        raise ArgumentError(f"message: expected numbers of at least 0, got {values.min()}")
    width = next(index for index, dtype in enumerate(_WIDTHS) if largest < 256**dtype.itemsize)
    return _BYTE.pack(width) + values.astype(_WIDTHS[width]).tobytes()


def _read_numbers(reader: Reader, size: int) -> NDArray[np.int64]:
    width: int = reader.unpack(_BYTE)[0]
    if width >= len(_WIDTHS):
        malformed(f"expected a width below {len(_WIDTHS)}, got {width}")
    dtype = _WIDTHS[width]
    values = np.frombuffer(reader.take(size * dtype.itemsize), dtype=dtype)
    if dtype.itemsize == 8 and values.max(initial=0) > LARGEST:
        malformed("expected numbers in [0, 2^63)")
    return values.astype(np.int64)


def _write_landmarks(indices: NDArray[np.int64]) -> bytes:
    return _write_count(len(indices)) + _write_numbers(indices)


def _read_landmarks(reader: Reader) -> NDArray[np.int64]:
    size = _read_count(reader)
    indices = _read_numbers(reader, size)
    if size and (indices[-1] >= reader.landmarks or (indices[1:] <= indices[:-1]).any()):
        malformed(f"expected landmarks in [0, {reader.landmarks}), each once and in order")
    indices.setflags(write=False)
    return indices


def _write_records(records: RecordSlice) -> bytes:
    columns = (_write_numbers(column) for column in records.values.T)
    return _write_landmarks(records.indices) + b"".join(columns)


def _read_records(reader: Reader) -> RecordSlice:
    indices = _read_landmarks(reader)
    values = np.empty((len(indices), 4), dtype=np.int64)
    for column in range(4):
        values[:, column] = _read_numbers(reader, len(indices))
    if values[:, OWNER].max(initial=-1) >= reader.agents:
        malformed(f"expected owners in [0, {reader.agents}), got {values[:, OWNER].max()}")
    return RecordSlice(indices, values)


def by_agent(kind: Kind[_T]) -> Kind[Mapping[int, _T]]:
    """Return the kind of a mapping from agents to values of a kind."""

    def write(values: Mapping[int, _T]) -> bytes:
        pairs = (_write_count(agent) + kind.write(values[agent]) for agent in sorted(values))
        return _write_count(len(values)) + b"".join(pairs)

    def read(reader: Reader) -> Mapping[int, _T]:
        values: dict[int, _T] = {}
        last = -1
        for _ in range(_read_count(reader)):
            agent = _read_agent(reader)
            if agent <= last:
                malformed(f"expected each agent once and in order, got {agent} after {last}")
            values[agent] = kind.read(reader)
            last = agent
        return MappingProxyType(values)

    return Kind(write, read)


# What has changed since the mission began.


def _write_text(text: str) -> bytes:
    data = text.encode()
    if len(data) > LONGEST_TEXT:
        raise ArgumentError(f"message: expected at most {LONGEST_TEXT} bytes of text, got {len(data)}")
    return _write_count(len(data)) + data


def _read_text(reader: Reader) -> str:
    size = _read_count(reader)
    if size > LONGEST_TEXT:
        malformed(f"expected at most {LONGEST_TEXT} bytes of text, got {size}")
    try:
        return reader.take(size).decode()
    except UnicodeDecodeError:
        malformed("expected text in UTF-8")


def _write_landmark(change: LandmarkChange) -> bytes:
    version, alive, *numbers = change
    return _write_count(version) + _BYTE.pack(alive) + _LANDMARK.pack(*numbers)


def _read_landmark(reader: Reader) -> LandmarkChange:
    version, alive = _read_count(reader), _read_flag(reader)
    numbers = reader.unpack(_LANDMARK)
    if not all(map(math.isfinite, numbers)) or numbers[0] < 0.0:
        malformed(f"expected finite numbers and a weight of at least 0, got {numbers}")
    return LandmarkChange(version, alive, *numbers)


def _write_catalogue(catalogue: Catalogue) -> bytes:
    indices = np.array(sorted(catalogue.landmarks), dtype=np.int64)
    changes = (_write_landmark(catalogue.landmarks[k]) for k in indices.tolist())
    return _write_landmarks(indices) + b"".join(changes) + _AGENT_CHANGES.write(catalogue.agents)


def _read_catalogue(reader: Reader) -> Catalogue:
    landmarks = {k: _read_landmark(reader) for k in _read_landmarks(reader).tolist()}
    agents = _AGENT_CHANGES.read(reader)
    return Catalogue(MappingProxyType(landmarks), agents) if landmarks or agents else EMPTY


_AGENT_CHANGE: Kind[AgentChange] = Kind(
    lambda change: _write_count(change.version) + _BYTE.pack(change.present) + _write_text(change.specification),
    lambda reader: AgentChange(_read_count(reader), _read_flag(reader), _read_text(reader)),
)
_AGENT_CHANGES: Kind[Mapping[int, AgentChange]] = by_agent(_AGENT_CHANGE)
CATALOGUE: Kind[Catalogue] = Kind(_write_catalogue, _read_catalogue)
LANDMARKS: Kind[NDArray[np.int64]] = Kind(_write_landmarks, _read_landmarks)
RECORDS: Kind[RecordSlice] = Kind(_write_records, _read_records)
TALLY: Kind[Mapping[int, int]] = by_agent(COUNT)
POSE_RECORDS: Kind[Mapping[int, PoseRecord]] = by_agent(POSE_RECORD)
SENDER: Kind[Sender] = Kind(
    lambda sender: b"".join(_write_count(number) for number in sender),
    lambda reader: Sender(_read_agent(reader), _read_count(reader)),
)
