"""A classic topic's memory and lock, which cannot describe themselves, and what a look now and then shows.

The lock is not taken: an observer must not make a PLC wait. A record read without it may be half written, and
is read until two reads agree.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from rosplc.errors import ChannelError
from rosplc.monitor.expected import ClassicTopic
from rosplc.monitor.message import Message, message_of
from rosplc.monitor.picture import ChannelView, State
from rosplc.shm.classic import ClassicMemory
from rosplc.shm.files import describe_owner

_ATTEMPTS = 100


@dataclass(frozen=True)
class ClassicState:
    """Memory and lock at one moment.

    ``semaphore`` is empty if there is none by configuration; ``size`` 0 while there is no memory; ``owner``
    reads ``root:root 0750``. ``value`` is 1 if the lock is free, 0 if it is taken, None if it cannot be read;
    ``record`` None likewise: ``error`` and ``code`` are why.
    """

    name: str
    semaphore: str
    size: int = 0
    owner: str = ""
    value: int | None = None
    record: bytes | None = None
    error: str = ""
    code: str = ""

    @property
    def lock(self) -> str:
        """The lock in a word."""
        if not self.semaphore:
            return "none"
        if self.value is None:
            return "not readable" if Path(f"/dev/shm/sem.{self.semaphore}").exists() else "missing"
        return {0: "taken", 1: "free"}.get(self.value, f"lets in {self.value}")


def look_at(name: str, semaphore: str, record_size: int) -> ClassicState:
    """Return a classic topic's memory and lock (none: an empty name); what is missing is in ``error``."""
    path = Path("/dev/shm") / name
    value = semaphore_value(Path(f"/dev/shm/sem.{semaphore}")) if semaphore else None
    if not os.path.lexists(path):
        return ClassicState(name, semaphore, value=value, error="there is no such memory", code="SHM101")
    try:
        with ClassicMemory(path, record_size, write=False) as memory:
            record = memory.read()
            for _ in range(_ATTEMPTS):
                again = memory.read()
                if again == record:
                    break
                record = again
            return ClassicState(name, semaphore, memory.size, describe_owner(path), value, record)
    except ChannelError as error:
        size = path.stat().st_size if path.exists() else 0
        return ClassicState(
            name, semaphore, size, describe_owner(path), value, error=error.what, code=error.code
        )


def semaphore_value(path: Path) -> int | None:
    """Return how many could enter now; None if the file cannot be read or is no semaphore of glibc."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    # 32-bit programs keep a flag for waiters in the lowest bit.
    flags = {32: 0, 16: 1}.get(len(content))
    return None if flags is None else int.from_bytes(content[:4], sys.byteorder) >> flags


class ClassicWatch:
    """Watches one classic memory of a bridge's prefix; nothing stays open between two looks."""

    def __init__(self, prefix: str, topic: ClassicTopic) -> None:
        self.id = f"classic:{topic.memory}"
        self._prefix = prefix
        self._topic = topic
        self._record: bytes | None = None
        self._changes = 0
        self._changed_ns: int | None = None
        self._since_ns: int | None = None

    def look(self, now_ns: int) -> ChannelView:
        """Return the memory's state; ``now_ns`` is of a monotonic clock."""
        topic, found = self._topic, self._look()
        if self._since_ns is None:
            self._since_ns = now_ns
        if found.record is not None and found.record != self._record:
            if self._record is not None:
                self._changes += 1
                self._changed_ns = now_ns
            self._record = found.record
        since = now_ns - (self._since_ns if self._changed_ns is None else self._changed_ns)
        stale = bool(topic.stale_after_ns) and since > topic.stale_after_ns
        state, words = self._judge(found, stale=stale)
        return ChannelView(
            id=self.id,
            prefix=self._prefix,
            topic=topic.topic,
            direction=topic.direction.word,
            type_name=topic.layout.type_name,
            state=state,
            words=words,
            code=found.code,
            age_ns=None if self._changed_ns is None else since,
            received=self._changes,
            stale=stale,
            silent=stale,
            stale_after_ns=topic.stale_after_ns,
            configured=True,
            record_size=topic.layout.size,
            object_size=found.size,
            layout_id=topic.layout.layout_id,
            classic=True,
        )

    def message(self, elements: int | None = None) -> Message:
        """Return the content of the memory, at most ``elements`` of each array (None: all).

        Raises ChannelError if it cannot be read.
        """
        found = self._look()
        if found.record is None:
            raise ChannelError(found.code, found.error, where=f"/dev/shm/{found.name}")
        return message_of(self.id, self._topic.layout, found.record, None, elements)

    def _look(self) -> ClassicState:
        return look_at(self._topic.memory, self._topic.semaphore, self._topic.layout.size)

    def _judge(self, found: ClassicState, *, stale: bool) -> tuple[State, str]:
        if found.code == "SHM101":
            return State.MISSING, found.error
        if found.error:
            return State.UNREADABLE, found.error
        if found.lock in ("missing", "not readable"):
            return State.UNREADABLE, f"its semaphore {found.semaphore} is {found.lock}"
        if stale:
            return State.STALE, "the record does not change for longer than it may"
        return State.OK, f"classic memory, lock: {found.lock}"
