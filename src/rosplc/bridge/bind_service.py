"""A service or action between the PLC and a user's program, which takes the place of ROS."""

from __future__ import annotations

import json
import queue
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from secrets import token_bytes
from threading import Event, Lock, Thread
from typing import Any, Literal

from rosplc.bridge.engine import Bridge
from rosplc.bridge.port import log
from rosplc.codec import Codec, Wire
from rosplc.config import parse_config, resolve
from rosplc.errors import ChannelError
from rosplc.layout import RecordView
from rosplc.ros import SERVICES, ActionClient, ActionServer, Backend, GoalEvent, GoalStatus, Reply, memory

Goal = Generator[Mapping[str, Any], None, Mapping[str, Any] | None]


@contextmanager
def _bridged(
    kind: Literal["services", "actions"], name: str, type_name: str, serves: bool, settings: dict[str, Any]
) -> Iterator[tuple[Any, Bridge, Backend]]:
    """Provide the plan of a service or action, its bridge, and the program's node on the ROS side."""
    what = {name: {"type": type_name, "server": "ros" if serves else "plc"}}
    project = resolve(parse_config(json.dumps({"diagnostics": {"enabled": False}, **settings, kind: what})))
    side, program = memory.open_apart(project.store, "bind", "program")
    with closing(side), closing(program), Bridge(project, side) as bridge:
        yield project.calls[0], bridge, program


@contextmanager
def bind_service(
    service: str, type: str, handler: Callable[[RecordView], Mapping[str, Any]] | None = None, **settings: Any
) -> Iterator[Callable[..., RecordView]]:
    """Carry a service in place of a bridge until the ``with`` block ends; its value calls the PLC.

    ``call(request, timeout=5.0)`` returns the response, or raises ChannelError: SHM140, the call was not
    executed and never will be; SHM141, it may have been executed.

    Args:
        service: As ROS writes it, ``"/cell/start"``.
        type: ``"package/srv/Name"``.
        handler: Executes the PLC's calls in another thread: it gets the request and returns the response. If
            it raises, the PLC gets no response. Without a handler, the PLC is the server.
        settings: Further keys of the configuration: ``prefix="cell1"``, ``limits={"string": 40}``.

    Raises:
        ConfigErrors: The arguments are invalid, as in a configuration.
        ChannelError: SHM116 if a bridge or another program holds a name; SHM117 ….
    """
    with _bridged("services", service, type, handler is not None, settings) as (plan, bridge, program):
        ask, answer = (Codec(layout, Wire.CDR) for layout in (plan.request, plan.response))
        one = Lock()

        def on_request(payload: bytes, caller: bytes, _: int) -> None:
            assert handler is not None
            response = handler(ask.layout.view(ask.decode(payload)))
            server.reply(caller, answer.encode(answer.layout.pack(response)))

        def state() -> tuple[int, int, int]:
            (found,) = bridge.status().services
            return sum(found.not_executed.values()), sum(found.fate_unknown.values()), found.outstanding

        def call(request: Mapping[str, Any], timeout: float = 5.0) -> RecordView:
            replies: queue.SimpleQueue[Reply] = queue.SimpleQueue()
            payload = ask.encode(ask.layout.pack(request))
            with one:
                before, ends = state(), time.monotonic() + timeout
                number = client.call(payload, replies.put)
                while (after := state())[:2] == before[:2] and time.monotonic() < ends:
                    with suppress(queue.Empty):
                        if (response := replies.get(timeout=0.01).payload) is not None:
                            return answer.layout.view(answer.decode(response))
                client.forget(number)
            # While a call before it is open, that may be the one that was refused.
            refused = after[0] > before[0] and not before[2]
            code, how = ("SHM140", "was not executed") if refused else ("SHM141", "may have been executed")
            raise ChannelError(code, f"the call {how}", where=service)

        if handler:
            server = program.serve(service, type, SERVICES, on_request)
        else:
            client = program.client(service, type, SERVICES)
        yield call


@contextmanager
def bind_action(
    action: str,
    type: str,
    handler: Callable[[RecordView], Generator[Mapping[str, Any], None, Mapping[str, Any] | None]]
    | None = None,
    **settings: Any,
) -> Iterator[Callable[..., RecordView]]:
    """Carry an action in place of a bridge until the ``with`` block ends; its value sends goals to the PLC.

    ``send(goal, feedback=None, timeout=None)`` returns the result. It calls ``feedback`` with each feedback;
    if that returns True, or after ``timeout`` seconds, the PLC is asked to cancel the goal. It raises
    ChannelError: SHM140, the goal was not begun and never will be; SHM141, it may have been begun; SHM143, it
    was aborted; SHM144, it was canceled.

    Args:
        action: As ROS writes it, ``"/cell/count"``.
        type: ``"package/action/Name"``.
        handler: Executes the PLC's goals, each in a thread: a generator that gets the goal, yields feedback
            and returns the result. It is closed at a ``yield`` when the PLC cancels the goal or the block
            ends. If it raises, the goal is aborted. At its end, the block aborts all goals and waits up to
            4 s for the handlers. Without a handler, the PLC is the server.
        settings: Further keys of the configuration: ``prefix="cell1"``, ``limits={"string": 40}``.

    Raises:
        ConfigErrors, ChannelError: As :func:`bind_service`.
    """
    with _bridged("actions", action, type, handler is not None, settings) as (plan, bridge, program):
        goals, results, feedbacks = (Codec(one, Wire.CDR) for one in (plan.goal, plan.result, plan.feedback))
        waiting: dict[bytes, queue.SimpleQueue[GoalEvent]] = {}
        running: dict[bytes, Thread] = {}
        over = Event()

        def carry_out(uuid: bytes, goal: RecordView) -> None:
            assert handler is not None
            try:
                steps = handler(goal)
                while not over.is_set() and server.status(uuid) is GoalStatus.EXECUTING:
                    try:
                        step = next(steps)
                    except StopIteration as end:
                        server.succeed(uuid, results.encode(results.layout.pack(end.value or {})))
                        return
                    server.feedback(uuid, feedbacks.encode(feedbacks.layout.pack(step)))
                steps.close()
                if not server.canceled(uuid):
                    server.abort(uuid)
            except Exception:
                server.abort(uuid)
                log.exception("%s: the handler failed", action)
            finally:
                del running[uuid]

        def on_goal(uuid: bytes, payload: bytes) -> None:
            if over.is_set():
                server.reject(uuid)
                return
            server.tick()
            server.accept(uuid)
            server.execute(uuid)
            arguments = uuid, goals.layout.view(goals.decode(payload))
            running[uuid] = Thread(
                target=carry_out, args=arguments, name=f"rosplc-goal {action}", daemon=True
            )
            running[uuid].start()

        def on_event(event: GoalEvent) -> None:
            if event.uuid in waiting:
                waiting[event.uuid].put(event)

        def send(
            goal: Mapping[str, Any],
            feedback: Callable[[RecordView], object] | None = None,
            timeout: float | None = None,
        ) -> RecordView:
            uuid, news = token_bytes(16), queue.SimpleQueue[GoalEvent]()
            payload, waiting[uuid] = goals.encode(goals.layout.pack(goal)), news
            alarm = None if timeout is None else time.monotonic() + timeout
            try:
                client.send(uuid, payload)
                while True:
                    try:
                        rest = None if alarm is None else max(0.0, alarm - time.monotonic())
                        event = news.get(timeout=rest)
                    except queue.Empty:
                        client.cancel(uuid)
                        alarm = None
                        continue
                    if event.kind == "feedback" and feedback is not None and event.payload is not None:
                        if feedback(feedbacks.layout.view(feedbacks.decode(event.payload))):
                            client.cancel(uuid)
                    elif event.kind == "result" and event.status is GoalStatus.SUCCEEDED and event.payload:
                        return results.layout.view(results.decode(event.payload))
                    elif event.kind in ("rejected", "failed", "result", "lost"):
                        raise _failure(event, action)
            finally:
                del waiting[uuid]

        if handler:
            server = ActionServer(
                program, plan.goal.store, action, type,
                on_goal=on_goal, on_cancel=lambda uuid: server.accept_cancel(uuid),
            )  # fmt: skip
        else:
            client = ActionClient(program, plan.goal.store, action, type, on_event)
        try:
            yield send
        finally:
            over.set()
            ends = time.monotonic() + _PATIENCE_S
            for uuid, thread in tuple(running.items()):
                thread.join(max(0.0, ends - time.monotonic()))
                server.abort(uuid)
            # The PLC is told before the bridge leaves.
            while (
                handler and bridge.status().actions[0].outstanding and time.monotonic() < ends + _PATIENCE_S
            ):
                time.sleep(0.01)


_PATIENCE_S = 2.0
_CODES = {GoalStatus.ABORTED: ("SHM143", "aborted"), GoalStatus.CANCELED: ("SHM144", "canceled")}


def _failure(event: GoalEvent, action: str) -> ChannelError:
    code, how = _CODES.get(event.status, ("SHM141", "lost: its outcome is unknown"))
    if event.kind == "rejected" or (event.reply is not None and event.reply.outcome == "not executed"):
        code, how = "SHM140", "not started"
    return ChannelError(code, f"the goal was {how}", where=action)
