"""_native.Sink and Group.divert(): messages from C to C, hostile bytes among them."""

from __future__ import annotations

import ctypes
import random
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from rosplc.codec import Codec, Fault
from rosplc.layout import Limits, compute_layout
from rosplc.shm import Attached, Direction, Group, Namespace, OwnedChannel, Sink, attach
from tests.codec_types import HARD_TYPES, hard_store
from tests.lib.channels import open_channel

_STORE = hard_store("jazzy")
_LIMITS = Limits(string=20, sequence=4)
_PASS = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int64)
_pointer = ctypes.pythonapi.PyCapsule_GetPointer
_pointer.restype, _pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]

Open = Callable[[str, Direction, Codec], tuple[OwnedChannel, Attached]]


@pytest.fixture
def channel(shm_namespace: Namespace) -> Iterator[Open]:
    """Give what opens channels, with the PLC's end."""
    with ExitStack() as stack:

        def open_one(topic: str, direction: Direction, codec: Codec) -> tuple[OwnedChannel, Attached]:
            size = codec.layout.size
            owned = open_channel(shm_namespace, direction, topic=topic, record_size=size, slots=8)
            stack.callback(owned.close)
            attached = attach(shm_namespace, topic, direction=direction, write=True)
            stack.callback(attached.close)
            return owned, attached

        yield open_one


def passing(sink: Sink) -> Callable[[bytes], bool]:
    """Return what another extension module calls, past the rules of when a sink is open."""
    capsule = sink.capsule
    address = _pointer(capsule, b"rosplc.sink")
    function = ctypes.cast(ctypes.c_void_p.from_address(address).value, _PASS)  # type: ignore[arg-type]

    def put(message: bytes) -> bool:
        exact = (
            ctypes.create_string_buffer(message, len(message)) if message else ctypes.create_string_buffer(1)
        )
        return not function(address, ctypes.addressof(exact), len(message), 1) and capsule is not None

    return put


@pytest.mark.parametrize("name", HARD_TYPES)
@pytest.mark.parametrize("truncate", [False, True])
def test_hostile_messages_are_taken_as_the_codec_takes_them(channel: Open, name: str, truncate: bool) -> None:
    """What the codec refuses is not published, what it accepts has its record; no byte beside is touched."""
    codec = Codec(compute_layout(_STORE, name, _LIMITS))
    owned, attached = channel("/in", Direction.TO_PLC, codec)
    writer, reader, record = owned.writer(1000), attached.reader(), bytearray(codec.layout.size)
    sink = Sink()
    sink.open(writer, codec.plan, truncate, 0)
    put = passing(sink)
    draw = random.Random(name)
    whole = codec.encode(bytes(codec.layout.size))
    accepted = 0
    for _ in range(400):
        message = bytearray(whole + draw.randbytes(draw.choice((0, 0, 4, 40, 400))))
        for _ in range(draw.randrange(4)):
            message[draw.randrange(len(message))] = draw.choice((0, 1, 2, 4, 16, 127, 255))
        del message[draw.choice((len(message), len(message), draw.randrange(len(message) + 1))) :]
        try:
            expected = codec.plan.decode(bytes(message), truncate)[0]
        except Fault:
            assert not put(bytes(message))
            assert reader.next(record) is None
            continue
        accepted += 1
        assert put(bytes(message))
        assert reader.next(record) is not None and record == expected
    assert accepted > 0


def test_what_is_taken_from_one_channel_goes_into_a_sink(channel: Open) -> None:
    """take() returns only what the sink does not take, and that closes it."""
    codec = Codec(compute_layout(_STORE, "std_msgs/msg/String", _LIMITS))
    (from_, plc), (to, other) = (
        channel("/out", Direction.TO_ROS, codec),
        channel("/in", Direction.TO_PLC, codec),
    )
    source, reader, record = plc.writer(1000), other.reader(), bytearray(codec.layout.size)
    group, sink = Group(), Sink()
    index = group.add_reader(from_.reader(1000), codec.plan, 1)
    group.divert(index, sink.capsule)

    def pass_on(text: str, **meta: int) -> list[bytes]:
        source.publish(codec.layout.pack({"data": text}), **meta)
        messages, faults = group.take()
        assert not faults
        return [message[1] for message in messages]

    def arrived() -> str | None:
        return None if reader.next(record) is None else codec.layout.to_dict(record)["data"]

    assert len(pass_on("closed")) == 1 and arrived() is None
    sink.open(to.writer(1000), codec.plan, False, 10**9)
    before = time.monotonic_ns()
    assert pass_on("open") == [] and arrived() == "open"
    assert before <= sink.last_ns <= time.monotonic_ns() and sink.messages == 1
    assert len(pass_on("shortened", flags=2)) == 1 and arrived() is None, "Python counts these"
    assert len(pass_on("behind it")) == 1, "the sink is closed"
    sink.close()
    assert sink.messages == 1
    with pytest.raises(IndexError):
        group.divert(index + 1, sink.capsule)
    with pytest.raises(ValueError, match="PyCapsule"):
        group.divert(index, object())
    group.remove(index)


def test_a_silence_closes_a_sink(channel: Open) -> None:
    """The message after it is Python's, which wants to know."""
    codec = Codec(compute_layout(_STORE, "std_msgs/msg/Int32", _LIMITS))
    (from_, plc), (to, _) = channel("/out", Direction.TO_ROS, codec), channel("/in", Direction.TO_PLC, codec)
    source, group, sink = plc.writer(1000), Group(), Sink()
    group.divert(group.add_reader(from_.reader(1000), codec.plan, 1), sink.capsule)
    sink.open(to.writer(1000), codec.plan, False, 1)
    time.sleep(0.001)
    source.publish(bytes(codec.layout.size))
    assert len(group.take()[0]) == 1 and sink.messages == 0


def test_a_writer_that_lost_its_claim_takes_nothing(channel: Open) -> None:
    """Neither does one that was released or whose object was retired: Python finds out why."""
    codec = Codec(compute_layout(_STORE, "std_msgs/msg/Int32", _LIMITS))
    (from_, plc), (to, _) = channel("/out", Direction.TO_ROS, codec), channel("/in", Direction.TO_PLC, codec)
    source, group, sink = plc.writer(1000), Group(), Sink()
    group.divert(group.add_reader(from_.reader(1000), codec.plan, 1), sink.capsule)
    writer = to.writer(1000)
    sink.open(writer, codec.plan, False, 0)
    writer.release()
    source.publish(bytes(codec.layout.size))
    assert len(group.take()[0]) == 1 and sink.messages == 0
    with pytest.raises(ValueError, match="released"):
        sink.open(writer, codec.plan, False, 0)
    sink.open(to.writer(1000), codec.plan, False, 0)
    to.retire()
    source.publish(bytes(codec.layout.size))
    assert len(group.take()[0]) == 1 and sink.messages == 0
