"""Another configuration for a running bridge: what changes, what is not disturbed, what is refused."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rosplc.bridge import Bridge
from rosplc.config import ConfigErrors, parse_config, read_config
from rosplc.errors import BackendError, ChannelError
from rosplc.ros import Qos
from rosplc.ros.memory import MemoryBackend, open_backend
from rosplc.shm import Namespace
from rosplc.shm.files import NameLock, Rights
from tests.lib.waiting import wait_for
from tests.unit.bridge.conftest import BOTH, DOMAIN, INT, STORE, STRING, Cell, numbers, wire

pytestmark = pytest.mark.verifies("configuration", own="rosplc alone")


def reload(cell: Cell, topics: str, **arguments: Any) -> str:
    """Reload the cell's bridge with other topics; return what has changed, in words."""
    assert cell.bridge is not None
    return str(cell.bridge.reload(parse_config(cell.config(topics, **arguments))))


def objects(namespace: Namespace) -> set[str]:
    """Return the topics of the objects that stand."""
    return {found[0] for name in namespace.topics() if (found := namespace.name_of(name)) is not None}


def test_topics_come_and_go(cell: Cell) -> None:
    """An added topic is carried, a removed one's object is retired; both without a restart."""
    bridge = cell.start(BOTH)
    leaving = cell.plc("/in")
    said = reload(cell, f"  /out: {{type: {INT}, to: ros}}\n  /new: {{type: {INT}, to: plc}}\n")
    assert said == "added /new; removed /in; topics unchanged: 1"
    assert objects(cell.namespace) == {"/out", "/new"}
    with pytest.raises(ChannelError, match="SHM111"):
        leaving.attached.valid()
    new = cell.plc("/new")
    cell.publisher("/new", INT).write(wire(INT, {"data": 7}))
    assert wait_for(new.read) == {"data": 7}
    assert [topic.topic for topic in bridge.status().topics] == ["/out", "/new"]
    assert not cell.peer.graph().topics.get("/in")


def test_what_is_the_same_is_not_disturbed(cell: Cell) -> None:
    """While topics are added and removed around it, a topic loses nothing and keeps its object."""
    # Slots for all: what a busy machine cannot take in time would be lost without a reload, too.
    both = BOTH.replace("to: ros", "to: ros, slots: 16384")
    bridge = cell.start(both)
    incoming, outgoing = cell.plc("/in"), cell.plc("/out")
    received = cell.listen("/out", INT)
    publisher = cell.publisher("/in", INT)
    stop, sent, taken = threading.Event(), [0], []

    def flow() -> None:
        while not stop.wait(0.002):
            sent[0] += 1
            outgoing.write({"data": sent[0]})
            publisher.write(wire(INT, {"data": sent[0]}))
            while (message := incoming.read(in_order=True)) is not None:
                taken.append(message["data"])

    thread = threading.Thread(target=flow)
    thread.start()
    try:
        for turn in range(10):
            extra = f"  /more{turn}: {{type: {INT}, to: {'plc' if turn % 2 else 'ros'}}}\n"
            reload(cell, both + extra)
    finally:
        stop.set()
        thread.join()
    wait_for(lambda: len(received) >= sent[0])
    assert numbers(received) == list(range(1, sent[0] + 1))
    assert taken == sorted(set(taken))
    assert incoming.attached.still_there()
    incoming.attached.valid()
    status = bridge.status()
    assert (status.topic("/in").received, status.topic("/in").lost) == (sent[0], 0)


@pytest.mark.parametrize(
    "extra", ["qos: {depth: 5}", "rate_limit: 1ms", "on_change: true", "stale_after: 3s"]
)
def test_a_change_of_manner_keeps_the_object(cell: Cell, extra: str) -> None:
    """Quality of service, rates and the like change under the PLC's feet without it noticing."""
    cell.start(BOTH)
    incoming = cell.plc("/in")
    assert reload(cell, BOTH.replace("to: plc", f"to: plc, {extra}")).startswith("changed /in")
    incoming.attached.valid()
    cell.publisher("/in", INT).write(wire(INT, {"data": 3}))
    assert wait_for(incoming.read) == {"data": 3}


def restart(cell: Cell, topics: str) -> None:
    cell.stop()
    cell.start(topics)


@pytest.mark.parametrize("change", [reload, restart])
def test_a_changed_layout_retires_the_old_object(cell: Cell, change: Callable[[Cell, str], object]) -> None:
    """A PLC with the old layout is told at its next call, and the new object takes its place."""
    cell.start(f"  /text: {{type: {STRING}, to: plc, limits: {{data: 4}}}}\n")
    old = cell.plc("/text")
    change(cell, f"  /text: {{type: {STRING}, to: plc, limits: {{data: 8}}}}\n")
    with pytest.raises(ChannelError, match="SHM111"):
        old.attached.valid()
    new = cell.plc("/text")
    cell.publisher("/text", STRING).write(wire(STRING, {"data": "12345678"}))
    assert wait_for(new.read) == {"data": "12345678"}


def test_a_turned_topic(cell: Cell) -> None:
    """A topic may change its direction."""
    cell.start(BOTH)
    reload(cell, BOTH.replace("to: plc", "to: ros"))
    received = cell.listen("/in", INT)
    cell.plc("/in").write({"data": 5})
    wait_for(lambda: numbers(received) == [5])


def test_what_the_plc_wrote_before_is_passed_on(cell: Cell) -> None:
    """Messages that wait in a removed topic's object, for their time, are not forgotten."""
    cell.start(f"  /out: {{type: {INT}, to: ros, rate_limit: 1h}}\n")
    received = cell.listen("/out", INT)
    outgoing = cell.plc("/out")
    for number in (1, 2):
        outgoing.write({"data": number})
    wait_for(lambda: numbers(received) == [1])
    reload(cell, "  {}\n")
    wait_for(lambda: numbers(received) == [1, 2])
    assert not objects(cell.namespace)


def test_a_topic_that_leaves_says_no_substitute(cell: Cell) -> None:
    """Nothing is put in a silent PLC's place because its topic is removed or changed."""
    topic = (
        f"  /out: {{type: {INT}, to: ros, stale_after: 1h, on_stale: {{value: {{data: 77}}, period: 1s}}}}\n"
    )
    bridge = cell.start(topic)
    received = cell.listen("/out", INT)
    cell.plc("/out").write({"data": 1})
    wait_for(lambda: numbers(received) == [1])
    reload(cell, topic.replace("1h", "2h"))
    cell.plc("/out").write({"data": 2})
    wait_for(lambda: numbers(received) == [1, 2])
    reload(cell, "  {}\n")
    bridge.stop()
    assert numbers(received) == [1, 2]


def test_the_end_drops_no_message_that_waits(cell: Cell) -> None:
    """What a rate limit holds back is sent when the bridge ends: the last message is never dropped."""
    bridge = cell.start(f"  /out: {{type: {INT}, to: ros, rate_limit: 1h}}\n")
    received = cell.listen("/out", INT)
    outgoing = cell.plc("/out")
    outgoing.write({"data": 1})
    wait_for(lambda: numbers(received) == [1])
    outgoing.write({"data": 2})
    wait_for(lambda: bridge.status().topic("/out").received == 2)
    bridge.stop()
    wait_for(lambda: numbers(received) == [1, 2])


def test_classic_topics_come_change_and_go(cell: Cell) -> None:
    """A topic becomes classic and a channel again; its memory stays where a classic project expects it."""
    name = f"{cell.namespace.prefix}_classic"
    cell.start(BOTH)
    channel = cell.plc("/in")
    classic = BOTH.replace("to: plc", f"to: plc, classic: {{name: {name}}}")
    try:
        reload(cell, classic)
        with pytest.raises(ChannelError, match="SHM111"):
            channel.attached.valid()
        cell.publisher("/in", INT).write(wire(INT, {"data": 9}))
        wait_for(lambda: Path(f"/dev/shm/{name}").read_bytes()[:4] == b"\x09\0\0\0")
        reload(cell, BOTH)
        cell.plc("/in").attached.valid()
    finally:
        for path in Path("/dev/shm").glob(f"*{name}*"):
            path.unlink()


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("beat: 20ms", "beat: 30ms", ":6: beat"),
        ("domain: 41", "domain: 42", ":3: ros.domain"),
        ("period: 100ms", "period: 200ms", ":4: diagnostics.period"),
        ("bridge: cell", "bridge: other", ":1: bridge"),
    ],
)
def test_keys_that_cannot_change(tmp_path: Path, cell: Cell, old: str, new: str, key: str) -> None:
    """A file that changes such a key is refused as a whole, with file, line and key; all runs on."""
    path = tmp_path / "rosplc.yaml"
    text = cell.config(BOTH).replace("beat: 20ms\n", "").replace("topics:", "beat: 20ms\ntopics:")
    path.write_text(text)
    cell.bridge = bridge = Bridge(read_config(path))
    bridge.start()
    path.write_text(text.replace(old, new) + f"  /new: {{type: {INT}, to: plc}}\n")
    with pytest.raises(ConfigErrors, match="CFG012") as found:
        bridge.reload()
    assert str(found.value.where) == f"{path}{key}"
    assert objects(cell.namespace) == {"/in", "/out"}
    note = bridge.status().notes[0]
    assert "refused" in note
    assert f"{path}{key}" in note
    path.write_text(text)
    assert not bridge.reload()
    assert bridge.status().notes == ()


def test_a_broken_file_changes_nothing(tmp_path: Path, cell: Cell, caplog: pytest.LogCaptureFixture) -> None:
    """What is wrong is logged, every error with its line; the topics are carried on."""
    path = tmp_path / "rosplc.yaml"
    path.write_text(cell.config(BOTH))
    cell.bridge = bridge = Bridge(read_config(path))
    bridge.start()
    incoming = cell.plc("/in")
    path.write_text(
        cell.config(f"  /in: {{type: {INT}, too: plc}}\n  /b: {{type: nope/msg/Nope, to: plc}}\n")
    )
    with caplog.at_level(logging.ERROR), pytest.raises(ConfigErrors):
        bridge.reload()
    assert f"{path}:8: topics./in.too" in caplog.text
    cell.publisher("/in", INT).write(wire(INT, {"data": 1}))
    assert wait_for(incoming.read) == {"data": 1}
    assert "and 1 more" in bridge.status().notes[0]
    assert "refused" in bridge.status().judgement[1]


def test_a_name_that_is_taken_refuses_all(cell: Cell) -> None:
    """If an added topic's name is another bridge's, the others are not added either, and nothing is left."""
    bridge = cell.start(BOTH)
    lock = NameLock(cell.namespace.lock_path("/b"), Rights())
    more = f"  /a: {{type: {INT}, to: plc}}\n  /b: {{type: {INT}, to: plc}}\n"
    with pytest.raises(ChannelError, match="SHM116"):
        reload(cell, BOTH + more)
    assert objects(cell.namespace) == {"/in", "/out"}
    assert [topic.topic for topic in bridge.status().topics] == ["/in", "/out"]
    lock.release()
    assert reload(cell, BOTH + more).startswith("added /a, /b")


def test_what_fails_half_way_is_undone(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """If a changed topic cannot be opened, those that were let go of are carried again as before."""
    bridge = cell.start(BOTH)
    received = cell.listen("/out", INT)
    subscribe = MemoryBackend.subscribe

    def refuse(self: MemoryBackend, topic: str, type_name: str, qos: Qos, on_message: Any) -> Any:
        if type_name == STRING:
            raise BackendError("ROS002", "not today", where=topic)
        return subscribe(self, topic, type_name, qos, on_message)

    monkeypatch.setattr(MemoryBackend, "subscribe", refuse)
    changed = BOTH.replace(f"/in: {{type: {INT}", f"/in: {{type: {STRING}").replace(
        "to: ros", "to: ros, slots: 64"
    )
    with pytest.raises(BackendError, match="not today"):
        reload(cell, changed + f"  /a: {{type: {INT}, to: plc}}\n")
    assert objects(cell.namespace) == {"/in", "/out"}
    incoming = cell.plc("/in")
    cell.publisher("/in", INT).write(wire(INT, {"data": 4}))
    assert wait_for(incoming.read) == {"data": 4}
    cell.plc("/out").write({"data": 5})
    wait_for(lambda: numbers(received) == [5])
    assert "ROS002" in bridge.status().notes[0]


def test_new_types_and_changed_definitions(tmp_path: Path, cell: Cell) -> None:
    """A type that the file brings with it is carried; one that is in use may not become another."""
    folder = tmp_path / "own_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "One.msg").write_text("int32 a\n")
    cell.start(BOTH)
    types = f"types: {{paths: [{tmp_path / 'own_msgs'}]}}"
    topics = BOTH + "  /one: {type: own_msgs/msg/One, to: plc}\n"
    assert reload(cell, topics, more=types).startswith("added /one")
    (folder / "One.msg").write_text("int32 a\nint32 b\n")
    with pytest.raises(ConfigErrors, match="definition of own_msgs/msg/One"):
        reload(cell, topics, more=types)


def test_a_removed_topic_is_not_made_again(cell: Cell) -> None:
    """The check that looks after objects knows nothing of topics that have left."""
    bridge = cell.start(BOTH)
    for _ in range(5):
        reload(cell, BOTH.splitlines(keepends=True)[0])
        reload(cell, BOTH)
    reload(cell, BOTH.splitlines(keepends=True)[0])
    for now in range(3):
        bridge.check(now)
    assert objects(cell.namespace) == {"/in"}


def test_only_a_running_bridge_reloads(cell: Cell) -> None:
    """Before the start, and for a configuration that was not read from a file, there is nothing to reload."""
    bridge = cell.make(BOTH)
    with pytest.raises(RuntimeError, match="not been started"):
        bridge.reload()
    cell.bridge = bridge
    bridge.start()
    with pytest.raises(RuntimeError, match="was not read from a file"):
        bridge.reload()


def test_a_backend_that_ends(cell: Cell, caplog: pytest.LogCaptureFixture) -> None:
    """A ROS side that was told to leave is reported once, to the log, the status and the one that asked."""
    backend = open_backend(STORE, "leaving", domain=DOMAIN)
    bridge = Bridge(parse_config(cell.config(BOTH)), backend)
    told: list[str] = []
    bridge.on_ended = told.append
    cell.bridge = bridge
    bridge.start()
    backend.ended = "somebody told node /leaving to shut down"  # type: ignore[attr-defined]
    wait_for(lambda: told)
    assert "shut down" in bridge.status().judgement[1]
    bridge.ask(0)
    assert told == ["somebody told node /leaving to shut down"]
    assert caplog.text.count("the bridge no longer carries messages [ROS015]") == 1
    bridge.stop()
    backend.close()
