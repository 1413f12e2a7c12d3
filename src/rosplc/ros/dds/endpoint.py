"""The bridge's own DDS endpoints: bytes in, bytes out, and how they fare.

The hot paths are :meth:`DdsSubscription.take` and :meth:`DdsPublisher.write`.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from typing import Any

from cyclonedds._clayer import ddspy_take, ddspy_write, ddspy_write_ts

from rosplc.clock import Clock
from rosplc.ros._base import BaseEndpoint, BasePublisher, BaseSubscription
from rosplc.ros.backend import OnMessage, Qos
from rosplc.ros.buffers import default_buffer, largest_message
from rosplc.ros.dds import native
from rosplc.ros.dds.idl import dds_topic
from rosplc.ros.dds.log import library_log

__all__ = ["DdsPublisher", "DdsSubscription"]

_logger = logging.getLogger("rosplc.ros.dds")

_BATCH = 256  # messages taken from one reader before the others get their turn

Diagnose = Callable[["DdsSubscription | DdsPublisher"], tuple[str, str]]
"""Returns code and words for what keeps peers from matching an endpoint."""


class _Endpoint(BaseEndpoint):
    """What both directions have in common.

    Args:
        topic: The absolute ROS topic name.
        type_name: The ROS type name.
        qos: The settings.
        on_close: Called once, before the entity is deleted.
        clock: Time.
        entity: The wheel's reader or writer.
        type_hash: The ROS type hash; empty on Humble.
        diagnose: Asked for the reason in :meth:`status`.
    """

    logger = _logger

    def __init__(
        self,
        topic: str,
        type_name: str,
        qos: Qos,
        on_close: Callable[[Any], None],
        clock: Clock,
        entity: Any,
        type_hash: str,
        diagnose: Diagnose,
    ) -> None:
        super().__init__(topic, type_name, qos, on_close, clock)
        self.type_hash = type_hash
        self.guid: bytes = entity.guid.bytes
        self._entity = entity
        self._ref: int = entity._ref
        self._diagnose = diagnose

    def _matched(self) -> int:
        return native.matched_count(self._ref, of_reader=self.direction == "in")

    def _problem(self) -> tuple[str, str]:
        return self._diagnose(self)  # type: ignore[arg-type]

    def _late(self) -> int:
        if not self.qos.deadline_ns:
            return 0
        return native.deadlines_missed(self._ref, of_reader=self.direction == "in")

    def matched_handles(self) -> frozenset[int]:
        """Instance handles of the matched peers."""
        if self.closed:
            return frozenset()
        return native.matched_handles(self._ref, of_reader=self.direction == "in")

    def close(self) -> None:
        """Delete the entity; closing twice is harmless."""
        if not self.closed:
            super().close()
            native.delete(self._entity)


class DdsSubscription(_Endpoint, BaseSubscription):
    """A DDS reader of one topic; see :class:`rosplc.ros.backend.Subscription`."""

    def __init__(self, on_message: OnMessage, *arguments: Any) -> None:
        _Endpoint.__init__(self, *arguments)
        self._on_message = on_message
        self.strangers: frozenset[int] = frozenset()  # set by the backend as peers come and go
        self._refused_strangers = 0
        self._unfit_before = library_log().dropped(dds_topic(self.topic))
        self.condition = 0  # set by the backend when the receive thread watches the reader

    def _matched(self) -> int:
        """Publishers whose messages are delivered; with a lease, those that show that they live."""
        matched = len(self.matched_handles() - self.strangers) if self.strangers else super()._matched()
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
            if self.closed:
                return
            samples = ddspy_take(self._ref, native.ANY_STATE, _BATCH)
            if samples.__class__ is int:
                _logger.error("%s: taking messages failed: %s", self.topic, native.refusal("take", samples))
                return
            strangers = self.strangers
            for payload, info in samples:
                if not info.valid_data:  # a peer has gone: no message
                    continue
                if strangers and info.publication_handle in strangers:
                    self._refused_strangers += 1
                    continue
                self._deliver(payload, info.source_timestamp)
                if self.closed:  # by on_message
                    return

    def _losses(self) -> int:
        return native.sample_lost(self._ref) + native.sample_rejected(self._ref)

    def _problem(self) -> tuple[str, str]:
        log = library_log()
        log.drain()
        self._rejected = log.dropped(dds_topic(self.topic)) - self._unfit_before + self._refused_strangers
        code, reason = super()._problem()
        if self._rejected and not reason:
            code = "ROS003"
            reason = (
                f"{self._rejected} messages on {self.topic} do not fit {self.type_name} as it is defined here"
            )
        return code, reason


class DdsPublisher(_Endpoint, BasePublisher):
    """A DDS writer of one topic; see :class:`rosplc.ros.backend.Publisher`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._buffer = default_buffer()
        self._large = largest_message(self._buffer) or sys.maxsize

    def _warn_large(self, size: int) -> None:
        _logger.warning(
            "%s: a message of %d bytes does not fit into a default receive buffer (net.core.rmem_default, %d "
            "bytes): subscribers on Fast DDS lose parts of it; best_effort ones lose the message. "
            "Raise net.core.rmem_default on their machines, or let them subscribe reliable",
            self.topic,
            size,
            self._buffer,
        )
        self._large = sys.maxsize

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message; see :meth:`rosplc.ros.backend.Publisher.write`."""
        data = self._checked(payload)  # the C layer would not ask whether there is a header
        if len(data) > self._large:
            self._warn_large(len(data))
        with self._lock:
            if self.closed:
                raise self._closed()
            code = (
                ddspy_write(self._ref, data)
                if stamp_ns is None
                else ddspy_write_ts(self._ref, data, stamp_ns)
            )
            if code >= 0:
                self._messages += 1
                self._last_ns = self._clock.time_ns()
                return True
            if code == native.RETCODE_TIMEOUT:
                self._dropped += 1
                return False
        raise self._refusal(f"its {len(payload)} bytes do not fit {self.type_name}")
