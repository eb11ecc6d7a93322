"""Reads a record: whole files by their index, those that are cut up to the cut, and from any moment on."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple

import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, ChunkIndex, Footer, Header, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk
from mcap.summary import Summary

from covey.errors import RecordError
from covey.runtime.records.mcap_record import METADATA, VERSION, topic_of
from covey.runtime.records.record import RECORD
from covey.runtime.records.record_types import LAYOUTS, decode
from covey.runtime.watching.feed import (
    Health,
    Motion,
    ObstacleAppeared,
    Scene,
    TeamChange,
    TeamState,
    Trading,
    Update,
    Weights,
)
from covey.runtime.watching.view import TeamView

_BROKEN = (
    McapError,
    CRCValidationError,
    struct.error,
    zstandard.ZstdError,
    ValueError,
    KeyError,
    EOFError,
    MemoryError,
)
"""What the library raises where bytes are not what they should be."""

KEPT = 4
"""So many chunks that were read last are kept."""

_CHUNK_HEAD = struct.Struct("<BQQQQII4sQ")
"""Of a chunk with zstd: opcode, length, both times, size, checksum, name of the compression, compressed size."""

_RELATIVE = (TeamChange, Trading, Weights)
"""What means something only together with all before it."""


class Topic(NamedTuple):
    """What is on a topic: the name of its type in ROS 2, and how many messages."""

    type: str
    messages: int


@dataclass(frozen=True)
class _Block:
    """Where a chunk is, its times in nanoseconds, and the channels that have messages in it."""

    offset: int
    start: int
    end: int
    channels: frozenset[int]


class Record:
    """A record on disk; a context that closes the file.

    Parameters
    ----------
    path : str or Path
        An MCAP file that `covey.runtime.records.mcap_record` wrote, or a result directory that has one.

    Attributes
    ----------
    path : Path
    size : int
        Bytes.
    scene : Scene
        The first.
    metadata : mapping of str to str
        Mission, seed, software; see `covey.runtime.records.mcap_record.describe`.
    complete : bool
        Whether the file has its end; otherwise it was cut, or the run was killed.
    read_to : int
        What is read ends at this byte.
    start, end : float
        Times of the first and the last message, seconds.
    topics : mapping of str to Topic

    Raises
    ------
    RecordError
        If there is no such file, it is no MCAP file, not from covey, or cut before the scene.

    Examples
    --------
    >>> Record("nowhere.mcap")
    Traceback (most recent call last):
        ...
    covey.errors.RecordError: nowhere.mcap: no record here; expected what `covey plan` or `covey fly` wrote
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.metadata: Mapping[str, str] = {}
        self.complete = False
        self._damaged: dict[int, str] = {}
        self._classes: dict[int, type[Any]] = {}
        self._blocks: list[_Block] = []
        self._counts = Counter[int]()
        self._torn: Sequence[object] = ()
        self._cached = lru_cache(maxsize=KEPT)(self._chunk)
        self._stream = self._open()
        try:
            self._read_structure()
        except OSError as error:
            self._stream.close()
            raise RecordError(f"{self.path}: cannot be read: {error}") from error
        except BaseException:
            self._stream.close()
            raise

    def __enter__(self) -> Record:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    @property
    def duration(self) -> float:
        """Seconds from the first message to the last."""
        return self.end - self.start

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong with the file, as far as it was read, for people."""
        cut = [] if self.complete else [f"the file ends at byte {self.read_to:,} of {self.size:,} without its index"]
        return (*cut, *self._damaged.values())

    def items(self, kinds: Container[type[Any]] | None = None) -> Iterator[Scene | Update]:
        """Yield what was told, in order.

        After a damaged chunk, what means something only with all before it is left out up to the next `TeamState`.

        Parameters
        ----------
        kinds : container of type, optional
            Only those types.
        """
        yield from self._items(self._blocks, kinds)

    def at(self, time: float) -> TeamView:
        """Return the state at a time, seconds: after all that was told by then."""
        limit = max(time, self.start) + 1e-9
        blocks = [block for block in self._blocks if block.start <= limit * 1e9]
        begin = self._keyframe(blocks, limit)
        view = TeamView()
        for item in self._items(blocks[:begin], (Scene, ObstacleAppeared)):
            view.apply(item)
        scene = None  # it has no time, but is told with what comes after it
        for item in self._items(blocks[begin:], None):
            if isinstance(item, Scene):
                scene = item
                continue
            if item.time > limit:
                break
            if scene is not None:
                view.apply(scene)
                scene = None
            view.apply(item)
        for kind, known in ((Motion, view.motion), (Health, view.health)):
            last = None if known is not None else self._last(kind, blocks[:begin])
            if isinstance(last, Motion):
                view.motion = last
            elif isinstance(last, Health):
                view.health = last
        return view

    # How it is done.

    def _open(self) -> IO[bytes]:
        try:
            if self.path.is_dir():
                self.path = self.path / RECORD
            if self.path.exists() and not self.path.is_file():
                raise RecordError(f"{self.path}: expected a regular file or a result directory")
            self.size = self.path.stat().st_size
            return self.path.open("rb")
        except FileNotFoundError as error:
            raise RecordError(
                f"{self.path}: no record here; expected what `covey plan` or `covey fly` wrote"
            ) from error
        except (OSError, ValueError) as error:
            raise RecordError(f"{str(self.path)!r}: cannot be read: {error}") from error

    def _read_structure(self) -> None:
        channels: dict[int, Channel] = {}
        schemas: dict[int, Schema] = {}
        summary = self._summary()
        if summary is not None:
            self._take_index(summary)
            channels, schemas = summary.channels, summary.schemas
        else:
            self._scan(channels, schemas)
        own = {topic_of(cls): cls for cls in LAYOUTS}
        self._classes = {
            number: own[channel.topic]
            for number, channel in channels.items()
            if channel.topic in own and channel.schema_id in schemas
        }
        if not self._classes and (channels or self.complete):
            raise RecordError(f"{self.path}: expected a record of covey, got another MCAP file")
        self._check_version()
        first = next(self._items(self._blocks[:1], (Scene,)), None)
        if not isinstance(first, Scene):
            why = self.problems[0] if self.problems else "it has no scene"
            raise RecordError(f"{self.path}: nothing of the run can be read: {why}")
        self.scene = first
        self.start = self._blocks[0].start / 1e9
        self.end = max(block.end for block in self._blocks) / 1e9
        self.topics = {
            channel.topic: Topic(schemas[channel.schema_id].name, self._counts[number])
            for number, channel in sorted(channels.items())
            if channel.schema_id in schemas
        }

    def _check_version(self) -> None:
        version = self.metadata.get("version", str(VERSION))
        if version != str(VERSION):
            raise RecordError(f"{self.path}: expected a record of version {VERSION}, got {version!r}")

    def _summary(self) -> Summary | None:
        """Return the index of a complete file."""
        try:
            summary = SeekingReader(self._stream, record_size_limit=self.size).get_summary()
        except (OSError, *_BROKEN):  # too short to look for the end, or the end is not what it should be
            return None
        return summary

    def _take_index(self, summary: Summary) -> None:
        self.complete, self.read_to = True, self.size
        indices: Sequence[ChunkIndex] = sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
        self._blocks = [
            _Block(
                index.chunk_start_offset,
                index.message_start_time,
                index.message_end_time,
                frozenset(index.message_index_offsets),
            )
            for index in indices
        ]
        if summary.statistics is not None:
            self._counts.update(summary.statistics.channel_message_counts)
        for entry in summary.metadata_indexes:
            if entry.name == METADATA:
                try:
                    self._stream.seek(entry.offset)
                    self._take_metadata(next(StreamReader(self._stream, skip_magic=True).records))
                except (OSError, *_BROKEN) as error:
                    self._damaged[entry.offset] = f"the metadata at byte {entry.offset:,} cannot be read: {error}"

    def _take_metadata(self, record: object) -> None:
        if isinstance(record, Metadata) and record.name == METADATA:
            self.metadata = record.metadata

    def _scan(self, channels: dict[int, Channel], schemas: dict[int, Schema]) -> None:
        """Find what there is in a file without an index, up to where it ends or makes no sense any more."""
        self.read_to = 0
        self._stream.seek(0)
        reader = StreamReader(self._stream, emit_chunks=True, record_size_limit=self.size)
        try:
            for record in reader.records:
                start, self.read_to = self.read_to or 8, self._stream.tell()
                if isinstance(record, Header) and record.profile != "ros2":
                    raise RecordError(f"{self.path}: expected a record of covey, got another MCAP file")
                if isinstance(record, Chunk):
                    self._scan_chunk(start, record, channels, schemas)
                self._take_metadata(record)
                if isinstance(record, Footer):
                    break
        except _BROKEN:  # here it was cut
            self._scan_torn(channels, schemas)
        if self.read_to == 0:
            if not self._is_mcap():
                raise RecordError(f"{self.path}: expected an MCAP file, got something else")
            self.read_to = min(self.size, 8)
        self.size = max(self.size, self.read_to)

    def _is_mcap(self) -> bool:
        """Whether the file begins as an MCAP file does, as far as it goes."""
        magic = b"\x89MCAP0\r\n"
        self._stream.seek(0)
        return magic.startswith(self._stream.read(len(magic)))

    def _scan_chunk(self, offset: int, chunk: Chunk, channels: dict[int, Channel], schemas: dict[int, Schema]) -> None:
        self._scan_records(offset, self._broken_up(offset, chunk), channels, schemas)

    def _scan_torn(self, channels: dict[int, Channel], schemas: dict[int, Schema]) -> None:
        """Find what there is in the chunk in which the file ends."""
        self._stream.seek(self.read_to)
        data = self._stream.read()
        self.size = self._stream.tell()  # a run that goes on has written more since the file was opened
        self._torn = torn_records(data)
        if self._torn:
            self._scan_records(self.read_to, self._torn, channels, schemas)
            self.read_to = self.size

    def _scan_records(
        self, offset: int, records: Sequence[object], channels: dict[int, Channel], schemas: dict[int, Schema]
    ) -> None:
        found, times = Counter[int](), list[int]()
        for record in records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                found[record.channel_id] += 1
                times.append(record.log_time)
        self._counts += found
        if found:
            self._blocks.append(_Block(offset, min(times), max(times), frozenset(found)))

    def _broken_up(self, offset: int, chunk: Chunk) -> Sequence[object]:
        """Return what is in a chunk; a damaged one is noted, and nothing is."""
        try:
            return breakup_chunk(chunk, validate_crc=True)
        except _BROKEN as error:
            why = " ".join(str(error).split()) or type(error).__name__
            self._damaged[offset] = f"the chunk at byte {offset:,} is damaged and left out: {why}"
            return ()

    def _chunk(self, block: _Block) -> Sequence[object]:
        if self._torn and block is self._blocks[-1]:
            return self._torn
        reader = StreamReader(self._stream, skip_magic=True, emit_chunks=True, record_size_limit=self.size)
        try:
            self._stream.seek(block.offset)
            record = next(reader.records)
        except (OSError, *_BROKEN) as error:
            self._damaged[block.offset] = f"the chunk at byte {block.offset:,} cannot be read: {error}"
            return ()
        if not isinstance(record, Chunk):
            self._damaged[block.offset] = f"at byte {block.offset:,}: expected a chunk, got {type(record).__name__}"
            return ()
        return self._broken_up(block.offset, record)

    def _items(self, blocks: Sequence[_Block], kinds: Container[type[Any]] | None) -> Iterator[Scene | Update]:
        wanted = {number: cls for number, cls in self._classes.items() if kinds is None or cls in kinds}
        whole = True  # nothing is missing since the last state
        for block in blocks:
            if not wanted.keys() & block.channels:
                continue
            records = self._cached(block)
            whole = whole and block.offset not in self._damaged
            for record in records:
                if not isinstance(record, Message) or record.channel_id not in wanted:
                    continue
                cls = wanted[record.channel_id]
                whole = whole or cls is TeamState
                if not whole and issubclass(cls, _RELATIVE):
                    continue
                try:
                    yield decode(cls, record.data)
                except (ValueError, TypeError) as error:
                    raise RecordError(f"{self.path}: expected a {cls.__name__} of covey: {error}") from error

    def _keyframe(self, blocks: Sequence[_Block], time: float) -> int:
        """Return the last block from which the state at a time can be told."""
        wanted = {number for number, cls in self._classes.items() if cls is TeamState}
        for index in range(len(blocks) - 1, 0, -1):
            if wanted & blocks[index].channels:
                first = next(self._items(blocks[index : index + 1], (TeamState,)), None)
                if isinstance(first, TeamState) and first.time <= time:
                    return index
        return 0

    def _last(self, kind: type[Any], blocks: Sequence[_Block]) -> Scene | Update | None:
        wanted = {number for number, cls in self._classes.items() if cls is kind}
        for block in reversed(blocks):
            if wanted & block.channels:
                found = list(self._items([block], (kind,)))
                if found:
                    return found[-1]
        return None


def torn_records(data: bytes) -> Sequence[object]:
    """Return what can be had of the records in a chunk of which only the beginning is there."""
    if len(data) < _CHUNK_HEAD.size or data[0] != Opcode.CHUNK:
        return ()
    name = _CHUNK_HEAD.unpack_from(data)[7]
    if name != b"zstd":
        return ()
    try:
        text = zstandard.ZstdDecompressor().decompressobj().decompress(data[_CHUNK_HEAD.size :])
    except zstandard.ZstdError:
        return ()
    records: list[object] = []
    at, head = 0, struct.Struct("<BQ")
    while at + head.size <= len(text):
        end = at + head.size + head.unpack_from(text, at)[1]
        if end > len(text):
            break
        try:
            records += breakup_chunk(Chunk("", text[at:end], 0, 0, 0, end - at))
        except _BROKEN:
            break
        at = end
    return records
