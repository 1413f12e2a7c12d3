"""What a replay's messages go into."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from rosplc.clock import SYSTEM, Clock

__all__ = ["Target", "TopicCount", "wait_for_readers"]

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
