"""The writer's machine, and other changes to the memory; :mod:`protocol` defines the order of stores."""

from __future__ import annotations

from protocol import DELAYED_RULE, FENCE, FENCES_RULE, HEAD, RULE, Config, Reader, Store, Writer
from sequences import distance, next_sequence

__all__ = ["initial", "writer_steps"]


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
        config.restarts, config.scribbles, (), DELAYED_RULE if config.handback else FENCES_RULE,
    )  # fmt: skip
    reader = Reader(0 if config.latched else config.start, seen, 0, shown=(seen, seen))
    return _refill(config, writer), reader


def _begun(config: Config, number: int) -> int:
    """Return the message's number without the prefilled slots of a start in mid-stream."""
    return number - (config.slots if config.start else 0)


def _claim(config: Config, number: int) -> Store:
    """Return the store of the rule under which a writer continues with message ``number``."""
    return (RULE, DELAYED_RULE if config.delayed(_begun(config, number)) else FENCES_RULE, number)


def _message(config: Config, sequence: int, number: int) -> list[Store]:
    at = 3 * (sequence % config.slots)
    name = (at, sequence, number)
    record = [(at + 1, number, number), (at + 2, number, number)]
    head = (HEAD, sequence, number)
    if config.delayed(_begun(config, number)):
        return [name, *record, FENCE, head]
    first = [FENCE] if config.f1 else []
    second = [FENCE] if config.f2 else []
    if config.sealed:
        fifth, sixth = [FENCE] if config.f5 else [], [FENCE] if config.f6 else []
        return [*first, (at, 0, number), *fifth, *record, *sixth, name, *second, head]
    return [*first, name, *record, *second, head]


def _refill(config: Config, writer: Writer) -> Writer:
    """Open the next group once every store of the last one is visible, as a fence does."""
    if writer.open:
        return writer
    begun, later = [], list(writer.later)
    private, log = writer.private, writer.log
    while True:
        if not later:
            if _begun(config, len(log)) >= config.messages:
                break
            private = next_sequence(private, config.slots, config.modulus)
            log = (*log, private)
            later = _message(config, private, len(log))
            if config.handover and _begun(config, len(log)) == config.handover + 1:
                later = [FENCE, _claim(config, len(log)), *later]  # the claim takes at least a scan
        store = later.pop(0)
        if store != FENCE:
            begun.append(store)
        elif begun:
            break
    return writer._replace(open=tuple(begun), later=tuple(later), private=private, log=log)


def _visible(config: Config, writer: Writer, store: Store) -> Writer:
    location, value, number = store
    if location == RULE:
        return writer._replace(rule=value)
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
        claim = (_claim(config, len(writer.log) + 1),) if config.handover else ()
        fresh = writer._replace(open=(), later=claim, private=writer.head, paused=left)
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
    if location in (HEAD, RULE):
        return f"{'head' if location == HEAD else 'writer_rule'} = {value}"
    word = ("sequence", "word a", "word b")[location % 3]
    return f"slot {location // 3} {word} = {value}  (message {number})"
