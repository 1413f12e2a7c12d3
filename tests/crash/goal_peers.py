"""As call_peers.py, of goals: a PLC that sends them one by one, and the bridge between it and ROS."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any

from rosplc.bridge import Bridge
from rosplc.bridge.called_goals import CalledGoals
from rosplc.config import read_config
from rosplc.virtual_plc import ActionClient, Task
from rosplc.virtual_plc.call_blocks import _In, _Out
from tests.crash.call_peers import Fuse, always, append

STEPS = {
    "bridge: goal taken": [(CalledGoals, "_call", "before", always)],
    "bridge: goal sent": [(CalledGoals, "_call", "after", always)],
    "bridge: answered by ROS": [(CalledGoals, "_learn", "before", always)],
    "bridge: state written": [(CalledGoals, "_report", "after", always)],
    "bridge: feedback written": [(CalledGoals, "_pass_on", "after", always)],
    "bridge: result taken": [(CalledGoals, "_result", "before", always)],
    "bridge: result written": [(CalledGoals, "_answer", "after", always)],
    "plc: answer taken": [(_In, "take", "after", always)],
    "plc: written": [(_Out, "publish", "after", always)],
}
"""As those of calls."""


def _sabotage(what: str) -> None:
    if what == "duplicate send_goal":
        connect = CalledGoals._connect

        def connected(self: Any, backend: Any) -> Any:
            client = connect(self, backend)

            def send(uuid: bytes) -> None:
                newest = self._newest(self._asks)
                client.send(uuid, self._codecs[self._asks].encode(newest[0]))

            client.adopt = send  # type: ignore[method-assign]
            return client

        CalledGoals._connect = connected  # type: ignore[method-assign]


def bridge(folder: Path) -> None:
    """Carry the goals until SIGTERM."""
    with Bridge(read_config(folder / "rosplc.yaml")):
        print("ready", flush=True)
        signal.sigwait({signal.SIGTERM})


def plc(folder: Path) -> None:
    """Send goals all the time, until SIGTERM."""
    client = ActionClient("/move", prefix=(folder / "prefix").read_text(), beat_ms=100)
    task = Task("Cell", 0.002)
    number = 0

    @task.program
    def send() -> None:
        nonlocal number
        client()
        if client.xExecute and not client.xBusy:
            outcome = "done" if client.xDone else str(client.eError and client.eError.name)
            answer = client.result.token if client.xDone else "-"
            append(folder / "ended-at-plc", client.goal.token, outcome, answer)
            client.xExecute = False
        elif client.goal is not None and not client.xExecute:
            number += 1
            client.goal.token = f"p{os.getpid()}-{number}"
            append(folder / "asked-by-plc", client.goal.token)
            client.xExecute = True

    task.start()
    print("ready", flush=True)
    signal.sigwait({signal.SIGTERM})
    task.stop()
    client.close()


def main(role: str, folder: str, step: str, passes: str, sabotage: str = "") -> None:
    """Run a role."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    _sabotage(sabotage)
    Fuse(step, int(passes), STEPS)
    (bridge if role == "bridge" else plc)(Path(folder))


if __name__ == "__main__":
    main(*sys.argv[1:])
