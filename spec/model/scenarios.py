"""The searches: what must hold, what must fail, and which limits are known.

A mutation removes one rule of the specification. It specifies the beginning of the text of the property
that must break, or explains why none breaks. Some rules are needed only under certain circumstances; for
these, there is a search with and one without these circumstances.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from calls import CallConfig, explore_calls
from explore import Result, explore
from protocol import Config

__all__ = ["HOLDS", "HOLDS_WITHOUT", "LARGE", "LIMITS", "MUTATIONS", "Scenario"]


@dataclass(frozen=True)
class Scenario:
    """One search and its expected result.

    Attributes:
        name: Unique, for the table and for tests.
        config: The bounded instance.
        breaks: How the text of the broken property begins; empty: every property holds.
        why: The reason for this result, in one sentence.
    """

    name: str
    config: Config | CallConfig
    breaks: str = ""
    why: str = field(default="", compare=False)

    def search(self) -> Result:
        """Visit every reachable state, or stop at the first broken property."""
        if isinstance(self.config, Config):
            return explore(self.config)
        return explore_calls(self.config)


def _both(name: str, breaks: str = "", why: str = "", **settings: Any) -> list[Scenario]:
    config = Config(**settings)
    return [
        Scenario(f"{name}, newest", config, breaks, why),
        Scenario(f"{name}, in order", replace(config, in_order=True), breaks, why),
    ]


WRAP = 29
"""A head three messages before the wrap of the modulus 32."""

PLAIN: dict[str, Any] = {"sealed": False}
"""Without a seal: the basis of section 7.4, and a test of each condition of M12 alone."""

DELAYED: dict[str, Any] = {"sealed": False, "f1": False, "margin": 3}
"""Section 7.4: one scan publishes s and fills s + 1 in any order; its end replaces F2."""

NEAR: dict[str, Any] = {"scribbles": 1, "scribble_near": True, "start": 8, "messages": 5}
FAR: dict[str, Any] = {"scribbles": 1, "start": 8, "messages": 5}

HOLDS: list[Scenario] = [
    *_both("from empty"),
    *_both("from empty, latched reader", latched=True),
    *_both("mid-stream, latched reader", latched=True, start=8),
    *_both("killed and restarted", messages=6, restarts=1),
    *_both("killed and restarted twice", messages=5, restarts=2),
    *_both("over the wrap", messages=7, start=WRAP),
    *_both("over the wrap, killed and restarted", messages=6, start=WRAP, restarts=1),
    *_both("head scribbled far away", **FAR),
    *_both("head scribbled far away, writer restarted", **{**FAR, "messages": 3}, restarts=1),
    *_both("head scribbled with any value", **NEAR),
    *_both("no seal", **PLAIN),
    *_both("no seal, killed and restarted", **PLAIN, messages=6, restarts=1),
    *_both("no seal, over the wrap", **PLAIN, messages=7, start=WRAP),
    *_both("no seal, head scribbled far away", **PLAIN, **FAR),
    *_both("delayed writer", **DELAYED),
    *_both("delayed writer, killed and restarted", **DELAYED, messages=6, restarts=1),
    *_both("delayed writer, over the wrap", **DELAYED, messages=6, start=WRAP),
    *_both("delayed writer, head scribbled far away", **DELAYED, **{**FAR, "messages": 4}),
    *_both("hand-over to the delayed rule", messages=6, handover=2),
    *_both("hand-over to the delayed rule, over the wrap", messages=6, handover=2, start=WRAP),
    *_both("hand-over to the delayed rule, killed and restarted", messages=5, handover=2, restarts=1),
    *_both("hand-over back to fences", messages=6, handover=2, handback=True),
    *_both(
        "hand-over back to fences, killed and restarted", messages=5, handover=2, handback=True, restarts=1
    ),
    Scenario("calls: the PLC answers", CallConfig()),
    Scenario("calls: the PLC answers, three lives", CallConfig(calls=1, lives=3)),
    Scenario("calls: the PLC answers, the caller restarts", CallConfig(lives=1, restarts=1)),
    Scenario("calls: the PLC answers, both restart", CallConfig(calls=1, restarts=1)),
    Scenario("calls: an answerer was only paused", CallConfig(calls=1, overlap=True)),
    Scenario("calls: a bridge answers", CallConfig(bridge_answers=True)),
    Scenario("calls: a bridge answers, three lives", CallConfig(calls=1, lives=3, bridge_answers=True)),
]

MUTATIONS: list[Scenario] = [
    *_both(
        "hand-over to the delayed rule, the rule loaded once",
        "torn",
        "with the first writer's window, a slot passes that the second writer is filling",
        messages=6,
        handover=2,
        rule_again=False,
    ),
    *_both(
        "without F1, no seal",
        "torn",
        "bytes of s overtake head = s - 1, and by its distance from head the slot seems untouched",
        f1=False,
        refusals=False,
        **PLAIN,
    ),
    Scenario(
        "without F1, in order",
        Config(f1=False, in_order=True),
        "message 1 refused",
        "the oldest message that must still be there is not",
    ),
    *_both("without F2", "message 1 refused", "head names a slot that is not written yet", f2=False),
    *_both(
        "without F2, no seal",
        "invented",
        "the same, and the sequence may be visible before the record",
        f2=False,
        refusals=False,
        **PLAIN,
    ),
    Scenario(
        "without F3, in order",
        Config(f3=False, in_order=True),
        "torn",
        "next(last) does not depend on head: the copy may be older than the head that validates it",
    ),
    Scenario(
        "without F3, in order, no seal", Config(f3=False, in_order=True, sealed=False), "torn", "the same"
    ),
    *_both(
        "without F3, head scribbled",
        "torn",
        "the comparison of the sequence before the copy has no effect",
        f3=False,
        **NEAR,
    ),
    *_both("without F4", "torn", "head is compared before the writer comes around", f4=False),
    *_both("without F4, no seal", "torn", "the same", f4=False, **PLAIN),
    *_both(
        "without F5, head scribbled", "torn", "the record changes before the seal is seen", f5=False, **NEAR
    ),
    *_both(
        "without F6, head scribbled",
        "content of",
        "the seal is lifted before the record is complete",
        f6=False,
        **NEAR,
    ),
    *_both(
        "without the distance, no seal",
        "torn",
        "the sequence word was copied before the writer came around",
        distance_check=False,
        **PLAIN,
    ),
    *_both(
        "without the sequence, head scribbled",
        "content of",
        "an old message is shown as a new one",
        sequence_check=False,
        **FAR,
    ),
    *_both(
        "with N - 1, no seal",
        "torn",
        "at distance N - 1 the writer is at work in that very slot",
        margin=1,
        refusals=False,
        **PLAIN,
    ),
    Scenario("with N - 1, in order", Config(in_order=True, margin=1), "message 1 refused", "the same"),
    *_both(
        "sequence compared with the copy only, head scribbled",
        "torn",
        "a slot that is complete after the copy need not have been before it",
        early_q=False,
        **NEAR,
    ),
    *_both(
        "without a seal, head scribbled with any value",
        "content of",
        "the sequence is visible before the record",
        **PLAIN,
        **NEAR,
    ),
    *_both(
        "head behind last taken for new",
        "message 1 accepted as new",
        "a head scribbled backwards names a message that was taken",
        behind_check=False,
        **NEAR,
    ),
    Scenario(
        "lost counted at every attempt",
        Config(in_order=True, lost_on_accept=False),
        "3 counted as lost, 2",
        "an attempt that fails is repeated, and its losses with it",
    ),
    *_both(
        "without a shadow", "the last good message is gone", "a refused copy has overwritten it", shadow=False
    ),
    *_both(
        "delayed writer, N - 2",
        "torn",
        "section 7.4 has no F1 between head = s and the bytes of s + 1",
        refusals=False,
        **{**DELAYED, "margin": 2},
    ),
    Scenario(
        "delayed reader without a head of the scan before",
        Config(sealed=False, f3=False, in_order=True),
        "torn",
        "within one scan nothing orders the load of head before the copy",
    ),
    Scenario(
        "calls: without F7, or in one scan",
        CallConfig(calls=1, lives=1, f7=False),
        "executed after it was reported",
        "the answerer loads head again before its store of taken is visible",
    ),
    Scenario(
        "calls: without F8, or in one scan",
        CallConfig(calls=1, lives=1, f8=False),
        "executed after it was reported",
        "the caller loads taken before its withdrawal is visible",
    ),
    Scenario(
        "calls: no second look",
        CallConfig(calls=1, lives=1, second_look=False),
        "executed after it was reported",
        "the withdrawal came between taking and acting",
    ),
    Scenario(
        "calls: last := 0 on attach",
        CallConfig(calls=1, last_is_head=False),
        "executed, though it waited",
        "a new life executes what waited",
    ),
    Scenario(
        "calls: no F7 behind the claim",
        CallConfig(calls=1, claim_fence=False),
        "executed, though it waited",
        "head is loaded before the claim is seen",
    ),
    Scenario(
        "calls: judged without a withdrawal",
        CallConfig(calls=1, withdraw_when_lost=False),
        "executed after it was reported",
        "the call was published just before the claim changed, and is new to the next answerer",
    ),
    Scenario(
        "calls: not executed, believed from the next answerer",
        CallConfig(calls=1, claim_behind_answer=False, before_known=False),
        "reported as not executed",
        "it finds a call withdrawn that the one before has executed",
    ),
    Scenario(
        "calls: numbers without the claim",
        CallConfig(lives=1, restarts=1, epoch=False),
        "an answer completes a call",
        "the first call of a restarted caller has the number of one before",
    ),
    Scenario(
        "calls: a bridge that does not know what was taken",
        CallConfig(calls=1, bridge_answers=True, before_known=False),
        "reported as not executed",
        "it finds a call withdrawn that the bridge before has executed",
    ),
]
"""Searches that must fail, with the reasons."""

HOLDS_WITHOUT: list[Scenario] = [
    *_both(
        "without the sequence",
        "",
        "with a true head the distance decides alone",
        sequence_check=False,
        **PLAIN,
    ),
    *_both("without the distance", "", "with a seal the sequence decides alone", distance_check=False),
    Scenario(
        "without F1, newest, sealed",
        Config(f1=False),
        "",
        "with a seal the sequence decides alone; only the oldest slots can be refused",
    ),
    Scenario(
        "without F3, newest",
        Config(f3=False),
        "",
        "the slot's address depends on head, and that keeps the order",
    ),
    *_both("without F5", "", "with a true head the distance decides alone", f5=False),
    *_both(
        "without F6", "", "with a correct head F2 orders both the record and the sequence before it", f6=False
    ),
]
"""Rules that are not needed while another rule holds: each one is a second safeguard."""

LIMITS: list[Scenario] = [
    *_both(
        "a paused writer goes on after its claim was taken",
        "torn",
        "only the end of a process stops its stores",
        messages=5,
        restarts=1,
        zombie=True,
    ),
    *_both(
        "head scribbled backwards, and its writer restarts there",
        "torn",
        "the same sequence is published twice, and one copy spans both",
        **{**NEAR, "messages": 4},
        restarts=1,
    ),
    Scenario(
        "calls: paused between its load of claim and its store of taken",
        CallConfig(overlap=True, at_once=False),
        "executed after it was reported",
        "it stores into a line that now belongs to another program",
    ),
]
"""Known limits: properties that the format does not guarantee."""

LARGE: list[Scenario] = [
    *_both("large: killed and restarted three times", messages=8, restarts=3),
    *_both("large: two laps", messages=12, start=28, modulus=64),
    *_both("large: eight slots", slots=8, messages=12, modulus=64),
    *_both("large: head scribbled with any value", **{**NEAR, "messages": 7, "modulus": 48}),
    *_both("large: head scribbled twice with any value", **{**NEAR, "messages": 5, "scribbles": 2}),
    *_both(
        "large: far away twice, writer restarted", **{**FAR, "messages": 3, "scribbles": 2, "restarts": 1}
    ),
    *_both("large: no seal, killed and restarted three times", **PLAIN, messages=7, restarts=3),
    *_both("large: delayed writer, killed and restarted twice", **DELAYED, messages=7, restarts=2),
    Scenario("large: calls, both restart", CallConfig(restarts=1)),
    Scenario("large: calls, answerers were only paused", CallConfig(calls=1, lives=3, overlap=True)),
    Scenario("large: calls, a bridge answers", CallConfig(calls=3, bridge_answers=True)),
]
"""Searches with bigger bounds, which take minutes instead of seconds."""
