"""What is on /diagnostics, decoded by an independent library."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from rosplc.bridge import diagnostics
from rosplc.bridge.diagnostics import TOPIC, TYPE, Diagnostics
from rosplc.bridge.status import BridgeStatus
from rosplc.model import TypeStore
from rosplc.ros import Qos, open_backend
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
    assert "data: string has 8 bytes, the limit is 3" in text.message
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
    assert "ago from ROS publisher" in statuses(messages)["rosplc: cell: /in"].message


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


def test_what_has_not_changed_is_sent_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A status keeps its words when the one before it has become longer, and so has another place."""
    got: list[bytes] = []
    entry = {"level": 1, "name": "a", "message": "m", "hardware_id": "cell"}
    entries = [entry, {**entry, "name": "b", "values": {"reason": "none"}}]
    monkeypatch.setattr(diagnostics, "diagnostic_statuses", lambda _: entries)
    types = TypeStore.bundled("jazzy")
    with closing(open_backend("memory", types, "cell", domain=92)) as backend:
        backend.subscribe(TOPIC, TYPE, Qos(), lambda payload, _: got.append(payload))
        sender = Diagnostics(types, backend)
        for length in range(6):
            entries[0] = {**entry, "values": {"reason": "x" * length}}
            sender.publish(BridgeStatus("cell", "memory", running=True))
            wait_for(lambda: len(got) == length + 1)  # noqa: B023 - called at once
    store = get_typestore(Stores.ROS2_JAZZY)
    for length, payload in enumerate(got):
        sent: Any = store.deserialize_cdr(payload, TYPE)
        first, second = sent.status
        assert (first.name, first.values[0].value) == ("a", "x" * length)
        assert (second.level, second.name, second.values[0].value) == (1, "b", "none")
