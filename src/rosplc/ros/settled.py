"""The graph once everybody in it has been seen: discovery takes a moment, and nobody says when it is over."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection

from rosplc.ros.backend import GraphInfo

_LEAST_S = 1.0
_STEADY_S = 1.0


def settled_graph(graph: Callable[[], GraphInfo], seconds: float, needed: Collection[str] = ()) -> GraphInfo:
    """Return the graph once it has not changed for a second, or when the time is over.

    Args:
        graph: :meth:`rosplc.ros.backend.Backend.graph`.
        seconds: The longest time.
        needed: Topics that are waited for.
    """
    start = changed = time.monotonic()
    seen = graph()
    while (now := time.monotonic()) - start < seconds:
        time.sleep(0.1)
        if (again := graph()) != seen:
            seen, changed = again, now
        # A graph in which nobody is may still be about to appear: it is waited for to the end.
        complete = bool(seen.nodes) and all(end.node for end in seen.endpoints)
        complete = complete and all(topic in seen.topics for topic in needed)
        if complete and now - start > _LEAST_S and now - changed > _STEADY_S:
            break
    return seen
