"""The Write block over real objects: when it publishes, and when it may not."""

from __future__ import annotations

import copy

import pytest

from rosplc.errors import LayoutError
from rosplc.shm import Direction, attach
from rosplc.virtual_plc import Message, WriteBlock

INT = "std_msgs/msg/Int32"
TWIST = "geometry_msgs/msg/Twist"
TO_ROS = Direction.TO_ROS


def writing(side_, **settings) -> WriteBlock:
    block = WriteBlock(side_.topic, prefix=side_.namespace.prefix, **settings)
    assert not block.xEnable  # nothing is sent before a program says so
    block.xEnable = True
    return block


def test_each_enabled_call_publishes_one_message(side, scans):
    """Msg arrives as it was set, once per call, numbered and stamped by the PLC's clock."""
    bridge = side("/cmd", TWIST, TO_ROS)
    block = writing(bridge, layout=bridge.layout)
    block.msg.linear.x = 1.5
    scans(block)
    block.msg.angular.z = -0.5
    scans(block)
    info, first = bridge.take()
    assert (info.sequence, info.stamp_clock, first.linear.x, first.angular.z) == (1, 3, 1.5, 0.0)
    info, second = bridge.take()
    assert (info.sequence, second.linear.x, second.angular.z) == (2, 1.5, -0.5)
    assert bridge.take() is None
    assert (block.xPublished, block.udiSequence, block.udiPublished) == (True, 2, 2)


def test_a_disabled_call_sends_only_its_beat(side, scans):
    """XEnable FALSE publishes nothing, and the bridge still sees the PLC alive."""
    bridge = side("/n", INT, TO_ROS)
    block = writing(bridge)
    block.xEnable = False
    scans(block)
    before = bridge.channel.snapshot().writer.beat
    scans(block)
    assert bridge.take() is None
    assert bridge.channel.snapshot().writer.beat != before
    assert (block.xReady, block.xPublished) == (True, False)


def test_the_type_comes_from_the_description(side, scans):
    """Without a compiled-in layout msg is there as soon as the object is open."""
    bridge = side("/n", INT, TO_ROS)
    block = writing(bridge)
    assert block.msg is None
    block.xEnable = False
    scans(block)
    block.msg.data, block.xEnable = 7, True
    scans(block)
    assert bridge.take()[1].data == 7


def test_a_second_writer_is_refused_until_the_first_stops(side, scans):
    """Only one writer holds the claim; the other shows error 114 and may have it afterwards."""
    bridge = side("/n", INT, TO_ROS)
    one, two = writing(bridge), writing(bridge)
    one.xEnable = two.xEnable = False
    scans(one)
    scans(one, two)
    assert (one.xReady, two.xReady, two.udiError) == (True, False, 114)
    one.close()
    scans(two)
    assert (two.xReady, two.udiError) == (True, 0)


def test_a_silent_writer_loses_its_claim_and_notices(side, scans):
    """A writer that missed its beats is replaced, and stops with error 115 or 114 when it comes back."""
    bridge = side("/n", INT, TO_ROS)
    one, two = writing(bridge, beat_ms=50), writing(bridge, beat_ms=50)
    one.xEnable = two.xEnable = False
    scans(one)
    scans(two, ms=100)
    scans(two, ms=100)
    scans(two, ms=100)
    assert two.xReady
    scans(one)
    assert (one.xReady, one.udiError) == (False, 115)
    scans(one)
    assert (one.xReady, one.udiError) == (False, 114)
    scans(two)
    assert two.xReady


def test_a_read_only_object_cannot_be_written(side, scans, shm_namespace):
    """A Write block does not open an object towards the PLC: error 110."""
    bridge = side("/n", INT, Direction.TO_PLC)
    block = writing(bridge)
    scans(block)
    assert (block.udiError, block.xAttached, block.xPublished) == (110, False, False)


def test_an_absent_bridge_costs_nothing_but_the_message(shm_namespace, scans, side):
    """Before the bridge there is error 101; publishing starts by itself when it comes."""
    bridge = side("/n", INT, TO_ROS)
    layout = bridge.layout
    bridge.channel.retire()
    block = WriteBlock("/n", layout=layout, prefix=shm_namespace.prefix)
    scans(block)
    assert (block.udiError, block.xPublished) == (101, False)
    after = side("/n", INT, TO_ROS)
    block.msg.data, block.xEnable = 4, True
    scans(block, ms=3000)
    assert after.take()[1].data == 4


def test_a_retired_object_is_left(side, scans):
    """After RETIRED nothing more goes to the old object."""
    bridge = side("/n", INT, TO_ROS)
    block = writing(bridge)
    block.xEnable = False
    scans(block)
    block.xEnable = True
    observer = attach(bridge.namespace, "/n")
    bridge.channel.retire()
    scans(block)
    assert (block.xPublished, block.xAttached) == (False, False)
    assert observer.snapshot().writer.head == 0
    observer.close()


def test_what_nobody_filled_is_not_sent(side, scans):
    """An object with another layout creates msg again: that call publishes nothing, for nobody has set it."""
    bridge = side("/n", INT, TO_ROS)
    block = writing(bridge)
    scans(block)
    assert bridge.take() is None, "msg was made in this call"
    block.msg.data = 1
    scans(block)
    assert bridge.take()[1].data == 1
    bridge.channel.retire()
    after = side("/n", "std_msgs/msg/String", TO_ROS)
    block.msg.data = 2
    scans(block, ms=3000)
    assert (block.xPublished, after.take()) == (False, None)
    block.msg.data = "three"
    scans(block)
    assert after.take()[1].data == "three"


def test_another_layout_is_error_112(side, scans):
    """A compiled-in layout that differs is refused."""
    bridge = side("/n", INT, TO_ROS)
    other = side("/s", "std_msgs/msg/String", TO_ROS)
    block = writing(bridge, layout=other.layout)
    scans(block)
    assert block.udiError == 112
    assert "std_msgs/msg/Int32" in block.reason


def test_the_bridge_side_is_watched(side, scans):
    """XPeerAlive and udiTaken follow the bridge's reader line."""
    bridge = side("/n", INT, TO_ROS)
    block = writing(bridge)
    block.xEnable = False
    scans(block)
    block.xEnable = True
    scans(block)
    bridge.take()
    block.xEnable = False
    scans(block)
    assert (block.xPeerAlive, block.udiTaken) == (True, 1)
    scans(block, ms=5000)
    assert (block.xPeerAlive, block.udiError) == (False, 125)


def test_a_value_that_does_not_fit_is_the_programs_error(side, scans):
    """A wrong value raises LAY006 with the field's path and publishes nothing."""
    bridge = side("/cmd", TWIST, TO_ROS)
    block = writing(bridge, layout=bridge.layout)
    block.msg.linear.x = "fast"
    with pytest.raises(LayoutError, match=r"linear\.x"):
        scans(block)
    assert bridge.take() is None
    block.msg.linear.x = 1.0
    scans(block)
    assert bridge.take()[1].linear.x == 1.0


def test_messages_refuse_fields_that_the_type_does_not_have(side):
    """A misspelt field is an error and not a message without it."""
    bridge = side("/cmd", TWIST, TO_ROS)
    message = Message.initial(bridge.layout)
    with pytest.raises(AttributeError, match="no field 'lineal'"):
        message.lineal = 1
    with pytest.raises(AttributeError, match="no field 'q'"):
        message.update({"linear": {"q": 1}})
    message.linear = {"x": 2.0}
    assert (message.linear.x, message.linear.y) == (2.0, 0.0)
    assert copy.deepcopy(message) == message
    assert "linear" in dir(message)
    assert repr(message).startswith("Twist(linear=Vector3(x=2.0")


def test_messages_hold_lists_of_messages(side):
    """Elements that are messages can be appended as mappings and arrive."""
    bridge = side("/p", "geometry_msgs/msg/Polygon", TO_ROS)
    message = Message.initial(bridge.layout)
    message.points.append({"x": 1.0})
    view = bridge.layout.view(bridge.layout.pack(message))
    assert [point.x for point in view.points] == [1.0]
    again = Message.of(bridge.layout, view)
    assert again.points[0].x == 1.0
