"""The figures of the work that this comparison repeats: section 5.1 of the source.

A BeagleBone Black with CODESYS, 100 unsigned integers of 16 bits each way per cycle; seconds by number
of cycles. Its table 5.2 names its column Modbus too, by mistake: it is the one of shared memory.
"""

from __future__ import annotations

__all__ = ["BITS_PER_CYCLE", "MODBUS_S", "SHARED_MEMORY_S", "SOURCE_KBIT_S", "kbit_per_second"]

MODBUS_S = {10: 0.075, 50: 0.371, 100: 0.750, 200: 1.515, 300: 2.278, 400: 3.055, 500: 3.820, 1000: 7.657}
"""Its table 5.1, Modbus TCP."""

SHARED_MEMORY_S = {
    10: 0.039,
    50: 0.181,
    100: 0.350,
    200: 0.683,
    300: 1.018,
    400: 1.352,
    500: 1.684,
    1000: 3.353,
}
"""Its table 5.2, shared memory with a semaphore."""

SOURCE_KBIT_S = {"Modbus TCP": 423, "shared memory": 919}
"""Its rates, from its figure 5.4 and the text above it."""

BITS_PER_CYCLE = 3200
"""200 numbers of 16 bits, as the source counts."""


def kbit_per_second(cycles: int, seconds: float) -> float:
    """Return the rate as the source counts it: 3,200 bits a cycle."""
    return BITS_PER_CYCLE * cycles / seconds / 1000
