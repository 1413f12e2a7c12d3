"""Both sides of services step at random, also inside a scan, and are stopped, killed and replaced.

Nothing is executed twice, or after it was given up; a rule that is left out is found.
"""

from __future__ import annotations

import random
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from rosplc.errors import ChannelError
from rosplc.shm import constants as spec
from rosplc.shm.constants import ErrorNumber
from tests.verification.c_plc import LANGUAGES
from tests.verification.call_cell import CallCell, Caller, Server, machine_of

pytestmark = pytest.mark.verifies("call-blocks", own="translated Structured Text, 64 and 32 bits; SIGKILL")

CLAIM = spec.READER_LINES_OFFSET + spec.READER_LINE["claim"]


@pytest.fixture
def folder() -> Iterator[Path]:
    made = Path(tempfile.mkdtemp(prefix="T", dir="/dev/shm"))
    yield made
    shutil.rmtree(made)


def answer_to(token: int) -> int:
    return token * 3 + 1


class Ledger:
    """What was executed, and what each caller was told; compared, not believed."""

    def __init__(self) -> None:
        self.executed: set[int] = set()
        self.never: set[int] = set()
        self.done = 0

    def execute(self, token: int) -> None:
        assert token not in self.executed, f"{token} is executed twice"
        assert token not in self.never, (
            f"{token} is executed, though its caller was told that it never will be"
        )
        self.executed.add(token)

    def not_executed(self, token: int) -> None:
        assert token not in self.executed, f"{token} was executed, though its caller is told that it was not"
        self.never.add(token)

    def answered(self, token: int, value: int) -> None:
        assert token in self.executed, f"{token} has an answer, but was not executed"
        assert value == answer_to(token), f"{token} has the answer to another call"
        self.done += 1


class Calling:
    """The bridge as caller, with a PLC that serves: what section 11 asks of it, and nothing more."""

    kind = Caller

    def __init__(self, cell: CallCell, dice: random.Random, ledger: Ledger) -> None:
        self.cell, self.dice, self.ledger = cell, dice, ledger
        self.end = self.kind(cell)
        self.token = self.tokens = 0  # of the open call; 0: none
        self.claim = 0
        self.shown = 0
        self.correlation = 0
        self.quiet = -1  # rounds for which the bridge only beats

    def step(self) -> None:
        """Do what a bridge may do at any time."""
        with suppress(ChannelError):
            self._step()

    def _claim(self) -> int:
        return self.end.channels[0].region.word(CLAIM)

    def _step(self) -> None:
        if answer := self.end.answer():
            status, correlation, value, _ = answer
            if self.token and correlation == self.correlation:
                token, self.token = self.token, 0
                if status == spec.ANSWER_DONE:
                    self.ledger.answered(token, value)
                elif status == spec.ANSWER_NOT_EXECUTED and self._claim() == self.claim:
                    self.ledger.not_executed(token)
        if self.token and (self._claim() != self.claim or self.dice.random() < 0.05):
            token, self.token = self.token, 0
            if not self.end.withdraw():
                self.ledger.not_executed(token)
        elif not self.token and self._claim() and self.dice.random() < 0.5:
            self.claim = self._claim()
            self.tokens += 1
            self.token = self.tokens
            self.correlation = self.end.call(self.token)

    def restart(self) -> None:
        """Die, and come back: the open call is withdrawn, or waited for."""
        before = self.end
        open_, self.token = self.token, 0
        before.close()
        self.end = self.kind(self.cell)
        if open_:
            record = before.value.to_bytes(8, "little")
            status = spec.ASK_CALL + spec.ASK_WITHDRAWN
            self.end.requests.publish(
                record, correlation=self.correlation, status=status, client=bytes(range(16))
            )
            if not self.end.requests.begun(before.first):
                self.ledger.not_executed(open_)

    def started(self) -> None:
        """The PLC has been started again."""

    def replaced(self) -> None:
        """The objects have been replaced."""
        self.token = 0

    def program(self) -> None:
        """Be the PLC's program: execute what is shown, and answer."""
        end = self.end
        if not end.get("xRequest"):
            end.set(xReply=False, xReject=False)
            self.shown = 0
            return
        if not self.shown:
            self.shown = end.get("request.data")
            self.ledger.execute(self.shown)
        elif self.dice.random() < 0.4:
            end.set(**{"response.data": answer_to(self.shown), "xReply": True})


class Serving:
    """The bridge as answerer, with a PLC that calls."""

    kind = Server

    def __init__(self, cell: CallCell, dice: random.Random, ledger: Ledger) -> None:
        self.cell, self.dice, self.ledger = cell, dice, ledger
        self.end = self.kind(cell)
        self.tokens = self.token = 0
        self.open: tuple[int, int] | None = None
        self.old: list[int] = []  # correlations of calls that are over
        self.quiet = -1

    def step(self) -> None:
        """Do what a bridge may do at any time."""
        with suppress(ChannelError):
            self._step()

    def _step(self) -> None:
        draw = self.dice.random()
        if draw < 0.3 and (asked := self.end.take()):
            status, correlation, token = asked
            epoch = self.end.channels[0].region.word(spec.WRITER_LINE["writer_epoch"])
            if self.open and correlation == self.open[0]:
                if status != spec.ASK_CALL:
                    self.open = None  # nobody waits: the answer may come late, or not at all
            elif status != spec.ASK_CALL:
                self.end.answer(correlation, spec.ANSWER_NOT_EXECUTED)
            elif correlation >> 32 == epoch and self.end.requests.begin():
                self.ledger.execute(token)
                self.open = correlation, token
        elif draw < 0.5 and self.open:
            (correlation, token), self.open = self.open, None
            self.old.append(correlation)
            self.end.answer(correlation, value=answer_to(token))
        elif draw < 0.52 and self.old[:-1]:
            self.end.answer(self.dice.choice(self.old[:-1]), value=-1)  # of a call long over

    def restart(self) -> None:
        """Die, and come back: what was taken and not answered has an unknown fate."""
        self.end.close()
        self.end = self.kind(self.cell)
        if self.open:
            self.end.answer(self.open[0], spec.ANSWER_FATE_UNKNOWN)
            self.old.append(self.open[0])
            self.open = None

    def started(self) -> None:
        """The PLC has been started again: it forgets its call."""
        self.token = 0

    def replaced(self) -> None:
        """The objects have been replaced."""
        self.open = None

    def program(self) -> None:
        """Be the PLC's program: call, wait, give up."""
        end, dice = self.end, self.dice
        if end.get("xBusy"):
            end.set(xAbort=dice.random() < 0.02)
            return
        if self.token:
            if end.get("xDone"):
                self.ledger.answered(self.token, end.get("response.data"))
            elif end.get("eError") == ErrorNumber.NOT_EXECUTED:
                self.ledger.not_executed(self.token)
            self.token = 0
        end.set(xAbort=False)
        if end.get("xExecute"):
            end.set(xExecute=False)
        elif dice.random() < 0.7:
            self.tokens += 1
            self.token = self.tokens
            end.set(**{"xExecute": True, "tTimeout": dice.choice([0, 50, 500]), "request.data": self.token})


def campaign(
    folder: Path,
    kind: type[Calling | Serving],
    rule: str,
    seed: int,
    sabotage: Callable[[dict[str, str]], dict[str, str]] | None = None,
    rounds: int = 1500,
) -> Ledger:
    """Run both sides for a while, from a seed."""
    dice, ledger = random.Random(seed), Ledger()
    cell = CallCell(folder, machine_of(rule, sabotage))
    peer = kind(cell, dice, ledger)

    def inside() -> None:
        if peer.quiet < 0 and dice.random() < 0.2:
            peer.step()

    try:
        for _ in range(rounds):
            if rule != "delayed":
                cell.machine.on_barrier(inside)
            cell.scan(step=dice.choice([1, 10, 10, 10, 40]))
            cell.machine.on_barrier(None)
            peer.program()
            peer.quiet -= 1
            for _ in range(dice.randrange(3) if peer.quiet < 0 else 0):
                peer.step()
            event = dice.random()
            if event < 0.01 and rule not in LANGUAGES:
                cell.machine.online_change()
            elif event < 0.02:
                if dice.random() < 0.5:
                    cell.machine.stop()  # else it is killed
                peer.quiet = dice.choice([0, 0, 80])
                if not peer.quiet:
                    peer.step()
                cell.machine.start()
                peer.started()
            elif event < 0.03:
                peer.restart()
            elif event < 0.033:
                peer.end.retire()
                peer.end = peer.kind(cell)  # type: ignore[assignment]
                peer.replaced()
    finally:
        cell.machine.stop()
        cell.close()
    return ledger


@pytest.mark.parametrize("kind", [Calling, Serving])
@pytest.mark.parametrize("rule", ["32-bit-with-barrier", "delayed", "C11"])
@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.foreign) for n in (1, 2))])
def test_at_most_once(folder: Path, kind: type[Calling | Serving], rule: str, seed: int) -> None:
    """Whatever is stopped, killed or replaced, at whichever fence."""
    ledger = campaign(folder, kind, rule, seed)
    assert ledger.done > 20
    assert ledger.never


def change(name: str, *pairs: tuple[str, str]) -> Callable[[dict[str, str]], dict[str, str]]:
    """Return what replaces lines of an object."""

    def sabotage(texts: dict[str, str]) -> dict[str, str]:
        text = texts[name]
        for old, new in pairs:
            assert old in text, old
            text = text.replace(old, new)
        return {**texts, name: text}

    return sabotage


HEAD = "pstHeader^.stWriter.udiHead"
SABOTAGES = {
    "last := 0 when attached": (
        Calling,
        change("RosPlc_CallReader", (f"udiLast := {HEAD};", "udiLast := 0;"), (f"udiUntil := {HEAD};", ";")),
    ),
    "correlation without epoch": (
        Serving,
        change("RosPlc_CallBlock", (" AND (stOne.udiCaller = stOther.udiCaller)", "")),
    ),
    "no second look at head": (
        Calling,
        change("RosPlc_CallReader", (f"({HEAD} = udiSequence)", "TRUE")),
    ),
    "no look at taken": (Serving, change("RosPlc_CallWriter", ("stPart.xTaken := TRUE;", ";"))),
}


@pytest.mark.foreign
@pytest.mark.parametrize("name", SABOTAGES)
def test_a_rule_that_is_left_out_is_found(folder: Path, name: str) -> None:
    """The checker fails where the blocks leave a rule out."""
    kind, sabotage = SABOTAGES[name]
    for seed in range(12):
        try:
            campaign(folder, kind, "32-bit-with-barrier", seed, sabotage)
        except AssertionError:
            return
        shutil.rmtree(folder)
        folder.mkdir()
    pytest.fail(f"{name}: nobody noticed")
