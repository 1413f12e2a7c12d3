"""The bridge's own DDS endpoints: bytes in, bytes out, state; ``take`` and ``_emit`` are the hot paths."""

from __future__ import annotations

import sys
import threading
from array import array
from typing import Any

from cyclonedds._clayer import ddspy_take, ddspy_write_ts

from rosplc.ros._base import BaseEndpoint, BasePublisher, BaseSubscription, Problem, differs
from rosplc.ros.backend import Sink
from rosplc.ros.buffers import default_buffer, largest_message
from rosplc.ros.dds import native
from rosplc.ros.dds._batch import Outlet, changed
from rosplc.ros.dds.batches import obstacle
from rosplc.ros.dds.idl import dds_topic
from rosplc.ros.dds.native import library_log

_FRESH_NS = 10_000_000  # how old a number of messages that do not fit may be
BATCH = 256  # messages taken from one reader before the others get their turn


class Endpoint(BaseEndpoint):
    """The common base of both directions; the type hash is empty on Humble."""

    dirty = False  # whether a change was seen since the last status
    strangers: frozenset[int] = frozenset()  # handles of publishers that announce another definition

    def __init__(self, entity: Any, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.guid: bytes = entity.guid.bytes
        self.guids = {self.guid: self.direction == "in"}  # of its entities → whether it is a reader
        self.key = self.condition = 0  # set by the backend when the receive thread watches the reader
        self.dds_topic, self._received_topic = self._names()
        self.ref: int = entity._ref
        self.reader_ref = self.ref
        self._entity = entity
        self._unfit_before = library_log.dropped(self._received_topic)
        self.changing = array("i", (self.ref, int(native.CHANGES[self.direction])))
        self._asking = threading.Lock()
        self._known: tuple[tuple[Any, ...], tuple[str, str, int, int, int]] | None = None

    def _names(self) -> tuple[str, str]:
        """Return the DDS topics: that of ``entity``, and the one whose messages are received."""
        return (dds_topic(self.topic),) * 2

    def _matched(self) -> int:
        return native.matched_count(self.ref, self.direction)

    def _asked(self) -> tuple[str, str, int, int, int]:
        """Return what the middleware knows; what cannot have changed is not queried again."""
        if self.serves:
            return super()._asked()
        with self._asking:
            peers = self._node.peers.on(self.dds_topic, "out" if self.direction == "in" else "in")
            basis, known = (peers, self.strangers, self._rejected, self._unfit()), self._known
            if self.dirty or changed(self.changing) or known is None or known[0] != basis:
                self._known, self.dirty = None, False
                found = super()._asked()
                # A problem has words that depend on more, and one that settles on time.
                if not found[0] and not (found[1] and peers):
                    self._known = basis, found
                return found
            return known[1]

    def matched_handles(self) -> frozenset[int]:
        """Instance handles of the matched peers."""
        return frozenset() if self.closed else native.matched_handles(self.ref, self.direction)

    def review(self) -> None:
        """Note that peers may have appeared or disappeared. The node's lock is held."""

    def _samples(self) -> Any:
        """Take what has arrived, up to a limit. The lock is held."""
        if self.closed:
            return ()
        samples = ddspy_take(self.reader_ref, native.ANY_STATE, BATCH)
        if samples.__class__ is int:
            error = native.refusal("take", samples)
            self._node.logger.error("%s: taking messages failed: %s", self.topic, error)
            return ()
        return samples

    def _unfit(self) -> int:
        library_log.drain(_FRESH_NS)
        return library_log.dropped(self._received_topic) - self._unfit_before

    def entities(self) -> tuple[Any, ...]:
        """Return the entities to delete at the end."""
        return (self._entity,)

    def close(self) -> None:
        """Delete the entities; a second call does nothing."""
        if not self.closed:
            super().close()
            for entity in self.entities():
                native.delete(entity)


class DdsSubscription(BaseSubscription, Endpoint):
    """A DDS reader of one topic; see :class:`rosplc.ros.backend.Subscription`."""

    def review(self) -> None:
        """Find strangers: publishers with another type hash."""
        self.strangers = frozenset(
            peer.handle
            for peer in self._node.peers.on(self.dds_topic, "out")
            if differs(peer.info.type_hash, self.type_hash)
        )
        self._node.route(self)

    def divert(self, sink: Sink) -> bool:
        """Pass received messages to the sink; see :data:`rosplc.ros.backend.Sink`."""
        self.sink = sink
        return bool(self._node.route(self))

    def _matched(self) -> int:
        """Number of publishers whose messages are delivered; with a lease, only those that are alive."""
        matched = len(self.matched_handles() - self.strangers) if self.strangers else super()._matched()
        if matched and self.qos.lease_ns:
            # Its strangers may be among those alive: at most as many as match.
            return min(matched, native.alive_count(self.ref))
        return matched

    def deliver(self, payload: bytes, stamp_ns: int) -> None:
        """Deliver what the sink did not take; called only by the receive thread."""
        with self._lock:
            if not self.closed:
                self._deliver(payload, stamp_ns)

    def take(self) -> None:
        """Deliver what has arrived; called only by the receive thread."""
        # DDS matches a publisher that announces another definition of the type. Its messages may decode, with
        # values in the wrong fields, so they are refused and counted.
        with self._lock:
            strangers = self.strangers
            for payload, info in self._samples():
                if not info.valid_data:  # a peer has gone: no message
                    continue
                if strangers and info.publication_handle in strangers:
                    self._rejected += 1
                    continue
                self._deliver(payload, info.source_timestamp)
                if self.closed:  # by on_message
                    return

    def _losses(self) -> int:
        return native.sample_lost(self.ref) + native.sample_rejected(self.ref)

    def _late(self) -> int:
        return native.requested_deadline_missed(self.ref) if self.qos.deadline_ns else 0

    def _problem(self) -> Problem:
        code, reason = BaseEndpoint._problem(self)
        if (rejected := self._rejected + self._unfit()) and not reason:
            fits = f"do not fit the local definition of {self.type_name}"
            return "ROS003", f"{rejected} messages on {self.topic} {fits}"
        return code, reason


class DdsPublisher(BasePublisher, Endpoint):
    """A DDS writer of one topic; see :class:`rosplc.ros.backend.Publisher`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._buffer = default_buffer()
        self._large = largest_message(self._buffer) or sys.maxsize
        self._outlet = None if obstacle() else Outlet(self.ref)
        self.sink = self._outlet

    def open_sink(self, limit_ns: int) -> None:
        """Let messages pass directly; see :data:`rosplc.ros.backend.Sink`."""
        if self._outlet is not None and not self.closed:
            self._outlet.open(self._large, limit_ns)

    def _late(self) -> int:
        return native.offered_deadline_missed(self.ref) if self.qos.deadline_ns else 0

    def _warn_large(self, size: int) -> None:
        self._large = sys.maxsize
        text = (
            "%s: a message of %d bytes does not fit into a default receive buffer (net.core.rmem_default, %d "
            "bytes): subscribers on Fast DDS lose parts of it; best_effort subscribers lose all of it. "
            "Raise net.core.rmem_default on their machines, or use reliable subscriptions"
        )
        self._node.logger.warning(text, self.topic, size, self._buffer)

    def _emit(self, payload: bytes, stamp_ns: int) -> bool:
        if len(payload) > self._large:
            self._warn_large(len(payload))
        code = ddspy_write_ts(self.ref, payload, stamp_ns)
        if code < 0 and code != native.RETCODE_TIMEOUT:
            raise self._refusal(f"its {len(payload)} bytes are not a valid {self.type_name}")
        return bool(code >= 0)
