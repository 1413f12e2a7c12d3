"""The Read and Write blocks, with which a PLC program reads or writes a ROS topic.

A block finds its object as a PLC does (``spec/shm-format.md``, sections 8 and 9): it never creates, deletes
or waits. It compares state and layout id at every call. All blocks together make at most one attempt to open
per scan, with back-off.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar, Literal, NoReturn

from rosplc import shm
from rosplc.described import described_layout, layout_of
from rosplc.errors import ChannelError
from rosplc.layout import Layout, RecordView
from rosplc.layout.nodes import StructNode
from rosplc.shm.constants import STAMP_PLC, UNKNOWN, WRITER_LINE, ErrorNumber
from rosplc.virtual_plc.task import Scan, current_scan

_FIRST_DELAY_NS = 20_000_000
_LONGEST_DELAY_NS = 1_000_000_000


def error_number(error: ChannelError) -> int:
    """Return the error number (spec/shm-format.md, section 9) that a function block shows."""
    return int(error.code.removeprefix("SHM"))


class _Instance(ABC):
    """An instance of a block; it belongs to the task that calls it first.

    Attributes:
        udiReentries: Number of refused calls: another task owns the instance or was inside.
    """

    def __init__(self) -> None:
        self.udiError = self.udiReentries = 0
        self.reason = ""
        self._task = ""
        self._busy = threading.Lock()

    @property
    def xError(self) -> bool:
        """Whether ``udiError`` is not 0."""
        return self.udiError != 0

    @property
    def eError(self) -> ErrorNumber | None:
        """``udiError`` as an enumeration value; None while it is 0."""
        return ErrorNumber(self.udiError) if self.udiError else None

    @contextmanager
    def _entered(self) -> Iterator[Scan | None]:
        """Provide the scan of the call; None if another task owns the instance or is inside."""
        scan = current_scan()
        if not self._busy.acquire(blocking=False):
            self.udiReentries += 1
            yield None
            return
        try:
            self._task = self._task or scan.task
            foreign = bool(scan.task) and self._task != scan.task
            self.udiReentries += foreign
            yield None if foreign else scan
        finally:
            self._busy.release()

    def __call__(self) -> bool:
        """Run the block once.

        Return ``xNew`` or ``xPublished``; for a client ``xDone``; for a server whether it has a current call.

        Raises:
            LayoutError: LAY006 if a value to send does not fit its field; nothing is sent.
        """
        with self._entered() as scan:
            if scan is not None:
                return self._run(scan)
            self.udiError, self.reason = ErrorNumber.REENTERED.value, "the instance belongs to another task"
            return False

    @abstractmethod
    def _run(self, scan: Scan) -> bool: ...


class Block(_Instance):
    """A block for one topic.

    Attributes:
        layout: The layout of ``msg``, or None before it is known.
    """

    _direction: ClassVar[shm.Direction]
    msg: Any = None
    _record: bytearray

    def __init__(
        self,
        topic: str,
        *,
        layout: Layout | None = None,
        prefix: str = "rosplc",
        directory: str = "/dev/shm",
        beat_ms: int = 1000,
    ) -> None:
        super().__init__()
        self.topic = topic
        self.xAttached = self.xPeerAlive = False
        self.udiSequence = 0
        self.layout = self._compiled = layout
        self._namespace = shm.Namespace(prefix, directory)
        self._part, self._client = shm.Part.TOPIC, ""
        self._attached: shm.Attached | None = None
        self._failure: tuple[int, str] = (ErrorNumber.NO_OBJECT.value, "")  # 0 while the object is open
        self._opened_times = 0
        self._map_writable = True
        self._delay_ns = self._due_ns = 0  # of the next attempt to open
        self._beat_ms = beat_ms
        self._opened = 0
        self._peer = shm.Peer()
        if layout is not None:
            self._use_layout(layout)

    def _report_silence(self) -> None:
        if self.udiError == 0 and self._peer.silent:
            self.udiError, self.reason = ErrorNumber.PEER_SILENT.value, "the bridge sends no heartbeat"

    @abstractmethod
    def _use_layout(self, layout: Layout) -> None:
        """Create ``msg`` and the record."""

    @abstractmethod
    def _adopt(self, attached: shm.Attached, scan: Scan) -> None:
        """Start to use another object."""

    # -- the way to the object

    def _object_of(self, scan: Scan) -> shm.Attached | None:
        """Return the object if it is open and valid; adopt it first if it is a new one."""
        attached, layout = self._follow(scan), self.layout
        if attached is not None and layout is not None and self._opened_times != self._opened:
            if self.msg is None or len(self._record) != layout.size:
                self._use_layout(layout)
            self._peer = shm.Peer()
            self._adopt(attached, scan)
            self._opened = self._opened_times
        return attached

    def _follow(self, scan: Scan) -> shm.Attached | None:
        """Return the object if it is open and valid; otherwise, try once to open it. Raises nothing."""
        if self._attached is not None:
            try:
                self._attached.valid()
            except ChannelError as error:
                self._drop(error)
                # An object is retired when the next one takes its place: look at once.
                self._delay_ns = self._due_ns = 0
            else:
                return self._attached
        if scan.now_ns < self._due_ns or not scan.claim_open():
            return None
        try:
            self._open()
        except ChannelError as error:
            self._failure = error_number(error), str(error)
            self._back_off(scan)
            return None
        self._failure = 0, ""
        return self._attached

    def _drop(self, error: ChannelError) -> None:
        """Close the object because of ``error``; later scans open it again."""
        self._detach()
        self._failure = error_number(error), str(error)

    def _look_for_another(self, scan: Scan) -> None:
        """Open the name again beside a silent object; switch if it refers to another object.

        If a bridge's file is removed, the bridge creates a new object, which is not visible
        from the old one (spec, section 8.6). Until then, the old object is kept, so that a
        claim and the position in the stream survive a temporary absence of the bridge.
        """
        old = self._attached
        if old is None or scan.now_ns < self._due_ns or not scan.claim_open():
            return
        try:
            if old.still_there():
                self._back_off(scan)
                return
            self._open()
        except ChannelError as error:
            self._failure = self._failure[0], str(error)
            self._back_off(scan)
            return
        old.close()

    def _detach(self) -> None:
        if self._attached is not None:
            self._attached.close()
            self._attached = None

    def close(self) -> None:
        """Close the object; the next call opens it again."""
        self._detach()

    def _back_off(self, scan: Scan) -> None:
        self._delay_ns = min(_LONGEST_DELAY_NS, self._delay_ns * 2 or _FIRST_DELAY_NS)
        self._due_ns = scan.now_ns + self._delay_ns

    def _open(self) -> None:
        compiled = self._compiled
        try:
            attached = shm.attach(
                self._namespace,
                self.topic,
                direction=self._direction,
                write=self._map_writable,
                part=self._part,
                client=self._client,
            )
        except ChannelError as error:
            if error.code == "SHM102" and self._direction is shm.Direction.TO_PLC:
                # A reader needs no rights to write; without them it only has no reader line.
                self._map_writable = False
            raise
        try:
            if compiled is None:
                self.layout = layout_of(attached)
            else:
                self._compare(attached, compiled)
        except ChannelError:
            attached.close()
            raise
        self._attached = attached
        self._opened_times += 1
        self._delay_ns = self._due_ns = 0

    def _compare(self, attached: shm.Attached, compiled: Layout) -> None:
        found = attached.identity.layout_id
        if found == compiled.layout_id and attached.identity.record_size == compiled.size:
            return
        made_for = f"layout {compiled.layout_id} of {compiled.type_name}"
        what = f"the program was generated for {made_for}, but the object has layout {found}"
        try:
            what += f": {compiled.difference(described_layout(attached.description, where=self.topic))}"
        except ChannelError as error:
            # That the ids differ is certain; what differs only the description could tell.
            what += f" (the difference is unknown: {error.what})"
        raise ChannelError("SHM112", what, where=self.topic)


OnStale = Literal["hold", "zero", "value"]


class ReadBlock(Block):
    """Reads a topic once per scan; simulates a generated ``<Type>_Read``.

    Call the instance in every scan, then use its outputs, which are those of the PLC's block
    (docs/reference/plc-blocks.md). A call never waits and raises no exception for problems of the other side:
    they are in ``udiError``, and as text in ``reason``. ``msg`` is the message as a typed view, None before
    its type is known; ``info`` is its slot header (stamp, flags); ``age`` is ``tAge`` in seconds;
    ``udiSources`` is None where the PLC has 16#FFFFFFFF.

    Args:
        topic: The topic's ROS name.
        layout: The compiled-in layout, as in a PLC: an object with another layout is refused (error 112).
            None uses the object's own description.
        prefix: The bridge's ``prefix:``.
        directory: The directory of the objects.
        stale_after: Seconds without a new message after which ``xStale`` is set; None: never.
        on_stale: What ``msg`` contains then: the last message, zeros, or with ``value`` the ``stale_value``.
        stale_value: Field values for ``on_stale="value"``; omitted fields have initial values.
        mode: ``latest`` skips to the newest message and counts the skipped ones as lost; ``every`` takes
            them in order: one per call, :meth:`next` for more.
        max_per_cycle: With ``every``: the maximum number of messages in one scan.
        latched: Treat a message that is present at the first attach as new.
        beat_ms: The longest time between two calls that this block promises; tools consider the PLC gone
            after three such times.
    """

    _direction = shm.Direction.TO_PLC
    msg: RecordView | None = None

    def __init__(
        self,
        topic: str,
        *,
        layout: Layout | None = None,
        prefix: str = "rosplc",
        directory: str = "/dev/shm",
        stale_after: float | None = 1.0,
        on_stale: OnStale = "hold",
        stale_value: Mapping[str, Any] | None = None,
        mode: Literal["latest", "every"] = "latest",
        max_per_cycle: int = 8,
        latched: bool = False,
        beat_ms: int = 1000,
    ) -> None:
        if stale_after is not None and not stale_after > 0:
            raise ValueError(f"{topic}: stale_after must be above 0 s, or None, not {stale_after}")
        if max_per_cycle < 1:
            raise ValueError(f"{topic}: max_per_cycle must be at least 1")
        if (on_stale == "value") != (stale_value is not None):
            raise ValueError(f'{topic}: on_stale="value" and stale_value require each other')
        self._stale_value = stale_value
        super().__init__(topic, layout=layout, prefix=prefix, directory=directory, beat_ms=beat_ms)
        self.xValid = self.xNew = False
        self.xFirst = self.xTruncated = self.xSubstituted = self.xRecovered = False
        self.xSourcePresent = False
        self.xStale = stale_after is not None
        self.udiLost = self.uiTaken = 0
        self.udiSources: int | None = None
        self.age = 0.0
        self.info: shm.SlotInfo | None = None
        self._stale_after_ns = None if stale_after is None else round(stale_after * 1e9)
        self._on_stale = on_stale
        self._every = mode == "every"
        self._max_per_cycle = max_per_cycle
        self._latched = latched
        self._claim: shm.ReaderClaim | None = None
        self._reader: shm.Reader | None = None
        self._ever_new = False
        self._writer = 0  # claim of the writer whose message was taken last
        self._since_ns: int | None = None

    def next(self) -> bool:
        """With ``mode="every"``, take one more message in this scan; return whether there was one.

        ``msg`` then shows it; ``xNew`` stays set, as in the PLC.
        """
        if not self._every:
            return False
        with self._entered() as scan:
            # A link that found another object in this scan has closed the one of this reader.
            if scan is None or self._reader is None or self._opened_times != self._opened:
                return False
            try:
                return self._take(self._reader, scan)
            except ChannelError as error:
                self._drop(error)
                self._reader = self._claim = None
                return False

    def each(self) -> Iterator[RecordView]:
        """Run the block and yield ``msg`` for each message that this scan may take.

        After each step, the view shows the next message, so copy what you need for longer.
        """
        more = self()
        while more and self.msg is not None:
            yield self.msg
            more = self.next()

    def close(self) -> None:
        """Close the object; the next call opens it again."""
        self._detach()
        self._reader = self._claim = None
        self.xAttached = self.xPeerAlive = False

    def _run(self, scan: Scan) -> bool:
        self.xNew = self.xRecovered = self.xSourcePresent = False
        self.udiSources = None
        self.uiTaken = 0
        if self._since_ns is None:
            self._since_ns = scan.now_ns
        try:
            attached = self._object_of(scan)
            if attached is not None and self._reader is not None:
                if self._claim is not None and self._claim.attempt(scan.now_ns):
                    self._claim = None
                self._take(self._reader, scan)
                self._reader.beat()
                self._watch(attached, scan)
        except ChannelError as error:  # retired between the check and the copy, or not readable
            self._drop(error)
        self.xAttached = self._attached is not None
        if not self.xAttached:
            self.xPeerAlive = False
            self._reader = self._claim = None
        self.udiError, self.reason = self._failure
        self._report_silence()
        self._judge_age(scan)
        return self.xNew

    def _adopt(self, attached: shm.Attached, scan: Scan) -> None:
        latched = self._latched and self._opened == 0
        self._reader = attached.reader(latched=latched)
        # The line is for people who ask who reads; reading itself does not depend on it.
        self._claim = None
        if attached.region.writable:
            self._claim = shm.ReaderClaim(attached.region, self._reader, self._beat_ms, scan.task, range(4))
        if not latched:
            # Rule M14: what was published before is in msg, valid but never new.
            found = self._reader.peek_record()
            if found is not None:
                self._show(*found)

    def _use_layout(self, layout: Layout) -> None:
        self._record = bytearray(layout.initial())
        self.msg = layout.view(self._record)
        self.xValid = False
        # Packed once: a wrong stale_value then shows at the first opening, not when data stops.
        value = self._stale_value
        self._stale_record = bytes(layout.size) if value is None else bytes(layout.pack(value))

    def _take(self, reader: shm.Reader, scan: Scan) -> bool:
        if self._every and self.uiTaken >= self._max_per_cycle:
            return False
        found = reader.next_record() if self._every else reader.latest_record()
        if found is None:
            return False
        info = found[1]
        self.uiTaken += 1
        self.udiLost += info.lost
        self._show(*found)
        # The mark may be on a skipped message; a change of the claim and the silence are still seen.
        assert self._attached is not None
        epoch = self._attached.region.words(WRITER_LINE["writer_epoch"], 1)[0]
        another = epoch not in (0, self._writer)
        self.xRecovered = self.xFirst or self.xStale or another or not self._ever_new
        self._writer = epoch or self._writer
        self.xNew = self._ever_new = True
        self._since_ns = scan.now_ns
        return True

    def _show(self, record: bytes, info: shm.SlotInfo) -> None:
        # Only a copy that passed the re-check reaches msg (spec M12).
        self._record[:] = record
        self.info, self.udiSequence, self.xValid = info, info.sequence, True
        self.xFirst, self.xTruncated, self.xSubstituted = (bool(info.flags & bit) for bit in (1, 2, 4))

    def _watch(self, attached: shm.Attached, scan: Scan) -> None:
        state = attached.snapshot().writer
        peer = self._peer
        peer.observe(state.beat, state.head, state.beat_ms, scan.now_ns)
        self.xPeerAlive = peer.alive
        if peer.alive and state.sources != UNKNOWN:  # what a dead bridge knew last says nothing about now
            self.udiSources = state.sources
            self.xSourcePresent = state.sources > 0
        if peer.silent:
            self._look_for_another(scan)

    def _judge_age(self, scan: Scan) -> None:
        age_ns = max(0, scan.now_ns - (scan.now_ns if self._since_ns is None else self._since_ns))
        self.age = age_ns / 1e9
        limit = self._stale_after_ns
        self.xStale = limit is not None and (age_ns > limit or not self._ever_new)
        if self.xStale and self._on_stale != "hold" and self.msg is not None:
            # At every scan, so that a state found at the start does not show either.
            self._record[:] = self._stale_record
            self.xSubstituted = True


class Message:
    """A message with settable fields; ``Layout.pack`` accepts it.

    Nested messages are :class:`Message` objects, arrays and sequences are lists, strings are
    ``str``. A field that the type does not have cannot be set. Whether a value fits its field
    is checked when the message is packed.
    """

    __slots__ = ("_type_name", "_values")

    _type_name: str
    _values: dict[str, Any]

    def __init__(self, type_name: str, values: dict[str, Any]) -> None:
        put = object.__setattr__
        put(self, "_type_name", type_name)
        put(self, "_values", values)

    @classmethod
    def initial(cls, layout: Layout) -> Message:
        """Return a message with the type's default values."""
        return cls.of(layout, layout.view(layout.initial()))

    @classmethod
    def of(cls, layout: Layout, view: RecordView) -> Message:
        """Return a mutable copy of a record."""
        return _copy(layout.root, view)

    def update(self, values: Mapping[str, Any]) -> None:
        """Set the given fields; a mapping for a nested message sets only the fields in the mapping.

        Raises:
            AttributeError: A name is not a field of the type.
        """
        for name, value in values.items():
            present = getattr(self, name)
            if isinstance(present, Message) and isinstance(value, Mapping):
                present.update(value)
            else:
                self._values[name] = value

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # no ROS field does; copy and pickle look for such names early
            raise AttributeError(name)
        try:
            return self._values[name]
        except KeyError:
            self._refuse(name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self._values:
            self._refuse(name)
        if isinstance(value, Mapping) and isinstance(self._values[name], Message):
            self._values[name].update(value)
        else:
            self._values[name] = value

    def __reduce__(self) -> tuple[object, ...]:
        # The usual way would set the slots by name, which __setattr__ refuses.
        return (Message, (self._type_name, self._values))

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._values]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Message):
            return NotImplemented
        return self._type_name == other._type_name and self._values == other._values

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={value!r}" for name, value in self._values.items())
        return f"{self._type_name.rpartition('/')[2]}({fields})"

    def _refuse(self, name: str) -> NoReturn:
        fields = ", ".join(self._values) or "none"
        raise AttributeError(f"{self._type_name} has no field {name!r}; its fields: {fields}")


def _copy(node: StructNode, view: RecordView) -> Message:
    values = {}
    for member in node.members:
        if not member.name or member.count_of is not None:
            continue
        value, element = getattr(view, member.name), getattr(member.node, "element", member.node)
        if isinstance(element, StructNode):
            several = isinstance(value, list)
            value = [_copy(element, item) for item in value] if several else _copy(element, value)
        values[member.name] = value
    return Message(node.type_name, values)


class WriteBlock(Block):
    """Publishes ``msg`` on a topic; simulates a generated ``<Type>_Write``.

    Set ``msg`` and ``xEnable``, then call the instance once per scan: each call with ``xEnable`` publishes
    one message. ``msg`` is None before the type is known; after that, every field can be set. The other pins,
    ``reason``, ``layout``, ``prefix``, ``directory`` and ``beat_ms`` are as for :class:`ReadBlock`.
    """

    _direction = shm.Direction.TO_ROS
    xEnable = xReady = xPublished = False
    udiPublished = udiTaken = 0
    udiSinks: int | None = None
    _claim: shm.WriterClaim | None = None
    _writer: shm.Writer | None = None
    _unfilled = False  # msg was made in this call: what the program filled was another

    def close(self) -> None:
        """Release the claim and close the object; the next call opens it again."""
        if self._writer is not None:
            self._writer.release()
        self._detach()
        self._writer = self._claim = None
        self._peer = shm.Peer()
        self.xReady = False

    def _run(self, scan: Scan) -> bool:
        self.xPublished = self._unfilled = False
        attached = self._object_of(scan)
        if attached is not None:
            if self._writer is None:
                self._claim_line(attached, scan)
            if self._writer is not None:
                self._publish(self._writer)
        if self._attached is not None:
            self._watch(self._attached, scan)
        else:
            self.xReady = self.xPeerAlive = False
            self.udiSinks = None
            self._writer = self._claim = None
            self.udiError, self.reason = self._failure
        self.xAttached = self._attached is not None
        return self.xPublished

    def _adopt(self, attached: shm.Attached, scan: Scan) -> None:
        self._writer = self._claim = None
        self.xReady = False

    def _use_layout(self, layout: Layout) -> None:
        self._record = bytearray(layout.size)
        self.msg = Message.initial(layout)
        self._unfilled = True

    def _claim_line(self, attached: shm.Attached, scan: Scan) -> None:
        self.xReady = False
        try:
            if self._claim is None:
                self._claim = attached.writer_claim(self._beat_ms)
            self._writer = self._claim.attempt(scan.now_ns)
        except ChannelError as error:
            self._drop(error)
            return
        if self._writer is None:
            # It may stop, so the next scans look again.
            self.udiError, self.reason = ErrorNumber.CLAIMED.value, "another writer holds the claim"
        else:
            self._claim = None
            self.udiError, self.reason = 0, ""

    def _publish(self, writer: shm.Writer) -> None:
        layout = self.layout
        assert layout is not None
        try:
            if self.xEnable and not self._unfilled:
                layout.pack_into(self.msg, self._record)
                self.udiSequence = writer.publish(
                    self._record, stamp_ns=time.monotonic_ns(), stamp_clock=STAMP_PLC
                )
                self.udiPublished += 1
                self.xPublished = True
            else:
                writer.check()
                writer.beat()
        except ChannelError as error:
            self._writer, self.xReady = None, False
            if error.code == "SHM115":
                # Its present holder keeps it: a new claim waits for that one's silence.
                self.udiError, self.reason = error_number(error), str(error)
            else:
                self._drop(error)
            return
        self.xReady = True
        self.udiError, self.reason = 0, ""

    def _watch(self, attached: shm.Attached, scan: Scan) -> None:
        state = attached.snapshot()
        line = state.readers[0]
        peer = self._peer
        peer.observe(line.beat, line.taken, line.beat_ms, scan.now_ns)
        self.xPeerAlive = peer.alive
        self.udiTaken = line.taken
        self.udiSinks = line.sinks if peer.alive and line.sinks != UNKNOWN else None
        if peer.silent:
            self._report_silence()
            self._look_for_another(scan)
