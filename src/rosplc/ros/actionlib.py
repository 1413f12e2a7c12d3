"""Actions of ROS 1 over any backend: the five topics of actionlib, http://wiki.ros.org/actionlib.

actionlib identifies a goal by a text, this module by 16 bytes. The client writes these as 32 hexadecimal
digits. The server reads such digits, uses a text of up to 16 bytes as it is, and hashes a longer text, which
is usual; it stores the text with the goal. A server in another process that adopts the goal needs the text,
too: see :meth:`ActionServer.note`.

A result is published once. Clients that connect later, such as after a server's restart, get the last one.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import struct
from collections import OrderedDict
from collections.abc import Mapping
from functools import partial
from typing import Any

from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.reasons import Reason
from rosplc.ros import actions, fields
from rosplc.ros._base import NO_SERVER
from rosplc.ros.actions import ActionClient, ActionServer, Goal
from rosplc.ros.backend import Backend, Publisher, Qos, Reply
from rosplc.ros.goals import GoalInfo, GoalStatus

LONGEST_ID = 1024  # bytes of a goal's text
_PATIENCE_NS = 10_000_000_000  # for a goal that the server does not list, or a result that does not come
_QOS = Qos(depth=100)
_UNLISTED = Reply(reason=Reason.SERVER_GONE, text="the goal is not in the server's status list")
_LIST, _ID = "actionlib_msgs/msg/GoalStatusArray", "actionlib_msgs/msg/GoalID"
_HEX = re.compile(rb"[0-9a-f]{32}\Z")

# actionlib_msgs/GoalStatus
_PENDING, _ACTIVE, _PREEMPTED, _SUCCEEDED, _ABORTED, _REJECTED, _PREEMPTING, _RECALLING, _RECALLED = range(9)
_NUMBERS = (_PENDING, _ACTIVE, _ACTIVE, _PREEMPTING, _SUCCEEDED, _PREEMPTED, _ABORTED)  # by GoalStatus
_STATUSES = {number: GoalStatus(status) for status, number in enumerate(_NUMBERS)}
# Those that a goal has one after the other until it ends; not listed comes first.
_OPEN = (-1, _PENDING, _RECALLING, _ACTIVE, _PREEMPTING)


def _rank(number: int) -> int:
    return _OPEN.index(number) if number in _OPEN else len(_OPEN)


def uuid_of(text: bytes) -> bytes:
    """Return the 16 bytes of a goal's text."""
    if _HEX.match(text):
        return bytes.fromhex(text.decode())
    return text.ljust(16, b"\0") if len(text) <= 16 else hashlib.blake2b(text, digest_size=16).digest()


def text_of(uuid: bytes) -> bytes:
    """Return the text of a goal, as far as it can be derived from the 16 bytes."""
    text = uuid.rstrip(b"\0")
    return text if text.isascii() and text.decode().isprintable() else uuid.hex().encode()


def _text(text: bytes) -> bytes:
    return len(text).to_bytes(4, "little") + text


def _goal_id(text: bytes, stamp_ns: int = 0) -> bytes:
    return struct.pack("<2I", *divmod(stamp_ns, 10**9)) + _text(text)


def _header(now_ns: int) -> bytes:
    return struct.pack("<4I", 0, *divmod(now_ns, 10**9), 0)


def _topic(action: str, type_name: str, name: str, kind: str) -> tuple[str, str]:
    """Return the name and type of a topic; the action's own types have its type name as a prefix."""
    own = type_name.replace("/action/", "/msg/")
    return f"{action}/{name}", kind if "/" in kind else own + kind


def _read_id(goal_id: Mapping[str, Any]) -> GoalInfo:
    """Return a goal's text, and its stamp; ROS008 if the text is too long."""
    text, stamp = goal_id["id"].encode(errors="surrogateescape"), goal_id["stamp"]
    if len(text) > LONGEST_ID:
        raise BackendError("ROS008", f"a goal ID has {len(text)} bytes; the limit is {LONGEST_ID}")
    return text, stamp["sec"] % 2**32 * 10**9 + stamp["nanosec"]


def _read_status(status: Mapping[str, Any]) -> tuple[bytes, int, str]:
    """Return a goal's UUID, its status, and the server's text about it."""
    words = status["text"][:LONGEST_ID].encode(errors="surrogateescape").decode(errors="replace")
    return uuid_of(_read_id(status["goal_id"])[0]), status["status"], words


class ActionlibServer(ActionServer):
    """An action for actionlib clients; see :class:`rosplc.ros.actions.ActionServer`.

    ``on_cancel`` is also called for undecided goals: if such a goal is rejected, it counts as recalled; if it
    is accepted, ``on_cancel`` is called again. actionlib has no answer for a rejected cancel request.
    No status is published before the first :meth:`tick` or goal, so that no adopted goal is missing.
    """

    def _open(self, backend: Backend, store: TypeStore) -> None:
        self._store = store
        self._default = fields.pack(store, f"{self.type_name}_Result", {})
        self._canceled_ns = 0  # goals up to this stamp are canceled
        # Goals that were not accepted, or canceled before they came: number and message of the status, since.
        self._over: OrderedDict[bytes, tuple[int, bytes, int]] = OrderedDict()
        keep, topic, latched = self._keep, partial(_topic, self.action, self.type_name), actions.STATUS_QOS
        self._feedback: Publisher = keep(backend.advertise(*topic("feedback", "ActionFeedback"), _QOS))
        self._statuses: Publisher = keep(backend.advertise(*topic("status", _LIST), latched))
        self._result: Publisher = keep(backend.advertise(*topic("result", "ActionResult"), latched))
        keep(backend.subscribe(*topic("cancel", _ID), _QOS, self._on_cancels))
        keep(backend.subscribe(*topic("goal", "ActionGoal"), _QOS, self._on_send))

    def _on_send(self, payload: bytes, *_others: Any) -> None:
        try:
            _, type_name = _topic(self.action, self.type_name, "goal", "ActionGoal")
            head, body = fields.unpack_first(self._store, type_name, payload, 2)
            text, stamp_ns = _read_id(head["goal_id"])
        except BackendError:
            self.refused[Reason.REJECTED] += 1
            raise
        text, stamp_ns = text or os.urandom(16).hex().encode(), stamp_ns or self._clock.time_ns()
        uuid = uuid_of(text)
        with self._lock:
            over = self._over.get(uuid)
            if uuid in self._goals or (over and over[0] != _RECALLING):
                return  # as actionlib: it has come before
            self._make_room()
            goal = self._goals[uuid] = Goal(text, stamp_ns)
            if over or stamp_ns <= self._canceled_ns:
                goal.cancels.append(actions.Cancel(b"", {uuid}))
            full = len(self._goals) > actions.MOST_GOALS
            if goal.cancels or full:
                self.refused[Reason.QUEUE_FULL if full else Reason.CALLER_GONE] += 1
                self.reject(uuid)
                return
            self._publish()
        self._on_goal(uuid, body)

    def _on_cancels(self, payload: bytes, *_others: Any) -> None:
        text, stamp_ns = _read_id(fields.unpack(self._store, _ID, payload))
        uuid, asked = uuid_of(text), []
        with self._lock:
            self._canceled_ns = max(self._canceled_ns, min(stamp_ns, self._clock.time_ns()))
            if text and uuid in self._goals:
                self._goals[uuid].caller = text
            elif text and uuid not in self._over:
                self._keep_over(uuid, Goal(text, stamp_ns), _RECALLING)
            for one, goal in self._goals.items():
                meant = (one == uuid if text else not stamp_ns) or 0 < goal.stamp_ns <= stamp_ns
                if meant and goal.status < GoalStatus.CANCELING and not goal.cancels:
                    goal.cancels.append(actions.Cancel(b"", {one}))
                    asked.append(one)
        for one in asked:
            self._on_cancel(one)

    def _keep_over(self, uuid: bytes, goal: Goal, number: int) -> None:
        self._over[uuid] = number, self._status(uuid, goal, number), self._clock.monotonic_ns()
        if len(self._over) > actions.MOST_GOALS:
            self._over.popitem(last=False)
        self._publish()

    def _write(self, publisher: Publisher, body: bytes) -> None:
        with contextlib.suppress(BackendError):  # closed, or the middleware refuses: nobody can be told
            publisher.write(_header(self._clock.time_ns()) + body)

    def _status(self, uuid: bytes, goal: Goal, number: int | None = None) -> bytes:
        number = _NUMBERS[goal.status] if number is None else number
        return _goal_id(goal.caller or text_of(uuid), goal.stamp_ns) + bytes([number]) + _text(b"")

    def _publish(self) -> None:
        listed = [self._status(uuid, goal) for uuid, goal in self._goals.items()]
        listed += [status for _, status, _ in self._over.values()]
        self._write(self._statuses, len(listed).to_bytes(4, "little") + b"".join(listed))

    def _decided(self, uuid: bytes, goal: Goal, accepted: bool) -> None:
        if not accepted:
            number = _RECALLED if goal.cancels else _REJECTED
            self._write(self._result, self._status(uuid, goal, number) + self._default)
            self._keep_over(uuid, goal, number)

    def _ended(self, uuid: bytes, goal: Goal, status: GoalStatus, result: bytes | None) -> None:
        body = self._default if result is None else result
        self._write(self._result, self._status(uuid, goal, _NUMBERS[status]) + body)

    def _settle(self, uuid: bytes, goal: Goal, *, agreed: bool) -> None:
        goal.cancels.clear()

    def _feed(self, uuid: bytes, goal: Goal, payload: bytes) -> bytes:
        return _header(self._clock.time_ns()) + self._status(uuid, goal) + payload

    def note(self, uuid: bytes) -> bytes:
        """Return the goal's text."""
        goal = self._goals.get(uuid)
        return b"" if goal is None else goal.caller

    def _noted(self, note: bytes, stamp_ns: int, status: GoalStatus = GoalStatus.EXECUTING) -> Goal:
        return Goal(note, stamp_ns, status)

    def accept(self, uuid: bytes) -> bool:
        """Accept a goal; see :meth:`rosplc.ros.actions.ActionServer.accept`."""
        accepted = super().accept(uuid)
        if accepted and self._goals[uuid].cancels:
            self._on_cancel(uuid)
        return accepted

    def present(self, uuid: bytes) -> bool:
        """Return whether a goal waits for a decision: nothing is known about its client."""
        return self._undecided(uuid) is not None

    def tick(self) -> None:
        """Forget goals that ended long ago, and publish the statuses, which clients wait for."""
        super().tick()
        with self._lock:
            before = self._clock.monotonic_ns() - self._keep_ns
            for one in [one for one, (*_, since) in self._over.items() if since <= before]:
                del self._over[one]
            self._publish()


class ActionlibClient(ActionClient):
    """A client of an actionlib action; see :class:`rosplc.ros.actions.ActionClient`.

    A recalled goal counts as rejected. The events ``not canceled`` and ``lost`` do not exist: a goal that the
    server no longer lists gets the result UNKNOWN; if a result was missed, it has the status but no payload.
    """

    def _open(self, backend: Backend, store: TypeStore) -> None:
        self._store = store
        keep, topic = self._keep, partial(_topic, self.action, self.type_name)
        for kind, name in (("feedback", "ActionFeedback"), ("result", "ActionResult")):
            keep(backend.subscribe(*topic(kind, name), _QOS, partial(self._on_news, kind)))
        keep(backend.subscribe(*topic("status", _LIST), _QOS, self._on_statuses))
        self._cancel: Publisher = keep(backend.advertise(*topic("cancel", _ID), _QOS))
        self._goal: Publisher = keep(backend.advertise(*topic("goal", "ActionGoal"), _QOS))

    @property
    def ready(self) -> bool:
        """Whether all topics of a server are connected."""
        return all(endpoint.matched for endpoint in self._endpoints)

    def _dispatch(self, uuid: bytes, goal: bytes) -> None:
        if self.ready:
            goal_id = _goal_id(uuid.hex().encode(), self._clock.time_ns())
            self._goal.write(_header(self._clock.time_ns()) + goal_id + goal)
        else:
            self._tell(uuid, "failed", reply=NO_SERVER, last=True)

    def _seek(self, uuid: bytes) -> None:
        """Wait for the next status list: there is no request for a status."""

    def cancel(self, uuid: bytes) -> None:
        """Request that a goal be canceled."""
        if uuid in self._goals:
            self._cancel.write(_goal_id(uuid.hex().encode()))

    # -- what comes

    def _learn(self, uuid: bytes, number: int, words: str) -> None:
        """Process the server's status of a goal; messages of different topics arrive in any order."""
        with self._lock:
            sent = self._goals.get(uuid)
            if sent is None or number > _RECALLED or _rank(number) <= _rank(sent.number):
                return
            sent.number = number
            if _rank(number) == len(_OPEN):
                sent.since_ns = self._clock.monotonic_ns()
            begins = number in _STATUSES and number != _PENDING and not sent.accepted
            sent.accepted |= begins
        if begins and not sent.adopted:
            self._tell(uuid, "accepted")
        if number in (_REJECTED, _RECALLED) and not sent.accepted:
            self._tell(uuid, "rejected", reply=Reply(None, "not executed", Reason.REJECTED, words), last=True)
        elif number in (_PREEMPTING, _RECALLING):
            self._tell(uuid, "canceling")
        if sent.accepted:
            self._on_status(uuid, _STATUSES.get(number, GoalStatus.UNKNOWN))

    def _on_statuses(self, payload: bytes, _stamp_ns: int) -> None:
        found = fields.unpack(self._store, _LIST, payload)["status_list"]
        listed = {status[0]: status for status in map(_read_status, found)}
        for uuid in listed.keys() & self._goals.keys():
            self._learn(*listed[uuid])
        now = self._clock.monotonic_ns()
        for uuid, sent in tuple(self._goals.items()):
            waits = _rank(sent.number) in (0, len(_OPEN))
            gone = now - sent.since_ns > _PATIENCE_NS if waits else uuid not in listed
            if gone and (sent.adopted or sent.number >= 0):
                status = _STATUSES.get(sent.number if waits else -1, GoalStatus.UNKNOWN)
                self._tell(uuid, "result", status=status, last=True)
            elif gone:
                self._tell(uuid, "failed", reply=_UNLISTED, last=True)

    def _on_news(self, kind: str, payload: bytes, _stamp_ns: int) -> None:
        last = kind == "result"
        _, type_name = _topic(self.action, self.type_name, kind, f"Action{kind.title()}")
        head, body = fields.unpack_first(self._store, type_name, payload, 2)
        uuid, number, words = _read_status(head["status"])
        self._learn(uuid, number, words)
        status = _STATUSES.get(number, GoalStatus.UNKNOWN) if last else GoalStatus.UNKNOWN
        self._tell(uuid, kind, payload=body, status=status, last=last)
