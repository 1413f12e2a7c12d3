"""Log repeated warnings seldom: the first at once, then one every ten seconds with a count."""

from __future__ import annotations

import logging
from collections.abc import Hashable

__all__ = ["QUIET_NS", "RepeatedWarnings"]

QUIET_NS = 10_000_000_000
"""Time between two log lines of one kind."""

_MOST_KINDS = 1000


class RepeatedWarnings:
    """Counts what it holds back; kinds are hashable, such as ``(topic, code)``."""

    def __init__(self, logger: logging.Logger) -> None:
        self._logger = logger
        self._seen: dict[Hashable, tuple[int, int]] = {}

    def warn(self, kind: Hashable, now_ns: int, text: str) -> None:
        """Log ``text``, or count it if its kind was logged within the last ten seconds."""
        last, held = self._seen.get(kind, (None, 0))
        if last is not None and now_ns - last < QUIET_NS:
            self._seen[kind] = (last, held + 1)
            return
        if len(self._seen) >= _MOST_KINDS:
            self._seen.clear()
        self._seen[kind] = (now_ns, 0)
        self._logger.warning("%s%s", text, f" ({held} more since the last such line)" if held else "")
