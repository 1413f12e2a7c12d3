"""The bridge's own DDS endpoints: bytes in, bytes out, and how they fare.

The hot paths are :meth:`DdsSubscription.take` and :meth:`DdsPublisher.write`.
"""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, Literal

from cyclonedds._clayer import ddspy_take, ddspy_write, ddspy_write_ts

from rosplc.errors import BackendError
from rosplc.ros.backend import EndpointStatus, OnMessage, Qos
from rosplc.ros.dds import native
from rosplc.ros.dds.config import receive_buffer
from rosplc.ros.dds.idl import dds_topic
from rosplc.ros.dds.log import library_log

__all__ = ["DdsPublisher", "DdsSubscription"]

_logger = logging.getLogger("rosplc.ros.dds")

_BATCH = 256  # messages taken from one reader before the others get their turn
_PADDING = (b"", b"\0", b"\0\0", b"\0\0\0")

Diagnose = Callable[["DdsSubscription | DdsPublisher"], tuple[str, str]]
"""Returns code and words for what keeps peers from matching an endpoint."""

Closed = Callable[["DdsSubscription | DdsPublisher"], None]


class _Endpoint:
    """What both directions have in common.

    Args:
        entity: The wheel's reader or writer.
        topic: The absolute ROS topic name.
        type_name: The ROS type name.
        type_hash: The ROS type hash; empty on Humble.
        qos: The settings.
        diagnose: Asked for the reason in :meth:`status`.
        on_close: Called once, before the entity is deleted.
    """

    direction: Literal["in", "out"]

    def __init__(
        self,
        entity: Any,
        topic: str,
        type_name: str,
        type_hash: str,
        qos: Qos,
        diagnose: Diagnose,
        on_close: Closed,
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.type_hash = type_hash
        self.qos = qos
        self.guid: bytes = entity.guid.bytes
        self._entity = entity
        self._ref: int = entity._ref
        self._diagnose = diagnose
        self._on_close = on_close
        self._lock = threading.RLock()  # re-entrant: on_message may close its own subscription
        self._closed = False
        self._messages = 0
        self._last_ns = 0

    @property
    def matched(self) -> int:
        """Peers that exchange messages with this endpoint."""
        return 0 if self._closed else native.matched_count(self._ref, of_reader=self.direction == "in")

    def _late(self) -> int:
        """Times that the deadline passed without a message; 0 if there is none."""
        if not self.qos.deadline_ns:
            return 0
        return native.deadlines_missed(self._ref, of_reader=self.direction == "in")

    def matched_handles(self) -> frozenset[int]:
        """Instance handles of the matched peers."""
        if self._closed:
            return frozenset()
        return native.matched_handles(self._ref, of_reader=self.direction == "in")

    def close(self) -> None:
        """Delete the entity; closing twice is harmless."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        self._on_close(self)  # type: ignore[arg-type]
        native.delete(self._entity)


class DdsSubscription(_Endpoint):
    """A DDS reader of one topic; see :class:`rosplc.ros.backend.Subscription`."""

    direction: Literal["in"] = "in"

    def __init__(self, on_message: OnMessage, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._on_message = on_message
        self._failed = 0
        self._refused = 0
        self.strangers: frozenset[int] = frozenset()  # set by the backend as peers come and go
        self._dropped_before = library_log().dropped(dds_topic(self.topic))
        self.condition = 0  # set by the backend when the receive thread watches the reader

    @property
    def matched(self) -> int:
        """Publishers whose messages are delivered; with a lease, those that show that they live."""
        matched = len(self.matched_handles() - self.strangers) if self.strangers else super().matched
        if matched and self.qos.lease_ns:
            # Its strangers may be among those alive: at most as many as match.
            return min(matched, native.alive_count(self._ref))
        return matched

    def take(self) -> None:
        """Deliver what has arrived; called by the receive thread alone.

        DDS matches a publisher that announces another definition of the type. Its messages may
        decode, with values in the wrong fields, so they are refused and counted.
        """
        with self._lock:
            if self._closed:
                return
            samples = ddspy_take(self._ref, native.ANY_STATE, _BATCH)
            if samples.__class__ is int:
                _logger.error("%s: taking messages failed: %s", self.topic, native.refusal("take", samples))
                return
            on_message, strangers = self._on_message, self.strangers
            count = 0
            for payload, info in samples:
                if not info.valid_data:  # a peer has gone: no message
                    continue
                if strangers and info.publication_handle in strangers:
                    self._refused += 1
                    continue
                count += 1
                try:
                    on_message(payload, info.source_timestamp)
                except Exception:
                    self._failed += 1
                    if self._failed == 1:
                        _logger.exception("%s: the receiver of its messages failed", self.topic)
                if self._closed:  # by on_message
                    break
            if count:
                self._messages += count
                self._last_ns = time.time_ns()

    def status(self) -> EndpointStatus:
        """Return the present state."""
        if self._closed:
            return EndpointStatus(
                self.topic,
                self.type_name,
                "in",
                0,
                self._messages,
                0,
                0,
                self._failed,
                self._last_ns,
                "closed",
                "ROS009",
            )
        log = library_log()
        log.drain()
        rejected = log.dropped(dds_topic(self.topic)) - self._dropped_before + self._refused
        code, reason = self._diagnose(self)
        if rejected and not reason:
            code = "ROS003"
            reason = f"{rejected} messages on {self.topic} do not fit {self.type_name} as it is defined here"
        return EndpointStatus(
            self.topic,
            self.type_name,
            "in",
            self.matched,
            self._messages,
            native.sample_lost(self._ref) + native.sample_rejected(self._ref),
            rejected,
            self._failed,
            self._last_ns,
            reason,
            code,
            self._late(),
        )


class DdsPublisher(_Endpoint):
    """A DDS writer of one topic; see :class:`rosplc.ros.backend.Publisher`."""

    direction: Literal["out"] = "out"

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._dropped = 0
        self._rejected = 0
        self._large = receive_buffer() or sys.maxsize

    def _warn_large(self, size: int) -> None:
        _logger.warning(
            "%s: a message of %d bytes does not fit into a default receive buffer (net.core.rmem_default, %d "
            "bytes): subscribers on Fast DDS lose parts of it; best_effort ones lose the message. "
            "Raise net.core.rmem_default on their machines, or let them subscribe reliable",
            self.topic,
            size,
            self._large,
        )
        self._large = sys.maxsize

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message; see :meth:`rosplc.ros.backend.Publisher.write`."""
        size = len(payload)
        # The C layer looks at the header without asking whether there is one.
        if size < 4 or payload[0] != 0 or payload[1] > 1:
            raise self._refused("it has no header of plain CDR")
        if size > self._large:
            self._warn_large(size)
        if size & 3:
            payload = bytes(payload) + _PADDING[-size & 3]
        with self._lock:
            if self._closed:
                raise BackendError("ROS009", f"the publisher of {self.topic} is closed")
            if stamp_ns is None:
                code = ddspy_write(self._ref, payload)
            else:
                code = ddspy_write_ts(self._ref, payload, stamp_ns)
            if code >= 0:
                self._messages += 1
                self._last_ns = time.time_ns()
                return True
            if code == native.RETCODE_TIMEOUT:
                self._dropped += 1
                return False
        raise self._refused(f"its {size} bytes do not fit {self.type_name}")

    def _refused(self, why: str) -> BackendError:
        with self._lock:
            self._rejected += 1
        return BackendError("ROS008", f"a message was not sent on {self.topic}: {why}")

    def status(self) -> EndpointStatus:
        """Return the present state."""
        code, reason = ("ROS009", "closed") if self._closed else self._diagnose(self)
        return EndpointStatus(
            self.topic,
            self.type_name,
            "out",
            self.matched,
            self._messages,
            self._dropped,
            self._rejected,
            0,
            self._last_ns,
            reason,
            code,
            0 if self._closed else self._late(),
        )
