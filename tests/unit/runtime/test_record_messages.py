"""Messages of a record: how they are packed, and that every one survives."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from rosbags.typesys import Stores, get_typestore

from covey.playground.sample import sample_feed
from covey.runtime.records import ros_types
from covey.runtime.records.record_topics import StandardTopics, into_body, topic_names
from covey.runtime.records.record_types import decode, encode
from covey.runtime.watching.feed import (
    BoundFound,
    ChangeKind,
    Ended,
    Health,
    Motion,
    Note,
    ObstacleAppeared,
    Run,
    Scene,
    SceneAgent,
    SceneObstacle,
    TeamChange,
    TeamState,
    Trading,
    Weights,
)


def test_messages_are_packed_as_the_definition_says() -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    pose = [1.0, 2.0, 3.0, 0.5, 0.5, -0.5, 0.5]
    transforms = ros_types.TransformsMessage("map", ["a", "longer name", "ab"])
    got: Any = store.deserialize_cdr(transforms.pack(1_500_000_007, [pose] * 3), ros_types.TRANSFORMS)
    assert [one.child_frame_id for one in got.transforms] == ["a", "longer name", "ab"]
    assert got.transforms[1].header.stamp.nanosec == 500_000_007
    assert got.transforms[2].transform.rotation.w == 0.5
    for child in ("a", "ab", "abc", "abcd", "abcdefgh"):
        odometry = ros_types.OdometryMessage("map", child)
        one: Any = store.deserialize_cdr(odometry.pack(2_000_000_001, pose, [1, 2, 3, 4, 5, 6]), ros_types.ODOMETRY)
        assert (one.child_frame_id, one.header.stamp.sec, one.pose.pose.orientation.y) == (child, 2, -0.5)
        assert one.twist.twist.angular.z == 6.0
    points = np.arange(6.0).reshape(2, 3)
    marker = ros_types.Marker("cells", 4, frame="map", points=points, colour="#ff0000", text="é", frame_locked=True)
    array: Any = store.deserialize_cdr(ros_types.marker_array(5, [marker, marker]), ros_types.MARKERS)
    assert array.markers[1].points[1].z == 5.0
    assert (array.markers[1].color.r, array.markers[1].text, array.markers[1].frame_locked) == (1.0, "é", True)
    battery: Any = store.deserialize_cdr(ros_types.battery_state(1_500_000_007, "abc", 0.75), ros_types.BATTERY)
    assert (battery.header.frame_id, battery.header.stamp.nanosec, battery.percentage) == ("abc", 500_000_007, 0.75)
    assert (battery.power_supply_status, battery.present) == (battery.POWER_SUPPLY_STATUS_DISCHARGING, True)
    assert math.isnan(battery.voltage)
    assert math.isnan(battery.design_capacity)
    line: Any = store.deserialize_cdr(ros_types.log_line(5, ros_types.WARN, "covey", "lost"), ros_types.LOG)
    assert (line.level, line.name, line.msg) == (30, "covey", "lost")


def test_only_batteries_of_which_something_is_known_are_on_their_topics() -> None:
    put: list[tuple[str, str]] = []
    topics = StandardTopics(lambda topic, kind, data, latched: put.append((topic, kind)))
    topics.write(next(sample_feed(agents=2, landmarks=16)), 0)
    put.clear()
    unknown, activity = np.full(2, np.nan), np.zeros(2, dtype=np.uint8)
    topics.write(Health(1.0, activity, unknown, unknown, unknown), 1)
    assert put == []
    topics.write(Health(2.0, activity, np.array([math.nan, 0.25]), unknown, unknown), 2)
    ((topic, kind),) = put
    assert (topic.split("/")[-1], kind) == ("battery", ros_types.BATTERY)
    for tenth in range(1, 51):  # healths come more often when activities change
        topics.write(Health(2.0 + 0.1 * tenth, activity, np.array([math.nan, 0.25]), unknown, unknown), 2 + tenth)
    assert 5 <= len(put) <= 7


def test_who_hovers_is_told_of_less_often() -> None:
    put: list[str] = []
    topics = StandardTopics(lambda topic, kind, data, latched: put.append(topic))
    topics.write(next(sample_feed(agents=3, landmarks=16)), 0)
    put.clear()
    poses = np.tile([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], (3, 1))
    velocities = np.array([[0.05, 0.0, 0.0], [0.5, 0.0, 0.0], [np.nan] * 3])
    for tick in range(200):  # ten seconds
        topics.write(
            Motion(0.05 * tick, poses, velocities, np.zeros((3, 3)), np.empty((0, 3)), math.nan, math.inf), tick
        )
    hovering, moving, unknown = (sum(f"agent_{k}/odometry" in topic for topic in put) for k in (1, 2, 3))
    assert (moving, unknown) == (100, 100)
    assert 10 <= hovering <= 11
    assert put.count("/tf") == 100


@given(st.lists(st.text(max_size=8), max_size=12))
def test_topics_are_names_that_ros_takes_and_all_differ(names: list[str]) -> None:
    found = topic_names(names)
    assert len(set(found)) == len(names)
    assert all(name.isascii() and name.replace("_", "a").isalnum() and not name[0].isdigit() for name in found)
    assert all("__" not in name for name in found)


@given(
    arrays.arrays(np.float64, (3, 4), elements=st.floats(-1, 1)),
    arrays.arrays(np.float64, (3, 3), elements=st.floats(-9, 9)),
)
def test_velocities_are_turned_into_the_body(quats: Any, vectors: Any) -> None:
    norm = np.linalg.norm(quats, axis=1, keepdims=True)
    quats = np.where(norm > 0.1, quats / np.where(norm > 0.1, norm, 1.0), [1.0, 0.0, 0.0, 0.0])
    w, x, y, z = quats.T
    rotation = np.array(
        [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
         [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
         [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    )  # fmt: skip
    assert into_body(quats, vectors) == pytest.approx(np.einsum("jik,kj->ki", rotation, vectors), abs=1e-9)


floats = st.floats(allow_nan=True, allow_infinity=True)
vectors = arrays.arrays(np.float64, st.integers(0, 4), elements=floats)
indices = arrays.arrays(np.int32, st.integers(0, 4))
codes = arrays.arrays(np.uint8, st.integers(0, 4))
agents = st.lists(st.integers(0, 99), max_size=3).map(tuple)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=9)


def rows(columns: int) -> st.SearchStrategy[Any]:
    """Arrays with so many columns."""
    return st.integers(0, 3).flatmap(lambda n: arrays.arrays(np.float64, (n, columns), elements=floats))


rings = st.lists(rows(2), max_size=3).map(tuple)
obstacles = st.builds(SceneObstacle, rows(2), floats, floats, floats)
members = st.builds(SceneAgent, texts, texts, rings, texts, floats)
ITEMS = st.one_of(
    st.builds(
        Scene, st.sampled_from(Run), texts, st.integers(0, 2**63 - 1), floats, texts,
        st.lists(members, max_size=3).map(tuple), rows(3), vectors, st.one_of(st.none(), rows(3).filter(len)), floats,
        rings, st.lists(obstacles, max_size=2).map(tuple), floats, floats,
        st.one_of(st.none(), st.tuples(floats, floats)), st.dictionaries(texts, st.integers()),
        st.dictionaries(texts, texts),
    ),
    st.builds(TeamState, floats, indices, rows(7), vectors, vectors, codes, indices, st.integers(0, 2**31 - 1), floats),
    st.builds(
        TeamChange, floats, st.sampled_from(ChangeKind), agents, indices, indices, agents, rows(7), agents, vectors,
        floats, texts,
    ),
    st.builds(Trading, floats, st.integers(0, 9), st.integers(0, 9), indices, indices, st.booleans()),
    st.builds(Weights, floats, indices, vectors),
    st.builds(Motion, floats, rows(7), rows(3), rows(3), rows(3), floats, floats),
    st.builds(Health, floats, codes, vectors, vectors, vectors),
    st.builds(Note, floats, texts, agents, texts),
    st.builds(ObstacleAppeared, floats, obstacles),
    st.builds(BoundFound, floats, floats),
    st.builds(Ended, floats, texts, st.sampled_from([True, False, None]), floats),
)  # fmt: skip


def equal(first: Any, second: Any) -> bool:
    """Whether two values are the same, bit for bit, and of the same shape and type."""
    if isinstance(first, np.ndarray):
        same = first.dtype == second.dtype and first.shape == second.shape
        return bool(same and first.tobytes() == second.tobytes())
    if isinstance(first, float):
        return struct.pack("<d", first) == struct.pack("<d", second) or (math.isnan(first) and math.isnan(second))
    if isinstance(first, tuple):
        return len(first) == len(second) and all(equal(a, b) for a, b in zip(first, second, strict=True))
    if hasattr(type(first), "__dataclass_fields__"):
        fields = type(first).__dataclass_fields__
        return type(first) is type(second) and all(equal(getattr(first, n), getattr(second, n)) for n in fields)
    return bool(first == second)


@given(ITEMS)
def test_every_item_survives(item: Any) -> None:
    assert equal(decode(type(item), encode(item)), item)


@given(ITEMS, st.data())
def test_a_message_that_is_cut_is_refused(item: Any, data: st.DataObject) -> None:
    message = encode(item)
    with pytest.raises(ValueError, match=r"."):
        decode(type(item), message[: data.draw(st.integers(0, len(message) - 1))])
