"""The Write block: one topic towards ROS, as a program in a PLC fills it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, NoReturn

from rosplc.errors import ChannelError
from rosplc.layout import Layout, RecordView
from rosplc.layout.nodes import StructNode
from rosplc.shm import Attached, Direction, Namespace, Peer, Writer, WriterClaim
from rosplc.shm.constants import STAMP_PLC, UNKNOWN, ErrorNumber
from rosplc.virtual_plc.block import Block, error_number
from rosplc.virtual_plc.task import Scan


class Message:
    """A message with settable fields; ``Layout.pack`` accepts it.

    Nested messages are :class:`Message` objects, arrays and sequences are lists, strings are
    ``str``. A field that the type does not have cannot be set; whether a value fits its
    field shows when the message is packed.
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
        """Return a copy of a record that can be changed."""
        return _copy(layout.root, view)

    def update(self, values: Mapping[str, Any]) -> None:
        """Set the named fields; a mapping for a nested message sets only what it names.

        Raises:
            AttributeError: A name is no field of the type.
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
    """Publishes ``msg`` on a topic; the stand-in for a generated ``<Type>_Write``.

    Set ``msg`` and ``xEnable``, then call the instance once per scan: each call with
    ``xEnable`` publishes one message. A call waits for nothing and raises nothing about
    the other side: what is wrong is in ``udiError``.

    Args:
        topic: The topic as ROS writes it.
        layout: The compiled-in layout, as a PLC has it; None takes the object's own
            description, and ``msg`` is then None until the object is open.
        prefix: The bridge's ``prefix:``.
        directory: Where the objects stand.
        beat_ms: The longest time between two calls that this block promises; the bridge
            takes the PLC for gone after three of them.

    Attributes:
        msg: The message to send; every field can be set. None before the type is known.
        xEnable: Whether a call publishes; False, as it is at first, sends nothing but the beat.
        xAttached: The object is open and fits.
        xReady: The object is open and the claim is this block's: a call will publish.
        xPeerAlive: The bridge beats.
        xPublished: This call published.
        udiSequence: The sequence number of the last published message.
        udiPublished: Messages published since the start.
        udiTaken: The sequence number that the bridge has taken.
        udiSinks: ROS subscribers behind the bridge; None if unknown, as without a bridge that lives.
        udiError: 0, or a number of spec/shm-format.md, section 9.
        reason: ``udiError`` in words.
    """

    def __init__(
        self,
        topic: str,
        *,
        layout: Layout | None = None,
        prefix: str = "rosplc",
        directory: str = "/dev/shm",
        beat_ms: int = 1000,
    ) -> None:
        super().__init__(topic, Namespace(prefix, directory), Direction.TO_ROS, layout, beat_ms)
        self.msg: Any = None if layout is None else Message.initial(layout)
        self.xEnable = False
        self.xReady = self.xPublished = False
        self.udiPublished = self.udiTaken = 0
        self.udiSinks: int | None = None
        self._claim: WriterClaim | None = None
        self._writer: Writer | None = None
        self._record = bytearray(0 if layout is None else layout.size)
        self._unfilled = False  # msg was made in this call: what the program filled was another

    def close(self) -> None:
        """Release the claim and let go of the object; the next call opens it again."""
        if self._writer is not None:
            self._writer.release()
        self._detach()
        self._writer = self._claim = None
        self._peer = Peer()
        self.xReady = False

    def _run(self, scan: Scan) -> bool:
        self.xPublished = self._unfilled = False
        attached = self._follow(scan)
        if attached is not None and self._opened_times != self._opened:
            self._adopt(attached)
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

    def _adopt(self, attached: Attached) -> None:
        layout = self.layout
        assert layout is not None  # an open link has one
        self._opened = self._opened_times
        self._writer = self._claim = None
        self._peer = Peer()
        self.xReady = False
        if self.msg is None or len(self._record) != layout.size:
            self._record = bytearray(layout.size)
            self.msg = Message.initial(layout)
            self._unfilled = True

    def _claim_line(self, attached: Attached, scan: Scan) -> None:
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

    def _publish(self, writer: Writer) -> None:
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

    def _watch(self, attached: Attached, scan: Scan) -> None:
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
