"""Calls: spec/shm-format.md, section 11."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest

from rosplc._core import check_identity
from rosplc.errors import ChannelError
from rosplc.shm import (
    ACTION,
    SERVICE,
    Answerer,
    Attached,
    Caller,
    Description,
    Direction,
    Group,
    Namespace,
    OwnedChannel,
    Part,
    Reader,
    SlotInfo,
    Writer,
    attach,
)
from rosplc.shm import constants as spec
from tests.lib.channels import acting_reader, describe, open_channel, open_service, pattern

_RECORD = pattern(7, 64)
_ANSWER = bytes(32)
_TAKEN = spec.reader_line(0) + spec.READER_LINE["taken"]


class Server:
    """A PLC's server, one life of it: each claims line 0 of the request object."""

    def __init__(self, namespace: Namespace, stack: ExitStack) -> None:
        self.asks: Attached = stack.enter_context(attach(namespace, "/add", part=Part.REQUEST, write=True))
        self.answers = stack.enter_context(attach(namespace, "/add", part=Part.RESPONSE, write=True))
        self.reader: Reader = acting_reader(self.asks, "server", beat_ms=50)
        self.writer: Writer = self.answers.writer(beat_ms=50)
        self.answerer = Answerer(self.asks, self.reader, self.answers)
        self.executed: list[int] = []

    def look(self) -> str:
        """Take what is new, and say what it is."""
        info = self.reader.latest(bytearray(64))
        if info is None:
            return "nothing"
        self.info = info
        return self.answerer.take(info)

    def execute(self) -> None:
        """Take a new call and carry it out."""
        assert self.look() == "begin"
        self.executed.append(self.info.correlation)

    def answer(self, status: int = spec.ANSWER_DONE) -> None:
        """End the call taken last."""
        info = self.info
        self.writer.publish(
            _ANSWER, correlation=info.correlation, status=status, client=info.client, reason=3
        )
        self.answerer.answered(info.correlation)

    def crash(self) -> None:
        """Make the claims silent ones: the next claimant replaces them."""
        for region in (self.asks.region, self.answers.region):
            region.store(spec.reader_line(0) + spec.READER_LINE["beat_ms"], 1)
            region.store(spec.WRITER_LINE["writer_beat_ms"], 1)


class Bridge:
    """A bridge that calls a server in the PLC."""

    def __init__(self, namespace: Namespace) -> None:
        self.asks, self.answers = open_service(namespace)
        self.writer = self.asks.writer()
        self.reader = self.answers.reader()
        self.caller = Caller(self.asks, self.writer, follows_claim=True)
        self.send = partial(self.writer.publish, _RECORD)

    def poll(self) -> int:
        """Take the newest answer and say what it is."""
        info = self.reader.latest(bytearray(32))
        return 0 if info is None else self.caller.answer(info)

    def close(self) -> None:
        self.asks.close()
        self.answers.close()


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def bridge(shm_namespace: Namespace, stack: ExitStack) -> Bridge:
    made = Bridge(shm_namespace)
    stack.callback(made.close)
    return made


@pytest.fixture
def server(bridge: Bridge, shm_namespace: Namespace, stack: ExitStack) -> Server:
    return Server(shm_namespace, stack)


# ---- objects


@pytest.mark.parametrize("part", [*SERVICE, *ACTION])
def test_parts(part: Part) -> None:
    """Who writes an object decides its direction, and its name leads back to it."""
    caller_writes = part in (Part.REQUEST, Part.GOAL)
    assert part.direction("plc") == (Direction.TO_PLC if caller_writes else Direction.TO_ROS)
    assert part.direction("ros") == (Direction.TO_ROS if caller_writes else Direction.TO_PLC)
    namespace = Namespace("cell1")
    name = namespace.object_name("/robot1/add", part, "left")
    assert namespace.part_of(name) is part
    assert namespace.name_of(name) == ("/robot1/add", "left")
    assert namespace.name_of(namespace.object_name("/robot1/add", part)) == ("/robot1/add", "")
    assert Namespace("cell2").part_of(name) is None


@pytest.mark.parametrize("client", ["1", "a-b", "a.b", "a b", "a" * 33, "é", "_a", "a\n"])
def test_clients_that_are_no_names(client: str) -> None:
    """What could be taken for another object's name is refused; a topic has no clients."""
    for part, name in ((Part.REQUEST, client), (Part.TOPIC, "left")):
        with pytest.raises(ChannelError) as caught:
            Namespace().object_name("/add", part, name)
        assert caught.value.code == "SHM118"


def test_a_topic_a_service_and_a_client_have_objects_and_locks_of_their_own(
    shm_namespace: Namespace, stack: ExitStack
) -> None:
    """One name in ROS can be a topic's, a service's and an action's."""
    stack.enter_context(open_channel(shm_namespace, topic="/add"))
    for client in ("", "left"):
        for channel in open_service(shm_namespace, "ros", client=client):
            stack.enter_context(channel)
    found = dict(shm_namespace.objects())
    assert [part.word for part in found.values()] == ["request", "request", "response", "response", "topic"]
    assert shm_namespace.topics() == [shm_namespace.object_name("/add")]
    assert len(list(Path(shm_namespace.directory).glob(f"{shm_namespace.prefix}.l*"))) == 5


def test_description_of_a_part(shm_namespace: Namespace, stack: ExitStack) -> None:
    """The self-description has part, client and the partners' layout ids; a topic's has none of them."""
    asks, answers = open_service(shm_namespace, client="left", layout_id="ff" * 8)
    stack.enter_context(asks), stack.enter_context(answers)
    with attach(shm_namespace, "/add", part=Part.RESPONSE, client="left") as attached:
        about = attached.description
        assert about == answers.description
        assert (about.kind, about.part, about.client) == ("service", Part.RESPONSE, "left")
        assert about.partners == {"request": "0123456789abcdef"}
        assert asks.description.partners == {"response": "ff" * 8}
    assert not {"kind", "part", "client", "partners"} & set(json.loads(describe().to_json()))


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "action"},
        {"part": "response"},
        {"part": 1},
        {"client": None},
        {"partners": []},
        {"partners": {"response": "no"}},
        {"partners": {"response": 1}},
    ],
)
def test_description_that_does_not_agree(change: dict[str, object]) -> None:
    """A self-description of another part than its object's is refused, and so are damaged members."""
    about = Description(
        **(vars(describe("/add")) | {"part": Part.REQUEST, "partners": {"response": "00" * 8}})
    )
    members = json.loads(about.to_json())
    assert Description.from_json(about.to_json(), part=Part.REQUEST) == about
    with pytest.raises(ChannelError) as caught:
        Description.from_json(json.dumps(members | change).encode(), part=Part.REQUEST)
    assert caught.value.code == "SHM113"


def test_an_object_of_another_kind_is_refused(shm_namespace: Namespace, stack: ExitStack) -> None:
    """A topic's, a request's and a goal's object are never taken for each other (check 110)."""
    asks, answers = open_service(shm_namespace)
    stack.enter_context(asks), stack.enter_context(answers)
    for part in Part:
        path = shm_namespace.path("/add", part)
        if part is not Part.REQUEST:
            path.unlink(missing_ok=True)
            os.link(asks.path, path)
            stack.callback(path.unlink, missing_ok=True)
            with pytest.raises(ChannelError) as caught:
                attach(shm_namespace, "/add", part=part)
            assert caught.value.code == "SHM110"
    first = asks.region.read(0, spec.HEADER_SIZE)
    size = asks.identity.object_size
    assert [check_identity(first, size, 0, part.value) for part in Part] == [110, 0, 110, 110, 110, 110]
    assert check_identity(first, size, 0, 0) == 0
    assert check_identity(first, size, 0) == 110


# ---- adopted or replaced together


def _reasons(channels: tuple[OwnedChannel, ...]) -> list[str]:
    for channel in channels:
        channel.close()
    return [channel.replaced_reason for channel in channels]


def test_objects_are_adopted_together(shm_namespace: Namespace) -> None:
    """A bridge that starts again adopts both."""
    _reasons(open_service(shm_namespace))
    again = open_service(shm_namespace)
    assert [channel.adopted for channel in again] == [True, True]
    assert _reasons(again) == ["", ""]


@pytest.mark.parametrize("what", ["layout", "removed", "retired", "damaged"])
def test_objects_are_replaced_together(shm_namespace: Namespace, what: str) -> None:
    """If one cannot be adopted none is, and a program that has the other one mapped notices."""
    _reasons(open_service(shm_namespace))
    path = shm_namespace.path("/add", Part.RESPONSE)
    if what == "removed":
        path.unlink()
    elif what != "layout":
        with path.open("r+b") as file:
            file.seek(spec.IDENTITY["state"] if what == "retired" else spec.IDENTITY["magic"])
            file.write(b"\2")
    with attach(shm_namespace, "/add", part=Part.REQUEST) as asks:
        again = open_service(shm_namespace, layout_id="ff" * 8 if what == "layout" else "0123456789abcdef")
        assert [channel.adopted for channel in again] == [False, False]
        assert again[0].generation != asks.identity.generation
        with pytest.raises(ChannelError, match="SHM111"):
            asks.valid()
    request, response = _reasons(again)
    assert request
    assert bool(response) is (what != "removed")


def test_nobody_who_dies_in_between_leaves_a_mixed_set(
    shm_namespace: Namespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that were found are retired before the first is made: a later bridge adopts none of them."""
    _reasons(open_service(shm_namespace))
    monkeypatch.setattr("rosplc.shm.owned.create_complete", _die)
    with pytest.raises(ChannelError, match="SHM117"):
        open_service(shm_namespace, layout_id="ff" * 8)
    monkeypatch.undo()
    for part in SERVICE:
        with pytest.raises(ChannelError, match="SHM111"):
            attach(shm_namespace, "/add", part=part)
    again = open_service(shm_namespace)
    assert not any(channel.adopted for channel in again)
    _reasons(again)


def _die(*_: object, **__: object) -> int:
    raise ChannelError("SHM117", "no room")


def test_none_is_owned_unless_all_are(shm_namespace: Namespace, stack: ExitStack) -> None:
    """Where another bridge holds one of the names, the others are let go, and nothing is touched."""
    asks, answers = open_service(shm_namespace)
    stack.enter_context(answers)
    asks.close()
    with pytest.raises(ChannelError, match="SHM116"):
        open_service(shm_namespace, layout_id="ff" * 8)
    with attach(shm_namespace, "/add", part=Part.REQUEST) as attached:
        assert attached.identity.generation == asks.generation
    answers.close()
    again = open_service(shm_namespace)
    assert all(channel.adopted for channel in again)
    _reasons(again)


# ---- slots


def test_a_slot_has_status_client_and_reason(bridge: Bridge, server: Server) -> None:
    """What publish is given arrives; client is 16 bytes or none."""
    caller = bytes(range(16))
    bridge.writer.publish(_RECORD, correlation=9, status=1 | 8, client=caller, reason=4)
    info = server.reader.latest(bytearray(64))
    assert info is not None
    assert (info.status, info.client, info.reason, info.correlation) == (9, caller, 4, 9)
    bridge.writer.publish(_RECORD)
    info = server.reader.latest(bytearray(64))
    assert info is not None
    assert (info.status, info.client, info.reason, info.correlation) == (0, bytes(16), 0, 0)
    for wrong in (b"short", bytes(17)):
        with pytest.raises(ValueError, match="16 bytes"):
            bridge.writer.publish(_RECORD, client=wrong)


def test_a_group_only_reports(bridge: Bridge, server: Server, plan_of_64_bytes: object) -> None:
    """Mode 2 leaves the taking to the owner of the reader, and is quiet once it is done."""
    group = Group()
    index = group.add_reader(server.reader, plan_of_64_bytes, 2)  # type: ignore[arg-type]
    assert group.take() == ([], [])
    bridge.writer.publish(_RECORD)
    assert group.wait(1000, 10**9) == 1
    for _ in range(2):
        assert group.take() == ([(index, b"", 1, 0, 0, 0)], [])
    assert server.asks.region.word(_TAKEN) == 0
    assert server.reader.latest(bytearray(64)) is not None
    assert group.take() == ([], [])
    with pytest.raises(ValueError, match="only report"):
        group.add_reader(server.reader, plan_of_64_bytes, 3)  # type: ignore[arg-type]


@pytest.fixture
def plan_of_64_bytes() -> object:
    from rosplc.codec import Codec, Wire
    from rosplc.layout import compute_layout
    from rosplc.model import TypeStore

    store = TypeStore.from_definition("a/msg/B", "uint64[8] data\n", distro="jazzy")
    return Codec(compute_layout(store, "a/msg/B"), Wire.CDR).plan


# ---- M26 to M29


def test_a_call_is_executed_and_answered(bridge: Bridge, server: Server) -> None:
    """The usual way: one call after the other, each ended by one answer with its number."""
    for number in (1, 2):
        correlation = bridge.caller.call(bridge.send, client=bytes(range(16)))
        assert correlation == bridge.writer.epoch << 32 | number
        with pytest.raises(RuntimeError):
            bridge.caller.call(bridge.send)
        server.execute()
        assert server.info.client == bytes(range(16))
        assert bridge.poll() == 0
        server.answer()
        assert bridge.poll() == spec.ANSWER_DONE
        assert (server.look(), bridge.caller.correlation, bridge.caller.late) == ("nothing", 0, 0)
    assert server.executed == [bridge.writer.epoch << 32 | number for number in (1, 2)]


def test_a_call_withdrawn_in_time_is_not_executed(bridge: Bridge, server: Server) -> None:
    """Where the answerer has not taken it, it sees the withdrawal alone, and does not begin."""
    bridge.caller.call(bridge.send)
    assert bridge.caller.withdraw(bridge.send) is False
    assert server.look() == "withdrawn"
    server.answer(spec.ANSWER_NOT_EXECUTED)
    assert bridge.poll() == 0
    assert bridge.caller.late == 1
    assert server.executed == []


def test_a_call_withdrawn_too_late_may_have_been_executed(bridge: Bridge, server: Server) -> None:
    """Its fate is unknown until the answer comes, which there is one of."""
    bridge.caller.call(bridge.send)
    server.execute()
    assert bridge.caller.withdraw(bridge.send) is True
    assert server.look() == "more"
    server.answer()
    assert bridge.poll() == spec.ANSWER_DONE
    assert server.look() == "nothing"


def test_an_answered_call_is_not_answered_again(bridge: Bridge, server: Server) -> None:
    """A withdrawal that crosses the answer changes nothing (M29)."""
    bridge.caller.call(bridge.send)
    server.execute()
    server.answer()
    assert bridge.caller.withdraw(bridge.send) is True
    assert server.look() == ""
    assert bridge.poll() == spec.ANSWER_DONE


def test_the_answerer_looks_again(bridge: Bridge, server: Server) -> None:
    """A withdrawal between taking and acting: the caller waits for the answer, nothing is executed (M26)."""
    bridge.caller.call(bridge.send)
    info = server.reader.latest(bytearray(64))
    assert info is not None
    assert bridge.caller.withdraw(bridge.send) is True
    assert server.reader.begin() is False
    assert server.answerer.take(info) == ""
    assert server.look() == "withdrawn"
    server.answer(spec.ANSWER_NOT_EXECUTED)
    assert bridge.poll() == spec.ANSWER_NOT_EXECUTED


def test_who_lost_the_line_does_not_act(bridge: Bridge, server: Server) -> None:
    """The second look covers the claim, and that the object is in use."""
    bridge.caller.call(bridge.send)
    assert server.reader.latest(bytearray(64)) is not None
    assert server.reader.begin()
    bridge.asks.region.store(spec.reader_line(0), 1)
    assert not server.reader.begin()
    bridge.asks.retire()
    with pytest.raises(ChannelError, match="SHM111"):
        server.reader.begin()


@pytest.mark.parametrize("taken", [False, True])
def test_nothing_that_waited_is_executed(
    bridge: Bridge, server: Server, shm_namespace: Namespace, stack: ExitStack, taken: bool
) -> None:
    """STOP and RUN: the next answerer executes nothing, the caller learns what became of the call (M27)."""
    bridge.caller.call(bridge.send)
    if taken:
        server.execute()
    assert bridge.caller.lost(bridge.send) == 0
    server.crash()
    second = Server(shm_namespace, stack)
    assert second.look() == "nothing"
    assert bridge.asks.region.word(_TAKEN) == int(taken), "the claim must leave it as it is"
    expected = spec.ANSWER_FATE_UNKNOWN if taken else spec.ANSWER_NOT_EXECUTED
    assert bridge.caller.lost(bridge.send) == expected
    assert second.look() in ("unknown", "withdrawn")
    assert second.executed == []
    bridge.caller.call(bridge.send)
    second.execute()


def test_who_is_held_up_before_the_first_look_claims_the_line(
    server: Server, shm_namespace: Namespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A busy machine may stop it for longer than a silent claim lasts, between any two looks at the clock."""
    server.crash()
    clock = itertools.count(0, 10**9)
    monkeypatch.setattr("time.monotonic_ns", lambda: next(clock))
    with attach(shm_namespace, "/add", part=Part.REQUEST, write=True) as asks:
        assert acting_reader(asks, "server", beat_ms=50).line == 0


def test_an_answerer_that_has_gone_ends_the_call(bridge: Bridge, server: Server) -> None:
    """A claim given back ends what was handed out before."""
    bridge.caller.call(bridge.send)
    server.asks.close()
    assert bridge.caller.claim() == 0
    assert bridge.caller.lost(bridge.send) == spec.ANSWER_NOT_EXECUTED
    assert bridge.caller.lost(bridge.send) == 0


def test_a_call_published_as_the_claim_changed_is_executed_by_nobody(
    bridge: Bridge, server: Server, shm_namespace: Namespace, stack: ExitStack
) -> None:
    """The caller looked at the claim before, the next answerer at head: the withdrawal decides."""
    seen = bridge.caller.claim()
    server.crash()
    second = Server(shm_namespace, stack)
    bridge.caller.call(bridge.send)
    bridge.caller.claimed = seen
    assert bridge.caller.lost(bridge.send) == spec.ANSWER_NOT_EXECUTED
    assert second.look() == "withdrawn"
    assert second.executed == []


def test_the_next_answerer_does_not_vouch_for_the_one_before(
    bridge: Bridge, server: Server, shm_namespace: Namespace, stack: ExitStack
) -> None:
    """It finds a call withdrawn that the first has executed; whatever it answers misleads no caller."""
    bridge.caller.call(bridge.send)
    server.execute()
    server.crash()
    second = Server(shm_namespace, stack)
    assert bridge.caller.withdraw(bridge.send) is True
    assert second.look() == "unknown"
    second.answer(spec.ANSWER_NOT_EXECUTED)  # as one would that does not know
    assert bridge.poll() == 0
    assert bridge.caller.lost(bridge.send) == spec.ANSWER_FATE_UNKNOWN


def test_an_answer_for_an_earlier_life_completes_nothing(
    bridge: Bridge, server: Server, shm_namespace: Namespace, stack: ExitStack
) -> None:
    """The first call of a restarted caller has the number of its claim, so an old answer is late (M28)."""
    bridge.caller.call(bridge.send)
    server.execute()
    bridge.close()
    again = Bridge(shm_namespace)
    stack.callback(again.close)
    assert again.asks.adopted
    again.caller.call(again.send)
    server.answer()
    assert again.poll() == 0
    assert again.caller.late == 1
    server.execute()
    server.answer()
    assert again.poll() == spec.ANSWER_DONE
    assert len(set(server.executed)) == 2


@pytest.mark.parametrize("taken", [False, True])
def test_a_restarted_caller_continues_the_open_call(
    bridge: Bridge, server: Server, shm_namespace: Namespace, stack: ExitStack, taken: bool
) -> None:
    """It withdraws what was not begun, and waits for the answer to what was."""
    bridge.caller.call(bridge.send)
    if taken:
        server.execute()
    bridge.close()
    again = Bridge(shm_namespace)
    stack.callback(again.close)
    found = attach(shm_namespace, "/add", part=Part.REQUEST).reader().peek(bytearray(64))
    assert isinstance(found, SlotInfo)
    again.caller.resume(found)
    assert again.caller.withdraw(again.send) is taken
    if taken:
        assert server.look() == "more"
        server.answer()
        assert again.poll() == spec.ANSWER_DONE
    else:
        assert server.look() == "withdrawn"
    assert len(server.executed) == int(taken)


@pytest.mark.parametrize("step", ["published", "taken", "answered", "withdrawn"])
def test_a_restarted_bridge_acts_once(shm_namespace: Namespace, stack: ExitStack, step: str) -> None:
    """As answerer it continues from taken: what an earlier bridge began is never begun again (M15)."""
    asks, answers = open_service(shm_namespace, "ros")
    plc_asks = stack.enter_context(attach(shm_namespace, "/add", part=Part.REQUEST, write=True))
    plc_answers = stack.enter_context(attach(shm_namespace, "/add", part=Part.RESPONSE, write=True))
    writer = plc_asks.writer()
    reader = acting_reader(plc_answers)
    caller = Caller(plc_asks, writer, follows_claim=False)
    send = partial(writer.publish, _RECORD)
    bridge = Answerer(asks, taking := asks.reader(), answers)
    correlation = caller.call(send)
    if step != "published":
        info = taking.latest(bytearray(64))
        assert info is not None
        assert bridge.take(info) == "begin"
    if step == "answered":
        answers.writer().publish(_ANSWER, correlation=correlation, status=spec.ANSWER_DONE)
    if step == "withdrawn":
        assert caller.withdraw(send) is True
    asks.close(), answers.close()

    asks, answers = open_service(shm_namespace, "ros")
    stack.enter_context(asks), stack.enter_context(answers)
    assert asks.adopted
    bridge = Answerer(asks, taking := asks.reader(), answers)
    info = taking.latest(bytearray(64))
    found = "" if info is None else bridge.take(info)
    assert found == {"published": "begin", "withdrawn": "unknown"}.get(step, "")
    assert bridge.unanswered == (correlation if step in ("taken", "withdrawn") else 0)
    assert caller.lost(send) == 0
    if bridge.unanswered:
        answers.writer().publish(_ANSWER, correlation=correlation, status=spec.ANSWER_FATE_UNKNOWN, reason=8)
        bridge.answered(correlation)
    if step != "published":
        answer = reader.latest(bytearray(32))
        assert answer is not None
        assert caller.answer(answer) == (spec.ANSWER_DONE if step == "answered" else spec.ANSWER_FATE_UNKNOWN)


@pytest.mark.parametrize("taken", [False, True])
def test_a_retired_object_ends_a_plcs_call(shm_namespace: Namespace, stack: ExitStack, taken: bool) -> None:
    """A PLC that finds its objects replaced knows whether its call was taken."""
    asks, answers = open_service(shm_namespace, "ros")
    plc_asks = stack.enter_context(attach(shm_namespace, "/add", part=Part.REQUEST, write=True))
    caller = Caller(plc_asks, writer := plc_asks.writer(), follows_claim=False)
    caller.call(partial(writer.publish, _RECORD))
    if taken:
        assert asks.reader().latest(bytearray(64)) is not None
    asks.retire(), answers.retire()
    assert caller.retired() == (spec.ANSWER_FATE_UNKNOWN if taken else spec.ANSWER_NOT_EXECUTED)
    assert caller.retired() == 0


def test_one_acts(bridge: Bridge, server: Server, shm_namespace: Namespace, stack: ExitStack) -> None:
    """Line 0 has one holder, observers use the others, and what the PLC writes the bridge acts on."""
    other = stack.enter_context(attach(shm_namespace, "/add", part=Part.REQUEST, write=True))
    beat = spec.reader_line(0) + spec.READER_LINE["beat_ms"]
    other.region.store(beat, 50)
    with pytest.raises(ChannelError, match="SHM114"):
        _while_beating(server.reader, other)
    assert other.reader("watcher", observe=False).line == 1
    with pytest.raises(ValueError, match="no reader line 1 for an answerer"):
        server.reader.claim(1, 0, 50, "", answer=True)


def _while_beating(reader: Reader, other: Attached) -> None:
    import threading

    stop = threading.Event()

    def beat() -> None:
        while not stop.wait(0.005):
            reader.beat()

    thread = threading.Thread(target=beat)
    thread.start()
    try:
        acting_reader(other)
    finally:
        stop.set()
        thread.join()


@pytest.mark.parametrize(
    ("taken", "first", "begun"),
    [
        (0, 1, False),
        (1, 1, True),
        (2, 1, True),
        (1, 2, False),
        (0, 2**32 - 1, False),
        (2**32 - 2, 2**32 - 1, False),
        (2**32 - 1, 2**32 - 1, True),
        (4, 2**32 - 1, True),
        (2**32 - 1, 4, False),
    ],
)
def test_begun(bridge: Bridge, taken: int, first: int, begun: bool) -> None:
    """What was taken before the call's first message is not of this call, over the wrap too."""
    bridge.asks.region.store(_TAKEN, taken)
    assert bridge.writer.begun(first) is begun
