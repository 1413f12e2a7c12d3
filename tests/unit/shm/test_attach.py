"""Attaching, claiming and reading: spec/shm-format.md, sections 3, 4, 7.3 and 9."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable

import pytest

from rosplc.errors import ChannelError
from rosplc.shm import Direction, Namespace, WriterClaim, attach
from rosplc.shm.constants import IDENTITY, UNKNOWN, WRITER_LINE, reader_line
from tests.lib.channels import LAYOUT, describe, open_channel, pattern

pytestmark = pytest.mark.verifies("objects", own="rosplc alone")

_TOPIC = "/robot1/cmd_vel"


def _expect(number: int, call: Callable[[], object]) -> None:
    with pytest.raises(ChannelError) as caught:
        call()
    assert caught.value.code == f"SHM{number}"


def test_expectations(shm_namespace: Namespace) -> None:
    """An object of another direction, layout or size is refused, and the error says both."""
    with open_channel(shm_namespace):
        attach(shm_namespace, _TOPIC, layout_id=LAYOUT, record_size=64, direction=Direction.TO_PLC).close()
        _expect(110, lambda: attach(shm_namespace, _TOPIC, direction=Direction.TO_ROS))
        _expect(112, lambda: attach(shm_namespace, _TOPIC, layout_id="f" * 16))
        _expect(112, lambda: attach(shm_namespace, _TOPIC, record_size=65))
        _expect(101, lambda: attach(shm_namespace, "/other"))
        _expect(118, lambda: attach(shm_namespace, "other"))


@pytest.mark.parametrize(
    ("word", "value", "number"),
    [
        ("magic", 1, 104),
        ("version", 0x30000, 105),
        ("features_required", 8, 106),
        ("generation", 1, 107),
        ("slot_count", 5, 108),
        ("object_size", 2**31 - 1, 109),
        ("kind", 3, 110),
        ("state", 2, 111),
    ],
)
def test_hostile_object(shm_namespace: Namespace, word: str, value: int, number: int) -> None:
    """Each kind of damage to an object's identity has its error number."""
    open_channel(shm_namespace).close()
    path = shm_namespace.path(_TOPIC)
    image = bytearray(path.read_bytes())
    struct.pack_into("<I", image, IDENTITY[word], value)
    if number != 107:
        struct.pack_into("<I", image, 108, zlib.crc32(image[16:108], zlib.crc32(image[:12])))
    path.write_bytes(image)
    _expect(number, lambda: attach(shm_namespace, _TOPIC, write=True))


@pytest.mark.parametrize(("size", "number"), [(0, 103), (511, 103), (512, 109), (1000, 109)])
def test_truncated_object(shm_namespace: Namespace, size: int, number: int) -> None:
    """An object cut short is refused before anything behind its end is touched."""
    open_channel(shm_namespace).close()
    with shm_namespace.path(_TOPIC).open("r+b") as file:
        file.truncate(size)
    _expect(number, lambda: attach(shm_namespace, _TOPIC))


def test_object_rounded_up_to_pages(shm_namespace: Namespace) -> None:
    """Sizes are compared with >=: a runtime may round an object up."""
    open_channel(shm_namespace).close()
    with shm_namespace.path(_TOPIC).open("r+b") as file:
        file.truncate(8192)
    attach(shm_namespace, _TOPIC).close()


def test_damaged_description(shm_namespace: Namespace) -> None:
    """A program that needs no description can attach; a tool gets SHM113."""
    open_channel(shm_namespace).close()
    with shm_namespace.path(_TOPIC).open("r+b") as file:
        file.seek(512)
        file.write(b"\xff")
    with attach(shm_namespace, _TOPIC) as attached:
        _expect(113, lambda: attached.description)


def test_attaching_executes_no_retained_command(shm_namespace: Namespace) -> None:
    """A new reader sees the last state with peek, but has nothing new until the next message (M14)."""
    with open_channel(shm_namespace) as channel:
        writer = channel.writer()
        writer.publish(pattern(1, 64), stamp_ns=123, stamp_clock=2, correlation=2**63)
        with attach(shm_namespace, _TOPIC) as attached:
            reader = attached.reader()
            out = bytearray(64)
            assert reader.latest(out) is None
            assert reader.next(out) is None
            assert out == bytes(64)
            info = reader.peek(out)
            assert info is not None
            assert tuple(info) == (1, 1, 0, 123, 2, 2**63, 0, bytes(16), 0)
            assert out == pattern(1, 64)
            writer.publish(pattern(2, 64))
            info = reader.latest(out)
            assert info is not None
            assert (info.sequence, info.flags, info.stamp_clock) == (2, 0, 0)
            assert reader.latest(out) is None


def test_latched_reader_takes_what_is_there(shm_namespace: Namespace) -> None:
    """A latched topic's reader starts with what the object holds, and counts no loss for it."""
    with open_channel(shm_namespace) as channel, attach(shm_namespace, _TOPIC) as attached:
        writer = channel.writer()
        for number in range(1, 10):
            writer.publish(pattern(number, 64))
        reader = attached.reader(latched=True)
        out = bytearray(64)
        infos = [reader.next(out) for _ in range(4)]
        assert [info and info.sequence for info in infos] == [7, 8, 9, None]
        assert reader.lost == 0


def test_losses_are_counted(shm_namespace: Namespace) -> None:
    """Four slots hold three messages; what came before is counted, once."""
    with open_channel(shm_namespace) as channel, attach(shm_namespace, _TOPIC, write=True) as attached:
        writer = channel.writer()
        writer.publish(pattern(0, 64))
        reader = attached.reader("motion", observe=False)
        out = bytearray(64)
        for number in range(1, 11):
            writer.publish(pattern(number, 64))
        infos = [reader.next(out) for _ in range(4)]
        assert [info and (info.sequence, info.lost) for info in infos] == [(9, 7), (10, 0), (11, 0), None]
        line = attached.snapshot().readers[0]
        assert (line.lost, line.taken, line.task, line.layout_id) == (7, 11, "motion", LAYOUT)
        assert line.generation == channel.generation


def test_reader_lines(shm_namespace: Namespace) -> None:
    """Readers that want lines share four; the fifth observes, and a released line serves again."""
    with open_channel(shm_namespace), attach(shm_namespace, _TOPIC, write=True) as attached:
        readers = [attached.reader(f"task{index}", observe=False, beat_ms=1) for index in range(4)]
        assert [reader.line for reader in readers] == [0, 1, 2, 3]
        assert attached.reader().line is None
        readers[2].release()
        assert readers[2].line is None
        assert attached.reader("new", observe=False).line == 2


def test_silent_reader_line_is_taken_over(shm_namespace: Namespace) -> None:
    """A line whose reader was killed serves the next one; the old reader, if it lives, observes on."""
    with open_channel(shm_namespace) as channel, attach(shm_namespace, _TOPIC, write=True) as attached:
        writer = channel.writer()
        old = [attached.reader(f"old{index}", observe=False, beat_ms=20) for index in range(4)]
        new = attached.reader("new", observe=False)
        assert new.line is not None
        taken = old[new.line]
        taken.beat()
        assert taken.line is None
        writer.publish(pattern(1, 64))
        assert taken.next(bytearray(64)) is not None
        assert attached.snapshot().readers[new.line].task == "new"


def test_bridge_keeps_line_0(shm_namespace: Namespace) -> None:
    """Towards ROS, line 0 is the bridge's and others get the rest (M9)."""
    with (
        open_channel(shm_namespace, Direction.TO_ROS) as channel,
        attach(shm_namespace, _TOPIC, write=True) as attached,
    ):
        assert channel.reader().line == 0
        assert attached.reader(observe=False).line == 1


def test_bridge_goes_on_where_the_one_before_stopped(shm_namespace: Namespace) -> None:
    """A new bridge continues from line 0's taken: nothing twice, and nothing left out (M14)."""
    out = bytearray(64)
    with open_channel(shm_namespace, Direction.TO_ROS) as channel:
        attached = attach(shm_namespace, _TOPIC, write=True)
        writer = attached.writer()
        reader = channel.reader()
        for number in (1, 2, 3):
            writer.publish(pattern(number, 64))
        info = reader.next(out)
        assert info is not None
        assert info.sequence == 1
    with open_channel(shm_namespace, Direction.TO_ROS) as channel:
        reader = channel.reader()
        infos = [reader.next(out) for _ in range(3)]
        assert [info and info.sequence for info in infos] == [2, 3, None]
    attached.close()


def test_what_was_sent_before_the_bridge_read(shm_namespace: Namespace) -> None:
    """Messages sent between an object's creation and the bridge's first claim are not skipped."""
    out = bytearray(64)
    open_channel(shm_namespace, Direction.TO_ROS).close()
    with attach(shm_namespace, _TOPIC, write=True) as attached:
        attached.writer().publish(pattern(1, 64))
    with open_channel(shm_namespace, Direction.TO_ROS) as channel:
        info = channel.reader().next(out)
        assert info is not None
        assert info.sequence == 1


def test_one_writer(shm_namespace: Namespace) -> None:
    """A second writer is refused while the first beats (M6)."""
    with (
        open_channel(shm_namespace, Direction.TO_ROS),
        attach(shm_namespace, _TOPIC, write=True) as one,
        attach(shm_namespace, _TOPIC, write=True) as two,
    ):
        first = one.writer(beat_ms=10)
        claim = two.writer_claim()
        for now_ms in range(0, 1000, 50):
            first.beat()
            assert claim.attempt(now_ms * 1_000_000) is None
        first.release()
        second = claim.attempt(10**9)
        assert second is not None
        with pytest.raises(ValueError):
            first.publish(bytes(64))


def test_waiting_for_a_living_writer_ends(shm_namespace: Namespace) -> None:
    """Asking for the channel of a writer that publishes raises SHM114."""
    with (
        open_channel(shm_namespace, Direction.TO_ROS) as channel,
        attach(shm_namespace, _TOPIC, write=True) as one,
        attach(shm_namespace, _TOPIC, write=True) as two,
    ):
        one.writer(beat_ms=60_000)
        region = channel.region

        class Ticking(WriterClaim):
            def attempt(self, now_ns: int) -> None:
                super().attempt(now_ns)
                region.store(WRITER_LINE["writer_beat"], region.word(WRITER_LINE["writer_beat"]) + 1)

        two.writer_claim = lambda beat_ms=1000: Ticking(two.region, beat_ms)  # type: ignore[method-assign]
        _expect(114, two.writer)


def test_dead_writer_is_replaced_and_stopped(shm_namespace: Namespace) -> None:
    """A silent writer's claim is taken over after its time; if it wakes up it publishes nothing (M6)."""
    with (
        open_channel(shm_namespace, Direction.TO_ROS),
        attach(shm_namespace, _TOPIC, write=True) as one,
        attach(shm_namespace, _TOPIC, write=True) as two,
    ):
        first = one.writer(beat_ms=40)
        first.publish(pattern(1, 64))
        claim = two.writer_claim()
        assert claim.attempt(0) is None
        assert claim.attempt(119_000_000) is None
        second = claim.attempt(120_000_000)
        assert second is not None
        assert second.publish(pattern(2, 64)) == 2
        _expect(115, lambda: first.publish(pattern(9, 64)))
        _expect(115, first.check)
        first.release()
        assert second.publish(pattern(3, 64)) == 3


def test_read_only(shm_namespace: Namespace) -> None:
    """A program that may only read can observe, and is told so when it wants more."""
    with open_channel(shm_namespace, Direction.TO_ROS), attach(shm_namespace, _TOPIC) as attached:
        attached.reader()
        _expect(122, attached.writer)
        _expect(122, lambda: attached.reader(observe=False))
        _expect(122, lambda: attached.region.store(WRITER_LINE["head"], 1))


def test_snapshot(shm_namespace: Namespace) -> None:
    """A snapshot shows every counter of every line."""
    with open_channel(shm_namespace) as channel, attach(shm_namespace, _TOPIC) as attached:
        writer = channel.writer(beat_ms=50)
        writer.publish(bytes(64), flags=2)
        writer.refuse(112)
        writer.set_sources(3)
        state = attached.snapshot()
        assert state.state == 1
        assert (state.writer.head, state.writer.refused, state.writer.truncated) == (1, 1, 1)
        assert (state.writer.beat_ms, state.writer.sources, state.writer.error) == (50, 3, 112)
        before = state.writer.beat
        writer.beat()
        assert attached.snapshot().writer.beat == before + 1
        assert [line.claim for line in state.readers] == [0, 0, 0, 0]


def test_nobody_speaks_for_the_one_before(shm_namespace: Namespace) -> None:
    """Sources and sinks are unknown from a claim until the new holder counts them."""
    with open_channel(shm_namespace, Direction.TO_ROS) as channel:
        channel.reader().set_sinks(2)
        with attach(shm_namespace, _TOPIC, write=True) as attached:
            attached.writer().set_sources(3)
    with open_channel(shm_namespace, Direction.TO_ROS) as channel:
        assert channel.adopted
        channel.reader()
        with attach(shm_namespace, _TOPIC, write=True) as attached:
            attached.writer()
            state = attached.snapshot()
    assert (state.writer.sources, state.readers[0].sinks) == (UNKNOWN, UNKNOWN)


def test_undecodable_task_name(shm_namespace: Namespace) -> None:
    """A task name that is no text, or has no end, is shown as well as can be."""
    with open_channel(shm_namespace) as channel:
        for word in range(4):
            channel.region.store(reader_line(1) + 48 + 4 * word, 0xFFFFFFFF)
        assert channel.snapshot().readers[1].task == "�" * 16


def test_topics_side_by_side(shm_namespace: Namespace) -> None:
    """Objects of several topics do not touch each other."""
    with (
        open_channel(shm_namespace, topic="/a") as one,
        open_channel(shm_namespace, topic="/a/b") as two,
        attach(shm_namespace, "/a/b") as attached,
    ):
        one.writer().publish(pattern(1, 64))
        two.writer()
        assert attached.snapshot().writer.head == 0
        assert attached.description == describe("/a/b")
