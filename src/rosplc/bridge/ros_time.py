"""ROS time for the PLC's block ``RosPlc_Time``: the system's, or with ``use_sim_time`` that of ``/clock``."""

from __future__ import annotations

import struct
import threading

from rosplc.clock import Clock
from rosplc.codec import Codec
from rosplc.config.resolve import Project
from rosplc.layout import compute_layout
from rosplc.ros import Backend, EndpointStatus, OnMessage, Qos, Subscription, fields

TOPIC = "/ros_time"
PERIOD_NS = 100_000_000  # time between two times of :meth:`RosTime.write`
_CLOCK, _CLOCK_TYPE = "/clock", "rosgraph_msgs/msg/Clock"
_AT_MOST_NS = 5_000_000  # time between two messages because of /clock, at least


class RosTime:
    """In the backend's place for the topic of ROS time: its source, and its stream's subscription."""

    def __init__(self, project: Project, backend: Backend, clock: Clock, sim: bool) -> None:
        self._store, self._clock, self._sim = project.store, clock, sim
        self._type = project.topic(TOPIC).type_name
        self._codec = Codec(compute_layout(project.store, _CLOCK_TYPE))
        self._lock = threading.Lock()
        self._on_message: OnMessage | None = None
        self._sim_ns = self._written_ns = self._count = 0
        self._took_ns = 0  # from the look at the clock to the PLC's object, at most of late
        self._backend = backend
        self._source: Subscription | None = None

    def subscribe(self, _topic: str, _type: str, _qos: Qos, on_message: OnMessage) -> RosTime:
        """Return the subscription of the topic's stream: this one. Raises as the backend does."""
        self._on_message = on_message
        if self._sim:
            qos = Qos("best_effort", depth=1)
            self._source = self._backend.subscribe(_CLOCK, _CLOCK_TYPE, qos, self._on_clock)
        return self

    def _on_clock(self, data: bytes, _stamp_ns: int) -> None:
        seconds, rest = struct.unpack("<iI", self._codec.decode(data))
        self._sim_ns = seconds * 10**9 + rest
        if self._clock.monotonic_ns() - self._written_ns >= _AT_MOST_NS:
            self.write()

    def write(self) -> None:
        """Give the time to the PLC, unless it is not known yet."""
        with self._lock:
            before = self._written_ns = self._clock.monotonic_ns()
            now = self._sim_ns if self._sim else self._clock.time_ns()
            if now and self._on_message is not None:
                took = min(self._took_ns, 2**32 - 1)
                values = {"now": now, "transfer": took, "sim": self._sim}
                self._on_message(fields.pack(self._store, self._type, values), now)
                self._count += 1
                self._took_ns = max(self._clock.monotonic_ns() - before, self._took_ns * 9 // 10)

    def status(self) -> EndpointStatus:
        """Return the present state; the sources are the publishers of ``/clock``, or the system's clock."""
        matched = 1 if self._source is None else self._source.matched
        return EndpointStatus(TOPIC, self._type, "in", matched, self._count)

    def close(self) -> None:
        """Write no more."""
        self._on_message = None
        if self._source is not None:
            self._source.close()
