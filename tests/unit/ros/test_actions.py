"""The action engine over the memory backend: its messages, its states, what clients and servers learn."""

from __future__ import annotations

import contextlib
import itertools
import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.reasons import Reason
from rosplc.ros import SERVICES, Backend, Qos, actions, open_backend
from rosplc.ros import goals as wire
from rosplc.ros.actions import ActionClient, ActionServer, GoalEvent
from rosplc.ros.goals import CancelCode, GoalStatus, GoalStep
from tests.interop.graphs import free_domain
from tests.lib.waiting import wait_for

STORE = TypeStore.bundled("kilted")
FIBONACCI = "example_interfaces/action/Fibonacci"
MESSAGES = wire.Messages(STORE, FIBONACCI)
GOAL = b"\0\1\0\0\5\0\0\0"
SEQUENCE = b"\0\1\0\0\2\0\0\0\1\0\0\0\2\0\0\0"
ONE, TWO, THREE = (bytes([number] * 16) for number in (1, 2, 3))


class SteppedClock(Clock):
    """A clock whose monotonic time a test moves."""

    now_ns = 0

    def monotonic_ns(self) -> int:
        return self.now_ns

    def time_ns(self) -> int:
        return SYSTEM.time_ns()


class Server(ActionServer):
    """A server that notes what it is asked."""

    def __init__(self, backend: Backend, clock: Clock = SYSTEM) -> None:
        self.goals: list[tuple[bytes, bytes]] = []
        self.cancels: list[bytes] = []
        super().__init__(
            backend,
            STORE,
            "/fibonacci",
            FIBONACCI,
            on_goal=lambda *goal: self.goals.append(goal),
            on_cancel=self.cancels.append,
            clock=clock,
        )


class Client(ActionClient):
    """A client that notes what becomes of its goals."""

    def __init__(self, backend: Backend) -> None:
        self.events: list[GoalEvent] = []
        super().__init__(backend, STORE, "/fibonacci", FIBONACCI, self.events.append)
        wait_for(lambda: self.ready)

    def wait(self, uuid: bytes, kind: str) -> GoalEvent:
        """Return the last event of a kind about a goal."""
        return wait_for(lambda: [e for e in self.events if (e.uuid, e.kind) == (uuid, kind)], kind)[-1]


@pytest.fixture
def graph() -> Iterator[Any]:
    """Give a function that opens nodes of one graph."""
    opened: list[Backend] = []
    with free_domain() as domain:

        def open_node(name: str) -> Backend:
            opened.append(open_backend("memory", STORE, name, domain=domain))
            return opened[-1]

        yield open_node
        for backend in opened:
            backend.close()


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


@pytest.fixture
def server(graph: Any, clock: SteppedClock) -> Server:
    return Server(graph("cell"), clock)


@pytest.fixture
def client(graph: Any, server: Server) -> Client:
    return Client(graph("robot"))


def begin(server: Server, client: Client, uuid: bytes = ONE) -> None:
    """Send a goal that is accepted and executed."""
    assert client.send(uuid, GOAL)
    wait_for(lambda: any(one == uuid for one, _ in server.goals))
    assert server.accept(uuid)
    assert server.execute(uuid)
    client.wait(uuid, "accepted")


# -- a goal's life


def test_a_goal_succeeds(server: Server, client: Client) -> None:
    """Goal, feedback and result arrive as they were sent; the client learns each state."""
    begin(server, client)
    assert server.goals == [(ONE, GOAL)]
    assert server.feedback(ONE, SEQUENCE)
    assert client.wait(ONE, "feedback").payload == SEQUENCE
    assert server.succeed(ONE, SEQUENCE)
    assert client.wait(ONE, "result") == GoalEvent(ONE, "result", SEQUENCE, GoalStatus.SUCCEEDED)
    assert not server.feedback(ONE, SEQUENCE)
    assert [one.messages for one in server.endpoints()[2:]] == [1, 0, 1]
    assert [one.matched for one in client.endpoints()] == [1, 1, 1, 1, 1]


def test_a_goal_is_rejected(server: Server, client: Client) -> None:
    """Its client learns that, and may send one of the same UUID again."""
    for _ in range(2):
        client.send(ONE, GOAL)
        wait_for(lambda: server.goals)
        assert server.present(ONE)
        assert server.reject(ONE)
        client.wait(ONE, "rejected")
        server.goals.clear(), client.events.clear()
    assert not server.reject(ONE)
    assert not server.present(ONE)


def test_a_goal_that_is_known_is_not_accepted_again(graph: Any, server: Server, client: Client) -> None:
    """A second goal of one UUID is answered for the server's program, which learns nothing of it."""
    other = Client(graph("other"))
    begin(server, client)
    assert not client.send(ONE, GOAL)
    other.send(ONE, GOAL)
    other.wait(ONE, "rejected")
    assert len(server.goals) == 1


def test_more_goals_than_there_is_room_for(
    server: Server, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are rejected, but what has ended makes room: its result may be kept for an hour."""
    monkeypatch.setattr(actions, "MOST_GOALS", 1)
    begin(server, client)
    client.send(TWO, GOAL)
    client.wait(TWO, "rejected")
    server.succeed(ONE, SEQUENCE)
    client.wait(ONE, "result")
    begin(server, client, TWO)
    assert server.status(ONE) is GoalStatus.UNKNOWN


def test_a_result_is_kept(server: Server, client: Client, clock: SteppedClock, graph: Any) -> None:
    """Another process that knows the UUID gets the result for ten seconds, and then none."""
    begin(server, client)
    server.abort(ONE, SEQUENCE)
    client.wait(ONE, "result")
    clock.now_ns += 10_000_000_000 - 1
    server.tick()
    later = Client(graph("later"))
    later.adopt(ONE)
    assert later.wait(ONE, "result") == GoalEvent(ONE, "result", SEQUENCE, GoalStatus.ABORTED)
    clock.now_ns += 1
    server.tick()
    later.adopt(ONE)
    wait_for(lambda: later.events[-1].status is GoalStatus.UNKNOWN and later.events[-1].kind == "result")
    assert later.events[-1].payload == b"\0\1\0\0\0\0\0\0"  # no sequence
    assert server.status(ONE) is GoalStatus.UNKNOWN


def test_a_result_without_content_is_the_default(server: Server, client: Client) -> None:
    """A goal that ends without a result still ends."""
    begin(server, client)
    assert server.abort(ONE)
    assert client.wait(ONE, "result").payload == b"\0\1\0\0\0\0\0\0"
    with pytest.raises(BackendError, match="ROS008"):
        begin(server, client, TWO) or server.succeed(TWO, b"\0\1\0\0\1\0\0\0")
    assert server.status(TWO) is GoalStatus.EXECUTING


def test_many_ask_for_one_result(
    server: Server, client: Client, graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of them get it; of more than there is room for the oldest goes."""
    monkeypatch.setattr(actions, "MOST_WAITING", 2)
    begin(server, client)
    others = [Client(graph(f"other{number}")) for number in range(2)]
    for number, other in enumerate(others, 2):
        other.adopt(ONE)
        wait_for(lambda n=number: server.endpoints()[2].messages == n)
    server.succeed(ONE, SEQUENCE)
    for other in others:
        assert other.wait(ONE, "result").payload == SEQUENCE
    assert not [event for event in client.events if event.kind == "result"]


# -- cancel


def test_a_cancel_is_decided_by_the_program(server: Server, client: Client) -> None:
    """It may refuse, and agree to the next; then it ends the goal itself."""
    begin(server, client)
    assert not server.accept_cancel(ONE)
    assert not server.reject_cancel(ONE)
    client.cancel(ONE)
    wait_for(lambda: server.cancels == [ONE])
    assert server.reject_cancel(ONE)
    assert client.wait(ONE, "not canceled").reply is not None
    assert server.status(ONE) is GoalStatus.EXECUTING
    client.cancel(ONE)
    wait_for(lambda: server.cancels == [ONE, ONE])
    assert server.accept_cancel(ONE)
    client.wait(ONE, "canceling")
    wait_for(lambda: client.wait(ONE, "status").status is GoalStatus.CANCELING)
    client.events.clear()
    client.cancel(ONE)  # it is canceling already: rcl_action refuses a second request
    client.wait(ONE, "not canceled")
    assert server.canceled(ONE, SEQUENCE)
    assert client.wait(ONE, "result").status is GoalStatus.CANCELED


def test_a_goal_that_ends_answers_its_cancel(server: Server, client: Client) -> None:
    """A request that was not decided is refused when the goal ends."""
    begin(server, client)
    client.cancel(ONE)
    wait_for(lambda: server.cancels)
    server.succeed(ONE, SEQUENCE)
    client.wait(ONE, "not canceled")


@pytest.mark.parametrize(
    ("uuid", "when", "code", "asked"),
    [
        (ONE, 0, CancelCode.NONE, [ONE]),
        (THREE, 0, CancelCode.GOAL_TERMINATED, []),
        (b"?" * 16, 0, CancelCode.UNKNOWN_GOAL_ID, []),
        (bytes(16), 0, CancelCode.NONE, [ONE, TWO]),
        (bytes(16), 10**9, CancelCode.NONE, [ONE]),
        (TWO, 10**9, CancelCode.NONE, [ONE, TWO]),
        (bytes(16), 1, CancelCode.NONE, []),
    ],
)
def test_what_a_request_to_cancel_is_about(
    graph: Any, server: Server, uuid: bytes, when: int, code: CancelCode, asked: list[bytes]
) -> None:
    """A goal; all; those accepted until a time, and one besides: as rcl_action has it."""
    for number, one in enumerate((ONE, TWO, THREE), 1):
        server.adopt(one, number * 10**9, GoalStatus.EXECUTING)
    server.succeed(THREE, SEQUENCE)
    replies: list[Any] = []
    caller = graph("caller").client("/fibonacci/_action/cancel_goal", "action_msgs/srv/CancelGoal", SERVICES)
    caller.call(MESSAGES.pack_cancel(uuid, when), replies.append)
    wait_for(lambda: len(server.cancels) == len(asked))
    assert server.cancels == asked
    for one in asked:
        assert not replies
        server.accept_cancel(one)
    wait_for(lambda: replies)
    canceling = [(one, 10**9 * one[0]) for one in asked]
    assert MESSAGES.read_canceling(replies[0].payload) == (code, canceling)


# -- all states and steps


LEGAL = {
    # rcl_action/src/rcl_action/goal_state_machine.c, _goal_state_transition_map
    ("ACCEPTED", "EXECUTE"): "EXECUTING",
    ("ACCEPTED", "CANCEL"): "CANCELING",
    ("EXECUTING", "CANCEL"): "CANCELING",
    ("EXECUTING", "SUCCEED"): "SUCCEEDED",
    ("EXECUTING", "ABORT"): "ABORTED",
    ("CANCELING", "SUCCEED"): "SUCCEEDED",
    ("CANCELING", "ABORT"): "ABORTED",
    ("CANCELING", "CANCELED"): "CANCELED",
}


def lead(server: Server, state: GoalStatus) -> None:
    """Bring a goal of another process into a state."""
    first = GoalStatus.ACCEPTED if state is GoalStatus.ACCEPTED else GoalStatus.EXECUTING
    if state in (GoalStatus.CANCELING, GoalStatus.CANCELED):
        first = GoalStatus.CANCELING
    assert server.adopt(ONE, 0, first)
    end = {GoalStatus.SUCCEEDED: server.succeed, GoalStatus.ABORTED: server.abort}
    end[GoalStatus.CANCELED] = server.canceled
    if state.ended:
        assert end[state](ONE, SEQUENCE)
    assert server.status(ONE) is state


@pytest.mark.parametrize(("state", "step"), list(itertools.product(list(GoalStatus)[1:], GoalStep)))
def test_every_step_from_every_state(graph: Any, server: Server, state: GoalStatus, step: GoalStep) -> None:
    """What rcl_action's state machine has is done; nothing else changes a goal."""
    lead(server, state)
    if step is GoalStep.CANCEL:
        request = MESSAGES.pack_cancel(ONE)
        name = "/fibonacci/_action/cancel_goal"
        replies: list[Any] = []
        graph("caller").client(name, "action_msgs/srv/CancelGoal", SERVICES).call(request, replies.append)
        wait_for(lambda: server.cancels or replies)
        done = server.accept_cancel(ONE)
    elif step is GoalStep.EXECUTE:
        done = server.execute(ONE)
    else:
        method = {"SUCCEED": server.succeed, "ABORT": server.abort, "CANCELED": server.canceled}[step.name]
        done = method(ONE, SEQUENCE)
    expected = LEGAL.get((state.name, step.name))
    assert done is (expected is not None)
    assert server.status(ONE).name == (expected or state.name)


def test_a_goal_that_is_not_accepted_takes_no_step(server: Server, client: Client) -> None:
    """Undecided, unknown: only a decision is possible, and only one."""
    client.send(ONE, GOAL)
    wait_for(lambda: server.goals)
    for uuid in (ONE, TWO):
        assert not server.execute(uuid)
        assert not server.succeed(uuid, SEQUENCE)
        assert not server.feedback(uuid, SEQUENCE)
        assert not server.accept_cancel(uuid)
    assert not server.accept(TWO)
    assert server.accept(ONE)
    assert not server.accept(ONE)
    assert not server.reject(ONE)
    assert not server.adopt(ONE, 0, GoalStatus.EXECUTING)
    assert not server.adopt(TWO, 0, GoalStatus.SUCCEEDED)


# -- other processes, other ends


def test_a_goal_outlives_its_server(graph: Any) -> None:
    """A successor adopts it: a client that asks again gets the result; the status is published."""
    cell = graph("cell")
    server = Server(cell)
    client = Client(graph("robot"))
    begin(server, client)
    server.close()
    lost = client.wait(ONE, "lost")
    assert lost.reply is not None
    assert lost.reply.reason is Reason.SERVER_GONE
    successor = Server(cell)
    assert successor.adopt(ONE, 5, GoalStatus.EXECUTING)
    wait_for(lambda: client.ready)
    client.adopt(ONE)
    successor.feedback(ONE, SEQUENCE)
    client.wait(ONE, "feedback")
    wait_for(lambda: successor.endpoints()[2].messages == 1)
    successor.succeed(ONE, SEQUENCE)
    assert client.wait(ONE, "result").payload == SEQUENCE


def test_a_goal_outlives_its_client(graph: Any, server: Server, client: Client) -> None:
    """A successor that knows its UUID learns status and result, and may cancel it."""
    begin(server, client)
    client.close()
    successor = Client(graph("successor"))
    successor.adopt(ONE)
    assert successor.wait(ONE, "status").status is GoalStatus.EXECUTING
    successor.cancel(ONE)
    wait_for(lambda: server.cancels)
    server.accept_cancel(ONE)
    server.canceled(ONE, SEQUENCE)
    assert successor.wait(ONE, "result") == GoalEvent(ONE, "result", SEQUENCE, GoalStatus.CANCELED)


def test_without_a_server(graph: Any) -> None:
    """A goal fails at once, and was not executed."""
    events: list[GoalEvent] = []
    client = ActionClient(graph("robot"), STORE, "/fibonacci", FIBONACCI, events.append)
    assert not client.ready
    client.send(ONE, GOAL)
    assert [(one.kind, one.reply.outcome, one.reply.reason) for one in events if one.reply] == [
        ("failed", "not executed", Reason.NO_SERVER)
    ]


def test_a_goal_that_was_forgotten(server: Server, client: Client) -> None:
    """Nothing more is heard of it."""
    begin(server, client)
    client.forget(ONE)
    client.forget(ONE)
    before = len(client.events)
    server.feedback(ONE, SEQUENCE)
    server.succeed(ONE, SEQUENCE)
    begin(server, client, TWO)
    assert {event.uuid for event in client.events[before:]} == {TWO}


def test_bytes_that_are_none_of_an_action(graph: Any, server: Server, client: Client) -> None:
    """They are refused by the server, and change nothing at a client."""
    rogue = graph("rogue")
    for name, kind in (
        ("send_goal", f"{FIBONACCI}_SendGoal"),
        ("get_result", f"{FIBONACCI}_GetResult"),
        ("cancel_goal", "action_msgs/srv/CancelGoal"),
    ):
        rogue.client(f"/fibonacci/_action/{name}", kind, SERVICES).call(GOAL, print)
    statuses = rogue.advertise(
        "/fibonacci/_action/status", "action_msgs/msg/GoalStatusArray", actions.STATUS_QOS
    )
    statuses.write(b"\0\1\0\0\xff\xff\xff\xff")
    rogue.advertise("/fibonacci/_action/feedback", f"{FIBONACCI}_FeedbackMessage", Qos()).write(GOAL)
    wait_for(lambda: [one.failed for one in client.endpoints()[:2]] == [1, 1])
    begin(server, client)
    assert server.goals == [(ONE, GOAL)]


def test_an_action_that_cannot_be_opened(graph: Any) -> None:
    """Nothing of it remains."""
    node = graph("cell")
    with pytest.raises(Exception, match="TYP001"):
        ActionServer(node, STORE, "/a", "example_interfaces/action/None", on_goal=print, on_cancel=print)
    with pytest.raises(BackendError, match="ROS005"):
        ActionServer(node, STORE, "/a b", FIBONACCI, on_goal=print, on_cancel=print)
    assert node.status() == ()


# -- messages


INNER = "bool flag\nstring name\nfloat64[] values\n"
RESULT = (
    "int8 small\nint64 large\nstring text\nstring[] texts\nuint16[3] three\ntest/Inner inner\n"
    "test/Inner[] inners\ntest/Empty empty\ntest/Empty[2] empties\nfloat64[<=4] bounded\nbool last\n"
)
RESPONSE = "int8 status\ntest/All_Result result\n"
ORACLE = get_typestore(Stores.ROS2_KILTED)


def all_types() -> tuple[TypeStore, Any]:
    """Return our types and the oracle's, with a result of every kind of field in both."""
    store, oracle = STORE, get_typestore(Stores.ROS2_KILTED)
    types: dict[str, Any] = {}
    for name, text in (
        ("Inner", INNER),
        ("Empty", ""),
        ("All_Result", RESULT),
        ("All_GetResult_Response", RESPONSE),
    ):
        store = store.with_definition(f"test/msg/{name}", text)
        types.update(get_types_from_msg(text, f"test/msg/{name}"))
    oracle.register(types)
    return store, oracle


TYPES = all_types()


def any_result(oracle: Any, chance: random.Random) -> Any:
    """Return a result with any values."""
    kinds = oracle.types

    def text() -> str:
        return "x" * chance.randrange(9)

    def inner() -> Any:
        values = np.array([chance.random() for _ in range(chance.randrange(4))])
        return kinds["test/msg/Inner"](flag=chance.random() < 0.5, name=text(), values=values)

    empty = kinds["test/msg/Empty"]
    return kinds["test/msg/All_Result"](
        small=chance.randrange(100),
        large=chance.randrange(2**60),
        text=text(),
        texts=[text() for _ in range(chance.randrange(4))],
        three=np.array([chance.randrange(1000) for _ in range(3)], np.uint16),
        inner=inner(),
        inners=[inner() for _ in range(chance.randrange(3))],
        empty=empty(),
        empties=[empty(), empty()],
        bounded=np.array([chance.random() for _ in range(chance.randrange(5))]),
        last=True,
    )


@pytest.mark.parametrize("little", [True, False])
def test_a_result_behind_its_status(little: bool) -> None:
    """What another implementation of CDR writes is read and written, in both byte orders."""
    store, oracle = TYPES
    messages = wire.Messages(store, "test/msg/All")
    chance = random.Random(1)
    for _ in range(100):
        result = any_result(oracle, chance)
        response = oracle.types["test/msg/All_GetResult_Response"](status=4, result=result)
        both = [(result, "test/msg/All_Result"), (response, "test/msg/All_GetResult_Response")]
        given = [bytes(oracle.serialize_cdr(*one, little_endian=little)) for one in both]
        alone, whole = (bytes(oracle.serialize_cdr(*one)) for one in both)
        packed, (status, found) = messages.pack_result(4, given[0]), messages.read_result(given[1])
        assert (packed, status, found) == (whole[: len(packed)], 4, alone[: len(found)])
        assert max(len(whole) - len(packed), len(alone) - len(found)) < 4  # padding at the end
    for size in range(len(packed) - 1):
        with pytest.raises(BackendError, match="ROS008"):
            messages.read_result(given[1][:size])


def test_messages_of_the_package() -> None:
    """The other messages are read and written as another implementation of CDR does it."""
    kinds = ORACLE.types

    def info(uuid: bytes, stamp_ns: int) -> Any:
        stamp = kinds["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
        identity = kinds["unique_identifier_msgs/msg/UUID"](np.frombuffer(uuid, np.uint8))
        return kinds["action_msgs/msg/GoalInfo"](identity, stamp)

    goals = [(ONE, 3 * 10**9 + 5, 2), (TWO, 0, 6), (THREE, 10**18, 4)]
    for count in range(4):
        known = goals[:count]
        statuses = [kinds["action_msgs/msg/GoalStatus"](info(*one[:2]), one[2]) for one in known]
        array = kinds["action_msgs/msg/GoalStatusArray"](statuses)
        for little in (True, False):
            data = bytes(ORACLE.serialize_cdr(array, "action_msgs/msg/GoalStatusArray", little_endian=little))
            assert MESSAGES.read_statuses(data) == known
            assert not little or MESSAGES.pack_statuses(known) == data[: len(MESSAGES.pack_statuses(known))]
    data = bytes(ORACLE.serialize_cdr(info(ONE, 5), "action_msgs/msg/GoalInfo"))
    assert MESSAGES.pack_cancel(ONE, 5) == data
    assert MESSAGES.read_cancel(data) == (ONE, 5)
    assert MESSAGES.read_accepted(MESSAGES.pack_accepted(True, 7))
    assert MESSAGES.read_canceling(MESSAGES.pack_canceling(1, [(ONE, 5), (TWO, 6)])) == (
        1,
        [(ONE, 5), (TWO, 6)],
    )
    assert wire.unwrap(wire.wrap(ONE, GOAL)) == (ONE, GOAL)


@given(st.binary(max_size=120))
def test_any_bytes_are_a_message_or_refused(data: bytes) -> None:
    """Nothing that a peer sends raises another error, or makes more of it than there is."""
    store, _ = TYPES
    messages = wire.Messages(store, "test/msg/All")
    for read in (wire.unwrap, MESSAGES.read_cancel, MESSAGES.read_canceling, MESSAGES.read_accepted):
        with contextlib.suppress(BackendError):
            read(data)
    with contextlib.suppress(BackendError):
        assert len(MESSAGES.read_statuses(data)) <= len(data)
    with contextlib.suppress(BackendError):
        assert len(messages.read_result(data)[1]) <= 2 * len(data)
