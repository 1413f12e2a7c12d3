"""The Codec class and its native Plan: arguments, buffers, errors in words."""

from __future__ import annotations

import array
import random
import threading
import time

import pytest

from rosplc._core import Fault, Plan
from rosplc.codec import Codec, Wire, compile_plan
from rosplc.codec.compile import OpCode
from rosplc.errors import CODES, CodecError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from tests.codec_oracle import Oracle, random_value
from tests.codec_types import hard_store

JAZZY = TypeStore.bundled("jazzy")


def codec(name: str, wire: Wire = Wire.CDR, **limits: int) -> Codec:
    return Codec(compute_layout(hard_store("jazzy"), name, Limits(**limits)), wire)


def test_any_buffer_will_do() -> None:
    """Messages and records may be bytes, bytearrays, memoryviews or arrays."""
    tested = codec("std_msgs/UInt32")
    message = b"\0\1\0\0\x2a\0\0\0"
    for form in (bytes, bytearray, memoryview, lambda data: array.array("B", data)):
        record = tested.decode(form(message))
        assert record == b"\x2a\0\0\0"
        assert tested.encode(form(record)) == message
    out = array.array("I", [0])
    assert tested.decode_into(message, memoryview(out)) == 0
    assert out[0] == 42


def test_unaligned_memory_will_do() -> None:
    """Neither messages nor records need any alignment in memory."""
    oracle = Oracle(hard_store("jazzy"), 7, 3)
    tested = codec("hard_msgs/Tree", string=7, sequence=3)
    value = random_value(oracle, "hard_msgs/msg/Tree", random.Random(4))
    for little in (True, False):
        for shift in range(1, 8):
            message = bytes(shift) + oracle.cdr("hard_msgs/msg/Tree", value, little=little)
            room = bytearray(shift + tested.layout.size)
            tested.decode_into(memoryview(message)[shift:], memoryview(room)[shift:])
            assert room[shift:] == oracle.record("hard_msgs/msg/Tree", value)
            assert tested.encode(memoryview(room)[shift:]) == oracle.cdr("hard_msgs/msg/Tree", value)


@pytest.mark.parametrize("size", [0, 3, 5])
def test_records_have_one_size(size: int) -> None:
    """A record that is too short or too long is refused, read or written."""
    tested = codec("std_msgs/UInt32")
    with pytest.raises(CodecError, match=f"{size} bytes instead of 4") as error:
        tested.encode(bytes(size))
    assert error.value.code == "COD009"
    with pytest.raises(CodecError) as error:
        tested.decode_into(b"\0\1\0\0\x2a\0\0\0", bytearray(size))
    assert error.value.code == "COD009"


def test_a_small_destination_is_refused() -> None:
    """A message never runs over the memory it is written to."""
    tested = codec("std_msgs/String", string=5)
    out = bytearray(b"\xaa" * 16)
    with pytest.raises(Fault) as fault:
        tested.plan.encode_into(b"abcde\0", memoryview(out)[:13])
    assert fault.value.args == (9, 0xFFFFFFFF, 13, tested.plan.encoded_bound)
    assert out[13:] == b"\xaa" * 3
    assert tested.plan.encode_into(b"abcde\0", out) == 16
    assert out == b"\0\1\0\0\6\0\0\0abcde\0\0\0"


def test_wrong_arguments_are_type_errors() -> None:
    """Objects without a buffer, read-only destinations and wrong counts raise Python's own errors."""
    plan = codec("std_msgs/UInt32").plan
    message = b"\0\1\0\0\x2a\0\0\0"
    for call in (
        lambda: plan.decode("text"),
        lambda: plan.decode(),
        lambda: plan.decode(message, False, 3),
        lambda: plan.decode_into(message),
        lambda: plan.encode(7),
        lambda: plan.encode_into(bytes(4)),
        lambda: Plan("text"),
        lambda: Plan(blob=b""),
    ):
        with pytest.raises(TypeError):
            call()
    with pytest.raises(BufferError):
        plan.decode_into(message, bytes(4))


def test_large_messages_go_through_without_the_interpreters_lock() -> None:
    """Messages above 256 KiB are converted by several threads at once, each rightly."""
    tested = codec("sensor_msgs/Image", sequence=1 << 20)
    layout = tested.layout
    failures: list[str] = []

    def convert(number: int) -> None:
        record = bytes(layout.pack({"width": number, "data": bytes([number]) * (1 << 20)}))
        for _ in range(5):
            if tested.decode(tested.encode(record)) != record:
                failures.append(f"image {number}")

    threads = [threading.Thread(target=convert, args=(number,)) for number in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not failures
    assert not any(thread.is_alive() for thread in threads)


@pytest.mark.parametrize(
    ("name", "string", "sequence"), [("hard_msgs/Tree", 2000, 12), ("hard_msgs/Texts", 65534, 4)]
)
def test_a_record_that_changes_meanwhile_is_encoded_soundly(name: str, string: int, sequence: int) -> None:
    """While another thread scribbles over the record, every message still decodes."""
    tested = codec(name, string=string, sequence=sequence)
    record = bytearray(tested.layout.size)
    assert len(record) >= 256 * 1024  # so that the lock is given away
    patterns = [byte * len(record) for byte in (b"a", b"\0", b"\xff", b"\0", b"\2")]
    stop = threading.Event()

    def scribble() -> None:
        while not stop.is_set():
            for pattern in patterns:
                record[:] = pattern

    thread = threading.Thread(target=scribble)
    thread.start()
    try:
        end = time.monotonic() + 1
        while time.monotonic() < end:
            tested.decode(tested.encode(record))
    finally:
        stop.set()
        thread.join(60)


def test_an_error_names_type_field_size_and_limit() -> None:
    """A refusal reads as one sentence with everything that is needed to act on it."""
    tested = codec("sensor_msgs/JointState", string=8, sequence=2)
    wide = codec("sensor_msgs/JointState", string=8, sequence=4)
    message = wide.encode(wide.layout.pack({"position": [1.0, 2.0, 3.0]}))
    with pytest.raises(CodecError) as error:
        tested.decode(message)
    assert str(error.value) == (
        "sensor_msgs/msg/JointState: position: sequence has 3 elements; the limit is 2 [COD005] "
        + CODES["COD005"].remedy
    )


def test_faults_may_come_as_numbers() -> None:
    """A fault that a group reports as a tuple is explained like one that was raised."""
    tested = codec("std_msgs/String", string=4)
    index = next(number for number, op in enumerate(tested._ops) if op.code is OpCode.STRING)
    error = tested.explain((4, index, 9, 4))
    assert (error.code, error.where) == ("COD004", "std_msgs/msg/String: data")
    assert error.what == "string has 9 bytes; the limit is 4"
    for number in range(1, 10):
        assert tested.explain((number, 0xFFFFFFFF, 1, 2)).code == f"COD{number:03d}"


def test_a_bound_of_the_type_is_told_from_a_limit() -> None:
    """Where the type itself sets the bound, the remedy does not suggest to raise the limit."""
    store = JAZZY.with_definition("test_msgs/msg/T", "string<=4 a\n")
    tested = Codec(compute_layout(store, "test_msgs/msg/T"), Wire.CDR)
    with pytest.raises(CodecError) as error:
        tested.decode(b"\0\1\0\0\6\0\0\0" + b"12345\0")
    assert error.value.code == "COD004"
    assert "the type itself" in error.value.what
    assert "cannot be raised" in error.value.remedy


def test_the_encoded_bound_is_tight_enough() -> None:
    """The bound covers the fullest message and exceeds it by alignment only."""
    tested = codec("sensor_msgs/JointState", string=8, sequence=2)
    full = tested.layout.pack(
        {"name": ["x" * 8] * 2, "position": [0] * 2, "velocity": [0] * 2, "effort": [0] * 2}
    )
    size = len(tested.encode(full))
    assert size <= tested.plan.encoded_bound <= size + 80


@pytest.mark.parametrize(
    ("at", "value", "reason"),
    [
        (0, 0, "not a plan"),
        (4, 7, "not a plan"),
        (8, 0, "record size"),
        (8, 0xFFFFFFFF, "record size"),
        (8, 100, "leaves its element"),
        (12, 1, "number of ops"),
        (24, 0x01010109 + 90, "unknown op"),
        (24, 0x01010301, "alignment"),
        (28, 0xFFFFFFFF, "leaves its element"),
        (32, 0xFFFFFFFF, "leaves its element"),
        (80, 80, "STRING leaves its element"),  # a capacity of 80 without room for the NUL
        (112, 0, "no element size"),
    ],
)
def test_a_damaged_plan_is_refused(at: int, value: int, reason: str) -> None:
    """A plan whose numbers do not hold together is refused when it is loaded."""
    blob = bytearray(compile_plan(compute_layout(JAZZY, "sensor_msgs/JointState").root, Wire.CDR).blob)
    Plan(blob)
    blob[at : at + 4] = value.to_bytes(4, "little")
    with pytest.raises(ValueError, match=reason):
        Plan(blob)
    with pytest.raises(ValueError, match="shorter than its head"):
        Plan(blob[:20])
