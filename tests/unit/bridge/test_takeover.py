"""What a bridge finds when it starts, and what one that was stopped finds when it is resumed."""

from __future__ import annotations

import fcntl
import os
import threading
from typing import Any

import pytest

from rosplc.bridge import Bridge, Level, port
from rosplc.bridge.hold import OnChange
from rosplc.bridge.stream import ToRos
from rosplc.config import parse_config
from rosplc.errors import BackendError, ChannelError
from rosplc.ros import Qos
from rosplc.ros.lifecycle import LifecycleBackend
from rosplc.ros.memory import MemoryBackend, open_backend
from tests.lib.waiting import wait_for
from tests.unit.bridge.conftest import BOTH, DOMAIN, INT, STORE, STRING, Cell, numbers, wire

OUT = f"  /out: {{type: {INT}, to: ros, slots: 64}}\n"


def pause(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Keep a bridge's threads from doing anything, as SIGSTOP does, until the event is set."""
    go_on, paused = threading.Event(), threading.Event()
    assert bridge._carriers is not None

    def poll(_due: int | None) -> None:
        paused.set()
        go_on.wait(60)

    for stream in bridge._streams:
        ports, check = bridge._carriers.of(stream.plan).ports, stream.check
        monkeypatch.setattr(ports, "poll", poll)
        monkeypatch.setattr(
            stream, "check", lambda now_ns, check=check: go_on.is_set() and bool(check(now_ns))
        )
        ports.wake()
        assert paused.wait(60)
        paused.clear()
    own, beat = [stream.port for stream in bridge._streams], port.beat
    others = lambda users: [user for user in users if all(user is not port.user for port in own)]  # noqa: E731
    monkeypatch.setattr(port, "beat", lambda users: beat(others(users)))
    return go_on


@pytest.mark.parametrize("entry", ["", ", rate_limit: 1ms"], ids=["at once", "held back"])
def test_a_resumed_bridge_repeats_nothing(cell: Cell, monkeypatch: pytest.MonkeyPatch, entry: str) -> None:
    """Its lock files were removed and another bridge carries its topics: it notices before it sends."""
    topics = OUT.replace("}", entry + "}")
    first = cell.start(topics)
    messages = cell.listen("/out", INT)
    plc = cell.plc("/out")
    plc.write({"data": 1})
    wait_for(lambda: len(messages) == 1)
    go_on = pause(first, monkeypatch)
    plc.write({"data": 2})  # what the first may still take is taken again by the second
    cell.namespace.lock_path("/out").unlink()
    second = Bridge(parse_config(cell.config(topics)))
    second.start()
    try:
        wait_for(lambda: numbers(messages)[-1:] == [2])
        plc.write({"data": 3})
        wait_for(lambda: numbers(messages)[-1:] == [3])
        go_on.set()
        wait_for(lambda: "SHM116" in first.status().topic("/out").problem)
        plc.write({"data": 4})
        wait_for(lambda: numbers(messages)[-1:] == [4])
        wait_for(lambda: second.status().topic("/out").published >= 3)
    finally:
        second.stop()
    assert numbers(messages) == [1, 2, 3, 4]


def test_only_the_bridge_that_carries_a_topic_advertises_it(cell: Cell) -> None:
    """What the other one retains is not for late subscribers; it is back once the topic is its own again."""
    first = cell.start(OUT)
    listener = open_backend(STORE, "listener", domain=DOMAIN)

    def publishers() -> int:
        return [found.topic for found in listener.graph().endpoints].count("/out")

    assert publishers() == 1
    cell.namespace.lock_path("/out").unlink()
    with Bridge(parse_config(cell.config(OUT))):
        assert publishers() == 2
        wait_for(lambda: "SHM116" in first.status().topic("/out").problem)
        wait_for(lambda: publishers() == 1)
    wait_for(lambda: publishers() == 1 and not first.status().topic("/out").problem)
    messages = cell.listen("/out", INT)
    cell.plc("/out").write({"data": 1})
    wait_for(lambda: messages)
    listener.close()


@pytest.mark.parametrize("substituting", [False, True])
def test_no_substitutes_while_another_bridge_carries_the_topic(cell: Cell, substituting: bool) -> None:
    """It hears no PLC any more, but the other does, and a substitute would contradict the PLC."""
    entry = ", stale_after: 100ms, on_stale: {value: {data: -7}, period: 20ms}}"
    first = cell.start(OUT.replace("}", entry))
    plc = cell.plc("/out")
    if substituting:
        wait_for(lambda: first.status().topic("/out").substituting)
    cell.namespace.lock_path("/out").unlink()
    with Bridge(parse_config(cell.config(OUT))):
        wait_for(lambda: "SHM116" in first.status().topic("/out").problem)
        stage: Any = first._streams[0].hold.stages[-1]
        before, due = first.status().topic("/out").substituted, stage.due_ns
        messages = cell.listen("/out", INT)
        for number in range(5):  # it becomes due again and again, and comes to nothing
            plc.write({"data": number})
            wait_for(lambda due=due: stage.due_ns > due + 20_000_000)  # type: ignore[misc]
            due = stage.due_ns
        wait_for(lambda: 4 in numbers(messages))
        assert numbers(messages) == list(range(5))
        status = first.status().topic("/out")
        assert (status.substituted, status.substituting) == (before, False)


@pytest.mark.parametrize("kind", ["object", "lock file"])
def test_a_strangers_directory_costs_one_topic(cell: Cell, kind: str) -> None:
    """The topic is not carried and says so, others are; once the directory has gone it is carried."""
    namespace = cell.namespace
    path = namespace.path("/in") if kind == "object" else namespace.lock_path("/in")
    path.mkdir()
    bridge = cell.start(BOTH)
    messages = cell.listen("/out", INT)
    cell.plc("/out").write({"data": 1})
    wait_for(lambda: messages)
    status = bridge.status().topic("/in")
    assert status.judgement[0] is Level.ERROR
    assert "SHM121" in status.problem
    path.rmdir()
    wait_for(lambda: not bridge.status().topic("/in").problem)
    plc = cell.plc("/in")
    cell.publisher("/in", INT).write(wire(INT, {"data": 5}))
    assert wait_for(plc.read) == {"data": 5}


def test_types_that_ros_refuses_change_nothing(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """A start that the ROS side refuses leaves the objects of the bridge before as they were."""
    cell.start(
        f"  /text: {{type: {STRING}, to: plc, limits: {{data: 4}}}}\n  /gone: {{type: {INT}, to: plc}}\n"
    )
    plc = cell.plc("/text")
    cell.stop()

    def refuse(_backend: MemoryBackend, type_name: str) -> None:
        raise BackendError("ROS012", f"{type_name} has a different definition in the installed package")

    with monkeypatch.context() as patch:
        patch.setattr(MemoryBackend, "check", refuse, raising=False)
        with pytest.raises(BackendError, match="ROS012"):
            cell.start(f"  /text: {{type: {STRING}, to: plc, limits: {{data: 8}}}}\n")
    plc.attached.valid()
    assert cell.namespace.path("/gone").exists()


@pytest.mark.parametrize(("entry", "expected"), [("latched: true", [7]), ("", [])])
def test_a_latched_message_outlives_a_restart(cell: Cell, entry: str, expected: list[int]) -> None:
    """Late subscribers get what the object retains, uncounted; only where that is asked for."""
    topics = f"  /out: {{type: {INT}, to: ros, {entry}}}\n  /other: {{type: {INT}, to: ros}}\n"
    bridge = cell.start(topics)
    plc = cell.plc("/out")
    plc.write({"data": 7})
    wait_for(lambda: bridge.status().topic("/out").published == 1)
    cell.stop()
    bridge = cell.start(topics)
    late, other = (
        cell.listen(topic, INT, Qos(durability="transient_local", depth=10)) for topic in ("/out", "/other")
    )
    cell.plc("/other").write({"data": 1})
    wait_for(lambda: other)  # the carrier has looked at both by then
    assert numbers(late) == expected
    plc.write({"data": 8})
    wait_for(lambda: numbers(late) == [*expected, 8])
    assert bridge.status().topic("/out").received == 1


def test_a_message_written_while_a_bridge_starts_is_sent_once(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is new, and no more what the bridge before has left."""
    topics = f"  /out: {{type: {INT}, to: ros, latched: true}}\n"
    bridge = cell.start(topics)
    plc = cell.plc("/out")
    plc.write({"data": 1})
    wait_for(lambda: bridge.status().topic("/out").published == 1)
    cell.stop()
    messages = cell.listen("/out", INT)
    begin = ToRos.begin

    def write_first(stream: ToRos, now_ns: int) -> None:
        plc.write({"data": 2})
        begin(stream, now_ns)

    monkeypatch.setattr(ToRos, "begin", write_first)
    cell.start(topics)
    wait_for(lambda: messages)
    plc.write({"data": 3})
    wait_for(lambda: numbers(messages)[-1] == 3)
    assert numbers(messages) == [2, 3]


@pytest.mark.parametrize(("newer", "expected"), [([], 7), ([8, 9], 9)])
def test_a_latched_message_comes_when_an_inactive_node_becomes_active(
    cell: Cell, newer: list[int], expected: int
) -> None:
    """Activation publishes the newest message once; one from before the start is in no counter."""
    topics = f"  /out: {{type: {INT}, to: ros, latched: true}}\n"
    bridge = cell.start(topics)
    plc = cell.plc("/out")
    plc.write({"data": 7})
    wait_for(lambda: bridge.status().topic("/out").published == 1)
    cell.stop()
    gate = LifecycleBackend(open_backend(STORE, "node", domain=DOMAIN))
    bridge = cell.bridge = Bridge(parse_config(cell.config(topics)), gate)
    bridge.start()

    def counts() -> tuple[int, int, int]:
        status = bridge.status().topic("/out")
        return status.received, status.published, status.lost

    late = cell.listen("/out", INT, Qos(durability="transient_local", depth=10))
    for value in newer:
        plc.write({"data": value})
    wait_for(lambda: counts() == (len(newer), 0, max(0, len(newer) - 1)))
    assert not late
    gate.activate()
    wait_for(lambda: late)
    plc.write({"data": 10})
    wait_for(lambda: len(late) > 1)
    assert numbers(late) == [expected, 10]
    wait_for(lambda: counts() == (len(newer) + 1, 1 + bool(newer), max(0, len(newer) - 1)))
    gate.close()


def test_messages_of_the_time_without_a_bridge_are_told_apart(cell: Cell) -> None:
    """The first warning tells how long no bridge was running and how many messages that cost."""
    topics = f"  /out: {{type: {INT}, to: ros, slots: 4}}\n"
    bridge = cell.start(topics)
    messages = cell.listen("/out", INT)
    plc = cell.plc("/out")
    plc.write({"data": 0})
    wait_for(lambda: messages)
    cell.stop()
    lock = cell.namespace.lock_path("/out")
    os.utime(lock, ns=(lock.stat().st_atime_ns, lock.stat().st_mtime_ns - 90_000_000_000))
    for number in range(1, 11):
        plc.write({"data": number})
    bridge = cell.start(topics)
    reason = wait_for(lambda: bridge.status().topic("/out").reason)
    assert reason.startswith("no bridge was running for 9")
    assert reason.endswith(" s: 7 messages were not carried")
    for number in range(11, 13):
        plc.write({"data": number})
    wait_for(lambda: numbers(messages)[-1] == 12)
    assert bridge.status().topic("/out").lost == 7


def test_a_strangers_lock_is_not_called_a_bridge(cell: Cell) -> None:
    """What holds the lock is named by its process; only the process that an object names is a bridge."""
    path = cell.namespace.lock_path("/in")
    path.touch(0o660)
    with path.open("r+b") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(ChannelError) as refused:
            cell.start(BOTH)
    assert f"process {os.getpid()} (" in refused.value.what
    assert "bridge" not in refused.value.what


def test_on_change_after_another_object_begins_again(cell: Cell) -> None:
    """A new object has no message that could be unchanged."""
    bridge = cell.start(f"  /in: {{type: {INT}, to: plc, on_change: true}}\n")
    publisher = cell.publisher("/in", INT)
    publisher.write(wire(INT, {"data": 1}))
    wait_for(lambda: bridge.status().topic("/in").published == 1)
    cell.namespace.path("/in").unlink()
    wait_for(lambda: cell.namespace.path("/in").exists() and not bridge.status().topic("/in").problem)
    stages: list[Any] = bridge._streams[0].hold.stages
    wait_for(lambda: all(stage.last is None for stage in stages if isinstance(stage, OnChange)))
    publisher.write(wire(INT, {"data": 1}))
    wait_for(lambda: bridge.status().topic("/in").published == 2)


def test_a_given_backend_that_can_check_types_is_asked(cell: Cell) -> None:
    """The types are asked about before anything is opened."""
    backend = open_backend(STORE, "mine", domain=DOMAIN)
    asked: list[str] = []
    backend.check = asked.append  # type: ignore[attr-defined]
    with Bridge(parse_config(cell.config(BOTH)), backend):
        assert asked == [INT]
    backend.close()
