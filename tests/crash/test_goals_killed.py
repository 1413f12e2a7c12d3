"""Goals of a PLC while bridge and PLC are killed at each of their steps: never sent twice, no wrong word.

The truth is in files, as in test_calls_killed.py.
"""

from __future__ import annotations

import queue
import random
import signal
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rosplc.codec import Codec, Wire
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import ActionServer, open_backend
from rosplc.shm import Namespace
from tests.crash.call_peers import append
from tests.crash.goal_peers import STEPS
from tests.crash.test_calls_killed import ROOT
from tests.crash.test_calls_killed import domain as domain
from tests.lib.waiting import wait_for

TYPE = "cell_msgs/action/Do"
STEP_S = 0.005
UNSENT = ("bridge: goal taken", "bridge: goal sent")
"""Where a goal may be lost on its way: nobody knows then."""


class Cell:
    """Bridge and PLC as processes, and a server of /move in this one, which has one goal in hand."""

    def __init__(self, folder: Path, namespace: Namespace, domain: int, sabotage: str = "") -> None:
        self.folder, self.sabotage = folder, sabotage
        definition = folder / "types/cell_msgs/action/Do.action"
        definition.parent.mkdir(parents=True)
        definition.write_text("string token\n---\nstring token\n---\nstring token\n")
        (folder / "prefix").write_text(namespace.prefix)
        (folder / "rosplc.yaml").write_text(
            f"prefix: {namespace.prefix}\nros: {{backend: dds, domain: {domain}}}\nbeat: 20ms\n"
            "types: {paths: [types]}\ndiagnostics: {enabled: false}\nactions:\n"
            f"  /move: {{type: {TYPE}, server: ros}}\n"
        )
        store = TypeStore.bundled("jazzy").with_paths([folder / "types"])
        self.codecs = {
            part: Codec(compute_layout(store, f"{TYPE}_{part}"), Wire.CDR)
            for part in ("Goal", "Result", "Feedback")
        }
        self.ros = open_backend("dds", store, "peer", domain=domain)
        self.goals: queue.SimpleQueue[tuple[bytes, str]] = queue.SimpleQueue()
        self.canceled: set[bytes] = set()
        self.action = ActionServer(
            self.ros,
            store,
            "/move",
            TYPE,
            on_goal=self._on_goal,
            on_cancel=self._on_cancel,
            keep_result_ns=10**12,
        )
        self.processes: dict[str, subprocess.Popen[str]] = {}
        self._stop = threading.Event()
        self._worker = threading.Thread(target=self._execute)

    def _message(self, part: str, token: str) -> bytes:
        codec = self.codecs[part]
        return codec.encode(codec.layout.pack({"token": token}))

    def _on_goal(self, uuid: bytes, payload: bytes) -> None:
        codec = self.codecs["Goal"]
        token = str(codec.layout.to_dict(codec.decode(payload))["token"])
        append(self.folder / "executed-by-ros", token)
        self.action.accept(uuid)
        self.action.execute(uuid)
        self.goals.put((uuid, token))

    def _on_cancel(self, uuid: bytes) -> None:
        self.action.accept_cancel(uuid)
        self.canceled.add(uuid)

    def _execute(self) -> None:
        while not self._stop.wait(STEP_S):
            while not self.goals.empty():
                uuid, token = self.goals.get()
                for _ in range(3):
                    self.action.feedback(uuid, self._message("Feedback", token))
                    self._stop.wait(STEP_S)
                if not self.action.succeed(uuid, self._message("Result", token)):
                    self.action.canceled(uuid)

    def start(self, role: str, step: str = "", passes: int = 0) -> None:
        command = [sys.executable, "-m", "tests.crash.goal_peers", role, str(self.folder), step, str(passes)]
        process = subprocess.Popen([*command, self.sabotage], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        self.processes[role] = process
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n" or step  # one that is to die may be quick

    def end(self, role: str, number: int) -> None:
        process = self.processes.pop(role)
        if number == signal.SIGTERM:
            process.send_signal(number)
        assert process.wait(100) == (0 if number == signal.SIGTERM else -number)
        assert process.stdout is not None
        process.stdout.close()

    def kill_at(self, step: str, passes: int) -> None:
        """Run a process that dies at a step beside one that does not."""
        role = step.partition(":")[0]
        if role in self.processes:
            self.end(role, signal.SIGTERM)
        self.complete(role)
        self.start(role, step, passes)
        self.end(role, signal.SIGKILL)

    def complete(self, but: str = "") -> None:
        """Start what is not running."""
        for role in ("bridge", "plc"):
            if role != but and role not in self.processes:
                self.start(role)

    def ended(self, outcome: str) -> int:
        """Return how many goals have ended so."""
        return sum(line[1] == outcome for line in self.lines("ended-at-plc"))

    def lines(self, name: str) -> list[list[str]]:
        path = self.folder / name
        return [line.split() for line in path.read_text().splitlines()] if path.exists() else []

    @contextmanager
    def running(self) -> Iterator[None]:
        try:
            self._worker.start()
            yield
        finally:
            self._stop.set()
            self._worker.join()
            for process in self.processes.values():
                process.kill()
                process.communicate()
            self.ros.close()

    def check(self) -> list[str]:
        """Return what the files hold against the goals."""
        asked = {token for token, _ in self.lines("asked-by-plc")}
        executed, ended = self.lines("executed-by-ros"), self.lines("ended-at-plc")
        begun = {token for token, _ in executed}
        found = [f"{token}: executed, though nobody asked" for token in begun - asked]
        for what, lines in (("executed", executed), ("ended", ended)):
            times = Counter(line[0] for line in lines)
            found += [f"{token}: {what} {count} times" for token, count in times.items() if count > 1]
        for token, outcome, answer, _ in ended:
            if outcome == "done" and (answer != token or token not in begun):
                found.append(f"{token}: answered with {answer}, executed: {token in begun}")
            if outcome == "NOT_EXECUTED" and token in begun:
                found.append(f"{token}: called safe to repeat, and executed")
        return found


def _kills(cell: Cell, steps: list[str], seed: int) -> None:
    passes = random.Random(seed)
    with cell.running():
        for step in steps:
            cell.kill_at(step, passes.randint(1, 4))
        cell.complete()
        least = cell.ended("done") + 3
        wait_for(lambda: cell.ended("done") >= least, "goals")


def test_goals_at_each_step(tmp_path: Path, shm_namespace: Namespace, domain: int) -> None:
    """Each step kills once; a goal goes on with the next bridge, wherever the one before was killed."""
    cell = Cell(tmp_path, shm_namespace, domain)
    _kills(cell, list(STEPS), 1)
    assert cell.check() == []
    assert cell.ended("FATE_UNKNOWN") <= len(UNSENT)
    assert {line[1] for line in cell.lines("ended-at-plc")} <= {"done", "FATE_UNKNOWN"}


def test_the_check_sees_a_goal_that_is_sent_twice(
    tmp_path: Path, shm_namespace: Namespace, domain: int
) -> None:
    cell = Cell(tmp_path, shm_namespace, domain, "duplicate send_goal")
    _kills(cell, ["bridge: state written"], 1)
    assert any("safe to repeat, and executed" in line for line in cell.check())


@pytest.mark.verify(minutes=15)
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("step", STEPS)
def test_many_kills_at_one_step(tmp_path: Path, shm_namespace: Namespace, domain: int, step: str) -> None:
    cell = Cell(tmp_path, shm_namespace, domain)
    _kills(cell, [step] * 300, 2)
    assert cell.check() == []
    assert cell.ended("FATE_UNKNOWN") <= 300 * (step in UNSENT)
