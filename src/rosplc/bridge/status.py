"""What a bridge reports about itself: plain data, judged in one place for every display."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Literal

from rosplc.levels import Level as Level
from rosplc.levels import format_age as format_age
from rosplc.shm import Direction
from rosplc.shm.names import Call


@dataclass(frozen=True, slots=True)
class ClassicStatus:
    """The state of a classic topic's memory and lock, which have no heartbeat."""

    memory: str  # the memory's name
    semaphore: str  # the semaphore's name; empty if nothing guards the memory
    bytes: int  # the memory's size; 0 while there is none that can be used
    attached: bool  # whether memory and lock are in use
    # how long the lock has been taken at every look, without a sign of life; 0 if it was free
    held_ns: int = 0
    timeouts: int = 0  # how often the lock was not free within ``wait``
    recovered: int = 0  # how often it was freed for a holder that counted as dead
    mended: int = 0  # how often it would have let in more than one

    @property
    def lock(self) -> str:
        """The state of the lock as text."""
        if not self.semaphore:
            return "none"
        state = f"held for {format_age(self.held_ns)}" if self.held_ns > 1_000_000_000 else "OK"
        return f"{state}; timeouts: {self.timeouts}, freed: {self.recovered}, corrected: {self.mended}"


@dataclass(frozen=True, kw_only=True)
class PortStatus:
    """What a port knows about the PLC and its memory."""

    skipped: int = 0  # messages held back on purpose: rate limit, unchanged, replaced by a newer one
    lost: int = 0  # messages that came too fast, or while there was no object or no room
    # whether the PLC's side beats: a reader for ``to: plc``, the writer for ``to: ros``. None where
    # that cannot be known: classic memory has no beat.
    peer_alive: bool | None = False
    # time since the PLC's side, having been there, was missed; None if it is there, or never was
    peer_gone_ns: int | None = None
    tasks: tuple[str, ...] = ()  # names of the PLC's reading tasks (``to: plc``)
    classic: ClassicStatus | None = None  # memory and lock of a classic topic; None for a channel


@dataclass(frozen=True)
class TopicStatus(PortStatus):
    """The state of one topic, including that of its port."""

    topic: str  # as ROS writes it
    type_name: str  # ``package/msg/Name``
    direction: Direction  # where its messages go
    matched: int = 0  # ROS publishers or subscribers on the other side; 0 also before start
    received: int = 0  # messages that came in, from ROS or from the PLC
    published: int = 0  # messages passed on
    refused: int = 0  # messages that could not be converted or that the other side refused
    truncated: int = 0  # messages passed on with something cut off
    deadlines_missed: int = 0  # times that the QoS' deadline passed without a message; 0 where there is none
    rate_hz: float = 0.0  # messages that came in per second, over the last seconds
    age_ns: int | None = None  # time since the last message came in; None before the first
    stale: bool = False  # whether that is longer than the topic allows
    substituting: bool = False  # whether substitutes are published now in a silent PLC's place
    # stale as it is reported: not yet while it lasts for less than ``diagnostics.debounce``, and still
    # until messages have come again for so long
    silent: bool = False
    substituted: int = 0  # substitutes published in a silent PLC's place; they are in no other number
    recovered: int = 0  # how often messages came again after the source was stale
    problem: str = ""  # why the topic cannot be carried at present; empty if it is
    reason: str = ""  # in words, what is wrong or was wrong last; empty if all is well
    code: str = ""  # the error code that goes with ``reason``; empty if there is none
    recent: bool = False  # whether ``reason`` is from the last ten seconds, or still holds

    def _staleness(self, to_plc: bool) -> str:
        source = "ROS" if to_plc else "the PLC"
        if self.age_ns is not None and not self.stale:
            return f"messages from {source} have resumed after silence"
        if self.age_ns is not None:
            words = f"last message {format_age(self.age_ns)} ago from {source}"
            if to_plc and not self.matched:
                words += "; no publisher is left"
            return words + "; substitutes are published" if self.substituting else words
        if not to_plc:
            return f"no message yet from {source}"
        if not self.matched:
            return f"no message yet from {source}: no publisher"
        # Not every middleware tells this side that a peer refuses it for its definition of the type.
        return (
            f"no message yet from {source}, although there is a publisher: the publisher is silent, or its "
            "definition of the type differs and the middleware does not connect it (ROS003)"
        )

    @cached_property
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
            return Level.OK, "no publisher" if to_plc else "no subscriber"
        return Level.OK, f"{self.rate_hz:.3g} Hz"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON; ``direction`` as ``to_plc`` or ``to_ros``."""
        level, message = self.judgement
        return {**asdict(self), "direction": self.direction.word, "level": level.name, "message": message}


@dataclass(frozen=True, kw_only=True)
class CallStatus(Call):
    """The state of one use of a service or action; each call is counted in exactly one of its numbers."""

    type_name: str  # ``package/srv/Name`` or ``package/action/Name``
    server: Literal["plc", "ros"]  # who carries the calls out
    client: str = ""  # the use's name in the PLC's program; empty if it has none
    matched: int = 0  # ROS clients of what the PLC carries out; else 1 if a server is ready
    peer_alive: bool = False  # whether the PLC's block beats
    received: int = 0  # calls that came in, from ROS or from the PLC; the sum of the numbers but ``strays``
    not_executed: Mapping[str, int] = field(default_factory=dict)  # calls that never began, by reason
    # calls that may have been executed, by reason
    fate_unknown: Mapping[str, int] = field(default_factory=dict)
    unreadable: int = 0  # calls that were executed, with an answer that does not fit the PLC's record
    late: int = 0  # calls whose answer came when the caller had gone
    outstanding: int = 0  # calls that wait or are being carried out
    strays: int = 0  # answers that belong to no open call; they are in no other number
    problem: str = ""  # why it cannot be carried at present; empty if it is
    reason: str = ""  # in words, what is wrong or was wrong last; empty if all is well
    code: str = ""  # the error code that goes with ``reason``; empty if there is none
    recent: bool = False  # whether ``reason`` is from the last ten seconds, or still holds

    @property
    def _summary(self) -> str:
        """A sentence about the calls if there is no problem."""
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
    """The state of one use of a service."""

    service: str  # as ROS writes it
    done: int = 0  # calls whose answer was passed on

    kind = "service"

    @property
    def _summary(self) -> str:
        return f"{self.done} of {self.received} calls answered, {self.outstanding} outstanding"


@dataclass(frozen=True, kw_only=True)
class ActionStatus(CallStatus):
    """The state of one use of an action."""

    action: str  # as ROS writes it
    succeeded: int = 0  # goals that were reached
    aborted: int = 0  # goals that were begun and have failed
    canceled: int = 0  # goals that were canceled
    feedback: int = 0  # messages of feedback that were passed on
    # what the open goal does: ``waiting``, ``accepted``, ``executing`` or ``canceling``; empty
    # while there is none
    goal_status: str = ""

    kind = "action"

    @property
    def judgement(self) -> tuple[Level, str]:
        """The level and a sentence for it; an open goal keeps its state while the PLC is silent."""
        if self.server == "plc" and self.goal_status and not (self.problem or self.peer_alive):
            return Level.WARN, f"the PLC is silent; the goal is still {self.goal_status}"
        return super().judgement

    @property
    def _summary(self) -> str:
        goal = f"; current goal: {self.goal_status}" if self.goal_status else ""
        return f"{self.succeeded} of {self.received} goals succeeded, {self.outstanding} outstanding{goal}"


def carried(topics: int, services: int, actions: int) -> str:
    """Return the number of topics, services and actions as text."""
    uses = ((services, "service endpoints"), (actions, "action endpoints"))
    return " and ".join((f"{topics} topics", *(f"{count} {what}" for count, what in uses if count)))


@dataclass(frozen=True)
class BridgeStatus:
    """The state of a bridge and its topics, services and actions."""

    bridge: str
    backend: str = ""  # the ROS backend in use; empty before start
    running: bool = False  # whether it is started
    uptime_ns: int = 0  # time since the start; 0 before
    topics: tuple[TopicStatus, ...] = ()  # in the order of the configuration
    config_changed: bool = False  # whether the configuration's file differs from what was read
    notes: tuple[str, ...] = ()  # what else a person should know
    backend_why: str = ""  # how it was chosen, in words, with what was passed over; empty before start
    services: tuple[ServiceStatus, ...] = ()  # in the order of the configuration; each use is one
    actions: tuple[ActionStatus, ...] = ()  # likewise

    @property
    def calls(self) -> tuple[CallStatus, ...]:
        """Services, then actions."""
        return (*self.services, *self.actions)

    @property
    def judgement(self) -> tuple[Level, str]:
        """The level and a sentence for the bridge itself, without its topics."""
        if not self.running:
            return Level.ERROR, "not running"
        if self.notes:
            return Level.WARN, "; ".join(self.notes)
        counts = carried(len(self.topics), len(self.services), len(self.actions))
        return Level.OK, f"{counts} over {self.backend}"

    def topic(self, name: str) -> TopicStatus:
        """Return a topic's status; KeyError if there is no such topic."""
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
