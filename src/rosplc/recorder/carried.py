"""What is recorded: a topic's channel, or a service's two objects; and how files name it.

Calls are recorded as ROS 2 does, by the events of its service introspection: those of ``/cell/start`` are
messages ``pkg/srv/Name_Event`` on ``/cell/start/_service_event``. An event repeats a request or response;
client and number (``info``) tell which call it belongs to.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from rosplc.codec import Codec, Wire
from rosplc.described import layout_of
from rosplc.errors import ChannelError, RosplcError
from rosplc.layout import Layout, Limits, SequenceNode, StringNode, compute_layout
from rosplc.model import ArrayType, MessageType, NamedType, SequenceType, StringType, TypeStore
from rosplc.model._rosbags import EMPTY_MEMBER
from rosplc.monitor.watch import open_object
from rosplc.recorder.mcap_file import ChannelInfo
from rosplc.recorder.store import qos_text
from rosplc.ros import DEFAULT, LATCHED, Qos
from rosplc.shm import SERVICE, Description, Direction, Group, Namespace, Part, Reader, SlotInfo, distance
from rosplc.shm.attach import belong_together
from rosplc.shm.constants import ANSWER_DONE, ANSWER_MASK, ASK_WITHDRAWN, STAMP_SYSTEM, WRITER_LINE

EVENTS = "/_service_event"  # what the name of a topic with a service's events ends with
_IN_ORDER, _REPORT_NEWS = 1, 2
_NO_STAMP = 2**31 * 10**9  # a time of ROS has 31 bits of seconds
_IDL = {"bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double"}


def service_of(topic: str, type_name: str) -> str:
    """Return the service whose events a topic has; empty if it has none. As rosbag2 does."""
    events = topic.endswith(EVENTS) and "/srv/" in type_name and type_name.endswith("_Event")
    return topic.removesuffix(EVENTS) if events and "/_action/" not in topic else ""


_NO_COUNT = 1 << 24  # a distance beyond this means that the head is corrupt


class CarriedChannel:
    """An object, attached read-only: recording it disturbs no one.

    ``since_ns`` is when the recording began (ns since 1970), if it has: then what the object holds already is
    taken; if None, what comes after :meth:`join` is. Raises ChannelError as :func:`rosplc.shm.attach`; SHM113
    if the object does not describe itself.
    """

    def __init__(self, path: Path, *, since_ns: int | None) -> None:
        self._attached = open_object(str(path))
        try:
            self.description: Description = self._attached.description
            layout = layout_of(self._attached)
            # Also of a ROS 1 channel: its store is one of ROS 2, as the description gives no version.
            self.codec, self.limits = Codec(layout, Wire.CDR), dict(self.description.limits)
            self._plan = self.codec.plan
            # takes every message in order, and counts what it missed
            self.reader: Reader = self._attached.reader(latched=since_ns is not None)
            self._begun = since_ns is not None
        except BaseException:
            self._attached.close()
            raise
        self.topic = self.description.topic
        # whether it was made while recording, so that its first message is one to take
        self.since_creation = since_ns is not None and self._attached.identity.created_ns >= since_ns
        self.slots = self._attached.identity.slot_count  # one message less can wait

    def join(self, group: Group, mode: int = _IN_ORDER) -> list[int]:
        """Have a group take what comes from now on; return the indices.

        What came while the object was opened is no loss. Raises ChannelError SHM111 if it has been retired.
        """
        self._begin()
        return [group.add_reader(self.reader, self._plan, mode, self.slots)]

    def _begin(self) -> None:
        if not self._begun:
            self._begun = True
            self.reader = self._attached.reader()

    @property
    def lost(self) -> int:
        """Messages that were overwritten before they were taken."""
        return self.reader.lost

    def events(self, now_ns: int) -> Iterator[Event]:
        """Yield what happened, where a group only reports that something has."""
        yield from ()

    def still_there(self) -> bool:
        """Return whether the name still leads to this object."""
        return self._attached.still_there()

    def untaken(self) -> int:
        """Return how many messages the object holds that the reader has not taken."""
        head = self._attached.region.word(WRITER_LINE["head"])
        if not head or not (self.reader.last or self.since_creation):
            return 0
        count = distance(self.reader.last, head, self.slots)
        return count if count < _NO_COUNT else 0

    def close(self) -> None:
        """Unmap the object."""
        self._attached.close()


class Event(NamedTuple):
    """An event of a service: its call's number, its time (ns since 1970), and its CDR."""

    number: int
    time_ns: int
    data: bytes


class CarriedService(CarriedChannel):
    """Both objects of one use of a service; ``path`` is the file of its requests.

    Of a call's messages the first is a request, unless it is withdrawn already; of its answers a response is
    one, and all others report that there is none. Raises ChannelError as :class:`CarriedChannel`; SHM112 if
    the two objects do not belong together.
    """

    def __init__(self, namespace: Namespace, path: Path, *, since_ns: int | None) -> None:
        super().__init__(path, since_ns=since_ns)
        about = self.description
        try:
            other = namespace.path(about.topic, Part.RESPONSE, about.client)
            self._answers = CarriedChannel(other, since_ns=since_ns)
        except BaseException:
            super().close()
            raise
        both = dict(zip(SERVICE, (self, self._answers), strict=True))
        try:
            belong_together({part: one._attached for part, one in both.items()})
            layout = _event_layout(*(one.codec.layout for one in both.values()))
        except RosplcError as error:
            self.close()
            if isinstance(error, ChannelError):
                raise
            what = f"its events have no layout: {error.what} [{error.code}]"
            raise ChannelError("SHM113", what, where=str(path)) from error
        self.limits = {part.word: one.limits for part, one in both.items()}
        self._records = [bytearray(one.codec.layout.size) for one in both.values()]
        self._places = {one.name: one.offset for one in layout.root.members if one.count_of is None}
        self.codec = Codec(layout, Wire.CDR)
        self.topic = about.topic + EVENTS
        self.since_creation = False
        self._call = 0
        own = f"{namespace.prefix}{about.topic} {about.client}".encode()
        self._client = hashlib.md5(own, usedforsecurity=False).digest()  # a PLC has no number

    def join(self, group: Group, mode: int = _REPORT_NEWS) -> list[int]:
        """Have a group report what comes."""
        self._begin()
        self._answers._begin()
        return [*super().join(group, mode), *self._answers.join(group, mode)]

    def events(self, now_ns: int) -> Iterator[Event]:
        """Yield what has happened; a response never comes before its request."""
        response = self._records[1]
        while (answer := self._answers.reader.next(response)) is not None:
            yield from self._asked(now_ns)
            if answer.status & ANSWER_MASK == ANSWER_DONE:
                yield self._event("response", answer, now_ns)
        yield from self._asked(now_ns)

    def _asked(self, now_ns: int) -> Iterator[Event]:
        while (info := self.reader.next(self._records[0])) is not None:
            before, self._call = self._call, info.correlation
            if before != info.correlation and not info.status & ASK_WITHDRAWN:
                yield self._event("request", info, now_ns)

    def _event(self, part: str, info: SlotInfo, now_ns: int) -> Event:
        answers, served = part == "response", self.description.direction is Direction.TO_PLC
        time_ns = now_ns
        if info.stamp_clock == STAMP_SYSTEM and 0 < info.stamp_ns < _NO_STAMP:
            time_ns = info.stamp_ns
        about = {
            # REQUEST_SENT, REQUEST_RECEIVED, RESPONSE_SENT, RESPONSE_RECEIVED: as the PLC sees it.
            "event_type": (2 if served else 3) if answers else int(served),
            "stamp": {"sec": time_ns // 10**9 & 0x7FFFFFFF, "nanosec": time_ns % 10**9},
            "client_gid": info.client if any(info.client) else self._client,
            "sequence_number": int.from_bytes(info.correlation.to_bytes(8, "little"), "little", signed=True),
        }
        record = self.codec.layout.pack({"info": about, part: [{}]})
        at, content = self._places[part], self._records[answers]
        record[at : at + len(content)] = content
        return Event(info.correlation & 0xFFFFFFFF, time_ns, self.codec.encode(record))

    @property
    def lost(self) -> int:
        """Messages of both objects that were overwritten before they were taken."""
        return super().lost + self._answers.lost

    def still_there(self) -> bool:
        """Return whether the names still lead to these objects."""
        return super().still_there() and self._answers.still_there()

    def untaken(self) -> int:
        """Return how many messages the objects hold that were not taken."""
        return super().untaken() + self._answers.untaken()

    def close(self) -> None:
        """Unmap both objects."""
        self._answers.close()
        super().close()


def _event_layout(request: Layout, response: Layout) -> Layout:
    """Return the layout of a service's events, in which the records of both parts have their places."""
    service = request.type_name.removesuffix("_Request")
    types: dict[str, MessageType] = {}
    capacities: dict[str, int] = {}
    for name, part in (("request", request), ("response", response)):
        types |= {each: part.store[each] for each in part.store.dependencies(part.type_name)}
        for path, _, node in part.fields():
            if isinstance(node, StringNode | SequenceNode):
                capacities[f"{name}[].{path}"] = node.capacity
    store = TypeStore("", types).with_events(service)
    return compute_layout(store, f"{service}_Event", Limits(fields=capacities))


def channel_info(carried: CarriedChannel, number: int, prefix: str, qos: Qos | None) -> ChannelInfo:
    """Return how a file names a channel; ``qos`` None where no configuration says it."""
    description, layout = carried.description, carried.codec.layout
    topic, definition = description.part is Part.TOPIC, layout.store.definition_text(layout.type_name)
    # Which QoS the bridge uses is in its configuration alone; these are its defaults.
    qos = qos or (LATCHED if topic and description.direction is Direction.TO_ROS else DEFAULT)
    metadata = {
        "offered_qos_profiles": qos_text(qos),
        "topic_type_hash": layout.store.type_hash(layout.type_name),
        # What a replay needs to make the same channel again.
        "rosplc.direction": description.direction.word,
        "rosplc.limits": json.dumps(carried.limits),
        "rosplc.layout_id": layout.layout_id,
        "rosplc.slots": str(carried.slots),
        "rosplc.distro": description.distro,
        "rosplc.bridge": description.bridge,
        "rosplc.prefix": prefix,
    }
    schema = definition.encode(), "ros2msg"
    if not topic:
        # In .msg text, readers do not find the parts of services by their names.
        metadata["rosplc.definition"] = definition
        schema = _idl(layout.store, layout.type_name).encode(), "ros2idl"
    return ChannelInfo(number, carried.topic, layout.type_name, schema[1], schema[0], "cdr", metadata)


def _idl(store: TypeStore, name: str) -> str:
    parts = (f"{'=' * 80}\nIDL: {each}\n{_module(store[each])}" for each in store.dependencies(name)[::-1])
    return "".join(parts)


def _module(message: MessageType) -> str:
    package, kind, own = message.name.split("/")
    members = []
    for field in message.fields:
        inner, behind = field.type.inner, ""
        text = str(inner)
        if isinstance(inner, NamedType):
            text = text.replace("/", "::")
        elif isinstance(inner, StringType):
            text = "string" if inner.bound is None else f"string<{inner.bound}>"
        else:
            text = _IDL.get(text, text)
        if isinstance(field.type, ArrayType):
            behind = f"[{field.type.length}]"
        elif isinstance(field.type, SequenceType):
            text = (
                f"sequence<{text}>" if field.type.bound is None else f"sequence<{text}, {field.type.bound}>"
            )
        members.append(f"      {text} {field.name}{behind};\n")
    content = "".join(members) or f"      uint8 {EMPTY_MEMBER};\n"
    return f"module {package} {{\n  module {kind} {{\n    struct {own} {{\n{content}    }};\n  }};\n}};\n"
