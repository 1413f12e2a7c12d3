"""The blocks of the virtual PLC and of plc.h do as the Structured Text does, whatever happens to a call."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

import pytest

from rosplc.shm import constants as spec
from tests.verification.call_cell import (
    ActionCaller,
    ActionServer,
    CallCell,
    Caller,
    Server,
    Use,
    made_cell,
)

pytestmark = pytest.mark.verifies("blocks-conform", own="the same scans for all blocks")

STEPS, SEEDS = 300, 2
CALLING = ("xDone", "xBusy", "xError", "xAborted", "eError", "eReason", "xServer", "udiCalls", "udiLate")
SERVING = ("xCallerGone", "udiCalls", "udiRefused", "udiError", "tAge")
GOAL = ("xActive", "xCancelRejected", "eStatus", "xNewFeedback", "feedback.data", "result.data")
SERVED_GOAL = ("xGoal", "xActive", "xCancelRequested", "xCanceling", "xPreempt", "goal.data")
STEPPING = ("xAccept", "xReject", "xAcceptCancel", "xRejectCancel", "xSucceed", "xAbort", "xCanceled")
KINDS: dict[type[Use], tuple[tuple[str, ...], tuple[str, ...]]] = {
    Server: (("xExecute", "xAbort"), (*CALLING, "response.data")),
    ActionServer: (("xExecute", "xCancel"), (*CALLING, *GOAL)),
    Caller: (("xReply", "xReject"), (*SERVING, "xRequest", "request.data")),
    ActionCaller: ((*STEPPING, "xSendFeedback"), (*SERVING, *SERVED_GOAL)),
}
"""The bridge's side → inputs and outputs of the PLC's block."""
ANSWERS = {
    Server: (1, 2, 3, 4),
    ActionServer: (2, 3, 4, 5, 5, 5, 5 | 256, 5 | 512, 6, 7, 8, 6 | 1024, 8 | 1024),
}


class Pair:
    """The bridge's sides of two PLCs, to which the same happens."""

    def __init__(self, sides: Sequence[Any], seed: int) -> None:
        self.sides, self.draw = sides, random.Random(seed)
        self.numbers: list[int] = []  # of the call that each PLC has made
        self.open = False  # a call of the bridge

    def each(self, method: str, *arguments: Any) -> list[Any]:
        """Do something on both sides; the results must agree but for the claims in numbers."""
        found = [getattr(side, method)(*arguments) for side in self.sides]
        plain = [
            one and (one[0], one[1] & 0xFFFFFFFF, *one[2:]) if isinstance(one, tuple) else one
            for one in found
        ]
        assert plain[0] == plain[1] or method == "call"
        return found

    def answer(self, kind: type[Use]) -> None:
        """Let the bridges answer the call of the PLCs, or an earlier one."""
        earlier, value = self.draw.choice((0, 0, 0, 0, 1)), self.draw.randrange(1, 100)
        status, reason = self.draw.choice(ANSWERS[kind]), self.draw.randrange(11)
        feedback = kind is ActionServer and self.draw.random() < 0.2
        for side, number in zip(self.sides, self.numbers, strict=True):
            if feedback:
                side.report(number, value)
            else:
                side.answer(number - earlier, status, value, reason)

    def step(self, kind: type[Use]) -> None:
        """Do something at random."""
        what = self.draw.choices(("pin", "limit", "read", "go on"), (35, 2, 23, 25))[0]
        if what == "pin":
            pin, value = self.draw.choice(KINDS[kind][0]), self.draw.random() < 0.5
            for side in self.sides:
                side.set(**{pin: value})
        elif kind in ANSWERS:
            limit = self.draw.choice((0, 0, 30, 200))
            if what == "limit":
                pin = self.draw.choice(("tTimeout", "tBridgeGrace"))
                for side in self.sides:
                    side.set(**{pin: limit})
            elif what == "read" and (taken := self.each("take"))[0]:
                self.numbers = [one[1] for one in taken]
            elif what == "go on" and self.numbers:
                self.answer(kind)
        elif what == "read":
            answer = self.each("answer")[0]
            ended = answer and answer[0] & spec.ANSWER_MASK != spec.ANSWER_ACCEPTED
            self.open = self.open and not (ended and answer[1] == self.sides[0].correlation)
        elif what == "go on" and not self.open:
            self.each("call", self.draw.randrange(1, 100))
            self.open = True
        elif what == "go on" and self.draw.random() < 0.3:
            begun = [side.withdraw() for side in self.sides]
            self.open = any(begun)
        elif what == "go on" and kind is ActionCaller and self.sides[0].get("xActive"):
            self.each("ask", spec.ASK_CALL + self.draw.choice((2, 4, 6, 16)))


@pytest.mark.parametrize("seed", range(SEEDS))
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("other", ["virtual", "C11"])
def test_the_same_pins_after_the_same_events(other: str, kind: type[Use], seed: int) -> None:
    """Scan by scan, both PLCs show and send the same."""
    with made_cell("fences") as text, made_cell(other) as second:
        cells: tuple[CallCell, ...] = (text, second)
        pair = Pair([kind(cell) for cell in cells], seed)  # type: ignore[call-arg]
        for cell in cells:
            cell.scan(300)
        for number in range(STEPS):
            pair.step(kind)
            step = pair.draw.choice((5, 10, 20))
            for cell in cells:
                cell.scan(step=step)
            shown = [dict(zip(KINDS[kind][1], side.get(*KINDS[kind][1]), strict=True)) for side in pair.sides]
            assert shown[0] == shown[1], f"after {number} steps"
        assert pair.sides[0].get("udiCalls") > 0
