"""What a Zenoh subscription makes of the numbers that its publishers' messages carry."""

from __future__ import annotations

import logging
from types import SimpleNamespace

import pytest

pytest.importorskip("zenoh", reason="no wheel of eclipse-zenoh for this machine")

import zenoh

from rosplc.clock import SYSTEM
from rosplc.ros import Qos
from rosplc.ros.zenoh import keys as attachment
from rosplc.ros.zenoh.endpoint import ZenohSubscription
from rosplc.ros.zenoh.keys import Entity

LOGGER = logging.getLogger(__name__)
ONE, OTHER = bytes(16), bytes(range(16))


class Subscription:
    """A subscription to which samples are given as the library would."""

    def __init__(self, depth: int = 1000) -> None:
        self.got: list[bytes] = []
        entity = Entity(
            0, "a", "0", "1", "MS", "/", "node", "/t", "std_msgs/msg/String", "h", Qos(depth=depth)
        )
        node = SimpleNamespace(
            clock=SYSTEM, wake=lambda _: None, diagnose=lambda _: ("", ""), others=lambda _: (), logger=LOGGER
        )
        self.subscription = ZenohSubscription(lambda data, _: self.got.append(data), node, entity)

    def hear(self, *numbers: int, gid: bytes = ONE) -> None:
        for number in numbers:
            head = attachment.pack(number, 0, gid)
            self.give(b"\0\1\0\0" + number.to_bytes(8, "little"), head)

    def give(self, payload: bytes, head: bytes | None) -> None:
        wrapped = [
            None if data is None else SimpleNamespace(to_bytes=lambda d=data: d) for data in (payload, head)
        ]
        sample = SimpleNamespace(kind=zenoh.SampleKind.PUT, payload=wrapped[0], attachment=wrapped[1])
        self.subscription.arrived(sample)

    def counts(self) -> tuple[int, int]:
        """Hand everything over; return delivered and dropped."""
        for _ in range(5000):
            self.subscription.deliver_next()
        status = self.subscription.status()
        return status.received, status.dropped


@pytest.mark.parametrize(
    ("numbers", "dropped"),
    [
        ((1, 2, 3), 0),
        ((7, 8, 9), 0),  # came late: what was before was for others
        ((1, 5), 3),
        ((1, 3, 5, 6, 10), 5),
        ((5, 5, 4, 6), 0),  # out of order or twice is no loss
        ((1, 2**62), 0),  # nonsense
        ((2**62, 1, 2, 4), 1),  # and back
    ],
)
def test_gaps_are_counted(numbers: tuple[int, ...], dropped: int) -> None:
    """What is missing between two messages of one publisher was lost on the way."""
    one = Subscription()
    one.hear(*numbers)
    assert one.counts() == (len(numbers), dropped)


def test_each_publisher_has_numbers_of_its_own() -> None:
    """Publishers are told apart by their ids."""
    one = Subscription()
    for number in range(1, 50):
        one.hear(number)
        one.hear(1000 + 2 * number, gid=OTHER)
    assert one.counts() == (98, 48)


def test_overrun_and_gap_add_up() -> None:
    """What gives way in the queue and what was lost before are both counted, each once."""
    one = Subscription(depth=3)
    one.hear(1, 2, 3, 4, 5, 9)
    assert one.counts() == (3, 6)


def test_memory_of_publishers_is_bounded() -> None:
    """Made-up senders' ids take up no more memory than a thousand real ones."""
    one = Subscription()
    for number in range(5000):
        one.hear(1, gid=number.to_bytes(16, "little"))
    assert len(one.subscription._sequences) <= 1024


@pytest.mark.parametrize(
    "head", [None, b"", bytes(32), attachment.pack(-1, 0, ONE), attachment.pack(1, -1, ONE)]
)
def test_samples_of_no_ros_node_are_counted_as_such(head: bytes | None) -> None:
    """Without a proper attachment a sample is refused, and moves no numbers."""
    one = Subscription()
    one.hear(1)
    one.give(b"\0\1\0\0abcd", head)
    one.hear(2)
    assert one.counts() == (2, 0)
    assert one.subscription.status().rejected == 1
