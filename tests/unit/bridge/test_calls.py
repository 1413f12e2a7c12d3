"""Calls between ROS and the PLC: every way in which one can end, on a stepped clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import pytest

from rosplc.bridge.called import Called
from rosplc.bridge.carrier import CallPorts
from rosplc.bridge.port import Context
from rosplc.bridge.status import ServiceStatus
from rosplc.bridge.use import Use
from rosplc.codec import Codec, Wire
from rosplc.config import parse_config, resolve
from rosplc.errors import BackendError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.reasons import Reason
from rosplc.ros import EndpointStatus, Reply
from rosplc.ros.lifecycle import LifecycleBackend
from rosplc.shm import (
    SERVICE,
    Answerer,
    Attached,
    Caller,
    Namespace,
    OwnedChannel,
    Part,
    Reader,
    SlotInfo,
    Writer,
    attach,
)
from rosplc.shm.constants import (
    ANSWER_ACCEPTED,
    ANSWER_DONE,
    ANSWER_FATE_UNKNOWN,
    ANSWER_NOT_EXECUTED,
    ANSWER_UNREADABLE,
    ASK_CALL,
    ASK_WITHDRAWN,
    READER_LINE,
    WRITER_LINE,
    reader_line,
)
from tests.lib.channels import acting_reader
from tests.lib.clock import SteppedClock

STORE = TypeStore.bundled("jazzy")
TYPE = "std_srvs/srv/SetBool"
WIDE = {
    part: compute_layout(STORE, f"{TYPE}_{part.word.capitalize()}", Limits(string=300)) for part in SERVICE
}


def wire(part: Part, **fields: Any) -> bytes:
    return Codec(WIDE[part], Wire.CDR).encode(WIDE[part].pack(fields))


def unwire(part: Part, data: bytes) -> dict[str, Any]:
    return WIDE[part].to_dict(Codec(WIDE[part], Wire.CDR).decode(data))


@dataclass
class Ros:
    """A backend with one service; what the bridge does to its endpoint is in ``said``."""

    capabilities: frozenset[str] = frozenset({"services"})
    name: str = "fake"
    node: str = "/fake"
    remembers: bool = True
    matched: int = 1
    ready: bool = True
    gone: set[bytes] = field(default_factory=set)
    said: list[tuple[Any, ...]] = field(default_factory=list)
    on_request: Callable[[bytes, bytes, int], None] = lambda *_: None
    on_reply: Callable[[Reply], None] = lambda _: None
    error: Exception | None = None

    def serve(self, service: str, type_name: str, qos: Any, on_request: Any) -> Ros:
        self.on_request = on_request
        return self

    def client(self, service: str, type_name: str, qos: Any) -> Ros:
        return self

    def ask(self, caller: bytes, data: bool = True) -> None:
        self.on_request(wire(Part.REQUEST, data=data), caller, 0)

    def reply(self, caller: bytes, payload: bytes) -> bool:
        if caller in self.gone:
            return False
        self.said.append(("reply", caller, unwire(Part.RESPONSE, payload)))
        return True

    def refuse(self, caller: bytes, text: str) -> bool:
        self.said.append(("refuse", caller, text))
        return caller not in self.gone

    def present(self, caller: bytes) -> bool:
        return caller not in self.gone

    def call(self, payload: bytes, on_reply: Callable[[Reply], None]) -> int:
        if self.error is not None:
            raise self.error
        self.on_reply = on_reply
        self.said.append(("call", unwire(Part.REQUEST, payload)["data"]))
        return len(self.said)

    def forget(self, number: int) -> None:
        self.said.append(("forget", number))

    def status(self) -> EndpointStatus:
        return EndpointStatus("/s", TYPE, "in", matched=self.matched)

    def close(self) -> None:
        """Nothing is open."""


class Plc:
    """The PLC's side of the service, one step at a time."""

    def __init__(self, cell: Cell) -> None:
        opened = {
            part: attach(cell.namespace, "/s", write=True, part=part)
            for part in (Part.REQUEST, Part.RESPONSE)
        }
        self.objects: dict[Part, Attached] = opened
        self.serves = cell.server == "plc"
        taken, sent = (Part.REQUEST, Part.RESPONSE) if self.serves else (Part.RESPONSE, Part.REQUEST)
        self.reader: Reader = acting_reader(opened[taken], "Task", beat_ms=100)
        self.writer: Writer = opened[sent].writer(100)
        self.layouts = {Part.REQUEST: cell.use.plan.request, Part.RESPONSE: cell.use.plan.response}
        self._record = bytearray(self.layouts[taken].size)
        self._taken, self._sent = taken, sent
        if self.serves:
            self.answerer = Answerer(opened[taken], self.reader, opened[sent])
        else:
            self.caller = Caller(opened[sent], self.writer, follows_claim=False)

    def beat(self) -> None:
        self.reader.beat()
        self.writer.beat()

    def take(self) -> tuple[str, SlotInfo, dict[str, Any]] | None:
        """Take the newest message of the bridge; for a server also say what it is."""
        info = self.reader.latest(self._record)
        if info is None:
            return None
        what = self.answerer.take(info) if self.serves else ""
        return what, info, self.layouts[self._taken].to_dict(self._record)

    def send(self, fields: dict[str, Any], **words: Any) -> None:
        self.writer.publish(self.layouts[self._sent].pack(fields), **words)

    def answer(self, info: SlotInfo, status: int = ANSWER_DONE, reason: int = 0, **fields: Any) -> None:
        self.send(fields, correlation=info.correlation, status=status, reason=reason, client=info.client)
        self.answerer.answered(info.correlation)

    def call(self, data: bool = True) -> int:
        return self.caller.call(partial(self.send, {"data": data}))

    def withdraw(self) -> bool:
        return self.caller.withdraw(partial(self.send, {}))

    def leave(self) -> None:
        for one in self.objects.values():
            one.close()

    def die(self) -> None:
        """Keep the claims, and beat no more."""
        self.beat = lambda: None  # type: ignore[method-assign]


class Cell:
    """One use of a service whose thread is the test's."""

    def __init__(self, namespace: Namespace, server: str, entry: str = "", ros: Ros | None = None) -> None:
        text = f"services: {{/s: {{type: {TYPE}, server: {server}, {entry}}}}}"
        (self.plan,) = resolve(parse_config(text)).services
        self.namespace, self.server, self.ros = namespace, server, ros or Ros()
        self.clock = SteppedClock()
        self.plc: Plc | None = None
        self.plcs: list[Plc] = []
        self.bridge()

    def bridge(self) -> None:
        """Start a bridge; the one before is gone without a word."""
        context = Context(self.namespace, "cell", bytes(16), "jazzy", clock=self.clock)
        self.ports = CallPorts(context, 1_000_000)
        self.use: Use = self.ports.make(self.plan)
        self.use.open()
        self.use.connect(self.ros)  # type: ignore[arg-type]
        self.ports.add(self.use)
        self.use.begin(self.clock.monotonic_ns())

    def kill(self) -> None:
        """End the bridge so that it can do nothing any more."""
        for channel in self.use._channels.values():
            channel._abandon()  # as in a forked child: claims and words stay

    def restart(self) -> None:
        self.kill()
        self.bridge()
        self.turn(0.02)

    def attach(self) -> Plc:
        """Start the PLC's program, and let the bridge see it live."""
        self.plc = Plc(self)
        self.plcs.append(self.plc)
        self.turn(0.05, 4)
        return self.plc

    def turn(self, seconds: float = 0.006, times: int = 1) -> None:
        """Let time pass: the PLC beats, and the thread of the calls goes round."""
        for _ in range(times):
            if self.plc is not None:
                self.plc.beat()
            now = self.clock.advance(seconds)
            _, again = self.ports.take(now)
            for use in again:
                self.ports.remove(use)
                if use.reopen(now):
                    self.ports.add(use)

    @property
    def status(self) -> ServiceStatus:
        """The state, with each call in exactly one number."""
        found = self.use.status(self.clock.monotonic_ns())
        ends = found.done + found.unreadable + found.late + found.outstanding
        assert found.received == ends + sum(found.not_executed.values()) + sum(found.fate_unknown.values())
        return found

    def close(self) -> None:
        for plc in self.plcs:
            plc.leave()
        self.use.close()


Make = Callable[..., Cell]


@pytest.fixture
def make(shm_namespace: Namespace) -> Iterator[Make]:
    cells: list[Cell] = []

    def start(server: str, entry: str = "", **ros: Any) -> Cell:
        cells.append(Cell(shm_namespace, server, entry, Ros(**ros)))
        return cells[-1]

    yield start
    for cell in cells:
        cell.close()


def caller(client: int, number: int = 0) -> bytes:
    return client.to_bytes(8, "little") + number.to_bytes(8, "little")


A, B = caller(1), caller(2)


def begun(cell: Cell, who: bytes = A) -> SlotInfo:
    """Have a call handed out, and begun by the PLC."""
    cell.ros.ask(who)
    cell.turn()
    assert cell.plc is not None
    return begun_by(cell.plc, who)


def begun_by(plc: Plc, who: bytes = A) -> SlotInfo:
    found = plc.take()
    assert found is not None
    what, info, request = found
    assert (what, info.status, info.client, request) == ("begin", ASK_CALL, who, {"data": True})
    return info


# -- the PLC is the server


def test_a_call_reaches_the_plc_and_its_answer_the_caller(make: Make) -> None:
    cell = make("plc")
    plc = cell.attach()
    info = begun(cell)
    assert cell.status.outstanding == 1
    plc.answer(info, success=True, message="ok")
    cell.turn()
    assert cell.ros.said == [("reply", A, {"success": True, "message": "ok"})]
    assert (cell.status.done, cell.status.received) == (1, 1)
    second = begun(cell, B)
    assert second.correlation == info.correlation + 1


def test_one_call_at_a_time_and_the_rest_waits_within_its_bounds(make: Make) -> None:
    cell = make("plc", "depth: 3, per_client: 2, rate_limit: 100ms")
    plc = cell.attach()
    info = begun(cell)
    cell.ros.ask(caller(1, 1))
    cell.ros.ask(caller(1, 2))  # the third of this client
    cell.ros.ask(B)
    cell.ros.ask(caller(3))  # the fourth of all
    cell.ros.ask(B)  # the same again
    cell.turn()
    assert plc.take() is None
    assert [said[1] for said in cell.ros.said] == [caller(1, 2), caller(3)]
    assert cell.status.not_executed == {"queue_full": 2}
    plc.answer(info)
    cell.turn(0.05)
    assert plc.take() is None  # the rate limit
    cell.turn(0.06)
    found = plc.take()
    assert found is not None
    assert found[1].client == caller(1, 1)
    assert cell.status.outstanding == 2


def test_a_call_that_waited_too_long_never_reaches_the_plc(make: Make) -> None:
    cell = make("plc", "expire_after: 200ms, fallback: {message: late}")
    plc = cell.attach()
    info = begun(cell)
    cell.ros.ask(B)
    cell.turn(0.05, 3)
    assert cell.status.outstanding == 2
    cell.turn(0.05, 3)
    assert cell.ros.said == [("reply", B, {"success": False, "message": "late"})]
    assert cell.status.not_executed == {"expired": 1}
    plc.answer(info)  # the one that was begun has all the time it needs
    cell.turn()
    assert cell.status.done == 1


def test_a_call_that_was_handed_out_and_not_begun_is_withdrawn(make: Make) -> None:
    cell = make("plc", "expire_after: 200ms")
    plc = cell.attach()
    cell.ros.ask(A)
    cell.turn(0.05, 6)
    assert cell.status.not_executed == {"expired": 1}
    found = plc.take()
    assert found is not None
    what, info, _ = found
    assert (what, info.status) == ("withdrawn", ASK_CALL | ASK_WITHDRAWN)
    plc.answer(info, ANSWER_NOT_EXECUTED)
    cell.turn()
    plc.answer(begun(cell, B))
    cell.turn()
    assert (cell.status.done, cell.status.strays) == (1, 1)


@pytest.mark.parametrize("how", ["waiting", "handed out", "begun"])
def test_a_caller_that_has_gone(make: Make, how: str) -> None:
    cell = make("plc", "rate_limit: 30ms" if how == "waiting" else "")
    plc = cell.attach()
    if how == "waiting":
        plc.answer(begun(cell, B))
        cell.turn()
    elif how == "begun":
        info = begun(cell)
    if how != "begun":
        cell.ros.ask(A)
    cell.turn()
    cell.ros.gone.add(A)
    cell.turn(0.03, 3)
    found = plc.take()
    if how == "waiting":
        assert found is None
        assert cell.status.not_executed == {"caller_gone": 1}
    elif how == "handed out":
        assert found is not None
        assert found[0] == "withdrawn"
        assert cell.status.not_executed == {"caller_gone": 1}
    else:
        assert found is not None
        assert (found[0], found[1].status) == ("more", ASK_CALL | ASK_WITHDRAWN)
        assert cell.status.outstanding == 1
        plc.answer(info)
        cell.turn()
        assert (cell.status.late, cell.status.done) == (1, 0)


@pytest.mark.parametrize(
    ("status", "number", "kept"),
    [
        (ANSWER_NOT_EXECUTED, Reason.REJECTED, ("not_executed", {"rejected": 1})),
        (ANSWER_FATE_UNKNOWN, Reason.NONE, ("fate_unknown", {"none": 1})),
        (ANSWER_NOT_EXECUTED, 77, ("not_executed", {"none": 1})),
        (ANSWER_UNREADABLE, Reason.TOO_LARGE, ("unreadable", 1)),
    ],
)
def test_the_plc_answers_without_a_response(make: Make, status: int, number: int, kept: Any) -> None:
    cell = make("plc")
    plc = cell.attach()
    plc.answer(begun(cell), status, number)
    cell.turn()
    assert getattr(cell.status, kept[0]) == kept[1]
    assert [said[:2] for said in cell.ros.said] == [("refuse", A)]
    assert cell.status.judgement[1].startswith("call")


def test_without_a_plc_no_call_waits(make: Make) -> None:
    cell = make("plc", "fallback: {message: down}")
    cell.ros.ask(A)
    cell.turn()
    assert cell.ros.said == [("reply", A, {"success": False, "message": "down"})]
    plc = cell.attach()
    assert plc.take() is None
    plc.answer(begun(cell, B), success=True)
    cell.turn()
    plc.die()
    cell.turn(0.1, 8)
    cell.ros.ask(caller(3))
    cell.turn()
    assert cell.status.not_executed == {"plc_down": 2}
    assert not cell.status.peer_alive


@pytest.mark.parametrize("taken", [False, True])
def test_a_plc_that_falls_silent(make: Make, taken: bool) -> None:
    """The caller hears of it; nothing is handed out before the PLC has ended what it had begun."""
    cell = make("plc")
    plc = cell.attach()
    if taken:
        info = begun(cell)
    else:
        cell.ros.ask(A)
        cell.turn()
    beat = plc.beat
    plc.die()
    cell.turn(0.1, 8)
    assert [said[:2] for said in cell.ros.said] == [("refuse", A)]
    if not taken:
        assert cell.status.not_executed == {"plc_down": 1}
        return
    assert cell.status.fate_unknown == {"plc_down": 1}
    plc.beat = beat  # type: ignore[method-assign]
    cell.turn(0.02, 3)
    cell.ros.ask(B)
    cell.turn(0.02, 3)
    found = plc.take()
    assert found is not None
    assert (found[0], found[1].client) == ("more", A)
    plc.answer(info)
    cell.turn(0.02, 2)
    assert (cell.status.done, cell.status.strays) == (0, 1)
    found = plc.take()
    assert found is not None
    assert (found[0], found[1].client) == ("begin", B)


@pytest.mark.parametrize("taken", [False, True])
def test_a_plc_that_starts_again_executes_nothing_from_before(make: Make, taken: bool) -> None:
    cell = make("plc")
    plc = cell.attach()
    if taken:
        begun(cell)
    else:
        cell.ros.ask(A)
        cell.turn()
    plc.leave()
    cell.plcs.clear()
    again = cell.attach()
    assert cell.status.fate_unknown == ({"plc_down": 1} if taken else {})
    assert cell.status.not_executed == ({} if taken else {"plc_down": 1})
    found = again.take()
    assert found is None or found[0] in ("withdrawn", "unknown")
    if found is not None:
        again.answer(found[1], ANSWER_NOT_EXECUTED)
        cell.turn()
    again.answer(begun(cell, B))
    cell.turn()
    assert cell.status.done == 1


def test_requests_that_cannot_be_read(make: Make) -> None:
    cell = make("plc")
    cell.attach()
    cell.ros.on_request(b"\x00\x01", A, 0)
    cell.turn()
    assert cell.status.not_executed == {"rejected": 1}


def test_two_answers_of_a_plc_that_count_once(make: Make) -> None:
    cell = make("plc")
    plc = cell.attach()
    info = begun(cell)
    plc.answer(info)
    cell.turn()
    plc.answer(info)
    cell.turn()
    assert (cell.status.done, cell.status.strays, len(cell.ros.said)) == (1, 1, 1)


def test_objects_that_were_removed_are_created_again(make: Make) -> None:
    cell = make("plc")
    plc = cell.attach()
    begun(cell)
    cell.namespace.path("/s", Part.REQUEST).unlink()
    assert cell.use.check(cell.clock.monotonic_ns())
    cell.ports.remove(cell.use)
    assert cell.use.reopen(cell.clock.monotonic_ns())
    cell.ports.add(cell.use)
    assert cell.status.fate_unknown == {"bridge_restarted": 1}
    found = plc.take()
    assert found is not None
    assert found[1].status & ASK_WITHDRAWN
    plc.leave()
    cell.plcs.clear()
    again = cell.attach()
    again.answer(begun(cell, B))
    cell.turn()
    assert cell.status.done == 1


def test_a_bridge_that_stops_leaves_to_the_next_one_what_the_plc_has_begun(make: Make) -> None:
    cell = make("plc")
    plc = cell.attach()
    info = begun(cell)
    cell.ros.ask(B)
    cell.use.finish(cell.clock.monotonic_ns())
    assert [said[:2] for said in cell.ros.said] == [("refuse", B)]
    cell.use.close()
    cell.bridge()
    cell.turn()
    plc.answer(info, success=True)
    cell.turn()
    assert cell.ros.said[1:] == [("reply", A, {"success": True, "message": ""})]
    assert (cell.status.done, cell.status.received) == (1, 1)


@pytest.mark.parametrize("remembers", [True, False])
@pytest.mark.parametrize("answered", ["no", "before", "after"])
def test_a_bridge_that_was_killed_while_the_plc_carried_out_a_call(
    make: Make, answered: str, remembers: bool
) -> None:
    cell = make("plc", remembers=remembers)
    plc = cell.attach()
    info = begun(cell)
    if answered == "before":
        plc.answer(info, success=True)
    cell.restart()
    if answered == "after":
        assert cell.status.outstanding == 1
        plc.answer(info, success=True)
    cell.turn(0.02, 3)
    if answered == "no":
        assert cell.status.outstanding == 1
        plc.leave()
        cell.plcs.clear()
        cell.attach()
        assert sum(cell.status.fate_unknown.values()) == 1
    elif remembers:
        assert cell.ros.said == [("reply", A, {"success": True, "message": ""})]
        assert cell.status.done == 1
    else:
        assert cell.status.fate_unknown == {"bridge_restarted": 1}
    assert cell.status.received == 1


def test_a_caller_that_the_middleware_finds_again_only_later(make: Make) -> None:
    cell = make("plc")
    plc = cell.attach()
    info = begun(cell)
    cell.ros.gone.add(A)
    cell.restart()
    plc.answer(info, success=True)
    cell.turn(0.5, 3)
    assert cell.status.outstanding == 1
    cell.ros.gone.clear()
    cell.turn()
    assert cell.status.done == 1


def test_a_bridge_that_stops_while_a_caller_is_not_found_again(make: Make) -> None:
    """The answer was taken, and no later bridge finds it: it is counted now."""
    cell = make("plc")
    plc = cell.attach()
    info = begun(cell)
    cell.ros.gone.add(A)
    cell.restart()
    plc.answer(info, success=True)
    cell.turn(0.5, 3)
    assert cell.status.outstanding == 1
    cell.use.finish(cell.clock.monotonic_ns())
    assert (cell.status.outstanding, cell.status.late) == (0, 1)


def test_an_answer_that_has_come_is_passed_on_before_the_objects_are_left(make: Make) -> None:
    cell = make("plc")
    plc = cell.attach()
    plc.answer(begun(cell), success=True)
    cell.use.give_up(cell.clock.monotonic_ns())
    assert [said[:2] for said in cell.ros.said] == [("reply", A)]
    assert cell.status.done == 1


def test_objects_are_not_opened_twice_for_one_fault(make: Make) -> None:
    """Two threads may see it; to open them twice would end the calls of the first time."""
    cell = make("plc")
    cell.attach()
    begun(cell)
    cell.namespace.path("/s", Part.REQUEST).unlink()
    now = cell.clock.monotonic_ns()
    assert cell.use.check(now)
    assert cell.use.reopen(now)
    before = cell.use._channels
    assert cell.use.reopen(now)
    assert cell.use._channels is before
    assert not cell.use.check(now)


def test_a_look_at_objects_that_are_being_opened(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = make("plc")
    cell.attach()
    seen: list[bool] = []
    open_reader = OwnedChannel.reader

    def look(channel: OwnedChannel, beat_ms: int) -> Reader:
        seen.append(cell.use.check(0))
        cell.use.ask(0)
        return open_reader(channel, beat_ms)

    monkeypatch.setattr(OwnedChannel, "reader", look)
    cell.use.fail(0, RuntimeError("for a test"))
    assert cell.use.reopen(0)
    assert (seen, cell.use.problem) == ([False], "")


def test_a_bridge_that_was_killed_before_the_plc_began(make: Make) -> None:
    """The next one does not hand the call out again: it withdraws it."""
    cell = make("plc")
    plc = cell.attach()
    cell.ros.ask(A)
    cell.turn()
    cell.restart()
    assert cell.status.not_executed == {"bridge_restarted": 1}
    found = plc.take()
    assert found is not None
    assert found[0] == "withdrawn"


def test_a_bridge_that_was_killed_after_it_passed_the_answer_on(make: Make) -> None:
    cell = make("plc")
    plc = cell.attach()
    plc.answer(begun(cell))
    cell.turn()
    cell.restart()
    assert (cell.status.received, len(cell.ros.said)) == (0, 1)


def test_a_plc_that_started_again_while_no_bridge_was_there(make: Make) -> None:
    """What it had begun may have been executed, though its new life knows nothing of it."""
    cell = make("plc")
    plc = cell.attach()
    begun(cell)
    cell.kill()
    plc.leave()
    cell.plcs.clear()
    cell.bridge()
    again = cell.attach()
    cell.turn(0.5, 25)
    found = again.take()
    if found is not None:
        again.answer(found[1], ANSWER_NOT_EXECUTED)
    cell.turn(0.02, 2)
    assert sum(cell.status.fate_unknown.values()) == 1
    again.answer(begun(cell, B))
    cell.turn()
    assert cell.status.done == 1


def test_a_withdrawn_call_of_a_plc_and_a_bridge_that_both_started_again(make: Make) -> None:
    """The new program never saw that the call was withdrawn: the new bridge tells it once more."""
    cell = make("plc")
    plc = cell.attach()
    begun(cell)
    plc.die()
    cell.turn(0.1, 8)
    assert cell.status.fate_unknown == {"plc_down": 1}
    cell.kill()
    plc.leave()
    cell.plcs.clear()
    cell.plc = again = Plc(cell)
    cell.plcs.append(again)
    cell.bridge()
    cell.turn(0.02, 3)
    found = again.take()
    assert found is not None
    assert found[1].status & ASK_WITHDRAWN
    again.answer(found[1], ANSWER_NOT_EXECUTED)
    cell.turn()
    assert cell.status.fate_unknown == {"bridge_restarted": 1}
    again.answer(begun(cell, B))
    cell.turn()
    assert cell.status.done == 1


# -- the PLC is the client


def test_the_plc_calls_a_server(make: Make) -> None:
    cell = make("ros")
    plc = cell.attach()
    number = plc.call()
    cell.turn()
    assert cell.ros.said == [("call", True)]
    assert plc.caller.begun()
    cell.ros.on_reply(Reply(wire(Part.RESPONSE, success=True, message="hi")))
    cell.turn()
    found = plc.take()
    assert found is not None
    assert (found[1].correlation, found[1].status) == (number, ANSWER_DONE)
    assert found[2] == {"success": True, "message": "hi"}
    assert plc.caller.answer(found[1]) == ANSWER_DONE
    assert cell.status.done == 1
    plc.call(False)
    cell.turn()
    assert cell.ros.said[1:] == [("call", False)]


def test_no_request_is_taken_while_no_server_is_ready(make: Make) -> None:
    cell = make("ros", ready=False)
    plc = cell.attach()
    response = plc.objects[Part.RESPONSE].snapshot().writer
    request = plc.objects[Part.REQUEST].snapshot().readers[0]
    assert (response.sources, request.sinks) == (0, 0)
    plc.call()
    cell.turn(0.02, 3)
    assert not plc.caller.begun()
    assert cell.status.received == 0
    cell.ros.ready = True
    cell.turn(0.02, 2)
    assert cell.ros.said == [("call", True)]
    assert plc.objects[Part.RESPONSE].snapshot().writer.sources == 1


def test_what_a_dead_plc_asked_for_is_never_sent(make: Make) -> None:
    cell = make("ros", ready=False)
    plc = cell.attach()
    plc.call()
    plc.die()
    cell.turn(0.1, 8)
    cell.ros.ready = True
    cell.turn(0.1, 8)
    assert cell.ros.said == []
    plc.leave()
    cell.plcs.clear()
    cell.attach()
    cell.turn(0.02, 5)
    assert cell.ros.said == []


@pytest.mark.parametrize("before", [False, True])
def test_a_call_that_the_plc_withdraws(make: Make, before: bool) -> None:
    cell = make("ros", ready=not before)
    plc = cell.attach()
    plc.call()
    cell.turn()
    assert plc.withdraw() is not before
    cell.ros.ready = True
    cell.turn(0.02, 2)
    found = plc.take()
    assert found is not None
    if before:
        assert cell.ros.said == []
        assert cell.status.not_executed == {"caller_gone": 1}
        assert found[1].status == ANSWER_NOT_EXECUTED
    else:
        assert cell.ros.said == [("call", True), ("forget", 1)]
        assert cell.status.fate_unknown == {"caller_gone": 1}
        assert found[1].status == ANSWER_FATE_UNKNOWN
        cell.ros.on_reply(Reply(wire(Part.RESPONSE)))  # the backend had begun to hand it over
        cell.turn()
        assert plc.take() is None
    assert cell.status.received == 1


@pytest.mark.parametrize(
    ("reply", "status", "reason", "counted"),
    [
        (
            Reply(None, "not executed", Reason.NO_SERVER),
            ANSWER_NOT_EXECUTED,
            Reason.NO_SERVER,
            {"no_server": 1},
        ),
        (
            Reply(None, "fate unknown", Reason.SERVER_GONE),
            ANSWER_FATE_UNKNOWN,
            Reason.SERVER_GONE,
            {"server_gone": 1},
        ),
        (Reply(wire(Part.RESPONSE, message="x" * 81)), ANSWER_UNREADABLE, Reason.TOO_LARGE, 1),
        (Reply(b"\x00\x01\x00\x00\x01"), ANSWER_UNREADABLE, Reason.NONE, 1),
    ],
)
def test_answers_without_a_response(make: Make, reply: Reply, status: int, reason: int, counted: Any) -> None:
    cell = make("ros")
    plc = cell.attach()
    plc.call()
    cell.turn()
    cell.ros.on_reply(reply)
    cell.turn()
    found = plc.take()
    assert found is not None
    assert (found[1].status, found[1].reason) == (status, reason)
    name = {ANSWER_NOT_EXECUTED: "not_executed", ANSWER_FATE_UNKNOWN: "fate_unknown"}.get(
        status, "unreadable"
    )
    assert getattr(cell.status, name) == counted


def test_a_response_that_may_be_cut(make: Make) -> None:
    cell = make("ros", "on_overflow: truncate, limits: {response.message: 4}")
    plc = cell.attach()
    plc.call()
    cell.turn()
    cell.ros.on_reply(Reply(wire(Part.RESPONSE, message="abcdefgh")))
    cell.turn()
    found = plc.take()
    assert found is not None
    assert (found[1].status, found[2]["message"]) == (ANSWER_DONE, "abcd")


def test_a_request_that_the_middleware_refuses(make: Make) -> None:
    cell = make("ros", error=BackendError("ROS009", "closed"))
    plc = cell.attach()
    plc.call()
    cell.turn()
    assert cell.status.not_executed == {"rejected": 1}
    assert "closed" in cell.status.reason


def test_a_bridge_that_was_killed_while_a_server_carried_out_a_call(make: Make) -> None:
    """It cannot know what became of it, and says so; it does not call again."""
    cell = make("ros")
    plc = cell.attach()
    number = plc.call()
    cell.turn()
    cell.restart()
    found = plc.take()
    assert found is not None
    info = found[1]
    assert (info.correlation, info.status, info.reason) == (
        number,
        ANSWER_FATE_UNKNOWN,
        Reason.BRIDGE_RESTARTED,
    )
    assert cell.status.fate_unknown == {"bridge_restarted": 1}
    cell.turn(0.02, 3)
    assert cell.ros.said == [("call", True)]
    cell.restart()
    assert cell.status.received == 0  # it has its answer


@pytest.mark.parametrize("replaced", [False, True])
def test_an_answer_that_cannot_be_sent_counts_once(make: Make, replaced: bool) -> None:
    """Another has taken the claim: with the objects opened again the call has one end."""
    cell = make("ros")
    plc = cell.attach()
    plc.call()
    cell.turn()
    cell.ros.on_reply(Reply(wire(Part.RESPONSE, success=True)))
    cell.use._channels[Part.RESPONSE].region.store(WRITER_LINE["writer_epoch"], 12345)
    if replaced:
        cell.namespace.path("/s", Part.REQUEST).unlink()
    cell.turn(0.02, 2)
    assert cell.status.fate_unknown == {"bridge_restarted": 1}
    assert (cell.status.received, cell.status.done) == (1, 0)
    if not replaced:
        found = plc.take()
        assert found is not None
        assert found[1].status == ANSWER_FATE_UNKNOWN


def test_a_request_from_before_the_bridge_is_sent_once(make: Make) -> None:
    cell = make("ros", ready=False)
    plc = cell.attach()
    plc.call()
    cell.turn()
    cell.kill()
    cell.ros.ready = True
    cell.bridge()
    cell.turn(0.02, 4)
    assert cell.ros.said == [("call", True)]


def test_a_plc_that_starts_again_while_a_server_carries_out_its_call(make: Make) -> None:
    cell = make("ros")
    plc = cell.attach()
    plc.call()
    cell.turn()
    plc.leave()
    cell.plcs.clear()
    again = cell.attach()
    assert cell.ros.said == [("call", True), ("forget", 1)]
    assert cell.status.fate_unknown == {"plc_down": 1}
    assert again.take() is None or again.caller.correlation == 0
    again.call(False)
    cell.turn()
    assert cell.ros.said[2:] == [("call", False)]


_COUNTER = 0xFFFFFFFF


def _compare_counters_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sabotage: what is compared of two numbers leaves out who has made them."""
    answer, hear = Caller.answer, Called._hear

    def same_counter(self: Caller, info: SlotInfo) -> int:
        if not (self.correlation ^ info.correlation) & _COUNTER:
            self.correlation = info.correlation
        return answer(self, info)

    def same_number(self: Called, now_ns: int) -> None:
        for number, reply in tuple(self.events):
            if self._open_call is not None and not (self._open_call ^ number) & _COUNTER:
                self.events.remove((number, reply))
                self.events.append((self._open_call, reply))
        hear(self, now_ns)

    monkeypatch.setattr(Caller, "answer", same_counter)
    monkeypatch.setattr(Called, "_hear", same_number)


@pytest.mark.parametrize("sabotaged", [False, True])
def test_an_answer_to_a_call_of_an_earlier_bridge(
    make: Make, monkeypatch: pytest.MonkeyPatch, sabotaged: bool
) -> None:
    """It never ends a new call, though the two have the same counter; without the epoch it would."""
    if sabotaged:
        _compare_counters_alone(monkeypatch)
    cell = make("plc")
    plc = cell.attach()
    first = begun(cell)
    plc.answer(first, success=True)
    cell.turn()
    cell.restart()
    cell.turn(0.05, 4)
    second = begun(cell, B)
    assert second.correlation & _COUNTER == first.correlation & _COUNTER
    plc.answer(first, message="for the earlier call")
    cell.turn()
    wrong = [answered for word, who, answered in cell.ros.said if who == B]
    assert bool(wrong) is sabotaged, wrong
    if not sabotaged:
        assert (cell.status.strays, cell.status.outstanding) == (1, 1)
        plc.answer(second, success=True)
        cell.turn()
        assert cell.ros.said[-1] == ("reply", B, {"success": True, "message": ""})


@pytest.mark.parametrize("sabotaged", [False, True])
def test_an_answer_to_a_call_of_an_earlier_program(
    make: Make, monkeypatch: pytest.MonkeyPatch, sabotaged: bool
) -> None:
    """As above, with the PLC as the caller: the server had answered before it was to forget the call."""
    if sabotaged:
        _compare_counters_alone(monkeypatch)
    cell = make("ros")
    plc = cell.attach()
    first = plc.call()
    cell.turn()
    answer_first = cell.ros.on_reply
    plc.leave()
    cell.plcs.clear()
    again = cell.attach()
    second = again.call(False)
    cell.turn()
    assert second & _COUNTER == first & _COUNTER
    again.take()
    answer_first(Reply(wire(Part.RESPONSE, message="for the earlier call")))
    cell.turn()
    wrong = again.take()
    assert (wrong is not None) is sabotaged
    if not sabotaged:
        cell.ros.on_reply(Reply(wire(Part.RESPONSE, success=True)))
        cell.turn()
        found = again.take()
        assert found is not None
        assert (found[1].correlation, found[2]["success"]) == (second, True)


def test_a_bridge_that_stops_ends_the_call_of_the_plc(make: Make) -> None:
    cell = make("ros")
    plc = cell.attach()
    plc.call()
    cell.turn()
    cell.use.finish(cell.clock.monotonic_ns())
    found = plc.take()
    assert found is not None
    assert found[1].status == ANSWER_FATE_UNKNOWN


def test_a_backend_without_services(make: Make) -> None:
    cell = make("ros")
    with pytest.raises(BackendError, match="does not support services"):
        cell.use.connect(Ros(capabilities=frozenset({"topics"})))  # type: ignore[arg-type]


def test_an_answer_that_ends_no_call_does_not_stop_the_service(make: Make) -> None:
    """As from a program that takes the service for an action, or from a damaged slot."""
    cell = make("plc")
    plc = cell.attach()
    info = begun(cell)
    plc.send({}, correlation=info.correlation, status=ANSWER_ACCEPTED, client=info.client)
    cell.turn()
    assert (cell.status.outstanding, cell.status.strays) == (1, 1)
    plc.answer(info, success=True)
    cell.turn()
    plc.answer(begun(cell, B), success=True)
    cell.turn()
    assert cell.status.done == 2


def test_a_call_that_could_not_be_handed_out_was_not_executed(make: Make) -> None:
    """The claim was lost before it was published: it waits for the next objects."""
    cell = make("plc")
    plc = cell.attach()
    cell.use._channels[Part.REQUEST].region.store(WRITER_LINE["writer_epoch"], 12345)
    cell.ros.ask(A)
    cell.turn(0.02, 10)
    assert cell.status.fate_unknown == {}
    plc.answer(begun_by(plc))
    cell.turn()
    assert cell.status.done == 1


def test_a_call_whose_withdrawal_failed_is_not_handed_out_again(make: Make) -> None:
    """The PLC may begin it still: nobody has told it not to."""
    cell = make("plc", "expire_after: 200ms")
    plc = cell.attach()
    cell.ros.ask(A)
    cell.turn()
    cell.use._channels[Part.REQUEST].region.store(WRITER_LINE["writer_epoch"], 12345)
    begun_calls: list[int] = []
    cell.turn(0.3)
    found = plc.take()
    while found is not None:
        begun_calls += [found[1].correlation] * (found[0] == "begin")
        cell.turn()
        found = plc.take()
    assert len(begun_calls) <= 1
    assert cell.status.not_executed == {}
    assert sum(cell.status.fate_unknown.values()) == 1


def test_a_refusal_of_a_new_program_says_nothing_to_a_new_bridge(make: Make) -> None:
    """The program before had begun the call; the one after it found it withdrawn, with no bridge there."""
    cell = make("plc")
    plc = cell.attach()
    begun(cell)
    plc.leave()
    cell.plcs.clear()
    again = cell.plc = Plc(cell)
    cell.plcs.append(again)
    use: Any = cell.use
    use._caller.lost(partial(use._send, use._open_call.record))
    cell.kill()  # before it told the caller
    found = again.take()
    assert found is not None
    assert found[1].status & ASK_WITHDRAWN
    again.answer(found[1], ANSWER_NOT_EXECUTED, Reason.CALLER_GONE)  # M29: it knows no more
    cell.bridge()
    cell.turn(0.02, 3)
    assert cell.status.not_executed == {}
    assert sum(cell.status.fate_unknown.values()) == 1


def test_a_managed_bridge_answers_an_earlier_ones_caller_once_it_is_active(make: Make) -> None:
    cell = make("plc")
    plc = cell.attach()
    info = begun(cell)
    plc.answer(info, success=True)
    cell.kill()
    cell.ros.topic = "/s"  # type: ignore[attr-defined]
    node: Any = LifecycleBackend(cell.ros)  # type: ignore[arg-type]
    ros, cell.ros = cell.ros, node
    cell.bridge()
    cell.ros = ros
    cell.turn(0.5, 3)
    assert cell.status.outstanding == 1
    node.activate()
    cell.turn()
    assert cell.ros.said == [("reply", A, {"success": True, "message": ""})]
    assert cell.status.done == 1


def test_a_request_whose_sending_fails_unexpectedly_has_an_end(make: Make) -> None:
    cell = make("ros", error=RuntimeError("can't start new thread"))
    plc = cell.attach()
    plc.call()
    cell.turn()
    found = plc.take()
    assert found is not None
    assert found[1].status == ANSWER_FATE_UNKNOWN
    assert "new thread" in cell.status.reason


def test_a_plc_that_starts_again_while_its_call_is_being_sent(make: Make) -> None:
    """What the new program asks for at once is not lost."""
    cell = make("ros")
    plc = cell.attach()
    lives: list[Plc] = []
    send = cell.ros.call

    def slow(payload: bytes, on_reply: Callable[[Reply], None]) -> int:
        if not lives:
            plc.leave()
            cell.plcs.clear()
            lives.append(Plc(cell))
            cell.plc = lives[0]
            cell.plcs.extend(lives)
            lives[0].call(False)
        return send(payload, on_reply)

    cell.ros.call = slow  # type: ignore[method-assign]
    plc.call()
    cell.turn(0.02, 5)
    assert cell.ros.said[-1] == ("call", False)
    cell.ros.on_reply(Reply(wire(Part.RESPONSE, success=True)))
    cell.turn()
    found = lives[0].take()
    assert found is not None
    assert found[1].status == ANSWER_DONE


def test_an_answer_that_has_come_is_passed_on_before_the_bridge_stops(make: Make) -> None:
    cell = make("ros")
    plc = cell.attach()
    plc.call()
    cell.turn()
    cell.ros.on_reply(Reply(wire(Part.RESPONSE, success=True)))
    cell.use.finish(cell.clock.monotonic_ns())
    found = plc.take()
    assert found is not None
    assert (found[1].status, cell.status.done) == (ANSWER_DONE, 1)


@pytest.mark.parametrize("gone", [False, True])
def test_a_call_that_was_begun_stays_so_whatever_the_line_says_later(make: Make, gone: bool) -> None:
    """As after a stray pointer of the PLC's: the call was executed, and the next one is handed out."""
    cell = make("plc", "expire_after: 200ms")
    plc = cell.attach()
    info = begun(cell)
    cell.turn()
    if gone:
        cell.ros.gone.add(A)
        cell.turn()
    cell.use._channels[Part.REQUEST].region.store(reader_line(0) + READER_LINE["taken"], 0)
    if gone:
        plc.die()  # for a while
    cell.turn(0.1, 10)
    vars(plc).pop("beat", None)
    cell.turn(0.02, 4)
    assert cell.status.not_executed == {}
    plc.answer(info)
    cell.turn(0.02, 2)
    assert (plc.take() is None) is not gone
    plc.answer(begun(cell, B))
    cell.turn()
    assert cell.status.done == 2 - gone
