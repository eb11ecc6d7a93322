"""What an agent keeps on disk: a life that always rises, and a memory that is whole or not used."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covey.errors import OutputError
from covey.geometry import Pose2
from covey.protocol import AgentChange, Catalogue, LandmarkChange, LandmarkRecords, Memory, PoseRecords, Sender
from covey.runtime.network.agent_state import AgentDirectory, await_life, first_life
from covey.transports.codec import Codec

CODEC = Codec(bytes(range(16)), agents=3, landmarks=6)
SENDER = Sender(1, 7)
POSE = Pose2(0.25, -1.5, 3.0)


def memory(known: int = 6) -> Memory:
    records = LandmarkRecords.unknown(6)
    partition = {0: np.array([0, 4]), 1: np.array([1, 2, 3]), 2: np.array([5])}
    records.merge(LandmarkRecords.initial(6, partition, incarnation=9).slice(np.arange(known)))
    poses = PoseRecords.initial({agent: Pose2(float(agent), 0.5, 0.0) for agent in range(3)})
    return Memory(records, poses, (Pose2(1.0, 2.0, 0.5), Pose2(-1.0, 0.0, -0.5)))


def open_directory(folder: Path, said: list[str], codec: Codec = CODEC, agent: int = 1) -> AgentDirectory:
    return AgentDirectory(folder, agent, codec, said.append)


def kept(folder: Path) -> Path:
    said: list[str] = []
    open_directory(folder, said).keep(SENDER, memory(), POSE)
    assert said == []
    return folder / "agent-1" / "memory"


@pytest.mark.parametrize("known", [0, 3, 6])
def test_what_is_kept_is_recalled(tmp_path: Path, known: int) -> None:
    said: list[str] = []
    directory = open_directory(tmp_path / "deep" / "er", said)
    assert directory.recall() is None
    directory.keep(SENDER, memory(known), POSE)
    found = directory.recall()
    assert found is not None
    assert found.pose == POSE
    assert np.array_equal(found.memory.records.values, memory(known).records.values)
    assert found.memory.poses.as_mapping() == memory().poses.as_mapping()
    assert found.memory.avoid == memory().avoid
    assert said == []
    assert sorted(path.name for path in (tmp_path / "deep" / "er" / "agent-1").iterdir()) == ["memory"]


@pytest.mark.parametrize("added", [0, 2])
def test_a_memory_has_the_landmarks_that_there_are_and_not_those_that_may_come(tmp_path: Path, added: int) -> None:
    said: list[str] = []
    codec = Codec(bytes(range(16)), agents=3, landmarks=6, more_agents=10, more_landmarks=1000)
    changed = memory()
    landmarks = {6 + k: LandmarkChange(1 + k, True, 2.0, 0.5, float(k)) for k in range(added)}
    if added:
        landmarks[4] = LandmarkChange(9, False, 0.0, 1.0, 1.0)
        changed.records.grow(6 + added)
        changed.records.merge(changed.records.slice(np.array([6])).adopted_by(1, 7))
    catalogue = Catalogue(landmarks, {2: AgentChange(5, False)} if added else {})
    directory = open_directory(tmp_path, said, codec)
    directory.keep(SENDER, Memory(changed.records, changed.poses, changed.avoid, catalogue), POSE)
    found = directory.recall()
    assert found is not None
    assert said == []
    assert found.memory.catalogue == catalogue
    assert found.memory.records.first == 6
    assert np.array_equal(found.memory.records.values, changed.records.values[: 7 if added else 6])


@given(place=st.integers(0, 10_000), flip=st.integers(1, 255))
def test_no_flipped_byte_goes_unnoticed(tmp_path_factory: pytest.TempPathFactory, place: int, flip: int) -> None:
    folder = tmp_path_factory.mktemp("state")
    path = kept(folder)
    data = bytearray(path.read_bytes())
    data[place % len(data)] ^= flip
    path.write_bytes(data)
    said: list[str] = []
    assert open_directory(folder, said).recall() is None
    assert len(said) == 1
    assert "without memory" in said[0]
    assert path.with_name("memory.unused").read_bytes() == bytes(data)
    assert not path.exists()


@given(size=st.integers(0, 400))
def test_a_file_that_was_cut_short_is_not_used(tmp_path_factory: pytest.TempPathFactory, size: int) -> None:
    folder = tmp_path_factory.mktemp("state")
    path = kept(folder)
    data = path.read_bytes()
    path.write_bytes(data[: min(size, len(data) - 1)])
    said: list[str] = []
    assert open_directory(folder, said).recall() is None
    assert len(said) == 1


def test_the_memory_of_another_mission_is_put_aside(tmp_path: Path) -> None:
    kept(tmp_path)
    said: list[str] = []
    other = Codec(bytes(16), agents=3, landmarks=6)
    directory = open_directory(tmp_path, said, codec=other)
    assert directory.recall() is None
    assert "another mission" in said[0]
    assert (tmp_path / "agent-1" / "memory.unused").exists()
    assert directory.recall() is None
    assert len(said) == 1


def test_the_memory_of_another_agent_is_not_used(tmp_path: Path) -> None:
    path = kept(tmp_path)
    (tmp_path / "agent-2").mkdir()
    path.replace(tmp_path / "agent-2" / "memory")
    said: list[str] = []
    assert open_directory(tmp_path, said, agent=2).recall() is None
    assert "this agent" in said[0]


def test_each_life_is_above_the_last_and_not_below_the_clock(tmp_path: Path) -> None:
    said: list[str] = []
    before = time.time()
    lives = [open_directory(tmp_path, said).next_life() for _ in range(5)]
    assert lives == sorted(set(lives))
    assert lives[0] >= before
    assert said == []
    (tmp_path / "agent-1" / "incarnation").write_text("99999999999\n")
    assert open_directory(tmp_path, said).next_life() == 100_000_000_000


@pytest.mark.parametrize("text", ["", "seven", "-5", "9" * 19, "9" * 40, "\ufffd"])
def test_a_damaged_number_is_reported_and_the_clock_takes_its_place(tmp_path: Path, text: str) -> None:
    said: list[str] = []
    directory = open_directory(tmp_path, said)
    (tmp_path / "agent-1" / "incarnation").write_text(text, "utf-8")
    before = time.time()
    assert before <= directory.next_life() <= before + 10.0
    assert len(said) == 1


def test_a_life_without_files_is_never_that_of_the_last() -> None:
    """Two lives that begin in a row, each waiting for its second, have different numbers."""
    first = first_life()
    await_life(first)
    assert first_life() > first


def test_a_directory_that_cannot_be_used_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="--state"):
        open_directory(tmp_path / "file", [])
    directory = open_directory(tmp_path, [])
    (tmp_path / "agent-1" / ".incarnation.new").mkdir()
    (tmp_path / "agent-1" / ".memory.new").mkdir()
    with pytest.raises(OutputError, match="cannot be written"):
        directory.next_life()
    with pytest.raises(OutputError, match="cannot be written"):
        directory.keep(SENDER, memory(), POSE)
