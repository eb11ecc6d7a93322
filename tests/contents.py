"""Random messages and events, made from the table of the codec, so that every type in it is tried."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from covey.flight.layout import OBSERVATION, QUAT
from covey.geometry import Pose2
from covey.protocol import (
    OPERATOR,
    AgentChange,
    Busy,
    Catalogue,
    Cause,
    Change,
    Heartbeat,
    LandmarkChange,
    Offer,
    PoseRecord,
    Reason,
    RecordSlice,
    Sender,
    TradeId,
)
from covey.transports import layout
from covey.transports.codec import LAYOUTS, Codec, Content, Layout
from covey.transports.telemetry import Telemetry

AGENTS, LANDMARKS = 5, 300
LARGEST = 2**63 - 1

DIGEST = bytes(range(16))
CODEC = Codec(DIGEST, agents=AGENTS, landmarks=LANDMARKS)

counts = st.one_of(st.integers(0, 300), st.integers(0, LARGEST))
agents = st.integers(0, AGENTS - 1)
finite = st.floats(allow_nan=False, allow_infinity=False)
poses = st.builds(Pose2, finite, finite, st.floats(-10.0, 10.0))
records_of_poses = st.builds(PoseRecord, counts, counts, poses)
trades = st.builds(TradeId, agents, counts, counts)
sets = st.lists(st.integers(0, LANDMARKS - 1), unique=True, max_size=20).map(
    lambda chosen: np.array(sorted(chosen), dtype=np.int64)
)


weights = st.floats(0.0, 1e9)
catalogues = st.builds(
    Catalogue,
    st.dictionaries(
        st.integers(0, LANDMARKS - 1),
        st.builds(LandmarkChange, counts, st.booleans(), weights, finite, finite, finite, finite),
        max_size=4,
    ),
    st.dictionaries(agents, st.builds(AgentChange, counts, st.booleans(), st.text(max_size=20)), max_size=3),
)


components = st.floats(-layout.LARGEST_STATE, layout.LARGEST_STATE)


@st.composite
def vehicle_states(draw: st.DrawFn) -> NDArray[np.float64]:
    """States of vehicles anywhere, in any attitude."""
    state = np.array(draw(st.lists(components, min_size=OBSERVATION, max_size=OBSERVATION)))
    turn, tilt, twist = (draw(st.floats(-math.pi, math.pi)) for _ in range(3))
    state[QUAT : QUAT + 4] = [
        math.cos(turn) * math.cos(tilt),
        math.sin(turn) * math.cos(tilt),
        math.sin(tilt) * math.cos(twist),
        math.sin(tilt) * math.sin(twist),
    ]
    return state


@st.composite
def slices(draw: st.DrawFn) -> RecordSlice:
    """Records of random landmarks."""
    indices = draw(sets)
    rows = [[draw(counts), draw(counts), draw(agents), draw(counts)] for _ in indices]
    return RecordSlice(indices, np.array(rows, dtype=np.int64).reshape(-1, 4))


STRATEGIES: dict[int, st.SearchStrategy[Any]] = {
    id(layout.AGENT): agents,
    id(layout.CATALOGUE): catalogues,
    id(layout.CAUSE): st.sampled_from(Cause),
    id(layout.COUNT): counts,
    id(layout.DIGEST): st.binary(max_size=40),
    id(layout.POSE_RECORDS): st.dictionaries(agents, records_of_poses, max_size=AGENTS),
    id(layout.SENDER): st.builds(Sender, agents, counts),
    id(layout.FLAG): st.booleans(),
    id(layout.FLOAT): finite,
    id(layout.LANDMARKS): sets,
    id(layout.POSE): poses,
    id(layout.POSES): st.lists(poses, max_size=3).map(tuple),
    id(layout.POSE_RECORD): records_of_poses,
    id(layout.REASON): st.sampled_from(Reason),
    id(layout.RECORDS): slices(),
    id(layout.SHARE): st.one_of(st.floats(0.0, 1.0), st.just(math.nan)),
    id(layout.TALLY): st.dictionaries(agents, counts, max_size=AGENTS),
    id(layout.TRADE): trades,
    id(layout.VEHICLE_STATE): vehicle_states(),
}


@st.composite
def senders_and_contents(draw: st.DrawFn) -> tuple[Sender, Content]:
    """A sender and anything that it may say."""
    chosen: Layout = draw(st.sampled_from(list(LAYOUTS.values())))
    values = {name: draw(STRATEGIES[id(kind)]) for name, kind in chosen.kinds.items()}
    sender = Sender(OPERATOR if chosen.type is Change else draw(agents), draw(counts))
    if "sender" in chosen.type.__dataclass_fields__:
        values["sender"] = sender
    if chosen.type is Offer:  # it gives of its own, and wants of the other's
        own: RecordSlice = values["records"]
        values["give"] = own.indices[: draw(st.integers(0, len(own.indices)))]
        values["want"] = np.setdiff1d(values["want"], own.indices)
    if "trade" in values:
        values["trade"] = TradeId(sender.agent, *values["trade"][1:])
    return sender, chosen.type(**values)


def same(first: object, second: object) -> bool:
    """Whether two values of a message are equal, to the last bit and the type."""
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return dict(first) == dict(second)
    if type(first) is not type(second):
        return False
    if isinstance(first, RecordSlice) and isinstance(second, RecordSlice):
        return same(first.indices, second.indices) and same(first.values, second.values)
    if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
        return first.dtype == second.dtype and np.array_equal(first, second)
    if isinstance(first, float) and isinstance(second, float):
        if math.isnan(first):
            return math.isnan(second)
        return first == second and math.copysign(1.0, first) == math.copysign(1.0, second)
    return bool(first == second)


def same_content(first: Content, second: Content) -> bool:
    """Whether two messages or events are equal in every field."""
    names = type(first).__dataclass_fields__
    return type(first) is type(second) and all(same(getattr(first, name), getattr(second, name)) for name in names)


def telemetry(agent: int = 1, *, x: float = 0.0, incarnation: int = 1, battery: float = 0.5) -> Telemetry:
    """The report of a level vehicle at 1.5 m that flies along x."""
    state = np.array([x, 0.0, 1.5, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    return Telemetry(Sender(agent, incarnation), state, battery)


def busy(agent: int, number: int = 1) -> Busy:
    """A message that is no answer to anything."""
    return Busy(Sender(agent, 1), TradeId(agent, 1, number))


def beat(agent: int, sequence: int) -> Heartbeat:
    """A heartbeat of an agent at rest."""
    return Heartbeat(Sender(agent, 1), sequence, True, 1, PoseRecord(1, 1, Pose2(0.0, 0.0, 0.0)), {}, {})


def array(*values: int) -> NDArray[np.int64]:
    """A set of landmarks."""
    return np.array(values, dtype=np.int64)
