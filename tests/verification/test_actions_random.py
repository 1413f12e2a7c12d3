"""Both sides of actions step at random, as those of services do."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import pytest

from rosplc.shm import constants as spec
from rosplc.shm.constants import ErrorNumber
from tests.verification.call_cell import ActionCaller, ActionServer
from tests.verification.test_services_random import (
    Calling,
    Serving,
    answer_to,
    campaign,
    change,
    folder,
)

pytestmark = pytest.mark.verifies("call-blocks", own="translated Structured Text, 64 and 32 bits; SIGKILL")

__all__ = ["folder"]

CANCEL, WITHDRAWN = spec.ASK_CALL + spec.ASK_CANCEL, spec.ASK_WITHDRAWN
ENDS = (spec.ANSWER_SUCCEEDED, spec.ANSWER_CANCELED, spec.ANSWER_ABORTED)


class Asking(Calling):
    """The bridge as caller of an action in the PLC; what the PLC accepts counts as executed."""

    kind = ActionCaller
    accepted = 0  # the goal that the program has accepted
    known = False  # the caller knows of it

    def _step(self) -> None:
        end = cast(ActionCaller, self.end)
        if report := end.reported():
            assert report[2] == (report[1] & 0x7FFF), "feedback of another goal"
        if (answer := end.answer()) and self.token and answer[1] == self.correlation:
            status, _, value, _ = answer
            outcome = status & spec.ANSWER_MASK
            self.known = True
            if outcome != spec.ANSWER_ACCEPTED:
                token, self.token = self.token, 0
                if outcome in ENDS:
                    self.ledger.answered(token, value)
                elif outcome == spec.ANSWER_NOT_EXECUTED and self._claim() == self.claim:
                    self.ledger.not_executed(token)
        draw = self.dice.random()
        if self.token and (self._claim() != self.claim or (not self.known and draw < 0.03)):
            token, self.token = self.token, 0
            if not end.withdraw():
                self.ledger.not_executed(token)
        elif self.token and draw < 0.1:
            end.ask(self.dice.choice([spec.ASK_CALL + spec.ASK_ACCEPTED, CANCEL, CANCEL + spec.ASK_PREEMPT]))
        elif not self.token and self._claim() and draw < 0.5:
            self.claim, self.known = self._claim(), False
            self.tokens += 1
            self.token = self.tokens
            self.correlation = end.call(self.token)

    def program(self) -> None:
        """Be the PLC's program: accept, follow and end goals."""
        end, dice = self.end, self.dice
        steps = ("xAccept", "xReject", "xAcceptCancel", "xRejectCancel", "xSucceed", "xAbort", "xCanceled")
        end.set(**dict.fromkeys(steps, False))
        goal, active, asked, canceling = end.get("xGoal", "xActive", "xCancelRequested", "xCanceling")
        if active and not self.accepted:
            self.accepted = end.get("goal.data")
            self.ledger.execute(self.accepted)
        elif not active:
            self.accepted = 0
        draw = dice.random()
        if goal and draw < 0.5:
            end.set(**{dice.choice(["xAccept", "xAccept", "xReject"]): True})
        elif asked and draw < 0.5:
            end.set(**{dice.choice(["xAcceptCancel", "xRejectCancel"]): True})
        elif active and draw < 0.3:
            how = ["xSucceed", "xAbort", *(["xCanceled"] if canceling else [])]
            end.set(**{"result.data": answer_to(self.accepted), dice.choice(how): True})


class Following(Serving):
    """The bridge as answerer of an action, with a PLC that sends goals."""

    kind = ActionServer

    def _step(self) -> None:
        end, dice = cast(ActionServer, self.end), self.dice
        draw = dice.random()
        if draw < 0.3 and (asked := end.take()):
            status, correlation, token = asked
            epoch = end.channels[0].region.word(spec.WRITER_LINE["writer_epoch"])
            if self.open and correlation == self.open[0]:
                if status & spec.ASK_CANCEL and dice.random() < 0.5:
                    end.answer(correlation, spec.ANSWER_ACCEPTED + spec.ANSWER_CANCEL_ACCEPTED)
                elif status & spec.ASK_CANCEL:
                    end.answer(correlation, spec.ANSWER_ACCEPTED + spec.ANSWER_CANCEL_REJECTED)
            elif correlation in self.old:
                pass  # it has had its answer
            elif status & WITHDRAWN:
                end.answer(correlation, spec.ANSWER_NOT_EXECUTED)
            elif correlation >> 32 == epoch and end.requests.begin():
                assert not self.open or self.open[0] >> 32 != epoch, "a goal beside one that has not ended"
                self.ledger.execute(token)
                self.open = correlation, token
                end.answer(correlation, spec.ANSWER_ACCEPTED)
        elif draw < 0.4 and self.open:
            (correlation, token), self.open = self.open, None
            self.old.append(correlation)
            end.answer(correlation, dice.choice([*ENDS, *ENDS[:1] * 4]), answer_to(token))
        elif draw < 0.6 and self.open:
            end.report(self.open[0], self.open[1] & 0x7FFF)
        elif draw < 0.62 and self.open and self.old:
            end.answer(dice.choice(self.old), spec.ANSWER_SUCCEEDED, -1)

    def program(self) -> None:
        """Be the PLC's program: send goals, follow, cancel."""
        end, dice = self.end, self.dice
        if end.get("xNewFeedback") and end.get("xBusy"):
            assert end.get("feedback.data") == self.token & 0x7FFF
        if end.get("xBusy"):
            end.set(xCancel=dice.random() < 0.03)
            return
        if self.token:
            if end.get("xDone"):
                self.ledger.answered(self.token, end.get("result.data"))
            elif end.get("eError") == ErrorNumber.NOT_EXECUTED:
                self.ledger.not_executed(self.token)
            self.token = 0
        end.set(xCancel=False)
        if end.get("xExecute"):
            end.set(xExecute=False)
        elif dice.random() < 0.7:
            self.tokens += 1
            self.token = self.tokens
            end.set(**{"xExecute": True, "tTimeout": dice.choice([0, 50, 500]), "goal.data": self.token})


@pytest.mark.parametrize("kind", [Asking, Following])
@pytest.mark.parametrize("rule", ["32-bit-with-barrier", "delayed", "C11"])
@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.foreign) for n in (1, 2))])
def test_at_most_once(folder: Path, kind: type[Asking | Following], rule: str, seed: int) -> None:
    """Whatever is stopped, killed or replaced, at whichever fence."""
    ledger = campaign(folder, kind, rule, seed)
    assert ledger.done > 5
    assert ledger.never


SABOTAGES = {
    "a goal beside another": (
        Following,
        change("RosPlc_ActionClient", ("xOwed := xAccepted OR xGone OR stOut.xTaken;", "xOwed := xOwed;")),
    ),
    "answers of any goal count": (
        Following,
        change("RosPlc_Caller", ("stOther := stMine) THEN", "stOther := stIn.stCall) THEN")),
    ),
    "a goal that ended begins again": (
        Asking,
        change(
            "RosPlc_Answerer",
            ("xFound := xFound OR NOT xAgain;", "xFound := TRUE;"),
            ("stNow.udiStatus <> RosPlc_Format.ASK_CALL", "FALSE"),
        ),
    ),
}


@pytest.mark.foreign
@pytest.mark.parametrize("name", SABOTAGES)
def test_a_rule_that_is_left_out_is_found(folder: Path, name: str) -> None:
    """The checker fails where the blocks leave a rule out."""
    kind, sabotage = SABOTAGES[name]
    with pytest.raises(AssertionError):
        for seed in range(12):
            (folder / str(seed)).mkdir()
            campaign(folder / str(seed), kind, "32-bit-with-barrier", seed, sabotage)
