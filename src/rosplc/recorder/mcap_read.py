"""Reading MCAP files that may be cut off, damaged or hostile.

:func:`survey` finds where chunks lie and what topics there are: from the summary, or, where that is missing
or does not add up, by going through the file from the front. Chunks are read where they are needed. Nothing
in a file is believed: lengths are compared with what is there before memory is asked for, chunks are
decompressed with a bound, and checksums are compared.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, cast

import lz4.frame
import zstandard
from mcap.exceptions import InvalidMagic, McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Footer, Header, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader

from rosplc.errors import RecordingError
from rosplc.ros.plain_file import unreadable_kind

__all__ = ["MAX_CHUNK", "FileMessage", "Part", "Survey", "read_part", "survey"]

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
