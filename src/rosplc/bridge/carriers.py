"""The threads that carry, and the topics that they carry at present."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress

from rosplc._core._native import Fault
from rosplc.bridge.classic import ClassicCarrier
from rosplc.bridge.classic_to_plc import ClassicToPlc
from rosplc.bridge.classic_to_ros import ClassicToRos
from rosplc.bridge.to_plc import ToPlc
from rosplc.bridge.to_ros import Pump, ToRos
from rosplc.bridge.topic import Surroundings, Topic, log
from rosplc.config.resolve import TopicPlan
from rosplc.errors import ChannelError
from rosplc.shm import Direction

__all__ = ["Carriers"]

_HANGS = "the ROS side does not return from publishing; the bridge leaves it behind"


class Carriers:
    """The pump, and the carriers of classic topics.

    Args:
        around: What the bridge's topics share.
        tick_ns: How often the pump looks.
        on_due: Called, from any thread, when a message towards the PLC waits for its time.
    """

    def __init__(self, around: Surroundings, tick_ns: int, on_due: Callable[[int], None]) -> None:
        self._around = around
        self._tick_ns = tick_ns
        self._on_due = on_due
        self._pump: Pump | None = None
        self._classic_to_ros = ClassicCarrier("rosplc-classic-to-ros")
        self._classic_to_plc = ClassicCarrier("rosplc-classic-to-plc")
        self._topics: tuple[Topic, ...] = ()

    def make(self, plan: TopicPlan) -> Topic:
        """Return the topic of a plan; nothing is opened yet."""
        to_plc = plan.direction is Direction.TO_PLC
        if plan.classic is not None:
            if to_plc:
                return ClassicToPlc(plan, self._around, self._classic_to_plc.wake)
            return ClassicToRos(plan, self._around)
        return ToPlc(plan, self._around, self._on_due) if to_plc else ToRos(plan, self._around)

    @property
    def busy_since_ns(self) -> int:
        """Since when a thread has been publishing what it holds; 0 if none is."""
        pump = 0 if self._pump is None else self._pump.busy_since_ns
        return min((since for since in (pump, self._classic_to_ros.busy_since_ns) if since), default=0)

    @property
    def turned_ns(self) -> int:
        """When the pump last began a round."""
        return time.monotonic_ns() if self._pump is None else self._pump.turned_ns

    def start(self, topics: Iterable[Topic]) -> None:
        """Begin to carry topics that are open and joined."""
        self._topics = tuple(topics)
        self._pump = Pump(tuple(_in_pump(self._topics)), self._tick_ns)
        self._pump.start()
        self._classic_to_plc.start(tuple(_classic_to_plc(self._topics)))
        _await_subscribers(self._topics)
        self._classic_to_ros.start(tuple(_classic_to_ros(self._topics)))

    def reopen(self, topic: Topic, now_ns: int) -> None:
        """Have a topic's object opened again, by the thread that may."""
        if isinstance(topic, ToRos):
            if self._pump is not None:
                self._pump.reopen(topic)
        else:
            topic.reopen(now_ns)

    def replace(self, leaving: Collection[Topic], coming: Collection[Topic]) -> bool:
        """Carry other topics from now on; what the leaving ones still held has been passed on.

        Args:
            leaving: Topics to let go of; their endpoints and objects are still open.
            coming: Topics to carry as well; they are open and joined.

        Returns:
            False if the ROS side hangs; nothing has changed then.
        """
        assert self._pump is not None
        topics = (*(topic for topic in self._topics if topic not in leaving), *coming)
        _await_subscribers(coming)
        before = tuple(_classic_to_ros(self._topics)), tuple(_classic_to_plc(self._topics))
        after = tuple(_classic_to_ros(topics)), tuple(_classic_to_plc(topics))
        if before[0] != after[0] and not self._classic_to_ros.replace(after[0]):
            return False
        pump_leaving, pump_coming = tuple(_in_pump(leaving)), tuple(_in_pump(coming))
        if (pump_leaving or pump_coming) and not self._pump.replace(pump_leaving, pump_coming):
            self._classic_to_ros.replace(before[0])
            return False
        if before[1] != after[1]:
            self._classic_to_plc.replace(after[1])
        self._topics = topics
        for topic in leaving:
            _finish(topic)
        return True

    def stop_classic_to_plc(self) -> None:
        """End the thread that writes classic memory."""
        self._classic_to_plc.stop()

    def stop_classic_to_ros(self) -> None:
        """End the thread that reads classic memory; what waited for a subscriber is sent."""
        if not self._classic_to_ros.stop():
            log.error(_HANGS)
            return
        for topic in _classic_to_ros(self._topics):
            topic.finish(time.monotonic_ns())

    def stop_pump(self) -> None:
        """End the pump; what waited for a subscriber is sent."""
        if self._pump is not None and not self._pump.stop():
            log.error(_HANGS)


def _in_pump(topics: Iterable[Topic]) -> Iterable[ToRos]:
    return (topic for topic in topics if isinstance(topic, ToRos) and not isinstance(topic, ClassicToRos))


def _classic_to_ros(topics: Iterable[Topic]) -> Iterable[ClassicToRos]:
    return (topic for topic in topics if isinstance(topic, ClassicToRos))


def _classic_to_plc(topics: Iterable[Topic]) -> Iterable[ClassicToPlc]:
    return (topic for topic in topics if isinstance(topic, ClassicToPlc))


def _await_subscribers(topics: Iterable[Topic]) -> None:
    for topic in _classic_to_ros(topics):
        topic.await_subscriber(time.monotonic_ns())


def _finish(topic: Topic) -> None:
    """Pass on what a topic holds that no thread carries any more."""
    if isinstance(topic, ToRos):
        if not isinstance(topic, ClassicToRos):
            _drain(topic)
        topic.finish(time.monotonic_ns())
    if isinstance(topic, ToPlc) and (due := topic.due_ns) is not None:
        topic.flush(due)


def _drain(topic: ToRos) -> None:
    """Take what the PLC has written since the pump's last turn."""
    reader, record = topic.reader, bytearray(topic.plan.layout.size)
    if reader is None:
        return
    take = reader.next if topic.plan.every else reader.latest
    with suppress(ChannelError, ValueError, Fault):  # a damaged object: the pump has reported it
        for _ in range(topic.plan.slots):
            info = take(record)
            if info is None:
                return
            topic.on_message(topic.codec.encode(record), info.flags, info.stamp_ns, info.stamp_clock)
