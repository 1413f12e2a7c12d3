"""Damaged messages of every bundled type are refused or read, and never anything else."""

from __future__ import annotations

import random
import struct

import pytest

from rosplc.codec import Codec, Wire
from rosplc.errors import CodecError
from rosplc.layout import Limits, compute_layout
from tests.codec_oracle import Oracle, random_value
from tests.codec_types import hard_store

pytestmark = pytest.mark.verifies("hostile", own="malformed messages")

EXTREMES = (0, 1, 3, 7, 8, 0x7FFFFFFF, 0x80000000, 0xFFFFFFF0, 0xFFFFFFFF)
WIRES = (("jazzy", Wire.CDR, True), ("jazzy", Wire.CDR, False), ("noetic", Wire.ROS1, True))


def cases(distro: str, wire: Wire, little: bool):
    """Yield a codec and a message of every type."""
    oracle = Oracle(hard_store(distro), 6, 2)
    for name in oracle.store.names():
        codec = Codec(compute_layout(oracle.store, name, Limits(6, 2)), wire)
        value = random_value(oracle, name, random.Random(name))
        yield codec, oracle.ros1(name, value) if wire is Wire.ROS1 else oracle.cdr(name, value, little=little)


def outcome(codec: Codec, data: bytes, *, truncate: bool) -> str:
    """Return the error's code, or what happened instead."""
    out = bytearray(codec.layout.size)
    try:
        flags = codec.decode_into(data, out, truncate=truncate)
    except CodecError as error:
        assert codec.layout.type_name in error.where
        return error.code
    assert len(codec.encode(out)) <= codec.plan.encoded_bound
    return "truncated" if flags else "fine"


@pytest.mark.parametrize(("distro", "wire", "little"), WIRES)
def test_every_truncation_is_refused(distro: str, wire: Wire, little: bool) -> None:
    """A message cut off anywhere is refused as truncated; only CDR's final padding may be missing."""
    for codec, message in cases(distro, wire, little):
        ends = (
            range(len(message)) if len(message) <= 400 else random.Random(1).sample(range(len(message)), 400)
        )
        padding = 3 if wire is Wire.CDR else 0
        for end in ends:
            got = outcome(codec, message[:end], truncate=bool(end % 2))
            if end < len(message) - padding or padding == 0:
                assert got == "COD001", (codec.layout.type_name, end)
            else:
                assert got in ("COD001", "fine")


@pytest.mark.parametrize(("distro", "wire", "little"), WIRES)
def test_bytes_left_over_are_refused(distro: str, wire: Wire, little: bool) -> None:
    """Four bytes more than a CDR message has, or one more than a ROS 1 message has, are refused."""
    for codec, message in cases(distro, wire, little):
        more = bytes(4 if wire is Wire.CDR else 1)
        assert outcome(codec, message + more, truncate=True) == "COD002", codec.layout.type_name


@pytest.mark.parametrize("rounds", [20, pytest.param(2000, marks=pytest.mark.verify(minutes=0.25))])
@pytest.mark.parametrize(("distro", "wire", "little"), WIRES)
@pytest.mark.timeout(1200)
def test_flipped_bytes_are_harmless(distro: str, wire: Wire, little: bool, rounds: int) -> None:
    """Random bytes and extreme counts anywhere give a record or a coded error."""
    rng = random.Random(2)
    seen = set()
    for codec, message in cases(distro, wire, little):
        for _ in range(rounds):
            damaged = bytearray(message)
            for _ in range(rng.randint(1, 3)):
                if len(damaged) >= 8 and rng.random() < 0.5:
                    at = rng.randrange(len(damaged) // 4) * 4
                    struct.pack_into("<I" if little else ">I", damaged, at, rng.choice(EXTREMES))
                elif damaged:
                    damaged[rng.randrange(len(damaged))] = rng.randrange(256)
            seen.add(outcome(codec, bytes(damaged), truncate=rng.random() < 0.5))
    assert {"fine", "truncated", "COD001", "COD002", "COD005", "COD006", "COD007"} <= seen


@pytest.mark.parametrize(("distro", "wire"), [("jazzy", Wire.CDR), ("noetic", Wire.ROS1)])
def test_any_record_becomes_a_message(distro: str, wire: Wire) -> None:
    """Whatever bytes a record holds, its message decodes, and encodes to the same bytes again."""
    rng = random.Random(3)
    for codec, _ in cases(distro, wire, True):
        for _ in range(5):
            message = codec.encode(rng.randbytes(codec.layout.size))
            assert codec.encode(codec.decode(message)) == message
