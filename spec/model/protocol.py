"""The channel protocol as a transition system: what can become visible, what can be read.

Two machines share a memory of ``head`` and N slots; a slot is a sequence word and two record
words (two are enough to be torn). Every single store and load is a step of its own.

    writer   … F1 │ sequence = 0 │ F5 │ word a, word b │ F6 │ sequence │ F2 │ head │ …  (section 7.2)
    reader   head, sequence │ F3 │ word a, word b │ F4 │ head and sequence again            (section 7.3)

and, where a slot is not sealed while it is written (section 7.4, and what the first two
conditions are worth alone):

    writer   … F1 │ sequence, word a, word b │ F2 │ head │ F1 │ …
    reader   head │ F3 │ sequence, word a, word b │ F4 │ head again

*Stores.* Between two fences the stores of one group become visible in any order; stores to one
location keep their order. That is weaker than ARM and far weaker than x86. Only the order in
which stores become visible is modelled: when they were executed, a reader cannot tell.

*Loads.* Between two fences the loads of one group are satisfied in any order.

*Kill.* The writer stops with any part of the open group visible, and the rest never becomes
so. "Executed, still in a store buffer" is the same history with a later kill. A dead writer
is one that takes no further step; a restarted one loads ``head`` and counts from there. It
starts after the dead one's stores have become visible (the kernel's work between the death of
one process and the claim of the next, at least 100 ms later, holds barriers in plenty).

Everything that only the properties need ("ghost" state) is the publication log and the number
``m`` that each message carries in both record words.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from sequences import advance, distance, next_sequence

__all__ = ["Config", "Reader", "Step", "Writer", "initial", "reader_steps", "writer_steps"]

HEAD = -1
FENCE = (-2, 0, 0)
Store = tuple[int, int, int]
"""Location (HEAD, or 3 × slot + word), value, and the message it belongs to."""


@dataclass(frozen=True)
class Config:
    """A bounded instance of the protocol; every switch that is off is a mutation.

    Attributes:
        slots: N.
        modulus: Stands for 2**32.
        start: ``head`` before the first step; the slots hold what led there.
        messages: Messages that the writer begins, killed ones included.
        restarts: Times that the writer is killed, at any instant, and starts again.
        in_order: The reader takes ``next(last)`` instead of the newest.
        latched: The reader starts with ``last = 0``.
        sealed: The writer keeps a slot's sequence at 0 while it is written (M22), and the
            reader compares it before and after the copy.
        early_q: The reader loads the sequence before F3, not with the copy.
        f1, f2, f3, f4, f5, f6: The fences.
        margin: The largest accepted distance is N - ``margin``.
        distance_check: The first condition of M12.
        sequence_check: The second.
        behind_check: A head less than N behind ``last`` means "nothing new".
        lost_on_accept: Losses are counted when a message is accepted, not at every attempt.
        shadow: The copy goes to private memory first.
        refusals: A refusal without cause is a violation (off: look for graver ones behind it).
        scribbles: Times that a stranger stores into ``head``.
        scribble_near: The stranger may store any value, not only values far from the stream.
        zombie: A killed writer was only paused, and goes on after the takeover.
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


class Writer(NamedTuple):
    """The memory, the writer and its ghost state.

    Attributes:
        head: The visible ``head``.
        words: The visible slots, three words each.
        open: Stores of the open group that are not visible yet, in program order.
        later: Stores and fences of the begun messages after the open group.
        private: The writer's private head.
        log: Sequence of each begun message (index ``m`` - 1).
        published: Numbers of the published messages, in order.
        restarts: Restarts left.
        scribbles: Scribbles left.
        paused: What a paused writer that lost its claim still has to store.
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
        shown: What the reader's user sees, two words.
        stuck: The head of a refusal because the slot holds another sequence.
        at_head: So often refused under one head that only the newest is left to try (M13).
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


class Step(NamedTuple):
    """A step of the reader: what it did, what it is then, and which property broke."""

    label: str
    after: Reader
    violation: str = ""


def initial(config: Config) -> tuple[Writer, Reader]:
    """Return the first state: an empty channel, or a full one with ``head = start``."""
    words = [0] * (3 * config.slots)
    log: list[int] = []
    if config.start:
        for back in range(config.slots - 1, -1, -1):
            sequence = config.start - back
            log.append(sequence)
            at = 3 * (sequence % config.slots)
            words[at : at + 3] = [sequence, len(log), len(log)]
    seen = 0 if config.latched else len(log)
    writer = Writer(
        config.start, tuple(words), (), (), config.start, tuple(log), tuple(range(1, len(log) + 1)),
        config.restarts, config.scribbles, (),
    )  # fmt: skip
    reader = Reader(0 if config.latched else config.start, seen, 0, shown=(seen, seen))
    return _refill(config, writer), reader


# ----------------------------------------------------------------------------------- writer


def _message(config: Config, sequence: int, number: int) -> list[Store]:
    at = 3 * (sequence % config.slots)
    name = (at, sequence, number)
    record = [(at + 1, number, number), (at + 2, number, number)]
    head = (HEAD, sequence, number)
    first = [FENCE] if config.f1 else []
    second = [FENCE] if config.f2 else []
    if config.sealed:
        fifth, sixth = [FENCE] if config.f5 else [], [FENCE] if config.f6 else []
        return [*first, (at, 0, number), *fifth, *record, *sixth, name, *second, head]
    return [*first, name, *record, *second, head]


def _refill(config: Config, writer: Writer) -> Writer:
    """Open the next group once every store of the last one is visible: that is what a fence does."""
    if writer.open:
        return writer
    begun, later = [], list(writer.later)
    private, log = writer.private, writer.log
    while True:
        if not later:
            # Numbers go on over the prefilled slots of a start in mid-stream.
            if len(log) - (config.slots if config.start else 0) >= config.messages:
                break
            private = next_sequence(private, config.slots, config.modulus)
            log = (*log, private)
            later = _message(config, private, len(log))
        store = later.pop(0)
        if store != FENCE:
            begun.append(store)
        elif begun:
            break
    return writer._replace(open=tuple(begun), later=tuple(later), private=private, log=log)


def _visible(config: Config, writer: Writer, store: Store) -> Writer:
    location, value, number = store
    if location == HEAD:
        published = writer.published if number in writer.published else (*writer.published, number)
        return writer._replace(head=value, published=published)
    return writer._replace(words=(*writer.words[:location], value, *writer.words[location + 1 :]))


def _next_stores(stores: tuple[Store, ...]) -> list[int]:
    """Return the indices of the stores that may become visible next: the first per location."""
    seen: set[int] = set()
    indices = []
    for index, (location, _, _) in enumerate(stores):
        if location not in seen:
            seen.add(location)
            indices.append(index)
    return indices


def _scribbles(config: Config, writer: Writer) -> list[int]:
    if config.scribble_near:
        return [value for value in range(config.modulus) if value != writer.head]
    stream = {*writer.words[::3], writer.private, writer.head}
    reach = config.slots + config.messages
    return [
        value
        for value in range(config.modulus)
        if all(
            reach <= distance(one, value, config.slots, config.modulus)
            and reach <= distance(value, one, config.slots, config.modulus)
            for one in stream
        )
    ]


def writer_steps(config: Config, writer: Writer) -> list[tuple[str, Writer]]:
    """Return everything that may happen to the memory next, with a label each."""
    steps = []
    for index in _next_stores(writer.open):
        store = writer.open[index]
        rest = writer._replace(open=writer.open[:index] + writer.open[index + 1 :])
        steps.append((f"visible: {_name(store)}", _refill(config, _visible(config, rest, store))))
    for index in _next_stores(writer.paused)[:1]:
        store = writer.paused[index]
        rest = writer._replace(paused=writer.paused[1:])
        label = f"visible, from the writer that lost its claim: {_name(store)}"
        steps.append((label, _visible(config, rest, store)))
    if writer.restarts:
        left = (*writer.open, *(store for store in writer.later if store != FENCE)) if config.zombie else ()
        fresh = writer._replace(open=(), later=(), private=writer.head, paused=left)
        fresh = fresh._replace(restarts=writer.restarts - 1)
        what = "paused, another claims" if config.zombie else "killed, and restarted"
        steps.append((f"writer {what} with head = {writer.head}", _refill(config, fresh)))
    if writer.scribbles:
        steps += [
            (f"scribble: head = {value}", writer._replace(head=value, scribbles=writer.scribbles - 1))
            for value in _scribbles(config, writer)
        ]
    return steps


def _name(store: Store) -> str:
    location, value, number = store
    if location == HEAD:
        return f"head = {value}"
    word = ("sequence", "word a", "word b")[location % 3]
    return f"slot {location // 3} {word} = {value}  (message {number})"


# ----------------------------------------------------------------------------------- reader


def _wanted(config: Config, reader: Reader, h: int) -> int:
    """Return the sequence to take where ``head`` is ``h``; -1 where nothing is new."""
    n, modulus, last = config.slots, config.modulus, reader.last
    if h in (0, last):
        return -1
    if config.behind_check and last and distance(h, last, n, modulus) < n:
        return -1
    ahead = distance(last, h, n, modulus)
    if not config.in_order or reader.at_head or ahead >= modulus // 2:
        return h
    most = n - config.margin
    return advance(last, ahead - most if ahead > most + 1 else 1, n, modulus)


def reader_steps(config: Config, writer: Writer, reader: Reader) -> list[Step]:
    """Return every load that the reader may do next; the last one decides."""
    r = reader
    steps = []
    if r.h < 0:
        steps += _load_head(config, writer, r)
    if r.s < 0:
        return steps
    words = 3 * (r.s % config.slots)
    early_q = config.sealed and config.early_q
    after_f3 = not config.f3 or (r.h >= 0 and (r.q >= 0 or not early_q))
    if r.q < 0 and (early_q or after_f3):
        value = writer.words[words]
        steps.append(_decide(config, writer, r._replace(q=value), f"sequence of the slot: {value}"))
    for name, word in (("a", 1), ("b", 2)):
        if getattr(r, name) < 0 and after_f3:
            value = writer.words[words + word]
            copy = r._replace(a=value) if name == "a" else r._replace(b=value)
            if not config.shadow:
                shown = (value, r.shown[1]) if name == "a" else (r.shown[0], value)
                copy = copy._replace(shown=shown)
            steps.append(_decide(config, writer, copy, f"copies word {name}: {value}"))
    if config.f4 and (r.h < 0 or r.q < 0 or r.a < 0 or r.b < 0):
        return steps
    if r.h >= 0 and not r.near:
        h2 = writer.head
        apart = distance(r.s, h2, config.slots, config.modulus)
        if apart <= config.slots - config.margin or not config.distance_check:
            steps.append(_decide(config, writer, r._replace(near=True), f"h2 := {h2}"))
        else:
            steps.append(_refuse(config, r, f"h2 := {h2}"))
    if config.sealed and r.q >= 0 and not r.same:
        value = writer.words[words]
        if value == r.s or not config.sequence_check:
            steps.append(_decide(config, writer, r._replace(same=True), f"sequence again: {value}"))
        else:
            steps.append(_refuse(config, r, f"sequence again: {value}"))
    return steps


def _load_head(config: Config, writer: Writer, reader: Reader) -> list[Step]:
    h = writer.head
    s = _wanted(config, reader, h)
    if reader.s >= 0:
        if s == reader.s:
            return [_decide(config, writer, reader._replace(h=h), f"h := {h}")]
        return [Step(f"h := {h}, guessed wrong", _idle(reader))]
    steps = []
    if s >= 0:
        begun = reader._replace(h=h, s=s)
        if not config.lost_on_accept:
            skipped = distance(reader.last, s, config.slots, config.modulus) - 1
            begun = begun._replace(lost=reader.lost + skipped)
        steps.append(Step(f"h := {h}, s := {s}", begun))
    if config.in_order and ((config.sealed and config.early_q) or not config.f3):
        # next(last) does not depend on head, so a processor may load from its slot before it has
        # loaded head. The newest does depend on it: there, the address keeps the order.
        guess = next_sequence(reader.last, config.slots, config.modulus)
        steps.append(Step(f"guesses s := {guess} ahead of head", reader._replace(s=guess)))
    return steps


def _idle(reader: Reader, stuck: int | None = None) -> Reader:
    """Return the reader after an attempt; ``stuck``: under this head the slot held another sequence."""
    rest = Reader(reader.last, reader.taken, reader.lost, shown=reader.shown)
    if stuck is None:
        return rest._replace(stuck=reader.stuck, at_head=reader.at_head)
    return rest._replace(stuck=stuck, at_head=reader.at_head or reader.stuck == stuck)


def _refuse(config: Config, reader: Reader, label: str) -> Step:
    broken = ""
    if config.refusals and reader.quiet and not config.scribbles and not config.zombie:
        broken = f"message {reader.s} refused although nothing moved during the attempt"
    if reader.shown[0] != reader.shown[1]:
        broken = f"the last good message is gone, the user sees {reader.shown}"
    return Step(f"{label}, refuses {reader.s}", _idle(reader), broken)


def _decide(config: Config, writer: Writer, reader: Reader, label: str) -> Step:
    """Refuse a slot that holds another message; accept a copy once nothing is left to load."""
    r = reader
    if config.sequence_check and r.q not in (-1, r.s):
        step = _refuse(config, r, label)
        if r.h < 0:
            return Step(step.label, step.after)
        return step._replace(after=_idle(r, r.h))
    if min(r.h, r.q, r.a, r.b) < 0 or not r.near or (config.sealed and not r.same):
        return Step(label, r)
    lost = r.lost
    if config.lost_on_accept:
        lost = distance(r.last, r.s, config.slots, config.modulus) - 1
    broken = _broken(config, writer, r, lost)
    after = Reader(r.s, r.a, 0, shown=(r.a, r.b))
    return Step(f"{label}, ACCEPTS {r.s} with record ({r.a}, {r.b})", after, broken)


def _broken(config: Config, writer: Writer, reader: Reader, lost: int) -> str:
    """Return the property that accepting this copy breaks; empty where it breaks none."""
    number = reader.a
    if reader.a != reader.b:
        return f"torn: half of message {reader.a}, half of message {reader.b}"
    if not number:
        return f"invented: the slot of {reader.s} was never filled"
    if writer.log[number - 1] != reader.s:
        return f"content of {writer.log[number - 1]} accepted as {reader.s}"
    # Under a scribbled head a message may be found that is complete and sealed, and lacks only its
    # publication: that is not told apart, and does no harm.
    if number not in writer.published and not (config.sealed and config.scribbles):
        return f"invented: message {number} ({reader.s}) was never published"
    if number <= reader.taken:
        return f"message {number} accepted as new after message {reader.taken}"
    if config.in_order and not config.scribbles and not config.zombie and not config.latched:
        missed = sum(1 for one in writer.published if reader.taken < one < number)
        if missed != lost:
            return f"{lost} counted as lost, {missed} missed"
    return ""
