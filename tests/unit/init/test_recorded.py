"""Robots that were recorded: both ROS worlds, every storage, damaged files."""

from __future__ import annotations

from pathlib import Path

import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from rosplc.errors import RosplcError
from rosplc.init.propose import parse_wish, select
from rosplc.init.recorded import RecordedRobot
from rosplc.init.write import draft, save
from rosplc.model import TypeStore
from rosplc.shm import Direction, Namespace
from tests.e2e.turtle_recording import write_recording
from tests.unit.init.robots import JOINTS, PART, record
from tests.unit.recorder.making import POSE, Feed, received, recording, until


def robot(path: Path, distro: str | None = None, folders=()) -> RecordedRobot:
    return RecordedRobot(path, distro, folders, {"backend": "auto"})


def drafted(source: RecordedRobot, *wishes: str):
    chosen, left_out = select(
        source.found.topics, [parse_wish(text) for text in wishes], everything=not wishes
    )
    return draft(source, chosen, seconds=1.0), left_out


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_ros2_recording_gives_types_sizes_and_definitions(tmp_path: Path, storage: str) -> None:
    """Custom types come out of the recording, with what they need; every message is measured."""
    source = robot(record(tmp_path / "bag", storage))
    made, _ = drafted(source)
    assert {entry.topic: entry.type_name for entry in made.entries} == {
        "/joint_states": JOINTS,
        "/parts": PART,
    }
    capacities = {path: most for entry in made.entries for path, (most, _) in entry.limits.items()}
    assert capacities["name"] == 6
    assert capacities["name[]"] == 64
    assert capacities["sizes"] == 4
    assert made.seen["/parts"].rate_hz == pytest.approx(2.0)
    assert set(made.definitions) == {PART, "cell_msgs/msg/Side"}
    _, files = save(source, made, tmp_path / "rosplc.yaml", bridge="cell")
    assert "bool left" in (tmp_path / "msg/cell_msgs/msg/Side.msg").read_text()
    assert len(files) == 2
    source.close()


def test_a_single_file_of_a_recording_is_enough(tmp_path: Path) -> None:
    """An .mcap file without its folder is read as well."""
    (file,) = record(tmp_path / "bag").glob("*.mcap")
    source = robot(file)
    assert set(source.found.topics) == {"/joint_states", "/parts", "/rosout"}
    source.close()


def test_ros1_recording_leads_to_ros1(tmp_path: Path) -> None:
    """A .bag file is of noetic; its names and types stay as they are."""
    write_recording(tmp_path / "turtle.bag", steps=20)
    source = robot(tmp_path / "turtle.bag")
    made, _ = drafted(source)
    assert source.found.ros["distro"] == "noetic"
    types = {entry.topic: entry.type_name for entry in made.entries}
    assert types["/tf"] == "tf/msg/tfMessage"
    assert not made.definitions  # noetic has them
    assert all(made.seen[topic].unreadable == 0 for topic in types)
    source.close()
    with pytest.raises(RosplcError, match="ROS001"):
        robot(tmp_path / "turtle.bag", "jazzy")


def test_relative_names_of_ros1_are_absolute_ones(tmp_path: Path) -> None:
    """ROS 1 records a name as the node wrote it; the configuration has it with its slash, and measured."""
    with Writer(tmp_path / "chatter.bag") as writer:
        store = get_typestore(Stores.ROS1_NOETIC)
        connection = writer.add_connection("chatter", "std_msgs/msg/UInt16", typestore=store)
        for number in range(2):
            writer.write(connection, 5 + number, bytes([number, 0]))
    source = robot(tmp_path / "chatter.bag")
    made, _ = drafted(source)
    assert [entry.topic for entry in made.entries] == ["/chatter"]
    assert made.seen["/chatter"].messages == 2
    source.close()


def test_damage_is_said(tmp_path: Path) -> None:
    """What is no recording is an error; one that was cut off never crashes the program."""
    (tmp_path / "no.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "no.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "long.mcap").write_bytes(b"\x89MCAP0\r\n\x01" + b"\xff" * 7 + b"\x7f")
    for name in ("no.bag", "no.mcap", "long.mcap", "missing.bag", "missing"):
        with pytest.raises(RosplcError, match="ROS006"):
            robot(tmp_path / name)
    write_recording(tmp_path / "turtle.bag", steps=50)
    whole = (tmp_path / "turtle.bag").read_bytes()
    for size in range(0, len(whole), len(whole) // 40):
        cut = tmp_path / f"cut{size}.bag"
        cut.write_bytes(whole[:size] + bytes(len(whole) - size))
        try:
            source = robot(cut)
        except RosplcError as error:
            assert error.code == "ROS006"
            continue
        try:
            drafted(source, *([] if "/tf" not in source.found.topics else ["/tf"]))
        except (RosplcError, ValueError):
            pass
        finally:
            source.close()


def test_types_of_a_recording_are_not_executed(tmp_path: Path) -> None:
    """A definition with a field that is no name is refused, not turned into a program."""
    folder = record(tmp_path / "bag", "sqlite3")
    (file,) = folder.glob("*.db3")
    data = file.read_bytes()
    assert b"float32[] sizes" in data
    file.write_bytes(data.replace(b"float32[] sizes", b"float32[] 1);x="))
    source = robot(folder)
    with pytest.raises(RosplcError, match="TYP002"):
        drafted(source, "/parts")
    made, _ = drafted(source)
    assert [entry.topic for entry in made.entries] == ["/joint_states"]
    assert "TYP" not in made.left_out["/parts"] and made.left_out["/parts"]
    source.close()


@pytest.mark.parametrize("bag", [False, True])
def test_our_own_recording_keeps_directions_and_distribution(
    shm_namespace: Namespace, tmp_path: Path, bag: bool
) -> None:
    """What the PLC sent when it was recorded, it sends again; the distribution is the recorded bridge's."""
    store = TypeStore.bundled("humble")
    read = Feed(shm_namespace, "/read", store=store)
    sent = Feed(shm_namespace, "/sent", store=store, direction=Direction.TO_ROS)
    with recording(shm_namespace, tmp_path / "r", bag=bag) as recorder:
        for number in range(12):
            read.number(number + 1)
            sent.number(number + 1)
        until(lambda: received(recorder) == 24, recorder)
        recorder.stop()
    read.close()
    sent.close()
    source = robot(tmp_path / ("r" if bag else "r.mcap"))
    made, _ = drafted(source)
    source.close()
    assert {(entry.topic, entry.type_name, entry.to) for entry in made.entries} == {
        ("/read", POSE, "plc"),
        ("/sent", POSE, "ros"),
    }
    assert made.seen["/sent"].messages == 12
    assert all("Its publishers and the PLC" not in text for entry in made.entries for text in entry.about)
    assert (source.found.ros["distro"], source.found.notes) == ("humble", ())


def test_other_recordings_tell_no_direction(tmp_path: Path) -> None:
    """Of a recording that is not ours nobody knows who listened, and that is said."""
    source = robot(record(tmp_path / "bag"))
    assert {topic.carried for topic in source.found.topics.values()} == {""}
    assert "--to-ros" in source.found.notes[0]
    source.close()
