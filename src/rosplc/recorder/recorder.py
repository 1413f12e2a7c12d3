"""The data logger: records channels to files, continuously or when a trigger fires."""

from __future__ import annotations

import gc
import json
import operator
import re
import sys
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from rosplc._version import __version__
from rosplc.clock import SYSTEM, Clock
from rosplc.errors import RecordingError
from rosplc.layout import Layout, RecordView
from rosplc.layout.nodes import ArrayNode, SequenceNode, StringNode
from rosplc.monitor import Event, Expected, Watch
from rosplc.recorder.carried import Stream
from rosplc.recorder.inlet import Inlet, OnMessage, Outlet, Ring, Selection, TopicCount
from rosplc.recorder.mcap_file import Compression, SealedChunk
from rosplc.recorder.store import FileStore, Split, Written, dated, free_name, try_place
from rosplc.ros import Qos
from rosplc.shm import Namespace

_KINDS = {"stale": ("stale",), "error": ("refused", "lost", "plc-gone", "bridge-gone", "unreadable")}
"""Word → the kinds of events that it includes."""
_OPERATORS: dict[str, Callable[[Any, Any], bool]] = {
    "==": operator.eq, "!=": operator.ne, ">=": operator.ge, "<=": operator.le,
    ">": operator.gt, "<": operator.lt,
}  # fmt: skip
_STEP = r"[A-Za-z][A-Za-z0-9_]*(?:\[[0-9]{1,8}\])?"
_CONDITION = re.compile(
    rf"(?P<topic>(?:/[A-Za-z_][A-Za-z0-9_]*)+)\.(?P<path>{_STEP}(?:\.{_STEP})*)"
    r"\s*(?:(?P<operator>==|!=|>=|<=|>|<)\s*(?P<value>.+?))?\s*"
)
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?")


@dataclass(frozen=True)
class Condition:
    """A condition on one field, ``pose.position.x`` or ``codes[2]``; without an operator: true, or not 0."""

    text: str
    topic: str
    path: str
    operator: str = ""
    value: bool | int | float | str | None = None

    def check(self, layout: Layout) -> None:
        """Raise RecordingError REC005 unless the type has the field and the comparison is possible."""
        nodes = {path: node for path, _, node in layout.fields()}
        wanted = re.sub(r"\[[0-9]+\]", "[]", self.path)
        node = nodes.get(wanted)
        if node is None:
            last = wanted.split(".")[-1]
            known = [path for path in nodes if path.split(".")[-1] == last] or list(nodes)
            listed = ", ".join(known[:8]) + (", …" if len(known) > 8 else "")
            raise self._wrong(f"{layout.type_name} has no field {self.path}; it has {listed}")
        if isinstance(node, (ArrayNode, SequenceNode)):
            raise self._wrong(f"{self.path} has several elements; specify one, such as {self.path}[0]")
        if isinstance(node, StringNode):
            if not isinstance(self.value, str) or self.operator not in ("==", "!="):
                raise self._wrong(f"{self.path} is a string: compare it with == or != and quoted text")
        elif isinstance(self.value, str):
            raise self._wrong(f"{self.path} is not a string: compare it with a number, true or false")

    def _wrong(self, what: str) -> RecordingError:
        return RecordingError("REC005", what, where=self.text)

    def holds(self, message: RecordView) -> bool:
        """Return whether the condition is true; it is false for an element that a sequence does not have."""
        value: Any = message
        for step in self.path.split("."):
            name, bracket, index = step.partition("[")
            value = getattr(value, name)
            if bracket:
                at = int(index[:-1])
                if at >= len(value):
                    return False
                value = value[at]
        return bool(value) if not self.operator else _OPERATORS[self.operator](value, self.value)


def parse_condition(text: str) -> Condition:
    """Parse ``/topic.field``, with or without a comparison; raises RecordingError REC005."""
    found = _CONDITION.fullmatch(text.strip())
    if found is None:
        what = f"{text!r} is not a trigger; use stale, error or a topic's field"
        raise RecordingError("REC005", what, where="--trigger")
    value = None if found["value"] is None else _value(found["value"], text)
    return Condition(text.strip(), found["topic"], found["path"], found["operator"] or "", value)


def _value(text: str, where: str) -> bool | int | float | str:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    if len(text) >= 2 and text[0] == text[-1] and text[0] in "'\"":
        return text[1:-1]
    if _NUMBER.fullmatch(text):
        return int(text) if text.lstrip("+-").isdigit() else float(text)
    what = f"{text} is not a number, true, false or quoted text"
    raise RecordingError("REC005", what, where=where)


class Fired(NamedTuple):
    """A trigger that has fired: the time (ns since 1970) and the reason."""

    time_ns: int
    reason: str


class Triggers:
    """All triggers of a recording, used by the taking and the watching thread. REC005: a text is invalid.

    ``stale`` fires when a topic exceeds its maximum age; ``error`` if messages are refused or lost, a bridge
    or PLC is gone, or an object is damaged; ``/plc/status.fault`` when a field becomes true or not 0;
    ``/tank.level > 0.9`` or ``/axis.names[2] == 'gripper'`` when a comparison becomes true, at the first
    message for which it is true after one for which it was false: every message is checked.
    """

    def __init__(self, texts: Iterable[str]) -> None:
        texts = list(texts)
        self._kinds = {kind for text in texts for kind in _KINDS.get(text, ())}
        self.conditions = tuple(parse_condition(text) for text in texts if text not in _KINDS)
        self._fired: deque[Fired] = deque()
        self.problems: list[RecordingError] = []

    @property
    def watches(self) -> bool:
        """Whether channel events are needed."""
        return bool(self._kinds)

    def see(self, events: Sequence[Event]) -> None:
        """Check channel events."""
        for event in events:
            if event.kind in self._kinds:
                self.fire(event.time_ns, f"{event.topic or event.prefix}: {event.kind}: {event.words}")

    def fire(self, time_ns: int, reason: str) -> None:
        """Note that a trigger has fired; callable from any thread."""
        self._fired.append(Fired(time_ns, reason))

    def take(self) -> list[Fired]:
        """Return the triggers that have fired since the last call."""
        return [self._fired.popleft() for _ in range(len(self._fired))]

    def watch(self, stream: Stream) -> OnMessage | None:
        """Return a function for a stream's messages, or None; an invalid field is noted as a problem."""
        mine = []
        for condition in self.conditions:
            if condition.topic == stream.topic:
                try:
                    condition.check(stream.codec.layout)
                except RecordingError as error:
                    self.problems.append(error)
                else:
                    mine.append(condition)
        if not mine:
            return None
        held = [True] * len(mine)  # what holds from the first message on has not become true

        def look(stream: Stream, data: bytes, time_ns: int) -> None:
            message = stream.codec.layout.view(stream.codec.decode(data))
            for at, condition in enumerate(mine):
                before, held[at] = held[at], condition.holds(message)
                if held[at] and not before:
                    self.fire(time_ns, condition.text)

        return look


_LOOK_NS = 250_000_000
_SETTLE_NS = 200_000_000


@dataclass(frozen=True)
class RecordingOptions:
    """The options of a recording."""

    namespace: Namespace  # the channels' prefix and directory
    base: Path  # the file's path without ``.mcap``; of a ring buffer's files, what their names begin with
    selection: Selection = field(default_factory=Selection)
    split: Split = field(default_factory=Split)
    bag: bool = False  # write folders as `ros2 bag record` does
    compression: Compression = "zstd"
    chunk_bytes: int = 1 << 20
    flush_ns: int = 1_000_000_000  # how old a chunk becomes before it is written: what a crash may cost
    qos: Mapping[str, Qos] = field(default_factory=dict)  # topic → QoS, as far as a configuration says it
    distro: str = ""  # the ROS distribution that is named in the file
    keep_ns: int = 0  # how much a ring buffer keeps; 0: everything is written at once
    memory: int = 200_000_000  # bytes that a ring buffer's chunks may have
    triggers: Sequence[str] = ()
    after_ns: int = 0  # how long it goes on after a trigger before it is saved
    most_files: int = 100  # how many times it is saved; more would fill the disk
    expected: Expected | None = None  # what is stale, as far as a configuration says it


@dataclass(frozen=True)
class Progress:
    """The progress of a recording: ``size`` in bytes; ``span_ns`` is the time span in a ring buffer."""

    seconds: float
    topics: int
    received: int
    lost: int
    size: int
    span_ns: int
    files: int


@dataclass(frozen=True)
class Result:
    """The result of a recording."""

    files: tuple[Written, ...]
    topics: Mapping[str, TopicCount]
    seconds: float
    saves: tuple[str, ...] = ()  # why a ring buffer was saved, each time
    unsaved: int = 0  # triggers after the last save
    cut_short: bool = False  # whether memory held less than it was to keep

    @property
    def received(self) -> int:
        """Number of messages taken and kept, of all topics."""
        return sum(topic.received for topic in self.topics.values())

    @property
    def lost(self) -> int:
        """Number of missed messages, of all topics."""
        return sum(topic.lost + topic.refused for topic in self.topics.values())


@contextmanager
def quick_process() -> Iterator[None]:
    """Make this process respond quickly, for a program that only records.

    A computing thread yields after half a millisecond instead of five, and garbage collection skips objects
    that existed at the start. Otherwise, messages of channels with few slots would be lost.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(0.0005)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)


class Recorder:
    """A recording; call :meth:`start`, then :meth:`look_after` a few times per second, then :meth:`stop`.

    Raises RecordingError: REC005 if a trigger is invalid; REC001 or REC002 if the file cannot be created.
    """

    def __init__(self, options: RecordingOptions, clock: Clock = SYSTEM) -> None:
        self.options = options
        self._clock = clock
        self._triggers = Triggers(options.triggers)
        self._ring = Ring(options.keep_ns, options.memory, clock) if options.keep_ns else None
        self._outlet = Outlet(self._take, options.compression)
        self.inlet = Inlet(
            options.namespace,
            options.selection,
            self._outlet.put,
            chunk_bytes=options.chunk_bytes,
            flush_ns=options.flush_ns,
            qos=options.qos,
            watch=self._triggers.watch,
            clock=clock,
        )
        self._store = None if self._ring is not None else self._new_store(options.base, {})
        self._watch: Watch | None = None
        if self._triggers.watches:
            prefix, directory = options.namespace.prefix, str(options.namespace.directory)
            self._watch = Watch(prefix, directory=directory, expected=options.expected, clock=clock)
        self._files: list[Written] = []
        self._saves: list[str] = []
        self._waiting: list[Fired] = []
        self._due_ns = 0
        self._saver: threading.Thread | None = None
        self._save_error: Exception | None = None
        self._unsaved = 0
        self._looked_ns = 0
        self._began = self._clock.monotonic_ns()
        self.result: Result | None = None

    def start(self) -> None:
        """Start the recording.

        Raises ChannelError SHM123 if the directory cannot be listed; RecordingError REC005 if a trigger's
        field does not exist, REC001 or REC002 if the files of a ring buffer cannot be written.
        """
        if self._ring is not None:
            # Not only when a trigger fires: what is in memory then would be lost.
            try_place(self.options.base)
        try:
            self.inlet.start()
            self._raise_failure()
        except BaseException:
            self.stop()
            raise
        self._began = self._clock.monotonic_ns()
        self._looked_ns = self._clock.monotonic_ns()

    def look_after(self) -> None:
        """Check channels, triggers and failures; after REC001 or REC002, :meth:`stop` finishes the files."""
        now = self._clock.monotonic_ns()
        if now - self._looked_ns >= _LOOK_NS:
            self._looked_ns = now
            self.inlet.look_after()
            if self._watch is not None:
                seen = [
                    event
                    for event in self._watch.look().events
                    if not event.topic or event.topic in self.options.selection
                ]
                self._triggers.see(seen)
        self._raise_failure()
        if self._ring is not None:
            fired = self._triggers.take()
            if fired and not self._waiting:
                # The chunk of the moment is written when it is full: until then it is waited for as well.
                self._due_ns = now + self.options.after_ns + self.options.flush_ns + _SETTLE_NS
            self._waiting += fired
            saving = self._saver is not None and self._saver.is_alive()
            if self._waiting and now >= self._due_ns and not saving:
                self._save()

    def _raise_failure(self) -> None:
        for error in (self.inlet.error, self._outlet.error, self._save_error, *self._triggers.problems):
            if error is not None:
                raise error

    def trigger(self, reason: str) -> None:
        """Save the ring buffer, as a trigger would; callable from any thread."""
        self._triggers.fire(self._clock.time_ns(), reason)

    def idle_triggers(self) -> dict[str, str]:
        """Return the triggers on topics without any message so far: text → topic."""
        known = self.inlet.counts
        return {one.text: one.topic for one in self._triggers.conditions if one.topic not in known}

    def progress(self) -> Progress:
        """Return the progress."""
        counts = list(self.inlet.counts.values())
        dropped = sum(self._dropped().values())
        store, ring = self._store, self._ring
        return Progress(
            seconds=self._seconds(),
            topics=len(counts),
            received=sum(count.received for count in counts) - dropped,
            lost=sum(count.lost + count.refused for count in counts) + dropped,
            size=store.size if store is not None else ring.size if ring is not None else 0,
            span_ns=0 if ring is None else ring.span_ns,
            files=len(self._files) if store is None else len(store.written),
        )

    def stop(self) -> Result:
        """Take the remaining messages, finish the files, and return the result.

        Without messages, only a ring buffer's files stay. Raises REC001 or REC002 if the last has no summary.
        """
        seconds = self._seconds()
        self.inlet.stop()
        self._outlet.stop()
        if self._watch is not None:
            self._watch.close()
        if self._ring is not None:
            self._waiting += self._triggers.take()
            self._join()
            if self._waiting:
                self._save()
                self._join()
        failure = self._save_error
        if self._store is not None:
            try:
                self._store.finish()
            except RecordingError as error:
                failure = error
            self._files = self._store.written
            if failure is None and not any(count.received for count in self.inlet.counts.values()):
                self._store.discard()
                self._files = []
        files, saves = tuple(self._files), tuple(self._saves)
        cut_short = self._ring is not None and self._ring.cut_short
        self.result = Result(files, self._topics(), seconds, saves, self._unsaved, cut_short)
        if failure is not None:
            raise failure
        return self.result

    def _seconds(self) -> float:
        return (self._clock.monotonic_ns() - self._began) / 1e9

    def _take(self, chunk: SealedChunk) -> None:
        target = self._ring or self._store
        assert target is not None
        target.take(chunk)

    def _new_store(self, base: Path, more: Mapping[str, str]) -> FileStore:
        options = self.options
        facts, split, bag = lambda: {**self._facts(), **more}, options.split, options.bag
        return FileStore(base, self.inlet.channels, facts, split=split, bag=bag, distro=options.distro)

    # -- the ring buffer

    def _save(self) -> None:
        """Write the ring buffer's content in a separate thread, while messages are still taken."""
        assert self._ring is not None
        fired, self._waiting = self._waiting, []
        if len(self._saves) >= self.options.most_files:
            self._unsaved += len(fired)
            return
        chunks = self._ring.chunks()
        reasons = list(dict.fromkeys(one.reason for one in fired))
        base = free_name(dated(self.options.base, fired[0].time_ns))
        facts = {
            "trigger": json.dumps(reasons, ensure_ascii=False),
            "trigger_ns": json.dumps([one.time_ns for one in fired]),
        }

        def write() -> None:
            try:
                store = self._new_store(base, facts)
                try:
                    for chunk in chunks:
                        store.take(chunk)
                finally:
                    store.finish()
                    self._files += store.written
                self._saves.append("; ".join(reasons))
            except Exception as error:  # reported where the recording is waited for
                self._save_error = error

        self._saver = threading.Thread(target=write, name="rosplc-save", daemon=True)
        self._saver.start()

    def _join(self) -> None:
        if self._saver is not None:
            self._saver.join()

    # -- facts

    def _dropped(self) -> Counter[str]:
        dropped: Counter[str] = Counter()
        taken_back = Counter() if self._store is None else self._store.taken_back
        for number, count in [*self._outlet.dropped.items(), *taken_back.items()]:
            dropped[self.inlet.channels[number].topic] += count
        return dropped

    def _topics(self) -> dict[str, TopicCount]:
        dropped = self._dropped()
        return {
            topic: replace(count, received=count.received - dropped[topic], lost=count.lost + dropped[topic])
            for topic, count in sorted(self.inlet.counts.copy().items())
        }

    def _facts(self) -> dict[str, str]:
        topics = self._topics()
        return {
            "rosplc": __version__,
            "prefix": self.options.namespace.prefix,
            "lost": json.dumps({name: topic.lost for name, topic in topics.items() if topic.lost}),
            "refused": json.dumps({name: topic.refused for name, topic in topics.items() if topic.refused}),
            "lost_total": str(sum(topic.lost for topic in topics.values())),
        }
