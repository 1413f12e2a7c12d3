"""What a bridge reports about itself: plain data, judged in one place for all who show it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar, Literal

from rosplc.levels import Level, format_age
from rosplc.shm import Direction

__all__ = [
    "ActionStatus",
    "BridgeStatus",
    "CallStatus",
    "ClassicStatus",
    "Level",
    "PortStatus",
    "ServiceStatus",
    "TopicStatus",
    "format_age",
]


@dataclass(frozen=True, slots=True)
class ClassicStatus:
    """What can be known of a classic topic's memory and lock: there is no beat in them.

    Attributes:
        memory: The memory's name.
        semaphore: The semaphore's name; empty if nothing guards the memory.
        bytes: The memory's size; 0 while there is none that can be used.
        attached: Whether memory and lock are in use.
        held_ns: How long the lock has been taken at every look, without a sign of life; 0 if it was free.
        timeouts: How often the lock was not free within ``wait``.
        recovered: How often it was freed for a holder that counted as dead.
        mended: How often it would have let in more than one.
    """

    memory: str
    semaphore: str
    bytes: int
    attached: bool
    held_ns: int = 0
    timeouts: int = 0
    recovered: int = 0
    mended: int = 0

    @property
    def lock(self) -> str:
        """The lock in a few words."""
        if not self.semaphore:
            return "none"
        state = f"held for {format_age(self.held_ns)}" if self.held_ns > 1_000_000_000 else "in order"
        return f"{state}, {self.timeouts} timeouts, {self.recovered} freed, {self.mended} corrected"


@dataclass(frozen=True, kw_only=True)
class PortStatus:
    """What a port knows of the PLC and its memory.

    Attributes:
        skipped: Messages held back on purpose: rate limit, unchanged, replaced by a newer one.
        lost: Messages that came too fast, or while there was no object or no room.
        peer_alive: Whether the PLC's side beats: a reader for ``to: plc``, the writer for ``to: ros``.
            None where that cannot be known: classic memory has no beat.
        peer_gone_ns: Time since the PLC's side, having been there, was missed; None if it is there, or
            never was.
        tasks: Names of the PLC's reading tasks (``to: plc``).
        classic: Memory and lock of a classic topic; None for a channel.
    """

    skipped: int = 0
    lost: int = 0
    peer_alive: bool | None = False
    peer_gone_ns: int | None = None
    tasks: tuple[str, ...] = ()
    classic: ClassicStatus | None = None


@dataclass(frozen=True)
class TopicStatus(PortStatus):
    """The state of one topic, with that of its port.

    Attributes:
        topic: As ROS writes it.
        type_name: ``package/msg/Name``.
        direction: Where its messages go.
        matched: ROS publishers or subscribers on the other side; 0 also before start.
        received: Messages that came in, from ROS or from the PLC.
        published: Messages passed on.
        refused: Messages that could not be converted or that the other side refused.
        truncated: Messages passed on with something cut off.
        deadlines_missed: Times that the QoS' deadline passed without a message; 0 where there is none.
        rate_hz: Messages that came in per second, over the last seconds.
        age_ns: Time since the last message came in; None before the first.
        stale: Whether that is longer than the topic allows.
        silent: The same as it is reported: not yet while it lasts for less than ``diagnostics.debounce``, and
            still until messages have come again for so long.
        substituting: Whether substitutes are published now in a silent PLC's place.
        substituted: Substitutes published in a silent PLC's place; they are in no other number.
        recovered: How often messages came again after the source was stale.
        problem: Why the topic cannot be carried at present; empty if it is.
        reason: In words, what is wrong or was wrong last; empty if all is well.
        code: The error code that goes with ``reason``; empty if there is none.
        recent: Whether ``reason`` is from the last ten seconds, or still holds.
    """

    topic: str
    type_name: str
    direction: Direction
    matched: int = 0
    received: int = 0
    published: int = 0
    refused: int = 0
    truncated: int = 0
    deadlines_missed: int = 0
    rate_hz: float = 0.0
    age_ns: int | None = None
    stale: bool = False
    substituting: bool = False
    silent: bool = False
    substituted: int = 0
    recovered: int = 0
    problem: str = ""
    reason: str = ""
    code: str = ""
    recent: bool = False

    def _staleness(self, to_plc: bool) -> str:
        source = "ROS publisher" if to_plc else "the PLC"
        if self.age_ns is not None and not self.stale:
            return f"messages come again from {source}, after silence"
        if self.age_ns is not None:
            words = f"last message {format_age(self.age_ns)} ago from {source}"
            if to_plc and not self.matched:
                words += "; nobody publishes any more"
            return words + "; substitutes are published" if self.substituting else words
        if not to_plc:
            return f"no message yet from {source}"
        if not self.matched:
            return f"no message yet from {source}: nobody publishes"
        # Not every middleware tells this side that a peer refuses it for its definition of the type.
        return (
            f"no message yet from {source}, though one is there: it is silent, or it has another "
            "definition of the type and the middleware keeps the two apart (ROS003)"
        )

    @property
    def judgement(self) -> tuple[Level, str]:
        """The level and a sentence for it; the worst counts."""
        to_plc = self.direction is Direction.TO_PLC
        if self.problem:
            return Level.ERROR, self.problem
        if self.recent and self.code in ("ROS003", "ROS004") and not self.matched:
            return Level.ERROR, self.reason
        if self.recent and self.reason:
            return Level.WARN, self.reason
        if self.peer_gone_ns is not None:
            who = "the PLC task that reads it" if to_plc else "the PLC task that writes it"
            also = "; substitutes are published" if self.substituting else ""
            return Level.ERROR, f"{who} stopped {format_age(self.peer_gone_ns)} ago{also}"
        if self.silent:
            return Level.STALE, self._staleness(to_plc)
        if self.peer_alive is False:
            return Level.WARN, "no PLC task reads it" if to_plc else "no PLC task writes it"
        if not self.matched:
            return Level.OK, "nobody publishes" if to_plc else "nobody subscribes"
        return Level.OK, f"{self.rate_hz:.3g} Hz"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON; ``direction`` as ``to_plc`` or ``to_ros``."""
        level, message = self.judgement
        return {**asdict(self), "direction": self.direction.word, "level": level.name, "message": message}


@dataclass(frozen=True, kw_only=True)
class CallStatus:
    """The state of one use of a service or action; each call is in exactly one of its numbers.

    Attributes:
        type_name: ``package/srv/Name`` or ``package/action/Name``.
        server: Who carries the calls out.
        client: The use's name in the PLC's program; empty if it has none.
        matched: ROS clients of what the PLC carries out; else 1 if a server is ready.
        peer_alive: Whether the PLC's block beats.
        received: Calls that came in, from ROS or from the PLC; the sum of the numbers but ``strays``.
        not_executed: Calls that never began, by reason.
        fate_unknown: Calls that may have been executed, by reason.
        unreadable: Calls that were executed, with an answer that does not fit the PLC's record.
        late: Calls whose answer came when the caller had gone.
        outstanding: Calls that wait or are being carried out.
        strays: Answers that belong to no open call; they are in no other number.
        problem: Why it cannot be carried at present; empty if it is.
        reason: In words, what is wrong or was wrong last; empty if all is well.
        code: The error code that goes with ``reason``; empty if there is none.
        recent: Whether ``reason`` is from the last ten seconds, or still holds.
    """

    type_name: str
    server: Literal["plc", "ros"]
    client: str = ""
    matched: int = 0
    peer_alive: bool = False
    received: int = 0
    not_executed: Mapping[str, int] = field(default_factory=dict)
    fate_unknown: Mapping[str, int] = field(default_factory=dict)
    unreadable: int = 0
    late: int = 0
    outstanding: int = 0
    strays: int = 0
    problem: str = ""
    reason: str = ""
    code: str = ""
    recent: bool = False

    kind: ClassVar[Literal["service", "action"]]

    @property
    def called(self) -> str:
        """The service or action as ROS writes it."""
        return str(getattr(self, self.kind))

    @property
    def name(self) -> str:
        """What people call it: its kind, its name in ROS and its client."""
        return f"{self.kind} {self.called} {self.client}".rstrip()

    @property
    def _summary(self) -> str:
        """A sentence for the calls while all is well."""
        raise NotImplementedError

    @property
    def judgement(self) -> tuple[Level, str]:
        """The level and a sentence for it; the worst counts."""
        if self.problem:
            return Level.ERROR, self.problem
        if self.recent and self.reason:
            return Level.WARN, self.reason
        if not self.peer_alive:
            return Level.WARN, "no PLC task serves it" if self.server == "plc" else "no PLC task calls it"
        if not self.matched and self.server == "ros":
            return Level.WARN, "no server is ready"
        return Level.OK, self._summary

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        level, message = self.judgement
        return {self.kind: self.called, **asdict(self), "level": level.name, "message": message}


@dataclass(frozen=True, kw_only=True)
class ServiceStatus(CallStatus):
    """The state of one use of a service.

    Attributes:
        service: As ROS writes it.
        done: Calls whose answer was passed on.
    """

    service: str
    done: int = 0

    kind = "service"

    @property
    def _summary(self) -> str:
        return f"{self.done} of {self.received} calls answered, {self.outstanding} outstanding"


@dataclass(frozen=True, kw_only=True)
class ActionStatus(CallStatus):
    """The state of one use of an action.

    Attributes:
        action: As ROS writes it.
        succeeded: Goals that were reached.
        aborted: Goals that were begun and have failed.
        canceled: Goals that were canceled.
        feedback: Messages of feedback that were passed on.
        goal_status: What the open goal does: ``waiting``, ``accepted``, ``executing`` or ``canceling``;
            empty while there is none.
    """

    action: str
    succeeded: int = 0
    aborted: int = 0
    canceled: int = 0
    feedback: int = 0
    goal_status: str = ""

    kind = "action"

    @property
    def judgement(self) -> tuple[Level, str]:
        """The level and a sentence for it; an open goal stays as it is while the PLC is silent."""
        if self.server == "plc" and self.goal_status and not (self.problem or self.peer_alive):
            return Level.WARN, f"the PLC is silent; a goal is {self.goal_status} and stays so"
        return super().judgement

    @property
    def _summary(self) -> str:
        goal = f"; one is {self.goal_status}" if self.goal_status else ""
        return f"{self.succeeded} of {self.received} goals succeeded, {self.outstanding} outstanding{goal}"


def carried(topics: int, services: int, actions: int) -> str:
    """Return in words how much a bridge carries."""
    uses = ((services, "services"), (actions, "actions"))
    return " and ".join((f"{topics} topics", *(f"{count} uses of {what}" for count, what in uses if count)))


@dataclass(frozen=True)
class BridgeStatus:
    """A bridge, its topics, services and actions as they stand.

    Attributes:
        backend: The ROS backend in use; empty before start.
        backend_why: How it was chosen, in words, with what was passed over; empty before start.
        running: Whether it is started.
        uptime_ns: Time since the start; 0 before.
        topics: In the order of the configuration.
        services: In the order of the configuration; each use is one.
        actions: The same.
        config_changed: Whether the configuration's file differs from what was read.
        notes: What else a person should know.
    """

    bridge: str
    backend: str = ""
    running: bool = False
    uptime_ns: int = 0
    topics: tuple[TopicStatus, ...] = ()
    config_changed: bool = False
    notes: tuple[str, ...] = ()
    backend_why: str = ""
    services: tuple[ServiceStatus, ...] = ()
    actions: tuple[ActionStatus, ...] = ()

    @property
    def calls(self) -> tuple[CallStatus, ...]:
        """Services, then actions."""
        return (*self.services, *self.actions)

    @property
    def judgement(self) -> tuple[Level, str]:
        """The level of the bridge itself, its topics left out."""
        if not self.running:
            return Level.ERROR, "not running"
        if self.notes:
            return Level.WARN, "; ".join(self.notes)
        counts = carried(len(self.topics), len(self.services), len(self.actions))
        return Level.OK, f"{counts} over {self.backend}"

    def topic(self, name: str) -> TopicStatus:
        """Return one topic's status; KeyError if there is none."""
        for status in self.topics:
            if status.topic == name:
                return status
        raise KeyError(name)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        level, message = self.judgement
        return {
            **vars(self),
            "notes": list(self.notes),
            "level": level.name,
            "message": message,
            "topics": [status.to_dict() for status in self.topics],
            "services": [status.to_dict() for status in self.services],
            "actions": [status.to_dict() for status in self.actions],
        }
