"""What tests of recordings share: channels of real types, recorders that run, files as others see them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mcap.exceptions import EndOfFile, McapError
from mcap.reader import NonSeekingReader

from rosplc.described import description_of
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.recorder import Recorder, RecordingOptions, Result
from rosplc.recorder.replay import (
    Player,
    ReplayOptions,
    SentCount,
    Target,
    wait_for_answers,
    wait_for_readers,
)
from rosplc.recorder.source import Source, SourceTopic
from rosplc.shm import Direction, Namespace, OwnedChannel, Writer, attach
from tests.lib.waiting import wait_for

POSE = "geometry_msgs/msg/PoseStamped"


class Feed:
    """A channel and its writer: the bridge's towards the PLC, the PLC's towards ROS."""

    def __init__(
        self,
        namespace: Namespace,
        topic: str,
        type_name: str = POSE,
        *,
        direction: Direction = Direction.TO_PLC,
        slots: int = 256,
        limits: Limits | None = None,
        store: TypeStore | None = None,
    ) -> None:
        store = store or TypeStore.bundled("jazzy")
        self.layout: Layout = compute_layout(store, type_name, limits)
        self.topic = topic
        self.channel = OwnedChannel.open(
            namespace,
            description_of(self.layout, topic, direction, bridge="test"),
            record_size=self.layout.size,
            slots=slots,
        )
        self._plc = None
        if direction is Direction.TO_PLC:
            self.writer: Writer = self.channel.writer()
        else:
            self._plc = attach(namespace, topic, write=True)
            self.writer = self._plc.writer()

    def send(self, value: Any, stamp_ns: int = 0) -> int:
        return self.writer.publish(
            self.layout.pack(value), stamp_ns=stamp_ns, stamp_clock=1 if stamp_ns else 0
        )

    def number(self, number: int) -> int:
        """Send a message that carries a number."""
        return self.send(
            {"header": {"frame_id": "map"}, "pose": {"position": {"x": number}}}, stamp_ns=number
        )

    def close(self) -> None:
        if self._plc is not None:
            self._plc.close()
        self.channel.close()


def until(condition: Callable[[], object], recorder: Recorder | None = None) -> None:
    """Wait for a condition, looking after a recorder meanwhile."""

    def met() -> object:
        if recorder is not None:
            recorder.look_after()
        return condition()

    wait_for(met)


@contextmanager
def recording(namespace: Namespace, base: Path, **more: Any) -> Iterator[Recorder]:
    """Run a recorder; it is stopped at the end, whatever happens."""
    recorder = Recorder(RecordingOptions(namespace, base, **more))
    recorder.start()
    try:
        yield recorder
    finally:
        if recorder.result is None:
            recorder.stop()


def received(recorder: Recorder) -> int:
    return recorder.progress().received


def result_of(recorder: Recorder) -> Result:
    assert recorder.result is not None
    return recorder.result


def play(source: Source, target: Target, topics: dict[str, SourceTopic]) -> SentCount:
    """Play one topic's messages into a target as fast as possible; return what became of them."""
    stopped = threading.Event()
    try:
        assert wait_for_readers(target, 30, stopped.wait) == []
        Player(source, target, topics, ReplayOptions(speed=0)).play(stopped.wait)
        wait_for_answers(target, stopped.wait)
    finally:
        target.close()
    [count] = target.counts.values()
    return count


def read_from_the_front(path: Path) -> list[tuple[str, int, bytes]]:
    """Return topic, sequence and bytes of every message that the mcap library reads before a file ends."""
    found = []
    with path.open("rb") as file:
        try:
            for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                found.append((channel.topic, message.sequence, message.data))
        except (EndOfFile, McapError, EOFError, ValueError, IndexError) as error:
            assert found or error
        except Exception as error:  # struct.error has no better base
            assert type(error).__name__ == "error", error
    return found
