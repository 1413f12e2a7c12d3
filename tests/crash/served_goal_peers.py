"""As ``call_peers``, for goals that ROS sends to the PLC.

``served_goal_peers.py bridge|plc FOLDER [STEP PASSES] [SABOTAGE]``
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosplc.bridge import Bridge
from rosplc.bridge.served_goals import ServedGoals
from rosplc.config import read_config
from rosplc.ros import actions
from rosplc.shm.constants import ANSWER_ACCEPTED, ANSWER_MASK
from rosplc.virtual_plc import ActionServer, Task
from rosplc.virtual_plc.call_blocks import _In, _Out
from tests.crash.call_peers import Fuse, always, append

SLOW_S = 5.0
"""How long the PLC's program takes to decide on a goal whose token begins with ``slow``."""


def _undecided(use: Any, *_: Any) -> bool:
    return use._open_goal is not None and not use._open_goal.accepted


def _ends(_use: Any, _server: Any, _goal: Any, _payload: bytes, status: int, *_: Any) -> bool:
    return status & ANSWER_MASK != ANSWER_ACCEPTED


STEPS: dict[str, list[tuple[Any, str, str, Callable[..., bool]]]] = {
    "bridge: taken from ROS": [(ServedGoals, "_hand_out", "before", lambda use, *_: bool(use._waiting))],
    "bridge: goal written": [(ServedGoals, "_hand_out", "after", _undecided)],
    "bridge: acceptance taken": [(ServedGoals, "_accept", "before", _undecided)],
    "bridge: acceptance told": [(ServedGoals, "_accept", "after", always)],
    "bridge: end taken": [(ServedGoals, "_follow", "before", _ends)],
    "bridge: end told": [(ServedGoals, "_follow", "after", _ends)],
    "plc: taken stored": [(_In, "begin", "after", always)],
    "plc: written": [(_Out, "publish", "after", always)],
}
ALL = (*STEPS, "plc: shown", "plc: begun")


def _sabotage(what: str) -> None:
    if what == "republish":
        claimed = ServedGoals._claimed

        def hand_out_again(self: Any) -> None:
            claimed(self)
            goal, self._open_goal = self._open_goal, None
            if goal is not None:
                self._caller.correlation, goal.accepted, self._again = 0, False, False
                self._waiting.append(goal)

        ServedGoals._claimed = hand_out_again  # type: ignore[method-assign]
        actions.ActionServer.present = always  # type: ignore[method-assign]
    elif what == "no accept_within":
        begin = ServedGoals.begin

        def for_ever(self: Any, now_ns: int) -> None:
            object.__setattr__(self.plan, "accept_ns", 10**12)
            begin(self, now_ns)

        ServedGoals.begin = for_ever  # type: ignore[method-assign]


def plc(folder: Path, fuse: Fuse) -> None:
    """Carry out goals until SIGTERM; one whose token begins with ``slow`` is decided on late."""
    server = ActionServer("/go", prefix=(folder / "prefix").read_text(), beat_ms=100)
    task = Task("Cell", 0.002)
    state: dict[str, Any] = {"shown": "", "begun": "", "until": 0.0}

    @task.program
    def serve() -> None:
        server()
        token = server.goal.token if server.xGoal or server.xActive else ""
        if not token:
            state["shown"] = state["begun"] = ""
        elif server.xGoal and state["shown"] != token:
            state["shown"] = token
            state["until"] = time.monotonic() + SLOW_S * token.startswith("slow")
            fuse.burn("plc: shown")
        elif server.xActive and state["begun"] != token:
            state["begun"] = token
            append(folder / "executed", token)
            fuse.burn("plc: begun")
            server.result.token = token
        server.xAccept = server.xGoal and time.monotonic() >= state["until"]
        server.xAcceptCancel = server.xCancelRequested
        server.xCanceled = server.xCanceling
        server.xSucceed = server.xActive and not server.xCancelRequested and not server.xCanceling

    task.start()
    print("ready", flush=True)
    signal.sigwait({signal.SIGTERM})
    task.stop()
    server.close()


def main(role: str, folder: str, step: str = "", passes: str = "0", sabotage: str = "") -> None:
    """Run a role."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    _sabotage(sabotage)
    fuse = Fuse(step, int(passes), STEPS)
    if role == "bridge":
        with Bridge(read_config(Path(folder) / "rosplc.yaml")):
            print("ready", flush=True)
            signal.sigwait({signal.SIGTERM})
    else:
        plc(Path(folder), fuse)


if __name__ == "__main__":
    main(*sys.argv[1:])
