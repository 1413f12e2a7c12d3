"""Saving what is whole of a file that was cut off or damaged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rosplc.errors import RecordingError
from rosplc.recorder.mcap_read import Survey, read_part, survey
from rosplc.recorder.mcap_write import Batch, ChannelInfo, McapFile, seal
from rosplc.recorder.store import METADATA, failure

__all__ = ["Repaired", "repair"]

_OWN = "rosplc.repair"


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
    infos = _infos(found)
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
                file.add_metadata(_OWN, {"problem": found.problem, "damaged_parts": str(len(found.damaged))})
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


def _infos(found: Survey) -> dict[int, ChannelInfo]:
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
