"""Large messages between rosplc and a real node on rmw_fastrtps with its default settings."""

from __future__ import annotations

import struct
import time
import zlib

import pytest

from rosplc.ros import Backend, Qos
from tests.interop.ros2.conftest import Peer
from tests.lib.waiting import repeat_until, wait_for

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(300)]

BYTES = "std_msgs/msg/UInt8MultiArray"
SIZES = [pytest.param(1 << 20, id="1 MB"), pytest.param(8 << 20, id="8 MB")]
COUNT = 5


def message(fill: int, size: int) -> bytes:
    """Return a serialized UInt8MultiArray; its length is a multiple of 4."""
    return b"\0\1\0\0" + struct.pack("<III", 0, 0, size) + bytes([fill]) * size


@pytest.mark.parametrize("size", SIZES)
def test_to_ros(node: Backend, peer: Peer, size: int) -> None:
    """Reliable messages of any size arrive whole, in order, and without a gap."""
    publisher = node.advertise("/to", BYTES, Qos(depth=COUNT))
    heard = peer.subscribe("/to", BYTES, depth=COUNT)
    wait_for(lambda: publisher.status().matched == 1, "the peer")
    sent = [message(number, size) for number in range(COUNT)]
    for number, payload in enumerate(sent):
        assert publisher.write(payload)
        wait_for(lambda number=number: len(heard) > number, f"message {number}")
    assert [(one["size"], one["crc"]) for one in heard] == [(len(one), zlib.crc32(one)) for one in sent]


@pytest.mark.parametrize("size", SIZES)
def test_from_ros(node: Backend, peer: Peer, size: int) -> None:
    """Reliable messages of any size arrive whole, in order, and without a gap."""
    got: list[bytes] = []
    inbox = node.subscribe("/from", BYTES, Qos(depth=COUNT), lambda data, _: got.append(data))
    peer.advertise("/from", BYTES, depth=COUNT)
    wait_for(lambda: inbox.status().matched == 1, "the peer")
    # Until its first heartbeat, Cyclone DDS may miss what a volatile publisher sends (test_first.py).
    repeat_until(
        lambda: peer.tell(fill="/from", size=4, count=1, period=0.0), lambda: len(got) > 9, "some", every=0.5
    )
    peer.tell(fill="/from", size=size, count=COUNT, period=0.5)
    wait_for(lambda: len([data for data in got if len(data) > 100]) >= COUNT, "all messages")
    large = [zlib.crc32(data) for data in got if len(data) > 100]
    assert large == [zlib.crc32(message(number, size)) for number in range(COUNT)]


def test_a_camera_reaches_a_node_with_default_buffers(node: Backend, peer: Peer) -> None:
    """Of 40 images of 900 kB at 5 Hz, at least 38 reach a subscriber with the default settings."""
    publisher = node.advertise("/image", BYTES, Qos(depth=5))
    heard = peer.subscribe("/image", BYTES, depth=5)
    wait_for(lambda: publisher.status().matched == 1, "the peer")
    for number in range(40):
        assert publisher.write(message(number, 921_600))
        time.sleep(0.2)
    wait_for(lambda: len(heard) >= 38, "38 of 40 images")
