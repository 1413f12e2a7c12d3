"""``/rosout``, the topic for log lines in ROS: the bridge's log and lines from the PLC's program."""

from __future__ import annotations

import logging
import threading
from collections import deque
from typing import Any

from rosplc.bridge.port import RepeatedWarnings, log
from rosplc.bridge.stream import OwnEnd
from rosplc.clock import Clock
from rosplc.codec import Codec
from rosplc.config.resolve import Project
from rosplc.harmless import harmless, plural
from rosplc.ros import Backend, EndpointStatus, Publisher, Qos, fields

PERIOD_NS = 200_000_000  # time between two times of :meth:`Rosout.send`
TOPIC = "/rosout"
QOS = Qos(durability="transient_local", depth=1000, lifespan_ns=10_000_000_000)  # that of rclpy's nodes
_WAITING = 1000  # lines that wait at most; the oldest give way
_LONGEST = 4096  # characters of a line's text
_PLC_LINES = 50  # of the PLC in a second


class Rosout(logging.Handler):
    """Sends log lines to ``/rosout`` under the node's name; as a handler, it receives a logger's records.

    Lines are queued for :meth:`send`, so that logging never waits for ROS. What is logged while sending, such
    as a failure to send, is not sent.
    """

    def __init__(self, project: Project, backend: Backend, clock: Clock) -> None:
        super().__init__()
        self._store, self._clock = project.store, clock
        self._ros1 = project.store.ros_version == 1
        self._type = "rosgraph_msgs/msg/Log" if self._ros1 else "rcl_interfaces/msg/Log"
        self._name = backend.node if self._ros1 else backend.node.strip("/").replace("/", ".")
        self._lines: deque[tuple[dict[str, Any], int]] = deque(maxlen=_WAITING)
        self._left_out = 0
        self._sender = 0  # the thread that is sending
        self._warnings = RepeatedWarnings(log)
        self.publisher: Publisher = backend.advertise(TOPIC, self._type, QOS)

    def emit(self, record: logging.LogRecord) -> None:
        """Accept a record from a logger."""
        if threading.get_ident() != self._sender:
            try:
                text, path, line = harmless(self.format(record)), record.pathname, record.lineno
                self.put(record.levelno, text, file=path, function=record.funcName, line=line)
            except Exception:  # the record's arguments do not fit its text
                self.handleError(record)

    def put(self, level: int, text: str, child: str = "", stamp_ns: int = 0, **place: Any) -> None:
        """Queue a line: ``level`` as in :mod:`logging`, ``child`` of the node's name; ``stamp_ns`` 0: now."""
        stamp_ns, grade = stamp_ns or self._clock.time_ns(), min(max(level // 10, 1), 5)
        stamp = {"stamp": fields.time(stamp_ns)}
        values = {"name": self._name + child, "msg": text[:_LONGEST], **place}
        values["level"] = 2 ** (grade - 1) if self._ros1 else 10 * grade
        values |= {"header": stamp} if self._ros1 else stamp
        self._left_out += len(self._lines) == _WAITING
        self._lines.append((values, stamp_ns))

    def send(self) -> None:
        """Send the queued lines. A failure is logged, but not here."""
        if self._sender:  # a thread that was left behind hangs in the ROS side
            return
        self._sender = threading.get_ident()
        try:
            if count := self._left_out:
                self._left_out = 0
                self.put(logging.WARNING, f"dropped {plural(count, 'log line')}: the buffer was full")
            for _ in range(len(self._lines)):
                values, stamp_ns = self._lines.popleft()
                self.publisher.write(fields.pack(self._store, self._type, values), stamp_ns)
        except Exception as error:  # logged by the caller it would come back as the next line
            text = f"the log cannot be sent to {TOPIC}: {error}"
            self._warnings.warn(TOPIC, self._clock.monotonic_ns(), text)
        finally:
            self._sender = 0

    def leave(self) -> None:
        """Send the remaining lines and close the publisher."""
        logging.getLogger("rosplc").removeHandler(self)
        self.send()
        self.publisher.close()


class PlcLog(OwnEnd):
    """Completes the lines of the PLC's own topic ``/rosout`` and limits their rate."""

    def __init__(self, rosout: Rosout, project: Project, clock: Clock) -> None:
        super().__init__()
        self._layout = project.topic(TOPIC).layout
        self._codec = Codec(self._layout)
        self._rosout, self._now = rosout, clock.monotonic_ns
        self._since, self._lines = self._now(), 0

    @property
    def matched(self) -> int:  # type: ignore[override]
        """Number of subscribers to ``/rosout``."""
        return self._rosout.publisher.matched

    def status(self) -> EndpointStatus:
        """Return the state of the bridge's publisher."""
        return self._rosout.publisher.status()

    def write(self, payload: bytes, stamp_ns: int) -> bool:
        """Accept a line; lines beyond the limit are counted, and the count is logged later."""
        if (now := self._now()) - self._since >= 1_000_000_000:
            if (more := self._lines - _PLC_LINES) > 0:
                self._rosout.put(logging.WARNING, f"{plural(more, 'line')} suppressed", ".plc")
            self._since, self._lines = now, 0
        self._lines += 1
        if self._lines <= _PLC_LINES:
            line = self._layout.to_dict(self._codec.decode(payload))
            before = f" (the PLC suppressed {plural(line['line'], 'line')} before it)" * bool(line["line"])
            self._rosout.put(line["level"], harmless(line["msg"]) + before, ".plc", stamp_ns)
        return True
