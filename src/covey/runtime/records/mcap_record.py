"""Records a run in an MCAP file while it goes on, so that whatever happens to it is known up to the last second."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import queue
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import IO

from mcap.writer import CompressionType, Writer

from covey.errors import OutputError
from covey.runtime.records import ros_types
from covey.runtime.records.output import PARTIAL
from covey.runtime.records.record_topics import StandardTopics
from covey.runtime.records.record_types import LAYOUTS, PACKAGE, definition, encode, type_name
from covey.runtime.watching.feed import Scene, TeamState, Update

VERSION = 1
"""Of what covey puts into a record: the types of `covey.runtime.records.record_types`."""

CHUNK = 1_000_000
"""Size of a chunk before compression, bytes."""

WRITE_EVERY = 0.25
"""Seconds between two writes."""

WAITING = 8192
"""So many items may wait to be written; then a run waits for the file."""

METADATA = "covey"
"""Name of the metadata."""

_LATCHED = {"Scene", "TeamState", "Ended", "BoundFound"}

_FOREVER = {"sec": 9223372036, "nsec": 854775807}


def topic_of(cls: type[Scene] | type[Update]) -> str:
    """Return the topic of one of covey's own types.

    Examples
    --------
    >>> from covey.runtime.watching.feed import TeamChange
    >>> topic_of(TeamChange)
    '/covey/team_change'
    """
    name = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in cls.__name__)
    return f"/covey/{name.strip('_')}"


def partial_path(directory: str | Path) -> Path:
    """Return where the record of a run is while it goes on: in its result directory, or beside where that will be.

    Examples
    --------
    >>> partial_path("somewhere/result").as_posix()
    'somewhere/result.partial.mcap'
    """
    directory = Path(directory)
    folder, stem = (directory, "record") if directory.is_dir() else (directory.parent, directory.name)
    for number in itertools.count(1):
        candidate = folder / f"{stem}{'' if number == 1 else f'-{number}'}{PARTIAL}"
        if not os.path.lexists(candidate):
            return candidate
    raise AssertionError("unreachable")


class Recorder:
    """A watcher that writes what it is told into an MCAP file; a context that completes the file when it is left.

    Writing goes on in a thread of its own.  What was told more than a second ago is in the file, even if the process
    is killed.

    Parameters
    ----------
    path : str or Path
        The file; there must be none.  It is made when there is something to write.
    on_open : callable, optional
        Called with the path when the file is there.

    Attributes
    ----------
    path : Path
    failure : OutputError or None
        Why the record ends early.  A run does not suffer from that.

    Examples
    --------
    >>> import math, tempfile
    >>> import covey
    >>> from covey.runtime.records.mcap_reader import Record
    >>> text = "{schema_version: 1, name: two, agents: {count: 2}, environment: {landmarks: {points: [[0, 0], [2, 1]]},"
    >>> text += " region: {box: {x_m: [-1, 3], y_m: [-1, 2]}}}}"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Recorder(f"{folder}/run.mcap") as recorder:
    ...         deployment = covey.plan(covey.parse_mission(text, format="yaml"), watch=recorder)
    ...     with Record(recorder.path) as record:
    ...         abs(record.at(math.inf).score - deployment.score.final) < 1e-9
    True
    """

    def __init__(self, path: str | Path, *, on_open: Callable[[Path], object] | None = None) -> None:
        self.path = Path(path)
        self.failure: OutputError | None = None
        self._on_open = on_open
        self._waiting: queue.Queue[Scene | Update] = queue.Queue(WAITING)
        self._wake = threading.Event()
        self._closing = False
        self._thread: threading.Thread | None = None

    def __call__(self, item: Scene | Update) -> None:
        """Take the next thing that is told.

        Raises
        ------
        OutputError
            If the file cannot be made.
        """
        if self._thread is None:
            self._open()
        if self._waiting.qsize() >= WAITING // 2:
            self._wake.set()
        while self.failure is None:
            with contextlib.suppress(queue.Full):
                self._waiting.put(item, timeout=1.0)
                return

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Complete the file."""
        if self._thread is not None:
            self._closing = True
            self._wake.set()
            self._thread.join()

    def move(self, path: str | Path) -> None:
        """Complete the file and move it, in place of one that is there.

        Raises
        ------
        OutputError
            If it cannot be moved, or could not be written to its end.
        """
        self.close()
        if self.failure is not None:
            raise self.failure
        if self._thread is None:
            return
        try:
            self.path.replace(path)
        except OSError as error:
            raise OutputError(
                f"{path}: cannot be written: {error.strerror or error}; the record is in {self.path}"
            ) from error
        self.path = Path(path)

    def _open(self) -> None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            stream = self.path.open("xb")
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror or error}") from error
        self._thread = threading.Thread(target=self._run, args=(stream,), name="covey-record", daemon=True)
        self._thread.start()
        if self._on_open is not None:
            self._on_open(self.path)

    def _run(self, stream: IO[bytes]) -> None:
        why: object = "a mistake in covey"
        try:
            with stream:
                file = RecordFile(stream)
                while not self._closing:
                    self._wake.wait(WRITE_EVERY)
                    self._wake.clear()
                    self._write(file)
                self._write(file)
                file.finish()
            why = None
        except OSError as error:
            why = error.strerror or error
        finally:  # whatever happened, the run must not wait for this thread
            if why is not None:
                self.failure = OutputError(f"{self.path}: cannot be written: {why}; the record ends before the run")

    def _write(self, file: RecordFile) -> None:
        """Write all that waits."""
        count = self._waiting.qsize()
        for _ in range(count):
            file.write(self._waiting.get_nowait())
        if count:
            file.flush()


class RecordFile:
    """Turns what is told into the messages of an MCAP file.

    Parameters
    ----------
    stream : binary file
    """

    def __init__(self, stream: IO[bytes]) -> None:
        from covey import __version__

        self._stream = stream
        self._writer = Writer(stream, chunk_size=CHUNK, compression=CompressionType.ZSTD)
        self._writer.start("ros2", f"covey {__version__}")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequences: dict[int, int] = {}
        self._now = 0
        self._described = False
        self._standard = StandardTopics(self._put)
        for cls in LAYOUTS:  # in the first chunk, so that a file that is cut tells what it is
            self._channel(topic_of(cls), type_name(cls), definition(cls), latched=cls.__name__ in _LATCHED)

    def write(self, item: Scene | Update) -> None:
        """Write an item, and what follows from it in standard types."""
        if isinstance(item, Scene):
            if not self._described:
                self._described = True
                self._writer.add_metadata(METADATA, describe(item))
        else:
            self._now = max(self._now, round(item.time * 1e9))
        self._message(self._channels[topic_of(type(item))], encode(item))
        self._standard.write(item, self._now)
        if isinstance(item, TeamState) and self._sequences[self._channels[topic_of(TeamState)]] == 1:
            self._writer.flush()  # with this a file that is cut can be read at all

    def flush(self) -> None:
        """Give all that was written to the operating system."""
        self._writer.flush()

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()
        self._stream.flush()

    def _put(self, topic: str, kind: str, data: bytes, latched: bool) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channel(topic, kind, ros_types.definition(kind), latched=latched)
        self._message(channel, data)

    def _message(self, channel: int, data: bytes) -> None:
        sequence = self._sequences.get(channel, 0)
        self._sequences[channel] = sequence + 1
        self._writer.add_message(channel, self._now, data, self._now, sequence)

    def _channel(self, topic: str, kind: str, text: str, *, latched: bool) -> int:
        schema = self._schemas.get(kind)
        if schema is None:
            schema = self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode("utf-8"))
        profile = {"offered_qos_profiles": _quality(latched=latched)}
        channel = self._channels[topic] = self._writer.register_channel(topic, "cdr", schema, profile)
        return channel


def describe(scene: Scene) -> dict[str, str]:
    """Return the metadata of a record."""
    return {
        "version": str(VERSION),
        "mission": scene.mission,
        "seed": str(scene.seed),
        "run": scene.run.value,
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "source": json.dumps(scene.source),
        "software": json.dumps(dict(scene.software)),
        "messages": PACKAGE,
    }


def _quality(*, latched: bool) -> str:
    """Return the quality of service that a topic is offered with, as rosbag2 writes it: YAML, of which JSON is part."""
    profile = {
        "history": 1,  # keep last
        "depth": 1 if latched else 10,
        "reliability": 1,  # reliable
        "durability": 1 if latched else 2,  # transient local, volatile
        "deadline": _FOREVER,
        "lifespan": _FOREVER,
        "liveliness": 1,  # automatic
        "liveliness_lease_duration": _FOREVER,
        "avoid_ros_namespace_conventions": False,
    }
    return json.dumps([profile])
