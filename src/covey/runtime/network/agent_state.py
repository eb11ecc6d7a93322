"""What an agent keeps on disk, so that it can begin a new life with the memory of the last.

::

    DIR/agent-<number>/incarnation   the number of the newest life, raised and synced before the network is joined
    DIR/agent-<number>/memory        the newest map and changes, the pose of the vehicle and poses it could not reach

A file is written beside its place, synced and renamed, so that it is whole or absent whenever the power fails.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from covey.errors import CodecError, OutputError
from covey.geometry import Pose2
from covey.protocol import LandmarkRecords, Map, Memory, PoseRecords, Sender
from covey.transports.codec import Codec

MAGIC = b"covey memory 1\n"
CHECKSUM_BYTES = 32
LARGEST_LIFE = 2**62
"""A number beyond this in a file is damage."""


@dataclass(frozen=True)
class Remembered:
    """What was found on disk.

    Parameters
    ----------
    memory : Memory
    pose : Pose2
        Where the vehicle was.
    """

    memory: Memory
    pose: Pose2


class AgentDirectory:
    """One agent's files.

    Parameters
    ----------
    directory : Path
        Of one or several agents.
    agent : int
    codec : Codec
        Of the mission; what another mission left is not used.
    report : callable
        Called with a sentence about what cannot be used.

    Raises
    ------
    OutputError
        If the directory cannot be made.
    """

    def __init__(self, directory: Path, agent: int, codec: Codec, report: Callable[[str], object]) -> None:
        self._folder = directory / f"agent-{agent}"
        self._agent = agent
        self._codec = codec
        self._report = report
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{self._folder}: cannot be made: {error.strerror}; choose another --state") from error

    def next_life(self) -> int:
        """Raise the incarnation, on disk first, and return it.

        It is above every number that was kept here, and not below the seconds since 1970: so it rises as well when the
        files are lost, as long as the clock is not set back.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        path = self._folder / "incarnation"
        last = 0
        try:
            text = path.read_text("ascii").strip()
            last = int(text) if text.isdigit() and len(text) < 20 else LARGEST_LIFE
            if not last < LARGEST_LIFE:
                last = 0
                self._report(f"{path}: damaged; the clock numbers this life")
        except FileNotFoundError:
            pass
        except (OSError, UnicodeDecodeError):
            self._report(f"{path}: cannot be read; the clock numbers this life")
        life = max(last + 1, first_life())
        self._write(path, f"{life}\n".encode())
        return life

    def recall(self) -> Remembered | None:
        """Return what an earlier life left, or None if there is nothing or it cannot be used, which is reported.

        What cannot be used is kept beside as ``memory.unused``.
        """
        path = self._folder / "memory"
        try:
            return self._decode(path.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, CodecError, ValueError) as error:
            why = str(error)
        self._report(f"{path}: {why}; this life begins without memory")
        try:
            path.replace(path.with_name("memory.unused"))
        except OSError:
            self._report(f"{path}: cannot be put aside")
        return None

    def keep(self, sender: Sender, memory: Memory, pose: Pose2) -> None:
        """Write down what a later life can begin with.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        self._write(self._folder / "memory", self._encode(sender, memory, pose))

    def _encode(self, sender: Sender, memory: Memory, pose: Pose2) -> bytes:
        message = self._codec.encode(
            Map(sender, memory.records.known(), memory.poses.as_mapping(), memory.catalogue), sender=sender, number=0
        )
        head = json.dumps({"pose": _numbers(pose), "avoid": [_numbers(avoided) for avoided in memory.avoid]})
        data = b"".join((MAGIC, head.encode(), b"\n", message))
        return data + hashlib.sha256(data).digest()

    def _decode(self, data: bytes) -> Remembered:
        body = data[:-CHECKSUM_BYTES]
        if not body.startswith(MAGIC) or hashlib.sha256(body).digest() != data[-CHECKSUM_BYTES:]:
            raise ValueError("damaged")
        head, _, message = body[len(MAGIC) :].partition(b"\n")
        envelope = self._codec.decode(message)
        facts = json.loads(head)
        if not isinstance(envelope.content, Map) or envelope.sender.agent != self._agent:
            raise ValueError("expected the memory of this agent")
        poses = PoseRecords(envelope.content.poses)
        if self._agent not in poses:
            raise ValueError("expected the agent's own pose")
        records = LandmarkRecords.unknown(self._codec.first_landmarks)
        records.merge(envelope.content.records)
        avoid = tuple(_pose(avoided) for avoided in facts["avoid"])
        memory = Memory(records, poses, avoid, envelope.content.catalogue)
        return Remembered(memory, _pose(facts["pose"]))

    def _write(self, path: Path, data: bytes) -> None:
        beside = path.with_name(f".{path.name}.new")
        try:
            with beside.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
            _sync_folder(path.parent)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from error


def first_life() -> int:
    """Return the number of a life of which nothing is known but that it begins now."""
    return math.floor(time.time()) + 1


def await_life(life: int) -> None:
    """Wait, a second at most, until the clock has come to a life that `first_life` numbered: no two are the same."""
    time.sleep(min(1.0, max(0.0, life - time.time())))


def _numbers(pose: Pose2) -> list[float]:
    return [pose.x, pose.y, pose.yaw]


def _pose(numbers: list[float]) -> Pose2:
    x, y, yaw = (float(number) for number in numbers)
    return Pose2(x, y, yaw)


def _sync_folder(folder: Path) -> None:
    """Make a renaming last; only where a folder can be opened."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
