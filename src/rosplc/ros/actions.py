"""Servers and clients of ROS 2 actions over any backend; an action is three services and two topics.

rclpy has its own action server, but that can neither answer for goals that another process has accepted
nor leave the decision on a goal open; no other backend has one. Here, a goal is identified by its UUID alone,
so any process that has the UUID can adopt the goal.

Threads: every method may be called from any thread. The receivers are called from the backend's threads; they
must not block, and may call any method. Nothing here has its own thread: see :meth:`ActionServer.tick`.
"""

from __future__ import annotations

import contextlib
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Literal

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.reasons import Reason
from rosplc.ros import backend as side
from rosplc.ros.goals import (
    CANCELS,
    LITTLE,
    STATUSES,
    STEPS,
    CancelCode,
    GoalInfo,
    GoalStatus,
    GoalStep,
    Messages,
    unwrap,
    wrap,
)

MOST_GOALS = 256  # goals of one server, those whose results are kept included
_MOST_STATUSES = 1000  # goals of other clients that a client remembers
MOST_WAITING = 64  # requests for the result of one goal
KEEP_RESULT_NS = 10_000_000_000

STATUS_QOS = side.Qos(durability="transient_local", depth=1)
_ALL = bytes(16)


@dataclass(slots=True)
class Cancel:
    """A request to cancel: the goals without a decision, and those that are being canceled."""

    caller: bytes
    undecided: set[bytes]
    canceling: list[GoalInfo] = field(default_factory=list)


@dataclass(slots=True)
class Goal:
    """A goal of the server; UNKNOWN until it is accepted."""

    caller: bytes
    stamp_ns: int = 0
    status: GoalStatus = GoalStatus.UNKNOWN
    result: bytes | None = None
    ended_ns: int = 0
    waiting: list[bytes] = field(default_factory=list)
    cancels: list[Cancel] = field(default_factory=list)


class _Action:
    """An action's endpoints, all of them or none."""

    def __init__(self, backend: side.Backend, store: TypeStore, action: str, type_name: str) -> None:
        self.action, self.type_name = action, type_name
        self._lock = threading.RLock()
        self._endpoints: list[Any] = []
        with self._lock:  # a request may come at once
            try:
                self._open(backend, store)
            except BaseException:
                self.close()
                raise

    def _open(self, backend: side.Backend, store: TypeStore) -> None:
        raise NotImplementedError

    def _keep(self, endpoint: Any) -> Any:
        self._endpoints.append(endpoint)
        return endpoint

    def _place(self, name: str, kind: str) -> tuple[str, str]:
        """Return the name and type of a topic or service; ``kind`` is a full type name or a part."""
        return f"{self.action}/_action/{name}", kind if "/" in kind else f"{self.type_name}_{kind}"

    def endpoints(self) -> tuple[side.EndpointStatus, ...]:
        """Return the state of the five topics and services."""
        return tuple(endpoint.status() for endpoint in self._endpoints)

    def close(self) -> None:
        """Leave the graph; no goal is ended, and clients that wait for a decision or a result get none."""
        for endpoint in reversed(self._endpoints):
            endpoint.close()


class ActionServer(_Action):
    """An action for ROS clients. Methods return False, and do nothing, if a step is not possible.

    Args:
        backend: A backend for the ROS version of the types.
        store: The source of the types.
        action: The action's name.
        type_name: ``package/action/Name``.
        on_goal: Called with a UUID and goal: decide with :meth:`accept` or :meth:`reject`.
        on_cancel: Called with the UUID of a goal that a client wants to cancel: decide with
            :meth:`accept_cancel` or :meth:`reject_cancel`.
        keep_result_ns: How long a goal and its result are kept after its end.
        executing: Goals that another process has accepted, each with the time (ns since 1970) and its
            :meth:`note`: they are adopted before the first request arrives.
        clock: For tests.

    Attributes:
        refused: Number of goals that were not passed to ``on_goal``, by reason: there were too many, or they
            were canceled before they arrived, or they cannot be read.

    Raises:
        BackendError, MessageTypeError: As :meth:`rosplc.ros.backend.Backend.serve`.
    """

    def __init__(
        self,
        backend: side.Backend,
        store: TypeStore,
        action: str,
        type_name: str,
        *,
        on_goal: Callable[[bytes, bytes], object],
        on_cancel: Callable[[bytes], object],
        keep_result_ns: int = KEEP_RESULT_NS,
        executing: Iterable[tuple[bytes, int, bytes]] = (),
        clock: Clock = SYSTEM,
    ) -> None:
        self._on_goal, self._on_cancel = on_goal, on_cancel
        self._keep_ns, self._clock = keep_result_ns, clock
        self._goals = {uuid: self._noted(note, stamp_ns) for uuid, stamp_ns, note in executing}
        self.refused: Counter[Reason] = Counter()
        super().__init__(backend, store, action, type_name)

    def _open(self, backend: side.Backend, store: TypeStore) -> None:
        self._messages = Messages(store, self.type_name)
        keep, place = self._keep, self._place
        self._feedback: side.Publisher = keep(
            backend.advertise(*place("feedback", "FeedbackMessage"), side.Qos())
        )
        self._statuses: side.Publisher = keep(backend.advertise(*place("status", STATUSES), STATUS_QOS))

        def serve(name: str, kind: str, take: side.OnRequest) -> side.ServiceServer:
            server: side.ServiceServer = keep(backend.serve(*place(name, kind), side.SERVICES, take))
            return server

        self._get = serve("get_result", "GetResult", self._on_get)
        self._cancel = serve("cancel_goal", CANCELS, self._on_cancels)
        self._send = serve("send_goal", "SendGoal", self._on_send)
        self._publish()

    # -- requests of clients

    def _on_send(self, payload: bytes, caller: bytes, _stamp_ns: int) -> None:
        with self._lock:
            try:
                uuid, goal = unwrap(payload)
            except BackendError as error:
                self.refused[Reason.REJECTED] += 1
                self._send.refuse(caller, str(error))
                return
            self._make_room()
            new = uuid not in self._goals and len(self._goals) < MOST_GOALS
            if new:
                self._goals[uuid] = Goal(caller)
            else:  # as rclpy and rclcpp answer a goal that they have
                self.refused[Reason.QUEUE_FULL] += uuid not in self._goals
                self._answer(self._send, caller, self._messages.pack_accepted(False, 0))
        if new:
            self._on_goal(uuid, goal)

    def _make_room(self) -> None:
        """Forget the oldest ended goal if there are too many goals."""
        if len(self._goals) >= MOST_GOALS:
            ended = (one for one, goal in self._goals.items() if goal.status.ended)
            self._goals.pop(next(ended, b""), None)

    def _on_get(self, payload: bytes, caller: bytes, _stamp_ns: int) -> None:
        with self._lock:
            try:
                goal = self._known(unwrap(payload)[0])
            except BackendError as error:
                self._get.refuse(caller, str(error))
                return
            if goal is not None and not goal.status.ended:
                goal.waiting.append(caller)
                if len(goal.waiting) > MOST_WAITING:
                    self._get.refuse(goal.waiting.pop(0), "too many clients are waiting for this result")
                return
            status, result = (GoalStatus.UNKNOWN, None) if goal is None else (goal.status, goal.result)
            self._answer(self._get, caller, self._messages.pack_result(status, result))

    def _on_cancels(self, payload: bytes, caller: bytes, _stamp_ns: int) -> None:
        asked = []
        with self._lock:
            try:
                uuid, stamp_ns = self._messages.read_cancel(payload)
            except BackendError as error:
                self._cancel.refuse(caller, str(error))
                return
            code, wanted = self._chosen(uuid, stamp_ns)
            if not wanted:
                self._answer(self._cancel, caller, self._messages.pack_canceling(code, []))
            request = Cancel(caller, set(wanted))
            for one in wanted:
                goal = self._goals[one]
                goal.cancels.append(request)
                if len(goal.cancels) == 1:
                    asked.append(one)
                elif len(goal.cancels) > MOST_WAITING:
                    self._decide(one, goal.cancels.pop(0), False)
        for one in asked:
            self._on_cancel(one)

    def _chosen(self, uuid: bytes, stamp_ns: int) -> tuple[CancelCode, list[bytes]]:
        """Return the goals that a cancel request concerns, as rcl_action_process_cancel_request does."""
        if uuid != _ALL and not stamp_ns:
            if (goal := self._known(uuid)) is None:
                return CancelCode.UNKNOWN_GOAL_ID, []
            possible = (goal.status, GoalStep.CANCEL) in STEPS
            return (CancelCode.NONE, [uuid]) if possible else (CancelCode.GOAL_TERMINATED, [])
        return CancelCode.NONE, [
            one
            for one, goal in self._goals.items()
            if (goal.status, GoalStep.CANCEL) in STEPS
            and (one == uuid or not stamp_ns or goal.stamp_ns <= stamp_ns)
        ]

    def _known(self, uuid: bytes) -> Goal | None:
        goal = self._goals.get(uuid)
        return goal if goal is not None and goal.status is not GoalStatus.UNKNOWN else None

    def _undecided(self, uuid: bytes) -> Goal | None:
        goal = self._goals.get(uuid)
        return goal if goal is not None and goal.status is GoalStatus.UNKNOWN else None

    def _answer(self, server: side.ServiceServer, caller: bytes, payload: bytes) -> None:
        with contextlib.suppress(BackendError):  # closed, or the middleware refuses: nobody can be told
            server.reply(caller, payload)

    def _publish(self) -> None:
        goals = ((one, goal.stamp_ns, goal.status) for one, goal in self._goals.items() if goal.status)
        with contextlib.suppress(BackendError):
            self._statuses.write(self._messages.pack_statuses(goals))

    def _decided(self, uuid: bytes, goal: Goal, accepted: bool) -> None:
        """Tell a goal's client whether the goal is accepted."""
        goal.stamp_ns = self._clock.time_ns() if accepted else 0
        self._answer(self._send, goal.caller, self._messages.pack_accepted(accepted, goal.stamp_ns))

    def _ended(self, uuid: bytes, goal: Goal, status: GoalStatus, result: bytes | None) -> None:
        """Send the result to the clients that wait for it; ROS008 if the bytes are not a result."""
        response = self._messages.pack_result(status, result)
        for caller in goal.waiting:
            self._answer(self._get, caller, response)
        goal.waiting.clear()

    def _feed(self, uuid: bytes, goal: Goal, payload: bytes) -> bytes:
        """Return the message that carries feedback."""
        return wrap(uuid, payload)

    # -- decisions

    def accept(self, uuid: bytes) -> bool:
        """Accept a goal; it is executed once :meth:`execute` is called."""
        with self._lock:
            if (goal := self._undecided(uuid)) is None:
                return False
            goal.status = GoalStatus.ACCEPTED
            self._decided(uuid, goal, True)
            self._publish()
            return True

    def reject(self, uuid: bytes) -> bool:
        """Reject a goal."""
        with self._lock:
            if (goal := self._undecided(uuid)) is None:
                return False
            del self._goals[uuid]
            self._decided(uuid, goal, False)
            return True

    def present(self, uuid: bytes) -> bool:
        """Return whether the client of a goal that has not been decided still waits."""
        with self._lock:
            goal = self._undecided(uuid)
            return goal is not None and self._send.present(goal.caller)

    def note(self, uuid: bytes) -> bytes:
        """Return the further data that another process needs to adopt a goal, at most 1024 bytes."""
        with self._lock:
            goal = self._goals.get(uuid)
            return b"" if goal is None else b"".join(goal.waiting)

    def _noted(self, note: bytes, stamp_ns: int, status: GoalStatus = GoalStatus.EXECUTING) -> Goal:
        """Return the goal described by another process's note."""
        waiting = [note[at : at + 16] for at in range(0, len(note) - 15, 16)]
        return Goal(b"", stamp_ns, status, waiting=waiting)

    def adopt(self, uuid: bytes, stamp_ns: int, status: GoalStatus, note: bytes = b"") -> bool:
        """Adopt a goal that another process accepted at the given time and has not ended."""
        with self._lock:
            if uuid in self._goals or status is GoalStatus.UNKNOWN or status.ended:
                return False
            self._goals[uuid] = self._noted(note, stamp_ns, status)
            self._publish()
            return True

    def status(self, uuid: bytes) -> GoalStatus:
        """Return the state of a goal; UNKNOWN before it is accepted and after it is forgotten."""
        goal = self._goals.get(uuid)
        return GoalStatus.UNKNOWN if goal is None else goal.status

    def execute(self, uuid: bytes) -> bool:
        """Start to execute an accepted goal."""
        return self._step(uuid, GoalStep.EXECUTE)

    def feedback(self, uuid: bytes, payload: bytes) -> bool:
        """Publish feedback of an executing goal; also returns False if the middleware refuses it."""
        with self._lock, contextlib.suppress(BackendError):
            goal = self._known(uuid)
            if goal is not None and not goal.status.ended:
                return self._feedback.write(self._feed(uuid, goal, payload))
        return False

    def accept_cancel(self, uuid: bytes, *, asked: bool = False) -> bool:
        """Agree to cancel a goal: its state is canceling until it ends in one of three ways.

        ``asked``: the request was sent to the process from which the goal was adopted.
        """
        with self._lock:
            goal = self._known(uuid)
            return goal is not None and (asked or bool(goal.cancels)) and self._step(uuid, GoalStep.CANCEL)

    def reject_cancel(self, uuid: bytes) -> bool:
        """Refuse to cancel a goal, and continue it."""
        with self._lock:
            goal = self._known(uuid)
            if goal is None or not goal.cancels:
                return False
            self._settle(uuid, goal, agreed=False)
            return True

    def succeed(self, uuid: bytes, result: bytes) -> bool:
        """End a goal successfully; raises ROS008 if the bytes are not a result."""
        return self._step(uuid, GoalStep.SUCCEED, result)

    def abort(self, uuid: bytes, result: bytes | None = None) -> bool:
        """Abort a goal; ``result`` None: the default result. Raises as :meth:`succeed`."""
        return self._step(uuid, GoalStep.ABORT, result)

    def canceled(self, uuid: bytes, result: bytes | None = None) -> bool:
        """End a canceling goal as canceled; otherwise as :meth:`abort`."""
        return self._step(uuid, GoalStep.CANCELED, result)

    def _step(self, uuid: bytes, step: GoalStep, result: bytes | None = None) -> bool:
        with self._lock:
            goal = self._known(uuid)
            status = STEPS.get((goal.status, step)) if goal is not None else None
            if goal is None or status is None:
                return False
            if status.ended:
                self._ended(uuid, goal, status, result)
                goal.result, goal.ended_ns = result, self._clock.monotonic_ns()
            goal.status = status
            if status.ended or step is GoalStep.CANCEL:
                self._settle(uuid, goal, agreed=step is GoalStep.CANCEL)
            self._publish()
            return True

    def _settle(self, uuid: bytes, goal: Goal, *, agreed: bool) -> None:
        """Answer the clients that asked for a goal to be canceled."""
        requests, goal.cancels = goal.cancels, []
        for request in requests:
            self._decide(uuid, request, agreed)

    def _decide(self, uuid: bytes, request: Cancel, agreed: bool) -> None:
        request.undecided.discard(uuid)
        if agreed:
            request.canceling.append((uuid, self._goals[uuid].stamp_ns))
        if not request.undecided:
            code = CancelCode.NONE if request.canceling else CancelCode.REJECTED
            self._answer(self._cancel, request.caller, self._messages.pack_canceling(code, request.canceling))

    # -- the rest

    def tick(self) -> None:
        """Forget goals that ended long ago; call this from time to time."""
        with self._lock:
            before = self._clock.monotonic_ns() - self._keep_ns
            old = [one for one, goal in self._goals.items() if goal.status.ended and goal.ended_ns <= before]
            for one in old:
                del self._goals[one]
            if old:
                self._publish()


@dataclass(frozen=True, slots=True)
class GoalEvent:
    """An event of a goal that was sent."""

    uuid: bytes  # the goal
    # ``accepted``, or ``rejected`` and forgotten; ``failed``: nothing is known of the acceptance;
    # ``feedback``; ``status``: it has changed; ``canceling`` or ``not canceled``: the answer to
    # :meth:`ActionClient.cancel`; ``result``: it has ended, and is forgotten; ``lost``: the server
    # gives no result, and :meth:`ActionClient.adopt` asks again
    kind: Literal[
        "accepted", "rejected", "failed", "feedback", "status", "canceling", "not canceled", "result", "lost"
    ]
    payload: bytes | None = None  # feedback or result
    # with ``status`` and ``result``; UNKNOWN if the server does not know the goal (any more)
    status: GoalStatus = GoalStatus.UNKNOWN
    # with ``failed``, ``not canceled`` and ``lost``: how the call ended that has no response
    reply: side.Reply | None = None


@dataclass(slots=True)
class Sent:
    """A client's goal, its open calls, and its state in status lists (actionlib)."""

    since_ns: int  # when it was sent or adopted, or ended without a result
    adopted: bool = False
    accepted: bool = False
    number: int = -1  # its status, once it was listed
    status: GoalStatus = GoalStatus.UNKNOWN
    calls: set[tuple[int, int]] = field(default_factory=set)  # which service, and the call's number


class ActionClient(_Action):
    """A client of a ROS action.

    Args:
        backend, store, action, type_name: As of :class:`ActionServer`.
        on_event: Called with the events of the goals. A status may arrive before the acceptance.
        clock: For tests.

    Raises:
        BackendError, MessageTypeError: As :meth:`rosplc.ros.backend.Backend.client`.
    """

    def __init__(
        self,
        backend: side.Backend,
        store: TypeStore,
        action: str,
        type_name: str,
        on_event: Callable[[GoalEvent], object],
        *,
        clock: Clock = SYSTEM,
    ) -> None:
        self._on_event, self._clock = on_event, clock
        self._goals: dict[bytes, Sent] = {}
        self._statuses: dict[bytes, GoalStatus] = {}  # as the server last published them
        super().__init__(backend, store, action, type_name)

    def _open(self, backend: side.Backend, store: TypeStore) -> None:
        self._messages = Messages(store, self.type_name)
        keep, place = self._keep, self._place
        keep(backend.subscribe(*place("feedback", "FeedbackMessage"), side.Qos(), self._on_feedback))
        keep(backend.subscribe(*place("status", STATUSES), STATUS_QOS, self._on_statuses))
        self._services: list[side.ServiceClient] = [
            keep(backend.client(*place(*each), side.SERVICES))
            for each in (("send_goal", "SendGoal"), ("cancel_goal", CANCELS), ("get_result", "GetResult"))
        ]

    @property
    def ready(self) -> bool:
        """Whether all services of a server are known."""
        return all(service.ready for service in self._services)

    def send(self, uuid: bytes, goal: bytes) -> bool:
        """Send a goal; False if a goal with this UUID is already known. Raises as ServiceClient.call."""
        with self._lock:
            if uuid in self._goals:
                return False
            self._goals[uuid] = Sent(self._clock.monotonic_ns())
        try:
            self._dispatch(uuid, goal)
        except BaseException:
            self.forget(uuid)
            raise
        return True

    def _dispatch(self, uuid: bytes, goal: bytes) -> None:
        self._call(_SEND, uuid, wrap(uuid, goal), self._messages.read_accepted, self._on_decision)

    def adopt(self, uuid: bytes) -> None:
        """Request the status and result of a goal that this or another process sent earlier."""
        with self._lock:
            self._goals.setdefault(uuid, Sent(self._clock.monotonic_ns(), adopted=True))
            status = self._statuses.get(uuid)
        if status is not None:
            self._on_status(uuid, status)
        self._seek(uuid)

    def _seek(self, uuid: bytes) -> None:
        self._call(_GET, uuid, LITTLE + uuid, self._messages.read_result, self._on_result)

    def cancel(self, uuid: bytes) -> None:
        """Request that a goal be canceled; raises as ServiceClient.call."""
        request, read = self._messages.pack_cancel(uuid), self._messages.read_canceling
        self._call(_CANCEL, uuid, request, read, self._on_canceling)

    def forget(self, uuid: bytes) -> None:
        """Stop following a goal, without informing the server."""
        with self._lock:
            sent = self._goals.pop(uuid, None)
        if sent is not None:
            for service, number in sent.calls:
                self._services[service].forget(number)

    def _call(
        self,
        service: int,
        uuid: bytes,
        payload: bytes,
        read: Callable[[bytes], Any],
        take: Callable[[bytes, Any, side.Reply], None],
    ) -> None:
        """Call a service for a goal; ``take`` gets the result of ``read``, or None without a response."""

        def ended(reply: side.Reply) -> None:
            found = None
            try:
                if reply.payload is not None:
                    found = read(reply.payload)
            except BackendError as error:
                reply = side.Reply(text=str(error))
            take(uuid, found, reply)

        with self._lock:
            if uuid not in self._goals:
                return
        number = self._services[service].call(payload, ended)
        with self._lock:
            sent = self._goals.get(uuid)
            if sent is not None:
                sent.calls.add((service, number))
        if sent is None:  # it has ended, or was forgotten meanwhile
            self._services[service].forget(number)

    # -- what comes

    def _on_decision(self, uuid: bytes, accepted: bool | None, reply: side.Reply) -> None:
        if accepted:
            self._tell(uuid, "accepted")
            with contextlib.suppress(BackendError):  # closed meanwhile
                self._seek(uuid)
        elif accepted is None:
            self._tell(uuid, "failed", reply=reply, last=True)
        else:
            self._tell(uuid, "rejected", last=True)

    def _on_result(self, uuid: bytes, found: tuple[int, bytes] | None, reply: side.Reply) -> None:
        if found is None:
            self._tell(uuid, "lost", reply=reply)
        else:
            self._tell(uuid, "result", payload=found[1], status=_status(found[0]), last=True)

    def _on_canceling(self, uuid: bytes, found: tuple[int, list[GoalInfo]] | None, reply: side.Reply) -> None:
        agreed = found is not None and any(one == uuid for one, _ in found[1])
        self._tell(uuid, "canceling" if agreed else "not canceled", reply=reply)

    def _on_feedback(self, payload: bytes, _stamp_ns: int) -> None:
        uuid, feedback = unwrap(payload)
        self._tell(uuid, "feedback", payload=feedback)

    def _on_statuses(self, payload: bytes, _stamp_ns: int) -> None:
        newest = self._messages.read_statuses(payload)[-_MOST_STATUSES:]
        self._statuses = {uuid: _status(number) for uuid, _, number in newest}
        for uuid, status in self._statuses.items():
            self._on_status(uuid, status)

    def _on_status(self, uuid: bytes, status: GoalStatus) -> None:
        with self._lock:
            sent = self._goals.get(uuid)
            if sent is None or sent.status is status:
                return
            sent.status = status
        self._tell(uuid, "status", status=status)

    def _tell(self, uuid: bytes, kind: Any, *, last: bool = False, **more: Any) -> None:
        with self._lock:
            known = self._goals.pop(uuid, None) if last else self._goals.get(uuid)
        if known is not None:
            self._on_event(GoalEvent(uuid, kind, **more))


_SEND, _CANCEL, _GET = range(3)


def _status(number: int) -> GoalStatus:
    return GoalStatus(number) if number in GoalStatus.__members__.values() else GoalStatus.UNKNOWN
