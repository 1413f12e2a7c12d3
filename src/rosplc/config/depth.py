"""How many slots an object needs: the arithmetic behind ``slots``.

Two demands meet (spec/shm-format.md, section 7.3). A reader accepts a copy only if the
writer has published at most N-2 messages meanwhile, so N-2 periods must outlast a copy plus a
preemption. And where every message counts, N-1 messages must outlast the time between two
visits of the reader.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Demand", "least_slots", "usual_slots"]

_PREEMPTION_NS = 1_000_000
"""A PLC task or another process in between; a board without a real-time kernel has more."""

_COPY_NS_PER_BYTE = 5
"""A 1 GHz Cortex-A8 copies 1 MiB in 4.7 ms; everything else is faster."""

_PAUSE_NS = 20_000_000
"""How long a reader may be kept from running, for the usual number."""

_BRIDGE_PAUSE_NS = 200_000_000
"""The same for the bridge, on a loaded machine without a real-time kernel."""

_MOST_BYTES = 1 << 20
"""Records beyond this are not worth the bridge's longer pause."""

_BURST = 16
"""Slots where every message counts and nobody said how fast they come."""

_MOST = 65536


@dataclass(frozen=True)
class Demand:
    """What the slots have to stand.

    Attributes:
        period_ns: Shortest time between two messages; 0 if unknown.
        visit_ns: Time between two visits of the reader.
        record_size: Bytes of a record.
        every: Every message counts.
        by_bridge: The reader is the bridge.
    """

    period_ns: int
    visit_ns: int
    record_size: int
    every: bool
    by_bridge: bool = False


def least_slots(demand: Demand) -> int:
    """Return the number below which messages are certain to be lost or copies to be refused."""
    return _slots(demand, _PREEMPTION_NS)


def usual_slots(demand: Demand) -> int:
    """Return the number taken where the configuration gives none."""
    if demand.every and not demand.period_ns:
        return _BURST
    usual = _slots(demand, _PAUSE_NS)
    if not (demand.every and demand.by_bridge):
        return usual
    return max(usual, min(_slots(demand, _BRIDGE_PAUSE_NS), _power(_MOST_BYTES // demand.record_size)))


def _slots(demand: Demand, pause_ns: int) -> int:
    if not demand.period_ns:
        return 4
    copy_ns = demand.record_size * _COPY_NS_PER_BYTE + _PREEMPTION_NS
    needed = 2 + _ceil(copy_ns, demand.period_ns)
    if demand.every:
        needed = max(needed, 1 + _ceil(demand.visit_ns + pause_ns, demand.period_ns))
    return min(_MOST, max(4, 1 << (needed - 1).bit_length()))


def _power(number: int) -> int:
    """Return the largest power of two that is not above a number."""
    return 1 << (number.bit_length() - 1) if number else 0


def _ceil(value: int, unit: int) -> int:
    return -(-value // unit)
