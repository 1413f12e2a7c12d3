"""A topic's messages as they come: how many, how often, how long."""

from __future__ import annotations

from dataclasses import dataclass

from rosplc.init.found import Seen
from rosplc.init.meter import Meter

__all__ = ["Sample"]


@dataclass
class Sample:
    """Counts, times and measures messages; used by one thread at a time.

    Args:
        meter: Measures them.
        settle_ns: For so long from the first message on none counts for the rate: publishers that keep
            messages for those who come later deliver all of them at once.
    """

    meter: Meter
    settle_ns: int = 0
    _first_ns: int = 0
    _last_ns: int = 0
    _gap_ns: int = 0
    _count: int = 0
    _regular_from_ns: int = 0
    _regular: int = 0

    def take(self, data: bytes, time_ns: int) -> None:
        """Take a message that came at ``time_ns`` of any one clock."""
        if self._count:
            self._gap_ns = max(self._gap_ns, time_ns - self._last_ns)
        else:
            self._first_ns = time_ns
        self._last_ns = max(time_ns, self._last_ns)
        self._count += 1
        if not self.settle_ns or time_ns - self._first_ns >= self.settle_ns:
            self._regular_from_ns = self._regular_from_ns if self._regular else time_ns
            self._regular += 1
        self.meter.measure(data)

    def seen(self, seconds: float, trouble: str = "") -> Seen:
        """Return what it was like, of ``seconds`` of listening."""
        lasted = (self._last_ns - self._regular_from_ns) / 1e9
        return Seen(
            messages=self.meter.messages,
            unreadable=self.meter.unreadable,
            seconds=seconds,
            rate_hz=(self._regular - 1) / lasted if self._regular > 1 and lasted > 0 else 0.0,
            longest_gap_s=self._gap_ns / 1e9,
            lengths=dict(self.meter.lengths),
            trouble="" if self._count else trouble,
        )
