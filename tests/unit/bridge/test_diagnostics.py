"""What is on /diagnostics, decoded by an independent library."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from rosplc.bridge.diagnostics import TOPIC, TYPE, Diagnostics
from rosplc.bridge.status import BridgeStatus, TopicStatus
from rosplc.bridge.stream import Stream
from rosplc.model import TypeStore
from rosplc.ros import Qos, open_backend
from rosplc.shm import Direction
from tests.lib.clock import SteppedClock
from tests.lib.waiting import wait_for
from tests.unit.bridge.conftest import Cell, wire

INT = "std_msgs/msg/Int32"
STRING = "std_msgs/msg/String"


def statuses(messages: list[bytes]) -> dict[str, Any]:
    """Return the newest status by name."""
    store = get_typestore(Stores.ROS2_JAZZY)
    return {status.name: status for data in messages for status in store.deserialize_cdr(data, TYPE).status}


def test_one_status_for_the_bridge_and_one_per_topic(cell: Cell) -> None:
    """Levels, words and counters are those of Bridge.status()."""
    messages = cell.listen(TOPIC, TYPE)
    topics = f"  /text: {{type: {STRING}, to: plc, limits: {{data: 3}}}}\n  /out: {{type: {INT}, to: ros}}\n"
    cell.start(topics, diagnostics=True)
    publisher = cell.publisher("/text", STRING)
    publisher.write(wire(STRING, {"data": "fits"[:3]}))
    publisher.write(wire(STRING, {"data": "does not"}))

    def refused() -> bool:
        found = statuses(messages).get("rosplc: cell: /text")
        return found is not None and found.level == 1

    wait_for(refused)
    found = statuses(messages)
    assert list(found) == ["rosplc: cell", "rosplc: cell: /text", "rosplc: cell: /out"]
    bridge, text, out = found.values()
    assert (bridge.level, bridge.message, bridge.hardware_id) == (0, "2 topics over memory", "cell")
    assert "data: string has 8 bytes; the limit is 3" in text.message
    values = {pair.key: pair.value for pair in text.values}
    assert list(values) == [
        "type", "direction", "rate [Hz]", "age", "matched", "PLC alive", "received", "published", "skipped",
        "lost", "refused", "truncated", "substituted", "recovered", "reason",
    ]  # fmt: skip
    assert (values["received"], values["published"], values["refused"]) == ("2", "1", "1")
    assert (values["type"], values["direction"], values["matched"]) == (STRING, "to_plc", "1")
    assert (out.level, out.message) == (1, "no PLC task writes it")


def test_stale_topics_are_stale(cell: Cell) -> None:
    """A topic whose messages stopped has the level STALE."""
    messages = cell.listen(TOPIC, TYPE)
    cell.start(f"  /in: {{type: {INT}, to: plc, stale_after: 50ms}}\n", diagnostics=True)
    cell.publisher("/in", INT).write(wire(INT, {"data": 1}))
    wait_for(lambda: (found := statuses(messages).get("rosplc: cell: /in")) is not None and found.level == 3)
    assert "ago from ROS" in statuses(messages)["rosplc: cell: /in"].message


def test_many_topics_come_in_several_messages(cell: Cell) -> None:
    """Each message stays small; together they name every topic, with the present time."""
    messages = cell.listen(TOPIC, TYPE)
    cell.start("".join(f"  /t{i}: {{type: {INT}, to: plc}}\n" for i in range(70)), diagnostics=True)
    wait_for(lambda: len(statuses(messages)) == 71)
    store = get_typestore(Stores.ROS2_JAZZY)
    parts: list[Any] = [store.deserialize_cdr(data, TYPE) for data in messages[:3]]
    assert [len(part.status) for part in parts] == [32, 32, 7]
    assert parts[0].header.stamp.sec == cell.stamps[TOPIC][0] // 10**9


def test_no_diagnostics_where_not_wanted(cell: Cell) -> None:
    """With diagnostics: {enabled: false} the topic is not even advertised."""
    cell.start(f"  /in: {{type: {INT}, to: plc}}\n", diagnostics=False)
    assert TOPIC not in cell.peer.graph().topics


def test_diagnostics_outlast_2038() -> None:
    """Seconds beyond an int32 keep their bits, which ROS 1 reads as they are."""
    got: list[bytes] = []
    types = TypeStore.bundled("jazzy")
    clock = SteppedClock(time_ns=(2**31 + 5) * 10**9)
    with closing(open_backend("memory", types, "cell", domain=92)) as backend:
        backend.subscribe(TOPIC, TYPE, Qos(), lambda payload, _: got.append(payload))
        sender = Diagnostics(types, backend, clock)
        sender.publish(BridgeStatus("cell", "memory", running=True))
        wait_for(lambda: got)
    store = get_typestore(Stores.ROS2_JAZZY)
    sent: Any = store.deserialize_cdr(got[0], TYPE)
    assert sent.header.stamp.sec % 2**32 == 2**31 + 5


def test_what_has_not_changed_is_sent_again() -> None:
    """A status keeps its words when the one before it has become longer, and so has another place."""
    got: list[bytes] = []
    first, second = (
        TopicStatus(topic=f"/{name}", type_name=INT, direction=Direction.TO_PLC, problem="m", reason="none")
        for name in "ab"
    )
    types = TypeStore.bundled("jazzy")
    with closing(open_backend("memory", types, "cell", domain=92)) as backend:
        backend.subscribe(TOPIC, TYPE, Qos(), lambda payload, _: got.append(payload))
        sender = Diagnostics(types, backend)
        for length in range(6):
            topics = replace(first, reason="x" * length), second
            sender.publish(BridgeStatus("cell", "memory", running=True, topics=topics))
            wait_for(lambda: len(got) == length + 1)  # noqa: B023 - called at once
    store = get_typestore(Stores.ROS2_JAZZY)
    for length, payload in enumerate(got):
        sent: Any = store.deserialize_cdr(payload, TYPE)
        _, one, other = sent.status
        assert (one.name, one.values[-1].value) == ("rosplc: cell: /a", "x" * length)
        assert (other.level, other.name, other.message) == (2, "rosplc: cell: /b", "m")
        assert (other.values[-1].key, other.values[-1].value) == ("reason", "none")


@pytest.mark.parametrize("length", range(230, 250))
def test_long_texts_are_cut(length: int) -> None:
    """A text keeps its first 240 bytes, whole characters and no NUL; what is behind it is in its place."""
    got: list[bytes] = []
    types, text = TypeStore.bundled("jazzy"), "\0ü" + "x" * length
    with closing(open_backend("memory", types, "cell", domain=92)) as backend:
        backend.subscribe(TOPIC, TYPE, Qos(), lambda payload, _: got.append(payload))
        status = TopicStatus(topic="/a", type_name=INT, direction=Direction.TO_PLC, problem=text, reason=text)
        Diagnostics(types, backend).publish(BridgeStatus("cell", "memory", running=True, topics=(status,)))
        wait_for(lambda: got)
    sent: Any = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(got[0], TYPE)
    cut = (" ü" + "x" * length).encode()[:240].decode(errors="ignore")
    assert (sent.status[1].message, sent.status[1].values[-1].value) == (cut, cut)


def test_ros1_reads_it_too() -> None:
    """Without CDR's boundaries, for the types of ROS 1."""
    got: list[bytes] = []
    types = TypeStore.bundled("noetic")
    with closing(open_backend("memory", types, "cell", domain=92)) as backend:
        backend.subscribe(TOPIC, TYPE, Qos(), lambda payload, _: got.append(payload))
        status = TopicStatus(topic="/a", type_name=INT, direction=Direction.TO_ROS, problem="odd")
        Diagnostics(types, backend).publish(BridgeStatus("cell", "memory", running=True, topics=(status,)))
        wait_for(lambda: got)
    sent: Any = get_typestore(Stores.ROS1_NOETIC).deserialize_ros1(got[0], TYPE)
    assert [one.name for one in sent.status] == ["rosplc: cell", "rosplc: cell: /a"]
    assert (sent.status[1].level, sent.status[1].message) == (2, "odd")
    assert sent.status[1].values[-1].key == "reason"


def test_a_change_is_in_the_next_diagnostics(cell: Cell) -> None:
    """Each number and word that a stream reports is in what is published after it has changed."""
    topics = f"  /in: {{type: {INT}, to: plc, stale_after: 1h}}\n  /out: {{type: {INT}, to: ros}}\n"
    bridge = cell.start(topics)
    messages = cell.listen(TOPIC, TYPE)
    assert bridge.backend is not None
    sender = Diagnostics(TypeStore.bundled("jazzy"), bridge.backend)

    def told(topic: str) -> dict[str, str]:
        count = len(messages)
        sender.publish(bridge.status())
        wait_for(lambda: len(messages) > count)
        status = statuses(messages[count:])[f"rosplc: cell: {topic}"]
        return {pair.key: pair.value for pair in status.values} | {"message": status.message}

    for stream in bridge._streams:
        assert isinstance(stream, Stream)
        topic = stream.plan.topic
        for number, name in enumerate(vars(stream.counters), 5):
            assert told(topic)[name] != str(number)
            setattr(stream.counters, name, number)
            assert told(topic)[name] == str(number)
        for name, key, values in (
            ("_rate", "rate [Hz]", (12.5, 13.5)),
            ("peer_alive", "PLC alive", (True, False)),
        ):
            for value in values:

                def shown(name: str = name, key: str = key, value: object = value) -> bool:
                    setattr(stream if name == "_rate" else stream.port, name, value)  # noqa: B023 - called at once
                    return told(topic)[key] == str(value)  # noqa: B023 - called at once

                wait_for(shown)  # the heartbeat sets it again each second
        stream.note(stream._now(), "something else", "COD001")
        assert (told(topic)["reason"], told(topic)["message"]) == ("something else", "something else")
        stream.problem = "it broke"
        assert told(topic)["message"] == "it broke"
        stream.problem = ""
        assert told(topic)["message"] == "something else"
    assert told("/in")["age"] == "never"
    publisher = cell.publisher("/in", INT)
    wait_for(lambda: told("/in")["matched"] == "1")
    publisher.write(wire(INT, {"data": 1}))
    wait_for(lambda: told("/in")["received"] == "6")
    assert told("/in")["age"].endswith(" s")
    publisher.close()
    wait_for(lambda: told("/in")["matched"] == "0")
