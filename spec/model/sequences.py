"""Sequence arithmetic of ``spec/shm-format.md`` section 7.1, for any modulus.

The format counts modulo 2**32. The model counts modulo a small number, so that a few
messages are enough for a wrap. There is no other difference.
"""

from __future__ import annotations

__all__ = ["advance", "distance", "next_sequence"]


def next_sequence(sequence: int, slots: int, modulus: int = 1 << 32) -> int:
    """Return the sequence after ``sequence``: the wrap skips 0 … ``slots`` - 1."""
    return sequence + 1 if sequence < modulus - 1 else slots


def distance(first: int, second: int, slots: int, modulus: int = 1 << 32) -> int:
    """Return how many messages lie from ``first`` to ``second``, modulo ``modulus``."""
    return (second - first - (slots if second < first else 0)) % modulus


def advance(sequence: int, count: int, slots: int, modulus: int = 1 << 32) -> int:
    """Return the sequence that ``count`` applications of :func:`next_sequence` lead to."""
    result = sequence + count
    return result if result < modulus else result - modulus + slots
