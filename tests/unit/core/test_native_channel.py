"""The channel's Python types: arguments, bounds, closing, and conversion straight in and out of slots."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable

import pytest

import rosplc._core as _native
from rosplc.codec import Codec, Wire
from rosplc.errors import ChannelError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Direction, Namespace, attach
from rosplc.shm.constants import HEADER_SIZE, IDENTITY, WRITER_LINE
from tests.lib.channels import is_torn, open_channel, pattern

_TOPIC = "/robot1/cmd_vel"


@pytest.fixture(scope="module")
def codec() -> Codec:
    return Codec(
        compute_layout(TypeStore.bundled("jazzy"), "std_msgs/msg/String", Limits(string=7)), Wire.CDR
    )


def _wire(text: bytes) -> bytes:
    body = (len(text) + 1).to_bytes(4, "little") + text + b"\0"
    return b"\0\1\0\0" + body + b"\0" * (-len(body) % 4)


def test_region_repeats_the_checks(shm_namespace: Namespace) -> None:
    """A Region maps nothing that its own look at identity and file size does not confirm."""
    with open_channel(shm_namespace) as channel:
        path = channel.path
        first = path.read_bytes()[:HEADER_SIZE]
        with path.open("rb") as file:
            for image, number in (
                (first[:100], 103),
                (b"\0" * 512, 104),
                (first[:70] + b"x" + first[71:], 107),
            ):
                with pytest.raises(ChannelError, match=f"SHM{number}"):
                    _native.Region(file.fileno(), image, False, str(path))
        with open(path.with_name(path.name + "2"), "w+b") as short:
            short.write(first)
            short.flush()
            with pytest.raises(ChannelError, match="SHM109"):
                _native.Region(short.fileno(), first, False, str(path))
    with pytest.raises(OSError):
        _native.Region(99999, first, False, str(path))


@pytest.mark.parametrize("offset", [-4, 1, 2, 1 << 40, -(1 << 40)])
def test_words_outside_the_object(shm_namespace: Namespace, offset: int) -> None:
    """No word outside the object can be named."""
    with open_channel(shm_namespace) as channel:
        size = channel.identity.object_size
        for call in (
            lambda: channel.region.word(offset),
            lambda: channel.region.store(offset, 1),
            lambda: channel.region.word(size),
            lambda: channel.region.words(0, size // 4 + 1),
            lambda: channel.region.words(0, -1),
            lambda: channel.region.words(0, 2, size // 4),
            lambda: channel.region.words(0, 2, 1 << 62),
            lambda: channel.region.words(0, 1, 0),
            lambda: channel.region.read(size - 1, 2),
            lambda: channel.region.read(-1, 1),
        ):
            with pytest.raises(IndexError):
                call()
        assert channel.region.word(size - 4) == 0
        some = channel.region.words(0, 64)
        assert channel.region.words(4, 8, 3) == some[1:25:3]


def test_closed_region(shm_namespace: Namespace) -> None:
    """After close() every call raises ValueError, and none touches the memory."""
    channel = open_channel(shm_namespace, Direction.TO_ROS)
    attached = attach(shm_namespace, _TOPIC, write=True)
    writer = attached.writer()
    reader = channel.reader()
    attached.close()
    channel.close()
    calls: list[Callable[[], object]] = [
        lambda: writer.publish(bytes(64)),
        writer.beat,
        writer.check,
        lambda: reader.next(bytearray(64)),
        lambda: reader.update(bytearray(64)),
        reader.beat,
        channel.snapshot,
        lambda: channel.region.read(0, 4),
        lambda: channel.region.store(0, 0),
    ]
    for call in calls:
        with pytest.raises(ValueError):
            call()
    assert reader.line is None
    writer.release()
    reader.release()


def test_arguments(shm_namespace: Namespace) -> None:
    """Wrong arguments are named, and publish nothing."""
    with open_channel(shm_namespace) as channel, attach(shm_namespace, _TOPIC) as attached:
        writer = channel.writer()
        reader = attached.reader()
        record = bytes(64)
        bad: list[tuple[type[Exception], Callable[[], object]]] = [
            (ValueError, lambda: writer.publish(bytes(63))),
            (ValueError, lambda: writer.publish(bytes(65))),
            (ValueError, lambda: writer.publish(record, stamp_ns=-1)),
            (ValueError, lambda: writer.publish(record, stamp_ns=2**64)),
            (ValueError, lambda: writer.publish(record, stamp_clock=4)),
            (ValueError, lambda: writer.publish(record, flags=8)),
            (ValueError, lambda: writer.publish(record, correlation=2**64)),
            (TypeError, lambda: writer.publish(record, 5)),  # type: ignore[call-arg]
            (TypeError, lambda: writer.publish()),  # type: ignore[call-arg]
            (TypeError, lambda: writer.publish(record, colour=1)),  # type: ignore[call-arg]
            (TypeError, lambda: writer.publish("text")),  # type: ignore[arg-type]
            (TypeError, lambda: writer.publish(record, stamp_ns="1")),  # type: ignore[arg-type]
            (TypeError, lambda: writer.publish_wire(None, b"")),  # type: ignore[arg-type]
            (ValueError, lambda: writer.set_sources(2**32)),
            (ValueError, lambda: reader.latest(bytearray(63))),
            (TypeError, lambda: reader.latest(5)),  # type: ignore[arg-type]
            (BufferError, lambda: reader.latest(bytes(64))),
            (ValueError, lambda: reader.update(bytearray(63))),
            (TypeError, lambda: reader.update(5)),  # type: ignore[arg-type]
            (BufferError, lambda: reader.update(bytes(64))),
        ]
        for error, call in bad:
            with pytest.raises(error):
                call()
        assert writer.head == 0
        assert channel.snapshot().writer.head == 0
        assert writer.publish(record, stamp_ns=2**64 - 1, correlation=2**64 - 1) == 1
        info = reader.latest(bytearray(100))
        assert info is not None
        assert (info.stamp_ns, info.correlation) == (2**64 - 1, 2**64 - 1)


@pytest.mark.parametrize("size", [1, 7, 8, 63, 64, 65, 4096, 300_001])
def test_record_sizes(shm_namespace: Namespace, size: int) -> None:
    """Records of any size come out as they went in, with and without the GIL held."""
    with open_channel(shm_namespace, record_size=size) as channel, attach(shm_namespace, _TOPIC) as attached:
        writer, reader = channel.writer(), attached.reader()
        for _ in range(6):
            record = os.urandom(size)
            out = bytearray(size)
            sequence = writer.publish(record)
            found = reader.peek_record()
            info = reader.next(out)
            assert found == (record, info)
            assert info is not None
            assert info.sequence == sequence
            assert out == record


def test_writer_and_reader_used_by_many_threads(shm_namespace: Namespace) -> None:
    """Threads that share a writer or a reader wait for each other, also while copies run without the GIL."""
    size = 512 * 1024
    with open_channel(shm_namespace, record_size=size) as channel, attach(shm_namespace, _TOPIC) as attached:
        writer, reader = channel.writer(), attached.reader()
        torn: list[bool] = []

        def write(number: int) -> None:
            record = pattern(number, size)
            for _ in range(40):
                writer.publish(record)

        def read() -> None:
            out = bytearray(size)
            for _ in range(40):
                if reader.latest(out):
                    torn.append(is_torn(out))

        threads = [threading.Thread(target=write, args=(number,)) for number in range(3)]
        threads += [threading.Thread(target=read) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert writer.head == 120
        assert torn
        assert not any(torn)


def test_closing_under_a_running_copy(shm_namespace: Namespace) -> None:
    """Closing while another thread copies ends in ValueError there, never in a fault."""
    size = 4 << 20
    for _ in range(5):
        channel = open_channel(shm_namespace, record_size=size)
        writer = channel.writer()
        started = threading.Event()

        def write(writer: _native.Writer = writer, started: threading.Event = started) -> None:
            record = bytes(size)
            with pytest.raises(ValueError):
                while True:
                    writer.publish(record)
                    started.set()

        thread = threading.Thread(target=write)
        thread.start()
        started.wait()
        channel.close()
        thread.join()


def test_rejected_copy_leaves_the_buffer_alone(shm_namespace: Namespace) -> None:
    """When nothing is accepted, the caller's buffer holds what it held (M12)."""
    with open_channel(shm_namespace) as channel, attach(shm_namespace, _TOPIC) as attached:
        writer, reader = channel.writer(), attached.reader()
        out = bytearray(64)
        writer.publish(pattern(1, 64))
        reader.latest(out)
        channel.region.store(WRITER_LINE["head"], 2)
        assert reader.latest(out) is None
        assert reader.next(out) is None
        assert reader.peek(out) is None
        assert out == pattern(1, 64)
        assert (reader.last, reader.lost, reader.discontinuities) == (1, 0, 0)
        assert reader.retries == 9


def test_records_as_objects(shm_namespace: Namespace) -> None:
    """What is taken as bytes is what is taken into a buffer; a rejected copy is returned by neither (M12)."""
    with open_channel(shm_namespace) as channel, attach(shm_namespace, _TOPIC) as attached:
        writer, buffer, objects = channel.writer(), attached.reader(), attached.reader()
        out = bytearray(64)
        assert objects.latest_record() is objects.next_record() is objects.peek_record() is None
        for number in (1, 2, 3):
            writer.publish(pattern(number, 64), stamp_ns=number)
        for take, same in ((buffer.next, objects.next_record), (buffer.latest, objects.latest_record)):
            info = take(out)
            assert info is not None
            assert same() == (out, info)
        channel.region.store(WRITER_LINE["head"], 4)
        assert objects.latest_record() is objects.next_record() is objects.peek_record() is None
        assert (objects.last, objects.lost, objects.discontinuities) == (3, 1, 0)
        assert objects.retries == 9


def test_update_takes_as_latest_does(shm_namespace: Namespace) -> None:
    """update() says whether there was news, takes the newest message, and counts what was missed."""
    with open_channel(shm_namespace) as channel, attach(shm_namespace, _TOPIC) as attached:
        writer, reader = channel.writer(), attached.reader()
        out = bytearray(64)
        assert reader.update(out) is False
        for number in (1, 2, 3):
            writer.publish(pattern(number, 64))
            assert reader.update(out) is True
            assert reader.update(out) is False
            assert out == pattern(number, 64)
        for number in (4, 5):
            writer.publish(pattern(number, 64))
        assert reader.update(out) is True
        assert out == pattern(5, 64)
        assert (reader.last, reader.lost) == (5, 1)
        channel.region.store(WRITER_LINE["head"], 6)
        assert reader.update(out) is False
        assert out == pattern(5, 64)


def test_layout_that_changes_under_a_reader(shm_namespace: Namespace) -> None:
    """A reader that finds another layout id stops, and so does a writer."""
    with open_channel(shm_namespace) as channel, attach(shm_namespace, _TOPIC) as attached:
        writer, reader = channel.writer(), attached.reader()
        channel.region.store(IDENTITY["layout_id_lo"], 1)
        for call in (lambda: writer.publish(bytes(64)), lambda: reader.next(bytearray(64)), attached.valid):
            with pytest.raises(ChannelError, match="SHM112"):
                call()


def test_wire_goes_straight_into_the_slot(shm_namespace: Namespace, codec: Codec) -> None:
    """A message is decoded into its slot and encoded out of it again."""
    size = codec.layout.size
    with open_channel(shm_namespace, record_size=size) as channel, attach(shm_namespace, _TOPIC) as attached:
        writer, reader = channel.writer(), attached.reader()
        assert writer.publish_wire(codec.plan, _wire(b"hello"), stamp_ns=5, stamp_clock=2) == (1, 0)
        out = bytearray(size)
        assert reader.peek(out) is not None
        assert out == codec.decode(_wire(b"hello"))
        assert reader.peek_wire(codec.plan) is not None
        taken = reader.next_wire(codec.plan)
        assert taken is not None
        assert taken[0] == _wire(b"hello")
        assert (taken[1].stamp_ns, taken[1].stamp_clock) == (5, 2)
        assert reader.latest_wire(codec.plan) is None


def test_refused_message_is_counted_and_not_published(shm_namespace: Namespace, codec: Codec) -> None:
    """A message that does not fit leaves the last one standing; truncating it is marked and counted."""
    size = codec.layout.size
    with open_channel(shm_namespace, record_size=size) as channel, attach(shm_namespace, _TOPIC) as attached:
        writer, reader = channel.writer(), attached.reader()
        writer.publish_wire(codec.plan, _wire(b"hello"))
        for wire in (_wire(b"much too long"), b"", b"\0\1\0\0\xff\xff\xff\xff"):
            with pytest.raises(_native.Fault):
                writer.publish_wire(codec.plan, wire)
        assert channel.snapshot().writer.refused == 3
        assert writer.head == 1
        assert writer.publish_wire(codec.plan, _wire(b"much too long"), truncate=True) == (2, 2)
        taken = reader.next_wire(codec.plan)
        assert taken is not None
        assert taken[0] == _wire(b"hello")
        taken = reader.next_wire(codec.plan)
        assert taken is not None
        assert taken[0] == _wire(b"much to")
        assert taken[1].flags == 2
        assert channel.snapshot().writer.truncated == 1


def test_plan_of_another_record(shm_namespace: Namespace, codec: Codec) -> None:
    """A plan for records of another size is refused before it touches a slot."""
    with open_channel(shm_namespace, record_size=640) as channel, attach(shm_namespace, _TOPIC) as attached:
        writer, reader = channel.writer(), attached.reader()
        with pytest.raises(ValueError):
            writer.publish_wire(codec.plan, _wire(b"hello"))
        with pytest.raises(ValueError):
            reader.next_wire(codec.plan)
        with pytest.raises(ValueError):
            _native.Group().add_reader(reader, codec.plan)
