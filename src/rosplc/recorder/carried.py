"""The recorded data: a topic's channel, or the objects of a service or action; and their names in files.

Calls are recorded as in ROS 2, by service introspection events: those of ``/cell/start`` are messages
``pkg/srv/Name_Event`` on ``/cell/start/_service_event``. An event repeats a request or response; its client
and number (``info``) identify the call. An action is recorded by the events of its three services, its
feedback and its status, below ``/cell/move/_action``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from rosplc import shm
from rosplc.codec import Codec, Wire
from rosplc.described import layout_of
from rosplc.errors import ChannelError, RosplcError
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.layout.nodes import SequenceNode, StringNode
from rosplc.model import ArrayType, MessageType, NamedType, SequenceType, StringType, TypeStore
from rosplc.model._rosbags import EMPTY_MEMBER
from rosplc.model.types import Field
from rosplc.reasons import Reason
from rosplc.recorder.mcap_file import ChannelInfo
from rosplc.recorder.store import qos_text
from rosplc.ros import DEFAULT, LATCHED, GoalStatus, Qos
from rosplc.ros.actions import STATUS_QOS
from rosplc.ros.goals import CancelCode
from rosplc.shm import constants as spec
from rosplc.shm.attach import belong_together

EVENTS = "/_service_event"  # what the name of a topic with a service's events ends with
_ACTION = "/_action/"
GOALS = f"{_ACTION}send_goal{EVENTS}"  # what the name of a topic with an action's goals ends with
_SERVICES = {
    "send_goal": "{}_SendGoal",
    "cancel_goal": "action_msgs/srv/CancelGoal",
    "get_result": "{}_GetResult",
}
_MESSAGES = {"feedback": "{}_FeedbackMessage", "status": "action_msgs/msg/GoalStatusArray"}
_TOPICS = {
    **{f"{_ACTION}{name}{EVENTS}": f"{kind}_Event" for name, kind in _SERVICES.items()},
    **{f"{_ACTION}{name}": kind for name, kind in _MESSAGES.items()},
}
"""The names of an action's topics, and the types of their messages."""
_COMMON = (
    "unique_identifier_msgs/msg/UUID", "action_msgs/msg/GoalStatusArray",
    "action_msgs/srv/CancelGoal_Request", "action_msgs/srv/CancelGoal_Response",
)  # fmt: skip
_IN_ORDER, _REPORT_NEWS = 1, 2
_NO_STAMP = 2**31 * 10**9  # a time of ROS has 31 bits of seconds
_IDL = {"bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double"}
_MOST_GOALS = 8  # of one use that are remembered
_NO_COUNT = 1 << 24  # a distance beyond this means that the head is corrupt
_ENDS = {
    spec.ANSWER_SUCCEEDED: GoalStatus.SUCCEEDED,
    spec.ANSWER_CANCELED: GoalStatus.CANCELED,
    spec.ANSWER_ABORTED: GoalStatus.ABORTED,
}


def service_of(topic: str, type_name: str) -> str:
    """Return the service whose events a topic contains, or empty; as rosbag2 does."""
    events = topic.endswith(EVENTS) and "/srv/" in type_name and type_name.endswith("_Event")
    return topic.removesuffix(EVENTS) if events and _ACTION not in topic else ""


def action_of(topic: str, type_name: str) -> str:
    """Return the action whose goals a topic contains, or empty."""
    events = "/action/" in type_name and type_name.endswith("_SendGoal_Event")
    return topic.removesuffix(GOALS) if events and topic.endswith(GOALS) else ""


def recorded_name(topic: str) -> str:
    """Return the topic, service or action of a recorded topic."""
    ending = next((one for one in (*_TOPICS, EVENTS) if topic.endswith(one)), "")
    return topic.removesuffix(ending)


def topics_of(name: str, part: shm.Part) -> list[str]:
    """Return the recorded topics of a topic, service or action."""
    endings = {shm.Part.TOPIC: [""], shm.Part.REQUEST: [EVENTS], shm.Part.GOAL: [*_TOPICS]}
    return [name + ending for ending in endings.get(part, ())]


class _Object:
    """An object, attached read-only; arguments and errors are as for :class:`Carried`."""

    def __init__(self, path: Path, *, since_ns: int | None) -> None:
        self.attached = shm.open_object(str(path))
        try:
            layout = layout_of(self.attached)
            # Also of a ROS 1 channel: its store is one of ROS 2, as the description gives no version.
            self.codec, self.limits = Codec(layout, Wire.CDR), dict(self.attached.description.limits)
            # takes every message in order, and counts what it missed
            self.reader: shm.Reader = self.attached.reader(latched=since_ns is not None)
            self._begun = since_ns is not None
        except BaseException:
            self.attached.close()
            raise
        self.record = bytearray(layout.size)
        self.slots = self.attached.identity.slot_count  # one message less can wait

    def begin(self) -> None:
        if not self._begun:
            self._begun = True
            self.reader = self.attached.reader()

    def next(self) -> shm.SlotInfo | None:
        return self.reader.next(self.record)

    @property
    def view(self) -> Any:
        return self.codec.layout.view(self.record)

    def untaken(self, since_creation: bool) -> int:
        head = self.attached.region.word(spec.WRITER_LINE["head"])
        if not head or not (self.reader.last or since_creation):
            return 0
        count = shm.distance(self.reader.last, head, self.slots)
        return count if count < _NO_COUNT else 0


@dataclass(frozen=True)
class Stream:
    """A topic of a recording; losses of ``objects`` count as its own."""

    topic: str
    codec: Codec
    limits: Mapping[str, Any]
    objects: tuple[_Object, ...] = ()
    qos: Qos = DEFAULT  # the bridge's default

    @property
    def lost(self) -> int:
        """Number of messages that were overwritten before they were taken."""
        return sum(one.reader.lost for one in self.objects)


class Event(NamedTuple):
    """An event: its stream, a number, a time (ns since 1970), and its CDR."""

    stream: int
    number: int
    time_ns: int
    data: bytes


class Carried:
    """A topic's channel, attached read-only: recording it has no side effects.

    ``since_ns`` is when the recording began (ns since 1970), None before that. If it is set, messages already
    in the object are taken; otherwise, only those after :meth:`join`. Raises ChannelError as
    :func:`rosplc.shm.attach`; SHM113 if the object has no self-description.
    """

    mode = _IN_ORDER

    def __init__(self, path: Path, *, since_ns: int | None) -> None:
        first = _Object(path, since_ns=since_ns)
        self._objects = [first]
        self.description: shm.Description = first.attached.description
        # whether it was made while recording, so that its first message is one to take
        self.since_creation = since_ns is not None and first.attached.identity.created_ns >= since_ns
        self.slots = first.slots
        # Which QoS the bridge uses is in its configuration alone; these are its defaults.
        qos = LATCHED if self.description.direction is shm.Direction.TO_ROS else DEFAULT
        self.streams: tuple[Stream, ...] = (
            Stream(self.description.topic, first.codec, first.limits, (first,), qos),
        )

    def join(self, group: shm.Group) -> list[int]:
        """Let a group take messages from now on, or report that there are some; return the indices.

        Messages that arrived during the opening do not count as lost. Raises SHM111 if an object was retired.
        """
        for one in self._objects:
            one.begin()
        return [group.add_reader(one.reader, one.codec.plan, self.mode, one.slots) for one in self._objects]

    def events(self, now_ns: int) -> Iterator[Event]:
        """Yield the events, if a group only reports that there are some."""
        yield from ()

    def still_there(self) -> bool:
        """Return whether the names still refer to these objects."""
        return all(one.attached.still_there() for one in self._objects)

    def untaken(self, stream: Stream) -> int:
        """Return the number of messages of a stream in the objects that were not taken."""
        return sum(one.untaken(self.since_creation) for one in stream.objects)

    def close(self) -> None:
        """Unmap the objects."""
        for one in self._objects:
            one.attached.close()


class CarriedService(Carried):
    """The objects of one use of a service; ``path`` is the file of its requests.

    The first message of a call is a request, unless it is already withdrawn. Among a call's answers, only a
    response is recorded; others report that there is no response. Raises ChannelError as :class:`Carried`;
    SHM112 if the objects do not belong together.
    """

    mode = _REPORT_NEWS
    parts: tuple[shm.Part, ...] = shm.SERVICE

    def __init__(self, namespace: shm.Namespace, path: Path, *, since_ns: int | None) -> None:
        super().__init__(path, since_ns=since_ns)
        about = self.description
        try:
            for part in self.parts[1:]:
                other = namespace.path(about.topic, part, about.client)
                self._objects.append(_Object(other, since_ns=since_ns))
            both = dict(zip(self.parts, self._objects, strict=True))
            belong_together({part: one.attached for part, one in both.items()})
            _check_types(both)
            self.streams = self._streams(both)
        except BaseException as error:
            self.close()
            if not isinstance(error, RosplcError) or isinstance(error, ChannelError):
                raise
            what = f"the event type has no valid layout: {error.what} [{error.code}]"
            raise ChannelError("SHM113", what, where=str(path)) from error
        self.since_creation = False
        self._call = 0
        self._served = about.direction is shm.Direction.TO_PLC
        own = f"{namespace.prefix}{about.topic} {about.client}".encode()
        self._client = hashlib.md5(own, usedforsecurity=False).digest()  # a PLC has no number

    def _streams(self, both: Mapping[shm.Part, _Object]) -> tuple[Stream, ...]:
        limits = {part.word: one.limits for part, one in both.items()}
        layouts = {f"{part.word}[].": one.codec.layout for part, one in both.items()}
        service = both[shm.Part.REQUEST].codec.layout.type_name.removesuffix("_Request")
        codec = _codec(with_interface(_merged(*layouts.values()), service), f"{service}_Event", layouts)
        return (Stream(self.description.topic + EVENTS, codec, limits, tuple(self._objects)),)

    def events(self, now_ns: int) -> Iterator[Event]:
        """Yield the events; a response never precedes its request."""
        while (answer := self._objects[1].next()) is not None:
            yield from self._asked(now_ns)
            yield from self._answered(answer, now_ns)
        yield from self._asked(now_ns)

    def _asked(self, now_ns: int) -> Iterator[Event]:
        while (info := self._objects[0].next()) is not None:
            before, self._call = self._call, info.correlation
            if before != info.correlation and not info.status & spec.ASK_WITHDRAWN:
                yield self._event(0, info, now_ns, request=self._objects[0].view)

    def _answered(self, info: shm.SlotInfo, now_ns: int) -> Iterator[Event]:
        if info.status & spec.ANSWER_MASK == spec.ANSWER_DONE:
            yield self._event(0, info, now_ns, response=self._objects[1].view)

    def _event(self, stream: int, info: shm.SlotInfo, now_ns: int, **part: Any) -> Event:
        """Return an event with a request or response."""
        answers, time_ns = "response" in part, _time_of(info, now_ns)
        about = {
            # REQUEST_SENT, REQUEST_RECEIVED, RESPONSE_SENT, RESPONSE_RECEIVED: as the PLC sees it.
            "event_type": (2 if self._served else 3) if answers else int(self._served),
            "stamp": _stamp(time_ns),
            "client_gid": info.client if any(info.client) else self._client,
            "sequence_number": int.from_bytes(info.correlation.to_bytes(8, "little"), "little", signed=True),
        }
        content = {name: [value] for name, value in part.items()}
        return self._message(stream, info, now_ns, {"info": about, **content})

    def _message(self, stream: int, info: shm.SlotInfo, now_ns: int, content: Mapping[str, Any]) -> Event:
        codec = self.streams[stream].codec
        data = codec.encode(codec.layout.pack(content))
        return Event(stream, info.correlation & 0xFFFFFFFF, _time_of(info, now_ns), data)


@dataclass
class _Goal:
    id: dict[str, Any]
    accepted_ns: int = 0
    asks: bool = False  # its caller asks for it to be canceled
    agreed: bool = False
    status: GoalStatus = GoalStatus.UNKNOWN


class CarriedAction(CarriedService):
    """The objects of one use of an action; ``path`` is the file of its goals.

    Events are recorded as if exchanged by a ROS client and server: the result of an accepted goal is
    requested, and the events that led to a newer state are included.
    """

    parts = shm.ACTION

    def __init__(self, namespace: shm.Namespace, path: Path, *, since_ns: int | None) -> None:
        super().__init__(namespace, path, since_ns=since_ns)
        self._goals: dict[int, _Goal] = {}  # the newest, by their calls
        self._early: list[Event] = []  # feedback taken before the answers

    def _streams(self, both: Mapping[shm.Part, _Object]) -> tuple[Stream, ...]:
        goal, result, feedback = (one.codec.layout for one in both.values())
        action = goal.type_name.removesuffix("_Goal")
        store = with_interface(_merged(goal, result, feedback), action)
        name, own = self.description.topic, self._objects
        inner = [{"request[].goal.": goal}, {}, {"response[].result.": result}, {"feedback.": feedback}, {}]
        limits = {part.word: one.limits for part, one in both.items()}
        objects: list[tuple[_Object, ...]] = [(own[0],), (), (own[1],), (own[2],), ()]
        return tuple(
            Stream(
                name + ending,
                _codec(store, kind.format(action), parts, sequence=1),
                limits,
                of,
                STATUS_QOS if ending.endswith("status") else DEFAULT,
            )
            for (ending, kind), parts, of in zip(_TOPICS.items(), inner, objects, strict=True)
        )

    def events(self, now_ns: int) -> Iterator[Event]:
        """Yield the events, in the order of a goal's life cycle."""
        # Feedback is taken first: that its goal was accepted is then among the answers.
        self._early = [*self._fed(now_ns)]
        yield from super().events(now_ns)
        yield from self._early
        self._early = []

    def _asked(self, now_ns: int) -> Iterator[Event]:
        while (info := self._objects[0].next()) is not None:
            goal, withdrawn = self._goals.get(info.correlation), info.status & spec.ASK_WITHDRAWN
            if goal is None:
                goal = self._add(info)
                if info.status != spec.ASK_CALL:  # its first message came before the recording
                    goal.accepted_ns = _time_of(info, now_ns)
                else:
                    request = {**goal.id, "goal": self._objects[0].view}
                    yield self._event(_SEND, info, now_ns, request=request)
            asks = bool(info.status & spec.ASK_CANCEL) and not withdrawn
            if asks and not goal.asks:
                yield self._event(_CANCEL, info, now_ns, request={"goal_info": goal.id})
            goal.asks = asks

    def _add(self, info: shm.SlotInfo) -> _Goal:
        if len(self._goals) >= _MOST_GOALS:
            del self._goals[next(iter(self._goals))]
        goal = self._goals[info.correlation] = _Goal({"goal_id": {"uuid": bytes(info.client)}})
        return goal

    def _answered(self, info: shm.SlotInfo, now_ns: int) -> Iterator[Event]:
        status, goal = info.status & spec.ANSWER_MASK, self._goals.get(info.correlation)
        if goal is None:  # it was accepted before the recording began, for all that is known
            goal = self._add(info)
            goal.accepted_ns = _time_of(info, now_ns)
        end = _ENDS.get(status)
        if status == spec.ANSWER_NOT_EXECUTED and (self._served or info.reason == Reason.REJECTED):
            yield self._event(_SEND, info, now_ns, response={"accepted": False})
        if end is None and status != spec.ANSWER_ACCEPTED:
            return
        if not goal.accepted_ns:
            goal.accepted_ns = _time_of(info, now_ns)
            accepted = {"accepted": True, "stamp": _stamp(goal.accepted_ns)}
            yield self._event(_SEND, info, now_ns, response=accepted)
            yield self._event(_GET, info, now_ns, request=goal.id)
        known = {**goal.id, "stamp": _stamp(goal.accepted_ns)}
        agreed = bool(info.status & spec.ANSWER_CANCEL_ACCEPTED) or end is GoalStatus.CANCELED
        if agreed and not goal.agreed:
            goal.agreed = True
            yield self._event(_CANCEL, info, now_ns, response={"goals_canceling": [known]})
        elif info.status & spec.ANSWER_CANCEL_REJECTED and goal.asks:
            goal.asks = False  # the caller may ask again
            yield self._event(_CANCEL, info, now_ns, response={"return_code": CancelCode.REJECTED})
        if end is not None:
            yield from self._early
            self._early = []
            yield from self._fed(now_ns)
        going = GoalStatus.CANCELING if goal.agreed else GoalStatus.EXECUTING
        before, goal.status = goal.status, end or going
        if goal.status is not before:
            content = {"status_list": [{"goal_info": known, "status": goal.status}]}
            yield self._message(_STATUS, info, now_ns, content)
        if end is not None and not info.status & spec.ANSWER_NO_RESULT:
            response = {"status": end, "result": self._objects[1].view}
            yield self._event(_GET, info, now_ns, response=response)

    def _fed(self, now_ns: int) -> Iterator[Event]:
        while (info := self._objects[2].next()) is not None:
            message = {"goal_id": {"uuid": bytes(info.client)}, "feedback": self._objects[2].view}
            yield self._message(_FEEDBACK, info, now_ns, message)


_SEND, _CANCEL, _GET, _FEEDBACK, _STATUS = range(len(_TOPICS))


def _check_types(both: Mapping[shm.Part, _Object]) -> None:
    types = {part: one.attached.description.type for part, one in both.items()}
    name = next(iter(types.values())).rpartition("_")[0]
    for part, own in types.items():
        if own != f"{name}_{part.word.capitalize()}":
            raise ChannelError(
                "SHM113", f"{own} is not the {part.word} type of {name}", where=str(both[part].attached.path)
            )


def _time_of(info: shm.SlotInfo, now_ns: int) -> int:
    usable = info.stamp_clock == spec.STAMP_SYSTEM and 0 < info.stamp_ns < _NO_STAMP
    return info.stamp_ns if usable else now_ns


def _stamp(time_ns: int) -> dict[str, int]:
    return {"sec": time_ns // 10**9 & 0x7FFFFFFF, "nanosec": time_ns % 10**9}


def with_interface(store: TypeStore, name: str) -> TypeStore:
    """Return a store that also has a service or action whose parts it has as messages."""
    if "/action/" in name:
        store = store.with_types_of(TypeStore.bundled("jazzy"), *_COMMON)
    return store.with_events(name)


def _merged(*layouts: Layout) -> TypeStore:
    types: dict[str, MessageType] = {}
    for one in layouts:
        types |= {each: one.store[each] for each in one.store.dependencies(one.type_name)}
    return TypeStore("", types)


def _codec(store: TypeStore, type_name: str, parts: Mapping[str, Layout], **limits: int) -> Codec:
    """Return the codec of a message that contains others, each with the capacities of its own layout."""
    capacities: dict[str, int] = {}
    for name, part in parts.items():
        for path, _, node in part.fields():
            if isinstance(node, StringNode | SequenceNode):
                capacities[name + path] = node.capacity
    return Codec(compute_layout(store, type_name, Limits(fields=capacities, **limits)), Wire.CDR)


def channel_info(carried: Carried, stream: Stream, number: int, prefix: str, qos: Qos | None) -> ChannelInfo:
    """Return the channel of a stream in a file; ``qos`` None if it is not configured."""
    description, layout = carried.description, stream.codec.layout
    definition = layout.store.definition_text(layout.type_name)
    metadata = {
        "offered_qos_profiles": qos_text(qos or stream.qos),
        "topic_type_hash": layout.store.type_hash(layout.type_name),
        # What a replay needs to make the same channel again.
        "rosplc.direction": description.direction.word,
        "rosplc.limits": json.dumps(stream.limits),
        "rosplc.layout_id": layout.layout_id,
        "rosplc.slots": str(carried.slots),
        "rosplc.distro": description.distro,
        "rosplc.bridge": description.bridge,
        "rosplc.prefix": prefix,
    }
    schema = definition.encode(), "ros2msg"
    if description.part is not shm.Part.TOPIC:
        # In .msg text, readers do not find the parts of services by their names.
        action = action_of(stream.topic, layout.type_name) and layout.type_name.removesuffix(
            "_SendGoal_Event"
        )
        metadata["rosplc.definition"] = _action_text(layout.store, action) if action else definition
        needed = layout.store.dependencies(layout.type_name)[::-1]
        texts = (f"{'=' * 80}\nIDL: {each}\n{_module(layout.store[each])}" for each in needed)
        schema = "".join(texts).encode(), "ros2idl"
    return ChannelInfo(number, stream.topic, layout.type_name, schema[1], schema[0], "cdr", metadata)


def _action_text(store: TypeStore, action: str) -> str:
    """Return the definition of a message that contains an action's parts, so that a replay has them all."""
    parts = store.action(action)
    fields = {"goal": parts.goal, "result": parts.result, "feedback": parts.feedback}
    own = MessageType(action, tuple(Field(name, NamedType(part.name)) for name, part in fields.items()))
    needed = (each for part in fields.values() for each in store.dependencies(part.name))
    return TypeStore("", {action: own, **{each: store[each] for each in needed}}).definition_text(action)


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
