"""The reader's machine and the properties; :mod:`protocol` defines the order of loads."""

from __future__ import annotations

from protocol import DELAYED_RULE, Config, Reader, Step, Writer
from sequences import advance, distance, next_sequence

__all__ = ["reader_steps"]


def _margin(config: Config, rule: int) -> int:
    return max(config.margin, 3) if rule == DELAYED_RULE else config.margin


def _begun(config: Config, reader: Reader) -> bool:
    """Return whether the loads before F3 that choose the message are done."""
    return reader.h >= 0 and (reader.rule >= 0 or not config.handover)


def _wanted(config: Config, reader: Reader, h: int) -> int:
    """Return the sequence to take if ``head`` is ``h``; -1 if nothing is new."""
    n, modulus, last = config.slots, config.modulus, reader.last
    if h in (0, last):
        return -1
    if config.behind_check and last and distance(h, last, n, modulus) < n:
        return -1
    ahead = distance(last, h, n, modulus)
    if ahead == 0:
        return -1
    if not config.in_order or reader.at_head or ahead >= modulus // 2:
        return h
    most = n - _margin(config, reader.rule)
    return advance(last, ahead - most if ahead > most + 1 else 1, n, modulus)


def reader_steps(config: Config, writer: Writer, reader: Reader) -> list[Step]:
    """Return every load that the reader may do next; the last one decides."""
    r = reader
    steps = []
    if r.h < 0:
        steps += _load_head(config, writer, r)
    if config.handover and r.rule < 0:
        steps += _load_rule(config, writer, r)
    if r.s < 0:
        return steps
    words = 3 * (r.s % config.slots)
    early_q = config.sealed and config.early_q
    begun = _begun(config, r)
    after_f3 = not config.f3 or (begun and (r.q >= 0 or not early_q))
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
    if config.f4 and (not begun or r.q < 0 or r.a < 0 or r.b < 0):
        return steps
    if begun and r.apart < 0:
        apart = min(distance(r.s, writer.head, config.slots, config.modulus), config.slots)
        steps.append(_judge(config, writer, r._replace(apart=apart), f"h2 := {writer.head}"))
    if config.handover and config.rule_again and begun and r.again < 0:
        steps.append(_judge(config, writer, r._replace(again=writer.rule), f"rule again: {writer.rule}"))
    if config.sealed and r.q >= 0 and not r.same:
        value = writer.words[words]
        if value == r.s or not config.sequence_check:
            steps.append(_decide(config, writer, r._replace(same=True), f"sequence again: {value}"))
        else:
            steps.append(_refuse(config, r, f"sequence again: {value}"))
    return steps


def _judge(config: Config, writer: Writer, reader: Reader, label: str) -> Step:
    """Apply the first condition of M12 once head, and where it may change the rule, are loaded again."""
    if reader.apart < 0 or (config.handover and config.rule_again and reader.again < 0):
        return Step(label, reader)
    margin = max(_margin(config, reader.rule), _margin(config, reader.again))
    if reader.apart <= config.slots - margin or not config.distance_check:
        return _decide(config, writer, reader._replace(near=True, apart=0, again=max(reader.again, 0)), label)
    return _refuse(config, reader, label)


def _load_rule(config: Config, writer: Writer, reader: Reader) -> list[Step]:
    loaded, label = reader._replace(rule=writer.rule), f"rule := {writer.rule}"
    if reader.h < 0:
        return [Step(label, loaded)]
    s = _wanted(config, loaded, reader.h)
    if reader.s >= 0 and s == reader.s:
        return [_decide(config, writer, loaded, label)]
    if reader.s >= 0 or s < 0:
        return [Step(f"{label}, nothing to take", _idle(reader))]
    return [Step(f"{label}, s := {s}", loaded._replace(s=s))]


def _load_head(config: Config, writer: Writer, reader: Reader) -> list[Step]:
    h = writer.head
    s = _wanted(config, reader, h)
    steps = []
    if config.handover and reader.rule < 0 and s >= 0:
        steps.append(Step(f"h := {h}", reader._replace(h=h)))
    elif reader.s >= 0:
        if s == reader.s:
            return [_decide(config, writer, reader._replace(h=h), f"h := {h}")]
        return [Step(f"h := {h}, guessed wrong", _idle(reader))]
    elif s >= 0:
        begun = reader._replace(h=h, s=s)
        if not config.lost_on_accept:
            skipped = distance(reader.last, s, config.slots, config.modulus) - 1
            begun = begun._replace(lost=reader.lost + skipped)
        steps.append(Step(f"h := {h}, s := {s}", begun))
    if reader.s < 0 and config.in_order and ((config.sealed and config.early_q) or not config.f3):
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
        if not _begun(config, r):
            return Step(step.label, step.after)
        return step._replace(after=_idle(r, r.h))
    if not _begun(config, r) or min(r.q, r.a, r.b) < 0 or not r.near or (config.sealed and not r.same):
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
