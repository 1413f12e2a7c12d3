"""A bridge and a PLC as processes of their own, which kill themselves at a named step of a call.

``call_peers.py bridge|plc FOLDER [STEP PASSES] [SABOTAGE]``: at the given pass of the step the process gets
SIGKILL. Who carries a call out appends the request's token to a file of its own before it acts; who calls
appends the token before, and how the call ended after it.
"""

from __future__ import annotations

import functools
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosplc.bridge import Bridge
from rosplc.bridge.called import Called
from rosplc.bridge.served import Served
from rosplc.config import read_config
from rosplc.virtual_plc import ServiceClient, ServiceServer, Task
from rosplc.virtual_plc.call_blocks import _In, _Out

SLOW_S = 2.5
"""How long the PLC takes for a call whose token begins with ``slow``."""

STEPS: dict[str, list[tuple[Any, str, str, Callable[..., bool]]]] = {}
"""Step → where it is: class, method, ``before`` or ``after``, and whether a pass counts."""


def _always(*_: Any) -> bool:
    return True


def _answers(_use: Any, _caller: bytes, payload: bytes | None, *_: Any) -> bool:
    return payload is not None


def _step(name: str, owner: Any, method: str, when: str, counts: Callable[..., bool] = _always) -> None:
    STEPS.setdefault(name, []).append((owner, method, when, counts))


_step("bridge: taken from ROS", Served, "_hand_out", "before", lambda use, *_: bool(use._waiting))
_step("bridge: request written", Served, "_publish", "after")
_step("bridge: answer taken", Served, "_reply", "before", _answers)
_step("bridge: answer sent", Served, "_reply", "after", _answers)
_step("bridge: request taken", Called, "_begin", "before")
_step("bridge: sent to ROS", Called, "_begin", "after")
_step("bridge: answered by ROS", Called, "_pass_on", "before")
_step("bridge: answer written", Called, "_answer", "after")
_step("plc: taken stored", _In, "begin", "after")
_step("plc: answer taken", _In, "take", "after")
_step("plc: written", _Out, "publish", "after")


class Fuse:
    """Kills this process at a pass of its step; ``burn`` is the pass of a step that has no method."""

    def __init__(self, step: str, passes: int) -> None:
        self.step, self.left = step, passes
        for owner, name, when, counts in STEPS.get(step, []):
            self._instrument(owner, name, when, counts)

    def burn(self, step: str) -> None:
        if step == self.step:
            self.left -= 1
            if self.left <= 0:
                os.kill(os.getpid(), signal.SIGKILL)

    def _instrument(self, owner: Any, name: str, when: str, counts: Callable[..., bool]) -> None:
        method = getattr(owner, name)

        @functools.wraps(method)
        def instrumented(*arguments: Any, **more: Any) -> Any:
            if when == "before" and counts(*arguments):
                self.burn(self.step)
            result = method(*arguments, **more)
            # A method of the PLC's tells whether anything was done.
            done = owner in (Served, Called, _Out) or result not in (None, False)
            if when == "after" and done and counts(*arguments):
                self.burn(self.step)
            return result

        setattr(owner, name, instrumented)


def append(path: Path, *words: object) -> None:
    """Add a line, which a kill of this process cannot take back, with the time."""
    line = " ".join(map(str, (*words, time.monotonic_ns()))) + "\n"
    with path.open("ab", buffering=0) as file:
        file.write(line.encode())


def _sabotage(what: str) -> None:
    if what == "republish":
        claimed = Served._claimed

        def hand_out_again(self: Any, *arguments: Any) -> None:
            claimed(self, *arguments)
            call, self._open_call = self._open_call, None
            if call is not None:
                self._caller.correlation, call.inherited = 0, False
                self._waiting.append(call)

        Served._claimed = hand_out_again  # type: ignore[method-assign]
    elif what == "no expiry":
        begin = Served.begin

        def for_ever(self: Any, now_ns: int) -> None:
            object.__setattr__(self.plan, "expire_ns", 10**12)
            begin(self, now_ns)

        Served.begin = for_ever  # type: ignore[method-assign]


def bridge(folder: Path) -> None:
    """Carry the calls until SIGTERM."""
    with Bridge(read_config(folder / "rosplc.yaml")):
        print("ready", flush=True)
        signal.sigwait({signal.SIGTERM})


def plc(folder: Path, fuse: Fuse) -> None:
    """Carry out what ROS asks for, and call ROS all the time, until SIGTERM."""
    prefix = (folder / "prefix").read_text()
    server = ServiceServer("/do", prefix=prefix, beat_ms=100)
    client = ServiceClient("/move", prefix=prefix, beat_ms=100)
    task = Task("Cell", 0.002)
    state: dict[str, Any] = {"number": 0, "until": 0.0, "token": ""}

    @task.program
    def serve() -> None:
        server.xReply = server.xReply and server.xRequest
        if not server():
            state["token"] = ""
        elif not state["token"] and server.request is not None:
            state["token"] = server.request.token
            append(folder / "executed-by-plc", state["token"])
            fuse.burn("plc: shown")
            state["until"] = time.monotonic() + SLOW_S * state["token"].startswith("slow")
            server.response.token = state["token"]
        server.xReply = bool(state["token"]) and time.monotonic() >= state["until"]

    @task.program
    def call() -> None:
        client()
        if client.xExecute and not client.xBusy:
            answer = client.response.token if client.xDone and client.response is not None else "-"
            outcome = "done" if client.xDone else str(client.eError and client.eError.name)
            append(folder / "ended-at-plc", client.request.token, outcome, answer)
            client.xExecute = False
        elif client.request is not None and not client.xExecute:
            state["number"] += 1
            client.request.token = f"p{os.getpid()}-{state['number']}"
            append(folder / "asked-by-plc", client.request.token)
            client.xExecute, client.tTimeout = True, 2.0

    task.start()
    print("ready", flush=True)
    signal.sigwait({signal.SIGTERM})
    task.stop()
    server.close()
    client.close()


def main(role: str, folder: str, step: str = "", passes: str = "0", sabotage: str = "") -> None:
    """Run a role."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    _sabotage(sabotage)
    fuse = Fuse(step, int(passes))
    if role == "bridge":
        bridge(Path(folder))
    else:
        plc(Path(folder), fuse)


if __name__ == "__main__":
    main(*sys.argv[1:])
