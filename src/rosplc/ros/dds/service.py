"""Services on DDS, as ``rmw_cyclonedds_cpp`` maps them.

A service is two topics, ``rq/<name>Request`` and ``rr/<name>Reply``; both endpoints of a server or client
exist, or neither. Between encapsulation and fields, each payload has 16 bytes: the client's id and the number
of the call, both in the payload's byte order. A response repeats them, so any server may send it. The reader
and the writer of a server share one ``serviceid=`` in their user data, those of a client one ``clientid=``.

Fast DDS uses the same names but carries the two numbers outside of the payload, so such endpoints match and
misread each other: they are recognized by the vendor in their ids, and are neither served nor called. Their
clients consider a service available if equal numbers of request readers and reply writers exist and have
matched (rmw_fastrtps, ``rmw_service_server_is_available``). Therefore, a server has a second reply writer,
in a separate partition where nothing matches it, as long as no server on Fast DDS has the same name.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from typing import Any, NamedTuple

from cyclonedds._clayer import ddspy_write

from rosplc.errors import BackendError
from rosplc.reasons import Reason
from rosplc.ros import _base
from rosplc.ros._base import MOST_CALLERS, BaseClient, KeepingServer
from rosplc.ros.backend import Reply
from rosplc.ros.dds import native
from rosplc.ros.dds.endpoint import Endpoint
from rosplc.ros.dds.idl import service_topics
from rosplc.ros.dds.peers import Peer

_ENCAPSULATION, _HEADER = 4, 16  # Bytes.
_ORDER = (">Qq", "<Qq")
_CALLER = struct.Struct("<Qq")
_PATIENCE_NS = 100_000_000  # for a client's reply reader, as rmw_cyclonedds_cpp has it
_DISCOVERY_NS = 2_000_000_000  # after which the clients of an earlier process have found the server
_BUSY = Reply(None, "not executed", Reason.QUEUE_FULL, "a server cannot keep up with its requests")


def with_header(payload: bytes, client: int, number: int) -> bytes:
    """Return a payload with a call's header."""
    header = struct.pack(_ORDER[payload[1]], client, number)
    return payload[:_ENCAPSULATION] + header + payload[_ENCAPSULATION:]


def split_header(data: bytes) -> tuple[bytes, int, int]:
    """Return payload, client and number; ValueError if there is no header."""
    if len(data) < _ENCAPSULATION + _HEADER or not _base.is_cdr(data):
        raise ValueError("it has no call header, or is not plain CDR")
    client, number = struct.unpack_from(_ORDER[data[1]], data, _ENCAPSULATION)
    return data[:_ENCAPSULATION] + data[_ENCAPSULATION + _HEADER :], client, number


class _Service(Endpoint):
    """The reader, writer and peers on the two topics; entity and type hash are those of the request."""

    def __init__(self, reader: Any, writer: Any, response_hash: str, *arguments: Any) -> None:
        asks = self.direction == "out"
        super().__init__(writer if asks else reader, *arguments)
        self._other = reader if asks else writer
        self._hash_of_response = response_hash
        self.reader_ref, self._writer_ref = reader._ref, writer._ref
        self.guids = {reader.guid.bytes: True, writer.guid.bytes: False}

    def _names(self) -> tuple[str, str]:
        request, self.reply_topic = service_topics(self.topic)
        return request, self.reply_topic if self.direction == "out" else request

    def entities(self) -> tuple[Any, ...]:
        """Return the entities to delete at the end, the request's endpoint first."""
        return self._entity, self._other

    def peers(self, *, replying: bool = False) -> list[Peer]:
        """Return the matched endpoints on the request's topic, or on the reply's."""
        entity, direction = self._entity, self.direction
        if replying:
            entity, direction = self._other, "out" if direction == "in" else "in"
        matched = frozenset() if self.closed else native.matched_handles(entity._ref, direction)
        topic, theirs = (self.dds_topic, self.reply_topic)[replying], "out" if direction == "in" else "in"
        return [peer for peer in self._node.peers.on(topic, theirs) if peer.handle in matched]

    def understands(self, peer: Peer, *, replying: bool = False) -> bool:
        """Return whether a peer uses the same protocol and definition."""
        ours = self._hash_of_response if replying else self.type_hash
        return peer.has_header and not _base.differs(ours, peer.info.type_hash)

    def _matched(self) -> int:
        return sum(map(self.understands, self.peers()))

    def _write(self, payload: bytes, client: int, number: int) -> bool:
        """Send a message; False if a peer cannot keep up."""
        with self._lock:
            if self.closed:
                raise self._closed()
            code = ddspy_write(self._writer_ref, with_header(payload, client, number))
            if code < 0 and code != native.RETCODE_TIMEOUT:
                raise self._refusal(f"its {len(payload)} bytes are not a valid {self.type_name}")
            self._dropped += code < 0
            return bool(code >= 0)

    def take(self) -> None:
        """Deliver what has arrived; called only by the receive thread."""
        with self._lock:
            samples = self._samples()
        for data, info in samples:
            if info.valid_data:  # otherwise a peer has gone
                try:
                    self._arrived(info, *split_header(data))
                except ValueError as error:
                    self.reject(error)

    def _arrived(self, info: Any, payload: bytes, client: int, number: int) -> None:
        """Process one message; ValueError if it must be refused."""
        raise NotImplementedError

    def _sender(self, info: Any, *, replying: bool = False) -> Peer:
        peer: Peer | None = self._node.writer(self._received_topic, info.publication_handle)
        if peer is None or not self.understands(peer, replying=replying):
            raise ValueError("its sender is unknown, or uses another protocol or definition")
        return peer


class _Pending(NamedTuple):
    """A response that waits for the client's reply reader; client None: from an earlier process's call."""

    since: int
    caller: bytes
    origin: Peer | None
    payload: bytes


class DdsServer(KeepingServer, _Service):
    """A service server; a caller's id is the client's id and the call's number, as little-endian words."""

    remembers = True

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._clients: OrderedDict[bytes, int] = OrderedDict()  # id → its first call in this process
        self._pending: list[_Pending] = []
        self._known_by = self._clock.monotonic_ns() + _DISCOVERY_NS
        self.decoy: Any = None  # the second reply writer

    def review(self) -> None:
        """Prevent clients on Fast DDS from using this service. The node's lock is held."""
        foreign = any(not peer.has_header for peer in self._node.peers.on(self.dds_topic, "in"))
        if foreign and self.decoy is not None:
            native.delete(self.decoy)
            self.decoy = None
        elif not foreign and self.decoy is None and not self.closed:
            self.decoy = self._node.decoy(self.topic, self.type_name)

    def entities(self) -> tuple[Any, ...]:
        """Return the entities to delete at the end."""
        return (*super().entities(), *([self.decoy] if self.decoy is not None else []))

    def _arrived(self, info: Any, payload: bytes, client: int, number: int) -> None:
        sender = self._sender(info)
        caller = _CALLER.pack(client, number)
        self._clients.setdefault(caller[:8], number)
        if len(self._clients) > MOST_CALLERS:
            self._clients.popitem(last=False)
        self._take(payload, caller, info.source_timestamp, sender)

    def _waits(self, caller: bytes, origin: Peer | None) -> bool:
        if origin is not None:
            return origin.handle in self.matched_handles()
        first = self._clients.get(caller[:8])
        return first is None or _CALLER.unpack(caller)[1] < first  # it called a server of an earlier process

    def _reached(self, origin: Peer | None) -> bool:
        """Return whether the client's reply reader is known."""
        if origin is None:
            return self._clock.monotonic_ns() >= self._known_by
        ids = {peer.service_id for peer in self.peers(replying=True)}
        return not origin.service_id or origin.service_id in ids

    def _answer(self, caller: bytes, origin: Peer | None, payload: bytes) -> bool:
        if self._reached(origin):
            readers = origin is not None or self.peers(replying=True)
            return bool(readers) and self._write(payload, *_CALLER.unpack(caller))
        with self._lock:
            self._pending.append(_Pending(self._clock.monotonic_ns(), caller, origin, payload))
        self._node.hurry(self)
        return True

    def flush(self) -> bool:
        """Send the responses whose readers are known by now, drop late ones; return whether some wait."""
        with self._lock:
            pending, self._pending = self._pending, []
            for one in pending if not self.closed else ():
                overdue = self._clock.monotonic_ns() - one.since >= _PATIENCE_NS
                if not self._reached(one.origin) and not (overdue and one.origin):
                    self._pending.append(one)
                    continue
                try:
                    waits = self._reached(one.origin) and self._waits(one.caller, one.origin)
                    sent = waits and self._answer(one.caller, one.origin, one.payload)
                    self._dropped += not sent
                except BackendError as error:
                    self._node.logger.warning("%s: %s", self.topic, error)
            return bool(self._pending)


class DdsClient(BaseClient, _Service):
    """A service client; see :class:`rosplc.ros.backend.ServiceClient`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._id = native.instance_handle(self.ref)

    def _matched(self) -> int:
        return len(self._receivers())

    def _receivers(self) -> list[int]:
        """Return the servers; none while the request would also reach a server that misreads it."""
        requested = self.peers()
        if len(requested) < len(self.matched_handles()) or not all(map(self.understands, requested)):
            return []
        replying = (peer for peer in self.peers(replying=True) if self.understands(peer, replying=True))
        ids = {peer.service_id for peer in replying}
        return [peer.handle for peer in requested if peer.service_id in ids]

    def _send(self, number: int, payload: bytes) -> Reply | None:
        return None if self._write(payload, self._id, number) else _BUSY

    def _arrived(self, info: Any, payload: bytes, client: int, number: int) -> None:
        if client == self._id:  # all clients of a service receive all responses
            self._sender(info, replying=True)
            self.end(number, Reply(payload))
