"""rclpy/duration.py."""

from __future__ import annotations

INFINITE_NS = 2**63 - 1


class Duration:
    def __init__(self, *, seconds: float = 0, nanoseconds: int = 0) -> None:
        self.nanoseconds = int(seconds * 10**9) + nanoseconds


Infinite = Duration(nanoseconds=INFINITE_NS)
