"""The data about one object that is kept between two looks, and what follows from it."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from rosplc.errors import ChannelError
from rosplc.monitor.classic import Expectation
from rosplc.monitor.message import Calls
from rosplc.monitor.picture import ChannelView, ReaderView, judge
from rosplc.shm import Attached, Direction, Liveness, Part, ReaderState, Snapshot, distance
from rosplc.shm.constants import SLOT_HEADER, STAMP_SYSTEM, UNKNOWN
from rosplc.shm.header import WriterState, channel_error
from rosplc.shm.names import Namespace

_LEAST_MS = 334
"""Minimum assumed heartbeat period: views look rarely and must not flicker on a busy machine."""


class _Peer:
    def __init__(self, claim: int, beat_ms: int, now_ns: int) -> None:
        period = max(beat_ms, _LEAST_MS) if beat_ms else 0
        self.promise, self.seen = (claim, beat_ms), False
        self.liveness = Liveness(period)
        self.until_ns = now_ns + 3 * min(max(period, _LEAST_MS), 10_000) * 1_000_000


class Peers:
    """Detects whether each claimant of one object is alive."""

    def __init__(self) -> None:
        self._known: dict[int, _Peer] = {}

    def alive(self, key: int, claim: int, beat_ms: int, beat: int, count: int, now_ns: int) -> bool | None:
        """Return whether a claimant is alive; None until known.

        ``key`` is its line; a ``claim`` of 0 means no claimant. It is alive if ``beat`` or ``count`` (head or
        taken) changes within the period promised by ``beat_ms``; ``now_ns`` is monotonic.
        """
        if not claim:
            self._known.pop(key, None)
            return False
        known = self._known.get(key)
        if known is None or known.promise != (claim, beat_ms):
            known = self._known[key] = _Peer(claim, beat_ms, now_ns)
        alive = known.liveness.observe(beat, count, now_ns)
        known.seen |= alive
        return alive or (None if now_ns < known.until_ns else False)

    def seen(self, key: int) -> bool:
        """Return whether the claimant of a line was seen alive at any time since its claim."""
        return key in self._known and self._known[key].seen


_WINDOW_NS = 2_000_000_000
_LONGEST_NS = 30_000_000_000
_FEWEST = 4
_MISSED = 2


class Rate:
    """Messages per second, computed from the number of messages at each look.

    It covers the last two seconds, or up to half a minute if fewer than three messages arrived in them, so
    that one message per second is shown as 1, and not alternately as 0 and 2.
    """

    def __init__(self) -> None:
        self._changes: deque[tuple[int, int]] = deque()

    def of(self, count: int, now_ns: int) -> float | None:
        """Note the number of messages at a monotonic ``now_ns``; return the rate in Hz, None until known."""
        changes = self._changes
        if not changes or changes[-1][1] != count:
            changes.append((now_ns, count))
        while len(changes) > _FEWEST and now_ns - changes[1][0] > _WINDOW_NS:
            changes.popleft()
        while len(changes) > 1 and now_ns - changes[1][0] > _LONGEST_NS:
            changes.popleft()
        (then, before), (last, after) = changes[0], changes[-1]
        if after == before:
            # One look tells nothing; the first change after a long time says when, and not how often.
            return 0.0 if now_ns - then > _WINDOW_NS else None
        mean = (last - then) / (after - before)
        late = now_ns - last > max(_MISSED * mean, _WINDOW_NS / 4)
        if now_ns - last > max(_WINDOW_NS, 5 * mean):
            return 0.0
        span = (now_ns if late else last) - then
        return (after - before) * 1e9 / span if span > 0 else None


_STOPPED = ("T", "t")
_THERE = "the process is running but does not respond"
_YOUNG_S = 30.0  # a bridge claims its objects, joins ROS, and only then beats
_START_TIME = 19  # index of the start among the fields behind the name, in ticks since the machine's start


def is_starting(pid: int, proc: Path = Path("/proc"), *, now_s: float | None = None) -> bool:
    """Return whether a bridge without a heartbeat is so young that it may not have sent one yet.

    ``now_s`` is in seconds since the machine's start; None uses the clock.
    """
    if not pid or process_words(pid, proc) != _THERE:
        return False
    now_s = time.clock_gettime(time.CLOCK_BOOTTIME) if now_s is None else now_s
    try:
        fields = (proc / str(pid) / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2]
        began_s = int(fields.split()[_START_TIME]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return False
    return now_s - began_s < _YOUNG_S


def process_words(pid: int, proc: Path = Path("/proc")) -> str:
    """Return the state of the process of a bridge without a heartbeat, as text; empty if unknown."""
    folder = proc / str(pid)
    try:
        # The name in parentheses may hold anything, parentheses too.
        state = (folder / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[0]
        command = (folder / "cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return "no process with this ID is visible"
    except (OSError, IndexError):
        return ""
    if state == "Z":
        return "the process has ended"
    if b"rosplc" not in command and b"python" not in command:
        return "the process ID belongs to another program"
    return "the process is stopped (SIGSTOP)" if state in _STOPPED else _THERE


_RECENT_NS = 10_000_000_000
_DEBOUNCE_NS = 500_000_000
WRITER = -1  # the key of the writer's line
_YEARS_NS = 10 * 365 * 86400 * 10**9


class Recently:
    """Whether a counter has grown within the last ten seconds."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._grown_ns: int | None = None

    def of(self, count: int, now_ns: int) -> bool:
        """Note the counter; return whether it grew recently."""
        if count > self._count:
            self._grown_ns = now_ns
        self._count = count
        return self._grown_ns is not None and now_ns - self._grown_ns < _RECENT_NS


class Tracked:
    """An attached object, mapped read-only, and its remembered data.

    Raises ChannelError SHM113 if the self-description cannot be read, or belongs to another object.
    """

    def __init__(self, namespace: Namespace, name: str, attached: Attached, now_ns: int) -> None:
        description, part = attached.description, Part(attached.identity.kind)
        try:
            stands_right = namespace.object_name(description.topic, part, description.client) == name
        except ChannelError:
            stands_right = False
        if not stands_right:
            what = f"the self-description is for {description.topic[:80]!r}, whose object has another name"
            raise channel_error(113, what, attached.path)
        self.name = name
        self.prefix = namespace.prefix
        self.attached = attached
        self.description = description
        self.direction = attached.identity.direction
        self._to_plc = self.direction is Direction.TO_PLC
        self.part = part
        self._calls = None if part is Part.TOPIC else Calls(attached)
        self._peers = Peers()
        self._rate = Rate()
        self._since_ns = now_ns
        first = attached.snapshot()
        self._head = first.writer.head
        self._count = 0
        self._changed_ns: int | None = None
        self._refused = Recently(first.writer.refused)
        self._lost = Recently(_most_lost(first))
        self._settled_ns = 0

    def close(self) -> None:
        """Unmap the object."""
        self.attached.close()

    def look(self, expectation: Expectation, now_ns: int, wall_ns: int) -> ChannelView:
        """Return the channel's state; ``now_ns`` is monotonic, ``wall_ns`` in ns since 1970 UTC.

        Raises ChannelError SHM111 or SHM112 if the name must be opened again.
        """
        self.attached.valid()
        identity, snapshot = self.attached.identity, Snapshot.of(self.attached.region, free=False)
        writer = snapshot.writer
        self._follow(writer.head, now_ns, expectation.stale_after_ns)
        age = self._age(writer.head, now_ns, wall_ns)
        since = max(now_ns - self._since_ns, _past(wall_ns, identity.created_ns)) if age is None else age
        limit = expectation.stale_after_ns
        writer_alive = self._peers.alive(
            WRITER, writer.epoch, writer.beat_ms, writer.beat, writer.head, now_ns
        )
        if writer.epoch and not writer.beat_ms:
            # It promises no beat: its silence tells nothing, its process does.
            runs = self.attached.process.runs(writer.epoch, writer.pid)
            if not writer_alive and (runs is not None or self._peers.seen(WRITER)):
                writer_alive = runs is not False
        readers = tuple(self._reader(line, now_ns) for line in snapshot.readers)
        acts = any_alive(reader.alive for reader in self._acting(readers))
        bridge, plc = (writer_alive, acts) if self._to_plc else (acts, writer_alive)
        own = snapshot.bridge(self.direction)
        bridge_pid = own.pid if own else 0
        starting = (
            bridge is False
            and not self._peers.seen(WRITER if self._to_plc else 0)
            and is_starting(bridge_pid)
        )
        bridge = None if starting else bridge
        lost = _most_lost(snapshot)
        seen = ChannelView(
            id=self.name,
            prefix=self.prefix,
            topic=self.description.topic,
            direction=self.direction.word,
            type_name=self.description.type,
            bridge=self.description.bridge,
            bridge_pid=bridge_pid,
            rate_hz=self._rate.of(self._count, now_ns),
            age_ns=age,
            received=writer.head,
            lost=lost,
            refused=writer.refused,
            truncated=writer.truncated,
            writer_alive=bridge if self._to_plc else plc,
            reader_alive=plc if self._to_plc else bridge,
            bridge_alive=bridge,
            plc_alive=plc,
            plc_claimed=bool(self._acting(readers)) if self._to_plc else bool(writer.epoch),
            ros_peers=_peers(own),
            stale=bool(limit) and since > limit,
            silent=bool(limit) and (since > limit + _DEBOUNCE_NS or now_ns < self._settled_ns),
            stale_after_ns=limit,
            configured=expectation.configured,
            record_size=identity.record_size,
            slots=identity.slot_count,
            object_size=identity.object_size,
            layout_id=identity.layout_id,
            generation=identity.generation,
            created_ns=identity.created_ns,
            readers=readers,
            kind=self.part.kind,
            part=self.part.word,
            client=self.description.client,
            call=None if self._calls is None else self._calls.look(writer.head),
        )
        state, words = judge(
            seen,
            starting=starting,
            refused_lately=self._refused.of(writer.refused, now_ns),
            lost_lately=self._lost.of(lost, now_ns) and expectation.in_order,
        )
        return replace(seen, state=state, words=words)

    def _follow(self, head: int, now_ns: int, limit: int) -> None:
        if head == self._head:
            return
        new = distance(self._head, head, self.attached.identity.slot_count) if self._head else head
        if new < 2**31:  # else the head was scribbled over, or begins again
            self._count += new
            before = self._since_ns if self._changed_ns is None else self._changed_ns
            if limit and self._head and now_ns - before > limit + _DEBOUNCE_NS:
                self._settled_ns = now_ns + _DEBOUNCE_NS
            self._changed_ns = now_ns
        self._head = head

    def _age(self, head: int, now_ns: int, wall_ns: int) -> int | None:
        if not head:
            return None
        if self._changed_ns is not None:
            return now_ns - self._changed_ns
        return max(now_ns - self._since_ns, _past(wall_ns, self._stamp(head)))

    def _stamp(self, head: int) -> int:
        """Return the newest message's stamp by the system clock; 0 if it has none."""
        identity, region = self.attached.identity, self.attached.region
        slot = identity.slots_offset + head % identity.slot_count * identity.slot_stride
        words = region.words(slot, SLOT_HEADER["checksum"] // 4)
        low, high, clock = words[SLOT_HEADER["stamp_lo"] // 4 :][:3]
        return low | high << 32 if words[0] == head and clock == STAMP_SYSTEM else 0

    def _reader(self, line: ReaderState, now_ns: int) -> ReaderView:
        alive = self._peers.alive(line.index, line.claim, line.beat_ms, line.beat, line.taken, now_ns)
        return ReaderView(
            line.index, line.task, line.pid, alive, line.taken, line.lost, line.retries, line.error
        )

    def _acting(self, readers: tuple[ReaderView, ...]) -> list[ReaderView]:
        """Return the readers that belong to the other side, without observers."""
        every = self._to_plc and self._calls is None
        return [reader for reader in readers if every or reader.index == 0]


def _peers(own: WriterState | ReaderState | None) -> int | None:
    """Return the number of ROS peers in the bridge's line; None if it does not count them."""
    count = UNKNOWN if own is None else own.sources if isinstance(own, WriterState) else own.sinks
    return None if count == UNKNOWN else count


def any_alive(alive: Iterable[bool | None]) -> bool | None:
    """Return whether any of several is alive; None if none is known to be alive and some are unknown."""
    known = list(alive)
    return True if True in known else None if None in known else False


def _most_lost(snapshot: Snapshot) -> int:
    return max((line.lost for line in snapshot.readers if line.claim), default=0)


def _past(wall_ns: int, then_ns: int) -> int:
    """Return how long ago a time on another clock was; 0 if it is implausible."""
    ago = wall_ns - then_ns
    return ago if then_ns and 0 < ago < _YEARS_NS else 0
