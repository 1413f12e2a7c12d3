"""Calls and goals while bridge, PLC and robot are killed at each step: at most once, and no wrong word.

The truth is in files: each executor's own, written before it acts, and each caller's. No counter is believed;
the bridge's are compared with the files.
"""

from __future__ import annotations

import os
import random
import select
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import NoReturn

import pytest

from rosplc.demo.plan import FreeDomain
from rosplc.shm import Namespace
from tests.crash.call_peers import ACTION, CALLS, GOALS_FROM_ROS, GOALS_OF_PLC, TYPE
from tests.lib.waiting import WATCHDOG_S, wait_for

pytestmark = pytest.mark.verifies("calls-once", own="processes killed at each step")

ROOT = Path(__file__).resolve().parents[2]
ROLES = ("bridge", "plc", "robot")
GOAL_ROLES = ("bridge", "goal-plc", "goal-robot")
EXPIRE_S = 0.5
SLACK_S = 3.5
OUTSTANDING = 5
"""Calls of one caller that a bridge can have at its end: as many as may wait, and one that has just come."""
LOSE_GOALS = {*GOALS_FROM_ROS, "bridge: goal taken", "bridge: goal sent"}
"""Kills that may meet a goal of the PLC's on its way to ROS: nobody knows then."""


class Cell:
    """Bridge, PLC and robot, each a process that can be killed."""

    def __init__(self, folder: Path, namespace: Namespace, domain: int, sabotage: str, goals: bool) -> None:
        self.folder, self.roles = folder, GOAL_ROLES if goals else ROLES
        for name, parts in (("srv/Do.srv", 2), ("action/Work.action", 3)):
            definition = folder / "types/cell_msgs" / name
            definition.parent.mkdir(parents=True)
            definition.write_text("---\n".join(["string token\n"] * parts))
        (folder / "where").write_text(f"{namespace.prefix} {domain}")
        uses = (
            f"services:\n  /do: {{type: {TYPE}, server: plc, expire_after: {EXPIRE_S:g}s}}\n"
            f"  /move: {{type: {TYPE}, server: ros}}\n",
            f"actions:\n  /work: {{type: {ACTION}, server: plc, accept_within: {EXPIRE_S:g}s}}\n"
            f"  /arm: {{type: {ACTION}, server: ros}}\n",
        )
        (folder / "rosplc.yaml").write_text(
            f"prefix: {namespace.prefix}\nros: {{backend: dds, domain: {domain}}}\nbeat: 20ms\n"
            "types: {paths: [types]}\ndiagnostics: {enabled: false}\n" + uses[goals]
        )
        self.running: dict[str, int] = {}
        self._losses = 0  # goals of the PLC's whose fate may be unknown
        self._found: list[str] = []
        self._heard: list[list[str]] = []
        self._rest = b""
        command = [sys.executable, "-m", "tests.crash.call_peers", str(folder), sabotage]
        pipe = subprocess.PIPE
        with (folder / "peers.log").open("wb") as errors:
            self._starter = subprocess.Popen(
                command, cwd=ROOT, stdin=pipe, stdout=pipe, stderr=errors, bufsize=0
            )

    def _tell(self, *words: object) -> None:
        assert self._starter.stdin is not None
        self._starter.stdin.write(("|".join(map(str, words)) + "\n").encode())

    def _hear(self, *words: object) -> int:
        """Return the number at the end of a line that begins with these words, and take the line.

        A process that was just started may say that it is ready before its starter says that it started.
        """
        assert self._starter.stdout is not None
        wanted, ends = list(map(str, words)), time.monotonic() + WATCHDOG_S
        while True:
            for found in self._heard:
                if found[: len(wanted)] == wanted:
                    self._heard.remove(found)
                    return int(found[-1])
            if not select.select([self._starter.stdout], [], [], max(0, ends - time.monotonic()))[0]:
                self._fail(f"no {' '.join(wanted)!r} came from the peers")
            if not (data := os.read(self._starter.stdout.fileno(), 65536)):
                self._fail(f"the peers' starter has ended before it wrote {' '.join(wanted)!r}")
            *lines, self._rest = (self._rest + data).split(b"\n")
            self._heard += (line.decode().split() for line in lines)

    def _fail(self, what: str) -> NoReturn:
        """Fail with what all processes are doing, and the end of what they wrote."""
        log = self.folder / "peers.log"
        for number in self.running.values():  # one after the other, or their lines are mixed
            count = log.read_text().count("Current thread")
            with suppress(ProcessLookupError, AssertionError):
                os.kill(number, signal.SIGUSR1)
                wait_for(
                    partial(lambda least: log.read_text().count("Current thread") > least, count), seconds=2
                )
        newest = [f"{path.name}: {self.lines(path.name)[-3:]}" for path in sorted(self.folder.glob("*-*"))]
        raise AssertionError(
            "\n".join([f"{what}; running: {self.running}", *newest, log.read_text()[-20_000:]])
        )

    def wait_for(self, condition: Callable[[], object], what: str, every: float = 0.05) -> None:
        try:
            wait_for(condition, what, every=every)
        except AssertionError as error:
            self._fail(str(error))

    def start(self, role: str, step: str = "", passes: int = 0) -> None:
        self._tell("start", role, step, passes)
        number = self.running[role] = self._hear("started")
        if not step:  # one that is to die may be quick
            self._hear("ready", number)

    def wait(self, role: str, status: int) -> None:
        """Wait for a process's end with a status."""
        self._tell("wait", self.running[role])
        if (found := self._hear("ended", self.running[role])) != status:
            self._fail(f"{role} ended with {found}, not with {status}")
        del self.running[role]
        self._heard.clear()  # what it said before it died

    def end(self, role: str) -> None:
        os.kill(self.running[role], signal.SIGTERM)
        self.wait(role, 0)

    def kill(self, role: str) -> None:
        os.kill(self.running[role], signal.SIGKILL)
        self.wait(role, -signal.SIGKILL)

    def kill_at(self, step: str, passes: int) -> None:
        """Run a process that dies at a step, beside two that do not."""
        role = step.partition(":")[0]
        self._losses += step in LOSE_GOALS
        if role == "goal-robot":
            self._expect_losses()
        if role in self.running:
            self.end(role)
        self.complete(role)
        self.start(role, step, passes)
        self.wait(role, -signal.SIGKILL)

    def _expect_losses(self) -> None:
        """From now on robots die, and goals of the PLC's with them; until now few may have been lost."""
        if self.roles is ROLES or (self.folder / "impatient").exists():
            return
        # A PLC that a busy machine holds up is silent, and its goal is canceled.
        fine = {"done", "forgotten", "PLC_DOWN"}
        lost = [line for line in self.lines("ended-at-plc") if not fine.intersection(line)]
        if len(lost) > self._losses:
            self._found.append(f"goals that have not reached their end, though their robot lived: {lost}")
        (self.folder / "impatient").touch()

    def complete(self, but: str = "") -> None:
        """Start what is not running."""
        for role in self.roles:
            if role != but and role not in self.running:
                self.start(role)

    def kill_at_random(self, times: int, chance: random.Random) -> None:
        self._expect_losses()
        for _ in range(times):
            self.complete()
            time.sleep(chance.random())  # when the kill comes, and nothing is concluded from it
            self.kill(chance.choice(self.roles))
        self.complete()

    def done(self) -> list[int]:
        """Return how many calls were answered, ROS' and the PLC's."""
        paths = [self.folder / f"ended-at-{who}" for who in ("ros", "plc")]
        return [path.read_text().count(" done ") if path.exists() else 0 for path in paths]

    def until_more(self, count: int = 3) -> None:
        wanted = [was + count for was in self.done()]
        self.wait_for(
            lambda: all(now >= least for now, least in zip(self.done(), wanted, strict=True)), "calls"
        )

    def call_late(self) -> None:
        """Have the robot make a call that waits for longer than it may."""
        self.complete()
        self.end(self.roles[2])
        self.start(self.roles[2], "late")
        self.wait(self.roles[2], 0)

    def close(self) -> None:
        for number in self.running.values():
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        for pipe in (self._starter.stdin, self._starter.stdout):
            assert pipe is not None
            pipe.close()
        self._starter.wait(WATCHDOG_S)

    def kills(self) -> Counter[str]:
        """Return how many processes have killed themselves at each step, as they noted."""
        return Counter(" ".join(words[:-1]) for words in self.lines("killed-at"))

    def lines(self, name: str) -> list[list[str]]:
        path = self.folder / name
        return [line.split() for line in path.read_text().splitlines()] if path.exists() else []

    def check(self) -> list[str]:
        """Kill all, and return what the files hold against the calls."""
        for role in list(self.running):
            self.kill(role)
        self._expect_losses()
        found = list(self._found)
        for caller, executor in (("ros", "plc"), ("plc", "ros")):
            asked = {token: int(at) for token, at in self.lines(f"asked-by-{caller}")}
            executed, ended = self.lines(f"executed-by-{executor}"), self.lines(f"ended-at-{caller}")
            done = {token for token, _ in executed}
            found += [f"{token}: executed, though nobody asked" for token in done - asked.keys()]
            for what, lines in (("executed", executed), ("ended", ended)):
                times = Counter(line[0] for line in lines)
                found += [f"{token}: {what} {count} times" for token, count in times.items() if count > 1]
            for token, outcome, answer, *_ in ended:
                if outcome == "done" and (answer != token or token not in done):
                    found.append(f"{token}: answered with {answer}, executed: {token in done}")
                if outcome == "NOT_EXECUTED" and token in done:
                    found.append(f"{token}: called safe to repeat, and executed")
            if caller == "ros":
                longest = (EXPIRE_S + SLACK_S) * 1e9
                late = (token for token, at in executed if int(at) - asked.get(token, 0) > longest)
                found += [f"{token}: executed too late" for token in late]
            else:
                ends = {token for token, *_ in ended}
                names = [token for token in asked if token not in ends]
                lives = Counter(token.partition("-")[0] for token in names)
                found += [
                    f"{life}: {count} calls without an end" for life, count in lives.items() if count > 1
                ]
            counts = self._check_counts(found, executor, list(asked), done)
            for token, outcome, _, reason, *_ in ended if caller == "plc" else []:
                told = outcome.lower().removeprefix("goal_")
                if (
                    reason != "TIME_OUT"
                    and outcome != "forgotten"
                    and counts[token]
                    and told not in counts[token]
                ):
                    found.append(f"{token}: ended as {told} ({reason}), counted as {counts[token]}")
        return found

    def _check_counts(
        self, found: list[str], server: str, asked: list[str], executed: set[str]
    ) -> dict[str, list[str]]:
        """Check that each call which came is in one counter, or was open when its bridge ended."""
        noted = [line for line in self.lines("noted-by-bridge") if line[1] == server]
        names = {key: words[0] for _, _, key, what, *words in noted if what == "came"}
        counts: dict[str, list[str]] = defaultdict(list)
        for life in dict.fromkeys(line[0] for line in noted):
            lines = [line for line in noted if line[0] == life]
            came = list(dict.fromkeys(names[line[2]] for line in lines if line[3] == "came"))
            counted = [
                (names.get(key, key), words[0]) for _, _, key, what, *words in lines if what == "counted"
            ]
            times = Counter(token for token, _ in counted)
            found += [f"{token}: in {count} counters" for token, count in times.items() if count > 1]
            # What is open at the end keeps all that came after it from the server.
            first = next((at for at, token in enumerate(came) if token not in times), len(came))
            open_ones = [token for token in came if token not in times]
            passed = [token for token, outcome in counted if outcome != "not_executed"]
            if len(open_ones) > OUTSTANDING or set(passed).intersection(came[first:]):
                found += [f"{token}: in no counter" for token in open_ones]
            found += _lost(came, asked) if came and server == "plc" else []
            for token, outcome in counted:
                counts[token].append(outcome)
                if outcome in ("done", "late", "unreadable") and token not in executed:
                    found.append(f"{token}: counted as {outcome}, and not executed")
                if outcome == "not_executed" and token in executed:
                    found.append(f"{token}: counted as not executed, and executed")
        return counts


def _lost(came: list[str], asked: list[str]) -> list[str]:
    """Find what did not come to a bridge though something that its robot asked later did.

    The end of a robot's calls tells nothing: what it sent before the bridge had matched its writer is sent
    again by DDS, but only while the robot lives, and on a busy machine it may have died by then.
    """
    rest, there = asked[asked.index(came[0]) :], set(came)
    last = {token.partition("-")[0]: at for at, token in enumerate(rest) if token in there}
    return [
        f"{token}: sent by a robot that lived on, and lost"
        for at, token in enumerate(rest)
        if token not in there and at < last.get(token.partition("-")[0], 0)
    ]


@pytest.fixture
def domain() -> Iterator[int]:
    free = FreeDomain()
    yield free.number
    free.close()


@contextmanager
def _cell(
    folder: Path, namespace: Namespace, domain: int, steps: Mapping[str, object], sabotage: str = ""
) -> Iterator[Cell]:
    cell = Cell(folder, namespace, domain, sabotage, goals=steps is not CALLS)
    try:
        yield cell
    finally:
        cell.close()


GROUPS = {"calls": CALLS, "goals from ROS": GOALS_FROM_ROS, "goals of the PLC": GOALS_OF_PLC}


@pytest.mark.parametrize(
    "share", [slice(1, None, 4), pytest.param(slice(None), marks=pytest.mark.foreign)], ids=["some", "all"]
)
@pytest.mark.parametrize("steps", GROUPS.values(), ids=GROUPS)
def test_each_step(
    tmp_path: Path, shm_namespace: Namespace, domain: int, steps: Mapping[str, object], share: slice
) -> None:
    """Each step kills once, and a few kills come at any time; what was answered stays true.

    What was accepted is executed once, and what was rejected is not; a goal of the PLC's goes on with the
    next bridge, wherever the one before was killed.
    """
    chance = random.Random(1)
    with _cell(tmp_path, shm_namespace, domain, steps) as cell:
        for step in list(steps)[share]:
            cell.kill_at(step, chance.randint(1, 4))
        cell.kill_at_random(4, chance)
        cell.until_more()
        if steps is not GOALS_OF_PLC:
            cell.call_late()
        assert cell.check() == []
    assert cell.kills() == dict.fromkeys(list(steps)[share], 1)
    assert not any(line[0].startswith("late") for line in cell.lines("executed-by-plc"))


@pytest.mark.parametrize(
    ("came", "lost"),
    [
        ("r1-1 r1-3 r2-1", ["r1-2"]),
        ("r1-1 r1-2 r1-3 r3-1", []),
        ("r1-2 r1-3 r2-2 r3-1", ["r2-1"]),
        ("r2-1 r3-1", []),
    ],
)
def test_what_the_check_calls_lost(came: str, lost: list[str]) -> None:
    """A robot that dies at once may have sent to a bridge that had not found it yet."""
    found = _lost(came.split(), ["r1-1", "r1-2", "r1-3", "r2-1", "r2-2", "r3-1"])
    assert [line.partition(":")[0] for line in found] == lost


def test_a_goal_that_stays_open_while_others_are_refused(
    tmp_path: Path, shm_namespace: Namespace, domain: int
) -> None:
    """A bridge may be killed with a goal that a dead PLC has begun, however many it has refused since."""
    with _cell(tmp_path, shm_namespace, domain, GOALS_FROM_ROS) as cell:
        cell.kill_at("goal-plc: begun", 1)
        asked = len(cell.lines("asked-by-ros"))
        cell.wait_for(
            lambda: len(cell.lines("asked-by-ros")) > asked + OUTSTANDING + 1, "goals that are refused"
        )
        assert cell.check() == []


@pytest.mark.foreign
@pytest.mark.parametrize(
    ("sabotage", "steps", "step", "words"),
    [
        ("republish", CALLS, "bridge: answer taken", "executed 2 times"),
        ("republish", GOALS_FROM_ROS, "bridge: end taken", "executed 2 times"),
        ("last := 0", CALLS, "", "executed 2 times"),
        ("last := 0", GOALS_FROM_ROS, "goal-plc: begun", "executed 2 times"),
        ("duplicate", GOALS_OF_PLC, "bridge: state written", "called safe to repeat, and executed"),
        ("no count", CALLS, "", "in no counter"),
    ],
)
def test_the_check_sees_a_sabotage(
    tmp_path: Path,
    shm_namespace: Namespace,
    domain: int,
    sabotage: str,
    steps: Mapping[str, object],
    step: str,
    words: str,
) -> None:
    """A window may be missed on a busy machine, so it is tried until the check turns red.

    Correlations without the epoch are sabotaged in ``test_call_killed.py``, and for the bridge in
    ``unit/bridge/test_calls.py``, where a late answer can be timed.
    """
    with _cell(tmp_path, shm_namespace, domain, steps, sabotage) as cell:
        for _ in range(60):
            if step:
                cell.kill_at(step, 1)
            cell.complete()
            cell.until_more(OUTSTANDING + 1 if steps is CALLS else 1)
            if any(words in line for line in cell.check()):
                return
        raise AssertionError(f"not found: {words}")


@pytest.mark.foreign
@pytest.mark.parametrize("steps", [CALLS, GOALS_FROM_ROS], ids=["calls", "goals"])
def test_the_check_sees_that_nothing_expires(
    tmp_path: Path, shm_namespace: Namespace, domain: int, steps: Mapping[str, object]
) -> None:
    """A PLC that is held up on a busy machine is silent, and gets no call: it is tried until one is late."""
    with _cell(tmp_path, shm_namespace, domain, steps, "no expiry") as cell:
        for _ in range(10):
            cell.call_late()
            if any(line.startswith("late") and "executed too late" in line for line in cell.check()):
                return
        raise AssertionError("nothing was executed too late")


@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    "kills",  # a run whose time is short still reaches each step
    [
        pytest.param(25, marks=pytest.mark.verify(minutes=0.3)),
        pytest.param(300, marks=pytest.mark.verify(minutes=2)),
    ],
)
@pytest.mark.parametrize(
    ("group", "step"), [(group, step) for group, steps in GROUPS.items() for step in steps]
)
def test_many_kills_at_one_step(
    tmp_path: Path,
    shm_namespace: Namespace,
    domain: int,
    group: str,
    step: str,
    kills: int,
    record_property: Callable[[str, object], None],
) -> None:
    chance = random.Random(2)
    with _cell(tmp_path, shm_namespace, domain, GROUPS[group]) as cell:
        for _ in range(kills):
            cell.kill_at(step, chance.randint(1, 4))
        cell.complete()
        cell.until_more()
        found = cell.check()
        asked = [len(cell.lines(f"asked-by-{who}")) for who in ("ros", "plc")]
        record_property(
            f"{group}, {step}",
            f"{cell.kills()[step]} kills, {asked[0]} from ROS and {asked[1]} from the PLC, "
            f"answered {cell.done()}, wrong {len(found)}",
        )
        assert found == []
    assert cell.kills() == {step: kills}


@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    ("group", "number"),
    [
        pytest.param("goals from ROS", 10_000, marks=pytest.mark.verify(minutes=10)),
        pytest.param("calls", 100_000, marks=pytest.mark.verify(minutes=20)),
    ],
)
def test_kills_at_any_time(
    tmp_path: Path,
    shm_namespace: Namespace,
    domain: int,
    group: str,
    number: int,
    record_property: Callable[[str, object], None],
) -> None:
    """Both directions together, while bridge, PLC and robot are killed at any time."""
    chance = random.Random(3)
    with _cell(tmp_path, shm_namespace, domain, GROUPS[group]) as cell:
        for least in range(number // 100, number + 1, number // 100):
            cell.kill_at_random(3, chance)
            cell.wait_for(partial(lambda least: sum(cell.done()) >= least, least), "answers", every=0.5)
        found = cell.check()
        record_property(f"{group}, at any time", f"300 kills, answered {cell.done()}, wrong {len(found)}")
        assert found == []
