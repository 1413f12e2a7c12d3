"""Calls in recordings: the events of ROS 2's service introspection."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from rosplc.described import description_of
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.recorder import Selection
from rosplc.shm import SERVICE, Caller, Namespace, OwnedChannel, Part, attach_together
from rosplc.shm.constants import ANSWER_DONE, ANSWER_NOT_EXECUTED, ASK_WITHDRAWN
from tests.unit.recorder.making import Feed, received, recording, until

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
        self.plc = attach_together(namespace, name, SERVICE, client=client, write=True)
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
        assert [error.code for error in recorder.failures.values()] == ["SHM112"]
