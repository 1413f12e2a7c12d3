"""Where chunks go: into one file or several of limited size or time, alone or as a rosbag2 folder; repair.

rosbag2's storage plugin for MCAP puts a topic's QoS into the channel's metadata, and everything that
``metadata.yaml`` says into a metadata record named ``rosbag2`` as well. Version 8 of that format is written,
the last one with numbers for QoS policies: Humble and Iron read no other, and later releases read it too.
"""

from __future__ import annotations

import errno
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from rosplc.errors import RecordingError
from rosplc.recorder.mcap_file import (
    Batch,
    ChannelInfo,
    McapFile,
    SealedChunk,
    Survey,
    read_part,
    seal,
    survey,
)
from rosplc.ros import DEFAULT, Qos

RECORD_NAME = "rosbag2"
_VERSION = 8
# rmw/types.h: rmw_qos_*_policy_e; 0 stands for the middleware's own default.
_KEEP_LAST = 1
_RELIABILITY = {"reliable": 1, "best_effort": 2}
_DURABILITY = {"transient_local": 1, "volatile": 2}
_AUTOMATIC = 1
_UNSET = {"sec": 0, "nsec": 0}


@dataclass(frozen=True)
class BagFile:
    """A file of a bag: its name in the folder, its earliest and latest log time, its messages."""

    name: str
    start_ns: int
    end_ns: int
    messages: int


@dataclass(frozen=True)
class BagTopic:
    """A topic of a bag."""

    name: str
    type_name: str
    qos: str
    type_hash: str
    messages: int


def qos_text(qos: Qos) -> str:
    """Return ``offered_qos_profiles`` for what a topic's publisher offers."""
    profile = {
        "history": _KEEP_LAST,
        "depth": qos.depth,
        "reliability": _RELIABILITY[qos.reliability],
        "durability": _DURABILITY[qos.durability],
        "deadline": _time(qos.deadline_ns),
        "lifespan": _UNSET,
        "liveliness": _AUTOMATIC if qos.lease_ns else 0,
        "liveliness_lease_duration": _time(qos.lease_ns),
        "avoid_ros_namespace_conventions": False,
    }
    return to_yaml([profile]).rstrip("\n")


def qos_of_text(text: str) -> Qos:
    """Return what ``offered_qos_profiles`` says of the first publisher, else the default.

    Only what decides who receives what is taken over: promises about time are not, as a replay may
    be slower than they allow.
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


def bag_information(files: Iterable[BagFile], topics: Iterable[BagTopic], distro: str) -> dict[str, Any]:
    """Return what ``metadata.yaml`` holds."""
    files = list(files)
    filled = [file for file in files if file.messages]
    start = min((file.start_ns for file in filled), default=0)
    end = max((file.end_ns for file in filled), default=0)
    return {
        "rosbag2_bagfile_information": {
            "version": _VERSION,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": end - start},
            "starting_time": {"nanoseconds_since_epoch": start},
            "message_count": sum(file.messages for file in files),
            "topics_with_message_count": [_topic(topic) for topic in topics],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file.name for file in files],
            "files": [_file(file) for file in files],
            "custom_data": {},
            "ros_distro": distro,
        }
    }


def to_yaml(value: Any) -> str:
    """Return YAML, without references between equal parts, which rosbag2 would not expect."""
    return yaml.dump(value, Dumper=_Plain, sort_keys=False, allow_unicode=True)


class _Plain(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def _time(ns: int) -> Mapping[str, int]:
    return {"sec": ns // 10**9, "nsec": ns % 10**9}


def _topic(topic: BagTopic) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": topic.qos,
            "type_description_hash": topic.type_hash,
        },
        "message_count": topic.messages,
    }


def _file(file: BagFile) -> dict[str, Any]:
    return {
        "path": file.name,
        "starting_time": {"nanoseconds_since_epoch": file.start_ns},
        "duration": {"nanoseconds": file.end_ns - file.start_ns},
        "message_count": file.messages,
    }


SUFFIX = ".mcap"


def base_of(output: Path) -> Path:
    """Return a path without its ``.mcap``."""
    return output.with_name(output.name.removesuffix(SUFFIX)) if output.name != SUFFIX else output


def dated(base: Path, time_ns: int) -> Path:
    """Return ``base_2026-03-28_14-05-09``, by local time."""
    text = time.strftime("%Y-%m-%d_%H-%M-%S", time.localtime(time_ns / 1e9))
    return base.with_name(f"{base.name}_{text}")


def free_name(base: Path) -> Path:
    """Return a base that neither a file nor a folder has; a number is put behind it if need be."""
    taken, number = base, 1
    while any(_exists(one) for one in (taken, file_name(taken), file_name(taken, 0))):
        number += 1
        taken = base.with_name(f"{base.name}-{number}")
    return taken


def file_name(base: Path, part: int | None = None) -> Path:
    """Return the file of a base, or one of its parts: ``base_0.mcap``."""
    return base.with_name(f"{base.name}{'' if part is None else f'_{part}'}{SUFFIX}")


def _exists(path: Path) -> bool:
    return path.exists() or path.is_symlink()


METADATA = "rosplc"
"""Name of the metadata record that tells what was lost."""

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclass(frozen=True)
class Split:
    """When a new file begins; 0 for never."""

    size: int = 0
    time_ns: int = 0


@dataclass(frozen=True)
class Written:
    """A file that is finished.

    Attributes:
        path: The file.
        size: Its bytes.
        start_ns: The earliest log time; 0 without messages.
        end_ns: The latest.
        counts: Topic → messages.
        complete: Whether it has its summary.
    """

    path: Path
    size: int
    start_ns: int
    end_ns: int
    counts: Mapping[str, int]
    complete: bool

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {
            "path": str(self.path),
            "bytes": self.size,
            "start_ns": self.start_ns,
            "end_ns": self.end_ns,
            "messages": sum(self.counts.values()),
            "topics": dict(self.counts),
            "complete": self.complete,
        }


class FileStore:
    """Writes chunks into files; used by one thread at a time.

    Args:
        base: The file's path without ``.mcap``, or the folder's.
        channels: Channel id → how files name it; it may grow.
        facts: Returns what the metadata record says; asked often, and written when it changed.
        split: When a new file begins.
        bag: Write a folder with a ``metadata.yaml``, as `ros2 bag record` does.
        distro: The ROS distribution that ``metadata.yaml`` names.

    Attributes:
        written: The files that are finished.
        taken_back: Channel id → messages that gave way to the end of a file, on a full disk.

    Raises:
        RecordingError: REC001, the first file cannot be created; REC002, the disk is full. Also from
            the other methods; the files that there are stay readable.
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
        self._files: list[BagFile] = []
        self._counts: dict[int, int] = {}
        self._said: Mapping[str, str] = {}
        self.written: list[Written] = []
        self.taken_back: dict[int, int] = {}
        if bag:
            try:
                base.mkdir(parents=True)
            except OSError as error:
                raise failure(error, base) from error
            self._write_metadata()
        self._file: McapFile | None = self._open()

    @property
    def size(self) -> int:
        """Bytes written, all files together."""
        return sum(file.size for file in self.written) + (0 if self._file is None else self._file.size)

    @property
    def path(self) -> Path:
        """The file that is being written, or was last."""
        return self._file.path if self._file is not None else self.written[-1].path

    def take(self, chunk: SealedChunk) -> None:
        """Write a chunk."""
        file = self._file
        assert file is not None
        if file.messages and self._due(file, chunk):
            self._close(file)
            file = self._file = self._open()
        try:
            for channel in chunk.counts:
                file.declare(self._channels[channel])
            file.append(chunk)
            self._say(file)
        except OSError as error:
            raise failure(error, file.path) from error

    def finish(self) -> None:
        """Finish the last file; harmless twice."""
        if self._file is not None:
            self._close(self._file)

    def discard(self) -> None:
        """Remove the finished files, because nothing is in them.

        Raises:
            RecordingError: REC001.
        """
        try:
            for one in self.written:
                one.path.unlink()
            if self._bag:
                (self._base / "metadata.yaml").unlink()
                self._base.rmdir()
        except OSError as error:
            raise failure(error, self._base) from error

    def _due(self, file: McapFile, chunk: SealedChunk) -> bool:
        size, time_ns = self._split.size, self._split.time_ns
        return bool(
            (size and file.size + len(chunk.blob) > size)
            or (time_ns and chunk.end_ns - file.start_ns >= time_ns)
        )

    def _open(self) -> McapFile:
        parts = self._bag or self._split != Split()
        base = self._base / self._base.name if self._bag else self._base
        path = file_name(base, len(self.written) if parts else None)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = McapFile(path)
        except OSError as error:
            raise failure(error, path) from error
        try:
            # Without a record of this name, newer releases of rosbag2 read QoS as a newer format.
            file.add_metadata(RECORD_NAME, self._information([BagFile(path.name, 0, 0, 0)], {}))
        except OSError as error:
            file.close()
            raise failure(error, path) from error
        self._said = {}
        return file

    def _say(self, file: McapFile) -> None:
        facts = self._facts()
        if facts != self._said:
            file.add_metadata(METADATA, facts)
            self._said = facts

    def _close(self, file: McapFile) -> None:
        self._file = None

        def last_words() -> dict[str, Mapping[str, str]]:
            for channel, count in file.taken_back.items():
                self.taken_back[channel] = count
            entry = BagFile(file.path.name, file.start_ns, file.end_ns, file.messages)
            facts = self._facts()
            said: dict[str, Mapping[str, str]] = {METADATA: facts} if facts != self._said else {}
            return {**said, RECORD_NAME: self._information([entry], file.counts)}

        failed: OSError | None = None
        try:
            file.finish(last_words)
        except OSError as error:
            failed = error
        self.written.append(self._summary(file))
        self._files.append(BagFile(file.path.name, file.start_ns, file.end_ns, file.messages))
        for channel, count in file.counts.items():
            self._counts[channel] = self._counts.get(channel, 0) + count
        if failed is not None:
            raise failure(failed, file.path) from failed
        if self._bag:
            self._write_metadata()

    def _summary(self, file: McapFile) -> Written:
        counts: dict[str, int] = {}
        for channel, count in file.counts.items():
            topic = self._channels[channel].topic
            counts[topic] = counts.get(topic, 0) + count
        return Written(file.path, file.size, file.start_ns, file.end_ns, counts, file.finished)

    def _information(self, files: list[BagFile], counts: Mapping[int, int]) -> dict[str, str]:
        return {"serialized_metadata": self._yaml(files, counts, whole=False)}

    def _yaml(self, files: list[BagFile], counts: Mapping[int, int], *, whole: bool) -> str:
        topics = [
            BagTopic(
                channel.topic,
                channel.schema_name,
                channel.metadata.get("offered_qos_profiles", ""),
                channel.metadata.get("topic_type_hash", ""),
                counts[number],
            )
            for number, channel in sorted(dict(self._channels).items())
            if number in counts
        ]
        distros = (one.metadata.get("rosplc.distro", "") for one in list(self._channels.values()))
        information = bag_information(files, topics, self._distro or next(distros, ""))
        return to_yaml(information if whole else information["rosbag2_bagfile_information"])

    def _write_metadata(self) -> None:
        path = self._base / "metadata.yaml"
        try:
            temporary = path.with_suffix(".tmp")
            temporary.write_text(self._yaml(self._files, self._counts, whole=True), encoding="utf-8")
            temporary.replace(path)
        except OSError as error:
            raise failure(error, path) from error


def try_place(base: Path) -> None:
    """Make the folder of a file that is written later, and try that a file can be created in it.

    Raises:
        RecordingError: REC001 or REC002, as it would be raised then.
    """
    try:
        base.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=base.parent):
            pass
    except OSError as error:
        raise failure(error, base.parent) from error


def failure(error: OSError, path: Path) -> RecordingError:
    """Return what a failed write means to a person: REC002 where the disk is full, else REC001."""
    if error.errno in _FULL:
        return RecordingError("REC002", f"no room: {error.strerror}", where=str(path))
    if isinstance(error, FileExistsError):
        what = "there is something at this name already, and nothing is overwritten"
    else:
        what = error.strerror or str(error)
    return RecordingError("REC001", what, where=str(path))


_REPAIR = "rosplc.repair"


@dataclass(frozen=True)
class Repaired:
    """What was saved.

    Attributes:
        path: The new file.
        messages: Messages in it.
        topics: Topic → messages.
        problem: What was wrong with the old one; empty if nothing was.
        damaged: Parts of it that could not be read.
    """

    path: Path
    messages: int
    topics: dict[str, int]
    problem: str
    damaged: int


def repair(source: Path, target: Path, look: Callable[[int], None] = lambda _: None) -> Repaired:
    """Copy every message that can be read, with its topic and times, into a new and complete file.

    Args:
        source: The file, which stays as it is.
        target: The new file; there must be nothing at this name yet.
        look: Called now and then with the messages saved so far.

    Raises:
        RecordingError: REC003, nothing of the file can be read; REC001 or REC002, the new one cannot be
            written.
    """
    found = survey(source, count=True)
    try:
        file = McapFile(target, found.profile)
    except OSError as error:
        raise failure(error, target) from error
    infos = _known_channels(found)
    topics: dict[str, int] = {}
    try:
        try:
            for metadata in found.metadata:
                if metadata.name != METADATA:
                    continue
                file.add_metadata(metadata.name, metadata.metadata)
            for part in found.parts:
                batch = Batch()
                for message in read_part(source, part):
                    info = infos.get(message.channel)
                    if info is None:
                        continue
                    file.declare(info)
                    batch.add(
                        message.channel, message.sequence, message.log_ns, message.publish_ns, message.data
                    )
                    topics[info.topic] = topics.get(info.topic, 0) + 1
                if batch:
                    file.append(seal(batch, "zstd"))
                look(file.messages)
            if found.problem:
                file.add_metadata(
                    _REPAIR, {"problem": found.problem, "damaged_parts": str(len(found.damaged))}
                )
        except OSError as error:
            raise failure(error, target) from error
    finally:
        try:
            file.finish()
        except OSError as error:
            raise failure(error, target) from error
    if not file.messages:
        target.unlink()
        what = found.problem or "it has no messages"
        remedy = "No whole message is in it: use another copy of it, or record again."
        raise RecordingError("REC003", f"nothing to save: {what}", where=str(source), remedy=remedy)
    return Repaired(target, file.messages, topics, found.problem, len(found.damaged))


def _known_channels(found: Survey) -> dict[int, ChannelInfo]:
    infos = {}
    for number, channel in found.channels.items():
        schema = found.schemas.get(channel.schema_id)
        if schema is not None:  # without one nobody can tell what its messages are
            infos[number] = ChannelInfo(
                id=number,
                topic=channel.topic,
                schema_name=schema.name,
                schema_encoding=schema.encoding,
                schema=schema.data,
                encoding=channel.message_encoding,
                metadata=channel.metadata,
            )
    return infos
