"""_native.Group: one tick over all channels."""

from __future__ import annotations

import gc
import resource
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

import rosplc._core as _native
from rosplc.codec import Codec, Wire
from rosplc.errors import ChannelError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Direction, Namespace, OwnedChannel, attach
from rosplc.shm.attach import Attached
from rosplc.shm.constants import READER_LINE, WRITER_LINE, reader_line
from tests.lib.channels import open_channel

_TICK = 1_000_000
_SECOND = 1_000_000_000
_Pair = tuple[OwnedChannel, Attached]


@pytest.fixture(scope="module")
def codec() -> Codec:
    return Codec(compute_layout(TypeStore.bundled("jazzy"), "geometry_msgs/msg/Point", Limits()), Wire.CDR)


def _record(codec: Codec, x: float) -> bytearray:
    return codec.layout.pack({"x": x})


@pytest.fixture
def pairs(shm_namespace: Namespace, codec: Codec) -> Iterator[list[_Pair]]:
    made: list[_Pair] = []
    for index in range(3):
        topic = f"/out{index}"
        channel = open_channel(
            shm_namespace, Direction.TO_ROS, topic=topic, record_size=codec.layout.size, slots=8
        )
        made.append((channel, attach(shm_namespace, topic, write=True)))
    yield made
    for channel, attached in made:
        attached.close()
        channel.close()


def test_everything_new_in_one_call(pairs: list[_Pair], codec: Codec) -> None:
    """One take() returns the newest or all messages of every channel, encoded, with their stamps."""
    group = _native.Group()
    writers = [attached.writer() for _, attached in pairs]
    newest = group.add_reader(pairs[0][0].reader(), codec.plan, 0)
    in_order = group.add_reader(pairs[1][0].reader(), codec.plan, 1)
    quiet = group.add_reader(pairs[2][0].reader(), codec.plan, 1)
    assert len({newest, in_order, quiet}) == 3
    assert group.take() == ([], [])
    for x in (1.0, 2.0, 3.0):
        writers[0].publish(_record(codec, x), stamp_ns=7, stamp_clock=3)
        writers[1].publish(_record(codec, x))
    assert group.wait(_TICK, 10 * _SECOND) == 2
    messages, faults = group.take()
    assert faults == []
    assert [(index, sequence) for index, _, sequence, *_ in messages] == [
        (newest, 3),
        (in_order, 1),
        (in_order, 2),
        (in_order, 3),
    ]
    assert messages[0][1] == codec.encode(_record(codec, 3.0))
    assert messages[0][4:] == (7, 3)
    assert messages[1][1] == codec.encode(_record(codec, 1.0))
    assert group.take() == ([], [])


def test_taken_is_stored_before_anything_is_handed_out(pairs: list[_Pair], codec: Codec) -> None:
    """What take() returned is never returned again, not even to the next bridge (M15)."""
    channel, attached = pairs[0]
    group = _native.Group()
    group.add_reader(channel.reader(), codec.plan, 1)
    attached.writer().publish(_record(codec, 1.0))
    assert len(group.take()[0]) == 1
    assert channel.region.word(reader_line(0) + READER_LINE["taken"]) == 1


def test_limit(pairs: list[_Pair], codec: Codec) -> None:
    """A channel hands out at most its limit per call, and the rest with the next."""
    channel, attached = pairs[0]
    group = _native.Group()
    group.add_reader(channel.reader(), codec.plan, 1, 2)
    writer = attached.writer()
    for x in range(5):
        writer.publish(_record(codec, float(x)))
    counts = []
    while group.wait(_TICK, 0):
        counts.append(len(group.take()[0]))
    assert counts == [2, 2, 1]


def test_timeout_and_wake(pairs: list[_Pair], codec: Codec) -> None:
    """wait() ends without news at its timeout, or when another thread wakes it."""
    group = _native.Group()
    group.add_reader(pairs[0][0].reader(), codec.plan)
    begin = time.monotonic()
    assert group.wait(_TICK, _SECOND // 20) == 0
    assert time.monotonic() - begin >= 0.05
    thread = threading.Timer(0.05, group.wake)
    thread.start()
    assert group.wait(_TICK) == 0
    thread.join()
    assert group.wait(0, _SECOND // 100) == 0


def test_wait_follows_a_grid(pairs: list[_Pair]) -> None:
    """Ticks lie on an absolute grid: work between two waits does not add up."""
    group = _native.Group()
    tick = 20_000_000
    begin = time.monotonic_ns()
    for _ in range(10):
        group.wait(tick, tick)
        time.sleep(0.002)
    assert time.monotonic_ns() - begin >= 9 * tick


@pytest.mark.parametrize("tick", [10 * _SECOND, 0])
def test_signal_interrupts_wait(tick: int) -> None:
    """A signal's handler runs while wait() sleeps or spins, and its exception comes through."""

    def handler(number: int, frame: object) -> None:
        raise InterruptedError("handled")

    before = signal.signal(signal.SIGALRM, handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises(InterruptedError):
            _native.Group().wait(tick)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_broken_channel_is_reported_once(pairs: list[_Pair], codec: Codec) -> None:
    """A retired object is a fault of its channel, once, and holds up no other."""
    group = _native.Group()
    first = group.add_reader(pairs[0][0].reader(), codec.plan, 1)
    second = group.add_reader(pairs[1][0].reader(), codec.plan, 1)
    for _, attached in pairs[:2]:
        attached.writer().publish(_record(codec, 1.0))
    pairs[0][0].region.store(12, 2)
    messages, faults = group.take()
    assert [index for index, *_ in messages] == [second]
    assert len(faults) == 1
    assert faults[0][0] == first
    assert isinstance(faults[0][1], ChannelError)
    assert faults[0][1].code == "SHM111"
    assert group.take() == ([], [])
    assert group.wait(_TICK, 0) == 0
    group.remove(first)


def test_scribbled_head_does_not_spin(pairs: list[_Pair], codec: Codec) -> None:
    """A head that its slot does not confirm is looked at now and then, not at every tick."""
    channel, attached = pairs[0]
    group = _native.Group()
    group.add_reader(channel.reader(), codec.plan, 1)
    writer = attached.writer()
    writer.publish(_record(codec, 1.0))
    assert len(group.take()[0]) == 1
    channel.region.store(WRITER_LINE["head"], 500)
    wakes = 0
    for _ in range(64):
        if group.wait(_TICK, _TICK):
            wakes += 1
            assert group.take() == ([], [])
    assert 1 <= wakes <= 8
    writer.publish(_record(codec, 2.0))
    messages, _ = group.take()
    assert [sequence for _, _, sequence, *_ in messages] == [2]


def test_remove_and_reuse(pairs: list[_Pair], codec: Codec) -> None:
    """A removed channel is let go of, and its index serves again."""
    group = _native.Group()
    index = group.add_reader(pairs[0][0].reader(), codec.plan)
    group.remove(index)
    with pytest.raises(IndexError):
        group.remove(index)
    pairs[0][1].writer().publish(_record(codec, 1.0))
    assert group.take() == ([], [])
    for _ in range(40):
        group.add_reader(pairs[1][0].reader(), codec.plan)
    assert group.add_reader(pairs[0][0].reader(), codec.plan) == 40
    with pytest.raises(IndexError):
        group.remove(-1)


def test_beat(pairs: list[_Pair]) -> None:
    """One call beats the lines of all readers and writers."""
    channel, attached = pairs[0]
    reader, writer = channel.reader(), attached.writer()
    before = channel.snapshot()
    _native.beat([reader, writer])
    after = channel.snapshot()
    assert after.writer.beat == before.writer.beat + 1
    assert after.readers[0].beat == before.readers[0].beat + 1


def test_all_beat_in_one_call(pairs: list[_Pair], codec: Codec) -> None:
    """Readers, writers and tuples of them beat; what is closed, released or None does not, others raise."""
    users = [(channel.reader(), attached.writer()) for channel, attached in pairs]

    def beats() -> list[tuple[int, int]]:
        found = [attached.snapshot() for _, attached in pairs]
        return [(each.readers[0].beat, each.writer.beat) for each in found]

    before = beats()
    _native.beat([users[0], None, *users[1], users[2][1]] * 20)
    assert beats() == [
        (before[0][0] + 20, before[0][1] + 20),
        (before[1][0] + 20, before[1][1] + 20),
        (before[2][0], before[2][1] + 20),
    ]
    users[0][1].release()
    pairs[1][0].close()
    before = beats()
    _native.beat([*users, *(user for pair in users for user in pair)])
    after = beats()
    assert after[0] == (before[0][0] + 2, before[0][1])
    assert after[1][0] == before[1][0]
    assert after[2] == (before[2][0] + 2, before[2][1] + 2)
    for wrong in ([1], [(users[2][0], "x")], [pairs[2][0].region], users[2], None):
        with pytest.raises(TypeError):
            _native.beat(wrong)  # type: ignore[arg-type]
    nested: Any = ()
    for _ in range(1_000_000):
        nested = (nested,)
    with pytest.raises(RecursionError):
        _native.beat([nested])


def test_closed_channels_are_quiet(pairs: list[_Pair], codec: Codec) -> None:
    """A channel closed while it is in a group is quiet, and its memory outlives the group's looks."""
    group = _native.Group()
    readers = [channel.reader() for channel, _ in pairs]
    for (channel, attached), reader in zip(pairs, readers, strict=True):
        group.add_reader(reader, codec.plan)
        attached.writer().publish(_record(codec, 1.0))
        channel.close()
    assert group.wait(_TICK, 0) == 0
    assert group.take() == ([], [])
    _native.beat([*readers])
    del readers, reader
    del group
    gc.collect()


@pytest.mark.parametrize("predict", [False, True])
def test_a_steady_stream_is_taken_whole(pairs: list[_Pair], codec: Codec, predict: bool) -> None:
    """What a thread publishes at intervals arrives in order and complete, whenever wait() looks."""
    group = _native.Group(predict=predict)
    for channel, _ in pairs:
        group.add_reader(channel.reader(), codec.plan, 1)
    writers = [attached.writer() for _, attached in pairs]
    found: dict[int, list[int]] = {index: [] for index in range(len(pairs))}

    def write() -> None:
        for x in range(150):
            for writer in writers:
                writer.publish(_record(codec, float(x)))
            time.sleep(0.003)
            while x - min(map(len, found.values())) > 4:  # on a busy machine slots are few
                time.sleep(0.003)

    thread = threading.Thread(target=write)
    thread.start()
    while any(len(sequences) < 150 for sequences in found.values()):
        assert group.wait(_TICK, 10 * _SECOND)
        for index, _, sequence, *_ in group.take()[0]:
            found[index].append(sequence)
    thread.join()
    assert all(sequences == list(range(1, 151)) for sequences in found.values())


@pytest.mark.parametrize("predict", [False, True])
def test_channels_come_and_go_while_another_thread_waits(
    pairs: list[_Pair], codec: Codec, predict: bool
) -> None:
    """Adding and removing is safe while wait() runs in another thread."""
    group = _native.Group(predict=predict)
    stop = threading.Event()

    def wait() -> None:
        while not stop.is_set():
            group.wait(100_000, _TICK)

    thread = threading.Thread(target=wait)
    thread.start()
    for _ in range(300):
        indices = [group.add_reader(channel.reader(), codec.plan) for channel, _ in pairs]
        for index in indices:
            group.remove(index)
    stop.set()
    thread.join()


@pytest.mark.parametrize("arguments", [(-1,), (61 * _SECOND,), (_TICK, 0, 61 * _SECOND)])
def test_ticks_that_are_none(arguments: tuple[int, ...]) -> None:
    """A tick is 0 to 60 s."""
    with pytest.raises(ValueError):
        _native.Group().wait(*arguments)


def test_a_quiet_wait_sleeps_once_a_tick(shm_namespace: Namespace, codec: Codec) -> None:
    """With nothing to take, the wait sleeps from tick to tick; what that costs is benchmarks/'s to say."""
    group = _native.Group()
    channels = []
    for index in range(20):
        channel = open_channel(
            shm_namespace, Direction.TO_ROS, topic=f"/quiet{index}", record_size=codec.layout.size
        )
        group.add_reader(channel.reader(), codec.plan)
        channels.append(channel)
    begin, before = time.monotonic(), resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
    assert group.wait(10 * _TICK, _SECOND) == 0
    sleeps = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - before
    ticks = (time.monotonic() - begin) * 100
    for channel in channels:
        channel.close()
    # A spinning wait never sleeps, one that wakes for other reasons sleeps more often than it ticks.
    assert 1 <= sleeps <= ticks + 5


def test_a_wait_that_predicts_sleeps_longer_while_nothing_beats(pairs: list[_Pair], codec: Codec) -> None:
    """After a thousand ticks without a change it may sleep longer than a tick, and still finds news."""
    group = _native.Group(predict=True)
    group.add_reader(pairs[0][0].reader(), codec.plan)
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
    assert group.wait(_TICK // 10, _SECOND, 10 * _TICK) == 0  # 10,000 ticks
    assert resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - before < 2_000
    pairs[0][1].writer().publish(_record(codec, 1.0))
    assert group.wait(_TICK // 10, 10 * _SECOND, 10 * _TICK) == 1


def test_a_finalizer_may_add_a_channel_while_messages_are_made(
    shm_namespace: Namespace, pairs: list[_Pair], codec: Codec
) -> None:
    """Its larger messages get another buffer, and what was taken before stays as it was taken."""
    limits = [Limits(string=1000 * size) for size in range(1, 31)]
    texts = [compute_layout(TypeStore.bundled("jazzy"), "std_msgs/msg/String", limit) for limit in limits]
    plans = [Codec(text, Wire.CDR).plan for text in texts]
    channels = [
        open_channel(shm_namespace, Direction.TO_ROS, topic=f"/text{index}", record_size=text.size)
        for index, text in enumerate(texts)
    ]
    others = [(channel.reader(), plan) for channel, plan in zip(channels, plans, strict=True)]
    writer, reader, wanted = pairs[0][1].writer(), pairs[0][0].reader(), codec.encode(_record(codec, 1.0))
    waiting: list[int] = []

    class Adds:
        def __init__(self) -> None:
            self.itself = self

        def __del__(self) -> None:
            if waiting:
                group.add_reader(*others[waiting.pop()])

    threshold = gc.get_threshold()
    try:
        for _ in range(5):
            group = _native.Group()
            group.add_reader(reader, codec.plan, 1)
            kept = [(number,) * 7 for number in range(3000)]  # more than Python has ready
            waiting[:] = reversed(range(len(others)))
            writer.publish(_record(codec, 1.0))
            Adds()
            gc.set_threshold(1)
            messages, faults = group.take()
            gc.set_threshold(*threshold)
            gc.collect()
            assert ([message[1] for message in messages], faults) == ([wanted], [])
            assert len(waiting) < len(others)
            assert len(kept) == 3000
            waiting.clear()
    finally:
        gc.set_threshold(*threshold)
        for channel in channels:
            channel.close()
