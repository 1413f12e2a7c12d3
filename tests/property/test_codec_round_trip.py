"""Every bundled type, and harder ones, against the slow codec of tests/codec_oracle.py."""

from __future__ import annotations

import random
from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import DISTROS
from tests.codec_oracle import Oracle, random_value
from tests.codec_types import hard_store

pytestmark = pytest.mark.verifies("conversion", own="a slow independent codec")

CAPACITIES = ((7, 3), (20, 1))


@cache
def store_of(distro: str):
    return hard_store(distro)


@cache
def codec_of(distro: str, name: str, string: int, sequence: int, wire: Wire) -> Codec:
    return Codec(compute_layout(store_of(distro), name, Limits(string, sequence)), wire)


def check(distro: str, name: str, string: int, sequence: int, rng: random.Random) -> None:
    """Compare one random message in each serialization, in both directions."""
    oracle = Oracle(store_of(distro), string, sequence)
    value = random_value(oracle, name, rng)
    record = oracle.record(name, value)
    cdr, ros1 = (codec_of(distro, name, string, sequence, wire) for wire in (Wire.CDR, Wire.ROS1))
    message = oracle.cdr(name, value)
    for codec, wire in (
        (cdr, message),
        (cdr, oracle.cdr(name, value, little=False)),
        (ros1, oracle.ros1(name, value)),
    ):
        for fill in (b"\x00", b"\xff"):
            out = bytearray(fill * len(record))
            assert codec.decode_into(wire, out) == 0
            assert out == record, f"{distro} {name} {codec.wire}"
        assert len(wire) <= codec.plan.encoded_bound
    assert cdr.encode(record) == message, f"{distro} {name}"
    assert ros1.encode(record) == oracle.ros1(name, value), f"{distro} {name}"


def check_all(distro: str, samples: int) -> None:
    for name in store_of(distro).names():
        for string, sequence in CAPACITIES:
            for number in range(samples):
                check(distro, name, string, sequence, random.Random(f"{name} {number}"))


@pytest.mark.parametrize("distro", DISTROS)
def test_every_type_goes_both_ways(distro: str) -> None:
    """Random contents of every type give the oracle's record, and the oracle's bytes again."""
    check_all(distro, 2)


@pytest.mark.verify(minutes=0.25)
@pytest.mark.timeout(900)
@pytest.mark.parametrize("distro", DISTROS)
def test_every_type_goes_both_ways_often(distro: str) -> None:
    """The same with many contents per type."""
    check_all(distro, 60)


def every_name() -> list[tuple[str, str]]:
    return [(distro, name) for distro in DISTROS for name in store_of(distro).names()]


@given(
    which=st.sampled_from(every_name()),
    rng=st.randoms(use_true_random=False),
    sizes=st.sampled_from(CAPACITIES),
)
@settings(max_examples=150, deadline=None)
def test_searched_contents_go_both_ways(
    which: tuple[str, str], rng: random.Random, sizes: tuple[int, int]
) -> None:
    """Contents that hypothesis searches for give the oracle's record and bytes."""
    check(*which, *sizes, rng)


@pytest.mark.verify(minutes=0.5)
@pytest.mark.timeout(1200)
@given(
    which=st.sampled_from(every_name()),
    rng=st.randoms(use_true_random=False),
    sizes=st.sampled_from(CAPACITIES),
)
@settings(max_examples=6000, deadline=None)
def test_searched_contents_go_both_ways_often(
    which: tuple[str, str], rng: random.Random, sizes: tuple[int, int]
) -> None:
    """The same, searched for longer."""
    check(*which, *sizes, rng)


@pytest.mark.parametrize("distro", ["jazzy", "noetic"])
def test_the_layouts_views_read_what_was_sent(distro: str) -> None:
    """What a decoded record shows as a dict is the message that was encoded."""
    oracle = Oracle(store_of(distro), 12, 4)
    for name in store_of(distro).names():
        codec = codec_of(distro, name, 12, 4, Wire.CDR)
        value = random_value(oracle, name, random.Random(name))
        shown = codec.layout.to_dict(codec.decode(oracle.cdr(name, value)))
        assert oracle.record(name, shown) == oracle.record(name, value), name
