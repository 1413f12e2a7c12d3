"""A caller or an answerer that dies at any step of a call: spec/shm-format.md, section 11.

Each executor appends the call's own token to a file before it acts; what the other side was told is compared
with that file alone. Each sabotage of a rule turns the same comparison red.
"""

from __future__ import annotations

import os
import subprocess
import time
from collections import Counter
from functools import partial
from pathlib import Path

import pytest

from rosplc.shm import Answerer, Caller, Namespace, Part, attach
from rosplc.shm import constants as spec
from tests.lib.channels import acting_reader, open_service, pattern, start_child, until

pytestmark = pytest.mark.verifies("calls-once", own="processes killed at each step")

_COMMON = """
import os, signal, sys, time
from functools import partial
from rosplc.shm import Answerer, Caller, Namespace, Part, Reader, attach
from rosplc.shm import constants as spec
from tests.lib.channels import acting_reader, open_service, pattern
prefix, server, step, number, path, sabotage = sys.argv[1:]
namespace, calls = Namespace(prefix), 0
file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)

def reach(name):
    global step
    if f"{name} {calls}" == f"{step} {number}":
        os.kill(os.getpid(), signal.SIGKILL)
    if f"pause {name} {calls}" == f"{step} {number}":
        step = ""
        print("paused", flush=True)
        sys.stdin.readline()

def token(record):
    return int.from_bytes(record[:8], "little")
"""

# Answers calls: a server in the PLC, or a bridge.
_ANSWERER = (
    _COMMON
    + """
if server == "plc":
    asks = attach(namespace, "/add", part=Part.REQUEST, write=True)
    answers = attach(namespace, "/add", part=Part.RESPONSE, write=True)
    writer = answers.writer(beat_ms=50)
    reader = acting_reader(asks, beat_ms=50)
    if sabotage == "last := 0":
        reader = Reader(asks.region, 0)
        reader.claim(0, asks.region.word(spec.reader_line(0)), 50, "")
else:
    asks, answers = open_service(namespace, "ros")
    writer, reader = answers.writer(), asks.reader()
answerer = Answerer(asks, reader, answers)
if sabotage == "last := 0":
    answerer.unanswered = 0
if sabotage == "no second look":
    class Blind:
        latest, beat, begin = reader.latest, reader.beat, lambda self: True
    answerer._reader = Blind()
record = bytearray(64)

def answer(correlation, status):
    writer.publish(bytes(32), correlation=correlation, status=status)
    answerer.answered(correlation)

if server == "ros" and answerer.unanswered:
    answer(answerer.unanswered, spec.ANSWER_FATE_UNKNOWN)
print("ready", flush=True)
while True:
    info = reader.latest(record)
    if info is None:
        reader.beat(), writer.beat()
        time.sleep(0.001)
        continue
    reach("taken")
    found = answerer.take(info)
    if found == "begin":
        reach("looked")
        os.write(file, f"{token(record)}\\n".encode())
        reach("executed")
        answer(info.correlation, spec.ANSWER_DONE)
        reach("answered")
        calls += 1
    elif found in ("withdrawn", "unknown"):
        unknown = found == "unknown"
        answer(info.correlation, spec.ANSWER_FATE_UNKNOWN if unknown else spec.ANSWER_NOT_EXECUTED)
"""
)

# A bridge that calls a server in the PLC; every third call is withdrawn at once.
_CALLER = (
    _COMMON
    + """
asks, answers = open_service(namespace)
writer, reader = asks.writer(), answers.reader()
caller = Caller(asks, writer, follows_claim=True)
record = bytearray(64)

def finish(send, outcome=0):
    while not outcome:
        info = reader.latest(bytearray(32))
        outcome = caller.answer(info) if info else caller.lost(send)
    os.write(file, f"{token(record)} {outcome}\\n".encode())

before = Reader(asks.region, 0).peek(record)
answered = answers.slot(answers.region.word(spec.WRITER_LINE["head"]))
if before and not before.status & spec.ASK_WITHDRAWN and "resume" not in sabotage:
    if not answered or answered.correlation != before.correlation:
        send = partial(writer.publish, bytes(record))
        caller.resume(before)
        finish(send, 0 if caller.withdraw(send) else spec.ANSWER_NOT_EXECUTED)
if "epoch" in sabotage:
    class Forgetful:
        head, epoch, begun = property(lambda self: writer.head), 0, writer.begun
    caller._writer = Forgetful()
print("ready", flush=True)
for line in sys.stdin:
    record[:] = pattern(int(line), 64)
    send = partial(writer.publish, bytes(record))
    caller.call(send)
    reach("written")
    outcome = 0
    if int(line) % 3 == 0:
        outcome = 0 if caller.withdraw(send) else spec.ANSWER_NOT_EXECUTED
        reach("withdrawn")
    finish(send, outcome)
    reach("reported")
    calls += 1
    print("next", flush=True)
"""
)


def _problems(executed: list[int], told: dict[int, int]) -> list[str]:
    """Compare what was executed with what callers were told."""
    times = Counter(executed)
    found = [f"call {token} was executed {number} times" for token, number in times.items() if number > 1]
    for token, outcome in told.items():
        if outcome == spec.ANSWER_NOT_EXECUTED and times[token]:
            found.append(f"call {token} was reported as not executed, but it was")
        if outcome == spec.ANSWER_DONE and not times[token]:
            found.append(f"call {token} was reported as done, but it was not")
    return found


def _lines(path: Path) -> list[list[int]]:
    return [[int(word) for word in line.split()] for line in path.read_text("ascii").splitlines()]


def _stop(child: subprocess.Popen[str]) -> None:
    child.kill()
    child.wait()
    for pipe in (child.stdin, child.stdout):
        assert pipe is not None
        pipe.close()


class _Calls:
    """Calls from this process, to answerers in others, which are started again when they die."""

    def __init__(self, namespace: Namespace, server: str, path: Path, sabotage: str = "") -> None:
        self._start = partial(self._child, namespace, server, path, sabotage)
        if server == "plc":
            self.asks, self.answers = open_service(namespace)
            self.writer, self.reader = self.asks.writer(), self.answers.reader()
            self.child = self._start("", 0)
        else:
            self.child = self._start("", 0)
            self.asks = attach(namespace, "/add", part=Part.REQUEST, write=True)  # type: ignore[assignment]
            self.answers = attach(namespace, "/add", part=Part.RESPONSE, write=True)  # type: ignore[assignment]
            self.writer, self.reader = self.asks.writer(), acting_reader(self.answers)  # type: ignore[attr-defined]
        self.caller = Caller(self.asks, self.writer, follows_claim=server == "plc")
        self.told: dict[int, int] = {}

    @staticmethod
    def _child(
        namespace: Namespace, server: str, path: Path, sabotage: str, step: str, number: int
    ) -> subprocess.Popen[str]:
        child = start_child(_ANSWERER, namespace.prefix, server, step, number, path, sabotage)
        assert until(child, "ready") == "ready"
        return child

    def restart(self, step: str = "", number: int = 0) -> None:
        """Kill the answerer and start another, which dies at a step of its call ``number``."""
        _stop(self.child)
        self.child = self._start(step, number)

    def send(self, token: int) -> partial[int]:
        return partial(self.writer.publish, pattern(token, 64))

    def call(self, token: int) -> None:
        """Make a call and note how it has ended, whatever dies meanwhile."""
        self.caller.call(self.send(token))
        self.wait(token)

    def wait(self, token: int) -> None:
        """Wait for the end of the open call."""
        watchdog = time.monotonic() + 60
        while (outcome := self._look(token)) == 0:
            assert time.monotonic() < watchdog
            if self.child.poll() is not None:
                self.restart()
        self.told[token] = outcome

    def _look(self, token: int) -> int:
        info = self.reader.latest(bytearray(32))
        if info is not None:
            return self.caller.answer(info)
        time.sleep(0.0005)
        return self.caller.lost(self.send(token))

    def close(self) -> None:
        _stop(self.child)
        self.asks.close()
        self.answers.close()


@pytest.mark.parametrize("server", ["plc", "ros"])
def test_killed_answerer(shm_namespace: Namespace, tmp_path: Path, server: str) -> None:
    """It dies at each step of a call: nothing is executed twice, or reported as not executed if it was."""
    path = tmp_path / "executed"
    calls = _Calls(shm_namespace, server, path)
    try:
        token = 0
        for step in ("taken", "looked", "executed", "answered"):
            calls.restart(step, 1)
            for _ in range(4):
                token += 1
                calls.call(token)
        executed = [line[0] for line in _lines(path)]
        assert _problems(executed, calls.told) == []
        assert sorted(calls.told) == list(range(1, token + 1))
        outcomes = Counter(calls.told.values())
        # The second call of each round meets the kill: what was taken and not answered is unknown.
        assert outcomes[spec.ANSWER_FATE_UNKNOWN] == 3
        # And the call behind the last kill may have been handed out to a PLC that was dead by then.
        refused = outcomes[spec.ANSWER_NOT_EXECUTED]
        assert refused <= (1 if server == "plc" else 0)
        assert outcomes[spec.ANSWER_DONE] == token - 3 - refused
    finally:
        calls.close()


@pytest.mark.parametrize("sabotage", ["", "last := 0"])
def test_a_new_life_executes_nothing_that_waited(
    shm_namespace: Namespace, tmp_path: Path, sabotage: str
) -> None:
    """It finds a call that the one before has executed; one that starts with last := 0 executes it again."""
    calls = _Calls(shm_namespace, "plc", path := tmp_path / "executed", sabotage)
    try:
        calls.restart("executed", 0)
        calls.caller.call(calls.send(1))
        calls.child.wait(60)
        calls.restart()
        calls.wait(1)
        calls.call(2)
        problems = _problems([line[0] for line in _lines(path)], calls.told)
        assert bool(problems) is bool(sabotage), problems
    finally:
        calls.close()


@pytest.mark.parametrize("sabotage", ["", "no second look"])
def test_a_withdrawal_between_taking_and_acting(
    shm_namespace: Namespace, tmp_path: Path, sabotage: str
) -> None:
    """The answerer is held up; one that does not look at head again executes what was withdrawn.

    ``taken`` is put back as if it had been held up before it stored it.
    """
    calls = _Calls(shm_namespace, "plc", path := tmp_path / "executed", sabotage)
    try:
        calls.restart("pause taken", 0)
        calls.caller.call(calls.send(1))
        assert until(calls.child, "paused") == "paused"
        taken = spec.reader_line(0) + spec.READER_LINE["taken"]
        calls.asks.region.store(taken, 0)
        assert calls.caller.withdraw(calls.send(1)) is False
        calls.told[1] = spec.ANSWER_NOT_EXECUTED
        assert calls.child.stdin is not None
        calls.child.stdin.write("\n")
        calls.child.stdin.flush()
        calls.call(2)
        problems = _problems([line[0] for line in _lines(path)], calls.told)
        assert bool(problems) is bool(sabotage), problems
    finally:
        calls.close()


class _Server:
    """A PLC's server in this process, for callers in others."""

    def __init__(self, namespace: Namespace) -> None:
        self.asks = attach(namespace, "/add", part=Part.REQUEST, write=True)
        self.answers = attach(namespace, "/add", part=Part.RESPONSE, write=True)
        self.writer, self.reader = self.answers.writer(), acting_reader(self.asks)
        self.answerer = Answerer(self.asks, self.reader, self.answers)
        self.executed: list[int] = []

    def scan(self, *, reply: bool = True) -> int:
        """Act on a new message; return the number of the call that was begun, 0 none."""
        record = bytearray(64)
        info = self.reader.latest(record)
        self.writer.beat()
        found = "" if info is None else self.answerer.take(info)
        if info is None or found not in ("begin", "withdrawn"):
            return 0
        if found == "begin":
            self.executed.append(int.from_bytes(record[:8], "little"))
        if reply:
            self.answer(info.correlation, spec.ANSWER_DONE if found == "begin" else spec.ANSWER_NOT_EXECUTED)
        return info.correlation

    def answer(self, correlation: int, status: int = spec.ANSWER_DONE) -> None:
        self.writer.publish(bytes(32), correlation=correlation, status=status)
        self.answerer.answered(correlation)

    def close(self) -> None:
        self.asks.close()
        self.answers.close()


def _caller(
    namespace: Namespace, path: Path, step: str = "", number: int = 0, sabotage: str = ""
) -> subprocess.Popen[str]:
    return start_child(_CALLER, namespace.prefix, "plc", step, number, path, sabotage)


def _tell(child: subprocess.Popen[str], *tokens: int) -> None:
    assert child.stdin is not None
    child.stdin.write("".join(f"{token}\n" for token in tokens))
    child.stdin.flush()


@pytest.mark.parametrize("reply_late", [False, True])
def test_killed_caller(shm_namespace: Namespace, tmp_path: Path, reply_late: bool) -> None:
    """It dies at each step of a call; the next one finishes what it finds open, nothing is executed twice."""
    path = tmp_path / "told"
    child = _caller(shm_namespace, path)
    until(child, "ready")
    server = _Server(shm_namespace)
    try:
        token = 0
        for step in ("written", "withdrawn", "reported"):
            _stop(child)
            child = _caller(shm_namespace, path, step, 2)
            watchdog = time.monotonic() + 60
            _tell(child, *range(token + 1, token + 4))
            while child.poll() is None:
                assert time.monotonic() < watchdog
                server.scan()
            token += 3
            if not reply_late:
                server.scan()
            _stop(child)
            child = _caller(shm_namespace, path)
            _tell(child, token := token + 1)
            os.set_blocking(child.stdout.fileno(), False)  # type: ignore[union-attr]
            while not path.exists() or all(line[0] != token for line in _lines(path)):
                assert time.monotonic() < watchdog
                server.scan()
            os.set_blocking(child.stdout.fileno(), True)  # type: ignore[union-attr]
            token += 2  # the next round begins behind a multiple of three
        told: dict[int, int] = {}
        for number, outcome in _lines(path):
            assert number not in told, "reported twice"
            told[number] = outcome
        assert _problems(server.executed, told) == []
        assert spec.ANSWER_DONE in told.values()
    finally:
        _stop(child)
        server.close()


@pytest.mark.parametrize("sabotage", ["no resume", "no resume, no epoch"])
def test_an_answer_for_an_earlier_life(shm_namespace: Namespace, tmp_path: Path, sabotage: str) -> None:
    """It comes when the restarted caller has a call open; numbers without the claim make it that call's."""
    path = tmp_path / "told"
    child = _caller(shm_namespace, path, "written", 0, sabotage)
    until(child, "ready")
    server = _Server(shm_namespace)
    try:
        _tell(child, 1)
        child.wait(60)
        first = server.scan(reply=False)
        assert first
        _stop(child)
        child = _caller(shm_namespace, path, "pause written", 0, sabotage)
        until(child, "ready")
        _tell(child, 2)
        assert until(child, "paused") == "paused"
        server.answer(first)
        _tell(child, 0)
        told: dict[int, int] = {}
        watchdog = time.monotonic() + 60
        while "epoch" in sabotage and not told:
            assert time.monotonic() < watchdog
            told = dict(_lines(path))  # type: ignore[arg-type]
        if not told:
            while not server.scan():
                assert time.monotonic() < watchdog
            while not told:
                assert time.monotonic() < watchdog
                told = dict(_lines(path))  # type: ignore[arg-type]
        problems = _problems(server.executed, told)
        assert bool(problems) is ("epoch" in sabotage), problems
    finally:
        _stop(child)
        server.close()
