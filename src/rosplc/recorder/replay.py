"""Replays a recording in order and at its pace, into channels, topics, services or actions.

Answers, feedback and results are not compared.
"""

from __future__ import annotations

import secrets
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, cast

from rosplc.bridge.bind import Binding
from rosplc.bridge.carrier import CallPorts, Carrier, Duty, Rounds
from rosplc.bridge.port import Context
from rosplc.clock import SYSTEM, Clock
from rosplc.codec import Codec, Wire
from rosplc.config.plans import ServicePlan
from rosplc.config.resolve import Project, describe, rights
from rosplc.described import description_of, layout_of
from rosplc.errors import ChannelError, RecordingError, RosplcError
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.model.interfaces import PARTS
from rosplc.recorder.carried import recorded_name
from rosplc.recorder.convert import Conversion, Requests, renamed
from rosplc.recorder.inlet import Selection
from rosplc.recorder.source import Source, SourceTopic
from rosplc.ros import (
    ROS1,
    SERVICES,
    Backend,
    EndpointStatus,
    GoalEvent,
    Publisher,
    Qos,
    Reply,
    ServiceClient,
    action_classes,
    memory,
    open_backend,
)
from rosplc.ros.backend import OnReply, OnRequest
from rosplc.shm import Description, Direction, Namespace, OwnedChannel, attach
from rosplc.shm.calls import WORDS
from rosplc.shm.files import USUAL, Rights

_LOOK_S = 0.05
_ANSWER_NS = 10_000_000_000
_ASKED = {"service": "requests", "action": "goals"}
_TICK_NS = 1_000_000


@dataclass
class SentCount:
    """The counts of one topic's messages; answered requests and ended goals count as sent, others as lost."""

    sent: int = 0
    refused: int = 0
    lost: int = 0
    reason: str = ""
    asked: int = 0  # requests of a service or goals, answered or not

    @property
    def open(self) -> int:
        """Number of requests without an answer so far."""
        return max(0, self.asked - self.sent - self.lost)

    def answered(self, reply: Reply) -> None:
        """Count the end of a call."""
        if reply.payload is not None:
            self.sent += 1
        else:
            self.lost += 1
            self.reason = reply.text or f"{reply.outcome}: {WORDS[reply.reason]}"


class Target(ABC):
    """The destination of messages, which are converted on the way."""

    linger_s = 0.0  # how long to stay after the last message, in seconds

    def __init__(self, topics: Collection[str]) -> None:
        self.counts = {name: SentCount() for name in topics}  # topic → what became of its messages
        self.notes: list[str] = []  # what is converted, dropped or left zero on the way
        self._conversions: dict[str, Conversion] = {}
        self._clients: dict[str, ServiceClient | PlcService | Goals] = {}

    @abstractmethod
    def write(self, topic: str, data: bytes, stamp_ns: int) -> str:
        """Forward a converted message; return why it is lost, or empty. What does not fit is refused."""

    @abstractmethod
    def missing(self) -> list[str]:
        """Return the topics without a reader or subscriber, and the services without a server."""

    @abstractmethod
    def close(self) -> None:
        """Close everything; channels keep their last message."""

    def _convert_by(self, name: str, conversion: Conversion) -> None:
        self._conversions[name] = conversion
        self.notes += [f"{name}: {note}" for note in conversion.notes]

    @property
    def executing(self) -> bool:
        """Whether a goal is being executed, which may take any time."""
        return any(isinstance(one, Goals) and one.accepted for one in self._clients.values())

    def send(self, topic: str, data: bytes, stamp_ns: int) -> None:
        """Convert a message and forward it; refusals and losses are counted and never raised."""
        count = self.counts[topic]
        try:
            converted = self._conversions[topic](data)
            if converted is None:
                return
            if topic in self._clients:
                self._clients[topic].call(converted, count.answered)
                count.asked += 1
                return
            lost = self.write(topic, converted, stamp_ns)
        except RosplcError as error:
            count.refused += 1
            where = f"{error.where}: " if error.where else ""
            count.reason = count.reason or f"{where}{error.what} [{error.code}]"
            return
        if lost:
            count.lost += 1
            count.reason = lost
        else:
            count.sent += 1


def wait_for_answers(target: Target, stopped: Callable[[float], bool], clock: Clock = SYSTEM) -> None:
    """Wait until every request has an answer; the rest count as lost. ``stopped`` is as below."""
    end = clock.monotonic_ns() + _ANSWER_NS
    while any(one.open for one in target.counts.values()) and clock.monotonic_ns() < end:
        if stopped(_LOOK_S):
            break
        if target.executing:
            end = clock.monotonic_ns() + _ANSWER_NS
    for one in target.counts.values():
        if one.open:
            one.lost, one.reason = one.lost + one.open, "no response arrived"


def wait_for_readers(
    target: Target, seconds: float, stopped: Callable[[float], bool], clock: Clock = SYSTEM
) -> list[str]:
    """Wait until every topic has a reader or subscriber, and return the topics that have none.

    ``stopped`` waits for the given seconds; it returns True to end the wait.
    """
    end = clock.monotonic_ns() + seconds * 1e9
    while (missing := target.missing()) and clock.monotonic_ns() < end:
        if stopped(_LOOK_S):
            break
    return missing


_NO_TIME = 2**63 - 1  # DDS and ROS count ns since 1970 in signed 64 bits; the largest number means none
_NAP_S = 0.2  # the longest wait before checking whether to stop


@dataclass(frozen=True)
class ReplayOptions:
    """The options of a replay."""

    speed: float = 1.0  # 1 as recorded, 2 twice as fast; 0 as fast as possible
    loop: bool = False
    start_ns: int = 0  # leave out so much at the beginning
    end_ns: int = 0  # end so long after the recording's beginning; 0 for its end
    # ``now``: a message is stamped when it is sent; ``original``: as it was recorded
    stamps: Literal["now", "original"] = "now"


def chosen_topics(
    source: Source,
    selection: Selection,
    rename: Mapping[str, str],
    *,
    to_plc: bool,
    services: Collection[str] = (),
    actions: Collection[str] = (),
) -> tuple[dict[str, SourceTopic], list[str]]:
    """Return new name → topic for the topics to replay, and remarks on topics that are left out.

    If no names are given, a replay to the PLC leaves out topics that the PLC wrote; ``rename`` is topic → new
    name. Requests are sent only to ``services`` and goals only to ``actions``; their events are selected.
    Other topics of actions are left out unless named. Raises RecordingError REC006 if nothing is left, REC007
    if two topics would have the same name.
    """
    remarks = [f"{name} is left out: {why}" for name, why in source.unusable.items() if name in selection]
    chosen: dict[str, SourceTopic] = {}
    unknown = {*services, *actions}
    for name, topic in sorted(source.topics.items()):
        call, named = topic.service or topic.action, actions if topic.action else services
        if call in named:
            unknown.discard(call)
        if name in source.unusable or (name not in selection and call not in named):
            continue
        if call and call not in named:
            what = "goals are" if topic.action else "requests are"
            flag = "--action" if topic.action else "--service"
            remarks.append(f"{call} is left out: {what} sent only with {flag} {call}")
            continue
        if not call and recorded_name(name) != name and name not in selection.topics:
            continue
        if not call and to_plc and topic.direction == "to_ros" and not selection.topics:
            remarks.append(f"{name} is left out: the PLC wrote it; specify it explicitly to replay it")
            continue
        new = name.replace(call, rename.get(call, call), 1) if call else rename.get(name, name)
        if new in chosen:
            raise RecordingError("REC007", f"{new} would receive the messages of two topics", where=name)
        chosen[new] = topic
    if unknown:
        raise RecordingError("REC006", "no calls or goals with this name were recorded", where=min(unknown))
    names = {one.service or one.action or one.name for one in source.topics.values()}
    remarks += (f"{wrong} is not renamed: it was not recorded" for wrong in rename if wrong not in names)
    if not chosen:
        known = ", ".join(sorted(source.topics)) or "none"
        calls = any(one.service or one.action for one in source.topics.values())
        remedy = "To send recorded requests or goals, add --service or --action." if calls else ""
        what = f"no topic is left to replay; the recording contains: {known}"
        raise RecordingError("REC006", what, remedy=remedy)
    return chosen, remarks


@dataclass
class Player:
    """Replays a recording into a target."""

    source: Source
    target: Target
    topics: Mapping[str, SourceTopic]  # new name → topic
    options: ReplayOptions = field(default_factory=ReplayOptions)
    clock: Clock = SYSTEM  # what the pace is kept by, and messages are stamped with
    rounds: int = 0  # how many times it was begun
    position_ns: int = 0  # how far it is from the recording's beginning
    latest_ns: int = 0  # the most that a message was sent too late, at a speed other than the fastest
    disordered: int = 0  # messages whose time lies before that of the one sent before

    def play(self, stopped: Callable[[float], bool], look: Callable[[], None] = lambda: None) -> None:
        """Replay until the end, or until ``stopped``, which waits for the given seconds, returns True.

        ``look`` is called a few times per second, for progress. REC003: the file is damaged; all messages
        before the damage were sent.
        """
        while not stopped(0.0):
            self.rounds += 1
            if not self._once(stopped, look) or not self.options.loop:
                return

    def _once(self, stopped: Callable[[float], bool], look: Callable[[], None]) -> bool:
        """Replay once; return whether there was a message and the end was reached."""
        options, source = self.options, self.source
        names: dict[str, list[str]] = {}
        for new, topic in self.topics.items():
            names.setdefault(topic.name, []).append(new)
        first = source.start_ns + options.start_ns
        last = source.start_ns + options.end_ns if options.end_ns else source.end_ns
        began, base, before = 0, -1, 0
        looked = self.clock.monotonic_ns()
        for message in source.messages(names.keys(), first, last):
            if base < 0:
                # From its first message on: silence before it is nobody's test.
                began, base = self.clock.monotonic_ns(), message.log_ns
            if message.log_ns < before:
                self.disordered += 1
            before = message.log_ns
            self.position_ns = message.log_ns - source.start_ns
            if options.speed:
                due = began + int((message.log_ns - base) / options.speed)
                while (rest := due - self.clock.monotonic_ns()) > 0:
                    if stopped(min(_NAP_S, rest / 1e9)):
                        return False
                    look()
                self.latest_ns = max(self.latest_ns, -rest)
            if self.clock.monotonic_ns() - looked > _NAP_S * 1e9:
                looked = self.clock.monotonic_ns()
                look()
                if stopped(0.0):
                    return False
            original = options.stamps == "original" and 0 < message.publish_ns < _NO_TIME
            stamp = message.publish_ns if original else self.clock.time_ns()
            for new in names[message.topic]:
                self.target.send(new, message.data, stamp)
        return base >= 0


_SLOTS = 64  # of a channel that neither a configuration nor a recording nor an object describes


class PlcTarget(Target):
    """Channels to the PLC, each created or adopted as a bridge would.

    A channel's limits and depth are those of the configuration (``project``), otherwise of the existing
    object, otherwise of the recording, so that they match the code in the PLC. ``topics`` is name in shared
    memory → topic; ``distro`` is the source of definitions that are not in the recording. Raises ChannelError
    SHM116 if a bridge or another program writes the channel, SHM117 and others; REC007 if the PLC writes its
    topic, or its type differs.
    """

    def __init__(
        self,
        topics: Mapping[str, SourceTopic],
        namespace: Namespace,
        *,
        project: Project | None = None,
        distro: str = "jazzy",
    ) -> None:
        super().__init__(topics)
        self._namespace, self._project, self._distro = namespace, project, distro
        self._bindings: dict[str, Binding] = {}
        self._before: dict[str, tuple[tuple[int, int], ...]] = {}
        try:
            calls = {name for name, topic in topics.items() if topic.service or topic.action}
            for name in sorted(calls):
                self._clients[name] = self._call(name, topics[name])
            plans = {name: self._plan(name, topic) for name, topic in topics.items() if name not in calls}
            for name, plan in plans.items():
                try:
                    self._bindings[name] = plan.bind(namespace)
                except ValueError as error:  # limits that lead to an object of more than 2 GiB
                    raise RecordingError("REC007", str(error), where=name) from error
        except BaseException:
            self.close()
            raise

    def write(self, topic: str, data: bytes, stamp_ns: int) -> str:
        """Write a message into the channel; a message that exceeds its limits is refused."""
        try:
            self._bindings[topic].write(data, stamp_ns=stamp_ns)
        except ChannelError as error:
            return f"{error.what} [{error.code}]"
        return ""

    def missing(self) -> list[str]:
        """Return the topics that no PLC task reads: no heartbeat in a reader line between two calls."""
        quiet = [name for name, client in self._clients.items() if not client.ready]
        for name in self._bindings:
            now = self._lines(name)
            before = self._before.setdefault(name, now)
            if now == before or not any(now):
                quiet.append(name)
        return quiet

    def close(self) -> None:
        """Close the objects, which keep their last state."""
        for client in self._clients.values():
            client.close()
        for binding in self._bindings.values():
            binding.close()

    def _lines(self, name: str) -> tuple[tuple[int, int], ...]:
        try:
            with attach(self._namespace, name) as attached:
                lines = attached.snapshot().readers
        except ChannelError:
            return ()
        return tuple((line.beat, line.taken) if line.claim else (0, 0) for line in lines)

    def _plan(self, name: str, topic: SourceTopic) -> _Plan:
        own, project = topic.types(self._distro), self._project
        for plan in () if project is None else project.topics:
            if plan.topic == name and plan.port == "channel":
                assert project is not None
                self._convert(name, topic, own, plan.layout, plan.direction, "the configuration")
                settings = project.config.settings
                description = describe(plan, distro=settings.ros.distro, bridge=settings.bridge)
                owner = rights(project.config)
                return _Plan(description, plan.layout, plan.slots, plan.truncate, owner)
        there = self._there(name)
        if there is not None:
            self._convert(name, topic, own, there.layout, there.description.direction, "the existing channel")
            return there
        # A ROS 1 bag becomes a channel of the distribution's types, all else one of its own.
        store = _with(TypeStore.bundled(self._distro), own, topic.type_name) if topic.ros1 else own
        layout = _layout(store, renamed(topic.type_name, store), topic.limits)
        self._convert(name, topic, own, layout, Direction.TO_PLC, "")
        description = description_of(layout, name, Direction.TO_PLC, bridge="replay")
        return _Plan(description, layout, topic.slots or _SLOTS)

    def _convert(
        self, name: str, topic: SourceTopic, own: TypeStore, layout: Layout, direction: Direction, who: str
    ) -> None:
        """Prepare the conversion for a channel; REC007 if the PLC writes it, or its type differs."""
        if direction is not Direction.TO_PLC:
            raise RecordingError(
                "REC007",
                f"according to {who}, the PLC writes this topic",
                where=name,
                remedy=f"Exclude it with --exclude {name}, or rename it with --rename {name}:=/other.",
            )
        if layout.type_name != renamed(topic.type_name, layout.store):
            what = f"the type in {who} is {layout.type_name}, but {topic.type_name} was recorded"
            raise RecordingError("REC007", what, where=name)
        wanted = layout.type_name
        conversion = Conversion(own, topic.type_name, layout.store, wanted, from_ros1=topic.ros1, where=name)
        self._convert_by(name, conversion)

    def _call(self, name: str, topic: SourceTopic) -> PlcService | Goals:
        """Return a service or action of the PLC from the configuration; REC007 as :meth:`_convert`."""
        called, own, project = recorded_name(name), topic.types(self._distro), self._project
        plans = () if project is None else project.calls
        kind = "action" if topic.action else "service"
        found = (one for one in plans if (one.kind, one.called, one.server) == (kind, called, "plc"))
        plan = next(found, None)
        if plan is None or project is None:
            what = f"the configuration has no {kind} with this name and server: plc"
            remedy = f"Set --config to the bridge's file, or use --to ros to send the {_ASKED[kind]} to ROS."
            raise RecordingError("REC007", what, where=called, remedy=remedy)
        if plan.type_name != topic.call_type:
            what = f"the type in the configuration is {plan.type_name}, but {topic.call_type} was recorded"
            raise RecordingError("REC007", what, where=called)
        to_ros1 = project.store.ros_version == 1
        self._convert_by(name, Requests(own, plan.type_name, project.store, to_ros1=to_ros1, where=called))
        settings = project.config.settings
        names = settings.bridge, secrets.token_bytes(16), settings.ros.distro
        context = Context(self._namespace, *names, rights(project.config))
        if isinstance(plan, ServicePlan):
            return PlcService(plan, context)
        return Goals(project.store, called, plan.type_name, plan=plan, context=context)

    def _there(self, name: str) -> _Plan | None:
        """Return a channel that a bridge left; None if there is none, or if it must be replaced."""
        try:
            with attach(self._namespace, name) as attached:
                status = attached.path.stat()
                owner = Rights.of(status)
                slots = attached.identity.slot_count
                return _Plan(attached.description, layout_of(attached), slots, owner=owner)
        except (ChannelError, OSError):
            return None


class PlcPart:
    """A service or action of the PLC, maintained as in a bridge; ``backend`` takes the place of ROS."""

    def __init__(self, plan: Any, context: Context, backend: Backend) -> None:
        self._clock = context.clock
        ports = CallPorts(context, _TICK_NS)
        self._use = use = ports.make(plan)
        use.open()
        use.connect(backend)
        use.begin(self._clock.monotonic_ns())
        self._carrier = Carrier("rosplc-calls", ports, self._clock)
        self._carrier.replace((), (use,))
        beating = Duty("sending heartbeats", context.beat_ns, context.beat)
        self._beats = Rounds("rosplc-beats", self._clock, beating)
        self._beats.start()

    @property
    def ready(self) -> bool:
        """Whether the PLC's block is alive."""
        return self._use.status(self._clock.monotonic_ns()).peer_alive

    def close(self) -> None:
        """Withdraw calls that have not begun, and close the objects."""
        self._carrier.stop()
        self._beats.stop()
        self._use.close()


class Goals:
    """Sends goals to an action; the reply to a goal shows how it ended.

    With ``plan`` and ``context``, the action is the PLC's, otherwise that of ``backend``.
    """

    def __init__(
        self, store: TypeStore, action: str, type_name: str, backend: Backend | None = None, **plc: Any
    ) -> None:
        self.accepted: set[bytes] = set()
        self._waiting: dict[bytes, OnReply] = {}
        self._part: PlcPart | None = None
        self._nodes = memory.open_apart(store, "bridge", "replay") if backend is None else []
        try:
            if backend is None:
                backend = self._nodes[1]
                self._part = PlcPart(backend=self._nodes[0], **plc)
            self._client = action_classes(store)[1](backend, store, action, type_name, self._hear)
        except BaseException:
            self.close()
            raise

    @property
    def ready(self) -> bool:
        """Whether the action's server is available."""
        return self._client.ready and (self._part is None or self._part.ready)

    def call(self, goal: bytes, on_reply: OnReply) -> None:
        """Send a goal with a new UUID; ``on_reply`` is called once, by another thread."""
        uuid = secrets.token_bytes(16)
        self._waiting[uuid] = on_reply
        self._client.send(uuid, goal)

    def _hear(self, event: GoalEvent) -> None:
        if event.kind == "accepted":
            self.accepted.add(event.uuid)
        if event.kind not in ("rejected", "failed", "result", "lost"):
            return
        reply = event.reply or Reply(event.payload)
        if event.kind == "rejected":
            reply = Reply(text="the goal was rejected")
        elif reply.payload is None and not reply.text:
            reply = Reply(text="the outcome of the goal is unknown")
        self.accepted.discard(event.uuid)
        if (on_reply := self._waiting.pop(event.uuid, None)) is not None:
            on_reply(reply)

    def close(self) -> None:
        """Close the PLC's objects."""
        if self._part is not None:
            self._part.close()
        for node in self._nodes:
            node.close()


class PlcService(PlcPart):
    """A service of the PLC: the ROS side of its use, and the client that calls it."""

    capabilities = frozenset({"services"})
    remembers = False

    def __init__(self, plan: ServicePlan, context: Context) -> None:
        self._waiting: dict[bytes, OnReply] = {}
        self._status = EndpointStatus(plan.service, plan.type_name, "in", matched=1)
        # A fallback response tells nothing of the PLC.
        super().__init__(replace(plan, fallback=None), context, cast("Backend", self))

    def call(self, payload: bytes, on_reply: OnReply) -> None:
        """Send a request; ``on_reply`` is called once, by another thread."""
        caller = secrets.token_bytes(16)
        self._waiting[caller] = on_reply
        self._on_request(payload, caller, 0)

    def serve(self, _service: str, _type_name: str, _qos: Qos, on_request: OnRequest) -> PlcService:
        """As :meth:`rosplc.ros.Backend.serve`, like the other methods."""
        self._on_request = on_request
        return self

    def reply(self, caller: bytes, payload: bytes) -> bool:
        """Note the PLC's answer."""
        return self._end(caller, Reply(payload))

    def refuse(self, caller: bytes, text: str) -> bool:
        """Note that there will be no answer."""
        return self._end(caller, Reply(text=text))

    def present(self, caller: bytes) -> bool:
        """Return whether the call belongs to this replay, and not to an earlier bridge."""
        return caller in self._waiting

    def _end(self, caller: bytes, reply: Reply) -> bool:
        on_reply = self._waiting.pop(caller, None)
        if on_reply is not None:
            on_reply(reply)
        return on_reply is not None

    def status(self) -> EndpointStatus:
        """Return a status with one client."""
        return self._status


@dataclass(frozen=True)
class _Plan:
    description: Description
    layout: Layout
    slots: int
    truncate: bool = False
    owner: Rights = USUAL

    def bind(self, namespace: Namespace) -> Binding:
        about, size, slots, own = self.description, self.layout.size, self.slots, self.owner
        made = partial(OwnedChannel.open, namespace, about, record_size=size, slots=slots, rights=own)
        codec, cut = Codec(self.layout, Wire.CDR), self.truncate
        return Binding(about, codec, made, None, print=False, truncate=cut, every=False)


def _with(store: TypeStore, own: TypeStore, type_name: str) -> TypeStore:
    return store if renamed(type_name, store) in store else store.with_types_of(own, type_name)


def _layout(store: TypeStore, type_name: str, limits: Mapping[str, Any] | None) -> Layout:
    if limits is not None:
        with suppress(RosplcError):  # limits of another definition of the type, or made up
            return compute_layout(store, type_name, Limits.from_dict(dict(limits)))
    return compute_layout(store, type_name)


class RosTarget(Target):
    """Publishers on ROS topics, and clients of services, over any backend.

    ``topics`` is name in ROS → topic; ``distro`` is the source of the definitions on the wire; ``join`` opens
    the backend. Raises RecordingError REC007 if the recording's definition of a type does not match the
    distribution's; BackendError ROS001, ROS002 …
    """

    linger_s = 1.0  # a middleware may still be sending, or repeating what got lost

    def __init__(
        self,
        topics: Mapping[str, SourceTopic],
        *,
        backend: str = "auto",
        distro: str = "jazzy",
        domain: int | None = None,
        join: Callable[..., Backend] = open_backend,
    ) -> None:
        super().__init__(topics)
        store = TypeStore.bundled(distro)
        for name, topic in topics.items():
            own = topic.types(distro)
            if call := topic.service or topic.action:
                kind, words = topic.call_type, PARTS["action" if topic.action else "srv"]
                store = store.with_types_of(own, *(f"{kind}_{part}" for part in words))
                requests = Requests(own, kind, store, to_ros1=distro == ROS1, where=call)
                self._convert_by(name, requests)
                continue
            store = _with(store, own, topic.type_name)
            conversion = Conversion(
                own, topic.type_name, store, renamed(topic.type_name, store),
                from_ros1=topic.ros1, to_ros1=distro == ROS1, where=name,
            )  # fmt: skip
            self._convert_by(name, conversion)
        self.backend = join(backend, store, "rosplc_replay", domain=domain)
        self._publishers: dict[str, Publisher] = {}
        try:
            for name, topic in topics.items():
                called, kind = recorded_name(name), topic.call_type
                if topic.service:
                    self._clients[name] = self.backend.client(called, kind, SERVICES)
                elif topic.action:
                    self._clients[name] = Goals(store, called, kind, self.backend)
                else:
                    new = renamed(topic.type_name, store)
                    self._publishers[name] = self.backend.advertise(name, new, topic.qos)
        except BaseException:
            self.backend.close()
            raise

    def write(self, topic: str, data: bytes, stamp_ns: int) -> str:
        """Publish a message; it is lost if a subscriber has no room for it."""
        return "" if self._publishers[topic].write(data, stamp_ns) else "a subscriber cannot keep up"

    def missing(self) -> list[str]:
        """Return the topics without a subscriber."""
        lonely = [name for name, publisher in self._publishers.items() if not publisher.matched]
        return lonely + [name for name, client in self._clients.items() if not client.ready]

    def close(self) -> None:
        """Leave the graph."""
        self.backend.close()
