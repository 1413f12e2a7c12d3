"""Files as the mcap and rosbags libraries read them, and as they are when they were cut off or damaged."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader

from rosplc.errors import RecordingError
from rosplc.recorder.mcap_file import (
    COMPRESSIONS,
    MAX_CHUNK,
    Batch,
    ChannelInfo,
    Compression,
    McapFile,
    read_part,
    seal,
    survey,
)
from rosplc.recorder.store import FileStore, Split, qos_of_text, qos_text
from rosplc.ros import LATCHED, SENSOR_DATA, Qos
from tests.unit.recorder.making import read_from_the_front

pytestmark = pytest.mark.verifies("recordings", real="mcap and rosbags")

STRING = ChannelInfo(1, "/a", "std_msgs/msg/String", "ros2msg", b"string data\n", "cdr", {"k": "v"})
NUMBER = ChannelInfo(2, "/b", "std_msgs/msg/UInt8", "ros2msg", b"uint8 data\n", "cdr", {})
CHANNELS = {1: STRING, 2: NUMBER}


def batch(first: int, count: int, channel: int = 1) -> Batch:
    made = Batch()
    for number in range(first, first + count):
        made.add(channel, number, 1_000 + number, 500 + number, payload(number))
    return made


def payload(number: int) -> bytes:
    return b"\0\1\0\0" + (4).to_bytes(4, "little") + f"{number % 1000:03d}\0".encode()


def write(path: Path, compression: Compression = "zstd", chunks: int = 3, count: int = 10) -> None:
    file = McapFile(path)
    for number in range(chunks):
        file.declare(STRING)
        file.append(seal(batch(1 + number * count, count), compression))
    file.add_metadata("rosplc", {"lost": "{}"})
    file.finish()


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_both_libraries_read_every_message(tmp_path: Path, compression: Compression) -> None:
    """The libraries mcap, with its checksums, and rosbags read the messages and times that were written."""
    path = tmp_path / "a.mcap"
    write(path, compression)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = list(reader.iter_messages())
        summary = reader.get_summary()
        assert [one.name for one in reader.iter_metadata()] == ["rosplc"]
        assert reader.get_header().profile == "ros2"
    assert [one.sequence for _, _, one in found] == list(range(1, 31))
    assert [(one.log_time, one.publish_time) for _, _, one in found][-1] == (1030, 530)
    assert found[0][0].name == "std_msgs/msg/String" and found[0][1].metadata == {"k": "v"}
    assert summary is not None and summary.statistics is not None
    assert (summary.statistics.message_count, summary.statistics.chunk_count) == (30, 3)
    with AnyReader([path]) as bag:
        texts = [bag.deserialize(raw, one.msgtype).data for one, _, raw in bag.messages()]
    assert texts == [f"{number:03d}" for number in range(1, 31)]


def test_the_library_finds_messages_by_their_index(tmp_path: Path) -> None:
    """Reading by time and topic, which goes by the indexes, gives exactly what the file has."""
    path = tmp_path / "a.mcap"
    file = McapFile(path)
    for channel in (STRING, NUMBER):
        file.declare(channel)
    mixed = batch(1, 10)
    mixed.add(2, 1, 1005, 1005, b"\0\1\0\0\7")
    file.append(seal(mixed, "lz4"))
    file.append(seal(batch(11, 10), "none"))
    file.finish()
    with path.open("rb") as opened:
        reader = make_reader(opened)
        assert [m.log_time for _, _, m in reader.iter_messages(topics=["/b"])] == [1005]
        found = [m.sequence for _, _, m in reader.iter_messages(["/a"], starting_at=1009, ending_before=1013)]
    assert found == [9, 10, 11, 12]


def test_a_file_without_an_end_is_read_up_to_it(tmp_path: Path) -> None:
    """Cut at any byte, a file gives the messages of its whole chunks: to the library, and to a replay."""
    path, cut = tmp_path / "a.mcap", tmp_path / "cut.mcap"
    write(path, chunks=3, count=5)
    data = path.read_bytes()
    ends = [part.end for part in survey(path, count=True).parts]
    seen = set()
    for size in range(8, len(data), 13):
        cut.write_bytes(data[:size])
        whole = 5 * sum(end <= size for end in ends)
        assert len(read_from_the_front(cut)) == whole
        try:
            found = survey(cut)
        except RecordingError as error:
            assert error.code == "REC003" and whole == 0
            continue
        assert not found.complete and found.problem
        assert sum(len(read_part(cut, part)) for part in found.parts) == whole
        seen.add(whole)
    assert seen == {0, 5, 10, 15}


def test_damaged_files_are_refused_in_words(tmp_path: Path) -> None:
    """Whatever bytes are changed: a file is read, or RecordingError says what is wrong."""
    path, bad = tmp_path / "a.mcap", tmp_path / "bad.mcap"
    write(path, "lz4")
    original = path.read_bytes()
    rng = random.Random(7)
    refused = 0
    for _ in range(150):
        data = bytearray(original)
        for _ in range(rng.choice((1, 1, 2, 8))):
            at = rng.randrange(len(data))
            data[at] = rng.choice((0, 0xFF, rng.randrange(256)))
        bad.write_bytes(data)
        for count in (False, True):
            try:
                found = survey(bad, count=count)
                for part in found.parts:
                    read_part(bad, part)
            except RecordingError as error:
                assert error.code == "REC003"
                refused += 1
    assert refused > 30


@pytest.mark.parametrize("claimed", [MAX_CHUNK + 1, 2**63, 29, 31])
def test_a_chunk_that_lies_about_its_size_is_refused(tmp_path: Path, claimed: int) -> None:
    """What a chunk claims to unpack to is no reason to ask for that much memory."""
    path = tmp_path / "a.mcap"
    write(path, chunks=1)
    part = survey(path).parts[0]
    data = bytearray(path.read_bytes())
    data[part.offset + 9 + 16 : part.offset + 9 + 24] = claimed.to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="REC003") as caught:
        read_part(path, part)
    assert caught.value.code == "REC003"


@pytest.mark.parametrize(
    "content", [b"", b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"\0" * 4096, b"\x89MCAP0\r\n\1" + b"\xff" * 64]
)
def test_what_is_no_mcap_file_is_said_to_be_none(tmp_path: Path, content: bytes) -> None:
    """An empty file, another format and a header that lies are refused with REC003."""
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError) as caught:
        survey(path)
    assert caught.value.code == "REC003" and caught.value.where == str(path)


@pytest.mark.parametrize("qos", [Qos(), LATCHED, SENSOR_DATA, Qos(deadline_ns=1_500_000_000, lease_ns=2)])
def test_qos_is_what_rosbag2_reads(qos: Qos) -> None:
    """rosbags, and a replay, read from a topic's metadata the QoS that was written."""
    from rosbags.rosbag2.metadata import parse_qos

    [found] = parse_qos(qos_text(qos))
    assert (found.reliability is QosReliability.RELIABLE) == (qos.reliability == "reliable")
    assert (found.durability is QosDurability.TRANSIENT_LOCAL) == (qos.durability == "transient_local")
    assert found.depth == qos.depth
    assert found.deadline.sec * 10**9 + found.deadline.nsec == qos.deadline_ns
    again = qos_of_text(qos_text(qos))
    assert (again.reliability, again.durability) == (qos.reliability, qos.durability)


@pytest.mark.parametrize("text", ["", "[]", "{", "- 1", "- {depth: x}", "&a [*a]", "!!python/object:os.x {}"])
def test_qos_that_cannot_be_read_is_the_default(text: str) -> None:
    """Whatever a file says in the place of QoS, there is one to publish with."""
    assert qos_of_text(text) == Qos()


def test_newer_bags_name_policies_in_words() -> None:
    """QoS as Jazzy writes it is understood too."""
    text = "- {history: keep_last, depth: 3, reliability: best_effort, durability: transient_local}"
    assert qos_of_text(text) == Qos(reliability="best_effort", durability="transient_local", depth=10)


def test_a_bag_of_several_files_is_one_recording(tmp_path: Path) -> None:
    """A folder with metadata.yaml, split by size, is read by rosbags as one bag with all its messages."""
    base = tmp_path / "bag"
    store = FileStore(
        base, CHANNELS, lambda: {"lost": "{}"}, split=Split(size=2_000), bag=True, distro="jazzy"
    )
    for number in range(12):
        store.take(seal(batch(1 + number * 10, 10), "none"))
    store.finish()
    store.finish()
    assert len(store.written) > 2 and all(one.complete for one in store.written)
    assert sum(one.counts["/a"] for one in store.written) == 120
    with Reader(base) as bag:
        assert (bag.message_count, bag.ros_distro) == (120, "jazzy")
        assert [int.from_bytes(raw[8:11], "little") for _, _, raw in bag.messages()]
    information = yaml.safe_load((base / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert [file["path"] for file in information["files"]] == [one.path.name for one in store.written]
    with store.written[0].path.open("rb") as file:
        names = [one.name for one in make_reader(file).iter_metadata()]
    assert names == ["rosbag2", "rosplc", "rosbag2"]


def test_a_new_file_begins_after_its_time(tmp_path: Path) -> None:
    """Split by time, no file spans more than that, but for the chunk that it ends with."""
    store = FileStore(tmp_path / "a", CHANNELS, dict, split=Split(time_ns=100))
    for number in range(10):
        store.take(seal(batch(1 + number * 40, 40), "zstd"))
    store.finish()
    assert [one.path.name for one in store.written][:2] == ["a_0.mcap", "a_1.mcap"]
    assert all(one.end_ns - one.start_ns < 100 for one in store.written)


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    """A name that is taken is an error that says so, and the file stays as it was."""
    (tmp_path / "a.mcap").write_text("mine")
    with pytest.raises(RecordingError) as caught:
        FileStore(tmp_path / "a", CHANNELS, dict)
    assert caught.value.code == "REC001" and (tmp_path / "a.mcap").read_text() == "mine"
