"""Recording channels of this process: order, losses, channels that come and go, ring buffers and triggers."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import pytest
from mcap.reader import make_reader

from rosplc.errors import RecordingError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.recorder import Selection
from rosplc.recorder.inlet import Ring
from rosplc.recorder.mcap_file import ChunkIndex, SealedChunk
from rosplc.recorder.recorder import parse_condition
from rosplc.recorder.store import dated, free_name
from rosplc.shm import Direction, Namespace
from tests.lib.clock import SteppedClock
from tests.unit.recorder.making import POSE, Feed, read_from_the_front, received, recording, result_of, until


def numbers(path: Path, topic: str = "/a") -> list[int]:
    """Return the number that each message of a topic carries."""
    with path.open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages(topics=[topic]))
    return [message.publish_time for _, _, message in found]


def metadata(path: Path) -> dict[str, str]:
    """Return what a file says of its own making, the last word."""
    with path.open("rb") as file:
        return [one.metadata for one in make_reader(file).iter_metadata() if one.name == "rosplc"][-1]


def test_every_message_is_taken_in_order(shm_namespace: Namespace, tmp_path: Path) -> None:
    """Messages between two looks are all in the file, in both directions, with stamp and sequence."""
    one = Feed(shm_namespace, "/a")
    two = Feed(shm_namespace, "/b", direction=Direction.TO_ROS)
    with recording(shm_namespace, tmp_path / "r") as recorder:
        until(lambda: len(recorder.inlet.counts) == 2, recorder)
        for number in range(1, 201):
            one.number(number)
            two.number(number)
            if number % 50 == 0:
                until(lambda n=number: received(recorder) == 2 * n, recorder)
        result = recorder.stop()
    one.close()
    two.close()
    assert (result.received, result.lost) == (400, 0)
    [file] = result.files
    assert numbers(file.path, "/a") == numbers(file.path, "/b") == list(range(1, 201))
    with file.path.open("rb") as opened:
        summary = make_reader(opened).get_summary()
    assert summary is not None
    ways = {c.topic: c.metadata["rosplc.direction"] for c in summary.channels.values()}
    assert ways == {"/a": "to_plc", "/b": "to_ros"}
    assert {schema.name for schema in summary.schemas.values()} == {POSE} and len(summary.schemas) == 1


def test_what_was_missed_is_counted_and_in_the_file(shm_namespace: Namespace, tmp_path: Path) -> None:
    """Messages that were overwritten before they were read are counted: in the result and in the file."""
    feed = Feed(shm_namespace, "/a", slots=4)
    with recording(shm_namespace, tmp_path / "r") as recorder:
        feed.number(1)
        until(lambda: received(recorder) == 1, recorder)
        for number in range(2, 2002):  # far more than four slots, in less than a tick
            feed.number(number)
        feed.number(2002)
        until(lambda: read_count(recorder) >= 2002, recorder)
        result = recorder.stop()
    feed.close()
    topic = result.topics["/a"]
    assert topic.lost > 0 and topic.received + topic.lost == 2002
    found = numbers(result.files[0].path)
    assert found == sorted(found) and len(found) == topic.received
    said = metadata(result.files[0].path)
    assert json.loads(said["lost"]) == {"/a": topic.lost} and said["lost_total"] == str(topic.lost)


def read_count(recorder) -> int:
    """Return how many messages are accounted for."""
    progress = recorder.progress()
    return progress.received + progress.lost


def test_channels_come_and_go(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A channel that comes later, or is replaced, is recorded; another layout is a channel of its own."""
    with recording(shm_namespace, tmp_path / "r") as recorder:
        late = Feed(shm_namespace, "/a")
        for number in range(1, 6):
            late.number(number)
        until(lambda: received(recorder) == 5, recorder)
        late.channel.retire()
        again = Feed(shm_namespace, "/a", limits=Limits(string=20))
        again.number(6)
        until(lambda: received(recorder) == 6, recorder)
        again.channel.retire()
        same = Feed(shm_namespace, "/a", limits=Limits(string=20))
        same.number(7)
        until(lambda: received(recorder) == 7, recorder)
        result = recorder.stop()
    same.close()
    assert numbers(result.files[0].path) == list(range(1, 8))
    with result.files[0].path.open("rb") as opened:
        summary = make_reader(opened).get_summary()
    assert summary is not None and len(summary.channels) == 2


def test_what_a_retired_channel_still_held_is_lost(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A channel that is retired before everything was taken gives no more; what it held is counted."""
    feed = Feed(shm_namespace, "/a", slots=4096)
    with recording(shm_namespace, tmp_path / "r") as recorder:
        feed.number(1)
        until(lambda: received(recorder) == 1, recorder)
        for number in range(2, 1001):
            feed.number(number)
        feed.channel.retire()
        until(lambda: read_count(recorder) == 1000, recorder)


def test_what_came_before_a_new_channel_was_found_is_lost(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A channel that is made while recording counts from its first message, taken or not."""
    with recording(shm_namespace, tmp_path / "r") as recorder:
        feed = Feed(shm_namespace, "/a", slots=4)
        for number in range(1, 21):
            feed.number(number)
        until(lambda: read_count(recorder) == 20, recorder)
        result = recorder.stop()
    feed.close()
    assert (
        result.topics["/a"].received <= 20 and result.topics["/a"].lost == 20 - result.topics["/a"].received
    )


def test_only_what_was_asked_for(shm_namespace: Namespace, tmp_path: Path) -> None:
    """Patterns choose topics and leave others out."""
    feeds = [Feed(shm_namespace, topic) for topic in ("/r1/a", "/r1/b", "/r2/a")]
    selection = Selection(("/r1/*",), ("*b",))
    with recording(shm_namespace, tmp_path / "r", selection=selection) as recorder:
        for feed in feeds:
            feed.number(1)
        until(lambda: received(recorder) == 1, recorder)
        result = recorder.stop()
    for feed in feeds:
        feed.close()
    assert set(result.topics) == {"/r1/a"}
    assert Selection(("/x", "r1/a")).without_match(["/r1/a"]) == ["/x"]


def test_messages_are_in_the_file_before_its_end(shm_namespace: Namespace, tmp_path: Path) -> None:
    """What is older than a chunk's time is in the file while it is being written."""
    feed = Feed(shm_namespace, "/a")
    with recording(shm_namespace, tmp_path / "r", flush_ns=50_000_000) as recorder:
        for number in range(1, 11):
            feed.number(number)
        until(lambda: len(read_from_the_front(tmp_path / "r.mcap")) == 10, recorder)
    feed.close()


def test_a_bit_saves_the_last_minutes(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A ring buffer is saved each time a field becomes true, with what came before and after it."""
    feed, bit = Feed(shm_namespace, "/a"), Feed(shm_namespace, "/bit", "std_msgs/msg/Bool")
    keep = {
        "keep_ns": 60 * 10**9,
        "flush_ns": 50_000_000,
        "triggers": ("/bit.data", "/a.pose.position.x > 999"),
    }
    with recording(shm_namespace, tmp_path / "r", **keep) as recorder:
        until(lambda: len(recorder.inlet.counts) == 2, recorder)
        bit.send({"data": False})
        for number in range(1, 11):
            feed.number(number)
        until(lambda: received(recorder) == 11, recorder)
        assert not list(tmp_path.iterdir())
        for value in (True, True):
            bit.send({"data": value})
        until(lambda: recorder.progress().files == 1, recorder)
        feed.number(11)
        feed.number(1000)
        until(lambda: recorder.progress().files == 2, recorder)
        result = recorder.stop()
    feed.close()
    bit.close()
    first, second = result.files
    assert numbers(first.path)[:10] == list(range(1, 11))
    assert numbers(second.path) == [*range(1, 12), 1000]
    assert json.loads(metadata(first.path)["trigger"]) == ["/bit.data"]
    assert result.saves == ("/bit.data", "/a.pose.position.x > 999")
    assert len(list(tmp_path.iterdir())) == 2


def test_an_event_saves_the_last_minutes(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A message that the bridge refuses saves a ring buffer with the trigger `error`."""
    feed = Feed(shm_namespace, "/a")
    keep = {"keep_ns": 60 * 10**9, "flush_ns": 50_000_000, "triggers": ("error",)}
    with recording(shm_namespace, tmp_path / "r", **keep) as recorder:
        feed.number(1)
        until(lambda: received(recorder) == 1, recorder)
        recorder.look_after()

        def refuse() -> bool:
            feed.writer.refuse(4)
            return bool(recorder.progress().files)

        until(refuse, recorder)
        result = recorder.stop()
    feed.close()
    assert "refused" in result.saves[0]
    assert numbers(result.files[0].path) == [1]


def test_a_trigger_before_the_end_is_saved(shm_namespace: Namespace, tmp_path: Path) -> None:
    """Who stops a recorder that waits for what comes after a trigger gets the file anyway."""
    feed = Feed(shm_namespace, "/a")
    with recording(
        shm_namespace, tmp_path / "r", keep_ns=10**10, after_ns=3600 * 10**9, most_files=1
    ) as recorder:
        feed.number(1)
        until(lambda: received(recorder) == 1, recorder)
        recorder.trigger("by hand")
        recorder.look_after()
        result = recorder.stop()
    feed.close()
    assert result.saves == ("by hand",) and numbers(result.files[0].path) == [1]


def test_no_more_files_than_asked_for(shm_namespace: Namespace, tmp_path: Path) -> None:
    """Triggers beyond the number of files are counted, and fill no disk."""
    with recording(shm_namespace, tmp_path / "r", keep_ns=10**10, flush_ns=1, most_files=1) as recorder:
        recorder.trigger("one")
        until(lambda: recorder.progress().files == 1, recorder)
        recorder.trigger("two")
        recorder.look_after()
        result = recorder.stop()
    assert (len(result.files), result.unsaved) == (1, 1)


def test_a_save_that_failed_is_not_told_as_one(
    shm_namespace: Namespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk when a trigger fires is an error, and the result names nothing as saved."""
    feed = Feed(shm_namespace, "/a")
    with recording(shm_namespace, tmp_path / "r", keep_ns=10**10, after_ns=3600 * 10**9) as recorder:
        feed.number(1)
        until(lambda: received(recorder) == 1, recorder)
        recorder.trigger("by hand")

        def full(*_: object) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

        monkeypatch.setattr("rosplc.recorder.mcap_file.McapFile.append", full)
        with pytest.raises(RecordingError, match="REC002"):
            recorder.stop()
    feed.close()
    assert result_of(recorder).saves == ()


def test_triggers_without_a_channel_are_known(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A condition on a topic that nobody has is listed until its channel comes."""
    feed = Feed(shm_namespace, "/a")
    triggers = ("error", "/a.pose.position.x > 1", "/late.data")
    with recording(shm_namespace, tmp_path / "r", keep_ns=10**10, triggers=triggers) as recorder:
        assert recorder.idle_triggers() == {"/late.data": "/late"}
        late = Feed(shm_namespace, "/late", "std_msgs/msg/Bool")
        until(lambda: not recorder.idle_triggers(), recorder)
    feed.close()
    late.close()


def chunk(size: int) -> SealedChunk:
    return SealedChunk(bytes(size), ChunkIndex(size, 0, "", size, 0, 0, {}, 0, size), {1: 1})


def test_a_ring_stays_within_its_size_and_time() -> None:
    """The oldest chunks give way; that memory and not time was the reason is known."""
    ring = Ring(10**12, 10_000)
    for _ in range(100):
        ring.take(chunk(1_000))
        assert ring.size <= 10_000
    assert 0 < len(ring.chunks()) < 10 and ring.cut_short
    clock = SteppedClock()
    old = Ring(3_000_000_000, 10_000, clock)
    for _ in range(8):
        old.take(chunk(10))
        clock.advance(1)
    assert len(old.chunks()) == 4 and not old.cut_short


def test_names_that_are_taken_are_passed_over(tmp_path: Path) -> None:
    """A file's, a folder's and a part's name are taken; the next free one has a number."""
    base = dated(tmp_path / "r", 0.0)
    assert base.name.startswith("r_19")
    assert free_name(base) == base
    base.with_name(base.name + ".mcap").touch()
    base.with_name(base.name + "-2_0.mcap").touch()
    base.with_name(base.name + "-3").mkdir()
    assert free_name(base).name == base.name + "-4"


JOINT = compute_layout(TypeStore.bundled("jazzy"), "sensor_msgs/msg/JointState", Limits(sequence=3))


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("/j.position[1] > 1.5", True),
        ("/j.position[1] >= 2", True),
        ("/j.position[1]<2", False),
        ("/j.position[7] > 0", False),
        ("/j.velocity[0] != 0", False),
        ("/j.header.stamp.sec", True),
        ("/j.header.stamp.nanosec", False),
        ("/j.header.frame_id == 'map'", True),
        ('/j.name[1] != "a"', True),
        ("/j.header.stamp.sec == 7e0", True),
        ("/j.header.stamp.sec == true", False),
    ],
)
def test_conditions(text: str, holds: bool) -> None:
    """A condition compares numbers, texts and elements; an element that is not there fulfils none."""
    condition = parse_condition(text)
    condition.check(JOINT)
    value = {"header": {"frame_id": "map", "stamp": {"sec": 7}}, "name": ["a", "b"], "position": [1.0, 2.0]}
    assert condition.holds(JOINT.view(JOINT.pack(value))) is holds


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("fault", "is not a trigger"),
        ("/a.b >", "is not a trigger"),
        ("/a.b > x", "not a number, true"),
        ("/j.positions[0]", "it has"),
        ("/j.sec", "header.stamp.sec"),
        ("/j.position", "several elements"),
        ("/j.name[0]", "is a string"),
        ("/j.name[0] > 'a'", "is a string"),
        ("/j.position[0] == 'a'", "is not a string"),
    ],
)
def test_conditions_that_cannot_be(text: str, says: str) -> None:
    """A condition that cannot be understood, or does not fit the type, is refused in words."""
    with pytest.raises(RecordingError, match=says) as caught:
        parse_condition(text).check(JOINT)
    assert caught.value.code == "REC005"


def test_a_wrong_field_ends_the_start(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A trigger on a field that the topic's type does not have is an error before anything is recorded."""
    feed = Feed(shm_namespace, "/a")
    with (
        pytest.raises(RecordingError) as caught,
        recording(shm_namespace, tmp_path / "r", keep_ns=10**9, triggers=("/a.pose.x",)),
    ):
        pass
    feed.close()
    assert caught.value.code == "REC005" and "pose.position.x" in caught.value.what


def test_messages_that_the_disk_has_no_time_for_are_counted(shm_namespace: Namespace, tmp_path: Path) -> None:
    """Where writing fails, what is taken from then on is counted as lost, and the error is told."""
    feed = Feed(shm_namespace, "/a")
    with recording(shm_namespace, tmp_path / "r", flush_ns=10_000_000) as recorder:
        feed.number(1)
        until(lambda: len(read_from_the_front(tmp_path / "r.mcap")) == 1, recorder)

        def fail(_: object) -> None:
            raise RecordingError("REC002", "no room")

        recorder._outlet._take = fail
        feed.number(2)
        with pytest.raises(RecordingError):
            until(lambda: False, recorder)
        recorder.stop()
    feed.close()
    result = result_of(recorder)
    assert (result.topics["/a"].received, result.topics["/a"].lost) == (1, 1)
    assert numbers(tmp_path / "r.mcap") == [1]
