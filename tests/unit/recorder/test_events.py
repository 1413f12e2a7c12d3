"""Calls in recordings: the events of ROS 2's service introspection."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

from rosplc.cli.app import app
from rosplc.codec import Codec, Wire
from rosplc.config import parse_config, resolve
from rosplc.described import description_of
from rosplc.errors import RecordingError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.recorder import Selection
from rosplc.recorder.mcap_file import Batch, ChannelInfo, McapFile, seal
from rosplc.recorder.replay import (
    Player,
    PlcTarget,
    ReplayOptions,
    RosTarget,
    chosen_topics,
    wait_for_answers,
)
from rosplc.recorder.source import open_source
from rosplc.ros import SERVICES, open_backend
from rosplc.shm import SERVICE, Caller, Namespace, OwnedChannel, Part, attach
from rosplc.shm.constants import ANSWER_DONE, ANSWER_NOT_EXECUTED, ASK_WITHDRAWN
from rosplc.virtual_plc import ServiceServer, Task
from tests.lib.waiting import wait_for
from tests.unit.recorder.making import Feed, play, received, recording, until

SET_BOOL = "std_srvs/srv/SetBool"
CALLER = bytes(range(1, 17))
TOPIC = "/cell/start/_service_event"


class Service:
    """Both sides of one use of a service, which the PLC or ROS carries out."""

    def __init__(
        self, namespace: Namespace, server: Any = "plc", type_name: str = SET_BOOL, client: str = "",
        limits: Limits | None = None, name: str = "/cell/start", store: TypeStore | None = None,
    ) -> None:  # fmt: skip
        store = store or TypeStore.bundled("jazzy")
        messages = {part: f"{type_name}_{part.word.capitalize()}" for part in SERVICE}
        self.layouts = {part: compute_layout(store, message, limits) for part, message in messages.items()}
        parts = [
            (
                description_of(layout, name, part.direction(server), part=part, client=client, bridge="test"),
                layout.size,
            )
            for part, layout in self.layouts.items()
        ]
        self.owned = dict(zip(SERVICE, OwnedChannel.open_together(namespace, parts), strict=True))
        where = {"client": client, "write": True}
        self.plc = {part: attach(namespace, name, part=part, **where) for part in SERVICE}
        asks, answers = (self.owned, self.plc) if server == "plc" else (self.plc, self.owned)
        writer, self.answers = asks[Part.REQUEST].writer(), answers[Part.RESPONSE].writer()
        self.asks, self.caller = writer, Caller(asks[Part.REQUEST], writer, follows_claim=False)
        self.client = b""

    def ask(self, client: bytes = b"", **fields: Any) -> int:
        self.client = client
        self.send = partial(self.asks.publish, self.layouts[Part.REQUEST].pack(fields))
        return self.caller.call(self.send, client=client)

    def answer(self, status: int = ANSWER_DONE, **fields: Any) -> None:
        record, number = self.layouts[Part.RESPONSE].pack(fields), self.caller.correlation
        self.answers.publish(record, correlation=number, status=status, client=self.client)
        self.caller.correlation = 0

    def close(self) -> None:
        for each in (*self.plc.values(), *self.owned.values()):
            each.close()


@contextmanager
def events(path: Path) -> Iterator[list[Any]]:
    """Give the events of a recording as rosbags reads them."""
    with AnyReader([path]) as bag:
        yield [bag.deserialize(data, one.msgtype) for one, _, data in bag.messages()]


@pytest.mark.parametrize(("server", "kinds"), [("plc", [1, 2]), ("ros", [0, 3])])
def test_calls_are_recorded_as_ros_does(
    shm_namespace: Namespace, tmp_path: Path, server: str, kinds: list[int]
) -> None:
    """Each call is a request and a response with one number and one client, in a file that others read."""
    service = Service(shm_namespace, server)
    caller = CALLER if server == "plc" else b""
    with recording(shm_namespace, tmp_path / "r", bag=True) as recorder:
        for number in range(3):
            service.ask(caller, data=number == 1)
            until(lambda n=number: received(recorder) == 2 * n + 1, recorder)
            service.answer(success=True, message=f"done {number}")
            until(lambda n=number: received(recorder) == 2 * n + 2, recorder)
        [topic] = recorder.stop().topics.items()
    service.close()
    assert (topic[0], topic[1].type_name, topic[1].lost) == (TOPIC, f"{SET_BOOL}_Event", 0)
    with AnyReader([tmp_path / "r"]) as bag:  # which compares the hash with the definition's
        [one] = bag.connections
        assert (one.topic, one.msgtype) == (TOPIC, f"{SET_BOOL}_Event")
    with events(tmp_path / "r") as found:
        assert [event.info.event_type for event in found] == kinds * 3
        assert [len(event.request) for event in found] == [1, 0] * 3
        assert [event.request[0].data for event in found[::2]] == [False, True, False]
        assert [event.response[0].message for event in found[1::2]] == ["done 0", "done 1", "done 2"]
        calls = [(bytes(event.info.client_gid), event.info.sequence_number) for event in found]
        assert calls[::2] == calls[1::2] and len(set(calls)) == 3
        assert {client for client, _ in calls} == {CALLER} or server == "ros"
        assert all(event.info.stamp.sec for event in found)


def test_what_is_no_request_and_no_response(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A repeated message is no second request, one that was withdrawn unseen is none, refusals are none."""
    service = Service(shm_namespace)
    service.ask(CALLER, data=True)
    with recording(shm_namespace, tmp_path / "r") as recorder:
        service.caller.again(service.send, ASK_WITHDRAWN)  # its first message came before the recording
        service.answer(ANSWER_NOT_EXECUTED)
        service.ask(CALLER, data=True)
        until(lambda: received(recorder) == 1, recorder)
        service.caller.again(service.send, 0)
        service.caller.again(service.send, ASK_WITHDRAWN)
        service.answer(ANSWER_NOT_EXECUTED)
        service.ask(CALLER, data=True)
        until(lambda: received(recorder) == 2, recorder)
        recorder.stop()
    service.close()
    with events(tmp_path / "r.mcap") as found:
        assert [event.info.event_type for event in found] == [1, 1]


def test_a_response_never_precedes_its_request(shm_namespace: Namespace, tmp_path: Path) -> None:
    """Both are in the objects when they are first looked at."""
    service = Service(shm_namespace, "ros", client="pick")
    with recording(shm_namespace, tmp_path / "r") as recorder:
        for number in range(20):
            service.ask(data=True)
            service.answer(success=True)
            until(lambda n=number: received(recorder) == 2 * n + 2, recorder)
        recorder.stop()
    service.close()
    with events(tmp_path / "r.mcap") as found:
        assert [event.info.event_type for event in found] == [0, 3] * 20


@pytest.mark.parametrize(
    "type_name", ["std_srvs/srv/Empty", "nav_msgs/srv/GetPlan", "lifecycle_msgs/srv/GetAvailableTransitions"]
)
def test_every_kind_of_field_is_found_again(shm_namespace: Namespace, tmp_path: Path, type_name: str) -> None:
    """Nested messages, sequences, 8-byte numbers behind the header, and messages without fields."""
    service = Service(shm_namespace, type_name=type_name, limits=Limits(string=20, sequence=3))
    with recording(shm_namespace, tmp_path / "r") as recorder:
        given = {"tolerance": 0.5, "goal": {"header": {"frame_id": "map"}}} if "Plan" in type_name else {}
        service.ask(CALLER, **given)
        service.answer()
        until(lambda: received(recorder) == 2, recorder)
        recorder.stop()
    service.close()
    with events(tmp_path / "r.mcap") as found:
        assert [(len(event.request), len(event.response)) for event in found] == [(1, 0), (0, 1)]
        if given:
            assert found[0].request[0].tolerance == 0.5
            assert found[0].request[0].goal.header.frame_id == "map"


def test_services_are_selected_by_name(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A service's name means its events; its objects may come, go and be replaced while recording."""
    wanted = Selection(("/cell/*",), ("/cell/stop",))
    others = [Service(shm_namespace, name="/cell/stop"), Feed(shm_namespace, "/other")]
    with recording(shm_namespace, tmp_path / "r", selection=wanted) as recorder:
        for limits in (Limits(), Limits(string=9), Limits(string=9)):
            service = Service(shm_namespace, limits=limits)
            before = received(recorder)
            service.ask(CALLER, data=True)
            until(lambda n=before: received(recorder) == n + 1, recorder)
            for channel in service.owned.values():
                channel.retire()
            service.close()
        assert list(recorder.stop().topics) == [TOPIC]
    for other in others:
        other.close()


def test_objects_that_do_not_belong_together_are_refused(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A response object of another life of the service is named, and nothing is recorded."""
    one = Service(shm_namespace)
    path = shm_namespace.path("/cell/start", Part.RESPONSE)
    kept = path.read_bytes()
    one.close()
    other = Service(shm_namespace, limits=Limits(string=9))
    other.close()
    path.write_bytes(kept)
    with recording(shm_namespace, tmp_path / "r") as recorder:
        assert [error.code for error in recorder.inlet.failures.values()] == ["SHM112"]


STORE = TypeStore.bundled("jazzy")
DOMAIN = 4712  # of this process alone
EVENT = Codec(compute_layout(STORE, f"{SET_BOOL}_Event", Limits(sequence=1)), Wire.CDR)
REQUEST, RESPONSE = (
    Codec(compute_layout(STORE, f"{SET_BOOL}_{part.word.capitalize()}"), Wire.CDR) for part in SERVICE
)
HASH = STORE.type_hash(f"{SET_BOOL}_Event")


def recorded(path: Path, *given: dict[str, Any], type_hash: str = HASH) -> Path:
    """Write events as rosbag2 does, which has no definition of them."""
    channel = ChannelInfo(
        1, TOPIC, f"{SET_BOOL}_Event", "unknown", b"", "cdr", {"topic_type_hash": type_hash}
    )
    file, batch = McapFile(path), Batch()
    file.declare(channel)
    for number, one in enumerate(given):
        batch.add(1, 0, number, number, EVENT.encode(EVENT.layout.pack(one)))
    file.append(seal(batch, "none"))
    file.finish()
    return path


def event(kind: int, number: int, **parts: Any) -> dict[str, Any]:
    content = {part: [value] for part, value in parts.items()}
    return {"info": {"event_type": kind, "client_gid": CALLER, "sequence_number": number}, **content}


def calls(path: Path, to_plc: bool = False, **rename: str) -> tuple[Any, dict[str, Any]]:
    """Return a recording and the topic that is replayed to call a service."""
    source = open_source(path)
    named = {"/cell/start": "/other"} if rename else {}
    chosen, _ = chosen_topics(source, Selection((TOPIC,)), named, to_plc=to_plc, services=["/cell/start"])
    return source, chosen


@contextmanager
def ros_server(name: str = "/cell/start") -> Iterator[list[bool]]:
    """Serve in ROS: give what was asked for."""
    got: list[bool] = []
    node = open_backend("memory", STORE, "robot", domain=DOMAIN)

    def on_request(payload: bytes, caller: bytes, _stamp_ns: int) -> None:
        got.append(REQUEST.layout.to_dict(REQUEST.decode(payload))["data"])
        server.reply(caller, RESPONSE.encode(RESPONSE.layout.pack({"success": True})))

    server = node.serve(name, SET_BOOL, SERVICES, on_request)
    try:
        yield got
    finally:
        node.close()


def test_requests_are_sent_only_where_the_service_is_named(shm_namespace: Namespace, tmp_path: Path) -> None:
    """Neither all topics nor the topic with the events sends one; a name that is not recorded is refused."""
    feed, service = Feed(shm_namespace, "/a"), Service(shm_namespace)
    with recording(shm_namespace, tmp_path / "r") as recorder:
        feed.number(1)
        service.ask(CALLER, data=True)
        until(lambda: received(recorder) == 2, recorder)
    feed.close()
    service.close()
    source = open_source(tmp_path / "r.mcap")
    assert source.topics[TOPIC].service == "/cell/start" and source.topics[TOPIC].direction == "to_plc"
    for to_plc in (True, False):
        chosen, remarks = chosen_topics(source, Selection(), {}, to_plc=to_plc)
        assert list(chosen) == ["/a"] and "--service /cell/start" in remarks[0]
        with pytest.raises(RecordingError, match="REC006"):
            chosen_topics(source, Selection((TOPIC,)), {}, to_plc=to_plc)
        with pytest.raises(RecordingError, match=r"/cell/stop.*REC006"):
            chosen_topics(source, Selection(), {}, to_plc=to_plc, services=["/cell/stop"])
    chosen, _ = chosen_topics(source, Selection(), {}, to_plc=True, services=["/cell/start"])
    assert list(chosen) == ["/a", TOPIC]


@pytest.mark.parametrize("renamed", [False, True])
def test_recorded_requests_are_sent_to_ros(shm_namespace: Namespace, tmp_path: Path, renamed: bool) -> None:
    """Each request of the recording is sent once; the responses in it are not."""
    service = Service(shm_namespace, "ros")
    with recording(shm_namespace, tmp_path / "r") as recorder:
        for number, data in enumerate((True, False, True)):
            service.ask(data=data)
            service.answer(success=True)
            until(lambda n=number: received(recorder) == 2 * n + 2, recorder)
    service.close()
    name = "/other" if renamed else "/cell/start"
    source, topics = calls(tmp_path / "r.mcap", **({"to": name} if renamed else {}))
    with ros_server(name) as got:
        count = play(source, RosTarget(topics, backend="memory", domain=DOMAIN), topics)
    assert (got, count.sent, count.lost) == ([True, False, True], 3, 0)


def test_what_ros_has_recorded_is_sent_once(tmp_path: Path) -> None:
    """A call that both sides told of is one; the fact of a request without its content is refused."""
    path = recorded(
        tmp_path / "r.mcap",
        event(0, 1, request={"data": True}),
        event(1, 1, request={"data": True}),
        event(2, 1, response={"success": True}),
        event(3, 1, response={"success": True}),
        event(1, 2, request={"data": False}),
        event(0, 3),
    )
    source, topics = calls(path)
    with ros_server() as got:
        count = play(source, RosTarget(topics, backend="memory", domain=DOMAIN), topics)
    assert (got, count.sent, count.refused) == ([True, False], 2, 1)
    assert "content of the request was not recorded" in count.reason


def test_another_definition_is_refused(tmp_path: Path) -> None:
    """Without a definition in the file, the hash of the type tells."""
    _, topics = calls(recorded(tmp_path / "r.mcap", event(0, 1), type_hash=HASH[:-1] + "x"))
    with pytest.raises(RecordingError, match="REC007"):
        RosTarget(topics, backend="memory", domain=DOMAIN)


def test_a_server_that_is_not_there_is_no_success(tmp_path: Path) -> None:
    """A request that nobody took is lost, and the reason is told."""
    source, topics = calls(recorded(tmp_path / "r.mcap", event(0, 1, request={"data": True})))
    target = RosTarget(topics, backend="memory", domain=DOMAIN)
    assert target.missing() == [TOPIC]
    Player(source, target, topics, ReplayOptions(speed=0)).play(lambda _: False)
    wait_for_answers(target, lambda _: False)
    target.close()
    assert (target.counts[TOPIC].sent, target.counts[TOPIC].lost) == (0, 1)
    assert "no server is available" in target.counts[TOPIC].reason


def project_of(namespace: Namespace, service: str) -> Any:
    text = f"prefix: {namespace.prefix}\nservices:\n  /cell/start: {service}\n"
    return resolve(parse_config(text))


def test_recorded_requests_are_sent_to_the_plc(shm_namespace: Namespace, tmp_path: Path) -> None:
    """The PLC carries each out once, as if a bridge had sent it, and what it answers is counted."""
    project = project_of(shm_namespace, f"{{type: {SET_BOOL}, server: plc}}")
    path = recorded(
        tmp_path / "r.mcap", *(event(1, number, request={"data": number % 2 == 0}) for number in range(6))
    )
    source, topics = calls(path, to_plc=True)
    target = PlcTarget(topics, shm_namespace, project=project)
    server, got = ServiceServer("/cell/start", prefix=shm_namespace.prefix, beat_ms=10_000), []

    def scan() -> None:
        asked = server()
        if asked and not server.xReply and server.request is not None:
            got.append(server.request.data)
        server.xReply = asked and not server.xReply

    task = Task("RosTask", 0.002, programs=[scan])
    task.start()
    try:
        wait_for(lambda: not target.missing())
        count = play(source, target, topics)
        assert (got, count.sent, count.lost) == ([True, False] * 3, 6, 0)
        config = tmp_path / "rosplc.yaml"
        config.write_text(
            f"prefix: {shm_namespace.prefix}\nservices: {{/cell/start: {{type: {SET_BOOL}, server: plc}}}}\n"
        )
        command = ["replay", str(path), "--to", "plc", "--config", str(config), "--wait", "30s", "--json"]
        refused = CliRunner().invoke(app, command)
        assert refused.exit_code == 1 and "REC006" in refused.output and "--service" in refused.output
        sent = CliRunner().invoke(app, [*command, "--service", "/cell/start", "--quiet"])
        assert json.loads(sent.stdout)["topics"][TOPIC]["sent"] == 6
        assert got == [True, False] * 6
    finally:
        task.stop()
        server.close()


@pytest.mark.parametrize(
    "service",
    [f"{{type: {SET_BOOL}, server: ros}}", "{type: std_srvs/srv/Trigger, server: plc}", None],
)
def test_what_the_configuration_does_not_have_is_refused(
    shm_namespace: Namespace, tmp_path: Path, service: str | None
) -> None:
    """A service that the PLC calls, one of another type, and no configuration at all."""
    _, topics = calls(recorded(tmp_path / "r.mcap", event(1, 1)), to_plc=True)
    with pytest.raises(RecordingError, match="REC007"):
        PlcTarget(topics, shm_namespace, project=service and project_of(shm_namespace, service))
