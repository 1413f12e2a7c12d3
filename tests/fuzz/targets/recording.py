"""Recordings: MCAP files, damaged or made up, and ROS 1 bags, as ``rosplc replay`` opens them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from typing import Any

from mcap.writer import CompressionType, Writer

from rosplc.errors import BackendError, MessageTypeError, RecordingError
from rosplc.model import TypeStore
from rosplc.recorder.mcap_file import read_part, survey
from rosplc.recorder.source import open_source
from rosplc.recorder.store import qos_of_text
from tests.fuzz.choices import Choices
from tests.fuzz.oracle import refusals
from tests.fuzz.scratch import emptied

__all__ = ["check", "seeds"]

_folder = emptied("recording")
_MOST = 2000


def check(data: bytes) -> None:
    """Whatever the file holds, what can be read is read, and the rest is named."""
    choices = Choices(data)
    if choices.below(8) == 7:
        qos = qos_of_text(choices.rest().decode("utf-8", "replace"))
        assert 1 <= qos.depth <= 10_000
        return
    path = _folder / "one.mcap"
    path.write_bytes(choices.rest())
    with refusals(RecordingError):
        found = survey(path)
        again = survey(path, count=True)
        for part in (*found.parts, *again.parts):
            with refusals(RecordingError):
                assert len(read_part(path, part)) <= len(data)
    with refusals(RecordingError, BackendError, MessageTypeError):
        source = open_source(path)
        for topic in source.topics.values():
            with refusals(MessageTypeError):
                text = getattr(topic, "definition", "")
                TypeStore.bundled("jazzy").with_definition(topic.type_name, str(text))
        for _, _message in zip(range(_MOST), source.messages(list(source.topics), 0, 2**63), strict=False):
            pass
        source.close()


def _file(kind: CompressionType, *, chunked: bool) -> bytes:
    store = TypeStore.bundled("jazzy")
    out = BytesIO()
    writer: Any = Writer(out, compression=kind, use_chunking=chunked, chunk_size=256)
    writer.start("ros2")
    for number, name in enumerate(("std_msgs/msg/String", "geometry_msgs/msg/Twist")):
        schema = writer.register_schema(name, "ros2msg", store.definition_text(name).encode())
        channel = writer.register_channel(
            f"/t{number}", "cdr", schema, {"offered_qos_profiles": "- depth: 5"}
        )
        for time in range(3):
            writer.add_message(channel, time, struct.pack("<4sI4s", b"\0\1\0\0", 4, b"abc"), time)
    writer.add_metadata("rosplc", {"lost": "0"})
    writer.finish()
    return out.getvalue()


def seeds() -> Iterator[bytes]:
    """Sound files of each kind, cut ones, and a QoS."""
    for kind in (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4):
        whole = _file(kind, chunked=True)
        yield b"\0" + whole
        yield b"\0" + whole[: len(whole) * 2 // 3]
    yield b"\0" + _file(CompressionType.NONE, chunked=False)
    yield b"\7- history: 1\n  depth: 5\n  reliability: reliable\n  durability: 1\n"
