"""Messages per second out of a counter that is looked at now and then."""

from __future__ import annotations

from collections import deque

__all__ = ["Rate"]

_WINDOW_NS = 2_000_000_000
_LONGEST_NS = 30_000_000_000
_FEWEST = 4
_MISSED = 2


class Rate:
    """Messages per second, from looks at the number of messages.

    It counts over the last two seconds, and over up to half a minute where fewer than three messages came
    in them, so that one message a second reads as 1 and not as 0 and 2 in turn.
    """

    def __init__(self) -> None:
        self._changes: deque[tuple[int, int]] = deque()

    def of(self, count: int, now_ns: int) -> float | None:
        """Note the number at ``now_ns`` of a monotonic clock; return the rate in Hz, None before it is known.

        Args:
            count: Messages so far; it never falls.
            now_ns: The time.
        """
        changes = self._changes
        if not changes or changes[-1][1] != count:
            changes.append((now_ns, count))
        while len(changes) > _FEWEST and now_ns - changes[1][0] > _WINDOW_NS:
            changes.popleft()
        while len(changes) > 1 and now_ns - changes[1][0] > _LONGEST_NS:
            changes.popleft()
        (then, before), (last, after) = changes[0], changes[-1]
        if after == before:
            # One look tells nothing; the first change after a long time says when, and not how often.
            return 0.0 if now_ns - then > _WINDOW_NS else None
        mean = (last - then) / (after - before)
        late = now_ns - last > max(_MISSED * mean, _WINDOW_NS / 4)
        if now_ns - last > max(_WINDOW_NS, 5 * mean):
            return 0.0
        span = (now_ns if late else last) - then
        return (after - before) * 1e9 / span if span > 0 else None
