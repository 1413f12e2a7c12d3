"""Calls (section 11) as a transition system: the order of stores and loads, and what the caller reports.

    caller     load claim │ publish s │ … answer? claim changed? │ publish w │ F8 │ taken │ report
    answerer   claim │ F7 │ last := head │ … head new? │ taken := s │ F7 │ head, claim again │ act │ answer

Each store waits in a buffer of its process until it becomes visible. Stores to the same word keep their
order; all others become visible in any order. A process passes a fence when its buffer is empty. Under the
delayed rule (section 7.4), the end of a scan has the same effect, so the model covers programs with fences
and scans without. The two loads after F7 may happen in either order. Publishing a message is one step here;
:mod:`protocol` checks that messages are complete.

A killed process loses the contents of its buffer. If the kernel still makes a store visible, this is the
same history with a later kill. The next answerer is a new life with its own claim, or a restarted bridge.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from explore import Result

__all__ = ["CallConfig", "explore_calls"]

HEAD, CLAIM, TAKEN, ANSWER = range(4)
DONE, NOT_EXECUTED, FATE_UNKNOWN = 1, 2, 3
Stores = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class CallConfig:
    """A bounded instance; turning a switch off makes a mutation.

    Attributes:
        calls: How many calls the caller makes.
        lives: How many answerers run, one after the other.
        restarts: How often the caller is killed and restarted.
        bridge_answers: The PLC calls, and the answerer is a bridge, which continues from ``taken``.
        overlap: An answerer that loses its claim was only paused, and continues.
        at_once: It is not paused between its load of ``claim`` and its store of ``taken``.
        f7, f8: The fences of M26.
        claim_fence: F7 after the claim (M27).
        second_look: The answerer loads ``head`` and ``claim`` again.
        last_is_head: An answerer in the PLC starts at ``head`` and ignores waiting calls.
        withdraw_when_lost: The caller withdraws a call before it judges it when the answerer has changed.
        claim_behind_answer: The caller loads ``claim`` again after an answer ``NOT_EXECUTED``.
        before_known: A bridge knows which call its predecessor has taken.
        epoch: A call's number contains the caller's claim.
    """

    calls: int = 2
    lives: int = 2
    restarts: int = 0
    bridge_answers: bool = False
    overlap: bool = False
    at_once: bool = True
    f7: bool = True
    f8: bool = True
    claim_fence: bool = True
    second_look: bool = True
    last_is_head: bool = True
    withdraw_when_lost: bool = True
    claim_behind_answer: bool = True
    before_known: bool = True
    epoch: bool = True


class Caller(NamedTuple):
    """The caller's registers; ``call`` is 0 while no call is open."""

    at: str = "open"
    call: int = 0
    first: int = 0
    claim: int = 0
    lost: bool = False
    stores: Stores = ()
    epoch: int = 1
    counter: int = 0
    restarts: int = 0


class Answerer(NamedTuple):
    """One life of the answerer; ``doing``, ``done`` and ``before`` are numbers of calls."""

    name: int
    at: str = "claim"
    last: int = 0
    doing: int = 0
    done: int = 0
    before: int = 0
    stores: Stores = ()


class World(NamedTuple):
    """Memory, processes, and the state that only the properties need.

    ``log`` holds each message's call and whether it is withdrawn. ``calls`` holds each call's epoch, counter,
    number of executions, reported outcome (0: none), and the claim in memory when the call became visible.
    """

    memory: tuple[int, int, int, int]
    log: tuple[tuple[int, bool], ...]
    caller: Caller
    lives: tuple[Answerer, ...]
    born: int
    calls: tuple[tuple[int, int, int, int, int], ...] = ()


def _read(world: World, stores: Stores, word: int) -> int:
    own = [value for place, value in stores if place == word]
    return own[-1] if own else world.memory[word]


def _change(world: World, call: int, index: int, value: int) -> World:
    row = world.calls[call - 1]
    row = (*row[:index], value, *row[index + 1 :])
    return world._replace(calls=(*world.calls[: call - 1], row, *world.calls[call:]))  # type: ignore[arg-type]


Step = tuple[str, World, str]


def _visible(
    world: World, stores: Stores, keep: Callable[[World, Stores], World], who: str
) -> Iterator[Step]:
    seen = set()
    for index, (word, value) in enumerate(stores):
        if word in seen:
            continue
        seen.add(word)
        memory = (*world.memory[:word], value, *world.memory[word + 1 :])
        after = world._replace(memory=memory)  # type: ignore[arg-type]
        if word == HEAD and (call := world.log[value - 1][0]) and world.calls[call - 1][4] < 0:
            after = _change(after, call, 4, world.memory[CLAIM])
        name = ("head", "claim", "taken", "answer")[word]
        yield f"visible: {who}'s {name} = {value}", keep(after, stores[:index] + stores[index + 1 :]), ""


# An answer in memory: the call that it is about, and its outcome.
def _answer(call: int, outcome: int) -> int:
    return call * 4 + outcome


def _caller(config: CallConfig, world: World) -> Iterator[Step]:
    c = world.caller

    def put(changed: Caller, label: str, other: World = world) -> Step:
        return f"caller  {label}", other._replace(caller=changed), ""

    def publish(call: int, withdrawn: bool) -> tuple[World, Stores, int]:
        log = (*world.log, (call, withdrawn))
        return world._replace(log=log), (*c.stores, (HEAD, len(log))), len(log)

    def report(outcome: int, answered: int = 0) -> Step:
        label, after, bad = put(c._replace(at="open", call=0, lost=False), f"reports {outcome}")
        executed = world.calls[c.call - 1][2]
        if answered and answered != c.call:
            bad = "an answer completes a call that it was not given for"
        elif outcome == NOT_EXECUTED and executed:
            bad = "reported as not executed, but it was"
        elif outcome == DONE and not executed:
            bad = "reported as done, but it was not executed"
        return f"{label} for call {c.call}", _change(after, c.call, 3, outcome), bad

    yield from _visible(world, c.stores, lambda w, s: w._replace(caller=c._replace(stores=s)), "caller")
    if c.restarts:
        # Comes back with what is visible: it goes on with the newest call unless that has ended.
        head, taken = world.memory[HEAD], world.memory[TAKEN]
        call, withdrawn = world.log[head - 1] if head else (0, False)
        again = Caller(epoch=c.epoch + 1, restarts=c.restarts - 1)
        if call and not withdrawn and not world.calls[call - 1][3]:
            mine = taken and world.log[taken - 1][0] == call
            first = taken if mine else head
            again = again._replace(call=call, first=first, claim=world.memory[CLAIM])
        # What never became visible is no message: its number is used again.
        yield put(again, "is killed and comes back", world._replace(log=world.log[:head]))
    if c.at == "open" and not c.call:
        claim = _read(world, c.stores, CLAIM)
        if len(world.calls) < config.calls and (claim or config.bridge_answers):
            counter = c.counter + 1
            after, stores, s = publish(len(world.calls) + 1, False)
            row = (c.epoch if config.epoch else 0, counter, 0, 0, -1)
            after = after._replace(calls=(*world.calls, row))
            opened = c._replace(
                call=len(world.calls) + 1, first=s, claim=claim, stores=stores, counter=counter
            )
            yield put(opened, f"publishes call {opened.call} as {s}", after)
        return
    if c.at == "open":
        if not any(call == c.call and withdrawn for call, withdrawn in world.log):
            after, stores, w = publish(c.call, True)
            yield put(c._replace(at="fence", stores=stores), f"withdraws as {w}", after)
        claim = _read(world, c.stores, CLAIM)
        changed = claim != c.claim and not config.bridge_answers
        if changed and config.withdraw_when_lost:
            after, stores, w = publish(c.call, True)
            yield put(
                c._replace(at="fence", lost=True, stores=stores),
                f"sees claim {claim}, withdraws as {w}",
                after,
            )
        elif changed:
            yield put(c._replace(at="taken", lost=True), f"sees claim {claim}")
        about, outcome = divmod(world.memory[ANSWER], 4)
        if about and world.calls[about - 1][:2] == world.calls[c.call - 1][:2]:
            if outcome != NOT_EXECUTED or config.bridge_answers or not config.claim_behind_answer:
                yield report(outcome, about)
            else:
                yield put(c._replace(at="believe"), "reads the answer not executed")
    elif c.at == "fence" and not (config.f8 and c.stores):
        yield put(c._replace(at="taken"), "passes F8")
    elif c.at == "taken":
        begun = _read(world, c.stores, TAKEN) >= c.first
        if not begun or c.lost:
            yield report(FATE_UNKNOWN if begun else NOT_EXECUTED)
        else:
            yield put(c._replace(at="open"), "sees that it may have begun")
    elif c.at == "believe":
        if _read(world, c.stores, CLAIM) == c.claim:
            yield report(NOT_EXECUTED, c.call)
        else:
            yield put(c._replace(at="open"), "does not believe it: claim has changed")


def _life(config: CallConfig, world: World, index: int) -> Iterator[Step]:
    a = world.lives[index]

    def put(changed: Answerer, label: str, other: World = world) -> Step:
        lives = (*other.lives[:index], changed, *other.lives[index + 1 :])
        return f"answerer {a.name}  {label}", other._replace(lives=lives), ""

    def store(word: int, value: int) -> Stores:
        return (*a.stores, (word, value))

    def gone(w: World, stores: Stores) -> World:
        return put(a._replace(stores=stores), "", w)[1]

    yield from _visible(world, a.stores, gone, f"answerer {a.name}")
    if a.at == "claim":
        yield put(a._replace(at="claimed", stores=store(CLAIM, a.name)), "claims")
    elif a.at == "claimed" and not (config.claim_fence and a.stores):
        yield put(a._replace(at="start"), "passes F7")
    elif a.at == "start":
        last = _read(world, a.stores, TAKEN if config.bridge_answers else HEAD)
        if not config.last_is_head:
            last = 0
        before = world.log[last - 1][0] if last and config.before_known else 0
        about, _ = divmod(world.memory[ANSWER], 4)
        stores = a.stores
        done = about if about == before else 0
        if config.bridge_answers and before and not done:
            stores, done = store(ANSWER, _answer(before, FATE_UNKNOWN)), before
        started = a._replace(at="idle", last=last, before=before, done=done, stores=stores)
        yield put(started, f"starts behind {last}")
    elif a.at == "idle":
        if a.doing:
            answered = a._replace(doing=0, done=a.doing, stores=store(ANSWER, _answer(a.doing, DONE)))
            yield put(answered, f"answers call {a.doing}")
        head = _read(world, a.stores, HEAD)
        if head > a.last and _read(world, a.stores, CLAIM) == a.name:
            found = a._replace(at="take", last=head)
            if config.at_once:
                found = found._replace(at="fence", stores=store(TAKEN, head))
            yield put(found, f"finds {head}")
    elif a.at == "take":
        yield put(a._replace(at="fence", stores=store(TAKEN, a.last)), f"stores taken = {a.last}")
    elif a.at == "fence" and not (config.f7 and a.stores):
        yield put(a._replace(at="look" if config.second_look else "act"), "passes F7")
    elif a.at in ("look", "look at head", "look at claim"):
        for word, name, expected in ((HEAD, "head", a.last), (CLAIM, "claim", a.name)):
            if a.at not in ("look", f"look at {name}"):
                continue
            if _read(world, a.stores, word) != expected:
                yield put(a._replace(at="idle"), f"sees another {name}, and starts over")
            else:
                other = "claim" if name == "head" else "head"
                yield put(
                    a._replace(at=f"look at {other}" if a.at == "look" else "act"), f"sees the same {name}"
                )
    elif a.at == "act":
        yield _act(config, world, a, put, store)


def _act(
    config: CallConfig,
    world: World,
    a: Answerer,
    put: Callable[..., Step],
    store: Callable[[int, int], Stores],
) -> Step:
    call, withdrawn = world.log[a.last - 1]
    idle = a._replace(at="idle")
    if call in (a.doing, a.done):
        return put(idle, f"finds nothing new in {a.last}")
    if call == a.before or withdrawn:
        outcome = FATE_UNKNOWN if call == a.before else NOT_EXECUTED
        return put(
            idle._replace(done=call, stores=store(ANSWER, _answer(call, outcome))), f"answers {outcome}"
        )
    _, _, executed, reported, claim = world.calls[call - 1]
    bad = ""
    if executed:
        bad = "executed twice"
    elif reported == NOT_EXECUTED:
        bad = "executed after it was reported as not executed"
    elif claim != a.name and not config.bridge_answers:
        bad = "executed, though it waited when the answerer claimed"
    label, after, _ = put(
        idle._replace(doing=call), f"EXECUTES call {call}", _change(world, call, 2, executed + 1)
    )
    return label, after, bad


def _steps(config: CallConfig, world: World) -> Iterator[Step]:
    yield from _caller(config, world)
    for index in range(len(world.lives)):
        yield from _life(config, world, index)
    if world.born < config.lives:
        born = Answerer(world.born + 1)
        lives = (*world.lives, born) if config.overlap else (born,)
        yield f"answerer {born.name} comes", world._replace(lives=lives, born=born.name), ""


def explore_calls(config: CallConfig) -> Result:
    """Visit every reachable state, or stop at the first broken property."""
    first = World((0, 0, 0, 0), (), Caller(restarts=config.restarts), (), 0)
    parents: dict[World, tuple[World, str] | None] = {first: None}
    queue = deque([first])
    steps = executed = 0
    while queue:
        world = queue.popleft()
        for label, after, violation in _steps(config, world):
            steps += 1
            executed += "EXECUTES" in label
            if violation:
                trace, at = [label], world
                while (link := parents[at]) is not None:
                    at, one = link
                    trace.append(one)
                return Result(len(parents), steps, executed, violation, tuple(reversed(trace)))
            if after not in parents:
                parents[after] = world, label
                queue.append(after)
    return Result(len(parents), steps, executed, "", ())
