"""Data that only a configuration has: what is expected of a topic, and a classic topic's memory and lock.

The lock is not taken: an observer must not delay a PLC. A record read without the lock may be half written,
so it is read until two reads agree.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rosplc.config.resolve import Project, TopicPlan, load_project
from rosplc.errors import ChannelError
from rosplc.monitor.message import Message, message_of
from rosplc.monitor.picture import ChannelView, State
from rosplc.shm import Direction, Part
from rosplc.shm.classic import ClassicMemory
from rosplc.shm.files import describe_owner


@dataclass(frozen=True)
class Expectation:
    """What is expected of one topic.

    Its newest message may be ``stale_after_ns`` old, 0 for any age; ``in_order``: each message matters, so a
    loss is a fault; False if unknown; ``configured``: this is from a configuration.
    """

    stale_after_ns: int
    in_order: bool = False
    configured: bool = True


@dataclass(frozen=True)
class Expected:
    """The expectations of configurations: by prefix and topic, and classic topics with their bridge's prefix.

    ``calls`` are the objects of services and actions: prefix, name, part and client.
    ``stale_after_ns`` is for topics to the PLC that are in no configuration; 0 for never.
    """

    topics: Mapping[tuple[str, str], Expectation] = field(default_factory=dict)
    classic: tuple[tuple[str, TopicPlan], ...] = ()
    calls: tuple[tuple[str, str, Part, str], ...] = ()
    stale_after_ns: int = 1_000_000_000
    prefixes: frozenset[str] = frozenset()

    def of(self, prefix: str, topic: str, direction: Direction, part: Part = Part.TOPIC) -> Expectation:
        """Return what is expected of a topic; calls may arrive at any time, or never."""
        if part is not Part.TOPIC:
            return Expectation(0, configured=any(call[:2] == (prefix, topic) for call in self.calls))
        # Without a configuration silence to ROS is never stale.
        default = Expectation(self.stale_after_ns if direction is Direction.TO_PLC else 0, configured=False)
        return self.topics.get((prefix, topic)) or default


def expected_by(files: Iterable[Path]) -> Expected:
    """Read configurations and return their expectations together. Raises ConfigErrors if one is invalid."""
    found = [expected_of(load_project(file)) for file in files]
    return Expected(
        {key: topic for each in found for key, topic in each.topics.items()},
        tuple(classic for each in found for classic in each.classic),
        tuple(call for each in found for call in each.calls),
        prefixes=frozenset().union(*(each.prefixes for each in found)),
    )


def expected_of(project: Project) -> Expected:
    """Return the expectations of a resolved configuration."""
    prefix = project.namespace.prefix
    topics: dict[tuple[str, str], Expectation] = {}
    classic: list[tuple[str, TopicPlan]] = []
    for plan in project.topics:
        if plan.port == "channel":
            topics[prefix, plan.topic] = Expectation(plan.stale_after_ns, in_order=plan.every)
        else:
            classic.append((prefix, plan))
    calls = [(prefix, plan.called, part, plan.client) for plan in project.calls for part in plan.parts]
    return Expected(topics, tuple(classic), tuple(calls), prefixes=frozenset({prefix}))


_ATTEMPTS = 100


@dataclass(frozen=True)
class ClassicState:
    """Memory and lock at one moment.

    ``semaphore`` is empty if none is configured; ``size`` is 0 while there is no memory; ``owner`` is like
    ``root:root 0750``. ``value`` is 1 if the lock is free, 0 if it is taken, None if it cannot be read;
    ``record`` is None if it cannot be read, with the reason in ``error`` and ``code``.
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
        """The state of the lock as a word."""
        if not self.semaphore:
            return "none"
        if self.value is None:
            return "not readable" if Path(f"/dev/shm/sem.{self.semaphore}").exists() else "missing"
        return {0: "taken", 1: "free"}.get(self.value, f"admits {self.value}")


def look_at(plan: TopicPlan) -> ClassicState:
    """Return the state of a classic topic's memory and lock; ``error`` shows what is missing."""
    assert plan.classic is not None
    name, semaphore = plan.classic.name, plan.classic.semaphore
    path = Path("/dev/shm") / name
    value = semaphore_value(Path(f"/dev/shm/sem.{semaphore}")) if semaphore else None
    if not os.path.lexists(path):
        return ClassicState(name, semaphore, value=value, error="this memory does not exist", code="SHM101")
    try:
        with ClassicMemory(path, plan.layout.size, write=False) as memory:
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
    """Return a semaphore's value; None if the file cannot be read or is not a glibc semaphore."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    # 32-bit programs keep a flag for waiters in the lowest bit.
    flags = {32: 0, 16: 1}.get(len(content))
    return None if flags is None else int.from_bytes(content[:4], sys.byteorder) >> flags


class ClassicWatch:
    """Monitors one classic memory of a bridge's prefix; nothing stays open between two looks."""

    def __init__(self, prefix: str, topic: TopicPlan) -> None:
        assert topic.classic is not None
        self.id = f"classic:{topic.classic.name}"
        self._prefix = prefix
        self._topic = topic
        self._record: bytes | None = None
        self._changes = 0
        self._changed_ns: int | None = None
        self._since_ns: int | None = None

    def look(self, now_ns: int) -> ChannelView:
        """Return the memory's state; ``now_ns`` is from a monotonic clock."""
        topic, found = self._topic, look_at(self._topic)
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
        found = look_at(self._topic)
        if found.record is None:
            raise ChannelError(found.code, found.error, where=f"/dev/shm/{found.name}")
        return message_of(self.id, self._topic.layout, found.record, None, elements)

    def _judge(self, found: ClassicState, *, stale: bool) -> tuple[State, str]:
        if found.code == "SHM101":
            return State.MISSING, found.error
        if found.error:
            return State.UNREADABLE, found.error
        if found.lock in ("missing", "not readable"):
            return State.UNREADABLE, f"semaphore {found.semaphore} is {found.lock}"
        if stale:
            return State.STALE, "the record has not changed for longer than allowed"
        return State.OK, f"classic memory, lock: {found.lock}"
