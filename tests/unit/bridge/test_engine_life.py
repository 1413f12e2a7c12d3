"""A running bridge: who may start, stop, fail or vanish, and what survives it."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from rosplc._core import Fault
from rosplc.bridge import Bridge, Level
from rosplc.bridge.carrier import Carriers
from rosplc.bridge.channel import ChannelPort, ChannelsToRos
from rosplc.bridge.port import Context
from rosplc.bridge.stream import Stream, ToPlc, ToRos
from rosplc.config import parse_config, read_config, resolve
from rosplc.errors import BackendError, ChannelError, ConfigError
from rosplc.ros import LATCHED, Qos
from rosplc.ros.memory import MemoryBackend, MemoryPublisher, MemorySubscription, open_backend
from rosplc.shm import Namespace, OwnedChannel, attach
from rosplc.shm.constants import IDENTITY, STATE_RETIRED
from tests.lib.clock import SteppedClock
from tests.lib.waiting import repeat_until, wait_for
from tests.unit.bridge.conftest import BOTH, DOMAIN, INT, STORE, STRING, Cell, numbers, wire


def test_a_restart_adopts_and_goes_on(cell: Cell) -> None:
    """An attached PLC notices no restart; what it wrote meanwhile is sent once, nothing twice."""
    topics = BOTH.replace("to: ros", "to: ros, slots: 16")
    cell.start(topics)
    messages = cell.listen("/out", INT)
    incoming, outgoing = cell.plc("/in"), cell.plc("/out")
    publisher = cell.publisher("/in", INT)
    publisher.write(wire(INT, {"data": 1}))
    assert wait_for(incoming.read) == {"data": 1}
    outgoing.write({"data": 10})
    wait_for(lambda: len(messages) == 1)
    cell.stop()
    assert incoming.attached.snapshot().writer.epoch == 0, "a clean stop gives the claim back"
    outgoing.write({"data": 11})
    outgoing.write({"data": 12})
    bridge = cell.start(topics)
    assert all(stream.port.adopted for stream in bridge._streams)
    wait_for(lambda: len(messages) == 3)
    publisher.write(wire(INT, {"data": 2}))
    assert wait_for(incoming.read) == {"data": 2}
    incoming.attached.valid()
    outgoing.write({"data": 13})
    wait_for(lambda: len(messages) == 4)
    assert numbers(messages) == [10, 11, 12, 13]


def test_two_bridges_on_one_name(cell: Cell) -> None:
    """The second is refused before it disturbs anything, even where layouts or topics differ."""
    cell.start(BOTH)
    plc = cell.plc("/in")
    other = cell.make(f"  /a: {{type: {INT}, to: plc}}\n  /in: {{type: {STRING}, to: plc}}\n", name="other")
    with pytest.raises(ChannelError, match=rf"bridge cell, process {os.getpid()}, holds /in \[SHM116\]"):
        other.start()
    assert not other.status().running
    assert not cell.namespace.path("/a").exists()
    cell.publisher("/in", INT).write(wire(INT, {"data": 5}))
    assert wait_for(plc.read) == {"data": 5}
    cell.stop()
    other.start()
    other.stop()


def test_topics_that_left_the_configuration_are_retired(cell: Cell, shm_namespace: Namespace) -> None:
    """Objects of this bridge that nobody carries any more are removed; those of others stay.

    A name that is too long for an object is shortened, and tells nothing of the topic.
    """
    long, theirs = f"/{'out' * 30}", ("/theirs", f"/{'theirs' * 20}")
    cell.start(BOTH + f"  {long}: {{type: {INT}, to: ros}}\n")
    plc = cell.plc("/out")
    cell.stop()
    with cell.make("".join(f"  {topic}: {{type: {INT}, to: plc}}\n" for topic in theirs), name="other"):
        pass
    assert "~" in shm_namespace.path(long).name
    assert shm_namespace.path(long).exists()
    cell.start(f"  /in: {{type: {INT}, to: plc}}\n")
    assert not shm_namespace.path("/out").exists()
    assert not shm_namespace.path(long).exists()
    assert all(shm_namespace.path(topic).exists() for topic in theirs)
    with pytest.raises(ChannelError, match="SHM111"):
        plc.attached.valid()


@pytest.mark.parametrize("topic", ["/in", "/out"])
def test_a_removed_object_is_created_again(cell: Cell, topic: str) -> None:
    """Somebody empties /dev/shm: within a second or so both directions work again."""
    bridge = cell.start(BOTH)
    messages = cell.listen("/out", INT)
    publisher = cell.publisher("/in", INT)
    path = cell.namespace.path(topic)
    path.unlink()
    wait_for(path.exists)
    assert wait_for(lambda: bridge.status().topic(topic).code) == "SHM120"
    incoming, outgoing = cell.plc("/in"), cell.plc("/out")
    wait_for(lambda: incoming.attached.snapshot().writer.epoch, "the bridge to claim the new object")
    publisher.write(wire(INT, {"data": 6}))
    assert wait_for(incoming.read) == {"data": 6}
    outgoing.write({"data": 7})
    wait_for(lambda: messages)
    assert numbers(messages) == [7]


@pytest.mark.parametrize("topic", ["/in", "/out"])
@pytest.mark.parametrize("word", ["state", "magic", "slot_stride", "layout_id_lo"])
def test_a_damaged_object_is_created_again(cell: Cell, topic: str, word: str) -> None:
    """A foreign hand on the identity costs messages, not the topic."""
    bridge = cell.start(BOTH)
    messages = cell.listen("/out", INT)
    publisher = cell.publisher("/in", INT)
    with attach(cell.namespace, topic, write=True) as found:
        generation = found.identity.generation
        found.region.store(IDENTITY[word], STATE_RETIRED)
    wait_for(lambda: bridge.status().topic(topic).recent)

    def replaced() -> bool:
        try:
            with attach(cell.namespace, topic) as found:
                return found.identity.generation != generation
        except ChannelError:
            return False

    wait_for(replaced)
    incoming, outgoing = cell.plc("/in"), cell.plc("/out")
    wait_for(lambda: incoming.attached.snapshot().writer.epoch)
    publisher.write(wire(INT, {"data": 8}))
    assert wait_for(incoming.read) == {"data": 8}
    outgoing.write({"data": 9})
    wait_for(lambda: messages)
    assert not bridge.status().topic(topic).problem


@pytest.mark.parametrize("topic", ["/in", "/out"])
def test_a_message_into_a_retired_object_is_noticed_at_once(cell: Cell, topic: str) -> None:
    """The first user of the object finds out, counts the message or reports, and it is opened again."""
    bridge = cell.start(BOTH, more="tick: 500ms")
    messages = cell.listen("/out", INT)
    publisher, outgoing = cell.publisher("/in", INT), cell.plc("/out")
    outgoing.write({"data": 1})
    with attach(cell.namespace, topic, write=True) as found:
        found.region.store(IDENTITY["state"], STATE_RETIRED)
    publisher.write(wire(INT, {"data": 2}))
    wait_for(lambda: bridge.status().topic(topic).code in ("SHM111", "SHM120"))
    if topic == "/in":
        assert bridge.status().topic("/in").lost == 1
    wait_for(lambda: not bridge.status().topic(topic).problem)

    def arrives() -> bool:
        publisher.write(wire(INT, {"data": 3}))
        try:
            cell.plc("/out").write({"data": 4})
        except ChannelError:
            return False
        return bool(messages) and numbers(messages)[-1] == 4 and bridge.status().topic("/in").published > 1

    wait_for(arrives)


def test_a_record_that_cannot_be_encoded_is_refused(cell: Cell) -> None:
    """A fault of the encoder is counted and explained like any other."""
    bridge = cell.start(BOTH)
    bridge._streams[1].refuse(Fault(9, 0xFFFFFFFF, 3, 4), time.monotonic_ns())
    status = bridge.status().topic("/out")
    assert (status.refused, status.published) == (1, 0)
    assert status.code == "COD009"


@pytest.mark.parametrize("topic", ["/in", "/out"])
def test_an_object_that_cannot_be_made_is_tried_again(
    cell: Cell, topic: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A full /dev/shm is an error of the topic for as long as it lasts, and logged once."""
    clock = SteppedClock()
    bridge = cell.start(BOTH, clock=clock)

    def full(*_: object, **__: object) -> None:
        raise ChannelError("SHM117", "no space left")

    with monkeypatch.context() as patch:
        patch.setattr(OwnedChannel, "open", full)
        cell.namespace.path(topic).unlink()
        repeat_until(lambda: clock.step(1), lambda: "SHM117" in bridge.status().topic(topic).problem)
        assert bridge.status().topic(topic).judgement[0] is Level.ERROR
        cell.publisher("/in", INT).write(wire(INT, {"data": 1}))
        if topic == "/in":
            wait_for(lambda: bridge.status().topic("/in").lost == 1)
        for _ in range(3):
            clock.step(1)
    assert caplog.text.count("no space left") == 1
    repeat_until(lambda: clock.step(1), lambda: not bridge.status().topic(topic).problem)
    assert cell.namespace.path(topic).exists()


def test_an_object_reopened_during_its_check_is_no_problem(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The carrier may open an object again while the heartbeat looks after it; no error stays behind."""
    clock = SteppedClock()
    bridge = cell.start(f"  /out: {{type: {INT}, to: ros}}\n", clock=clock)
    (stream,) = bridge._streams
    port = stream.port
    assert isinstance(port, ChannelPort)
    look = OwnedChannel.still_there
    done: list[OwnedChannel] = []

    def still_there(channel: OwnedChannel) -> bool:
        found = look(channel)
        if not done:
            done.append(channel)
            port.channel = None  # as the carrier does first
        return found

    monkeypatch.setattr(OwnedChannel, "still_there", still_there)
    repeat_until(lambda: clock.step(1), lambda: done)
    port.channel = done[0]
    clock.step(1)  # a check more
    assert not stream.problem


def test_a_beat_into_an_object_just_closed_costs_no_other(cell: Cell) -> None:
    """Whatever is closed at the moment of a beat, the other topics beat."""
    bridge = cell.start(BOTH)
    for stream in bridge._streams:
        assert isinstance(stream.port, ChannelPort)
        assert stream.port.channel is not None
        stream.port.channel.region.close()
    stream.context.beat()


def test_a_failed_start_leaves_nothing_open(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """If ROS refuses the second topic, names, node and claims are free again."""
    bridge = cell.make(BOTH)

    def refuse(*_: object) -> None:
        raise BackendError("ROS002", "no")

    with monkeypatch.context() as patch:
        patch.setattr(MemoryBackend, "advertise", refuse)
        with pytest.raises(BackendError, match="ROS002"):
            bridge.start()
    assert cell.peer.graph().nodes == ()
    assert not bridge.status().running
    bridge.start()
    bridge.stop()
    cell.start(BOTH)


def test_one_topics_trouble_is_no_others(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """A publisher that fails, even with an unforeseen error, keeps no other topic from being carried."""
    topics = "".join(f"  /out{i}: {{type: {INT}, to: ros}}\n" for i in range(3))
    bridge = cell.start(topics)
    messages = cell.listen("/out2", INT)
    write = MemoryPublisher.write

    def sometimes(self: MemoryPublisher, payload: bytes, stamp_ns: int | None = None) -> bool:
        if self.topic == "/out0":
            raise RuntimeError("a mistake in a backend")
        return self.topic != "/out1" and write(self, payload, stamp_ns)

    monkeypatch.setattr(MemoryPublisher, "write", sometimes)
    for number in range(3):
        cell.plc(f"/out{number}").write({"data": number})
    wait_for(lambda: messages and all(bridge.status().topic(f"/out{number}").lost for number in range(2)))
    status = bridge.status()
    assert (status.topic("/out0").lost, status.topic("/out1").lost, status.topic("/out2").lost) == (1, 1, 0)
    assert "a mistake in a backend" in status.topic("/out0").reason
    assert "cannot keep up" in status.topic("/out1").reason


def test_an_unforeseen_error_costs_no_other_message(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages that were taken together with one that fails are sent anyway."""
    bridge = cell.start(f"  /a: {{type: {INT}, to: ros, slots: 64}}\n", more="tick: 200ms")
    messages = cell.listen("/a", INT)
    receive = ToRos.receive
    fails = [True]

    def once(self: ToRos, *arguments: Any) -> None:
        if fails:
            fails.clear()
            raise ZeroDivisionError
        receive(self, *arguments)

    monkeypatch.setattr(ToRos, "receive", once)
    plc = cell.plc("/a")
    for number in range(5):
        plc.write({"data": number})
    wait_for(lambda: len(messages) == 4)
    assert numbers(messages) == [1, 2, 3, 4]
    assert bridge.status().topic("/a").published == 4


def test_a_quiet_bridge_wakes_seldom_and_becomes_alert(cell: Cell) -> None:
    """Without a living writer the carrier ticks slowly; a message or a beat ends that."""
    bridge = cell.start(BOTH)
    stream = bridge._streams[1]
    assert bridge._carriers is not None
    assert isinstance(stream.port, ChannelPort)
    ports = bridge._carriers.of(stream.plan).ports
    assert isinstance(ports, ChannelsToRos)
    assert ports.tick(time.monotonic_ns()) == 10_000_000
    messages = cell.listen("/out", INT)
    plc = cell.plc("/out")
    plc.write({"data": 1})
    wait_for(lambda: messages)
    now = time.monotonic_ns()
    assert ports.tick(now) == 1_000_000
    stream.port.peer_alive = False
    assert ports.tick(now + 10**11) == 10_000_000
    stream.port.peer_alive = True
    assert ports.tick(now + 10**11) == 1_000_000


def test_both_sides_know_how_many_stand_behind(cell: Cell) -> None:
    """The PLC sees the number of publishers and subscribers, the status the PLC's task."""
    bridge = cell.start(BOTH)
    incoming, outgoing = cell.plc("/in"), cell.plc("/out")
    assert incoming.reader is not None
    assert outgoing.writer is not None
    wait_for(lambda: incoming.attached.snapshot().writer.sources == 0)
    cell.publisher("/in", INT)
    cell.listen("/out", INT)
    cell.peer.subscribe("/out", INT, Qos(), lambda *_: None)

    def beaten() -> bool:
        assert incoming.reader is not None
        assert outgoing.writer is not None
        incoming.reader.beat()
        outgoing.writer.beat()
        status = bridge.status()
        return status.topic("/in").peer_alive and status.topic("/out").peer_alive

    wait_for(beaten)
    wait_for(lambda: incoming.attached.snapshot().writer.sources == 1)
    wait_for(lambda: outgoing.attached.snapshot().readers[0].sinks == 2)
    assert bridge.status().topic("/in").tasks == ("MainTask",)

    def judged() -> bool:
        beaten()
        level, words = bridge.status().topic("/in").judgement
        return (
            level is Level.STALE
            and "there is a publisher: the publisher is silent, or its definition" in words
        )

    wait_for(judged)
    wait_for(
        lambda: not bridge.status().topic("/in").peer_alive and not bridge.status().topic("/out").peer_alive
    )
    level, words = bridge.status().topic("/out").judgement
    assert level is Level.ERROR
    assert "the PLC task that writes it stopped" in words


def test_the_bridge_beats_while_ros_hangs(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ROS side that does not return stops neither beats nor messages towards the PLC, and is reported."""
    clock = SteppedClock()
    bridge = cell.start(BOTH, clock=clock)
    incoming, outgoing = cell.plc("/in"), cell.plc("/out")
    go_on, asked, writing = threading.Event(), threading.Event(), threading.Event()

    def hang(*_: object) -> None:
        asked.set()
        go_on.wait(100)

    def write(*_: object) -> None:
        writing.set()
        go_on.wait(100)

    with monkeypatch.context() as patch:
        patch.setattr(MemoryPublisher, "write", write)
        patch.setattr(MemoryPublisher, "status", hang)
        patch.setattr(MemorySubscription, "status", hang)
        outgoing.write({"data": 1})
        repeat_until(lambda: clock.advance(0.5), writing.is_set)  # it waits for a subscriber first
        clock.advance(1)
        assert asked.wait(100)  # the reporter hangs too
        before = outgoing.attached.snapshot().readers[0].beat
        repeat_until(
            lambda: clock.advance(0.02), lambda: outgoing.attached.snapshot().readers[0].beat >= before + 3
        )
        bridge._streams[0].on_message(wire(INT, {"data": 2}), 0)  # type: ignore[attr-defined]
        assert wait_for(incoming.read) == {"data": 2}
    clock.advance(6)
    assert "publishing to ROS has been blocked" in bridge.status().judgement[1]
    go_on.set()


def test_a_message_that_was_not_sent_is_no_old_one(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """With on_change a message that ROS refused is sent when the PLC repeats it."""
    bridge = cell.start(f"  /out: {{type: {INT}, to: ros, on_change: true}}\n")
    messages = cell.listen("/out", INT)
    plc = cell.plc("/out")
    with monkeypatch.context() as patch:
        patch.setattr(MemoryPublisher, "write", lambda *_: False)
        plc.write({"data": 1})
        wait_for(lambda: bridge.status().topic("/out").lost == 1)
    plc.write({"data": 1})
    wait_for(lambda: messages)
    assert numbers(messages) == [1]


def test_a_configuration_edited_while_running_is_noticed(
    cell: Cell, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The status and the log say that a restart is needed; nothing else happens."""
    path = tmp_path / "rosplc.yaml"
    path.write_text(cell.config(BOTH))
    clock = SteppedClock()
    cell.bridge = bridge = Bridge(read_config(path), clock=clock)
    bridge.start()
    clock.until_waiting(2)
    clock.step(1)
    assert bridge.status().notes == ()
    path.write_text(cell.config(BOTH) + "\n# a comment\n")
    repeat_until(lambda: clock.step(1), lambda: bridge.status().config_changed)
    level, message = cell.bridge.status().judgement
    assert level is Level.WARN
    assert "configuration changed on disk" in message
    assert caplog.text.count("configuration changed on disk") == 1


def test_defaults_of_quality_of_service(cell: Cell) -> None:
    """Towards ROS late subscribers get what was sent before; towards the PLC no old command comes."""
    cell.publisher("/in", INT, LATCHED).write(wire(INT, {"data": 1}))
    bridge = cell.start(BOTH + f"  /latched: {{type: {INT}, to: plc, latched: true}}\n")
    cell.publisher("/latched", INT, LATCHED).write(wire(INT, {"data": 3}))
    cell.plc("/out").write({"data": 2})
    wait_for(lambda: bridge.status().topic("/out").published)
    late = cell.listen("/out", INT, Qos(durability="transient_local"))
    wait_for(lambda: late)
    assert numbers(late) == [2]
    wait_for(lambda: bridge.status().topic("/latched").received == 1)
    assert bridge.status().topic("/in").received == 0


def test_peers_that_do_not_match_are_explained(cell: Cell) -> None:
    """Another type or excluding settings show as an error with the reason in words."""
    bridge = cell.start(f"  /in: {{type: {INT}, to: plc}}\n  /fast: {{type: {INT}, to: plc}}\n")
    cell.publisher("/in", STRING)
    cell.publisher("/fast", INT, Qos(reliability="best_effort"))
    status = bridge.status()
    assert status.topic("/in").judgement[0] is Level.ERROR
    assert status.topic("/in").code == "ROS003"
    assert "std_msgs/msg/String" in status.topic("/in").judgement[1]
    assert status.topic("/fast").code == "ROS004"
    assert "best_effort" in status.topic("/fast").judgement[1]


def test_mode_and_group_reach_the_objects(cell: Cell) -> None:
    """shm.mode and shm.group are those of the objects."""
    cell.start(BOTH, more=f"shm: {{mode: 0640, group: {os.getgid()}}}")
    found = cell.namespace.path("/in").stat()
    assert (found.st_mode & 0o777, found.st_gid) == (0o640, os.getgid())


@pytest.mark.parametrize("key", ["owner", "group"])
def test_unknown_users_and_groups(cell: Cell, key: str) -> None:
    """A name that this machine does not know is an error at its line, before anything is opened."""
    bridge = cell.make(BOTH, more=f"shm: {{{key}: no-such-name}}")
    with pytest.raises(ConfigError, match=rf"shm\.{key}: there is no .* 'no-such-name'"):
        bridge.start()
    assert not cell.namespace.path("/in").exists()


def test_a_given_backend_is_left_open(cell: Cell) -> None:
    """The one that passes a backend keeps it; the bridge takes only its endpoints off."""
    backend = open_backend(STORE, "mine", domain=DOMAIN)
    with Bridge(parse_config(cell.config(BOTH)), backend) as bridge:
        assert {end.topic for end in backend.endpoints()} == {"/in", "/out", "/rosout"}
        with pytest.raises(RuntimeError, match="already been started"):
            bridge.start()
    assert backend.endpoints() == ()
    assert backend.graph().nodes == ("/peer",)
    backend.close()


def test_a_clean_stop_leaves_the_last_state(cell: Cell) -> None:
    """After the bridge has gone a reader still finds the last message."""
    cell.start(BOTH)
    plc = cell.plc("/in")
    cell.publisher("/in", INT).write(wire(INT, {"data": 9}))
    wait_for(plc.read)
    cell.stop()
    with attach(cell.namespace, "/in") as found:
        record = bytearray(plc.layout.size)
        assert found.reader(latched=True).latest(record) is not None
        assert plc.layout.to_dict(record) == {"data": 9}


def test_ros_1_messages(shm_namespace: Namespace) -> None:
    """With noetic's definitions the same object is filled from ROS 1's serialization."""
    head = f"prefix: {shm_namespace.prefix}\nros: {{distro: noetic}}\n"
    project = resolve(parse_config(head + f"topics: {{/in: {{type: {STRING}, to: plc}}}}\n"))
    context = Context(project.namespace, "cell", bytes(16), "noetic")
    topic = Carriers(context, 1_000_000).make(project.topics[0])
    assert isinstance(topic, ToPlc)
    topic.port.open()
    topic.on_message(b"\x02\0\0\0hi", 1)
    with attach(shm_namespace, "/in") as found:
        record = bytearray(project.topics[0].layout.size)
        assert found.reader(latched=True).latest(record) is not None
        assert project.topics[0].layout.to_dict(record) == {"data": "hi"}
        assert found.description.distro == "noetic"
    topic.on_message(wire(STRING, {"data": "no"}), 1)
    assert (topic.counters.published, topic.counters.refused) == (1, 1)
    topic.port.close()


def test_a_quiet_topic_is_looked_at_every_fifth_time(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """A backend that knows what has changed is not asked for what is still; messages and news end that."""
    clock, news, asked = SteppedClock(), set[object](), list[object]()
    look = Stream.ask

    def ask(stream: Stream, now_ns: int) -> None:
        asked.append(stream)
        look(stream, now_ns)

    monkeypatch.setattr(Stream, "ask", ask)
    monkeypatch.setattr(MemoryBackend, "changed", lambda _: frozenset(news), raising=False)
    bridge = cell.start(BOTH, clock=clock)
    into, out = bridge._streams

    def steps(count: int) -> list[object]:
        asked.clear()
        for _ in range(count):
            clock.step(1)
        return asked

    repeat_until(lambda: clock.step(1), lambda: into.still and out.still)
    assert [steps(5).count(each) for each in (into, out)] == [1, 1]
    news.add(into._endpoint)
    assert [steps(5).count(each) for each in (into, out)] == [5, 1]
    news.clear()
    peer = cell.publisher("/in", INT)
    peer.write(wire(INT, {"data": 1}))
    repeat_until(lambda: clock.step(1), lambda: not into.still)
    repeat_until(lambda: clock.step(1), lambda: into.still)
    assert bridge.status(10**12).topic("/in") == bridge.status().topic("/in")
    plc = cell.plc("/in")
    assert plc.reader is not None
    repeat_until(lambda: (plc.reader.beat(), clock.step(0.5)), lambda: into.port.peer_alive)
    assert not into.still
    assert bridge.status() == bridge.status()
    assert not into.still  # a look beside the reporter takes no change from it
