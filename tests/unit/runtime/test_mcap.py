"""Records: the same contents for every reader, whatever happened to the file."""

from __future__ import annotations

import errno
import os
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader as BagReader
from rosbags.typesys import Stores, get_typestore
from tests.unit.runtime.test_telling import scene

from covey.errors import OutputError, RecordError
from covey.runtime.fly import fly
from covey.runtime.plan import plan
from covey.runtime.records import ros_types
from covey.runtime.records.mcap_reader import Record
from covey.runtime.records.mcap_record import METADATA, Recorder, RecordFile, partial_path, topic_of
from covey.runtime.records.record_types import LAYOUTS, decode, encode
from covey.runtime.watching.feed import (
    BoundFound,
    Ended,
    Motion,
    Scene,
    TeamState,
    Update,
)
from covey.runtime.watching.view import TeamView

Items = list[Scene | Update]


def record(path: Path, items: Items) -> Path:
    """Record items and return the path."""
    with Recorder(path) as recorder:
        for item in items:
            recorder(item)
    assert recorder.failure is None
    return path


def as_bytes(items: Iterator[Scene | Update] | Items) -> list[bytes]:
    """Return items in a form in which equal ones are equal, NaN included."""
    return [encode(item) for item in items]


@pytest.fixture(scope="module")
def flown() -> Items:
    items: Items = []
    fly(scene(name='féld, "1"'), vehicles="kinematic", watch=items.append)
    last = items[-1]
    assert isinstance(last, Ended)
    items.insert(-2, BoundFound(last.time, 70.0))
    return items


@pytest.fixture(scope="module")
def file(flown: Items, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("record") / "record.mcap", flown)


def test_our_reader_gives_back_what_was_told(file: Path, flown: Items) -> None:
    with Record(file) as opened:
        assert opened.complete
        assert opened.problems == ()
        assert as_bytes(opened.items()) == as_bytes(flown)
        assert opened.metadata["mission"] == 'féld, "1"'
        assert opened.metadata["seed"] == "3"
        assert opened.scene.source == {**scene().source, "name": 'féld, "1"'}
        assert opened.topics["/covey/motion"].messages == sum(isinstance(item, Motion) for item in flown)
        assert opened.end == pytest.approx(opened.start + opened.duration)


def flat(message: Any) -> list[Any]:
    """Return the leaves of a decoded message, whichever library decoded it."""
    if isinstance(message, np.ndarray | bytes):
        return list(message) if isinstance(message, bytes) else list(message.tolist())
    if isinstance(message, (list, tuple)):
        return [leaf for part in message for leaf in flat(part)]
    if isinstance(message, (str, bool, int, float)):
        return [message]
    names = getattr(message, "__slots__", None) or list(vars(message))
    return [leaf for name in names if not name.startswith("__") for leaf in flat(getattr(message, name))]


def test_mcap_rosbags_and_we_read_equal_contents(file: Path, flown: Items) -> None:
    theirs: list[tuple[str, list[Any]]] = []
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        assert next(reader.iter_metadata()).name == METADATA
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            theirs.append((channel.topic, flat(decoded)))
            own = next((cls for cls in LAYOUTS if topic_of(cls) == channel.topic), None)
            if own is not None:
                assert encode(decode(own, message.data)) == message.data
    with AnyReader([file]) as bag:
        others = [
            (connection.topic, flat(bag.deserialize(raw, connection.msgtype))) for connection, _, raw in bag.messages()
        ]
    key = repr  # NaN differs from itself
    assert sorted(map(key, theirs)) == sorted(map(key, others))
    motions = [item for item in flown if isinstance(item, Motion)]
    states = [leaves for topic, leaves in theirs if topic == "/covey/motion"]
    assert [leaves[0] for leaves in states] == [motion.time for motion in motions]
    assert states[5][1 : 1 + motions[5].poses.size] == motions[5].poses.ravel().tolist()
    odometry = [leaves for topic, leaves in theirs if topic == "/covey/blue/odometry"]
    pose = motions[0].poses[0]
    assert odometry[0][:4] == [0, round(motions[0].time * 1e9), "map", "blue"]
    assert odometry[0][4:11] == [*pose[:3], *pose[4:], pose[3]]
    scores = [leaves[0] for topic, leaves in theirs if topic == "/covey/score"]
    last = flown[-1]
    assert isinstance(last, Ended)
    assert scores[-1] == last.score


def test_standard_types_are_those_of_ros_2() -> None:
    humble = get_typestore(Stores.ROS2_HUMBLE)
    names = (
        ros_types.ODOMETRY, ros_types.POSE_STAMPED, ros_types.TRANSFORMS, ros_types.MARKERS, ros_types.FLOAT64,
        ros_types.LOG,
    )  # fmt: skip
    for name in names:
        text, _ = humble.generate_msgdef(name, ros_version=2)
        for section in text.split("=" * 80 + "\n"):
            lines = [line for line in section.splitlines() if line and "=" not in line]
            ours = ros_types.definition(name)
            assert all(line in ours for line in lines), name


def test_bags_know_who_wants_the_last_message(file: Path) -> None:
    with BagReader(file) as bag:
        durability = {
            connection.topic: connection.ext.offered_qos_profiles[0].durability.name
            for connection in bag.connections
            if isinstance(connection.ext, ConnectionExtRosbag2)
        }
    assert durability["/covey/team_state"] == "TRANSIENT_LOCAL"
    assert durability["/covey/motion"] == "VOLATILE"


def test_any_moment_can_be_seen(file: Path, flown: Items) -> None:
    with Record(file) as opened:
        for moment in np.linspace(-1.0, opened.end + 1.0, 23):
            view = TeamView()
            for item in flown:
                if not isinstance(item, Scene) and item.time > max(moment, 0.0) + 1e-9:
                    break
                view.apply(item)
            seen = opened.at(float(moment))
            assert encode(seen.state(0.0)) == encode(view.state(0.0))
            assert (seen.motion is None) == (view.motion is None)
            if seen.motion is not None and view.motion is not None:
                assert encode(seen.motion) == encode(view.motion)
            assert (seen.ended is None) == (view.ended is None)


def test_a_scene_that_changes_is_followed(tmp_path: Path) -> None:
    items: Items = []
    plan(scene(), watch=items.append)
    last = items[-1]
    assert isinstance(last, Ended)
    end = last.time
    more: Items = []
    plan(scene(agents={"count": 5}), watch=more.append)
    state = more[1]
    assert isinstance(state, TeamState)
    second = [more[0], TeamState(end + 1.0, *(getattr(state, name) for name, _ in LAYOUTS[TeamState][1:]))]
    with Record(record(tmp_path / "r.mcap", [*items[:-1], *second, Ended(end + 2.0, "settled", True, 1.0)])) as opened:
        assert len(opened.at(end).owner) == 64
        assert len(opened.at(end).poses) == 3
        assert len(opened.at(end + 1.0).poses) == 5
        assert [type(item) for item in opened.items()][-3:] == [Scene, TeamState, Ended]


def read(path: Path) -> tuple[list[bytes] | None, str]:
    """Return what is left in a file, and what is wrong with it."""
    try:
        with Record(path) as opened:
            assert opened.read_to <= opened.size <= path.stat().st_size  # which grows while a run goes on
            found = as_bytes(opened.items())
            opened.at(1e9).state()
            return found, "; ".join(opened.problems)
    except RecordError as error:
        return None, str(error)


def test_a_file_that_is_cut_anywhere_opens_up_to_the_cut(file: Path, flown: Items, tmp_path: Path) -> None:
    data, told = file.read_bytes(), as_bytes(flown)
    rng = np.random.default_rng(5)
    cuts = {*range(50), *range(len(data) - 50, len(data)), *rng.integers(0, len(data), 60).tolist()}
    cut = tmp_path / "cut.mcap"
    before, opened_at = 0, None
    for length in sorted(cuts):
        cut.write_bytes(data[:length])
        found, why = read(cut)
        if found is None:
            assert opened_at is None  # once it opens, it opens with more
            assert "nothing of the run can be read: the file ends at byte" in why
            continue
        assert "without its index" in why
        opened_at = opened_at or length
        assert found == told[: len(found)]
        assert len(found) >= before
        before = len(found)
    assert before == len(told)
    assert opened_at is not None
    assert opened_at < 0.2 * len(data)


def records(data: bytes, opcode: int) -> list[tuple[int, int]]:
    """Return the offset and length of each record of a kind."""
    found, at = [], 8
    while at + 9 <= len(data) and data[at] != 0x0F:
        length = struct.unpack_from("<Q", data, at + 1)[0]
        if data[at] == opcode:
            found.append((at, length + 9))
        at += length + 9
    return found


@pytest.mark.parametrize("cut", [False, True])
def test_a_damaged_chunk_is_left_out_and_told(file: Path, flown: Items, tmp_path: Path, *, cut: bool) -> None:
    data = bytearray(file.read_bytes())
    places = records(bytes(data), 0x06)
    assert len(places) >= 3
    at, length = places[1]
    data[at + length // 2] ^= 0xFF
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data[: len(data) - 20 * cut])
    with Record(path) as opened:
        found = as_bytes(opened.items())
        assert any(f"the chunk at byte {at:,} is damaged" in problem for problem in opened.problems)
        assert opened.complete is not cut
    told = as_bytes(flown)
    rest = iter(told)
    assert all(item in rest for item in found)  # in order, nothing of our own
    assert len(found) < len(told)
    assert found[-1] == told[-1]


def test_whatever_byte_is_damaged_the_rest_is_read_or_it_is_said_why_not(
    file: Path, flown: Items, tmp_path: Path
) -> None:
    data, told = file.read_bytes(), as_bytes(flown)
    rng = np.random.default_rng(6)
    index = range(len(data) - 6000, len(data), 97)  # where chunks are, among others
    path = tmp_path / "damaged.mcap"
    for place in (*index, *rng.integers(0, len(data), 60).tolist()):
        damaged = bytearray(data)
        damaged[place] ^= 0xFF
        path.write_bytes(damaged)
        found, why = read(path)
        assert found is not None or "nothing of the run can be read" in why or "expected" in why or "cannot" in why
        rest = iter(told)
        assert all(item in rest for item in found or ())


def test_damaged_metadata_cost_nothing_else(file: Path, flown: Items, tmp_path: Path) -> None:
    data = bytearray(file.read_bytes())
    ((at, length),) = records(bytes(data), 0x0C)
    data[at + length - 20] = 0xFF  # no UTF-8
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    found, why = read(path)
    assert found == as_bytes(flown)
    assert "the metadata at byte" in why


def foreign(path: Path) -> None:
    """Write an MCAP file of somebody else."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data")
        channel = writer.register_channel("/x", "cdr", schema)
        writer.add_message(channel, 1, ros_types.float64(1.0), 1)
        writer.finish()


def test_what_is_no_record_is_refused(tmp_path: Path, file: Path) -> None:
    path = tmp_path / "x.mcap"
    with pytest.raises(RecordError, match="no record here"):
        Record(path)
    with pytest.raises(RecordError, match=r"record\.mcap: no record here"):
        Record(tmp_path)
    with pytest.raises(RecordError, match="cannot be read"):
        Record("\0")
    path.write_bytes(b"PK\x03\x04" + bytes(1000))
    with pytest.raises(RecordError, match="expected an MCAP file, got something else"):
        Record(path)
    foreign(path)
    with pytest.raises(RecordError, match="expected a record of covey, got another MCAP file"):
        Record(path)
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(RecordError, match="expected a record of covey, got another MCAP file"):
        Record(path)
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    with pytest.raises(RecordError, match="expected a regular file"):
        Record(fifo)


@pytest.mark.parametrize("seed", range(20))
def test_a_garbled_file_never_gives_a_traceback(file: Path, tmp_path: Path, seed: int) -> None:
    data, rng = bytearray(file.read_bytes()), np.random.default_rng(seed)
    for at in rng.integers(0, len(data), 1 + seed % 5):
        data[int(at)] = int(rng.integers(256))
    path = tmp_path / "garbled.mcap"
    path.write_bytes(data)
    found, why = read(path)
    assert found is not None or str(path) in why


def test_a_record_replaces_nothing(tmp_path: Path, flown: Items) -> None:
    path = tmp_path / "r.mcap"
    path.write_text("mine")
    recorder = Recorder(path)
    with pytest.raises(OutputError, match="cannot be written"):
        recorder(flown[0])
    recorder.close()
    assert path.read_text() == "mine"


def test_nothing_told_is_no_file(tmp_path: Path) -> None:
    with Recorder(tmp_path / "r.mcap"):
        pass
    assert not list(tmp_path.iterdir())


def test_a_run_goes_on_when_the_record_cannot_be_written(
    tmp_path: Path, flown: Items, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: RecordFile) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(RecordFile, "flush", full)
    recorder = Recorder(tmp_path / "r.mcap")
    for item in flown * 8:  # more than may wait
        recorder(item)
    recorder.close()
    assert recorder.failure is not None
    assert "No space left on device; the record ends before the run" in str(recorder.failure)
    with pytest.raises(OutputError, match="No space left"):
        recorder.move(tmp_path / "moved.mcap")


def test_partial_records_take_free_names(tmp_path: Path) -> None:
    target = tmp_path / "result"
    assert partial_path(target) == tmp_path / "result.partial.mcap"
    (tmp_path / "result.partial.mcap").touch()
    assert partial_path(target) == tmp_path / "result-2.partial.mcap"
    target.mkdir()
    assert partial_path(target) == target / "record.partial.mcap"


KILLED = """
import sys, time
from covey.runtime.fly import fly
from covey.runtime.records.mcap_record import Recorder
from tests.unit.runtime.test_telling import scene
recorder = Recorder(sys.argv[1])
def watch(item):
    recorder(item)
    if getattr(item, "time", 0.0) >= 3.0:
        time.sleep(600.0)
fly(scene(), vehicles="kinematic", watch=watch)
"""


def end_of(path: Path) -> float:
    """Return the time up to which a file can be read; -1 for not at all."""
    try:
        with Record(path) as opened:
            return opened.end
    except RecordError:
        return -1.0


def test_a_run_that_is_killed_is_known_up_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with subprocess.Popen([sys.executable, "-c", KILLED, str(path)]) as process:
        deadline = time.monotonic() + 120.0
        while end_of(path) < 3.0 and time.monotonic() < deadline and process.poll() is None:
            time.sleep(0.1)
        process.kill()
    with Record(path) as opened:
        assert not opened.complete
        assert opened.end >= 3.0
        motion = opened.at(opened.end).motion
        assert motion is not None
        assert motion.time >= 3.0


def test_writing_goes_on_while_a_run_says_nothing(tmp_path: Path, flown: Items) -> None:
    path = tmp_path / "r.mcap"
    with Recorder(path) as recorder:
        for item in flown[:30]:
            recorder(item)
        deadline = time.monotonic() + 60.0
        while path.exists() and len(read(path)[0] or ()) < 30:
            assert time.monotonic() < deadline, "what was told is not in the file"
            time.sleep(0.05)
