"""Playing a recording's messages into a target, in their order and at their pace."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import RecordingError
from rosplc.recorder.carried import Selection
from rosplc.recorder.source import Source, SourceTopic

__all__ = ["Player", "ReplayOptions", "Target", "TopicCount", "chosen_topics", "wait_for_readers"]

_LOOK_S = 0.05


@dataclass
class TopicCount:
    """What became of one topic's messages."""

    sent: int = 0
    refused: int = 0
    lost: int = 0
    reason: str = ""


class Target(Protocol):
    """Where messages go.

    Attributes:
        counts: Topic → what became of its messages.
        notes: What is converted, dropped or left zero on the way.
        linger_s: How long to stay after the last message, in seconds.
    """

    counts: dict[str, TopicCount]
    notes: list[str]
    linger_s: float

    def send(self, topic: str, data: bytes, stamp_ns: int) -> None:
        """Pass a message on; what does not fit is counted and never raised."""

    def missing(self) -> list[str]:
        """Return the topics that nobody takes yet."""

    def close(self) -> None:
        """Let go of everything; channels keep their last message."""


def wait_for_readers(
    target: Target, seconds: float, stopped: Callable[[float], bool], clock: Clock = SYSTEM
) -> list[str]:
    """Wait until every topic has somebody who takes it, and return those that have not.

    Args:
        target: Where messages will go.
        seconds: How long to wait.
        stopped: Waits for so many seconds; returns True if the wait is to end.
        clock: By which it is waited.
    """
    end = clock.monotonic_ns() + seconds * 1e9
    while (missing := target.missing()) and clock.monotonic_ns() < end:
        if stopped(_LOOK_S):
            break
    return missing


_NO_TIME = 2**63 - 1
"""DDS and ROS count ns since 1970 in signed 64 bits; the largest number means none."""
_NAP_S = 0.2
"""How long at most before it is looked whether to stop."""


@dataclass(frozen=True)
class ReplayOptions:
    """How a recording is replayed.

    Attributes:
        speed: 1 as recorded, 2 twice as fast; 0 as fast as it goes.
        loop: Begin again at the end.
        start_ns: Leave out so much at the beginning.
        end_ns: End so long after the recording's beginning; 0 for its end.
        stamps: ``now``: a message is stamped when it is sent; ``original``: as it was recorded.
    """

    speed: float = 1.0
    loop: bool = False
    start_ns: int = 0
    end_ns: int = 0
    stamps: Literal["now", "original"] = "now"


def chosen_topics(
    source: Source, selection: Selection, rename: Mapping[str, str], *, to_plc: bool
) -> tuple[dict[str, SourceTopic], list[str]]:
    """Return new name → topic of what is to be replayed, and in words what was left out.

    Args:
        source: The recording.
        selection: Which topics; without names, towards the PLC those that the PLC wrote are left out.
        rename: Topic → new name.
        to_plc: Whether they go into channels.

    Raises:
        RecordingError: REC006, nothing is left; REC007, two topics would have one name.
    """
    remarks = [f"{name} is left out: {why}" for name, why in source.unusable.items() if name in selection]
    chosen: dict[str, SourceTopic] = {}
    for name, topic in sorted(source.topics.items()):
        if name not in selection or name in source.unusable:
            continue
        if to_plc and topic.direction == "to_ros" and not selection.topics:
            remarks.append(f"{name} is left out: the PLC wrote it; name it to replay it")
            continue
        new = rename.get(name, name)
        if new in chosen:
            raise RecordingError("REC007", f"{new} would get two topics' messages", where=name)
        chosen[new] = topic
    for wrong in [name for name in rename if name not in source.topics]:
        remarks.append(f"{wrong} is not in the recording, and not renamed")
    if not chosen:
        known = ", ".join(sorted(source.topics)) or "none"
        raise RecordingError("REC006", f"no topic is left to replay; the recording has {known}")
    return chosen, remarks


@dataclass
class Player:
    """Plays a recording into a target.

    Args:
        source: The recording.
        target: Where it goes.
        topics: New name → topic.
        options: How.
        clock: What the pace is kept by, and messages are stamped with.

    Attributes:
        rounds: How many times it was begun.
        position_ns: How far it is from the recording's beginning.
        latest_ns: The most that a message was sent too late, at a speed other than the fastest.
        disordered: Messages whose time lies before that of the one sent before.
    """

    source: Source
    target: Target
    topics: Mapping[str, SourceTopic]
    options: ReplayOptions = field(default_factory=ReplayOptions)
    clock: Clock = SYSTEM
    rounds: int = 0
    position_ns: int = 0
    latest_ns: int = 0
    disordered: int = 0

    def play(self, stopped: Callable[[float], bool], look: Callable[[], None] = lambda: None) -> None:
        """Play until the end, or until told to stop.

        Args:
            stopped: Waits for so many seconds, and returns True if it is to stop.
            look: Called a few times a second, for progress.

        Raises:
            RecordingError: REC003, the file is damaged; what lies before has been sent.
        """
        while not stopped(0.0):
            self.rounds += 1
            if not self._once(stopped, look) or not self.options.loop:
                return

    def _once(self, stopped: Callable[[float], bool], look: Callable[[], None]) -> bool:
        """Play once; return whether there was a message, and the end was reached."""
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
