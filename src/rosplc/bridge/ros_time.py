"""ROS time for the PLC's block ``RosPlc_Time``: the system time, or ``/clock`` with ``use_sim_time``."""

from __future__ import annotations

import struct
import threading

from rosplc.bridge.stream import OwnEnd
from rosplc.clock import Clock
from rosplc.codec import Codec
from rosplc.config.resolve import Project
from rosplc.layout import compute_layout
from rosplc.ros import Backend, Qos, Subscription, fields

TOPIC = "/ros_time"
PERIOD_NS = 100_000_000  # time between two times of :meth:`RosTime.write`
_CLOCK, _CLOCK_TYPE = "/clock", "rosgraph_msgs/msg/Clock"
_AT_MOST_NS = 5_000_000  # time between two messages because of /clock, at least


class RosTime(OwnEnd):
    """The source of ROS time. Raises as the backend's ``subscribe`` does."""

    def __init__(self, project: Project, backend: Backend, clock: Clock, sim: bool) -> None:
        super().__init__()
        self._store, self._clock, self._backend = project.store, clock, backend
        self._type = project.topic(TOPIC).type_name
        self._codec = Codec(compute_layout(project.store, _CLOCK_TYPE))
        self._lock, self._switching = threading.Lock(), threading.Lock()
        self._sim_ns = self._written_ns = 0
        self._took_ns = 0  # from the look at the clock to the PLC's object, at most of late
        self._source: Subscription | None = None
        self._sim = False
        self.use(sim)

    @property
    def matched(self) -> int:  # type: ignore[override]
        """Number of publishers of ``/clock``, or 1 for the system clock."""
        return 1 if self._source is None else self._source.matched

    def _on_clock(self, data: bytes, _stamp_ns: int) -> None:
        seconds, rest = struct.unpack("<iI", self._codec.decode(data))
        self._sim_ns = seconds * 10**9 + rest
        if self._clock.monotonic_ns() - self._written_ns >= _AT_MOST_NS:
            self.write()

    def write(self) -> None:
        """Send the time to the PLC, if it is known."""
        with self._lock:
            before = self._written_ns = self._clock.monotonic_ns()
            now = self._sim_ns if self._sim else self._clock.time_ns()
            if now:
                took = min(self._took_ns, 2**32 - 1)
                values = {"now": now, "transfer": took, "sim": self._sim}
                self.give(fields.pack(self._store, self._type, values), now)
                self._took_ns = max(self._clock.monotonic_ns() - before, self._took_ns * 9 // 10)

    def use(self, sim: bool) -> None:
        """Use the time from ``/clock`` or the system clock; raises as the class."""
        with self._switching:
            if sim and self._source is None:
                self._sim_ns = 0
                qos = Qos("best_effort", depth=1)
                self._source = self._backend.subscribe(_CLOCK, _CLOCK_TYPE, qos, self._on_clock)
            elif not sim and self._source is not None:
                self._source.close()
                self._source = None
            self._sim = sim

    def leave(self) -> None:
        """Unsubscribe from ``/clock``."""
        self.use(False)
