"""Liveness by the observer's clock: spec/shm-format.md, M6 and M21."""

from __future__ import annotations

import pytest

from rosplc.shm import Liveness
from rosplc.shm.attach import silence_ns

pytestmark = pytest.mark.verifies("objects", own="rosplc alone")

_MS = 1_000_000


def test_beat_keeps_alive() -> None:
    """A peer lives from the first change until three of its periods have passed without one."""
    peer = Liveness(100)
    assert not peer.observe(5, 9, 0)
    assert not peer.observe(5, 9, 50 * _MS)
    assert peer.observe(6, 9, 100 * _MS)
    assert peer.observe(6, 9, 399 * _MS)
    assert not peer.observe(6, 9, 400 * _MS)
    assert peer.observe(7, 9, 5000 * _MS)


def test_messages_count_as_life() -> None:
    """A head that moves shows life without a beat."""
    peer = Liveness(100)
    peer.observe(5, 1, 0)
    assert peer.observe(5, 2, 10 * _MS)


def test_no_promise() -> None:
    """A peer that promises no period gets a second."""
    peer = Liveness(0)
    peer.observe(1, 0, 0)
    peer.observe(2, 0, 1)
    assert peer.observe(2, 0, 999 * _MS)
    assert not peer.observe(2, 0, 1001 * _MS)


def test_damaged_promise() -> None:
    """A damaged period keeps a dead peer alive for 30 s, not for months."""
    peer = Liveness(2**32 - 1)
    peer.observe(1, 0, 0)
    assert peer.observe(2, 0, 1)
    assert peer.observe(2, 0, 29_000 * _MS)
    assert not peer.observe(2, 0, 31_000 * _MS)


@pytest.mark.parametrize(
    ("beat_ms", "silence"), [(0, 1000), (1, 100), (33, 100), (50, 150), (1000, 3000), (2**32 - 1, 30_000)]
)
def test_silence(beat_ms: int, silence: int) -> None:
    """Claims outlast three beats, at least 100 ms, and no damaged word blocks them for days."""
    assert silence_ns(beat_ms) == silence * _MS
