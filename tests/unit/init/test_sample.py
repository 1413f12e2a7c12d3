"""How often a topic's messages come, where kept ones come first."""

from __future__ import annotations

import pytest

from rosplc.init.found import Meter
from rosplc.init.live import LiveRobot
from rosplc.model import TypeStore
from rosplc.ros import Qos, open_backend

STORE = TypeStore.bundled("jazzy")
STRING = "std_msgs/msg/String"
DATA = b"\0\1\0\0\2\0\0\0a\0"


def test_kept_messages_count_for_lengths_and_not_for_the_rate() -> None:
    """A thousand messages that are delivered at once and five seconds of 100 Hz are 100 Hz."""
    sample = Meter(STORE, STRING, settle_ns=10**9)
    for number in range(1000):
        sample.take(DATA, 10**12 + number * 1000)
    for number in range(500):
        sample.take(DATA, 10**12 + number * 10**7)
    seen = sample.finish(5.0)
    assert seen.rate_hz == pytest.approx(100.0)
    assert seen.messages == 1500 and seen.lengths["data"].most == 1


def test_without_kept_messages_the_first_counts() -> None:
    """A topic that keeps nothing is timed from its first message on."""
    sample = Meter(STORE, STRING)
    for number in range(3):
        sample.take(DATA, 10**12 + number * 10**8)
    assert sample.finish(1.0).rate_hz == pytest.approx(10.0)


def test_history_of_a_latched_topic_gives_no_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a publisher kept and delivers to a late subscriber is measured, and says nothing of its rate."""
    # No other node comes into a graph of this process.
    monkeypatch.setattr("rosplc.ros.backend._STEADY_NS", 100_000_000)
    # Longer than it asks for: a slow machine may take its time to deliver them.
    longer = lambda store, name, settle_ns: Meter(store, name, 1000 * settle_ns)  # noqa: E731
    monkeypatch.setattr("rosplc.init.live.Meter", longer)
    node = open_backend("memory", STORE, "robot", domain=231)
    latched = node.advertise("/kept", STRING, Qos(durability="transient_local", depth=1000))
    for _ in range(300):
        latched.write(DATA)
    robot = LiveRobot({"backend": "memory", "domain": 231})
    try:
        seen = robot.listen({"/kept": STRING}, 1.0, lambda _: None)["/kept"]
    finally:
        robot.close()
        node.close()
    assert seen.messages == 300
    assert seen.rate_hz == 0.0
