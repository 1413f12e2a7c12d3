"""Stores chunks in one file or in several of limited size or time, alone or as a rosbag2 folder; and repair.

rosbag2's storage plugin for MCAP stores a topic's QoS in the channel's metadata, and the content of
``metadata.yaml`` also in a metadata record named ``rosbag2``. Version 8 of that format is written, the last
one with numbers for QoS policies: Humble and Iron read no later version, and later releases read it, too.
"""

from __future__ import annotations

import errno
import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from rosplc.errors import RecordingError
from rosplc.recorder.mcap_file import Batch, ChannelInfo, McapFile, SealedChunk, read_part, seal, survey
from rosplc.ros import DEFAULT, Qos

RECORD_NAME = "rosbag2"
_VERSION = 8
# rmw/types.h: rmw_qos_*_policy_e; 0 stands for the middleware's own default.
_KEEP_LAST = 1
_RELIABILITY = {"reliable": 1, "best_effort": 2}
_DURABILITY = {"transient_local": 1, "volatile": 2}
_AUTOMATIC = 1


def qos_text(qos: Qos) -> str:
    """Return ``offered_qos_profiles`` for the QoS of a topic's publisher."""
    profile = {
        "history": _KEEP_LAST,
        "depth": qos.depth,
        "reliability": _RELIABILITY[qos.reliability],
        "durability": _DURABILITY[qos.durability],
        "deadline": _time(qos.deadline_ns),
        "lifespan": _time(qos.lifespan_ns),
        "liveliness": _AUTOMATIC if qos.lease_ns else 0,
        "liveliness_lease_duration": _time(qos.lease_ns),
        "avoid_ros_namespace_conventions": False,
    }
    return to_yaml([profile]).rstrip("\n")


def qos_of_text(text: str) -> Qos:
    """Return the QoS of the first publisher in ``offered_qos_profiles``, otherwise the default.

    Deadlines and leases are not included: a replay may be slower than they allow.
    """
    try:
        profile = yaml.safe_load(text)[0]
        reliability, durability = str(profile["reliability"]), str(profile["durability"])
        depth = int(profile["depth"])
    except (yaml.YAMLError, RecursionError, LookupError, TypeError, ValueError):
        return DEFAULT
    return Qos(
        reliability="best_effort" if reliability in ("2", "best_effort") else "reliable",
        durability="transient_local" if durability in ("1", "transient_local") else "volatile",
        depth=min(max(depth, DEFAULT.depth), 10_000),
    )


def to_yaml(value: Any) -> str:
    """Return YAML without references between equal parts, which rosbag2 does not expect."""
    return yaml.dump(value, Dumper=_Plain, sort_keys=False, allow_unicode=True)


class _Plain(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def _time(ns: int) -> Mapping[str, int]:
    return {"sec": ns // 10**9, "nsec": ns % 10**9}


SUFFIX = ".mcap"


def base_of(output: Path) -> Path:
    """Return a path without its ``.mcap``."""
    return output.with_name(output.name.removesuffix(SUFFIX)) if output.name != SUFFIX else output


def dated(base: Path, time_ns: int) -> Path:
    """Return ``base_2026-03-28_14-05-09``, by local time."""
    text = time.strftime("%Y-%m-%d_%H-%M-%S", time.localtime(time_ns / 1e9))
    return base.with_name(f"{base.name}_{text}")


def free_name(base: Path) -> Path:
    """Return a base that no file or folder has; a number is appended if needed."""
    taken, number = base, 1
    while any(map(os.path.lexists, (taken, file_name(taken), file_name(taken, 0)))):
        number += 1
        taken = base.with_name(f"{base.name}-{number}")
    return taken


def file_name(base: Path, part: int | None = None) -> Path:
    """Return the file name for a base, or for one of its parts: ``base_0.mcap``."""
    return base.with_name(f"{base.name}{'' if part is None else f'_{part}'}{SUFFIX}")


METADATA = "rosplc"  # name of the metadata record that tells what was lost

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclass(frozen=True)
class Split:
    """The limits at which a new file begins; 0 for none."""

    size: int = 0
    time_ns: int = 0


@dataclass(frozen=True)
class Written:
    """A finished file."""

    path: Path
    size: int  # bytes
    start_ns: int  # the earliest log time, ``end_ns`` the latest; 0 without messages
    end_ns: int
    counts: Mapping[str, int]  # topic → messages
    complete: bool  # whether it has its summary

    @property
    def messages(self) -> int:
        """Number of messages of all topics."""
        return sum(self.counts.values())

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {
            "path": str(self.path),
            "bytes": self.size,
            "start_ns": self.start_ns,
            "end_ns": self.end_ns,
            "messages": self.messages,
            "topics": dict(self.counts),
            "complete": self.complete,
        }


class FileStore:
    """Writes chunks into files; used by one thread at a time.

    ``base`` is the file's path without ``.mcap``, or that of the folder; ``bag`` makes it a folder with
    ``metadata.yaml`` (of ``distro``), as `ros2 bag record` does. ``channels``, channel id → description, may
    grow; ``facts`` returns the metadata record: called often, written when it has changed. The class and
    its methods raise RecordingError REC001 if a file cannot be created, REC002 if the disk is full; existing
    files stay readable.
    """

    def __init__(
        self,
        base: Path,
        channels: Mapping[int, ChannelInfo],
        facts: Callable[[], Mapping[str, str]],
        *,
        split: Split | None = None,
        bag: bool = False,
        distro: str = "",
    ) -> None:
        self._base, self._channels, self._facts = base, channels, facts
        self._split = split or Split()
        self._bag, self._distro = bag, distro
        self._counts: Counter[int] = Counter()
        self._said: Mapping[str, str] = {}
        self.written: list[Written] = []  # the files that are finished
        # channel id → messages that gave way to the end of a file, on a full disk
        self.taken_back: Counter[int] = Counter()
        if bag:
            with _writing(base):
                base.mkdir(parents=True)
            self._write_metadata()
        self._file: McapFile | None = self._open()

    @property
    def size(self) -> int:
        """Total bytes written to all files."""
        return sum(file.size for file in self.written) + (0 if self._file is None else self._file.size)

    def take(self, chunk: SealedChunk) -> None:
        """Write a chunk."""
        file, split = self._file, self._split
        assert file is not None
        too_large = split.size and file.size + len(chunk.blob) > split.size
        too_long = split.time_ns and chunk.index.message_end_time - file.start_ns >= split.time_ns
        if file.messages and (too_large or too_long):
            self._close(file)
            file = self._file = self._open()
        with _writing(file.path):
            for channel in chunk.counts:
                file.declare(self._channels[channel])
            file.append(chunk)
            for name, facts in self._news().items():
                file.add_metadata(name, facts)
                self._said = facts

    def finish(self) -> None:
        """Finish the last file; a second call does nothing."""
        if self._file is not None:
            self._close(self._file)

    def discard(self) -> None:
        """Remove the finished files, which are empty. Raises RecordingError REC001."""
        with _writing(self._base):
            for one in self.written:
                one.path.unlink()
            if self._bag:
                (self._base / "metadata.yaml").unlink()
                self._base.rmdir()

    def _open(self) -> McapFile:
        parts = self._bag or self._split != Split()
        base = self._base / self._base.name if self._bag else self._base
        path = file_name(base, len(self.written) if parts else None)
        with _writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            file = McapFile(path)
            try:
                # Without a record of this name, newer releases of rosbag2 read QoS as a newer format.
                file.add_metadata(RECORD_NAME, self._information(file))
            except OSError:
                file.close()
                raise
        self._said = {}
        return file

    def _news(self) -> dict[str, Mapping[str, str]]:
        """Return the metadata record with facts that are not yet in the file."""
        facts = self._facts()
        return {METADATA: facts} if facts != self._said else {}

    def _close(self, file: McapFile) -> None:
        self._file = None

        def last_words() -> dict[str, Mapping[str, str]]:
            self.taken_back |= file.taken_back
            return {**self._news(), RECORD_NAME: self._information(file)}

        try:
            with _writing(file.path):
                file.finish(last_words)
        finally:
            self.written.append(self._summary(file))
            self._counts.update(file.counts)
        if self._bag:
            self._write_metadata()

    def _summary(self, file: McapFile) -> Written:
        counts: Counter[str] = Counter()
        for channel, count in file.counts.items():
            counts[self._channels[channel].topic] += count
        return Written(file.path, file.size, file.start_ns, file.end_ns, counts, file.finished)

    def _information(self, file: McapFile) -> dict[str, str]:
        return {"serialized_metadata": to_yaml(self._contents([self._summary(file)], file.counts))}

    def _contents(self, files: list[Written], counts: Mapping[int, int]) -> dict[str, Any]:
        """Return the content of ``metadata.yaml``, below its only key."""
        channels = dict(self._channels)
        topics = [(channels[number], counts[number]) for number in sorted(channels) if number in counts]
        distros = (one.metadata.get("rosplc.distro", "") for one in channels.values())
        filled = [file for file in files if file.messages]
        start = min((file.start_ns for file in filled), default=0)
        end = max((file.end_ns for file in filled), default=0)
        return {
            "version": _VERSION,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": end - start},
            "starting_time": {"nanoseconds_since_epoch": start},
            "message_count": sum(file.messages for file in files),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": channel.topic,
                        "type": channel.schema_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": channel.metadata.get("offered_qos_profiles", ""),
                        "type_description_hash": channel.metadata.get("topic_type_hash", ""),
                    },
                    "message_count": count,
                }
                for channel, count in topics
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file.path.name for file in files],
            "files": [
                {
                    "path": file.path.name,
                    "starting_time": {"nanoseconds_since_epoch": file.start_ns},
                    "duration": {"nanoseconds": file.end_ns - file.start_ns},
                    "message_count": file.messages,
                }
                for file in files
            ],
            "custom_data": {},
            "ros_distro": self._distro or next(distros, ""),
        }

    def _write_metadata(self) -> None:
        path = self._base / "metadata.yaml"
        with _writing(path):
            temporary = path.with_suffix(".tmp")
            contents = {"rosbag2_bagfile_information": self._contents(self.written, self._counts)}
            temporary.write_text(to_yaml(contents), encoding="utf-8")
            temporary.replace(path)


def try_place(base: Path) -> None:
    """Create the folder of a later file, and try to create a file in it; REC001 or REC002 if that fails."""
    with _writing(base.parent):
        base.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=base.parent):
            pass


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Convert a failed write to a RecordingError: REC002 if the disk is full, otherwise REC001."""
    try:
        yield
    except OSError as error:
        if error.errno in _FULL:
            raise RecordingError("REC002", f"cannot write: {error.strerror}", where=str(path)) from error
        what = error.strerror or str(error)
        if isinstance(error, FileExistsError):
            what = "a file with this name already exists and is not overwritten"
        raise RecordingError("REC001", what, where=str(path)) from error


_REPAIR = "rosplc.repair"


@dataclass(frozen=True)
class Repaired:
    """The result of a repair."""

    path: Path  # the new file
    messages: int
    topics: dict[str, int]  # topic → messages
    problem: str  # what was wrong with the old file; empty if nothing
    damaged: int  # parts of it that could not be read


def repair(source: Path, target: Path, look: Callable[[int], None] = lambda _: None) -> Repaired:
    """Copy every readable message, with its topic and times, into a new and complete file.

    ``look`` is called from time to time with the number of saved messages. Raises RecordingError REC003 if
    nothing in the file can be read, REC001 or REC002 if the new file cannot be written.
    """
    found = survey(source, count=True)
    infos = {}
    for number, channel in found.channels.items():
        schema = found.schemas.get(channel.schema_id)
        if schema is not None:  # without one it is unknown what its messages are
            infos[number] = ChannelInfo(
                number, channel.topic, schema.name, schema.encoding, schema.data,
                channel.message_encoding, channel.metadata,
            )  # fmt: skip
    topics: Counter[str] = Counter()
    with _writing(target):
        file = McapFile(target, found.profile)
        try:
            for metadata in found.metadata:
                if metadata.name == METADATA:
                    file.add_metadata(metadata.name, metadata.metadata)
            for part in found.parts:
                batch = Batch()
                for one in read_part(source, part):
                    if one.channel_id in infos:
                        file.declare(infos[one.channel_id])
                        batch.add(one.channel_id, one.sequence, one.log_time, one.publish_time, one.data)
                        topics[infos[one.channel_id].topic] += 1
                if batch:
                    file.append(seal(batch, "zstd"))
                look(file.messages)
            if found.problem:
                damage = {"problem": found.problem, "damaged_parts": str(len(found.damaged))}
                file.add_metadata(_REPAIR, damage)
        finally:
            file.finish()
    if not file.messages:
        target.unlink()
        what = found.problem or "the file has no messages"
        remedy = "The file contains no complete message: use another copy, or record again."
        raise RecordingError("REC003", f"nothing to save: {what}", where=str(source), remedy=remedy)
    return Repaired(target, file.messages, topics, found.problem, len(found.damaged))
