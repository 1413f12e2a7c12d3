"""Taking every message of the selected channels, in order, as the bridge itself does.

One thread looks at all channels at once (:class:`rosplc.shm.Group`) and does nothing but put
messages into batches; what it missed, it counts. Opening and closing objects is the business of whoever
calls :meth:`Inlet.look_after`.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import ChannelError
from rosplc.recorder.carried import CarriedChannel, Selection, channel_info
from rosplc.recorder.mcap_write import Batch, ChannelInfo
from rosplc.ros import Qos
from rosplc.shm import Group, Namespace
from rosplc.shm.constants import STAMP_SYSTEM

__all__ = ["Inlet", "OnMessage", "TopicCount"]

OnMessage = Callable[[CarriedChannel, bytes, int], None]
"""Called by the taking thread with a channel, a message's CDR and the time; it must be quick."""

_IN_ORDER = 1
_TICK_NS = 1_000_000
_LONGEST_WAIT_NS = 200_000_000
_RETRY_NS = 1_000_000_000
_NO_TIME = 2**63 - 1
_LOSS = 1 << 24
"""A first sequence beyond this is no count of messages, but something that a writer made up."""


@dataclass
class TopicCount:
    """What was taken of a topic, and what was missed.

    Attributes:
        type_name: Its type.
        received: Messages taken and kept.
        lost: Messages missed: overwritten before they were read, or dropped because the disk did not keep up.
        refused: Messages taken that could not be encoded.
    """

    type_name: str
    received: int = 0
    lost: int = 0
    refused: int = 0


@dataclass(eq=False)
class _Entry:
    """A channel in the taking thread's hands."""

    carried: CarriedChannel
    number: int
    name: str
    count: TopicCount
    on_message: OnMessage | None
    index: int = -1
    broken: bool = False
    lost: int = field(default=0)
    first: bool = True

    def note_losses(self) -> None:
        lost = self.carried.reader.lost
        self.count.lost += lost - self.lost
        self.lost = lost


class Inlet:
    """Reads the channels of one prefix; :meth:`start` begins, :meth:`stop` ends.

    Args:
        namespace: Where the objects stand.
        selection: Which topics are taken.
        put: Given each full batch, by the taking thread.
        chunk_bytes: How many bytes make a batch full.
        flush_ns: After how long it is full in any case.
        qos: Topic → QoS, as far as a configuration says it.
        watch: Given a channel that is being attached, returns what its messages are shown to, or None.
        clock: What messages are stamped with, and when a batch is full.

    Attributes:
        channels: Channel id → how files name it, for every channel that was ever taken.
        counts: Topic → what was taken and missed.
        failures: Object name → why it cannot be taken.
        error: What ended the taking thread before its time; None if nothing has.
    """

    def __init__(
        self,
        namespace: Namespace,
        selection: Selection,
        put: Callable[[Batch], None],
        *,
        chunk_bytes: int,
        flush_ns: int,
        qos: Mapping[str, Qos] | None = None,
        watch: Callable[[CarriedChannel], OnMessage | None] = lambda _: None,
        clock: Clock = SYSTEM,
    ) -> None:
        self._clock = clock
        self._namespace, self._selection, self._put = namespace, selection, put
        self._chunk_bytes, self._flush_ns = chunk_bytes, flush_ns
        self._qos = qos or {}
        self._watch = watch
        self.channels: dict[int, ChannelInfo] = {}
        self.counts: dict[str, TopicCount] = {}
        self.failures: dict[str, ChannelError] = {}
        self.error: Exception | None = None
        self._numbers: dict[tuple[str, bytes, str], int] = {}
        self._entries: dict[str, _Entry] = {}
        self._by_index: dict[int, _Entry] = {}
        self._skipped: set[str] = set()
        self._retry_at: dict[str, int] = {}
        self._group = Group()
        self._jobs: deque[Callable[[], None]] = deque()
        self._ready = threading.Event()
        self._began_ns = self._clock.time_ns()
        self._started = False
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="rosplc-record", daemon=True)

    def start(self) -> None:
        """Attach to what is there, and take every message from the return of this on."""
        self.look_after()
        self._thread.start()
        self._started = True
        self._ready.wait()

    def stop(self) -> None:
        """Take what is there, put the last batch, and let go of everything."""
        self._stopping = True
        self._group.wake()
        if self._started:
            self._thread.join()
        for entry in self._entries.values():
            entry.note_losses()
            entry.carried.close()
        self._entries.clear()

    def look_after(self) -> None:
        """Count losses, attach to objects that have come, let go of those that went; about once a second.

        Raises:
            ChannelError: SHM123 if the directory cannot be listed.
        """
        for name, entry in list(self._entries.items()):
            entry.note_losses()
            if entry.broken or not entry.carried.still_there():
                del self._entries[name]
                self._jobs.append(lambda entry=entry: self._drop(entry))  # type: ignore[misc]
        now = self._clock.monotonic_ns()
        for name in self._namespace.topics():
            if name in self._entries or name in self._skipped or now < self._retry_at.get(name, 0):
                continue
            self._open(name, now)
        self._group.wake()

    def _open(self, name: str, now: int) -> None:
        topic = self._namespace.topic_of(name)
        if topic is not None and topic not in self._selection:
            self._skipped.add(name)
            return
        try:
            path = Path(self._namespace.directory) / name
            carried = CarriedChannel(path, since_ns=self._began_ns if self._started else None)
        except ChannelError as error:
            self._retry_at[name] = now + _RETRY_NS
            if error.code not in ("SHM101", "SHM111"):  # those are about to be replaced, or gone
                self.failures[name] = error
            return
        self.failures.pop(name, None)
        if carried.topic not in self._selection:
            carried.close()
            self._skipped.add(name)
            return
        count = self.counts.setdefault(carried.topic, TopicCount(carried.codec.layout.type_name))
        entry = _Entry(carried, self._number(carried), name, count, self._watch(carried))
        self._entries[name] = entry
        self._jobs.append(lambda: self._add(entry))

    def _number(self, carried: CarriedChannel) -> int:
        """Return the channel's id: the same again after a restart, another one for another layout."""
        info = channel_info(
            carried, len(self.channels) + 1, self._namespace.prefix, self._qos.get(carried.topic)
        )
        key = (info.topic, info.schema, info.metadata["rosplc.layout_id"])
        number = self._numbers.setdefault(key, info.id)
        self.channels.setdefault(number, info)
        return number

    # -- the taking thread's own

    def _add(self, entry: _Entry) -> None:
        carried = entry.carried
        try:
            reader = carried.begin()
        except ChannelError:
            entry.broken = True  # look_after opens the name again
            return
        entry.index = self._group.add_reader(reader, carried.codec.plan, _IN_ORDER, carried.slots)
        self._by_index[entry.index] = entry

    def _drop(self, entry: _Entry) -> None:
        if entry.index >= 0:
            self._group.remove(entry.index)
            del self._by_index[entry.index]
        entry.note_losses()
        # A retired object gives nothing out any more, also what was not taken yet.
        entry.count.lost += entry.carried.untaken()
        entry.carried.close()

    def _run(self) -> None:
        try:
            self._take_all()
        except Exception as error:  # whoever waits for the recording is told
            self.error = error
        finally:
            self._ready.set()

    def _take_all(self) -> None:
        batch, since = Batch(), 0
        while True:
            last = self._stopping
            if not last:
                rest = self._flush_ns - (self._clock.monotonic_ns() - since) if batch else _LONGEST_WAIT_NS
                self._group.wait(_TICK_NS, max(0, min(_LONGEST_WAIT_NS, rest)))
            messages, faults = self._group.take()
            if messages:
                if not batch:
                    since = self._clock.monotonic_ns()
                self._gather(batch, messages)
            for index, fault in faults:
                entry = self._by_index[index]
                if isinstance(fault, ChannelError):
                    entry.broken = True  # retired or damaged: look_after opens the name again
                else:
                    entry.count.refused += 1
            # Behind the taking: what an object that is let go of still held has been taken.
            while self._jobs:
                self._jobs.popleft()()
            self._ready.set()
            full = (
                len(batch.data) >= self._chunk_bytes or self._clock.monotonic_ns() - since >= self._flush_ns
            )
            if batch and (full or last):
                self._put(batch)
                batch = Batch()
            if last and not messages:
                return

    def _gather(self, batch: Batch, messages: list[tuple[int, bytes, int, int, int, int]]) -> None:
        now = self._clock.time_ns()
        by_index, add = self._by_index, batch.add
        for index, data, sequence, _flags, stamp_ns, stamp_clock in messages:
            entry = by_index[index]
            entry.count.received += 1
            if entry.first:
                entry.first = False
                if entry.carried.since_creation and sequence < _LOSS:
                    entry.count.lost += sequence - 1  # overwritten before the new object was found
            # A stamp of the PLC's own clock would stand beside the others as if it were of this one.
            usable = stamp_clock == STAMP_SYSTEM and 0 < stamp_ns < _NO_TIME
            add(entry.number, sequence, now, stamp_ns if usable else now, data)
            if entry.on_message is not None:
                entry.on_message(entry.carried, data, now)
