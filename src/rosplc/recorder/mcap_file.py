"""MCAP files: written chunk by chunk, and read safely even if they are truncated, damaged or hostile.

The library's records are used, but not its ``Writer``: it accepts only messages, while a ring buffer keeps
compressed chunks until a trigger; and it takes seven times as long per message, so that the reader would not
keep up at 20 topics × 1 kHz. A file is valid at every moment: only whole records are written, and a record
that does not fit on the disk is removed. Only :meth:`McapFile.finish` adds the summary, so a file without
one was truncated. :func:`survey` uses the summary or, if it is missing or wrong, goes through the file. No
content of a file is trusted: lengths are checked before memory is allocated, decompression is limited, and
checksums are compared.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple, cast

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.exceptions import InvalidMagic, McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Message, Metadata, MetadataIndex, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from rosplc._version import __version__
from rosplc.errors import RecordingError
from rosplc.ros.plain_file import unreadable_kind

__all__ = [
    "COMPRESSIONS", "MAX_CHUNK", "Batch", "Channel", "ChannelInfo", "ChunkIndex", "Compression", "McapFile",
    "Message", "Part", "Schema", "SealedChunk", "Survey", "read_part", "seal", "survey",
]  # fmt: skip

Compression = Literal["zstd", "lz4", "none"]
COMPRESSIONS: tuple[Compression, ...] = ("zstd", "lz4", "none")
_LEVEL = 1  # of zstd: three times as fast as its default, and hardly larger on messages
_MOST_TAKEN_BACK = 64
_MESSAGE = struct.Struct("<BQHIQQ").pack
_FIXED = 22  # bytes of a message record before its data: channel id, sequence, two times


class Batch:
    """The messages of a future chunk."""

    __slots__ = ("data", "end_ns", "index", "start_ns")

    def __init__(self) -> None:
        self.data = bytearray()  # message records
        # channel id → log time and offset in data of each of its messages, alternating
        self.index: dict[int, list[int]] = {}
        self.start_ns = self.end_ns = 0  # the earliest and the latest log time

    def __bool__(self) -> bool:
        return bool(self.data)

    def add(self, channel: int, sequence: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        """Add a message; ``channel`` is from 1 to 65535, ``sequence`` has 32 bits.

        ``log_ns`` is when it was taken and ``publish_ns`` when its source sent it (ns since 1970).
        """
        data = self.data
        places = self.index.get(channel)
        if places is None:
            places = self.index[channel] = []
        if not data:
            self.start_ns = self.end_ns = log_ns
        elif log_ns > self.end_ns:
            self.end_ns = log_ns
        elif log_ns < self.start_ns:
            self.start_ns = log_ns
        places.append(log_ns)
        places.append(len(data))
        data += _MESSAGE(Opcode.MESSAGE, _FIXED + len(payload), channel, sequence, log_ns, publish_ns)
        data += payload

    def counts(self) -> dict[int, int]:
        """Return channel id → messages."""
        return {channel: len(places) // 2 for channel, places in self.index.items()}


class ChannelInfo(NamedTuple):
    """The description of a channel in a file; ``id`` is from 1 to 65535."""

    id: int
    topic: str
    schema_name: str
    schema_encoding: str
    schema: bytes
    encoding: str
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class SealedChunk:
    """A finished chunk: Chunk and MessageIndex records, an index with offsets from 0, and id → messages."""

    blob: bytes
    index: ChunkIndex
    counts: Mapping[int, int]


def seal(batch: Batch, compression: Compression) -> SealedChunk:
    """Compress and index a batch with at least one message."""
    raw = packed = bytes(batch.data)
    if compression == "zstd":
        packed = zstandard.ZstdCompressor(level=_LEVEL).compress(raw)
    elif compression == "lz4":
        packed = bytes(lz4.frame.compress(raw))
    name = "" if compression == "none" else compression
    builder = RecordBuilder()
    Chunk(name, packed, batch.end_ns, batch.start_ns, zlib.crc32(raw), len(raw)).write(builder)
    length, offsets = builder.count, {}
    for channel, places in sorted(batch.index.items()):
        offsets[channel] = builder.count
        entries = list(zip(places[::2], places[1::2], strict=True))
        records.MessageIndex(channel, entries).write(builder)
    index = ChunkIndex(
        chunk_length=length,
        chunk_start_offset=0,
        compression=name,
        compressed_size=len(packed),
        message_end_time=batch.end_ns,
        message_index_length=builder.count - length,
        message_index_offsets=offsets,
        message_start_time=batch.start_ns,
        uncompressed_size=len(raw),
    )
    return SealedChunk(_ended(builder), index, batch.counts())


class McapFile:
    """A file that is being written; its name must not exist yet. It and its methods raise OSError."""

    def __init__(self, path: Path, profile: str = "ros2") -> None:
        self.path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self.size = 0  # bytes, whole records only
        self.finished = False  # whether the summary is written
        self.counts: Counter[int] = Counter()  # channel id → messages written
        self.taken_back: Counter[int] = Counter()  # channel id → messages that gave way to the summary
        self._schemas: dict[tuple[str, bytes], Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._last: deque[Mapping[int, int]] = deque(maxlen=_MOST_TAKEN_BACK)
        try:
            self._write(MCAP0_MAGIC + _bytes(records.Header(profile, f"rosplc {__version__}")))
        except OSError:
            self.close()
            path.unlink(missing_ok=True)  # not even a beginning
            raise

    @property
    def messages(self) -> int:
        """Number of messages written."""
        return sum(self.counts.values())

    @property
    def start_ns(self) -> int:
        """The earliest log time; 0 without messages."""
        return min((chunk.message_start_time for chunk in self._chunks), default=0)

    @property
    def end_ns(self) -> int:
        """The latest log time; 0 without messages."""
        return max((chunk.message_end_time for chunk in self._chunks), default=0)

    def declare(self, channel: ChannelInfo) -> None:
        """Write a channel and its schema, if not yet written."""
        if channel.id in self._channels:
            return
        key = (channel.schema_name, channel.schema)
        schema, data = self._schemas.get(key), b""
        if schema is None:
            number = len(self._schemas) + 1
            schema = Schema(number, channel.schema, channel.schema_encoding, channel.schema_name)
            data = _bytes(schema)
        record = Channel(channel.id, channel.topic, channel.encoding, dict(channel.metadata), schema.id)
        self._write(data + _bytes(record))
        self._schemas[key], self._channels[channel.id] = schema, record

    def append(self, chunk: SealedChunk) -> None:
        """Write a chunk whose channels were declared."""
        start = self.size
        self._write(chunk.blob)
        offsets = {channel: start + at for channel, at in chunk.index.message_index_offsets.items()}
        self._chunks.append(replace(chunk.index, chunk_start_offset=start, message_index_offsets=offsets))
        self._last.append(chunk.counts)
        self.counts.update(chunk.counts)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a Metadata record."""
        data = _bytes(Metadata(name, dict(values)))
        index = MetadataIndex(length=len(data), name=name, offset=self.size)
        self._write(data)
        self._metadata.append(index)

    def finish(self, last_words: Callable[[], Mapping[str, Mapping[str, str]]] = dict) -> None:
        """Write metadata and the summary, and close the file.

        On a full disk, the last chunks are removed to make room: many tools need a summary, and one second of
        data is a small loss. :attr:`taken_back` then has their messages. ``last_words`` returns metadata, as
        name → values; it is called again after a chunk was removed. Raises OSError without enough room; then
        the file is closed and can be read from its beginning.
        """
        try:
            while not self.finished:
                try:
                    for name, values in last_words().items():
                        self.add_metadata(name, values)
                    end = _bytes(records.DataEnd(0))
                    self._write(end + self._summary(self.size + len(end)))
                    self.finished = True
                except OSError:
                    if not self._last:
                        raise
                    # The last chunk gives way, and what was written after it.
                    self._cut(self._chunks.pop().chunk_start_offset)
                    self._metadata = [one for one in self._metadata if one.offset < self.size]
                    counts = self._last.pop()
                    self.counts.subtract(counts)
                    self.taken_back.update(counts)
        finally:
            self.close()

    def close(self) -> None:
        """Close the file in its current state; a second call does nothing."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def _cut(self, size: int) -> None:
        self.size = size
        os.ftruncate(self._fd, size)
        os.lseek(self._fd, size, os.SEEK_SET)

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._fd, rest) :]
        except OSError:
            # Half a record helps no reader, and its room may be enough for the summary.
            self._cut(self.size)
            raise
        self.size += len(data)

    def _summary(self, start: int) -> bytes:
        statistics = records.Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self._chunks),
            message_count=self.messages,
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: dict[Opcode, Sequence[McapRecord]] = {
            Opcode.SCHEMA: [*self._schemas.values()],
            Opcode.CHANNEL: [*self._channels.values()],
            Opcode.STATISTICS: [statistics],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.METADATA_INDEX: self._metadata,
        }
        builder, offsets = RecordBuilder(), []
        for opcode, group in groups.items():
            before = builder.count
            for record in group:
                record.write(builder)
            if group:
                offsets.append(records.SummaryOffset(opcode, start + before, builder.count - before))
        offsets_at = start + builder.count
        for offset in offsets:
            offset.write(builder)
        summary = _ended(builder)
        # The checksum covers the summary and the footer up to the checksum itself.
        footer = _bytes(records.Footer(start, offsets_at, 0))[:-4]
        crc = zlib.crc32(footer, zlib.crc32(summary))
        return summary + footer + crc.to_bytes(4, "little") + MCAP0_MAGIC


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return _ended(builder)


def _ended(builder: RecordBuilder) -> bytes:
    return bytes(builder.end())  # type: ignore[no-untyped-call]


MAX_CHUNK = 256 << 20  # bytes of the largest chunk, uncompressed; writers make chunks of about a megabyte

_DAMAGE = (
    McapError, EOFError, struct.error, ValueError, KeyError, IndexError, OverflowError, TypeError,
    MemoryError, RuntimeError, zstandard.ZstdError,
)  # fmt: skip
_NO_MCAP = "Specify an .mcap file; `rosplc replay` also accepts .bag and .db3 files."
_HOPELESS = "Nothing in this file can be recovered: use another copy, or record again."
_LOOSE = 1 << 20  # messages outside of chunks are read together in parts of about this size


class Part(NamedTuple):
    """A chunk, or messages outside of chunks: its position, and its earliest and latest log time."""

    offset: int
    end: int
    start_ns: int
    end_ns: int


@dataclass
class Survey:
    """The content of a file."""

    path: Path
    profile: str = ""  # from the header
    schemas: dict[int, Schema] = field(default_factory=dict)  # by id, as are ``channels``
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)  # metadata records, in their order
    parts: list[Part] = field(default_factory=list)  # where messages are, in the order of the file
    # channel id → messages; empty where the file does not have it and was not counted
    counts: Counter[int] = field(default_factory=Counter)
    complete: bool = False  # whether the file ends as it should; ``problem`` is why it does not
    problem: str = ""
    # parts that cannot be read; :func:`survey` finds them only if it has to look inside
    damaged: list[Part] = field(default_factory=list)

    def note(self, record: McapRecord) -> None:
        """Note what a record contains about the whole file."""
        if isinstance(record, records.Header):
            self.profile = record.profile
        elif isinstance(record, Schema):
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            self.channels.setdefault(record.id, record)
        elif isinstance(record, Metadata):
            self.metadata.append(record)
        elif isinstance(record, records.Statistics):
            self.counts = Counter(record.channel_message_counts)
        elif isinstance(record, records.Footer):
            self.complete = True


class _Bounded:
    """A file whose reads return all requested bytes or fail: lengths in a damaged file are arbitrary."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size = file, size
        self.seek, self.tell = file.seek, file.tell

    def read(self, length: int = -1) -> bytes:
        rest = self._size - self._file.tell()
        if not 0 <= length <= rest:
            raise EOFError(f"{length} bytes are expected, but only {rest} are left")
        return self._file.read(length)

    def records(self, *, skip_magic: bool) -> Iterator[McapRecord]:
        # The library asks for nothing but read().
        file = cast("BinaryIO", self)
        return StreamReader(file, skip_magic=skip_magic, emit_chunks=True, record_size_limit=None).records


def survey(path: Path, *, count: bool = False) -> Survey:
    """Return the content of a file; a truncated or damaged file is not ``complete``.

    ``count`` reads every chunk, even if there is a summary, to find damage. Raises RecordingError REC003 if
    it is not an MCAP file or cannot be opened.
    """
    what, remedy = unreadable_kind(path, folder=False)
    if what:
        raise RecordingError("REC003", what, where=str(path), remedy=remedy)
    try:
        with path.open("rb") as file:
            stream = _Bounded(file, path.stat().st_size)
            found = None if count else _summary(path, stream)
            if found is not None:
                return found
            found = Survey(path)
            file.seek(0)
            _walk(found, stream)
            if count or not found.complete or not found.channels:
                _look_inside(found)
    except OSError as error:
        raise _failed(error, path) from error
    return found


def read_part(path: Path, part: Part) -> list[Message]:
    """Return a part's messages, in the order of the file; raises RecordingError REC003 if it is damaged."""
    try:
        return [record for record in _records(path, part) if isinstance(record, Message)]
    except _DAMAGE as error:
        what = f"damaged between bytes {part.offset} and {part.end}: {_words(error)}"
        raise RecordingError("REC003", what, where=str(path)) from error
    except OSError as error:
        raise _failed(error, path) from error


def _failed(error: OSError, path: Path) -> RecordingError:
    what = error.strerror or str(error)
    return RecordingError("REC003", what, where=str(path), remedy="Check its permissions and the disk.")


def _summary(path: Path, stream: _Bounded) -> Survey | None:
    """Return the content according to the summary; None without a consistent summary."""
    try:
        reader = SeekingReader(cast("BinaryIO", stream), record_size_limit=None)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            return None
        lengths = (
            one.message_index_length - 15 * len(one.message_index_offsets) for one in summary.chunk_indexes
        )
        # Messages without an index, or outside of chunks, are not found by it.
        if summary.statistics.message_count != sum(length // 16 for length in lengths):
            return None
        metadata, profile = list(reader.iter_metadata()), reader.get_header().profile
    except (*_DAMAGE, OSError):  # a file shorter than a footer cannot be read from its end
        return None
    parts = [
        Part(
            one.chunk_start_offset,
            one.chunk_start_offset + one.chunk_length,
            one.message_start_time,
            one.message_end_time,
        )
        for one in summary.chunk_indexes
    ]
    counts = Counter(summary.statistics.channel_message_counts)
    return Survey(path, profile, dict(summary.schemas), dict(summary.channels), metadata, parts, counts, True)


def _walk(found: Survey, stream: _Bounded) -> None:
    """Go through the records at the top level."""
    begin = offset = stream.tell()
    loose = False  # whether the last part is one of messages outside of chunks, and may grow
    try:
        for record in stream.records(skip_magic=False):
            if isinstance(record, Chunk):
                start, end = record.message_start_time, record.message_end_time
                found.parts.append(Part(offset, stream.tell(), start, end))
                loose = False
            elif isinstance(record, Message):
                part = Part(offset, stream.tell(), record.log_time, record.log_time)
                if loose:
                    before = found.parts.pop()
                    start, end = min(before.start_ns, part.start_ns), max(before.end_ns, part.end_ns)
                    part = Part(before.offset, part.end, start, end)
                found.parts.append(part)
                loose = part.end - part.offset <= _LOOSE
            else:
                found.note(record)
            offset = stream.tell()
    except _DAMAGE as error:
        found.complete = False
        if offset == begin:
            begun = stream.tell() > 0 and not isinstance(error, InvalidMagic)
            what = "the file contains no complete record" if begun else "this is not an MCAP file"
            remedy = _HOPELESS if begun else _NO_MCAP
            what = f"{what}: {_words(error)}"
            raise RecordingError("REC003", what, where=str(found.path), remedy=remedy) from error
        found.problem = f"the file ends or is damaged at byte {offset}: {_words(error)}"


def _look_inside(found: Survey) -> None:
    """Read every part for its channels and counts; parts that cannot be read are damaged."""
    found.counts = Counter()
    for part in list(found.parts):
        counts: Counter[int] = Counter()
        try:
            for record in _records(found.path, part):
                if isinstance(record, Message):
                    counts[record.channel_id] += 1
                elif isinstance(record, Schema | Channel | Metadata):
                    found.note(record)
        except _DAMAGE as error:
            found.damaged.append(part)
            found.parts.remove(part)
            found.problem = found.problem or f"damaged at byte {part.offset}: {_words(error)}"
        else:
            found.counts.update(counts)


def _records(path: Path, part: Part) -> Iterator[McapRecord]:
    with path.open("rb") as file:
        file.seek(part.offset)
        stream = _Bounded(file, part.end)
        for record in stream.records(skip_magic=True):
            if isinstance(record, Chunk):
                data = _decompress(record)
                inner = _Bounded(BytesIO(data), len(data))
                inside = inner.records(skip_magic=True)
                while inner.tell() < len(data):
                    yield next(inside)
            else:
                yield record
            if stream.tell() >= part.end:
                return


def _decompress(chunk: Chunk) -> bytes:
    """Return a chunk's bytes, exactly as many as declared."""
    size = chunk.uncompressed_size
    if size > MAX_CHUNK:
        raise ValueError(f"the declared size of a chunk is {size} bytes; the limit is {MAX_CHUNK}")
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(BytesIO(chunk.data)).read(size + 1)
    elif chunk.compression == "lz4":
        data = bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1))
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"unknown compression {chunk.compression[:20]!r}")
    if len(data) != size:
        raise ValueError(f"a chunk does not have its declared size of {size} bytes")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("the checksum of a chunk is wrong")
    return data


def _words(error: BaseException) -> str:
    return str(error) or type(error).__name__
