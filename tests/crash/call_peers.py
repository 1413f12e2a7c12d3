"""Bridge, PLC and robot as processes that kill themselves at a named step of a call or goal.

``call_peers.py FOLDER [SABOTAGE]`` forks them when it is told to on its standard input. Each executor appends
the request's token to a file before it acts; each caller appends the token before it calls, and how the call
ended after it. The bridge notes when each call came and in which counter it went, so that the counters can be
compared with those files. SIGUSR1 makes each process write to standard error what its threads are doing.
"""

from __future__ import annotations

import faulthandler
import functools
import importlib
import itertools
import os
import queue
import signal
import sys
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from rosplc.bridge import Bridge
from rosplc.bridge.called import Called, CalledGoals
from rosplc.bridge.served import Served, ServedGoals
from rosplc.bridge.use import Use
from rosplc.codec import Codec, Wire
from rosplc.config import read_config
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import SERVICES, GoalEvent, GoalStatus, Reply, action_classes, actions, open_backend
from rosplc.shm import Attached, Part, Reader, SlotInfo
from rosplc.shm.attach import ReaderClaim
from rosplc.shm.constants import ANSWER_ACCEPTED, ANSWER_MASK
from rosplc.virtual_plc import ActionClient, ActionServer, ServiceClient, ServiceServer, Task
from rosplc.virtual_plc.call_blocks import _In, _Out
from tests.lib.waiting import wait_for

TYPE, ACTION = "cell_msgs/srv/Do", "cell_msgs/action/Work"
GOAL_S = 1.5
"""How long a caller in ROS waits for the end of a goal that was accepted."""
SLOW_S = 5.0
"""How long the PLC takes for a call whose token begins with ``slow``, and to decide on a goal ``late``."""
FEEDBACKS, FEEDBACK_S = 3, 0.005
"""How many messages of feedback the robot sends for a goal, and the time between them."""
RESTART_EVERY = 200
"""Of so many calls, the PLC's program executes one and goes to STOP and RUN before it answers."""
BEAT_MS = 30

Counts = Callable[..., bool]
Place = tuple[Any, str, str, Counts] | None


def always(*_: Any) -> bool:
    return True


def _waits(use: Any, *_: Any) -> bool:
    return bool(use._waiting)


def _answers(_use: Any, _caller: bytes, payload: bytes | None, *_: Any) -> bool:
    return payload is not None


def _undecided(use: Any, *_: Any) -> bool:
    return use._open_goal is not None and not use._open_goal.accepted


def _ends(_use: Any, _server: Any, _goal: Any, _payload: bytes, status: int, *_: Any) -> bool:
    return status & ANSWER_MASK != ANSWER_ACCEPTED


def _of(part: Part) -> Counts:
    return lambda block, *_: block._part is part


CALLS: dict[str, Place] = {
    "bridge: taken from ROS": (Served, "_hand_out", "before", _waits),
    "bridge: request written": (Served, "_publish", "after", always),
    "bridge: answer taken": (Served, "_reply", "before", _answers),
    "bridge: answer sent": (Served, "_reply", "after", _answers),
    "bridge: request taken": (Called, "_begin", "before", always),
    "bridge: sent to ROS": (Called, "_begin", "after", always),
    "bridge: answered by ROS": (Called, "_pass_on", "before", always),
    "bridge: answer written": (Called, "_answer", "after", always),
    "plc: taken stored": (_In, "begin", "after", always),
    "plc: answer taken": (_In, "take", "after", always),
    "plc: request written": (_Out, "publish", "after", _of(Part.REQUEST)),
    "plc: answer written": (_Out, "publish", "after", _of(Part.RESPONSE)),
    "plc: shown": None,
    "robot: asked": None,
    "robot: sent": None,
    "robot: answer taken": None,
    "robot: shown": None,
    "robot: answered": None,
}
"""The steps of calls; where each is: class, method, ``before`` or ``after`` it, and whether a pass counts.

Those that are in no method of rosplc's call :meth:`Fuse.burn`.
"""
GOALS_FROM_ROS: dict[str, Place] = {
    "bridge: goal taken from ROS": (ServedGoals, "_hand_out", "before", _waits),
    "bridge: goal written": (ServedGoals, "_hand_out", "after", _undecided),
    "bridge: acceptance taken": (ServedGoals, "_accept", "before", _undecided),
    "bridge: acceptance told": (ServedGoals, "_accept", "after", always),
    "bridge: end taken": (ServedGoals, "_follow", "before", _ends),
    "bridge: end told": (ServedGoals, "_follow", "after", _ends),
    "goal-plc: taken stored": (_In, "begin", "after", always),
    "goal-plc: answer written": (_Out, "publish", "after", _of(Part.RESULT)),
    "goal-plc: shown": None,
    "goal-plc: begun": None,
    "goal-robot: sent": None,
}
GOALS_OF_PLC: dict[str, Place] = {
    "bridge: goal taken": (CalledGoals, "_begin", "before", always),
    "bridge: goal sent": (CalledGoals, "_begin", "after", always),
    "bridge: goal answered by ROS": (CalledGoals, "_learn", "before", always),
    "bridge: state written": (CalledGoals, "_report", "after", always),
    "bridge: feedback written": (CalledGoals, "_pass_on", "after", always),
    "bridge: result taken": (CalledGoals, "_result", "before", always),
    "bridge: result written": (CalledGoals, "_answer", "after", always),
    "goal-plc: answer taken": (_In, "take", "after", always),
    "goal-plc: goal written": (_Out, "publish", "after", _of(Part.GOAL)),
    "goal-robot: shown": None,
    "goal-robot: ended": None,
}
STEPS = {**CALLS, **GOALS_FROM_ROS, **GOALS_OF_PLC}


class Fuse:
    """Kills this process at a pass of its step, and notes that; ``burn`` is a pass that is in no method."""

    def __init__(self, folder: Path, step: str, passes: int) -> None:
        self.folder, self.step, self.left = folder, step, passes
        self._lock = threading.Lock()
        if (place := STEPS.get(step)) is not None:
            self._instrument(*place)

    def burn(self, step: str) -> None:
        if step != self.step:
            return
        with self._lock:
            self.left -= 1
            if self.left <= 0:
                append(self.folder / "killed-at", self.step)
                os.kill(os.getpid(), signal.SIGKILL)

    def _instrument(self, owner: Any, name: str, when: str, counts: Counts) -> None:
        method = getattr(owner, name)

        @functools.wraps(method)
        def instrumented(*arguments: Any, **more: Any) -> Any:
            if when == "before" and counts(*arguments):
                self.burn(self.step)
            result = method(*arguments, **more)
            # A method of the PLC's tells whether anything was done.
            done = owner is not _In or result not in (None, False)
            if when == "after" and done and counts(*arguments):
                self.burn(self.step)
            return result

        setattr(owner, name, instrumented)


class Patience:
    """How long a caller waits for an answer: not long, though kills lose many; longer on a busy machine."""

    def __init__(self) -> None:
        self.seconds = 0.1

    def learn(self, answered: object) -> None:
        self.seconds = min(max(self.seconds * (0.4 if answered else 1.5), 0.1), 1.0)


def append(path: Path, *words: object) -> None:
    """Add a line, which a kill of this process cannot take back, with the time."""
    line = " ".join(map(str, (*words, time.monotonic_ns()))) + "\n"
    with path.open("ab", buffering=0) as file:
        file.write(line.encode())


def _sabotage(what: str, folder: Path) -> None:
    """Take a rule away from this process: the bridge, or with ``last := 0`` the PLC."""
    if what == "republish":
        claimed, goal_claimed = Served._claimed, ServedGoals._claimed

        def hand_out_again(self: Any, *arguments: Any) -> None:
            claimed(self, *arguments)
            call, self._open_call = self._open_call, None
            if call is not None:
                self._caller.correlation, call.inherited = 0, False
                self._waiting.append(call)

        def hand_goal_out_again(self: Any) -> None:
            goal_claimed(self)
            goal, self._open_goal = self._open_goal, None
            if goal is not None:
                self._caller.correlation, goal.accepted, self._again = 0, False, False
                self._waiting.append(goal)

        Served._claimed = hand_out_again  # type: ignore[method-assign]
        ServedGoals._claimed = hand_goal_out_again  # type: ignore[method-assign]
        actions.ActionServer.present = always  # type: ignore[method-assign]
    elif what == "no expiry":
        begin = Use.begin

        def for_ever(self: Any, now_ns: int) -> None:
            for limit in {"expire_after_ns", "accept_within_ns"}.intersection(vars(self.plan)):
                object.__setattr__(self.plan, limit, 10**12)
            begin(self, now_ns)

        Use.begin = for_ever  # type: ignore[method-assign]
    elif what == "duplicate":

        def send_again(self: Any, uuid: bytes) -> None:
            self.forget(uuid)
            self.send(uuid, Tokens(folder).put("Goal", "again"))

        actions.ActionClient.adopt = send_again  # type: ignore[method-assign]
    elif what == "no count":
        Use._count = lambda *_: None  # type: ignore[method-assign]
    elif what == "last := 0":
        Attached.reader = lambda self, **_: Reader(self.region, 0)  # type: ignore[assignment,method-assign]
        claim = ReaderClaim.__init__
        ReaderClaim.__init__ = lambda *a, answer, **k: claim(*a, **k)  # type: ignore[method-assign]


class Tokens:
    """The parts of ``cell_msgs/srv/Do`` and ``cell_msgs/action/Work``, as serialized bytes."""

    def __init__(self, folder: Path) -> None:
        self.store = TypeStore.bundled("jazzy").with_paths([folder / "types"])
        self._codecs = {
            part: Codec(compute_layout(self.store, f"{name}_{part}"), Wire.CDR)
            for name, parts in ((TYPE, ("Request", "Response")), (ACTION, ("Goal", "Result", "Feedback")))
            for part in parts
        }

    def put(self, part: str, token: str) -> bytes:
        codec = self._codecs[part]
        return codec.encode(codec.layout.pack({"token": token}))

    def get(self, part: str, data: bytes) -> str:
        codec = self._codecs[part]
        return str(codec.layout.to_dict(codec.decode(data))["token"])


def _note_counts(folder: Path) -> None:
    """Note when each call came, and in which counter it went: ``pid server call came|counted word``."""
    tokens, now = Tokens(folder), dict[type, str]()

    def around(owner: Any, name: str, before: Callable[..., None]) -> None:
        method = getattr(owner, name)

        @functools.wraps(method)
        def noted(*arguments: Any, **more: Any) -> Any:
            before(*arguments)
            return method(*arguments, **more)

        setattr(owner, name, noted)

    def note(use: Any, key: str, *words: object) -> None:
        append(folder / "noted-by-bridge", os.getpid(), use.plan.server, key, *words)

    def came(use: Any, payload: bytes, caller: bytes, _: int) -> None:
        note(use, caller.hex(), "came", tokens.get("Request", payload))

    def goal_came(use: Any, what: str, name: bytes, *payload: bytes) -> None:
        if what == "goal":
            note(use, name.hex(), "came", tokens.get("Goal", *payload))

    def begun(use: Any, what: str, payload: bytes, info: SlotInfo, _: int) -> None:
        part = "Request" if isinstance(use, Called) else "Goal"
        note(use, f"{info.correlation:x}", "came", tokens.get(part, payload))

    def of(key: Callable[..., str]) -> Callable[..., None]:
        return lambda use, *arguments: now.update({type(use): key(use, *arguments)})

    def counted(use: Any, outcome: str, *_: Any) -> None:
        word = "done" if outcome == "succeeded" else outcome.replace(" ", "_")
        note(use, now[type(use)], "counted", word)

    around(Served, "tell", came)
    around(Served, "_end", of(lambda _, call, *__: call.caller.hex()))
    around(Served, "_reply", of(lambda _, caller, *__: caller.hex()))
    around(ServedGoals, "tell", goal_came)
    around(ServedGoals, "_end", of(lambda _, goal, *__: goal.uuid.hex()))
    around(ServedGoals, "_follow", of(lambda _, __, goal, *___: goal.uuid.hex()))
    for asked in (Called, CalledGoals):
        around(asked, "_begin", begun)
        around(asked, "_answer", of(lambda use, *_: f"{use._open_call:x}"))
    around(Use, "_count", counted)


def bridge(folder: Path) -> None:
    """Carry the calls until SIGTERM."""
    with Bridge(read_config(folder / "rosplc.yaml")):
        _say("ready", os.getpid())
        signal.sigwait({signal.SIGTERM})


def _scan(task: Task) -> None:
    """Run a PLC's task until SIGTERM; fail with what halted it."""
    task.start()
    _say("ready", os.getpid())
    while not signal.sigtimedwait({signal.SIGTERM}, 1.0):
        if task.error is not None:
            raise task.error
    task.stop()


def plc(folder: Path, fuse: Fuse) -> None:
    """Carry out what ROS asks for, and call ROS all the time, until SIGTERM."""
    prefix = (folder / "where").read_text().split()[0]
    task = Task("Cell", 0.002)
    server: ServiceServer
    client: ServiceClient
    number, shown, executing, until, patience = 0, 0, "", 0.0, Patience()

    def run() -> None:
        nonlocal server, client
        server = ServiceServer("/do", prefix=prefix, beat_ms=BEAT_MS)
        client = ServiceClient("/move", prefix=prefix, beat_ms=BEAT_MS)

    def stop() -> None:
        if client.xExecute:
            append(folder / "ended-at-plc", client.request.token, "forgotten", "-", "-")
        server.close()
        client.close()

    @task.program
    def serve() -> None:
        nonlocal shown, executing, until
        server.xReply = server.xReply and server.xRequest
        if not server():
            executing = ""
        elif not executing and server.request is not None:
            executing = server.request.token
            append(folder / "executed-by-plc", executing)
            fuse.burn("plc: shown")
            slow, shown = executing.startswith("slow"), shown + 1
            until = time.monotonic() + SLOW_S * slow
            server.response.token = executing
            if shown % RESTART_EVERY == 2 and not slow:
                stop()
                run()
                server()  # at once: the bridge shall not have withdrawn the call yet
                executing = ""
        server.xReply = bool(executing) and time.monotonic() >= until

    @task.program
    def call() -> None:
        nonlocal number
        client()
        if client.xExecute and not client.xBusy:
            answer = client.response.token if client.xDone and client.response is not None else "-"
            outcome = "done" if client.xDone else str(client.eError and client.eError.name)
            append(folder / "ended-at-plc", client.request.token, outcome, answer, client.eReason.name)
            client.xExecute = False
            patience.learn(client.xDone)
        elif client.request is not None and not client.xExecute:
            number += 1
            client.request.token = f"p{os.getpid()}-{number}"
            append(folder / "asked-by-plc", client.request.token)
            client.xExecute, client.tTimeout = True, patience.seconds

    run()
    _scan(task)
    stop()


def robot(folder: Path, fuse: Fuse, *, late: bool) -> None:
    """Serve the PLC, and call it all the time, until SIGTERM, or with ``late`` until a call has expired."""
    tokens, lock, known, patience = Tokens(folder), threading.Lock(), threading.Event(), Patience()
    ros = open_backend("dds", tokens.store, "peer", domain=int((folder / "where").read_text().split()[1]))

    def on_request(payload: bytes, caller: bytes, _: int) -> None:
        token = tokens.get("Request", payload)
        append(folder / "executed-by-ros", token)
        fuse.burn("robot: shown")
        known.wait()
        server.reply(caller, tokens.put("Response", token))
        fuse.burn("robot: answered")

    def call(token: str, seconds: float) -> bool:
        came = threading.Event()

        def on_reply(reply: Reply) -> None:
            if reply.payload is not None:
                fuse.burn("robot: answer taken")
                append(folder / "ended-at-ros", token, "done", tokens.get("Response", reply.payload), "-")
                came.set()

        with lock:  # in the order of the file
            append(folder / "asked-by-ros", token)
            fuse.burn("robot: asked")
            number = client.call(tokens.put("Request", token), on_reply)
        fuse.burn("robot: sent")
        if not (answered := came.wait(seconds)):
            client.forget(number)
        return answered

    server = ros.serve("/move", TYPE, SERVICES, on_request)
    known.set()
    client = ros.client("/do", TYPE, SERVICES)
    _say("ready", os.getpid())
    name = (f"r{os.getpid()}-{number}" for number in itertools.count(1))
    if late:
        wait_for(lambda: client.ready and call(next(name), 1.0), "an answer")
        for number in itertools.count(1):
            token = f"slow{number}-{os.getpid()}"
            slow = threading.Thread(target=call, args=(token, SLOW_S + 5))
            slow.start()
            with suppress(AssertionError):  # refused, as a busy machine has held up the PLC
                wait_for(lambda token=token: token in (folder / "executed-by-plc").read_text(), seconds=3)
                break
        threading.Thread(target=call, args=(f"late-{os.getpid()}", 60.0)).start()
        slow.join()
        wait_for(lambda: call(next(name), 1.0), "an answer behind the late one")
    else:
        while not signal.sigtimedwait({signal.SIGTERM}, 0.002):
            if client.ready:
                patience.learn(call(next(name), patience.seconds))


def goal_plc(folder: Path, fuse: Fuse) -> None:
    """Carry out ROS' goals, and send goals to ROS all the time, until SIGTERM."""
    prefix = (folder / "where").read_text().split()[0]
    task = Task("Cell", 0.002)
    server = ActionServer("/work", prefix=prefix, beat_ms=BEAT_MS)
    client = ActionClient("/arm", prefix=prefix, beat_ms=BEAT_MS)
    number, shown, begun, until, patience = 0, "", "", 0.0, Patience()

    @task.program
    def serve() -> None:
        nonlocal shown, begun, until
        server()
        token = server.goal.token if server.xGoal or server.xActive else ""
        if not token:
            shown = begun = ""
        elif server.xGoal and shown != token:
            shown, until = token, time.monotonic() + SLOW_S * token.startswith("late")
            fuse.burn("goal-plc: shown")
        elif server.xActive and begun != token:
            begun = server.result.token = token
            append(folder / "executed-by-plc", token)
            fuse.burn("goal-plc: begun")
        server.xAccept = server.xGoal and time.monotonic() >= until
        server.xAcceptCancel = server.xCancelRequested
        server.xCanceled = server.xCanceling
        server.xSucceed = server.xActive and not server.xCancelRequested and not server.xCanceling

    @task.program
    def send() -> None:
        nonlocal number
        client()
        if client.xExecute and not client.xBusy:
            answer = client.result.token if client.xDone else "-"
            outcome = "done" if client.xDone else str(client.eError and client.eError.name)
            append(folder / "ended-at-plc", client.goal.token, outcome, answer, client.eReason.name)
            client.xExecute = False
            patience.learn(client.xDone)
        elif client.goal is not None and not client.xExecute:
            number += 1
            client.goal.token = f"p{os.getpid()}-{number}"
            append(folder / "asked-by-plc", client.goal.token)
            impatient = (folder / "impatient").exists()
            client.xExecute, client.tTimeout = True, 3 * patience.seconds * impatient

    _scan(task)
    if client.xExecute:
        append(folder / "ended-at-plc", client.goal.token, "forgotten", "-", "-")
    server.close()
    client.close()


def goal_robot(folder: Path, fuse: Fuse, *, late: bool) -> None:
    """As :func:`robot`, with goals; a result that does not come is asked for again."""
    tokens, known, patience = Tokens(folder), threading.Event(), Patience()
    ros = open_backend("dds", tokens.store, "peer", domain=int((folder / "where").read_text().split()[1]))
    servers, clients = action_classes(tokens.store)
    events: queue.SimpleQueue[GoalEvent] = queue.SimpleQueue()
    accepted: queue.SimpleQueue[tuple[bytes, str]] = queue.SimpleQueue()

    def on_goal(name: bytes, payload: bytes) -> None:
        known.wait()
        token = tokens.get("Goal", payload)
        append(folder / "executed-by-ros", token)
        fuse.burn("goal-robot: shown")
        server.accept(name)
        server.execute(name)
        accepted.put((name, token))

    def execute() -> None:
        while True:
            name, token = accepted.get()
            for _ in range(FEEDBACKS):
                server.feedback(name, tokens.put("Feedback", token))
                time.sleep(FEEDBACK_S)
            server.succeed(name, tokens.put("Result", token))
            fuse.burn("goal-robot: ended")

    def follow(name: bytes, seconds: float) -> tuple[str, str]:
        ask, ends = time.monotonic() + seconds, 0.0
        while True:
            if (now := time.monotonic()) >= ask:
                if now >= ends:
                    return "", ""
                client.adopt(name)
                ask = now + 0.3
            with suppress(queue.Empty):
                event = events.get(timeout=ask - now)
                if event.uuid != name:
                    continue
                if event.kind == "accepted":
                    ends = time.monotonic() + GOAL_S
                elif event.kind == "rejected":
                    return "NOT_EXECUTED", "-"
                elif event.kind == "result" and event.payload is not None:
                    outcome = "done" if event.status is GoalStatus.SUCCEEDED else event.status.name
                    return outcome, tokens.get("Result", event.payload) or "-"

    def send(token: str, seconds: float) -> bool:
        name = uuid.uuid4().bytes
        append(folder / "asked-by-ros", token)
        client.send(name, tokens.put("Goal", token))
        fuse.burn("goal-robot: sent")
        outcome, answer = follow(name, seconds)
        client.forget(name)
        if outcome:
            append(folder / "ended-at-ros", token, outcome, answer, "-")
        patience.learn(outcome)
        return outcome == "done"

    server = servers(
        *(ros, tokens.store, "/arm", ACTION),
        on_goal=on_goal,
        on_cancel=lambda name: server.accept_cancel(name),
        keep_result_ns=10**12,
    )
    known.set()
    threading.Thread(target=execute, daemon=True).start()
    client = clients(ros, tokens.store, "/work", ACTION, events.put)
    _say("ready", os.getpid())
    name = (f"r{os.getpid()}-{number}" for number in itertools.count(1))
    if late:
        wait_for(lambda: client.ready and send(next(name), patience.seconds), "a result")
        send(f"late-{os.getpid()}", 60.0)
        return
    while not signal.sigtimedwait({signal.SIGTERM}, 0.002):
        if client.ready:
            send(next(name), patience.seconds)


def _say(*words: object) -> None:
    os.write(1, (" ".join(map(str, words)) + "\n").encode())


def _play(folder: Path, sabotage: str, role: str, step: str, passes: int) -> None:
    fuse = Fuse(folder, step, passes)
    if role == "bridge":
        _note_counts(folder)
    if role.endswith("plc" if sabotage == "last := 0" else "bridge"):
        _sabotage(sabotage, folder)
    if role == "bridge":
        bridge(folder)
    elif role.endswith("plc"):
        (goal_plc if role == "goal-plc" else plc)(folder, fuse)
    else:
        (goal_robot if role == "goal-robot" else robot)(folder, fuse, late=step == "late")


def main(folder: str, sabotage: str = "") -> None:
    """Start processes, and wait for their ends, as standard input says, until it ends."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    faulthandler.register(signal.SIGUSR1)
    Tokens(Path(folder)).get("Request", Tokens(Path(folder)).put("Request", "warm"))
    importlib.import_module("rosplc.ros.dds.backend")  # once for all of them
    children = set()
    for line in sys.stdin:
        order, *words = line.rstrip("\n").split("|")
        if order == "wait":
            child = int(words[0])
            status = os.waitpid(child, 0)[1]
            children.discard(child)
            _say("ended", child, os.waitstatus_to_exitcode(status))
        elif child := os.fork():
            children.add(child)
            _say("started", child)
        else:
            try:
                _play(Path(folder), sabotage, words[0], words[1], int(words[2]))
                os._exit(0)
            except BaseException:
                sys.excepthook(*sys.exc_info())
                os._exit(1)
    for child in children:
        os.kill(child, signal.SIGKILL)


if __name__ == "__main__":
    main(*sys.argv[1:])
