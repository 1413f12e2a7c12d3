"""Replaying into channels and onto ROS topics: what comes, in which order, and what is refused."""

from __future__ import annotations

import sqlite3
import struct
import threading
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from rosplc.clock import SYSTEM, Clock
from rosplc.config.resolve import Project, load_project
from rosplc.described import layout_of
from rosplc.errors import ChannelError, RecordingError
from rosplc.layout import Limits
from rosplc.model import TypeStore
from rosplc.recorder import Selection
from rosplc.recorder.mcap_file import Batch, ChannelInfo, McapFile, seal
from rosplc.recorder.replay import (
    Player,
    PlcTarget,
    ReplayOptions,
    RosTarget,
    SentCount,
    chosen_topics,
    wait_for_readers,
)
from rosplc.recorder.source import Source, open_source
from rosplc.recorder.store import repair
from rosplc.ros import ROS1, Qos, open_backend
from rosplc.ros.bag import Bag
from rosplc.shm import Direction, Namespace, attach
from tests.command import rosplc
from tests.e2e.turtle_recording import write_recording
from tests.lib.clock import SteppedClock
from tests.unit.recorder.making import Feed, received, recording, until


class Heap:
    """A target that keeps what it gets."""

    linger_s = 0.0

    def __init__(self, clock: Clock = SYSTEM) -> None:
        self._clock = clock
        self.got: list[tuple[str, int]] = []
        self.at: list[int] = []
        self.stamps: list[int] = []
        self.counts: dict[str, SentCount] = {}
        self.notes: list[str] = []

    def send(self, topic: str, data: bytes, stamp_ns: int) -> None:
        self.got.append((topic, int.from_bytes(data[4:6], "little")))
        self.at.append(self._clock.monotonic_ns())
        self.stamps.append(stamp_ns)

    def missing(self) -> list[str]:
        return ["/nobody"]

    def close(self) -> None:
        pass


def made(path: Path, chunks: list[list[tuple[int, int, int]]], **metadata: str) -> Path:
    """Write a file: per chunk (channel, milliseconds, number) of each message; channels are /t1, /t2 ..."""
    file = McapFile(path)
    for chunk in chunks:
        batch = Batch()
        for channel, ms, number in chunk:
            file.declare(
                ChannelInfo(
                    channel,
                    f"/t{channel}",
                    "std_msgs/msg/UInt16",
                    "ros2msg",
                    b"uint16 data\n",
                    "cdr",
                    metadata,
                )
            )
            batch.add(
                channel, number, ms * 10**6, number, b"\0\1\0\0" + number.to_bytes(2, "little") + b"\0\0"
            )
        file.append(seal(batch, "lz4"))
    file.finish()
    return path


def never(_: float) -> bool:
    return False


def sleeping(seconds: float) -> bool:
    time.sleep(seconds)
    return False


def played(path: Path, options: ReplayOptions | None = None) -> Heap:
    """Play a recording by a clock that passes only while the player waits."""
    source, clock = open_source(path), SteppedClock()
    heap = Heap(clock)

    def stopped(seconds: float) -> bool:
        clock.advance(seconds)
        return False

    topics, _ = chosen_topics(source, Selection(), {}, to_plc=False)
    Player(source, heap, topics, options or ReplayOptions(speed=0), clock).play(stopped)
    return heap


def test_chunks_that_overlap_are_put_in_order(tmp_path: Path) -> None:
    """Messages come in order of log time, whatever the order of the file; those of one time as they stand."""
    path = made(
        tmp_path / "a.mcap", [[(1, 30, 3), (1, 10, 1)], [(2, 20, 2), (2, 40, 4)], [(1, 40, 5), (1, 5, 0)]]
    )
    assert [number for _, number in played(path).got] == [0, 1, 2, 3, 4, 5]


def test_the_pace_is_the_recordings(tmp_path: Path) -> None:
    """At speed 2 each message comes when half of its recorded time has passed."""
    path = made(tmp_path / "a.mcap", [[(1, 0, 0), (1, 100, 1), (1, 300, 2), (1, 9300, 3)]])
    heap = played(path, ReplayOptions(speed=2))
    assert [number for _, number in heap.got] == [0, 1, 2, 3]
    assert [(at - heap.at[0]) / 1e9 for at in heap.at] == pytest.approx([0, 0.05, 0.15, 4.65], abs=1e-6)


def test_parts_and_rounds(tmp_path: Path) -> None:
    """Start and end cut the recording, a loop begins it again until it is stopped."""
    path = made(tmp_path / "a.mcap", [[(1, ms, ms) for ms in range(0, 100, 10)]])
    heap = played(path, ReplayOptions(speed=0, start_ns=20 * 10**6, end_ns=50 * 10**6))
    assert [number for _, number in heap.got] == [20, 30, 40, 50]
    source, heap = open_source(path), Heap()
    player = Player(source, heap, source.topics, ReplayOptions(speed=0, loop=True))
    player.play(lambda _: player.rounds == 3)
    assert player.rounds == 3 and [n for _, n in heap.got[:11]] == [*range(0, 100, 10), 0]


@pytest.mark.parametrize("stamps", ["now", "original"])
def test_stamps(tmp_path: Path, stamps: Any) -> None:
    """A message is stamped with the time of its sending, or as it was recorded."""
    path = made(tmp_path / "a.mcap", [[(1, 0, 7), (1, 1, 0)]])
    heap = played(path, ReplayOptions(speed=0, stamps=stamps))
    assert heap.stamps[1] == SteppedClock().time_ns()  # 0 is no time
    assert heap.stamps[0] == (7 if stamps == "original" else SteppedClock().time_ns())


def test_choosing_and_renaming(tmp_path: Path) -> None:
    """Topics are chosen and renamed; what the PLC wrote is left out towards it, unless it is named."""
    path = made(tmp_path / "a.mcap", [[(1, 0, 1), (2, 1, 2)]], **{"rosplc.direction": "to_ros"})
    source = open_source(path)
    with pytest.raises(RecordingError) as caught:
        chosen_topics(source, Selection(), {}, to_plc=True)
    assert caught.value.code == "REC006"
    topics, remarks = chosen_topics(source, Selection(("/t1",)), {"/t1": "/new", "/x": "/y"}, to_plc=True)
    assert list(topics) == ["/new"] and any("/x" in one for one in remarks)
    heap = Heap()
    Player(source, heap, topics, ReplayOptions(speed=0)).play(never)
    assert heap.got == [("/new", 1)]
    with pytest.raises(RecordingError, match="two topics"):
        chosen_topics(source, Selection(), {"/t1": "/t2"}, to_plc=False)


def test_other_encodings_are_named(tmp_path: Path) -> None:
    """A topic whose messages are no CDR cannot be replayed, and that is said."""
    file = McapFile(tmp_path / "a.mcap")
    file.declare(ChannelInfo(1, "/j", "x", "jsonschema", b"{}", "json", {}))
    batch = Batch()
    batch.add(1, 1, 1, 1, b"{}")
    file.append(seal(batch, "none"))
    file.finish()
    source = open_source(tmp_path / "a.mcap")
    assert "json" in source.unusable["/j"]
    with pytest.raises(RecordingError):
        chosen_topics(source, Selection(), {}, to_plc=True)


def recorded(namespace: Namespace, base: Path, feed: Feed, values: list[Any]) -> Path:
    with recording(namespace, base) as recorder:
        for value in values:
            feed.send(value, stamp_ns=1)
        until(lambda: received(recorder) == len(values), recorder)
        result = recorder.stop()
    return result.files[0].path


def test_into_channels_and_back(shm_namespace: Namespace, tmp_path: Path) -> None:
    """What is replayed is in a channel like the recorded one, and a PLC's reader gets every message."""
    other = Namespace(shm_namespace.prefix + "x", shm_namespace.directory)
    feed = Feed(shm_namespace, "/a", "sensor_msgs/msg/JointState", limits=Limits(9, 3))
    values = [{"name": ["x" * 9], "position": [float(n)]} for n in range(20)]
    path = recorded(shm_namespace, tmp_path / "r", feed, values)
    feed.close()
    source = open_source(path)
    target = PlcTarget(source.topics, other)
    try:
        with attach(other, "/a", write=True) as plc:
            assert plc.identity.layout_id == feed.layout.layout_id and plc.identity.slot_count == 256
            reader = plc.reader("test", observe=False)
            out, got = bytearray(feed.layout.size), []
            Player(source, target, source.topics, ReplayOptions(speed=0)).play(never)
            while reader.next(out) is not None:
                got.append(feed.layout.to_dict(out)["position"])
        assert got == [[float(n)] for n in range(20)]
        assert target.counts["/a"].sent == 20
        with pytest.raises(ChannelError) as caught:
            PlcTarget(source.topics, other)
        assert caught.value.code == "SHM116"
    finally:
        target.close()
        for file in Path(other.directory).glob(f"{other.prefix}.*"):
            file.unlink()


def test_an_object_that_is_there_is_used_as_it_is(shm_namespace: Namespace, tmp_path: Path) -> None:
    """Where a bridge has left its channel, its limits hold; what does not fit is refused and counted."""
    feed = Feed(shm_namespace, "/a", "std_msgs/msg/String", limits=Limits(string=80))
    path = recorded(shm_namespace, tmp_path / "r", feed, [{"data": "short"}, {"data": "far too long"}])
    feed.channel.retire()
    there = Feed(shm_namespace, "/a", "std_msgs/msg/String", limits=Limits(string=5), slots=8)
    generation = there.channel.generation
    there.close()
    source = open_source(path)
    target = PlcTarget(source.topics, shm_namespace)
    Player(source, target, source.topics, ReplayOptions(speed=0)).play(never)
    target.close()
    count = target.counts["/a"]
    assert (count.sent, count.refused) == (1, 1) and "COD004" in count.reason
    with attach(shm_namespace, "/a") as attached:
        assert attached.identity.generation == generation


def test_a_configuration_says_what_the_channel_is(
    shm_namespace: Namespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By default the folder's configuration holds: the channel is the one that its bridge would make."""
    config = tmp_path / "rosplc.yaml"
    config.write_text(
        f"bridge: b\nprefix: {shm_namespace.prefix}\n"
        "topics:\n  /t1: {type: std_msgs/msg/UInt16, to: plc, slots: 32}\n"
        "  /t2: {type: std_msgs/msg/UInt16, to: ros}\n"
    )
    project = load_project(config)
    source = open_source(made(tmp_path / "a.mcap", [[(1, 0, 1), (2, 0, 2)]]))
    monkeypatch.chdir(tmp_path)
    rosplc("replay", "a.mcap", "--to", "plc", "--topic", "/t1", "--wait", "0", "--speed", "max")
    with attach(shm_namespace, "/t1") as attached:
        assert (attached.identity.slot_count, attached.description.bridge) == (32, "b")
    with pytest.raises(RecordingError, match="the PLC writes this topic"):
        PlcTarget({"/t2": source.topics["/t2"]}, shm_namespace, project=project)


def test_a_channel_of_the_other_direction_is_left_alone(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A channel that the PLC writes, or that has another type, is not replaced by a replay."""
    feed = Feed(shm_namespace, "/t1", "std_msgs/msg/UInt16", direction=Direction.TO_ROS)
    feed.close()
    Feed(shm_namespace, "/t2").close()
    source = open_source(made(tmp_path / "a.mcap", [[(1, 0, 1), (2, 0, 2)]]))
    for name in ("/t1", "/t2"):
        with pytest.raises(RecordingError) as caught:
            PlcTarget({name: source.topics[name]}, shm_namespace)
        assert caught.value.code == "REC007" and caught.value.where == name


def test_waiting_for_a_plc(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A replay waits until a PLC task reads each channel, or for as long as it was told."""
    source = open_source(made(tmp_path / "a.mcap", [[(1, 0, 1)]]))
    target = PlcTarget(source.topics, shm_namespace)
    assert wait_for_readers(target, 0.1, sleeping) == ["/t1"]
    done = threading.Event()

    def plc() -> None:
        with attach(shm_namespace, "/t1", write=True) as attached:
            reader = attached.reader("test", observe=False)
            while not done.wait(0.01):
                reader.beat()

    thread = threading.Thread(target=plc)
    thread.start()
    try:
        assert wait_for_readers(target, 60, sleeping) == []
    finally:
        done.set()
        thread.join()
        target.close()


def heard(domain: int, topic: str, type_name: str, store: TypeStore) -> tuple[Any, list[bytes]]:
    backend = open_backend("memory", store, "listener", domain=domain)
    got: list[bytes] = []
    backend.subscribe(topic, type_name, Qos(depth=1000), lambda data, _: got.append(data))
    return backend, got


def test_onto_ros_topics(tmp_path: Path) -> None:
    """A listener on a ROS topic gets every message's bytes."""
    store = TypeStore.bundled("jazzy")
    listener, got = heard(4711, "/new", "std_msgs/msg/UInt16", store)
    source = open_source(made(tmp_path / "a.mcap", [[(1, n, n) for n in range(50)]]))
    target = RosTarget({"/new": source.topics["/t1"]}, backend="memory", domain=4711)
    try:
        assert wait_for_readers(target, 60, sleeping) == []
        Player(source, target, {"/new": source.topics["/t1"]}, ReplayOptions(speed=0)).play(never)
        until(lambda: len(got) == 50)
    finally:
        target.close()
        listener.close()
    assert [int.from_bytes(data[4:6], "little") for data in got] == list(range(50))
    assert target.counts["/new"].sent == 50


class Ros1:
    """A backend that keeps what it is to send."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self.got: list[bytes] = []
        self.matched = 1

    def advertise(self, *_: Any) -> Ros1:
        return self

    def write(self, payload: bytes, _stamp_ns: int) -> bool:
        self.got.append(payload)
        return len(self.got) < 2

    def close(self) -> None:
        pass


def test_onto_ros_1_topics(tmp_path: Path) -> None:
    """Towards ROS 1 a message is written in its serialization; one that nobody has room for is counted."""
    source = open_source(made(tmp_path / "a.mcap", [[(1, 0, 258), (1, 1, 259)]]))
    target = RosTarget(source.topics, backend="rospy", distro=ROS1, join=Ros1)
    Player(source, target, source.topics, ReplayOptions(speed=0)).play(never)
    target.close()
    assert target.backend.got == [b"\2\1", b"\3\1"]  # type: ignore[attr-defined]
    assert (target.counts["/t1"].sent, target.counts["/t1"].lost) == (1, 1)


def test_another_definition_than_the_distributions_is_refused(tmp_path: Path) -> None:
    """A type that was recorded with other fields than the distribution's is not sent under its name."""
    file = McapFile(tmp_path / "a.mcap")
    file.declare(ChannelInfo(1, "/a", "std_msgs/msg/String", "ros2msg", b"uint8 other\n", "cdr", {}))
    batch = Batch()
    batch.add(1, 1, 1, 1, b"\0\1\0\0\1")
    file.append(seal(batch, "none"))
    file.finish()
    source = open_source(tmp_path / "a.mcap")
    with pytest.raises(RecordingError) as caught:
        RosTarget(source.topics, backend="memory")
    assert caught.value.code == "REC007" and "no field in common" in caught.value.what


def test_a_ros_1_bag_goes_into_channels(shm_namespace: Namespace, tmp_path: Path) -> None:
    """Every topic of a ROS 1 recording becomes a channel of ROS 2's types."""
    path = tmp_path / "turtle.bag"
    write_recording(path, steps=20)
    source = open_source(path)
    topics, _ = chosen_topics(source, Selection(), {}, to_plc=True)
    target = PlcTarget(topics, shm_namespace)
    try:
        Player(source, target, topics, ReplayOptions(speed=0)).play(never)
    finally:
        target.close()
        source.close()
    assert {name: one.sent for name, one in target.counts.items()} == {n: t.count for n, t in topics.items()}
    with attach(shm_namespace, "/turtle1/pose") as attached:
        assert attached.description.type == "turtlesim/msg/Pose"


def axis(path: Path, definition: str, values: tuple[float, float]) -> Path:
    """Write a recording of one message of a type of two numbers."""
    file, batch = McapFile(path), Batch()
    file.declare(ChannelInfo(1, "/axis", "cell_msgs/msg/Axis", "ros2msg", definition.encode(), "cdr", {}))
    batch.add(1, 1, 1, 1, b"\0\1\0\0" + struct.pack("<2d", *values))
    file.append(seal(batch, "none"))
    file.finish()
    return path


def project_of(folder: Path, prefix: str, topics: str, ros: str = "") -> Project:
    file = folder / "msg" / "cell_msgs" / "msg" / "Axis.msg"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("float64 position\nfloat64 speed\n")
    config = folder / "rosplc.yaml"
    config.write_text(
        f"bridge: b\nprefix: {prefix}\n{ros}types: {{paths: [{folder}/msg]}}\ntopics: {{{topics}}}\n"
    )
    return load_project(config)


def shown(namespace: Namespace, topic: str) -> dict[str, Any]:
    """Return the newest message of a channel as its own description has it."""
    with attach(namespace, topic) as attached:
        layout = layout_of(attached)
        record = bytearray(layout.size)
        assert attached.reader(latched=True).latest(record) is not None
        return layout.to_dict(record)


def play_into(target: PlcTarget, source: Source) -> None:
    topics = {name: source.topics[name] for name in target.counts}
    Player(source, target, topics, ReplayOptions(speed=0)).play(never)
    target.close()


@pytest.mark.parametrize("left", [False, True], ids=["configuration", "channel"])
def test_fields_go_by_their_names(left: bool, shm_namespace: Namespace, tmp_path: Path) -> None:
    """A recorded type with its fields in another order goes into a channel by name, not by place."""
    project = project_of(tmp_path, shm_namespace.prefix, "/axis: {type: cell_msgs/msg/Axis, to: plc}")
    source = open_source(axis(tmp_path / "a.mcap", "float64 speed\nfloat64 position\n", (3.0, 7.0)))
    if left:
        PlcTarget(source.topics, shm_namespace, project=project).close()
    target = PlcTarget(source.topics, shm_namespace, project=None if left else project)
    play_into(target, source)
    assert shown(shm_namespace, "/axis") == {"position": 7.0, "speed": 3.0}
    assert any("have another order" in note for note in target.notes)


@pytest.mark.parametrize(
    "definition", ["float32 position\nfloat64 speed\n", "float64 a\nfloat64 b\n", "string position\n"]
)
def test_definitions_that_do_not_agree_are_refused(
    definition: str, shm_namespace: Namespace, tmp_path: Path
) -> None:
    """A recorded type whose fields are of other types, or have other names, is not written into a channel."""
    project = project_of(tmp_path, shm_namespace.prefix, "/axis: {type: cell_msgs/msg/Axis, to: plc}")
    source = open_source(axis(tmp_path / "a.mcap", definition, (3.0, 7.0)))
    with pytest.raises(RecordingError, match="definitions do not match") as caught:
        PlcTarget(source.topics, shm_namespace, project=project)
    assert (caught.value.code, caught.value.where) == ("REC007", "/axis")
    assert not list(Path(shm_namespace.directory).glob(f"{shm_namespace.prefix}.t.*"))


@pytest.mark.parametrize("left", [False, True], ids=["configuration", "channel"])
def test_a_ros_1_bag_goes_into_a_ros_1_bridges_channels(
    left: bool, shm_namespace: Namespace, tmp_path: Path
) -> None:
    """Into a noetic bridge's channels, ``seq`` stays ``seq``; the channel that the bridge left is kept."""
    write_recording(tmp_path / "turtle.bag", steps=20)
    source = open_source(tmp_path / "turtle.bag")
    joints = {"/joint_states": source.topics["/joint_states"]}
    project = project_of(
        tmp_path,
        shm_namespace.prefix,
        "/joint_states: {type: sensor_msgs/msg/JointState, to: plc}",
        "ros: {distro: noetic}\n",
    )
    generation = 0
    if left:
        PlcTarget(joints, shm_namespace, project=project).close()
        with attach(shm_namespace, "/joint_states") as attached:
            generation = attached.identity.generation
    target = PlcTarget(joints, shm_namespace, project=None if left else project)
    play_into(target, source)
    header = shown(shm_namespace, "/joint_states")["header"]
    assert (header["seq"], header["stamp"]["sec"]) == (19, 1_396_293_887)
    assert not target.notes and target.counts["/joint_states"].sent == 20
    if left:
        with attach(shm_namespace, "/joint_states") as attached:
            assert attached.identity.generation == generation


def test_a_ros_1_bag_goes_onto_ros_1(tmp_path: Path) -> None:
    """Onto ROS 1, the bytes of a bag's messages are those that were recorded."""
    write_recording(tmp_path / "turtle.bag", steps=20)
    source = open_source(tmp_path / "turtle.bag")
    topics = {"/tf": source.topics["/tf"]}
    target = RosTarget(topics, backend="rospy", distro=ROS1, join=Ros1)
    Player(source, target, topics, ReplayOptions(speed=0)).play(never)
    with closing(Bag(tmp_path / "turtle.bag")) as bag:
        assert target.backend.got == [data for *_, data in bag.messages({"/tf"})]  # type: ignore[attr-defined]
    assert len(target.backend.got) == 20 and not target.notes  # type: ignore[attr-defined]


def test_names_without_a_slash_and_bags_without_messages(tmp_path: Path) -> None:
    """A relative name of ROS 1 is the absolute one; an empty bag has no time."""
    store = get_typestore(Stores.ROS1_NOETIC)
    for name, messages in (("full.bag", 2), ("empty.bag", 0)):
        with Writer(tmp_path / name) as writer:
            connection = writer.add_connection("chatter", "std_msgs/msg/UInt16", typestore=store)
            for number in range(messages):
                writer.write(connection, 5 + number, bytes([number, 0]))
    source, heap = open_source(tmp_path / "full.bag"), Heap()
    Player(source, heap, source.topics, ReplayOptions(speed=0)).play(never)
    assert list(source.topics) == ["/chatter"] and [name for name, _ in heap.got] == ["/chatter"] * 2
    empty = open_source(tmp_path / "empty.bag")
    assert (empty.start_ns, empty.end_ns, empty.topics["/chatter"].count) == (0, 0, 0)


def humble_bag(path: Path, encoding: str = "") -> Path:
    """Write rosbag2's SQLite file: Humble's without definitions, or a later one that lacks one."""
    database = sqlite3.connect(path)
    version = 4 if encoding else 3
    more = ", type_description_hash TEXT" if encoding else ""
    database.executescript(
        f"""
        CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
        CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER, metadata TEXT);
        CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT,
            offered_qos_profiles TEXT{more});
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
        CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT,
            encoded_message_definition TEXT, type_description_hash TEXT);
        INSERT INTO schema VALUES ({version}, 'humble');
        """
    )
    for number, (name, type_name) in enumerate(
        (("/n", "std_msgs/msg/UInt16"), ("/x", "cell_msgs/msg/Unknown")), 1
    ):
        database.execute(
            f"INSERT INTO topics VALUES (?, ?, ?, 'cdr', ''{', ' + repr('') if encoding else ''})",
            (number, name, type_name),
        )
        database.execute(
            "INSERT INTO messages VALUES (?, ?, ?, ?)", (number, number, number, b"\0\1\0\0\7\0")
        )
    if encoding:
        database.execute(
            "INSERT INTO message_definitions VALUES (1, 'cell_msgs/msg/Unknown', ?, '', '')", (encoding,)
        )
    database.commit()
    database.close()
    return path


@pytest.mark.parametrize("encoding", ["", "unknown"])
def test_an_sqlite_recording_without_definitions(encoding: str, tmp_path: Path) -> None:
    """Where rosbag2 wrote no definitions the distribution's hold; an unknown type costs its topic only."""
    source, heap = open_source(humble_bag(tmp_path / "a.db3", encoding), "humble"), Heap()
    topics, remarks = chosen_topics(source, Selection(), {}, to_plc=False)
    assert list(topics) == ["/n"] and list(source.unusable) == ["/x"]
    assert "neither the file nor humble contains a definition of" in remarks[0]
    Player(source, heap, topics, ReplayOptions(speed=0)).play(never)
    assert heap.got == [("/n", 7)] and "are taken from humble" in source.notes[0]


def test_a_cut_file_is_replayed_and_repaired(tmp_path: Path) -> None:
    """Of a file that was cut off, what is whole is replayed with a word about it, and can be saved."""
    path = made(tmp_path / "a.mcap", [[(1, n * 10 + k, n * 10 + k) for k in range(10)] for n in range(5)])
    data = path.read_bytes()
    path.write_bytes(data[: open_source(path)._surveys[0].parts[3].end + 20])  # type: ignore[attr-defined]
    source = open_source(path)
    assert "only the intact messages are replayed" in source.notes[0]
    assert [number for _, number in played(path).got] == list(range(40))
    done = repair(path, tmp_path / "b.mcap")
    assert (done.messages, done.topics) == (40, {"/t1": 40}) and done.problem
    again = open_source(tmp_path / "b.mcap")
    assert not again.notes and [number for _, number in played(tmp_path / "b.mcap").got] == list(range(40))


def test_a_damaged_part_is_left_out_of_the_repaired_file(tmp_path: Path) -> None:
    """A damaged chunk ends a replay with an error; repaired, the file has all the others."""
    path = made(tmp_path / "a.mcap", [[(1, n * 10 + k, n * 10 + k) for k in range(10)] for n in range(5)])
    part = open_source(path)._surveys[0].parts[2]  # type: ignore[attr-defined]
    data = bytearray(path.read_bytes())
    data[part.end - 5] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(RecordingError) as caught:
        played(path)
    assert caught.value.code == "REC003" and str(part.offset) in caught.value.what
    done = repair(path, tmp_path / "b.mcap")
    assert (done.messages, done.damaged) == (40, 1)
    assert [number for _, number in played(tmp_path / "b.mcap").got] == [*range(20), *range(30, 50)]


def test_nothing_to_repair(tmp_path: Path) -> None:
    """Of a file without one whole message nothing is saved, and no file is left."""
    path = made(tmp_path / "a.mcap", [[(1, 0, 0)]])
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(RecordingError) as caught:
        repair(path, tmp_path / "b.mcap")
    assert caught.value.code == "REC003" and not (tmp_path / "b.mcap").exists()


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    """A path that leads nowhere is an error that names it."""
    with pytest.raises(RecordingError, match="no such file"):
        open_source(tmp_path / "none.mcap")
