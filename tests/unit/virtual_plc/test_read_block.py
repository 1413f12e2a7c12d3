"""The Read block over real objects: what its outputs say, and when."""

from __future__ import annotations

import threading

import pytest

from rosplc.errors import LayoutError
from rosplc.shm import Direction
from rosplc.virtual_plc import ReadBlock, Task

INT = "std_msgs/msg/Int32"
TO_PLC = Direction.TO_PLC


def reading(side_, **settings) -> ReadBlock:
    return ReadBlock(side_.topic, prefix=side_.namespace.prefix, **settings)


def test_a_message_shows_as_new_for_one_call(side, scans):
    """XNew is set in the call that took the message, msg stays."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge)
    scans(block)
    assert (block.xAttached, block.xValid, block.xNew, block.xStale) == (True, False, False, True)
    bridge.send(data=5)
    scans(block)
    assert (block.xValid, block.xNew, block.xStale, block.msg.data) == (True, True, False, 5)
    assert (block.udiSequence, block.info.stamp_ns) == (1, 7)
    scans(block)
    assert (block.xValid, block.xNew, block.msg.data) == (True, False, 5)
    block.close()


def test_what_was_sent_before_the_attach_is_shown_but_never_new(side, scans):
    """Rule M14: a retained command is not executed after STOP → RUN."""
    bridge = side("/n", INT, TO_PLC)
    bridge.send(data=3)
    block = reading(bridge)
    scans(block)
    scans(block)
    assert (block.xValid, block.xNew, block.xStale, block.msg.data) == (True, False, True, 3)


def test_a_latched_block_takes_what_is_there_as_new(side, scans):
    """With latched=True the state found at the first attach is news."""
    bridge = side("/n", INT, TO_PLC)
    bridge.send(data=3)
    block = reading(bridge, latched=True)
    scans(block)
    assert (block.xNew, block.msg.data) == (True, 3)


def test_latest_skips_and_counts(side, scans):
    """Mode latest takes the newest message and counts the others as lost."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge)
    scans(block)
    bridge.send(data=0)
    scans(block)
    for number in range(1, 4):
        bridge.send(data=number)
    scans(block)
    assert (block.msg.data, block.udiLost, block.uiTaken) == (3, 2, 1)


def test_what_came_before_the_first_message_is_no_loss(side, scans):
    """A block that attached before anything was sent counts from the first message it takes."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge)
    scans(block)
    for number in range(1, 4):
        bridge.send(data=number)
    scans(block)
    assert (block.msg.data, block.udiLost) == (3, 0)


def test_every_takes_all_in_order(side, scans):
    """Mode every takes one message per call and more with next(), up to its limit per scan."""
    bridge = side("/n", INT, TO_PLC, slots=16)
    block = reading(bridge, mode="every", max_per_cycle=3)
    scans(block)
    for number in range(1, 6):
        bridge.send(data=number)
    seen = []
    scans(lambda: seen.extend(message.data for message in block.each()))
    assert (seen, block.uiTaken) == ([1, 2, 3], 3)
    scans(lambda: seen.extend(message.data for message in block.each()))
    assert (seen, block.udiLost) == ([1, 2, 3, 4, 5], 0)


def test_every_counts_what_the_slots_could_not_hold(side, scans):
    """N slots hold N-1 messages; the others are counted as lost."""
    bridge = side("/n", INT, TO_PLC, slots=4)
    block = reading(bridge, mode="every")
    scans(block)
    bridge.send(data=0)
    scans(block)
    for number in range(1, 11):
        bridge.send(data=number)
    seen = []
    scans(lambda: seen.extend(message.data for message in block.each()))
    assert seen == [8, 9, 10]
    assert block.udiLost == 7


def test_age_and_staleness_follow_the_blocks_own_clock(side, scans):
    """XStale comes when nothing new arrived for longer than stale_after."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge, stale_after=0.2)
    scans(block)
    bridge.send(data=1)
    scans(block)
    scans(block, ms=200)
    assert (block.age, block.xStale) == (pytest.approx(0.2), False)
    scans(block, ms=1)
    assert block.xStale
    assert (block.xValid, block.msg.data) == (True, 1)
    bridge.send(data=2)
    scans(block)
    assert (block.xStale, block.age) == (False, 0.0)


def test_stale_after_none_is_never_stale(side, scans):
    """Without a limit nothing is ever stale, as with T#0ms in the PLC."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge, stale_after=None)
    scans(block)
    scans(block, ms=100_000)
    assert not block.xStale


@pytest.mark.parametrize(
    ("settings", "w"),
    [
        ({"on_stale": "zero"}, (0.0, 0.0)),
        ({"on_stale": "value", "stale_value": {}}, (0.0, 1.0)),
        ({"on_stale": "value", "stale_value": {"x": 0.5}}, (0.5, 1.0)),
        ({"on_stale": "hold"}, (0.25, 0.75)),
    ],
)
def test_on_stale_decides_what_msg_becomes(side, scans, settings, w):
    """Once stale, msg is the last message, all zeros, or the given values on top of the initial ones."""
    bridge = side("/q", "geometry_msgs/msg/Quaternion", TO_PLC)
    block = reading(bridge, stale_after=0.1, **settings)
    scans(block)
    bridge.send(x=0.25, w=0.75)
    scans(block)
    assert (block.msg.x, block.msg.w) == (0.25, 0.75)
    scans(block, ms=200)
    assert (block.msg.x, block.msg.w) == w


def test_a_state_found_at_the_start_does_not_show_through_a_safe_value(side, scans):
    """A retained command is stale: with a safe value, msg has that one from the first scan on."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge, layout=bridge.layout, on_stale="value", stale_value={"data": -1})
    bridge.send(data=3)
    for _ in range(3):
        scans(block)
        assert (block.xStale, block.xNew, block.xSubstituted, block.msg.data) == (True, False, True, -1)
    bridge.send(data=4)
    scans(block)
    assert (block.xStale, block.xSubstituted, block.msg.data) == (False, False, 4)


def test_the_first_message_after_silence_is_marked(side, scans):
    """XRecovered comes with the first message at all and the first one after xStale, and with no other."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge, stale_after=0.1)
    seen = []
    for pause in (1, 50, 200, 50, 500):
        scans(block, ms=pause)
        bridge.send(data=pause)
        scans(block)
        seen.append(block.xRecovered)
        scans(block)
        assert not block.xRecovered
    assert seen == [True, False, True, False, True]


def test_the_first_message_of_another_writer_is_marked(side, scans):
    """A bridge that was away for a moment only is noticed, even where its marked message was skipped."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge, stale_after=None)
    scans(block)
    bridge.send(data=1)
    scans(block)
    bridge.send(data=2)
    scans(block)
    assert (block.xNew, block.xRecovered) == (True, False)
    bridge.writer = bridge.channel.writer(beat_ms=100)
    bridge.send(data=3)
    bridge.send(data=4)
    scans(block)
    assert (block.xNew, block.xFirst, block.xRecovered) == (True, False, True)


def test_publishers_are_known_only_while_the_bridge_lives(side, scans):
    """What a dead bridge knew of ROS publishers is not shown as if it held now."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge)
    bridge.writer.set_sources(2)
    scans(block)
    assert (block.udiSources, block.xSourcePresent) == (None, False)
    bridge.writer.beat()
    scans(block)
    assert (block.udiSources, block.xSourcePresent) == (2, True)
    bridge.writer.set_sources(0)
    bridge.writer.beat()
    scans(block)
    assert (block.udiSources, block.xSourcePresent) == (0, False)
    bridge.writer.set_sources(1)
    scans(block, ms=60_000)
    assert (block.xPeerAlive, block.udiSources, block.xSourcePresent) == (False, None, False)


def test_a_stale_value_that_does_not_fit_is_found_at_the_start(side):
    """A wrong stale_value shows when the program starts, not when data stops."""
    bridge = side("/n", INT, TO_PLC)
    with pytest.raises(LayoutError, match="LAY006"):
        reading(bridge, layout=bridge.layout, on_stale="value", stale_value={"data": "five"})


def test_the_peer_is_alive_while_it_beats(side, scans):
    """XPeerAlive follows the writer's beat; a silent writer gives error 125."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge)
    scans(block)
    bridge.writer.beat()
    scans(block)
    assert (block.xPeerAlive, block.udiError) == (True, 0)
    scans(block, ms=2000)
    assert (block.xPeerAlive, block.udiError, block.xAttached) == (False, 125, True)
    bridge.writer.beat()
    scans(block)
    assert (block.xPeerAlive, block.udiError) == (True, 0)


def test_an_absent_object_is_error_101_until_it_appears(side, shm_namespace, scans):
    """The block may start before the bridge: it tries again with back-off and raises nothing."""
    block = ReadBlock("/n", prefix=shm_namespace.prefix)
    scans(block)
    assert (block.udiError, block.xValid, block.msg) == (101, False, None)
    side("/n", INT, TO_PLC)
    scans(block, ms=1)
    assert block.udiError == 101, "the back-off was not kept"
    scans(block, ms=2000)
    assert (block.udiError, block.xAttached) == (0, True)


def test_a_retired_object_is_left_and_its_successor_found(side, scans):
    """RETIRED is noticed at the next call; a new object under the name is opened by itself."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge)
    scans(block)
    bridge.send(data=1)
    scans(block)
    bridge.channel.retire()
    scans(block, ms=50)
    assert not block.xAttached
    assert (block.xValid, block.msg.data) == (True, 1)
    after = side("/n", INT, TO_PLC, slots=8)
    scans(block, ms=3000)
    assert block.xAttached
    after.send(data=2)
    scans(block)
    assert (block.xNew, block.msg.data) == (True, 2)


def test_an_object_that_was_removed_and_made_again_is_found(side, scans):
    """Where the file was removed under a silent writer, the name leads to the new object."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge)
    scans(block)
    bridge.channel.path.unlink()
    bridge.namespace.lock_path("/n").unlink()
    after = side("/n", INT, TO_PLC)
    for _ in range(5):
        scans(block, ms=2000)
    after.send(data=9)
    scans(block)
    assert (block.xNew, block.msg.data) == (True, 9)


def test_next_after_the_object_was_retired_brings_nothing(side, scans):
    """An object that is retired in the middle of a scan ends its messages; nothing is raised."""
    bridge = side("/n", INT, TO_PLC, slots=16)
    block = reading(bridge, mode="every")
    scans(block)
    for number in range(3):
        bridge.send(data=number)
    seen = []

    def program():
        block()
        bridge.channel.retire()
        seen.extend((block.next(), block.next()))

    scans(program)
    assert seen == [False, False]
    scans(block)
    assert not block.xAttached


def test_another_layout_is_refused_and_named(side, scans):
    """A compiled-in layout that differs gives error 112 and says what differs."""
    bridge = side("/j", "sensor_msgs/msg/JointState", TO_PLC, fields={"name": 6})
    other = side("/other", "sensor_msgs/msg/JointState", TO_PLC, fields={"name": 4})
    block = reading(bridge, layout=other.layout)
    scans(block)
    assert (block.udiError, block.xAttached) == (112, False)
    assert "name" in block.reason
    assert bridge.layout.layout_id in block.reason


def test_another_layout_is_112_even_if_the_description_is_damaged(side, scans):
    """That layouts differ is certain from the ids; a damaged description only hides how."""
    bridge = side("/n", INT, TO_PLC)
    other = side("/other", "std_msgs/msg/String", TO_PLC)
    identity = bridge.channel.identity
    with open(bridge.channel.path, "r+b") as file:
        file.seek(identity.description_offset)
        file.write(b"\0" * identity.description_size)
    block = reading(bridge, layout=other.layout)
    scans(block)
    assert block.udiError == 112
    compiled = reading(bridge, layout=bridge.layout)
    scans(compiled)
    assert (compiled.udiError, compiled.xAttached) == (0, True), "a PLC does not need the description"
    described = reading(bridge)
    scans(described)
    assert described.udiError == 113


def test_a_successor_is_found_at_once_after_a_long_silence(side, scans):
    """Back-off from looking for a silent bridge does not delay the opening of a replaced object."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge)
    for _ in range(10):
        scans(block, ms=2000)
    bridge.channel.retire()
    side("/n", INT, TO_PLC, slots=8)
    scans(block, ms=1)
    assert block.xAttached


def test_the_wrong_direction_is_error_110(side, scans):
    """A Read block does not open an object towards ROS."""
    bridge = side("/n", INT, Direction.TO_ROS)
    block = reading(bridge)
    scans(block)
    assert block.udiError == 110


def test_a_new_type_under_the_name_is_taken_over_from_the_description(side, scans):
    """Without a compiled-in layout the block follows the object's own description."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge)
    scans(block)
    bridge.channel.retire()
    after = side("/n", "std_msgs/msg/String", TO_PLC)
    scans(block, ms=3000)
    scans(block, ms=3000)
    after.send(data="text")
    scans(block)
    assert block.msg.data == "text"


def test_one_attempt_to_open_per_scan_over_all_blocks(shm_namespace, side, scans):
    """Three blocks need three scans to open three objects."""
    blocks = [ReadBlock(f"/n{i}", prefix=shm_namespace.prefix) for i in range(3)]
    for i in range(3):
        side(f"/n{i}", INT, TO_PLC)
    attached = []
    for _ in range(3):
        scans(*blocks)
        attached.append(sum(block.xAttached for block in blocks))
    assert attached == [1, 2, 3]


def test_a_second_task_is_turned_away(side):
    """One instance belongs to one task; a call from another gives error 124 and changes nothing else."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge)
    first, second = Task("A", 1.0, programs=[block]), Task("B", 1.0, programs=[block])
    first.scan()
    bridge.send(data=1)
    second.scan()
    assert (block.udiError, block.udiReentries, block.xNew) == (124, 1, False)
    first.scan()
    assert (block.udiError, block.xNew) == (0, True)


def test_reentry_at_the_same_moment_is_turned_away(side):
    """A call while another is in progress returns at once."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge)
    block._busy.acquire()
    results = []
    thread = threading.Thread(target=lambda: results.append(block()))
    thread.start()
    thread.join(30)
    assert results == [False]
    assert block.udiError == 124


def test_the_task_shows_in_a_reader_line(side, scans):
    """People can see which task reads a topic, and what it has taken."""
    bridge = side("/n", INT, TO_PLC)
    block = reading(bridge)
    scans(block)
    bridge.send(data=1)
    scans(block)
    lines = [line for line in bridge.channel.snapshot().readers if line.claim]
    assert [(line.task, line.taken) for line in lines] == [("Test", 1)]
    block.close()
    assert not any(line.claim for line in bridge.channel.snapshot().readers)


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"stale_after": 0.0}, "stale_after"),
        ({"max_per_cycle": 0}, "max_per_cycle"),
        ({"on_stale": "value"}, "stale_value"),
        ({"stale_value": {"data": 1}}, "stale_value"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, word):
    """The message names the setting."""
    with pytest.raises(ValueError, match=word):
        ReadBlock("/n", **settings)
