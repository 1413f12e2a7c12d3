"""The public Python API over real objects."""

from __future__ import annotations

import threading

import pytest

import rosplc
from rosplc import ChannelError, Direction, LayoutError
from rosplc.described import described_layout, description_of
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Description, OwnedChannel
from rosplc.virtual_plc import ReadBlock
from tests.lib.waiting import repeat_until

STORE = TypeStore.bundled("jazzy")


class Bridge:
    """The bridge's hand on one topic."""

    def __init__(self, namespace, topic, type_name, direction, *, slots=8, limits=None):
        self.layout = compute_layout(STORE, type_name, limits or Limits())
        description = description_of(self.layout, topic, direction, bridge="test")
        self.channel = OwnedChannel.open(namespace, description, record_size=self.layout.size, slots=slots)
        if direction is Direction.TO_PLC:
            self.writer = self.channel.writer(beat_ms=100)
        else:
            self.reader = self.channel.reader(beat_ms=100)

    def send(self, **fields):
        return self.writer.publish(self.layout.pack(fields), stamp_ns=42)

    def take(self):
        record = bytearray(self.layout.size)
        return None if self.reader.next(record) is None else self.layout.view(record)


@pytest.fixture
def bridge(shm_namespace):
    made = []

    def make(topic="/n", type_name="std_msgs/msg/Int32", direction=Direction.TO_PLC, **settings):
        made.append(Bridge(shm_namespace, topic, type_name, direction, **settings))
        return made[-1]

    yield make
    for each in made:
        each.channel.close()


@pytest.fixture
def attach(shm_namespace):
    open_channels = []

    def make(topic="/n", **settings):
        open_channels.append(rosplc.attach(topic, prefix=shm_namespace.prefix, **settings))
        return open_channels[-1]

    yield make
    for each in open_channels:
        each.close()


def test_read_returns_each_message_once(bridge, attach):
    """read() gives the newest message once, typed, with its slot's facts in info."""
    side = bridge()
    channel = attach()
    assert channel.read() is None
    side.send(data=0)
    assert channel.read().data == 0
    side.send(data=1)
    side.send(data=2)
    message = channel.read()
    assert (message.data, channel.info.sequence, channel.info.stamp_ns, channel.lost) == (2, 3, 42, 1)
    assert channel.read() is None
    assert (channel.type_name, channel.direction) == ("std_msgs/msg/Int32", Direction.TO_PLC)


def test_current_shows_the_newest_message_again_and_again(bridge, attach):
    """current() does not care whether the message is new, and does not make it old."""
    side = bridge()
    side.send(data=5)
    channel = attach()
    assert channel.read() is None, "what was there at the attach is not new"
    assert channel.current().data == 5
    side.send(data=6)
    assert channel.current().data == 6
    assert channel.read().data == 6


def test_latched_takes_what_is_there(bridge, attach):
    """With latched=True the message that is there counts as new."""
    side = bridge()
    side.send(data=5)
    assert attach(latched=True).read().data == 5


def test_every_yields_in_order(bridge, attach):
    """every() yields each message once, in order, and ends with the last."""
    side = bridge()
    channel = attach()
    for number in range(5):
        side.send(data=number)
    assert [message.data for message in channel.every()] == [0, 1, 2, 3, 4]
    assert list(channel.every()) == []


def test_messages_outlive_the_next_one(bridge, attach):
    """A returned message never changes afterwards."""
    side = bridge()
    channel = attach()
    for number in range(3):
        side.send(data=number)
    kept = list(channel.every())
    side.send(data=99)
    channel.read()
    channel.close()
    assert [message.data for message in kept] == [0, 1, 2]


@pytest.mark.parametrize("timeout", [-1.0, float("nan")])
def test_what_is_no_time_to_wait_is_none(bridge, attach, timeout):
    """A negative timeout and NaN wait for nothing, and not for ever."""
    bridge()
    assert attach().wait(timeout) is None
    with pytest.raises(ChannelError, match="SHM101"):
        attach("/missing", timeout=timeout)


def test_wait_returns_when_a_message_comes(bridge, attach):
    """wait() comes back with the message, or with None when its time is over."""
    side = bridge()
    channel = attach()
    assert channel.wait(0.01) is None
    timer = threading.Timer(0.05, side.send, kwargs={"data": 3})
    timer.start()
    assert channel.wait(30).data == 3
    timer.join()


def test_wait_for_ever_holds_without_a_pause_too(bridge, attach):
    """Without a timeout wait() returns a message and nothing else, whatever its pause."""
    side = bridge()
    channel = attach()
    timer = threading.Timer(0.1, lambda: side.send(data=7))
    timer.start()
    message = channel.wait(poll=0.0)
    timer.join()
    assert message is not None
    assert message.data == 7


def test_write_takes_mappings_records_and_objects(bridge, attach):
    """What can be packed can be written, and arrives."""

    class Anything:
        data = 3

    side = bridge(direction=Direction.TO_ROS)
    with attach(write=True) as channel:
        assert channel.write({"data": 1}) == 1
        assert channel.write(Anything()) == 2
        assert channel.write(channel.current()) == 3
    assert [side.take().data for _ in range(3)] == [1, 3, 3]


def test_write_says_which_field_does_not_fit(bridge, attach):
    """A value out of range is refused with its path, and nothing is published."""
    side = bridge(type_name="geometry_msgs/msg/Twist", direction=Direction.TO_ROS)
    channel = attach(write=True)
    with pytest.raises(LayoutError, match=r"linear\.x"):
        channel.write({"linear": {"x": "fast"}})
    assert side.take() is None


def test_two_writers_are_refused(bridge, attach):
    """The second writer is told that the claim is held, and may have it when the first closes."""
    bridge(direction=Direction.TO_ROS)
    first = attach(write=True)
    stop = threading.Event()

    def beat():
        while not stop.wait(0.02):
            first.write({"data": 0})

    thread = threading.Thread(target=beat)
    thread.start()
    try:
        with pytest.raises(ChannelError) as caught:
            attach(write=True)
    finally:
        stop.set()
        thread.join()
    assert caught.value.code == "SHM114"
    first.close()
    assert attach(write=True).write({"data": 1}) > 0


def test_writing_needs_write(bridge, attach):
    """A channel attached for reading refuses to write: SHM122."""
    bridge(direction=Direction.TO_ROS)
    with pytest.raises(ChannelError, match="SHM122"):
        attach().write({"data": 1})


def test_writing_towards_the_plc_is_the_bridges(bridge, attach):
    """Only the bridge writes towards the PLC: SHM110."""
    bridge()
    with pytest.raises(ChannelError, match="SHM110"):
        attach(write=True)


def test_an_absent_object_is_an_error_unless_waited_for(bridge, attach, shm_namespace):
    """attach() raises SHM101 at once, or after its timeout, or returns when the object appears."""
    with pytest.raises(ChannelError, match="SHM101"):
        attach()
    with pytest.raises(ChannelError, match="SHM101"):
        attach(timeout=0.05)
    timer = threading.Timer(0.1, bridge)
    timer.start()
    assert attach(timeout=30).type_name == "std_msgs/msg/Int32"
    timer.join()


def test_a_layout_that_differs_is_refused(bridge, attach):
    """With an expected layout another one is SHM112."""
    bridge()
    other = compute_layout(STORE, "std_msgs/msg/Int64")
    with pytest.raises(ChannelError, match="SHM112"):
        attach(layout=other)


def test_a_channel_follows_its_name(bridge, attach):
    """After the bridge replaced the object the channel reads the new one, new type included."""
    side = bridge()
    channel = attach()
    side.channel.retire()
    assert channel.read() is None
    assert not channel.attached
    with pytest.raises(ChannelError, match="SHM101"):
        channel.snapshot()
    after = bridge(type_name="std_msgs/msg/String")
    repeat_until(channel.read, lambda: channel.attached)
    after.send(data="new")
    assert channel.read().data == "new"


def test_a_writer_follows_its_name(bridge, attach):
    """A write after the object was replaced goes to the new one."""
    side = bridge(direction=Direction.TO_ROS)
    channel = attach(write=True)
    channel.write({"data": 1})
    side.channel.retire()
    after = bridge(direction=Direction.TO_ROS)
    assert channel.write({"data": 2}) == 1
    assert after.take().data == 2


def test_a_task_shows_in_a_reader_line(bridge, attach):
    """With a task's name others can see who reads."""
    side = bridge()
    channel = attach(task="logger")
    assert [line.task for line in channel.snapshot().readers if line.claim] == ["logger"]
    channel.close()
    assert not any(line.claim for line in side.channel.snapshot().readers)


def test_an_observer_leaves_no_trace(bridge, attach):
    """Without a task nothing is claimed and the object is mapped read-only."""
    side = bridge()
    channel = attach()
    side.send(data=1)
    assert channel.read().data == 1
    assert not any(line.claim for line in side.channel.snapshot().readers)


def test_a_closed_channel_says_so(bridge, attach):
    """Using a closed channel is an error, closing it twice is not."""
    bridge()
    channel = attach()
    channel.close()
    channel.close()
    with pytest.raises(ValueError, match="closed"):
        channel.read()


def test_a_hostile_description_is_refused(bridge, attach, shm_namespace):
    """A description that lies about its layout is SHM113."""
    layout = compute_layout(STORE, "std_msgs/msg/Int32")
    description = Description(
        topic="/liar",
        type="std_msgs/msg/Int32",
        distro="jazzy",
        direction=Direction.TO_PLC,
        limits=layout.limits.to_dict(),
        layout_id="0123456789abcdef",
        bridge="test",
        definition="int32 data",
    )
    with pytest.raises(ChannelError, match="SHM113"):
        described_layout(description)
    with (
        OwnedChannel.open(shm_namespace, description, record_size=4),
        pytest.raises(ChannelError, match="SHM113"),
    ):
        attach("/liar")


@pytest.mark.parametrize(
    "changes",
    [
        {"definition": "no such syntax ::"},
        {"limits": {"string": "many"}},
        {"limits": {"fields": 3}},
        {"limits": {"fields": {"nothing": 3}}},
        {"type": "std_msgs/msg/Missing", "definition": ""},
    ],
)
def test_a_description_that_cannot_be_used_is_refused(attach, shm_namespace, changes):
    """Whatever is in a description, the answer is SHM113 and no other exception."""
    layout = compute_layout(STORE, "std_msgs/msg/Int32")
    facts = {
        "topic": "/odd",
        "type": "std_msgs/msg/Int32",
        "distro": "jazzy",
        "direction": Direction.TO_PLC,
        "limits": layout.limits.to_dict(),
        "layout_id": layout.layout_id,
        "bridge": "test",
        "definition": "int32 data",
    }
    description = Description(**{**facts, **changes})
    with (
        OwnedChannel.open(shm_namespace, description, record_size=4),
        pytest.raises(ChannelError, match="SHM113"),
    ):
        attach("/odd")


@pytest.mark.parametrize("record_size", [4, 16])
def test_a_header_that_disagrees_with_the_description_is_refused(attach, shm_namespace, record_size):
    """A record size that the described layout does not have is SHM113, or SHM112 for who expects it."""
    layout = compute_layout(STORE, "std_msgs/msg/Int64")
    description = Description(
        topic="/odd",
        type="std_msgs/msg/Int64",
        distro="jazzy",
        direction=Direction.TO_PLC,
        limits=layout.limits.to_dict(),
        layout_id=layout.layout_id,
        bridge="test",
        definition="int64 data",
    )
    with OwnedChannel.open(shm_namespace, description, record_size=record_size):
        with pytest.raises(ChannelError, match="SHM113"):
            attach("/odd")
        with pytest.raises(ChannelError, match="SHM112"):
            attach("/odd", layout=layout)
        for given, number in ((None, 113), (layout, 112)):
            block = ReadBlock("/odd", prefix=shm_namespace.prefix, layout=given)
            block()
            assert block.udiError == number


def test_topics_lists_live_and_unreadable_objects(bridge, shm_namespace):
    """topics() tells type, direction and who is alive, and names what cannot be read."""
    side = bridge("/a")
    bridge("/b", direction=Direction.TO_ROS)
    shm_namespace.path("/c").write_bytes(b"garbage")
    stop = threading.Event()

    def beat():
        while not stop.wait(0.01):
            side.writer.beat()

    thread = threading.Thread(target=beat)
    thread.start()
    try:
        states = rosplc.topics(shm_namespace.prefix)
    finally:
        stop.set()
        thread.join()
    assert [(state.topic, state.direction, state.writer_alive) for state in states] == [
        ("/a", "to_plc", True),
        ("/b", "to_ros", False),
        ("/c", "", False),
    ]
    assert states[2].code == "SHM103"
    with pytest.raises(ChannelError, match="SHM118"):
        rosplc.topics("bad prefix")


def test_topics_knows_the_topic_of_a_shortened_name(bridge, shm_namespace):
    """A long topic's object name is shortened; its description still gives the topic."""
    topic = "/" + "/".join(["very_long_name"] * 8)
    bridge(topic)
    assert [state.topic for state in rosplc.topics(shm_namespace.prefix)] == [topic]


def test_a_writer_that_changes_objects_packs_for_the_new_one(bridge, attach, shm_namespace):
    """A message written at the moment in which the type changed never carries the old one's bytes."""
    first = bridge(direction=Direction.TO_ROS)
    channel = attach(write=True)
    channel.write({"data": -1})
    shm_namespace.path("/n").unlink()
    first.channel.close()
    second = bridge(type_name="std_msgs/msg/Float32", direction=Direction.TO_ROS)
    channel._moved_at = 0.0  # a second has passed
    channel.write({"data": 2.5})
    assert second.take().data == 2.5


def test_losses_are_counted_once_while_there_is_no_object(bridge, attach):
    """What was lost in an object is in `lost` once: with it, without it, and after close()."""
    one = bridge()
    channel = attach()
    one.send(data=1)
    channel.read()
    for number in range(3):
        one.send(data=number)
    channel.read()
    assert channel.lost == 2
    one.channel.retire()
    assert channel.read() is None
    assert not channel.attached
    assert channel.lost == 2
    bridge()
    repeat_until(channel.read, lambda: channel.attached)
    assert channel.lost == 2
    channel.close()
    assert channel.lost == 2


def test_a_failed_attach_gives_its_line_back(bridge, attach, monkeypatch):
    """Whatever interrupts an attach, no reader line stays claimed."""
    one = bridge(direction=Direction.TO_ROS)

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(rosplc.shm.Attached, "writer", interrupt)
    with pytest.raises(KeyboardInterrupt):
        attach(write=True, task="probe")
    assert [line.claim for line in one.channel.snapshot().readers[1:]] == [0, 0, 0]
