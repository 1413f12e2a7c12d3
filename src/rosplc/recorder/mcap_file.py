"""MCAP files: written chunk by chunk, and read although they may be cut off, damaged or hostile.

The library's records are used, its ``Writer`` is not: a ring buffer keeps chunks that are finished and
compressed, and puts them into a file when something has happened; the ``Writer`` takes messages only, and
costs seven times as much per message, which at 20 topics × 1 kHz decides whether the reader keeps up.

A file is good at every moment: what is written is whole records, and one that the disk has no room for is
taken back. Only :meth:`McapFile.finish` adds the summary, so a file without one was cut off.

:func:`survey` finds where chunks are and what topics there are: from the summary, or, where that is missing
or does not add up, by going through the file from the front. Nothing in a file is believed: lengths are
compared with what is there before memory is asked for, chunks are decompressed with a bound, and checksums
are compared.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Literal, cast

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.exceptions import InvalidMagic, McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from rosplc._version import __version__
from rosplc.errors import RecordingError
from rosplc.ros.plain_file import unreadable_kind

_OPCODE = 0x05
_FIXED = 22  # channel id, sequence, two times
_HEAD = struct.Struct("<BQHIQQ").pack


class Batch:
    """The messages of one chunk to be.

    Attributes:
        data: Message records.
        index: Channel id → log time and offset in ``data`` of each of its messages, alternating.
        start_ns: The earliest log time.
        end_ns: The latest.
    """

    __slots__ = ("data", "end_ns", "index", "start_ns")

    def __init__(self) -> None:
        self.data = bytearray()
        self.index: dict[int, list[int]] = {}
        self.start_ns = 0
        self.end_ns = 0

    def __bool__(self) -> bool:
        return bool(self.data)

    def add(self, channel: int, sequence: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        """Add a message.

        Args:
            channel: Its channel's id, from 1 to 65535.
            sequence: Its number, 32 bits.
            log_ns: When it was taken (ns since 1970).
            publish_ns: When its source sent it (ns since 1970).
            payload: Its bytes.
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
        data += _HEAD(_OPCODE, _FIXED + len(payload), channel, sequence, log_ns, publish_ns)
        data += payload

    def counts(self) -> dict[int, int]:
        """Return channel id → messages."""
        return {channel: len(places) // 2 for channel, places in self.index.items()}


Compression = Literal["zstd", "lz4", "none"]
COMPRESSIONS: tuple[Compression, ...] = ("zstd", "lz4", "none")
_LEVEL = 1  # of zstd: three times as fast as its default, and hardly larger on messages
_MOST_TAKEN_BACK = 64


@dataclass(frozen=True)
class ChannelInfo:
    """A channel of a file, as everything that stands before its messages.

    Attributes:
        id: From 1 to 65535, the same in every file of a recording.
        topic: The topic.
        schema_name: The type, ``package/msg/Name``.
        schema_encoding: ``ros2msg``.
        schema: The definition.
        encoding: How messages are serialized, ``cdr``.
        metadata: What else is known of it.
    """

    id: int
    topic: str
    schema_name: str
    schema_encoding: str
    schema: bytes
    encoding: str
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class SealedChunk:
    """A finished chunk: the bytes that a file gets, and what its summary needs to know.

    Attributes:
        blob: The Chunk record, and the MessageIndex records behind it.
        chunk_length: Bytes of the Chunk record.
        index_offsets: Channel id → where in ``blob`` its MessageIndex stands.
        start_ns: The earliest log time.
        end_ns: The latest.
        compression: As the record names it.
        compressed_size: Bytes inside.
        uncompressed_size: Bytes that they stand for.
        counts: Channel id → messages.
    """

    blob: bytes
    chunk_length: int
    index_offsets: Mapping[int, int]
    start_ns: int
    end_ns: int
    compression: str
    compressed_size: int
    uncompressed_size: int
    counts: Mapping[int, int]


def seal(batch: Batch, compression: Compression) -> SealedChunk:
    """Compress and index a batch that holds at least one message."""
    raw = bytes(batch.data)
    packed, name = _compress(raw, compression)
    builder = RecordBuilder()
    Chunk(
        compression=name,
        data=packed,
        message_start_time=batch.start_ns,
        message_end_time=batch.end_ns,
        uncompressed_crc=zlib.crc32(raw),
        uncompressed_size=len(raw),
    ).write(builder)
    length = builder.count
    offsets = {}
    for channel, places in sorted(batch.index.items()):
        offsets[channel] = builder.count
        MessageIndex(channel, list(zip(places[::2], places[1::2], strict=True))).write(builder)
    return SealedChunk(
        blob=_ended(builder),
        chunk_length=length,
        index_offsets=offsets,
        start_ns=batch.start_ns,
        end_ns=batch.end_ns,
        compression=name,
        compressed_size=len(packed),
        uncompressed_size=len(raw),
        counts=batch.counts(),
    )


def _compress(raw: bytes, compression: Compression) -> tuple[bytes, str]:
    if compression == "zstd":
        return zstandard.ZstdCompressor(level=_LEVEL).compress(raw), "zstd"
    if compression == "lz4":
        return bytes(lz4.frame.compress(raw)), "lz4"
    return raw, ""


@dataclass
class _Contents:
    """What the summary will say."""

    schemas: dict[tuple[str, bytes], Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)


class McapFile:
    """A file that is being written.

    Args:
        path: Where; there must be nothing at this name yet.
        profile: What readers may rely on, ``ros2``.

    Attributes:
        path: As given.
        size: Bytes, whole records only.
        finished: Whether the summary is written.
        taken_back: Channel id → messages that gave way to the summary.

    Raises:
        OSError: It cannot be created, or written; also from the other methods.
    """

    def __init__(self, path: Path, profile: str = "ros2") -> None:
        self.path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self.size = 0
        self.finished = False
        self.taken_back: dict[int, int] = {}
        self._contents = _Contents()
        self._chunk_counts: deque[Mapping[int, int]] = deque(maxlen=_MOST_TAKEN_BACK)
        try:
            self._write(MCAP0_MAGIC + _bytes(Header(profile, f"rosplc {__version__}")))
        except OSError:
            self.close()
            path.unlink(missing_ok=True)  # not even a beginning
            raise

    @property
    def counts(self) -> dict[int, int]:
        """Channel id → messages written."""
        return self._contents.counts

    @property
    def messages(self) -> int:
        """Messages written."""
        return sum(self._contents.counts.values())

    @property
    def start_ns(self) -> int:
        """The earliest log time; 0 without messages."""
        return min((chunk.message_start_time for chunk in self._contents.chunks), default=0)

    @property
    def end_ns(self) -> int:
        """The latest log time; 0 without messages."""
        return max((chunk.message_end_time for chunk in self._contents.chunks), default=0)

    def declare(self, channel: ChannelInfo) -> None:
        """Write a channel and its schema, if they are not there yet."""
        contents = self._contents
        if channel.id in contents.channels:
            return
        key = (channel.schema_name, channel.schema)
        records: list[McapRecord] = []
        if (schema := contents.schemas.get(key)) is None:
            number = len(contents.schemas) + 1
            schema = Schema(
                id=number, data=channel.schema, encoding=channel.schema_encoding, name=channel.schema_name
            )
            records.append(schema)
        record = Channel(channel.id, channel.topic, channel.encoding, dict(channel.metadata), schema.id)
        records.append(record)
        self._write(b"".join(_bytes(one) for one in records))
        contents.schemas[key] = schema
        contents.channels[channel.id] = record

    def append(self, chunk: SealedChunk) -> None:
        """Write a chunk, whose channels were declared."""
        start = self.size
        self._write(chunk.blob)
        contents = self._contents
        contents.chunks.append(
            ChunkIndex(
                chunk_length=chunk.chunk_length,
                chunk_start_offset=start,
                compression=chunk.compression,
                compressed_size=chunk.compressed_size,
                message_end_time=chunk.end_ns,
                message_index_length=len(chunk.blob) - chunk.chunk_length,
                message_index_offsets={
                    channel: start + offset for channel, offset in chunk.index_offsets.items()
                },
                message_start_time=chunk.start_ns,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        self._chunk_counts.append(chunk.counts)
        for channel, count in chunk.counts.items():
            contents.counts[channel] = contents.counts.get(channel, 0) + count

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a Metadata record."""
        data = _bytes(Metadata(name, dict(values)))
        start = self.size
        self._write(data)
        self._contents.metadata.append(MetadataIndex(length=len(data), name=name, offset=start))

    def finish(self, last_words: Callable[[], Mapping[str, Mapping[str, str]]] = dict) -> None:
        """Write metadata and the summary, and close the file.

        On a full disk the last chunks make room for them: tools that need a summary are many, and a second
        of messages is little. :attr:`taken_back` then has their messages.

        Args:
            last_words: Returns metadata records, name → values; asked again when a chunk has made room.

        Raises:
            OSError: There was no room for it all the same; the file is closed, and readable from the front.
        """
        try:
            while not self.finished:
                try:
                    for name, values in last_words().items():
                        self.add_metadata(name, values)
                    end = _bytes(DataEnd(0))
                    self._write(end + self._summary(self.size + len(end)))
                    self.finished = True
                except OSError:
                    if not self._chunk_counts:
                        raise
                    self._take_back()
        finally:
            self.close()

    def _take_back(self) -> None:
        """Remove the last chunk, and what stands behind it."""
        contents = self._contents
        last = contents.chunks.pop()
        self.size = last.chunk_start_offset
        os.ftruncate(self._fd, self.size)
        os.lseek(self._fd, self.size, os.SEEK_SET)
        contents.metadata = [one for one in contents.metadata if one.offset < self.size]
        for channel, count in self._chunk_counts.pop().items():
            contents.counts[channel] -= count
            self.taken_back[channel] = self.taken_back.get(channel, 0) + count

    def close(self) -> None:
        """Close the file as it stands; harmless twice."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def sync(self) -> None:
        """Wait until the disk has it."""
        os.fdatasync(self._fd)

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._fd, rest) :]
        except OSError:
            # Half a record helps nobody, and its room may be enough for the summary.
            os.ftruncate(self._fd, self.size)
            os.lseek(self._fd, self.size, os.SEEK_SET)
            raise
        self.size += len(data)

    def _summary(self, start: int) -> bytes:
        contents = self._contents
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, list(contents.schemas.values())),
            (Opcode.CHANNEL, list(contents.channels.values())),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, list(contents.chunks)),
            (Opcode.METADATA_INDEX, list(contents.metadata)),
        ]
        builder, offsets = RecordBuilder(), []
        for opcode, records in groups:
            before = builder.count
            for record in records:
                record.write(builder)
            if records:
                offsets.append(
                    SummaryOffset(
                        group_opcode=opcode, group_start=start + before, group_length=builder.count - before
                    )
                )
        offsets_at = start + builder.count
        for offset in offsets:
            offset.write(builder)
        summary = _ended(builder)
        # The checksum covers the summary and the footer up to the checksum itself.
        footer = _bytes(Footer(start, offsets_at, 0))
        crc = zlib.crc32(footer[:-4], zlib.crc32(summary))
        return summary + footer[:-4] + crc.to_bytes(4, "little") + MCAP0_MAGIC

    def _statistics(self) -> Statistics:
        contents = self._contents
        return Statistics(
            attachment_count=0,
            channel_count=len(contents.channels),
            channel_message_counts=dict(contents.counts),
            chunk_count=len(contents.chunks),
            message_count=self.messages,
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=len(contents.metadata),
            schema_count=len(contents.schemas),
        )


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return _ended(builder)


def _ended(builder: RecordBuilder) -> bytes:
    return bytes(builder.end())  # type: ignore[no-untyped-call]


MAX_CHUNK = 256 << 20
"""Bytes that a chunk may stand for; writers make chunks of about a megabyte."""

_DAMAGE = (
    McapError, EOFError, struct.error, ValueError, KeyError, IndexError, OverflowError, TypeError,
    MemoryError, RuntimeError, zstandard.ZstdError,
)  # fmt: skip
_NO_MCAP = "Give an .mcap file; `rosplc replay` takes .bag and .db3 files as well, by their names."
_HOPELESS = "Nothing of it can be saved: use another copy of it, or record again."
_LOOSE = 1 << 20  # messages outside of chunks are read together in parts of about this size


@dataclass(frozen=True)
class Part:
    """A part of a file that has messages: a chunk, or messages that stand outside of chunks.

    Attributes:
        offset: Where it begins.
        end: Where it ends.
        start_ns: The earliest log time in it.
        end_ns: The latest.
    """

    offset: int
    end: int
    start_ns: int
    end_ns: int


@dataclass(frozen=True)
class FileMessage:
    """A message as it stands in a file; times in ns since 1970."""

    channel: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


@dataclass
class Survey:
    """What a file holds.

    Attributes:
        path: The file.
        profile: As the header says.
        schemas: By id.
        channels: By id.
        metadata: Metadata records, in their order.
        parts: Where messages are, in the order of the file.
        counts: Channel id → messages; empty where the file does not say and was not counted.
        complete: Whether the file ends as it should.
        problem: Why it does not.
        damaged: Parts that cannot be read; :func:`survey` finds them only if it has to look inside.
    """

    path: Path
    profile: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    complete: bool = False
    problem: str = ""
    damaged: list[Part] = field(default_factory=list)


class _Cut(EOFError):
    """The file ends within a record."""


class _Bounded:
    """A file that gives what is asked for, or nothing: a length in a damaged file asks for any amount."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size = file, size

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def read(self, length: int = -1) -> bytes:
        rest = self._size - self._file.tell()
        if not 0 <= length <= rest:
            raise _Cut(f"a length of {length} bytes, where {rest} are left")
        return self._file.read(length)

    def tell(self) -> int:
        return self._file.tell()


def survey(path: Path, *, count: bool = False) -> Survey:
    """Go through a file and return what it holds.

    Args:
        path: The file.
        count: Look into every chunk, also where a summary says what is in it: finds damage.

    Raises:
        RecordingError: REC003, it is no MCAP file or cannot be opened. A file that is cut off or damaged
            behind its beginning is no error: ``complete`` is False.
    """
    found = Survey(path)
    what, remedy = unreadable_kind(path, folder=False)
    if what:
        raise RecordingError("REC003", what, where=str(path), remedy=remedy)
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            stream = _Bounded(file, size)
            if not count and _trust_summary(found, stream):
                return found
            file.seek(0)
            _walk(found, stream)
            if count or not found.complete or not found.channels:
                _look_inside(found)
    except OSError as error:
        raise _failed(error, path) from error
    return found


def read_part(path: Path, part: Part) -> list[FileMessage]:
    """Return the messages of a part, in the order of the file.

    Raises:
        RecordingError: REC003, it is damaged.
    """
    try:
        return [_message(record) for record in _records(path, part) if isinstance(record, Message)]
    except _DAMAGE as error:
        what = f"damaged between bytes {part.offset} and {part.end}: {_words(error)}"
        raise RecordingError("REC003", what, where=str(path)) from error
    except OSError as error:
        raise _failed(error, path) from error


def _failed(error: OSError, path: Path) -> RecordingError:
    what = error.strerror or str(error)
    return RecordingError("REC003", what, where=str(path), remedy="Check permissions, and the disk it is on.")


def _trust_summary(found: Survey, stream: _Bounded) -> bool:
    """Take everything from the summary; False, and nothing taken, if there is none that adds up."""
    try:
        reader = SeekingReader(cast("BinaryIO", stream), record_size_limit=None)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            return False
        indexed = sum(
            (index.message_index_length - 15 * len(index.message_index_offsets)) // 16
            for index in summary.chunk_indexes
        )
        if summary.statistics.message_count != indexed:  # messages without an index, or outside of chunks
            return False
        metadata = list(reader.iter_metadata())
        profile = reader.get_header().profile
    except (*_DAMAGE, OSError):  # a file shorter than a footer cannot be read from its end
        return False
    found.profile, found.metadata = profile, metadata
    found.schemas, found.channels = dict(summary.schemas), dict(summary.channels)
    found.counts = dict(summary.statistics.channel_message_counts)
    found.parts = [
        Part(
            index.chunk_start_offset,
            index.chunk_start_offset + index.chunk_length,
            index.message_start_time,
            index.message_end_time,
        )
        for index in summary.chunk_indexes
    ]
    found.complete = True
    return True


def _walk(found: Survey, stream: _Bounded) -> None:
    """Go through the records at the top level."""
    records = _stream(stream).records
    loose: list[tuple[int, int, int]] = []
    offset = stream.tell()
    first = True
    try:
        for record in records:
            if isinstance(record, Chunk):
                _close_loose(found, loose)
                found.parts.append(
                    Part(offset, stream.tell(), record.message_start_time, record.message_end_time)
                )
            elif isinstance(record, Message):
                loose.append((offset, stream.tell(), record.log_time))
                if loose[-1][1] - loose[0][0] > _LOOSE:
                    _close_loose(found, loose)
            elif isinstance(record, Statistics):
                found.counts = dict(record.channel_message_counts)
            elif isinstance(record, Footer):
                found.complete = True
            else:
                _note(found, record)
            offset, first = stream.tell(), False
    except _DAMAGE as error:
        found.complete = False
        if first:
            begun = stream.tell() > 0 and not isinstance(error, InvalidMagic)
            what = "it has no whole record" if begun else "this is no MCAP file"
            remedy = _HOPELESS if begun else _NO_MCAP
            raise RecordingError(
                "REC003", f"{what}: {_words(error)}", where=str(found.path), remedy=remedy
            ) from error
        found.problem = f"it ends, or is damaged, at byte {offset}: {_words(error)}"
    _close_loose(found, loose)


def _note(found: Survey, record: McapRecord) -> None:
    if isinstance(record, Header):
        found.profile = record.profile
    elif isinstance(record, Schema):
        found.schemas.setdefault(record.id, record)
    elif isinstance(record, Channel):
        found.channels.setdefault(record.id, record)
    elif isinstance(record, Metadata):
        found.metadata.append(record)


def _close_loose(found: Survey, loose: list[tuple[int, int, int]]) -> None:
    if loose:
        times = [time for _, _, time in loose]
        found.parts.append(Part(loose[0][0], loose[-1][1], min(times), max(times)))
        loose.clear()


def _look_inside(found: Survey) -> None:
    """Read every part for its channels and counts; parts that cannot be read are damaged."""
    found.counts = {}
    for part in list(found.parts):
        counts: dict[int, int] = {}
        try:
            for record in _records(found.path, part):
                if isinstance(record, Message):
                    counts[record.channel_id] = counts.get(record.channel_id, 0) + 1
                else:
                    _note(found, record)
        except _DAMAGE as error:
            found.damaged.append(part)
            found.parts.remove(part)
            found.problem = found.problem or f"damaged at byte {part.offset}: {_words(error)}"
            continue
        for channel, number in counts.items():
            found.counts[channel] = found.counts.get(channel, 0) + number


def _records(path: Path, part: Part) -> Iterator[McapRecord]:
    with path.open("rb") as file:
        file.seek(part.offset)
        stream = _Bounded(file, part.end)
        for record in _stream(stream, skip_magic=True).records:
            if isinstance(record, Chunk):
                yield from _inside(record)
            else:
                yield record
            if stream.tell() >= part.end:
                return


def _inside(chunk: Chunk) -> Iterator[McapRecord]:
    data = _decompress(chunk)
    inner = BytesIO(data)
    bounded = _Bounded(inner, len(data))
    records = _stream(bounded, skip_magic=True).records
    while bounded.tell() < len(data):
        yield next(records)


def _decompress(chunk: Chunk) -> bytes:
    """Return a chunk's bytes, as many as it says and no more."""
    size = chunk.uncompressed_size
    if size > MAX_CHUNK:
        raise ValueError(f"a chunk claims {size} bytes; {MAX_CHUNK} are the most")
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(BytesIO(chunk.data)).read(size + 1)
    elif chunk.compression == "lz4":
        data = bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1))
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression[:20]!r} is not known")
    if len(data) != size:
        raise ValueError(f"a chunk of {size} bytes has {'more' if len(data) > size else len(data)}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk's checksum is wrong")
    return data


def _stream(stream: _Bounded, *, skip_magic: bool = False) -> StreamReader:
    # It asks for nothing but read().
    return StreamReader(
        cast("BinaryIO", stream), skip_magic=skip_magic, emit_chunks=True, record_size_limit=None
    )


def _message(record: Message) -> FileMessage:
    return FileMessage(record.channel_id, record.sequence, record.log_time, record.publish_time, record.data)


def _words(error: BaseException) -> str:
    return str(error) or type(error).__name__
