"""Goals from ROS while bridge and PLC are killed at each of their steps: begun at most once, and ended once.

The truth is in files: the PLC's own, written before it acts, and the client's. No counter is believed.
"""

from __future__ import annotations

import itertools
import random
import secrets
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rosplc.codec import Codec, Wire
from rosplc.demo.domain import FreeDomain
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import ActionClient, GoalEvent, open_backend
from rosplc.shm import Namespace
from tests.crash.call_peers import append
from tests.crash.served_goal_peers import ALL, SLOW_S
from tests.lib.waiting import wait_for

ROOT = Path(__file__).resolve().parents[2]
TYPE = "cell_msgs/action/Go"
ACCEPT_S = 0.5
SLACK_S = 3.5
LONGEST_S = 5.0
"""How long the client asks for a result."""


class Cell:
    """Bridge and PLC as processes, and in this one a client that sends one goal after the other to /go."""

    def __init__(self, folder: Path, namespace: Namespace, domain: int, sabotage: str = "") -> None:
        self.folder, self.sabotage = folder, sabotage
        definition = folder / "types/cell_msgs/action/Go.action"
        definition.parent.mkdir(parents=True)
        definition.write_text("string token\n---\nstring token\n---\nstring token\n")
        (folder / "prefix").write_text(namespace.prefix)
        (folder / "rosplc.yaml").write_text(
            f"prefix: {namespace.prefix}\nros: {{backend: dds, domain: {domain}}}\nbeat: 20ms\n"
            "types: {paths: [types]}\ndiagnostics: {enabled: false}\nactions:\n"
            f"  /go: {{type: {TYPE}, server: plc, accept_within: {ACCEPT_S:g}s}}\n"
        )
        store = TypeStore.bundled("jazzy").with_paths([folder / "types"])
        self.goals = Codec(compute_layout(store, f"{TYPE}_Goal"), Wire.CDR)
        self.results = Codec(compute_layout(store, f"{TYPE}_Result"), Wire.CDR)
        self.ros = open_backend("dds", store, "peer", domain=domain)
        self._one, self._news = threading.Lock(), threading.Condition()
        self._events: list[GoalEvent] = []
        self.client = ActionClient(self.ros, store, "/go", TYPE, self._on_event)
        self.processes: dict[str, subprocess.Popen[str]] = {}
        self._stop = threading.Event()
        self._sender = threading.Thread(target=self._send_all_the_time)
        self.sending = True

    def _on_event(self, event: GoalEvent) -> None:
        with self._news:
            self._events.append(event)
            self._news.notify_all()

    def send(self, token: str, seconds: float = LONGEST_S) -> str:
        """Send a goal, one at a time; return how it has ended: a word of the server's, or ``nothing``."""
        with self._one:
            return self._send(token, seconds)

    def _send(self, token: str, seconds: float) -> str:
        append(self.folder / "asked", token)
        uuid, end = secrets.token_bytes(16), time.monotonic() + seconds
        with self._news:
            self._events.clear()
        self.client.send(uuid, self.goals.encode(self.goals.layout.pack({"token": token})))
        word, answer = "nothing", "-"
        while word == "nothing" and time.monotonic() < end and not self._stop.is_set():
            with self._news:
                self._news.wait(0.02)
                events, self._events = [event for event in self._events if event.uuid == uuid], []
            kinds = {event.kind: event for event in events}
            if {"rejected", "failed"} & kinds.keys():
                word = "rejected" if "rejected" in kinds else "failed"
            elif (result := kinds.get("result")) is not None and result.status.ended:
                word, payload = result.status.name, result.payload
                answer = self.results.layout.to_dict(self.results.decode(payload or b""))["token"] or "-"
            elif result is not None:
                word = "forgotten"
            elif "lost" in kinds:
                wait_for(lambda: self.client.ready or self._stop.is_set(), "a server")
                self.client.adopt(uuid)
        self.client.forget(uuid)
        append(self.folder / "ended", token, word, answer)
        return word

    def _send_all_the_time(self) -> None:
        for number in itertools.count(1):
            if self._stop.wait(0.002):
                return
            if self.client.ready and self.sending:
                self.send(f"g{number}")

    def start(self, role: str, step: str = "", passes: int = 0) -> None:
        command = [sys.executable, "-m", "tests.crash.served_goal_peers", role, str(self.folder)]
        command += [step, str(passes), self.sabotage]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        self.processes[role] = process
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n" or step  # one that is to die may be quick

    def end(self, role: str) -> None:
        process = self.processes.pop(role)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0

    def kill_at(self, step: str, passes: int) -> None:
        """Run a process that dies at a step beside one that does not."""
        role = step.partition(":")[0]
        if role in self.processes:
            self.end(role)
        self.complete(role)
        self.start(role, step, passes)
        assert self.processes.pop(role).wait(100) == -signal.SIGKILL

    def complete(self, but: str = "") -> None:
        """Start what is not running."""
        for role in ("bridge", "plc"):
            if role != but and role not in self.processes:
                self.start(role)

    def until_more(self, count: int = 3) -> None:
        wanted = self.succeeded() + count
        wait_for(lambda: self.succeeded() >= wanted, "goals that are reached")

    def succeeded(self) -> int:
        return sum(line[1] == "SUCCEEDED" for line in self.lines("ended"))

    def lines(self, name: str) -> list[list[str]]:
        path = self.folder / name
        return [line.split() for line in path.read_text().splitlines()] if path.exists() else []

    @contextmanager
    def running(self) -> Iterator[None]:
        try:
            self._sender.start()
            yield
        finally:
            self._stop.set()
            self._sender.join()
            for process in self.processes.values():
                process.kill()
                process.wait()
            self.client.close()
            self.ros.close()

    def check(self) -> list[str]:
        """Return what the files hold against the goals."""
        asked = {token: int(at) for token, at in self.lines("asked")}
        executed = self.lines("executed")
        begun = Counter(token for token, _ in executed)
        found = [f"{token}: executed, though nobody asked" for token in begun if token not in asked]
        found += [f"{token}: executed {count} times" for token, count in begun.items() if count > 1]
        for token, at in executed:
            if int(at) - asked.get(token, 0) > (ACCEPT_S + SLACK_S) * 1e9:
                found.append(f"{token}: executed too late")
        for token, word, answer, _ in self.lines("ended"):
            if word == "SUCCEEDED" and (answer != token or token not in begun):
                found.append(f"{token}: reached with {answer}, executed: {token in begun}")
            if word == "rejected" and token in begun:
                found.append(f"{token}: rejected, and executed")
        return found


@pytest.fixture
def domain() -> Iterator[int]:
    free = FreeDomain()
    yield free.number
    free.close()


def _kills(cell: Cell, steps: list[str], seed: int, *, late: bool = False) -> None:
    passes = random.Random(seed)
    with cell.running():
        for step in steps:
            cell.kill_at(step, passes.randint(1, 4))
        cell.complete()
        cell.until_more()
        cell.sending = False
        if late:
            cell.send("slow", SLOW_S + 5)


def test_goals_at_each_step(tmp_path: Path, shm_namespace: Namespace, domain: int) -> None:
    """Each step kills once; what was answered stays true, and goals go on."""
    cell = Cell(tmp_path, shm_namespace, domain)
    _kills(cell, list(ALL), 1, late=True)
    assert cell.check() == []
    assert not any(line[0] == "slow" for line in cell.lines("executed"))


@pytest.mark.parametrize(
    ("sabotage", "step", "words"),
    [
        ("republish", "bridge: end taken", "executed 2 times"),
        ("no accept_within", "", "executed too late"),
    ],
)
def test_the_check_sees_a_sabotaged_bridge(
    tmp_path: Path, shm_namespace: Namespace, domain: int, sabotage: str, step: str, words: str
) -> None:
    """Sooner or later: a PLC that is held up is silent for a while, and then gets no goal."""
    cell = Cell(tmp_path, shm_namespace, domain, sabotage)
    with cell.running():
        for number in range(20):
            if step:
                cell.kill_at(step, 1)
            cell.complete()
            cell.until_more()
            if not step:
                cell.send(f"slow{number}", SLOW_S + 5)
            if any(words in line for line in cell.check()):
                return
    raise AssertionError(f"it did not see: {sabotage}")


@pytest.mark.verify(minutes=15)
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("step", ALL)
def test_many_kills_at_one_step(tmp_path: Path, shm_namespace: Namespace, domain: int, step: str) -> None:
    cell = Cell(tmp_path, shm_namespace, domain)
    _kills(cell, [step] * 300, 2)
    assert cell.check() == []
