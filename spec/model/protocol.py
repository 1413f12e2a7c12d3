"""The channel protocol as a transition system: which stores become visible, and what loads return.

Two machines share a memory of ``head`` and N slots. A slot has a sequence word and two record
words (two are enough for a torn record). Every store and every load is a separate step.

    writer   … F1 │ sequence = 0 │ F5 │ word a, word b │ F6 │ sequence │ F2 │ head │ …  (section 7.2)
    reader   head, sequence │ F3 │ word a, word b │ F4 │ head and sequence again            (section 7.3)

Without a seal (section 7.4, and to test the conditions of M12 separately):

    writer   … F1 │ sequence, word a, word b │ F2 │ head │ F1 │ …
    reader   head │ F3 │ sequence, word a, word b │ F4 │ head again

If a writer hands over to another one under a different rule (M23), the reader loads ``writer_rule``
with each load of ``head``; the two loads may happen in either order.

*Stores.* The stores between two fences form a group and become visible in any order, but stores to
the same location keep their order. This is weaker than ARM and much weaker than x86. The model
covers only the order in which stores become visible, because a reader cannot see when they were executed.

*Loads.* Between two fences, loads happen in any order.

*Kill.* The writer stops when any part of the open group is visible, and the rest never becomes
visible. A store that was executed but is still in a store buffer is the same history with a later
kill. A dead writer takes no further step. A restarted writer loads ``head`` and counts from there. It
starts after the dead writer's stores have become visible: the kernel executes many barriers between
the death of one process and the claim of the next, at least 100 ms later.

Only the properties need the "ghost" state: the publication log, and the number ``m`` that each
message carries in both record words.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

__all__ = [
    "DELAYED_RULE",
    "FENCE",
    "FENCES_RULE",
    "HEAD",
    "RULE",
    "Config",
    "Reader",
    "Step",
    "Store",
    "Writer",
]

HEAD, RULE = -1, -3
FENCE = (-2, 0, 0)
Store = tuple[int, int, int]
"""Location (HEAD, RULE, or 3 × slot + word), value, and the message it belongs to."""

FENCES_RULE, DELAYED_RULE = 1, 2


@dataclass(frozen=True)
class Config:
    """A bounded instance of the protocol; turning a switch off makes a mutation.

    Attributes:
        slots: N.
        modulus: Replaces 2**32.
        start: ``head`` before the first step; the slots hold the messages up to it.
        messages: Messages that the writer begins, including those cut off by a kill.
        restarts: How often the writer is killed, at any instant, and restarted.
        in_order: The reader takes ``next(last)`` instead of the newest.
        latched: The reader starts with ``last = 0``.
        sealed: The writer keeps a slot's sequence at 0 while it is written (M22), and the
            reader compares it before and after the copy.
        early_q: The reader loads the sequence before F3, not with the copy.
        f1, f2, f3, f4, f5, f6: The fences.
        margin: N - ``margin`` is the largest accepted distance.
        distance_check: The first condition of M12.
        sequence_check: The second condition of M12.
        behind_check: A head less than N behind ``last`` means "nothing new".
        lost_on_accept: Losses are counted when a message is accepted, not at every attempt.
        shadow: The copy goes to private memory first.
        refusals: A refusal without cause is a violation (off: search for more serious violations).
        scribbles: How often another program stores into ``head``.
        scribble_near: It may store any value, not only values far from the stream.
        zombie: A killed writer was only paused, and continues after the takeover.
        handover: Another writer, under the delayed rule, takes over after this many messages; 0: none does.
        handback: Reverses the hand-over: the first writer uses the delayed rule, the second uses fences.
        rule_again: The reader loads ``writer_rule`` a second time, after the copy (M23).
    """

    slots: int = 4
    modulus: int = 32
    start: int = 0
    messages: int = 7
    restarts: int = 0
    in_order: bool = False
    latched: bool = False
    sealed: bool = True
    early_q: bool = True
    f1: bool = True
    f2: bool = True
    f3: bool = True
    f4: bool = True
    f5: bool = True
    f6: bool = True
    margin: int = 2
    distance_check: bool = True
    sequence_check: bool = True
    behind_check: bool = True
    lost_on_accept: bool = True
    shadow: bool = True
    refusals: bool = True
    scribbles: int = 0
    scribble_near: bool = False
    zombie: bool = False
    handover: int = 0
    handback: bool = False
    rule_again: bool = True

    def delayed(self, number: int) -> bool:
        """Return whether the ``number``-th message is written under the delayed rule."""
        return self.handover > 0 and (number > self.handover) != self.handback


class Writer(NamedTuple):
    """The memory, the writer and its ghost state.

    Attributes:
        head: The visible ``head``.
        words: The visible slots, three words each.
        open: Stores of the open group that are not visible yet, in program order.
        later: Stores and fences of the messages begun, after the open group.
        private: The writer's private head.
        log: Sequence of each begun message (index ``m`` - 1).
        published: Numbers of the published messages, in order.
        restarts: Restarts left.
        scribbles: Scribbles left.
        paused: The stores that a paused writer still executes after it lost its claim.
        rule: The visible ``writer_rule``.
    """

    head: int
    words: tuple[int, ...]
    open: tuple[Store, ...]
    later: tuple[Store, ...]
    private: int
    log: tuple[int, ...]
    published: tuple[int, ...]
    restarts: int
    scribbles: int
    paused: tuple[Store, ...]
    rule: int = FENCES_RULE


class Reader(NamedTuple):
    """One reader; -1 stands for "not loaded yet".

    Attributes:
        last: Sequence of the last accepted message.
        taken: Ghost: its number ``m``, 0 none.
        lost: Messages counted as lost since then.
        h: The first load of ``head``.
        s: The sequence wanted.
        q: The slot's sequence word.
        a: The first copied record word.
        b: The second.
        near: ``head`` was loaded again and is near enough.
        same: The sequence word was loaded again and is ``s``.
        quiet: Ghost: the memory has not changed since the attempt began.
        shown: The two words that the reader's user sees.
        stuck: ``head`` at the last refusal because the slot held another sequence.
        at_head: Refused twice under the same head, so the reader continues at ``head`` (M13).
        rule: ``writer_rule`` as loaded with ``head``, if it may change.
        apart: The distance from ``s`` to ``head`` when that was loaded again.
        again: ``writer_rule`` as loaded again.
    """

    last: int
    taken: int
    lost: int
    h: int = -1
    s: int = -1
    q: int = -1
    a: int = -1
    b: int = -1
    near: bool = False
    same: bool = False
    quiet: bool = True
    shown: tuple[int, int] = (0, 0)
    stuck: int = -1
    at_head: bool = False
    rule: int = -1
    apart: int = -1
    again: int = -1


class Step(NamedTuple):
    """A step of the reader: its label, the state after it, and the property that broke."""

    label: str
    after: Reader
    violation: str = ""
