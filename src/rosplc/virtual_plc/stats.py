"""What a task knows about its own timing, as a PLC's task monitor shows it."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CycleStats"]


@dataclass(slots=True)
class CycleStats:
    """Counters of one task; every time is in nanoseconds.

    Attributes:
        scans: Scans that ran.
        missed: Scans that did not run because the one before took too long, or because the
            machine was late by a whole interval.
        jitter_max: The most by which a scan began after its time.
        cycle_last: Duration of the last scan.
        cycle_min: Shortest scan; 0 before the first.
        cycle_max: Longest scan.
        cycle_sum: Sum over all scans, for the mean.
        watchdog_excesses: Scans that took longer than the watchdog time.
    """

    scans: int = 0
    missed: int = 0
    jitter_max: int = 0
    cycle_last: int = 0
    cycle_min: int = 0
    cycle_max: int = 0
    cycle_sum: int = 0
    watchdog_excesses: int = 0

    @property
    def cycle_mean(self) -> float:
        """Mean duration of a scan in nanoseconds; 0 before the first."""
        return self.cycle_sum / self.scans if self.scans else 0.0

    def add(self, lateness: int, duration: int) -> None:
        """Count one scan that began ``lateness`` ns after its time and took ``duration`` ns."""
        self.scans += 1
        self.jitter_max = max(self.jitter_max, lateness)
        self.cycle_last = duration
        self.cycle_min = duration if self.scans == 1 else min(self.cycle_min, duration)
        self.cycle_max = max(self.cycle_max, duration)
        self.cycle_sum += duration

    def to_dict(self) -> dict[str, int | float]:
        """Return the counters as plain data, times in microseconds."""
        return {
            "scans": self.scans,
            "missed": self.missed,
            "jitter_max_us": self.jitter_max / 1000,
            "cycle_last_us": self.cycle_last / 1000,
            "cycle_min_us": self.cycle_min / 1000,
            "cycle_mean_us": self.cycle_mean / 1000,
            "cycle_max_us": self.cycle_max / 1000,
            "watchdog_excesses": self.watchdog_excesses,
        }
