"""What a watchdog is told: whether the threads that carry and beat go round."""

from __future__ import annotations

import threading

import pytest

from rosplc.ros.memory import MemoryPublisher
from tests.lib.waiting import wait_for
from tests.unit.bridge.conftest import Cell

INT = "std_msgs/msg/Int32"
BOTH = f"  /in: {{type: {INT}, to: plc}}\n  /out: {{type: {INT}, to: ros}}\n"
LONG_NS, SHORT_NS = 3_600_000_000_000, 400_000_000


def test_a_bridge_that_goes_round_is_not_stuck(cell: Cell) -> None:
    """A bridge that runs stands nowhere; one that is not started does."""
    bridge = cell.start(BOTH)
    assert bridge.stuck(LONG_NS) == ""
    bridge.stop()
    assert bridge.stuck(LONG_NS) == "the bridge has not been started"


def test_a_hanging_ros_side_is_noticed_and_forgotten(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """A publication that does not return counts as stuck after the time given, for as long as it hangs."""
    bridge = cell.start(BOTH)
    outgoing = cell.plc("/out")
    go_on = threading.Event()
    with monkeypatch.context() as patch:
        patch.setattr(MemoryPublisher, "write", lambda *_: go_on.wait(60) and None)
        outgoing.write({"data": 1})
        wait_for(lambda: "sends to ROS has been stuck" in bridge.stuck(SHORT_NS))
        assert bridge.stuck(LONG_NS) == ""
        go_on.set()
    wait_for(lambda: "towards ROS" not in bridge.stuck(SHORT_NS))


def test_a_hanging_keeper_is_noticed(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread that beats counts too."""
    bridge = cell.start(BOTH)
    go_on = threading.Event()
    for stream in bridge._streams:
        monkeypatch.setattr(stream, "check", lambda *_: go_on.wait(60) and False)
    wait_for(lambda: "heartbeat thread has been stuck" in bridge.stuck(SHORT_NS))
    go_on.set()
    wait_for(lambda: "heartbeat thread" not in bridge.stuck(2_000_000_000))
