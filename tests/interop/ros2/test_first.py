"""The first messages of a volatile publisher on rmw_fastrtps, sent from the moment of the match on."""

from __future__ import annotations

import pytest

from rosplc.ros import Backend, Qos
from tests.interop.ros2.conftest import Peer
from tests.lib.waiting import wait_for

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(300)]

BYTES = "std_msgs/msg/UInt8MultiArray"
COUNT = 20


def test_only_the_first_messages_may_be_lost(node: Backend, peer: Peer) -> None:
    """Over Fast DDS all arrive; Cyclone DDS begins behind the writer's first heartbeat, misses none then."""
    got: list[int] = []
    peer.advertise("/from", BYTES, depth=COUNT)
    peer.tell(fill="/from", size=4, count=COUNT, period=0.05)  # begins once there is a subscriber
    node.subscribe("/from", BYTES, Qos(depth=COUNT), lambda data, _: got.append(data[-1]))
    wait_for(lambda: got and got[-1] == COUNT - 1, "the last message")
    assert got == list(range(got[0], COUNT))
    assert got[0] == 0 or node.name == "dds"
