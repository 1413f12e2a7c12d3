"""Takes every message of the selected channels, in order, and makes chunks of them.

One thread polls all channels together (:class:`rosplc.shm.Group`), adds messages to batches and counts
missed messages. The caller of :meth:`Inlet.look_after` opens and closes objects. A second thread compresses.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import ChannelError
from rosplc.recorder.carried import (
    Carried,
    CarriedAction,
    CarriedService,
    Event,
    Stream,
    channel_info,
    recorded_name,
    topics_of,
)
from rosplc.recorder.mcap_file import Batch, ChannelInfo, Compression, SealedChunk, seal
from rosplc.ros import Qos
from rosplc.shm import Group, Namespace, Part
from rosplc.shm.constants import STAMP_SYSTEM


@dataclass(frozen=True)
class Selection:
    """Names or patterns of topics, such as ``/robot1/*``; without ``topics``, all except ``exclude``.

    A * also matches slashes; the name of a service or action selects all its topics.
    """

    topics: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()

    def __contains__(self, topic: str) -> bool:
        """Return whether a topic is selected."""
        return not _matches(topic, self.exclude) and (not self.topics or _matches(topic, self.topics))

    def without_match(self, topics: Iterable[str]) -> list[str]:
        """Return the requested names and patterns that match none of these topics."""
        names = list(topics)
        return [one for one in self.topics if not any(_matches(name, (one,)) for name in names)]


def _matches(topic: str, patterns: Iterable[str]) -> bool:
    absolute = (one if one.startswith(("/", "*")) else f"/{one}" for one in patterns)
    return any(fnmatchcase(topic, one) or fnmatchcase(recorded_name(topic), one) for one in absolute)


OnMessage = Callable[[Stream, bytes, int], None]
"""Called by the taking thread with a stream, a message's CDR and the time; must return quickly."""

_TICK_NS = 1_000_000
_LONGEST_WAIT_NS = 200_000_000
_RETRY_NS = 1_000_000_000
_NO_TIME = 2**63 - 1
_LOSS = 1 << 24  # a first sequence beyond this is no count of messages, but something that a writer made up


@dataclass
class TopicCount:
    """The message counts of a topic."""

    type_name: str
    received: int = 0  # taken and kept
    lost: int = 0  # overwritten before they were read, or dropped because the disk did not keep up
    refused: int = 0  # taken, but not encodable


@dataclass(eq=False)
class _Line:
    """A stream, and its channel in the file."""

    stream: Stream
    number: int
    count: TopicCount
    on_message: OnMessage | None
    lost: int = 0


@dataclass(eq=False)
class _Entry:
    """An object for the taking thread; ``lines`` are None for streams that are not selected."""

    carried: Carried
    lines: list[_Line | None]
    indices: list[int] = field(default_factory=list)
    broken: bool = False
    first: bool = True

    def chosen(self) -> list[_Line]:
        return [line for line in self.lines if line is not None]

    def note_losses(self) -> None:
        for line in self.chosen():
            before, line.lost = line.lost, line.stream.lost
            line.count.lost += line.lost - before


class Inlet:
    """Reads the channels of one prefix, from :meth:`start` to :meth:`stop`.

    The taking thread passes each batch to ``put`` when it has ``chunk_bytes``, or after ``flush_ns``. ``qos``
    is topic → configured QoS; ``watch`` gets each attached stream and returns a function to call with its
    messages, or None. ``clock`` also stamps the messages.
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
        watch: Callable[[Stream], OnMessage | None] = lambda _: None,
        clock: Clock = SYSTEM,
    ) -> None:
        self._clock = clock
        self._namespace, self._selection, self._put = namespace, selection, put
        self._chunk_bytes, self._flush_ns = chunk_bytes, flush_ns
        self._qos = qos or {}
        self._watch = watch
        # channel id → how files name it, for every channel that was ever taken
        self.channels: dict[int, ChannelInfo] = {}
        self.counts: dict[str, TopicCount] = {}  # topic → what was taken and missed
        self.failures: dict[str, ChannelError] = {}  # object name → why it cannot be taken
        # what ended the taking thread before its time; None if nothing has
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
        """Attach to the existing objects; after this returns, every message is taken."""
        self.look_after()
        self._thread.start()
        self._started = True
        self._ready.wait()

    def stop(self) -> None:
        """Take the remaining messages, put the last batch, and close everything."""
        self._stopping = True
        self._group.wake()
        if self._started:
            self._thread.join()
        for entry in self._entries.values():
            entry.note_losses()
            entry.carried.close()
        self._entries.clear()

    def look_after(self) -> None:
        """Count losses, attach to new objects, release removed ones; call this about once per second.

        Raises ChannelError SHM123 if the directory cannot be listed.
        """
        for name, entry in list(self._entries.items()):
            entry.note_losses()
            if entry.broken or not entry.carried.still_there():
                del self._entries[name]
                self._jobs.append(lambda entry=entry: self._drop(entry))  # type: ignore[misc]
        now = self._clock.monotonic_ns()
        for name, part in self._namespace.objects():
            if name in self._entries or name in self._skipped or now < self._retry_at.get(name, 0):
                continue
            if part in (Part.TOPIC, Part.REQUEST, Part.GOAL):
                self._open(name, part, now)
        self._group.wake()

    def _open(self, name: str, part: Part, now: int) -> None:
        found = self._namespace.name_of(name)
        if found is not None and not any(topic in self._selection for topic in topics_of(found[0], part)):
            self._skipped.add(name)
            return
        path, since = Path(self._namespace.directory) / name, self._began_ns if self._started else None
        try:
            if part is Part.TOPIC:
                carried = Carried(path, since_ns=since)
            else:
                kind = CarriedAction if part is Part.GOAL else CarriedService
                carried = kind(self._namespace, path, since_ns=since)
        except ChannelError as error:
            self._retry_at[name] = now + _RETRY_NS
            if error.code not in ("SHM101", "SHM111"):  # those are about to be replaced, or gone
                self.failures[name] = error
            return
        self.failures.pop(name, None)
        lines = [
            self._line(carried, one) if one.topic in self._selection else None for one in carried.streams
        ]
        if not any(lines):
            carried.close()
            self._skipped.add(name)
            return
        entry = self._entries[name] = _Entry(carried, lines)
        self._jobs.append(lambda: self._add(entry))

    def _line(self, carried: Carried, stream: Stream) -> _Line:
        count = self.counts.setdefault(stream.topic, TopicCount(stream.codec.layout.type_name))
        prefix, qos = self._namespace.prefix, self._qos.get(stream.topic)
        info = channel_info(carried, stream, len(self.channels) + 1, prefix, qos)
        # The same id again after a restart, another one for another layout.
        key = (info.topic, info.schema, info.metadata["rosplc.layout_id"])
        number = self._numbers.setdefault(key, info.id)
        self.channels.setdefault(number, info)
        return _Line(stream, number, count, self._watch(stream))

    # -- the taking thread's own

    def _add(self, entry: _Entry) -> None:
        carried = entry.carried
        try:
            entry.indices = carried.join(self._group)
        except ChannelError:
            entry.broken = True  # look_after opens the name again
        self._by_index |= dict.fromkeys(entry.indices, entry)

    def _drop(self, entry: _Entry) -> None:
        for index in entry.indices:
            self._group.remove(index)
            del self._by_index[index]
        entry.note_losses()
        for line in entry.chosen():
            # A retired object gives nothing out any more, also what was not taken yet.
            line.count.lost += entry.carried.untaken(line.stream)
        entry.carried.close()

    def _run(self) -> None:
        try:
            self._take_all()
        except Exception as error:  # reported where the recording is waited for
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
            taken = False
            if messages:
                if not batch:
                    since = self._clock.monotonic_ns()
                taken = self._gather(batch, messages)
            for index, fault in faults:
                entry = self._by_index[index]
                if isinstance(fault, ChannelError):
                    entry.broken = True  # retired or damaged: look_after opens the name again
                else:
                    entry.chosen()[0].count.refused += 1
            # Behind the taking: what an object that is let go of still held has been taken.
            while self._jobs:
                self._jobs.popleft()()
            self._ready.set()
            full = len(batch.data) >= self._chunk_bytes
            if batch and (full or last or self._clock.monotonic_ns() - since >= self._flush_ns):
                self._put(batch)
                batch = Batch()
            if last and not taken:
                return

    def _gather(self, batch: Batch, messages: list[tuple[int, bytes, int, int, int, int]]) -> bool:
        """Add taken messages to a batch; return whether there were any."""
        now, before = self._clock.time_ns(), len(batch.data)
        by_index, add = self._by_index, batch.add
        for index, message, sequence, _flags, stamp_ns, stamp_clock in messages:
            entry = by_index[index]
            if message and entry.first:
                entry.first = False
                if entry.carried.since_creation and sequence < _LOSS:
                    # overwritten before the new object was found
                    entry.chosen()[0].count.lost += sequence - 1
            # A stamp by the PLC's own clock would look like one by this clock.
            usable = stamp_clock == STAMP_SYSTEM and 0 < stamp_ns < _NO_TIME
            own = ((0, sequence, stamp_ns if usable else now, message),)
            for stream, number, sent_ns, data in own if message else self._events(entry, now):
                if (line := entry.lines[stream]) is None:
                    continue
                line.count.received += 1
                add(line.number, number, now, sent_ns, data)
                if line.on_message is not None:
                    line.on_message(line.stream, data, now)
        return len(batch.data) > before

    def _events(self, entry: _Entry, now: int) -> list[Event]:
        found: list[Event] = []
        try:
            found.extend(entry.carried.events(now))
        except ChannelError:
            entry.broken = True  # retired or damaged: look_after opens the name again
        return found


_MOST_BYTES = 64 << 20


class Outlet:
    """Compresses batches and passes the chunks to ``take``, in order, in a separate thread.

    At most 64 MiB wait, uncompressed; anything beyond is dropped and counted per channel id, as are
    all messages after ``error`` is set.
    """

    def __init__(self, take: Callable[[SealedChunk], None], compression: Compression) -> None:
        self._take, self._compression = take, compression
        self.dropped: Counter[int] = Counter()
        self.error: Exception | None = None
        self._waiting = 0
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(1, "rosplc-chunks")

    def put(self, batch: Batch) -> None:
        """Add a batch; never blocks."""
        size = len(batch.data)
        with self._lock:
            fits = self.error is None and self._waiting + size <= _MOST_BYTES
            if fits:
                self._waiting += size
        if fits:
            self._pool.submit(self._pass_on, batch)
        else:
            self._drop(batch)

    def stop(self) -> None:
        """Process the waiting batches, and end."""
        self._pool.shutdown()

    def _pass_on(self, batch: Batch) -> None:
        with self._lock:
            self._waiting -= len(batch.data)
        if self.error is not None:
            self._drop(batch)
            return
        try:
            self._take(seal(batch, self._compression))
        except Exception as error:  # reported where the recording is waited for
            self._drop(batch)
            with self._lock:
                self.error = error

    def _drop(self, batch: Batch) -> None:
        with self._lock:
            self.dropped.update(batch.counts())


_CHUNK_OVERHEAD = 1024  # what a chunk costs beyond its bytes, rounded up
_CHANNEL_OVERHEAD = 300  # its places in two dictionaries


class Ring:
    """Keeps chunks for ``keep_ns`` and within ``most_bytes``, dropping the oldest; thread-safe."""

    def __init__(self, keep_ns: int, most_bytes: int, clock: Clock = SYSTEM) -> None:
        self._clock = clock
        self._keep_ns, self._most_bytes = keep_ns, most_bytes
        self._chunks: deque[tuple[int, int, SealedChunk]] = deque()
        self._lock = threading.Lock()
        self.size = 0
        self.cut_short = False  # whether the size made a chunk give way before its time

    def take(self, chunk: SealedChunk) -> None:
        """Add a chunk."""
        now = self._clock.monotonic_ns()
        cost = len(chunk.blob) + _CHUNK_OVERHEAD + _CHANNEL_OVERHEAD * len(chunk.counts)
        with self._lock:
            self._chunks.append((now, cost, chunk))
            self.size += cost
            while self._chunks and now - self._chunks[0][0] > self._keep_ns:
                self.size -= self._chunks.popleft()[1]
            while self.size > self._most_bytes and len(self._chunks) > 1:
                self.size -= self._chunks.popleft()[1]
                self.cut_short = True

    def chunks(self) -> list[SealedChunk]:
        """Return the kept chunks, oldest first."""
        with self._lock:
            return [chunk for _, _, chunk in self._chunks]

    @property
    def span_ns(self) -> int:
        """The time from the oldest kept message to the newest."""
        with self._lock:
            if not self._chunks:
                return 0
            return max(
                0, self._chunks[-1][2].index.message_end_time - self._chunks[0][2].index.message_start_time
            )
