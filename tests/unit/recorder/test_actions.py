"""Goals in recordings: the topics of an action, and the events of its services."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

from rosplc.cli.app import app
from rosplc.codec import Codec, Wire
from rosplc.config import parse_config, resolve
from rosplc.described import description_of
from rosplc.errors import RecordingError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.reasons import Reason
from rosplc.recorder import Selection
from rosplc.recorder.carried import CarriedAction
from rosplc.recorder.replay import (
    PlcTarget,
    RosTarget,
    chosen_topics,
)
from rosplc.recorder.source import open_source
from rosplc.ros import action_classes, open_backend
from rosplc.shm import ACTION, SERVICE, Caller, Group, Namespace, OwnedChannel, Part, attach
from rosplc.shm import constants as spec
from rosplc.virtual_plc import ActionServer as VirtualServer
from rosplc.virtual_plc import Task
from tests.lib.waiting import wait_for
from tests.unit.recorder.making import Feed, play, received, recording, until

FIBONACCI = "example_interfaces/action/Fibonacci"
GOAL = bytes(range(1, 17))
NAME = "/cell/count"
SERVICES = [
    f"{NAME}/_action/{service}/_service_event" for service in ("send_goal", "cancel_goal", "get_result")
]
TOPICS = [*SERVICES, f"{NAME}/_action/feedback", f"{NAME}/_action/status"]
SEND, CANCEL, RESULT, FEEDBACK, STATUS = TOPICS


class Action:
    """Both sides of one use of an action, which the PLC or ROS carries out."""

    def __init__(
        self, namespace: Namespace, server: Any = "plc", distro: str = "jazzy", kind: str = FIBONACCI
    ) -> None:
        name, store, limits = NAME, TypeStore.bundled(distro), Limits(sequence=8)
        words = {part: f"{kind}_{part.word.capitalize()}" for part in ACTION}
        self.layouts = {part: compute_layout(store, message, limits) for part, message in words.items()}
        parts = [
            (description_of(layout, name, part.direction(server), part=part, bridge="test"), layout.size)
            for part, layout in self.layouts.items()
        ]
        self.owned = dict(zip(ACTION, OwnedChannel.open_together(namespace, parts), strict=True))
        self.plc = {part: attach(namespace, name, part=part, write=True) for part in ACTION}
        asks, answers = (self.owned, self.plc) if server == "plc" else (self.plc, self.owned)
        self.asks = asks[Part.GOAL].writer()
        self.writers = {part: answers[part].writer() for part in (Part.RESULT, Part.FEEDBACK)}
        self.caller = Caller(asks[Part.GOAL], self.asks, follows_claim=False)
        self.number = 0

    def ask(self, goal: bytes = GOAL, /, **fields: Any) -> None:
        self.goal = goal
        self.send = partial(self.asks.publish, self.layouts[Part.GOAL].pack(fields))
        self.number = self.caller.call(self.send, client=goal)

    def tell(self, status: int, part: Part = Part.RESULT, reason: int = 0, **fields: Any) -> None:
        record = self.layouts[part].pack(fields)
        words = {"correlation": self.number, "client": self.goal, "reason": reason}
        self.writers[part].publish(record, status=status, **words)
        if status & spec.ANSWER_MASK != spec.ANSWER_ACCEPTED:
            self.caller.correlation = 0

    def feed(self, *numbers: int) -> None:
        self.tell(spec.ANSWER_ACCEPTED, Part.FEEDBACK, sequence=numbers)

    def close(self) -> None:
        for each in (*self.plc.values(), *self.owned.values()):
            each.close()


@contextmanager
def messages(path: Path) -> Iterator[list[tuple[str, Any]]]:
    """Give topic and message of a recording as rosbags reads them."""
    with AnyReader([path]) as bag:
        yield [(one.topic, bag.deserialize(data, one.msgtype)) for one, _, data in bag.messages()]


def told(found: list[tuple[str, Any]]) -> list[Any]:
    """Return what a recording tells, without numbers and times."""
    seen: list[Any] = []
    for topic, message in found:
        if topic == FEEDBACK:
            seen.append(("feedback", list(message.feedback.sequence)))
        elif topic == STATUS:
            seen.append(("status", [one.status for one in message.status_list]))
        else:
            kind = message.info.event_type
            [content] = [*message.request, *message.response]
            names = [name for name in ("accepted", "return_code", "goal") if hasattr(content, name)]
            value: Any = getattr(content, names[0]) if names else None
            value = getattr(value, "order", value)
            if hasattr(content, "result"):
                value = (content.status, list(content.result.sequence))
            seen.append((topic.split("/")[4], kind, value))
    return seen


@pytest.mark.parametrize(("server", "kinds"), [("plc", (1, 2)), ("ros", (0, 3))])
def test_a_goal_is_recorded_as_ros_does(
    shm_namespace: Namespace, tmp_path: Path, server: str, kinds: tuple[int, int]
) -> None:
    """Goal, decision, feedback, status, result, in this order, in a file that others read."""
    action = Action(shm_namespace, server)
    asks, answers = kinds
    with recording(shm_namespace, tmp_path / "r", bag=True) as recorder:
        for at, step in enumerate(
            (
                lambda: action.ask(order=3),
                lambda: action.tell(spec.ANSWER_ACCEPTED),
                lambda: action.feed(0, 1),
                lambda: action.tell(spec.ANSWER_SUCCEEDED, sequence=[0, 1, 1]),
            )
        ):
            step()
            until(lambda n=(1, 4, 5, 7)[at]: received(recorder) == n, recorder)
        result = recorder.stop()
    action.close()
    assert set(result.topics) == set(TOPICS) and result.lost == 0
    with AnyReader([tmp_path / "r"]) as bag:  # which compares the hashes with the definitions
        assert {one.topic: one.msgtype for one in bag.connections} == {
            SEND: f"{FIBONACCI}_SendGoal_Event",
            RESULT: f"{FIBONACCI}_GetResult_Event",
            FEEDBACK: f"{FIBONACCI}_FeedbackMessage",
            STATUS: "action_msgs/msg/GoalStatusArray",
        }
    with messages(tmp_path / "r") as found:
        assert told(found) == [
            ("send_goal", asks, 3),
            ("send_goal", answers, True),
            ("get_result", asks, None),
            ("status", [2]),
            ("feedback", [0, 1]),
            ("status", [4]),
            ("get_result", answers, (4, [0, 1, 1])),
        ]
        goals = [message for topic, message in found if topic != STATUS and topic != FEEDBACK]
        assert {bytes(event.info.client_gid) for event in goals} == {GOAL}
        assert bytes(goals[0].request[0].goal_id.uuid) == bytes(goals[2].request[0].goal_id.uuid) == GOAL
        statuses = [message.status_list[0].goal_info for topic, message in found if topic == STATUS]
        assert all(bytes(one.goal_id.uuid) == GOAL and one.stamp.sec for one in statuses)
    [file] = (tmp_path / "r").glob("*.mcap")
    with file.open("rb") as stream:
        seen = {channel.topic for _, channel, _ in make_reader(stream).iter_messages()}
    assert seen == set(TOPICS) - {CANCEL}


CANCELED = spec.ANSWER_CANCEL_ACCEPTED


def test_cancellation_is_recorded(shm_namespace: Namespace, tmp_path: Path) -> None:
    """Requests to cancel with their answers: one that is rejected, and one that leads to the end."""
    action = Action(shm_namespace)
    with recording(shm_namespace, tmp_path / "r") as recorder:
        for count, step in (
            (1, lambda: action.ask(order=3)),
            (4, lambda: action.tell(spec.ANSWER_ACCEPTED)),
            (5, lambda: action.caller.again(action.send, spec.ASK_CANCEL)),
            (6, lambda: action.tell(spec.ANSWER_ACCEPTED | spec.ANSWER_CANCEL_REJECTED)),
            (6, lambda: action.caller.again(action.send, 0)),
            (7, lambda: action.caller.again(action.send, spec.ASK_CANCEL)),
            (9, lambda: action.tell(spec.ANSWER_ACCEPTED | CANCELED)),
            (11, lambda: action.tell(spec.ANSWER_CANCELED | CANCELED, sequence=[0])),
        ):
            step()
            until(lambda n=count: received(recorder) == n, recorder)
        recorder.stop()
    action.close()
    with messages(tmp_path / "r.mcap") as found:
        assert told(found)[4:] == [
            ("cancel_goal", 1, None),
            ("cancel_goal", 2, 1),
            ("cancel_goal", 1, None),
            ("cancel_goal", 2, 0),
            ("status", [3]),
            ("status", [5]),
            ("get_result", 2, (5, [0])),
        ]


def test_goals_that_did_not_begin(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A goal that was rejected is, one that was withdrawn unseen or whose fate is unknown has no answer."""
    action = Action(shm_namespace, "ros")
    with recording(shm_namespace, tmp_path / "r") as recorder:
        action.ask(order=1)
        action.tell(spec.ANSWER_NOT_EXECUTED, reason=Reason.REJECTED)
        until(lambda: received(recorder) == 2, recorder)
        action.ask(order=2)
        action.tell(spec.ANSWER_NOT_EXECUTED, reason=Reason.NO_SERVER)
        until(lambda: received(recorder) == 3, recorder)
        action.ask(order=3)
        action.tell(spec.ANSWER_FATE_UNKNOWN)
        until(lambda: received(recorder) == 4, recorder)
        action.ask(order=4)
        action.tell(spec.ANSWER_SUCCEEDED | spec.ANSWER_NO_RESULT)
        until(lambda: received(recorder) == 8, recorder)
        recorder.stop()
    action.close()
    with messages(tmp_path / "r.mcap") as found:
        assert told(found) == [
            ("send_goal", 0, 1), ("send_goal", 3, False), ("send_goal", 0, 2), ("send_goal", 0, 3),
            ("send_goal", 0, 4), ("send_goal", 3, True), ("get_result", 0, None), ("status", [4]),
        ]  # fmt: skip


def test_a_recording_that_begins_with_a_goal_under_way(shm_namespace: Namespace, tmp_path: Path) -> None:
    """What is not known is not made up: feedback and end are there, goal and decision are not."""
    action = Action(shm_namespace)
    action.ask(order=3)
    action.tell(spec.ANSWER_ACCEPTED)
    with recording(shm_namespace, tmp_path / "r") as recorder:
        action.feed(0)
        until(lambda: received(recorder) == 1, recorder)
        action.caller.again(action.send, spec.ASK_CANCEL)
        until(lambda: received(recorder) == 2, recorder)
        action.tell(spec.ANSWER_ABORTED, sequence=[0])
        until(lambda: received(recorder) == 4, recorder)
        recorder.stop()
    action.close()
    with messages(tmp_path / "r.mcap") as found:
        assert told(found) == [
            ("feedback", [0]), ("cancel_goal", 1, None), ("status", [6]), ("get_result", 2, (6, [0])),
        ]  # fmt: skip


def test_feedback_never_precedes_the_acceptance(shm_namespace: Namespace) -> None:
    """Both come while the recorder looks at the objects, behind its look at the answers."""
    action = Action(shm_namespace)
    carried = CarriedAction(shm_namespace, shm_namespace.path(NAME, Part.GOAL), since_ns=None)
    carried.join(Group())
    answers, looked = carried._objects[1], carried._objects[1].next

    def look() -> Any:
        found, answers.next = looked(), looked  # type: ignore[method-assign]
        action.tell(spec.ANSWER_ACCEPTED)
        action.feed(0)
        return found

    answers.next = look  # type: ignore[method-assign]
    action.ask(order=3)
    seen = [carried.streams[event.stream].topic for _ in range(2) for event in carried.events(1)]
    carried.close()
    action.close()
    assert seen == [SEND, SEND, RESULT, STATUS, FEEDBACK]


def test_many_goals_at_once_are_told_one_by_one(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A goal that follows at once does not take the end of the one before as its own."""
    action = Action(shm_namespace)
    with recording(shm_namespace, tmp_path / "r", selection=Selection((NAME,), (STATUS, RESULT))) as recorder:
        for order in range(20):
            action.ask(GOAL[:-1] + bytes([order]), order=order)
            action.tell(spec.ANSWER_SUCCEEDED, sequence=[order])
            if order % 2:
                until(lambda n=2 * order + 2: received(recorder) == n, recorder)
        assert list(recorder.stop().topics) == sorted((SEND, CANCEL, FEEDBACK))
    action.close()
    with messages(tmp_path / "r.mcap") as found:
        assert sorted(told(found), key=str) == sorted(
            [one for order in range(20) for one in (("send_goal", 1, order), ("send_goal", 2, True))], key=str
        )


@pytest.mark.parametrize(
    ("chosen", "topics"),
    [((NAME,), TOPICS), (("/cell/*",), TOPICS), (("*/feedback",), [FEEDBACK]), (("/other",), ["/other"])],
)
def test_actions_are_selected_by_name(
    shm_namespace: Namespace, tmp_path: Path, chosen: tuple[str, ...], topics: list[str]
) -> None:
    """An action's name means all of its topics; each can be chosen by itself."""
    action, other = Action(shm_namespace), Feed(shm_namespace, "/other")
    with recording(shm_namespace, tmp_path / "r", selection=Selection(chosen)) as recorder:
        assert list(recorder.stop().topics) == sorted(topics)
    action.close()
    other.close()


@pytest.mark.parametrize("parts", [SERVICE, ACTION])
@pytest.mark.parametrize(
    "type_name", ["std_msgs/msg/Bool", f"{FIBONACCI}_Goal", "std_srvs/srv/SetBool_Request"]
)
def test_objects_of_other_types_are_refused(
    shm_namespace: Namespace, tmp_path: Path, parts: tuple[Part, ...], type_name: str
) -> None:
    """Objects that call themselves a service's or an action's, but have other messages, are named."""
    layout = compute_layout(TypeStore.bundled("jazzy"), type_name)
    descriptions = [
        (description_of(layout, NAME, part.direction("plc"), part=part, bridge="test"), layout.size)
        for part in parts
    ]
    owned = OwnedChannel.open_together(shm_namespace, descriptions)
    with recording(shm_namespace, tmp_path / "r") as recorder:
        assert [error.code for error in recorder.inlet.failures.values()] == ["SHM113"]
    for each in owned:
        each.close()


DOMAIN = 4713  # of this process alone
STORE = TypeStore.bundled("jazzy")


@pytest.fixture
def shift(shm_namespace: Namespace, tmp_path: Path) -> Path:
    """A recording with the goals 3, 5 and 4."""
    return shift_of(shm_namespace, tmp_path)


def shift_of(namespace: Namespace, folder: Path, *action_of: str) -> Path:
    action, feed = Action(namespace, "ros", *action_of), Feed(namespace, "/a")
    with recording(namespace, folder / "shift") as recorder:
        feed.number(1)
        for count, order in ((8, 3), (15, 5), (22, 4)):
            action.ask(order=order)
            action.tell(spec.ANSWER_ACCEPTED)
            action.feed(0)
            action.tell(spec.ANSWER_ABORTED, sequence=[0])
            until(lambda n=count: received(recorder) == n, recorder)
    action.close()
    feed.close()
    return folder / "shift.mcap"


@contextmanager
def arm(
    name: str, goals: list[int], store: TypeStore = STORE, kind: str = FIBONACCI, wire: Wire = Wire.CDR
) -> Iterator[None]:
    """Serve an action in ROS; a goal of 5 is rejected."""
    node = open_backend("memory", store, "robot", domain=DOMAIN)
    asked, told = (
        Codec(compute_layout(store, f"{kind}_{part}", Limits(sequence=8)), wire)
        for part in ("Goal", "Result")
    )

    def on_goal(uuid: bytes, payload: bytes) -> None:
        goals.append(asked.layout.to_dict(asked.decode(payload))["order"])
        if goals[-1] == 5:
            server.reject(uuid)
            return
        server.accept(uuid)
        server.execute(uuid)
        server.succeed(uuid, told.encode(told.layout.pack({"sequence": [goals[-1]]})))

    server = action_classes(store)[0](node, store, name, kind, on_goal=on_goal, on_cancel=lambda _: None)
    server.tick()
    try:
        yield
    finally:
        server.close()
        node.close()


def test_goals_are_sent_only_where_the_action_is_named(shift: Path) -> None:
    """Neither all topics nor those of the action send one; feedback and status are left out as well."""
    source = open_source(shift)
    for to_plc in (True, False):
        chosen, remarks = chosen_topics(source, Selection(), {}, to_plc=to_plc)
        assert list(chosen) == ["/a"]
        assert [one for one in remarks if "--action /cell/count" in one] == remarks
        for name in (NAME, SEND):
            with pytest.raises(RecordingError, match="REC006"):
                chosen_topics(source, Selection((name,)), {}, to_plc=to_plc)
        with pytest.raises(RecordingError, match=r"/other.*REC006"):
            chosen_topics(source, Selection(), {}, to_plc=to_plc, actions=["/other"])
        with pytest.raises(RecordingError, match=r"/cell/count.*REC006"):
            chosen_topics(source, Selection(), {}, to_plc=to_plc, services=[NAME])
    chosen, _ = chosen_topics(source, Selection(), {}, to_plc=True, actions=[NAME])
    assert list(chosen) == ["/a", SEND]
    assert list(chosen_topics(source, Selection((FEEDBACK,)), {}, to_plc=False)[0]) == [FEEDBACK]


@pytest.mark.parametrize("renamed", [False, True])
def test_recorded_goals_are_sent_to_ros(shift: Path, renamed: bool) -> None:
    """Each is sent once, and has been sent when it has ended; one that is rejected is lost."""
    source, goals, name = open_source(shift), [], "/other" if renamed else NAME
    chosen, _ = chosen_topics(source, Selection((SEND,)), {NAME: name}, to_plc=False, actions=[NAME])
    with arm(name, goals):
        target = RosTarget(chosen, backend="memory", domain=DOMAIN)
        count = play(source, target, chosen)
    assert goals == [3, 5, 4]
    assert (count.sent, count.lost, count.reason) == (2, 1, "the goal was rejected")


@pytest.mark.parametrize(
    ("recorded", "kind"), [("noetic", "actionlib_tutorials/action/Fibonacci"), ("jazzy", FIBONACCI)]
)
def test_recorded_goals_are_sent_to_ros_1(
    shm_namespace: Namespace, tmp_path: Path, recorded: str, kind: str
) -> None:
    """To a server of actionlib, whether a bridge of ROS 1 or of ROS 2 carried them."""
    source, goals = open_source(shift_of(shm_namespace, tmp_path, recorded, kind)), []
    chosen, _ = chosen_topics(source, Selection((SEND,)), {}, to_plc=False, actions=[NAME])
    parts = (f"{kind}_{part}" for part in ("Goal", "Result", "Feedback"))
    store = TypeStore.bundled("noetic").with_types_of(TypeStore.bundled(recorded), *parts)
    with arm(NAME, goals, store, kind, Wire.ROS1):
        target = RosTarget(chosen, backend="memory", distro="noetic", domain=DOMAIN)
        count = play(source, target, chosen)
    assert goals == [3, 5, 4]
    assert (count.sent, count.lost, count.reason) == (2, 1, "the goal was rejected")


def test_recorded_goals_are_sent_to_the_plc(shm_namespace: Namespace, shift: Path, tmp_path: Path) -> None:
    """The PLC carries each out once, as if a bridge had sent it; what waits for its turn is not lost."""
    text = f"""
prefix: {shm_namespace.prefix}
actions:
  {NAME}: {{type: {FIBONACCI}, server: plc, on_new_goal: buffer, queue: 4, limits: {{result.sequence: 8}}}}
"""
    config = tmp_path / "rosplc.yaml"
    config.write_text(text)
    project = resolve(parse_config(text))
    source = open_source(shift)
    chosen, _ = chosen_topics(source, Selection((SEND,)), {}, to_plc=True, actions=[NAME])
    with pytest.raises(RecordingError, match="REC007"):
        PlcTarget(chosen, shm_namespace)
    target = PlcTarget(chosen, shm_namespace, project=project)
    server, got = VirtualServer(NAME, prefix=shm_namespace.prefix, beat_ms=10_000), []

    def scan() -> None:
        server()
        if server.xGoal and not server.xAccept and not server.xReject:
            got.append(server.goal.order)
        server.xReject = server.xGoal and server.goal.order == 5
        server.xAccept, server.xSucceed = server.xGoal and not server.xReject, server.xActive

    task = Task("RosTask", 0.002, programs=[scan])
    task.start()
    try:
        wait_for(lambda: not target.missing())
        count = play(source, target, chosen)
        assert got == [3, 5, 4]
        assert (count.sent, count.lost, count.reason) == (2, 1, "the goal was rejected")
        command = ["replay", str(shift), "--to", "plc", "--config", str(config), "--wait", "30s", "--json"]
        command += ["--exclude", "/a"]
        refused = CliRunner().invoke(app, command)
        assert refused.exit_code == 1 and "REC006" in refused.output and "--action" in refused.output
        sent = CliRunner().invoke(app, [*command, "--action", NAME, "--quiet"])
        assert json.loads(sent.stdout)["topics"][SEND]["sent"] == 2
        assert got == [3, 5, 4] * 2
    finally:
        task.stop()
        server.close()
