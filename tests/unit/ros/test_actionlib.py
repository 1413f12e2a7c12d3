"""actionlib over the memory backend: what clients and servers learn, and goals by their texts."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import partial
from typing import Any

import pytest

from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.ros import Backend, GoalEvent, GoalStatus, Qos, action_classes, open_backend
from rosplc.ros.actionlib import ActionlibClient, ActionlibServer, text_of, uuid_of
from rosplc.ros.actions import STATUS_QOS
from tests.interop.graphs import free_domain
from tests.lib.clock import SteppedClock
from tests.lib.waiting import wait_for

STORE = TypeStore.bundled("noetic")
TEST = "actionlib/action/Test"  # an int32 each: goal, result and feedback
ONE, TWO = (bytes([number] * 16) for number in (1, 2))
GOAL, DONE, HALF = (struct.pack("<i", number) for number in (7, 100, 50))
LONG = b"/robot-1-1700000000.123456789"


class Server(ActionlibServer):
    """A server that notes what it is asked."""

    def __init__(self, backend: Backend, clock: SteppedClock) -> None:
        self.goals: list[tuple[bytes, bytes]] = []
        self.cancels: list[bytes] = []
        super().__init__(
            backend,
            STORE,
            "/test",
            TEST,
            on_goal=lambda *goal: self.goals.append(goal),
            on_cancel=self.cancels.append,
            clock=clock,
        )


class Client(ActionlibClient):
    """A client that notes what becomes of its goals."""

    def __init__(self, backend: Backend, clock: SteppedClock) -> None:
        self.events: list[GoalEvent] = []
        super().__init__(backend, STORE, "/test", TEST, self.events.append, clock=clock)

    def wait(self, kind: str, uuid: bytes = ONE) -> GoalEvent:
        """Return the last event of a kind about a goal."""
        return wait_for(lambda: [e for e in self.events if (e.uuid, e.kind) == (uuid, kind)], kind)[-1]

    def kinds(self, uuid: bytes = ONE) -> list[str]:
        """Return the kinds of all events about a goal."""
        return [event.kind for event in self.events if event.uuid == uuid]


class Raw:
    """The topics of the other side, as bytes."""

    def __init__(self, backend: Backend, *, serves: bool) -> None:
        self.got: dict[str, list[bytes]] = {}
        self._out: dict[str, Any] = {}
        kinds = {
            "goal": "actionlib/msg/TestActionGoal",
            "cancel": "actionlib_msgs/msg/GoalID",
            "status": "actionlib_msgs/msg/GoalStatusArray",
            "feedback": "actionlib/msg/TestActionFeedback",
            "result": "actionlib/msg/TestActionResult",
        }
        for name, kind in kinds.items():
            if serves == (name in ("goal", "cancel")):
                got = self.got[name] = []
                backend.subscribe(f"/test/{name}", kind, Qos(), lambda data, _, got=got: got.append(data))
            else:
                self._out[name] = backend.advertise(f"/test/{name}", kind, Qos())

    def write(self, topic: str, body: bytes, *, header: bool = True) -> None:
        """Send a message, with a header before it."""
        self._out[topic].write(bytes(16 if header else 0) + body)

    def list(self, *goals: tuple[bytes, int]) -> None:
        """Publish the statuses of goals."""
        self.write("status", len(goals).to_bytes(4, "little") + b"".join(status(*goal) for goal in goals))


def goal_id(text: bytes, seconds: int = 0) -> bytes:
    return struct.pack("<3I", seconds, 0, len(text)) + text


def status(text: bytes, number: int) -> bytes:
    return goal_id(text) + bytes([number]) + bytes(4)


def listed(message: bytes) -> list[tuple[bytes, int]]:
    """Return texts and statuses of a list; its frame and all words are empty."""
    (count,), at, found = struct.unpack_from("<I", message, 16), 20, []
    for _ in range(count):
        (size,) = struct.unpack_from("<I", message, at + 8)
        found.append((message[at + 12 : at + 12 + size], message[at + 12 + size]))
        at += 12 + size + 5
    return found


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


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
def server(graph: Any, clock: SteppedClock) -> Server:
    return Server(graph("cell"), clock)


@pytest.fixture
def client(graph: Any, server: Server, clock: SteppedClock) -> Client:
    client = Client(graph("robot"), clock)
    assert client.ready
    return client


def begin(server: Server, client: Client) -> None:
    """Send a goal that is accepted and executed."""
    assert client.send(ONE, GOAL)
    wait_for(lambda: server.goals)
    assert server.accept(ONE)
    assert server.execute(ONE)
    client.wait("status")


def test_the_types_choose_the_classes() -> None:
    """Those of actionlib for types of ROS 1."""
    assert action_classes(STORE) == (ActionlibServer, ActionlibClient)
    assert ActionlibServer not in action_classes(TypeStore.bundled("jazzy"))


def test_a_goal_succeeds(server: Server, client: Client) -> None:
    """Goal, feedback and result arrive as they were sent; the client learns each state once."""
    begin(server, client)
    assert server.goals == [(ONE, GOAL)]
    assert server.feedback(ONE, HALF)
    assert client.wait("feedback").payload == HALF
    server.tick()
    assert server.succeed(ONE, DONE)
    assert client.wait("result") == GoalEvent(ONE, "result", DONE, GoalStatus.SUCCEEDED)
    assert client.kinds() == ["accepted", "status", "feedback", "status", "result"]
    assert not server.succeed(ONE, DONE)


@pytest.mark.parametrize(
    ("end", "as_what"),
    [("succeed", GoalStatus.SUCCEEDED), ("abort", GoalStatus.ABORTED), ("canceled", GoalStatus.CANCELED)],
)
def test_a_goal_is_canceled(server: Server, client: Client, end: str, as_what: GoalStatus) -> None:
    """Once the server agrees the goal is canceling, and may end in three ways."""
    begin(server, client)
    client.cancel(ONE)
    wait_for(lambda: server.cancels)
    assert server.accept_cancel(ONE)
    client.wait("canceling")
    assert client.wait("status").status is GoalStatus.CANCELING
    assert getattr(server, end)(ONE, DONE)
    assert client.wait("result") == GoalEvent(ONE, "result", DONE, as_what)


def test_a_cancel_that_is_rejected(server: Server, client: Client) -> None:
    """The goal goes on, and may be asked to be canceled again."""
    begin(server, client)
    for count in (1, 2):
        client.cancel(ONE)
        wait_for(lambda n=count: len(server.cancels) == n)
        assert server.reject_cancel(ONE)
        assert not server.accept_cancel(ONE)
    assert server.abort(ONE)
    assert client.wait("result") == GoalEvent(ONE, "result", bytes(4), GoalStatus.ABORTED)


@pytest.mark.parametrize("cancel", [False, True])
def test_a_goal_is_not_accepted(graph: Any, server: Server, client: Client, cancel: bool) -> None:
    """It is rejected, or recalled if it was to be canceled; the client may repeat neither."""
    raw = Raw(graph("other"), serves=False)
    assert client.send(ONE, GOAL)
    wait_for(lambda: server.goals)
    assert server.present(ONE)
    if cancel:
        client.cancel(ONE)
        assert wait_for(lambda: server.cancels) == [ONE]
        assert not server.accept_cancel(ONE)
    assert server.reject(ONE)
    event = client.wait("rejected")
    assert event.reply is not None
    assert event.reply.outcome == "not executed"
    raw.write("goal", goal_id(ONE.hex().encode()) + GOAL)
    raw.write("goal", goal_id(TWO.hex().encode()) + GOAL)
    wait_for(lambda: len(server.goals) == 2)
    assert [uuid for uuid, _ in server.goals] == [ONE, TWO]
    assert not server.present(ONE)


def test_a_goal_that_is_accepted_when_it_is_to_be_canceled(server: Server, client: Client) -> None:
    """The server is asked once more, now that it can agree."""
    client.send(ONE, GOAL)
    wait_for(lambda: server.goals)
    client.cancel(ONE)
    wait_for(lambda: server.cancels)
    assert server.accept(ONE)
    assert server.cancels == [ONE, ONE]
    assert server.accept_cancel(ONE)
    client.wait("canceling")


def test_a_cancel_comes_before_its_goal(graph: Any, server: Server) -> None:
    """The goal is recalled without being shown: two topics have no order."""
    raw = Raw(graph("robot"), serves=False)
    raw.write("cancel", goal_id(LONG), header=False)
    wait_for(lambda: listed(raw.got["status"][-1]) == [(LONG, 7)] if raw.got["status"] else False)
    raw.write("goal", goal_id(LONG, 9) + GOAL)
    wait_for(lambda: raw.got["result"])
    assert raw.got["result"][0][16:] == goal_id(LONG, 9) + b"\10" + bytes(4) + bytes(4)
    assert not server.goals


def test_cancels_of_many_goals(graph: Any, server: Server) -> None:
    """Without a text, up to a stamp or all."""
    raw = Raw(graph("robot"), serves=False)
    for second in (1, 2, 3):
        raw.write("goal", goal_id(b"goal %d" % second, second) + GOAL)
    wait_for(lambda: len(server.goals) == 3)
    raw.write("cancel", goal_id(b"", 2), header=False)
    wait_for(lambda: len(server.cancels) == 2)
    raw.write("cancel", goal_id(b""), header=False)
    wait_for(lambda: len(server.cancels) == 3)
    assert [text_of(uuid) for uuid in server.cancels] == [b"goal 1", b"goal 2", b"goal 3"]
    raw.write("goal", goal_id(b"late", 1) + GOAL)
    wait_for(lambda: raw.got["result"])
    assert len(server.goals) == 3


def test_a_goal_without_a_text_gets_one(graph: Any, server: Server) -> None:
    """As actionlib gives it; it is found again from the UUID."""
    raw = Raw(graph("robot"), serves=False)
    raw.write("goal", goal_id(b"") + GOAL)
    ((uuid, _),) = wait_for(lambda: server.goals)
    wait_for(lambda: raw.got["status"])
    assert listed(raw.got["status"][-1]) == [(uuid.hex().encode(), 0)]


def test_ended_goals_are_listed_for_a_while(graph: Any, server: Server, clock: SteppedClock) -> None:
    """Those that were rejected, too: a client takes a goal that is missing to be lost."""
    raw = Raw(graph("robot"), serves=False)
    for text in (b"one", b"two"):
        raw.write("goal", goal_id(text) + GOAL)
    wait_for(lambda: len(server.goals) == 2)
    server.reject(uuid_of(b"one"))
    server.accept(uuid_of(b"two"))
    server.execute(uuid_of(b"two"))
    server.succeed(uuid_of(b"two"), DONE)
    wait_for(lambda: sorted(listed(raw.got["status"][-1])) == [(b"one", 5), (b"two", 3)])
    clock.advance(11)
    server.tick()
    wait_for(lambda: listed(raw.got["status"][-1]) == [])


# -- adoption


def test_a_restarted_server_adopts(graph: Any, server: Server, client: Client, clock: SteppedClock) -> None:
    """The goal of our own client is named as before and never missing, and its result arrives."""
    begin(server, client)
    server.close()
    adopting = Server(graph("next"), clock)
    assert client.ready
    assert adopting.adopt(ONE, 5, GoalStatus.EXECUTING)
    assert adopting.succeed(ONE, DONE)
    assert client.wait("result").payload == DONE


@pytest.mark.parametrize("how", ["note", "cancel"])
def test_a_long_text_of_an_adopted_goal(graph: Any, server: Server, how: str) -> None:
    """The note about it tells the text; without one it is listed otherwise until its cancel tells it."""
    raw = Raw(graph("robot"), serves=False)
    uuid = uuid_of(LONG)
    server.adopt(uuid, 5, GoalStatus.EXECUTING, LONG if how == "note" else b"")
    wait_for(lambda: raw.got["status"])
    assert listed(raw.got["status"][-1]) == [(LONG if how == "note" else text_of(uuid), 1)]
    raw.write("cancel", goal_id(LONG), header=False)
    wait_for(lambda: server.cancels)
    assert server.note(uuid) == LONG
    server.accept_cancel(uuid)
    server.canceled(uuid)
    late: list[bytes] = []  # latched, as every subscriber of ROS 1 takes it
    kind = "actionlib/msg/TestActionResult"
    graph("late").subscribe("/test/result", kind, STATUS_QOS, lambda data, _: late.append(data))
    for got in (raw.got["result"], late):
        wait_for(lambda got=got: got)
        assert got[0][16 : 28 + len(LONG)] == struct.pack("<3I", 0, 5, len(LONG)) + LONG


@pytest.mark.parametrize("text", [b"a", b"goal 1", b"x" * 16, ONE.hex().encode(), b"0123456789abcdef" * 2])
def test_texts_that_are_found_again(text: bytes) -> None:
    """Hexadecimal digits of 16 bytes, and what has at most 16 bytes."""
    assert text_of(uuid_of(text)) == text


def test_longer_texts_have_digests() -> None:
    assert len(uuid_of(LONG)) == 16
    assert uuid_of(LONG) != uuid_of(LONG + b"0")


# -- a client and what it is told


@pytest.fixture
def cell(graph: Any) -> Raw:
    return Raw(graph("cell"), serves=True)


@pytest.fixture
def robot(graph: Any, cell: Raw, clock: SteppedClock) -> Client:
    client = Client(graph("robot"), clock)
    wait_for(lambda: client.ready)
    return client


TEXT = ONE.hex().encode()


def test_a_server_that_lists_the_goal_no_longer(cell: Raw, robot: Client) -> None:
    """It does not know the goal: its fate is unknown."""
    robot.send(ONE, GOAL)
    cell.list()
    cell.list((TEXT, 1), (b"others", 1))
    cell.list((b"others", 1))
    assert robot.wait("result") == GoalEvent(ONE, "result")
    assert robot.kinds() == ["accepted", "status", "result"]


def test_a_goal_that_is_never_listed(cell: Raw, robot: Client, clock: SteppedClock) -> None:
    """After a while nothing is known of it, adopted or sent."""
    robot.send(ONE, GOAL)
    robot.adopt(TWO)
    clock.advance(11)
    cell.list()
    reply = robot.wait("failed").reply
    assert reply is not None
    assert reply.outcome == "fate unknown"
    assert robot.wait("result", TWO) == GoalEvent(TWO, "result")


def test_a_result_that_was_missed(cell: Raw, robot: Client, clock: SteppedClock) -> None:
    """The goal's status is known anyway."""
    robot.adopt(ONE)
    cell.list((TEXT, 3))
    assert robot.wait("status").status is GoalStatus.SUCCEEDED
    clock.advance(11)
    cell.list((TEXT, 3))
    assert robot.wait("result") == GoalEvent(ONE, "result", None, GoalStatus.SUCCEEDED)


def test_topics_have_no_order(cell: Raw, robot: Client) -> None:
    """A result that comes first tells everything; an older status changes nothing."""
    robot.send(ONE, GOAL)
    robot.send(TWO, GOAL)
    cell.list((TEXT, 6))
    robot.wait("canceling")
    cell.write("feedback", status(TEXT, 1) + HALF)
    robot.wait("feedback")
    cell.write("result", status(TEXT, 2) + DONE)
    cell.write("result", status(TWO.hex().encode(), 3) + DONE)
    robot.wait("result", TWO)
    assert robot.kinds() == ["accepted", "canceling", "status", "feedback", "status", "result"]
    assert robot.kinds(TWO) == ["accepted", "status", "result"]


def test_without_a_server_nothing_is_sent(graph: Any, clock: SteppedClock) -> None:
    client = Client(graph("robot"), clock)
    assert client.send(ONE, GOAL)
    reply = client.wait("failed").reply
    assert reply is not None
    assert reply.outcome == "not executed"
    assert client.send(ONE, GOAL)


@pytest.mark.parametrize("size", range(32))
def test_messages_that_are_too_short(server: Server, client: Client, size: int) -> None:
    """Whatever they claim to hold, they are refused."""
    for receive in (server._on_send, client._on_statuses, partial(client._on_news, "result")):
        with pytest.raises(BackendError, match="ROS008"):
            receive((bytes(16) + b"\1" * 20)[:size] if size < 32 else b"\xff" * 40, 0)


def test_a_text_without_end(server: Server) -> None:
    """It is not remembered."""
    with pytest.raises(BackendError, match="the limit is 1024"):
        server._on_send(bytes(16) + goal_id(b"x" * 1025) + GOAL)
    assert not server.goals
