"""Services on Zenoh, as ``rmw_zenoh_cpp`` maps them: a server is a queryable, a call is a query.

A query has the same attachment as a topic's message, and the reply repeats its number and id. A query exists
in the server's process: when that ends, Zenoh ends the query, and no other process can answer it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import zenoh

from rosplc.reasons import Reason
from rosplc.ros._base import NO_SERVER, SERVER_GONE, BaseClient, KeepingServer, Queued
from rosplc.ros.backend import Reply
from rosplc.ros.zenoh.endpoint import Endpoint, Sender, read
from rosplc.ros.zenoh.keys import Attachment, gid_of, pack

# Seconds, as rmw_zenoh_cpp; it waits for the result of an action for as long as the library can count.
_TIMEOUT, _TIMEOUT_OF_RESULT = 600.0, 315_360_000.0


@dataclass(slots=True)
class _Origin:
    """A query that is waiting for its reply."""

    query: Any
    attachment: Attachment
    seen: bool = False  # whether its client has had a token


class ZenohServer(Queued, KeepingServer, Endpoint):
    """A service that is served; see :class:`rosplc.ros.backend.ServiceServer`."""

    _take = KeepingServer._take

    def _declare(self, session: Any) -> list[Any]:
        receive = zenoh.handlers.Callback(self.arrived, None, indirect=False)
        return [session.declare_queryable(self._key, receive, complete=True)]

    def arrived(self, query: Any) -> None:
        """Queue a request; called by threads of the library, so no exception may escape."""
        try:
            payload, attachment = read(query.payload, query.attachment)
            origin = _Origin(query, attachment)
            self._waits(b"", origin)  # while its client is certainly there
        except Exception as error:
            self.reject(error)
            return
        with self._lock:
            if self.closed or not self._put(payload, self.new_caller(), attachment.stamp_ns, origin):
                return
        self._node.wake(self)

    def _waits(self, caller: bytes, origin: _Origin) -> bool:
        """A client is seen by its token, if its attachments have the id that the token gives."""
        there = origin.attachment.gid in self._node.tokens.gids(self.topic, "SC")
        origin.seen |= there
        return there or not origin.seen

    def _answer(self, caller: bytes, origin: _Origin, payload: bytes) -> bool:
        attachment = pack(origin.attachment.sequence, self._clock.time_ns(), origin.attachment.gid)
        try:
            origin.query.reply(self._key, payload, attachment=attachment)
        except zenoh.ZError as error:
            self._dropped += 1
            self._node.logger.debug("%s: %s", self.topic, error)
            return False
        return True


class ZenohClient(Queued, BaseClient, Sender):
    """A service that is called; see :class:`rosplc.ros.backend.ServiceClient`."""

    _take = BaseClient.end

    def _declare(self, session: Any) -> list[Any]:
        querier = session.declare_querier(
            self._key,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_TIMEOUT_OF_RESULT if self.type_name.endswith("_GetResult") else _TIMEOUT,
        )
        with self._lock:
            self._route, self._gid = querier, gid_of(self.entity.token)
        return [querier]

    def _receivers(self) -> list[str]:
        return [self._key] if self.matched else []

    def _send(self, number: int, payload: bytes) -> Reply | None:
        errors: list[str] = []
        receive = zenoh.handlers.Callback(
            partial(self.arrived, number, errors), partial(self.finished, number, errors), indirect=False
        )
        try:
            attachment = pack(number, self._clock.time_ns(), self._gid)
            with self._asking:  # the reply may close this client before the library has returned
                self._route.get(receive, payload=payload, attachment=attachment)
        except (zenoh.ZError, AttributeError):  # withdrawn at this moment
            return NO_SERVER
        return None

    def arrived(self, number: int, errors: list[str], reply: Any) -> None:
        """Queue a response; called by threads of the library, so no exception may escape."""
        try:
            if reply.err is not None:
                errors.append(reply.err.payload.to_bytes()[:300].decode(errors="replace"))
                return
            payload, attachment = read(reply.ok.payload, reply.ok.attachment)
        except Exception as error:
            self.reject(error)
            return
        if (attachment.sequence, attachment.gid) == (number, self._gid):
            self._end_soon(number, Reply(payload))
        else:
            self.reject("the sequence number or client ID does not match the request")

    def finished(self, number: int, errors: list[str]) -> None:
        """Note that there are no more responses; called by threads of the library."""
        if not errors:
            self._end_soon(number, SERVER_GONE)
            return
        late = errors[0] == "Timeout"
        reason = Reason.TIME_OUT if late else Reason.SERVER_FAILED
        self._end_soon(number, Reply(reason=reason, text=errors[0]))

    def _end_soon(self, number: int, reply: Reply) -> None:
        with self._lock:
            if self.closed or (reply.payload is None and number not in self.calls):
                return
            self._put(number, reply)
        self._node.wake(self)
