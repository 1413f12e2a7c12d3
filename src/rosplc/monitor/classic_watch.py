"""A classic topic between two looks: all that can be seen is whether its record changes."""

from __future__ import annotations

from rosplc.errors import ChannelError
from rosplc.monitor.classic import ClassicState, look_at
from rosplc.monitor.expected import ClassicTopic
from rosplc.monitor.message import Message, message_of
from rosplc.monitor.picture import ChannelView
from rosplc.monitor.states import State

__all__ = ["ClassicWatch"]


class ClassicWatch:
    """Watches one classic memory; nothing stays open between two looks.

    Args:
        prefix: Its bridge's prefix.
        topic: What the configuration says of it.

    Attributes:
        id: The channel's id.
    """

    def __init__(self, prefix: str, topic: ClassicTopic) -> None:
        self.id = f"classic:{topic.memory}"
        self._prefix = prefix
        self._topic = topic
        self._record: bytes | None = None
        self._changes = 0
        self._changed_ns: int | None = None
        self._since_ns: int | None = None

    def look(self, now_ns: int) -> ChannelView:
        """Return how the memory stands; ``now_ns`` is of a monotonic clock."""
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
        """Return what stands in the memory.

        Args:
            elements: How many elements of each array are wanted at most; None for all.

        Raises:
            ChannelError: It cannot be read.
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
