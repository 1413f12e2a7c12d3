"""Calls while bridge and PLC are killed at each of their steps: at most once, and no wrong word about it.

The truth is in files: each executor's own, written before it acts, and each caller's. No counter is believed.
"""

from __future__ import annotations

import itertools
import random
import signal
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from rosplc.codec import Codec, Wire
from rosplc.demo.domain import FreeDomain
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import SERVICES, Reply, open_backend
from rosplc.shm import Namespace
from tests.crash.call_peers import SLOW_S, STEPS, append
from tests.lib.waiting import wait_for

ROOT = Path(__file__).resolve().parents[2]
TYPE = "cell_msgs/srv/Do"
ALL = (*STEPS, "plc: shown")
EXPIRE_S = 0.5
SLACK_S = 1.5


class Cell:
    """Bridge and PLC as processes, and ROS in this one: it calls /do, and serves /move."""

    def __init__(self, folder: Path, namespace: Namespace, domain: int, sabotage: str = "") -> None:
        self.folder, self.sabotage = folder, sabotage
        definition = folder / "types/cell_msgs/srv/Do.srv"
        definition.parent.mkdir(parents=True)
        definition.write_text("string token\n---\nstring token\n")
        (folder / "prefix").write_text(namespace.prefix)
        (folder / "rosplc.yaml").write_text(
            f"prefix: {namespace.prefix}\nros: {{backend: dds, domain: {domain}}}\nbeat: 20ms\n"
            "types: {paths: [types]}\ndiagnostics: {enabled: false}\nservices:\n"
            f"  /do: {{type: {TYPE}, server: plc, expire_after: {EXPIRE_S:g}s}}\n"
            f"  /move: {{type: {TYPE}, server: ros}}\n"
        )
        store = TypeStore.bundled("jazzy").with_paths([folder / "types"])
        self.codecs = {
            part: Codec(compute_layout(store, f"{TYPE}_{part}"), Wire.CDR) for part in ("Request", "Response")
        }
        self.ros = open_backend("dds", store, "peer", domain=domain)
        self.server = self.ros.serve("/move", TYPE, SERVICES, self._on_request)
        self.client = self.ros.client("/do", TYPE, SERVICES)
        self.processes: dict[str, subprocess.Popen[str]] = {}
        self._stop = threading.Event()
        self._caller = threading.Thread(target=self._call_all_the_time)
        self.calling = True

    def _message(self, part: str, token: str) -> bytes:
        codec = self.codecs[part]
        return codec.encode(codec.layout.pack({"token": token}))

    def _token(self, part: str, data: bytes) -> str:
        codec = self.codecs[part]
        return str(codec.layout.to_dict(codec.decode(data))["token"])

    def _on_request(self, payload: bytes, caller: bytes, _: int) -> None:
        token = self._token("Request", payload)
        append(self.folder / "executed-by-ros", token)
        self.server.reply(caller, self._message("Response", token))

    def call(self, token: str, seconds: float) -> bool:
        """Call the PLC; return whether a response came."""
        came = threading.Event()

        def on_reply(reply: Reply) -> None:
            if reply.payload is not None:
                append(self.folder / "ended-at-ros", token, "done", self._token("Response", reply.payload))
                came.set()

        append(self.folder / "asked-by-ros", token)
        number = self.client.call(self._message("Request", token), on_reply)
        if not (answered := came.wait(seconds)):
            self.client.forget(number)
        return answered

    def _call_all_the_time(self) -> None:
        for number in itertools.count(1):
            if self._stop.wait(0.002):
                return
            if self.client.ready and self.calling:
                self.call(f"r{number}", 1.0)

    def start(self, role: str, step: str = "", passes: int = 0) -> None:
        command = [sys.executable, "-m", "tests.crash.call_peers", role, str(self.folder), step, str(passes)]
        process = subprocess.Popen([*command, self.sabotage], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        self.processes[role] = process
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n" or step  # one that is to die may be quick

    def end(self, role: str) -> None:
        process = self.processes.pop(role)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0

    def done(self) -> list[int]:
        """Return how many calls were answered, ROS' and the PLC's."""
        ended = (self.lines(f"ended-at-{who}") for who in ("ros", "plc"))
        return [sum(line[1] == "done" for line in lines) for lines in ended]

    def until_more(self, count: int = 3) -> None:
        wanted = [was + count for was in self.done()]
        wait_for(lambda: all(now >= least for now, least in zip(self.done(), wanted, strict=True)), "calls")

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

    def lines(self, name: str) -> list[list[str]]:
        path = self.folder / name
        return [line.split() for line in path.read_text().splitlines()] if path.exists() else []

    @contextmanager
    def running(self) -> Iterator[None]:
        try:
            self._caller.start()
            yield
        finally:
            self._stop.set()
            self._caller.join()
            for process in self.processes.values():
                process.kill()
                process.wait()
            self.ros.close()

    def check(self) -> list[str]:
        """Return what the files hold against the calls."""
        found = []
        for caller, executor in (("ros", "plc"), ("plc", "ros")):
            asked = {token: int(at) for token, at in self.lines(f"asked-by-{caller}")}
            executed = self.lines(f"executed-by-{executor}")
            done, ended = {token for token, _ in executed}, self.lines(f"ended-at-{caller}")
            found += [f"{token}: executed, though nobody asked" for token in done - asked.keys()]
            for what, lines in (("executed", executed), ("ended", ended)):
                times = Counter(line[0] for line in lines)
                found += [f"{token}: {what} {count} times" for token, count in times.items() if count > 1]
            for token, outcome, answer, _ in ended:
                if outcome == "done" and (answer != token or token not in done):
                    found.append(f"{token}: answered with {answer}, executed: {token in done}")
                if outcome == "NOT_EXECUTED" and token in done:
                    found.append(f"{token}: called safe to repeat, and executed")
            if caller == "ros":
                longest = (EXPIRE_S + SLACK_S) * 1e9
                late = (token for token, at in executed if int(at) - asked.get(token, 0) > longest)
                found += [f"{token}: executed too late" for token in late]
        return found


@pytest.fixture
def domain() -> Iterator[int]:
    free = FreeDomain()
    yield free.number
    free.close()


def _kills(cell: Cell, steps: list[str], seed: int, *, late: bool = True) -> None:
    passes = random.Random(seed)
    with cell.running():
        for step in steps:
            cell.kill_at(step, passes.randint(1, 4))
        cell.complete()
        cell.until_more()
        if not late:
            return
        cell.calling = False
        wait_for(lambda: cell.call("warm", 1.0) or cell.call(f"warm{random.random()}", 1.0))
        slow = threading.Thread(target=cell.call, args=("slow", SLOW_S + 5))
        slow.start()
        wait_for(lambda: any(line[0] == "slow" for line in cell.lines("executed-by-plc")))
        cell.call("late", SLOW_S + 1)
        slow.join()


def test_calls_at_each_step(tmp_path: Path, shm_namespace: Namespace, domain: int) -> None:
    """Each step kills once; what was answered stays true, and calls go on."""
    cell = Cell(tmp_path, shm_namespace, domain)
    _kills(cell, list(ALL), 1)
    assert cell.check() == []
    assert not any(line[0] == "late" for line in cell.lines("executed-by-plc"))


@pytest.mark.parametrize(
    ("sabotage", "steps", "words"),
    [
        ("republish", ["bridge: answer taken"], "executed 2 times"),
        ("no expiry", [], "late: executed too late"),
    ],
)
def test_the_check_sees_a_sabotaged_bridge(
    tmp_path: Path, shm_namespace: Namespace, domain: int, sabotage: str, steps: list[str], words: str
) -> None:
    cell = Cell(tmp_path, shm_namespace, domain, sabotage)
    _kills(cell, steps, 1, late=not steps)
    assert any(words in line for line in cell.check())


@pytest.mark.verify(minutes=15)
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("step", ALL)
def test_many_kills_at_one_step(tmp_path: Path, shm_namespace: Namespace, domain: int, step: str) -> None:
    cell = Cell(tmp_path, shm_namespace, domain)
    _kills(cell, [step] * 300, 2, late=False)
    assert cell.check() == []


@pytest.mark.verify(minutes=20)
@pytest.mark.timeout(3600)
def test_a_hundred_thousand_calls(tmp_path: Path, shm_namespace: Namespace, domain: int) -> None:
    """Both directions together, with a kill at a random step after each ten thousand."""
    cell = Cell(tmp_path, shm_namespace, domain)
    steps = random.Random(3)
    with cell.running():
        for most in range(10_000, 110_000, 10_000):
            cell.kill_at(steps.choice(ALL), steps.randint(1, 100))
            cell.complete()
            wait_for(partial(lambda least: sum(cell.done()) > least, most), "calls", seconds=1800, every=1)
    assert cell.check() == []
