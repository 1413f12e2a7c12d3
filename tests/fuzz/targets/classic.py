"""Classic memories and semaphores that another program made, of any size and content."""

from __future__ import annotations

import atexit
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from rosplc.codec import Codec, Wire
from rosplc.errors import ChannelError
from rosplc.layout import Limits, compute_layout
from rosplc.layout.view import plain
from rosplc.model import TypeStore
from rosplc.shm.classic import ClassicLock, ClassicMemory, Entry
from tests.fuzz.choices import Choices
from tests.fuzz.oracle import refusals
from tests.fuzz.scratch import emptied

__all__ = ["check", "seeds"]

_layout = compute_layout(TypeStore.bundled("jazzy"), "sensor_msgs/msg/JointState", Limits(9, 3))
_codec = Codec(_layout, Wire.CDR)
_folder = emptied("classic")
# The C library keeps semaphores in /dev/shm and nowhere else.
_name = f"rosplc-fuzz-{os.getpid()}"
_semaphore = Path("/dev/shm") / f"sem.{_name}"
_SECOND = 1_000_000_000


@atexit.register
def _clean() -> None:
    with suppress(OSError):
        _semaphore.unlink()


def _lock(choices: Choices) -> None:
    """A semaphore file: refused, or a lock that lets one in."""
    _semaphore.write_bytes(choices.take(choices.byte() % 48))
    now = _SECOND
    with refusals(ChannelError):
        lock = ClassicLock(_name, _SECOND)
        try:
            while choices:
                now += choices.number(2) * 10_000
                if choices.flag():
                    lock.look(now, alive=choices.flag())
                elif lock.enter(now) is Entry.ENTERED:
                    assert lock.value == 0
                    lock.leave()
            assert 0 <= lock.value < 2**31
            lock.in_place()
        finally:
            lock.close()
    _clean()


def _memory(choices: Choices) -> None:
    """A memory: too small, or a record that can be shown and sent."""
    path = _folder / "memory"
    path.write_bytes(choices.rest())
    with refusals(ChannelError), ClassicMemory(path, _layout.size) as memory:
        record = memory.read()
        assert len(record) == _layout.size
        plain(_layout.view(memoryview(record)))
        message = _codec.encode(record)
        assert _codec.encode(_codec.decode(message)) == message
        memory.write(record)
        assert memory.in_place()


def check(data: bytes) -> None:
    """Whatever they hold, they are refused with a number, or used within their bounds."""
    choices = Choices(data)
    choices.pick((_memory, _lock))(choices)


def seeds() -> Iterator[bytes]:
    """A record, one full of nonsense, and semaphores that are free, taken and absurd."""
    yield b"\0" + bytes(_layout.pack({"name": ["a"], "position": [1.0]}))
    yield b"\0" + b"\xff" * _layout.size
    yield b"\0" + b"short"
    for value in (0, 1, 2, 64, 2**31 - 1, 2**32 - 1):
        content = value.to_bytes(4, "little") + bytes(4) + (128).to_bytes(4, "little") + bytes(20)
        yield b"\1\x20" + content + b"\1\0\1\0" + b"\xff\xff\0" * 30
