"""Objects in shared memory as files: header, self-description, slots, read by every tool that reads them."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from rosplc import api
from rosplc.cli.show import lines_of
from rosplc.described import description_of
from rosplc.doctor.objects import look_at_objects
from rosplc.errors import ChannelError, LayoutError, RosplcError
from rosplc.harmless import harmless
from rosplc.layout import Limits, compute_layout
from rosplc.layout.view import plain
from rosplc.model import TypeStore
from rosplc.monitor import find_objects
from rosplc.monitor.watch import Watch
from rosplc.shm import Direction
from rosplc.shm.header import Identity
from tests.fuzz.choices import Choices
from tests.fuzz.oracle import refusals
from tests.fuzz.scratch import emptied

__all__ = ["check", "seeds"]

_LARGEST = 1 << 18
_folder = emptied("object")
_path = _folder / "rosplc.t.fuzz"


def _repaired(text: bytes) -> tuple[bytes, int, str]:
    """Return a self-description with the layout id that it has by itself, and the record's size."""
    try:
        members = json.loads(text)
        store = TypeStore.from_definition(members["type"], members["definition"])
        layout = compute_layout(store, members["type"], Limits.from_dict(members["limits"]))
    except (RosplcError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return text, 8, "00" * 8
    members["layout_id"] = layout.layout_id
    return json.dumps(members).encode(), min(layout.size, _LARGEST), layout.layout_id


def _image(choices: Choices) -> bytes:
    """Build an object: mostly sound, or nothing would get beyond its first lines."""
    how, words = choices.byte(), [(choices.byte(), choices.number()) for _ in range(choices.below(4))]
    text = choices.part()
    size, layout_id = 8, "00" * 8
    if how & 1:
        text, size, layout_id = _repaired(text)
    text = text.ljust(2)[: 1 << 16]
    identity = Identity.plan(
        direction=Direction.TO_ROS if how & 2 else Direction.TO_PLC,
        slots=4,
        record_size=max(1, size),
        description_size=len(text),
        layout_id=layout_id,
        generation=7,
        bridge_id=bytes(16),
    )
    head = bytearray(identity.build().ljust(512, b"\0"))
    for at, word in words:
        struct.pack_into("<I", head, at % 128 * 4, word)
    if not how & 4:
        struct.pack_into("<I", head, 108, zlib.crc32(head[16:108], zlib.crc32(head[:12])))
    body = (bytes(head) + text).ljust(identity.slots_offset, b"\0") + choices.rest()
    return body if how & 8 else body.ljust(identity.object_size, b"\0")


def check(data: bytes) -> None:
    """Whatever the object holds, each tool shows it or says with a number what is wrong with it."""
    image = _image(Choices(data))
    _path.write_bytes(image)
    with refusals(ChannelError), api.attach("/fuzz", directory=str(_folder), latched=True) as channel:
        for _ in range(2):
            message = channel.current()
            if message is not None:
                repr(message)
                json.dumps(plain(message))
                harmless("\n".join(lines_of(plain(message))))
        for message in channel.every(0.0):
            repr(message)
        channel.snapshot()
        harmless(f"{channel.description}{channel!r}{channel.type_name}")
    if not any(image[at : at + 4].strip(b"\0") for at in (132, *range(192, 448, 64))):
        # Nobody claims it: whoever finds a claim waits for seconds, to see whether its holder lives.
        with (
            refusals(ChannelError, LayoutError),
            api.attach("/fuzz", directory=str(_folder), write=True, task="fuzz") as channel,
        ):
            channel.write({})
            channel.read()
    for state in find_objects(str(_folder), seconds=0.0):
        json.dumps(state.to_dict())
    with Watch(directory=str(_folder)) as watch:
        for _ in range(2):
            json.dumps(watch.look().as_json(), allow_nan=False)
        for view in watch.look().channels:
            with refusals(ChannelError):
                repr(watch.message(view, 8))
    look_at_objects(_folder, {}, sleep=lambda _: None)
    assert [path.name for path in Path(_folder).iterdir()] == [_path.name]


def seeds() -> Iterator[bytes]:
    """Sound objects of several types, with a message in each."""
    store = TypeStore.bundled("jazzy")
    for name in ("std_msgs/msg/String", "geometry_msgs/msg/Twist", "sensor_msgs/msg/JointState"):
        layout = compute_layout(store, name, Limits(20, 3))
        description = description_of(layout, "/fuzz", Direction.TO_ROS, bridge="fuzz")
        slot = struct.pack("<8I", 1, layout.size, 1, 0, 5, 0, 1, 0).ljust(64, b"\0") + layout.pack({})
        stride = -(-len(slot) // 64) * 64
        for how in (1, 3, 3 | 8):
            # head = 1: the newest message stands in slot 1
            words = struct.pack("<BI", 32, 1) + struct.pack("<BI", 33, 9)
            yield bytes([how, 2]) + words + description.to_json() + b"\xff" + bytes(stride) + slot
