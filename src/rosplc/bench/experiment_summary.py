"""The experiment's answer in a few sentences."""

from __future__ import annotations

from rosplc.bench.arrangements import CYCLIC, ONE_CORE, TWO_CORES
from rosplc.bench.found import Found
from rosplc.bench.markdown import cell_text
from rosplc.bench.source import MODBUS_S, SHARED_MEMORY_S

__all__ = ["summary"]

_PAIRS = (
    ("rosplc-c", "in C", ("libmodbus", "libmodbus-fc23", "semaphore-c", "signal-c")),
    ("rosplc-python", "in Python", ("pymodbus", "asyncua", "semaphore-python", "iceoryx2")),
)


def summary(found: Found) -> tuple[str, ...]:
    """Return one line per arrangement and language, and how whole the values were."""
    lines = []
    for arrangement in (TWO_CORES, ONE_CORE):
        for ours, language, others in _PAIRS:
            lines += _line(found, arrangement.name, arrangement.title, ours, language, others)
    for arrangement in CYCLIC:
        entries = found.entries(arrangement.name)
        if entries:
            middle = [each["all"]["p50_us"] for each in entries.values()]
            lines.append(
                f"{arrangement.title}: a cycle takes {cell_text(min(middle) / 1000)} to "
                f"{cell_text(max(middle) / 1000)} ms whoever carries the data: the programs' period decides."
            )
    entries_of_all = [entry for arrangement in found for entry in arrangement["contenders"]]
    if entries_of_all:
        wrong, runs = (sum(entry[key] for entry in entries_of_all) for key in ("wrong", "runs"))
        lines.append(f"Torn, lost or repeated messages: {wrong} of {runs:,} runs ended with wrong values.")
        ratio = MODBUS_S[1000] / SHARED_MEMORY_S[1000]
        lines.append(f"The source found shared memory {cell_text(ratio)} times as fast as Modbus TCP.")
    return tuple(lines)


def _line(
    found: Found, arrangement: str, title: str, ours: str, language: str, others: tuple[str, ...]
) -> list[str]:
    entries = found.entries(arrangement)
    if ours not in entries:
        return []
    parts = []
    for other in others:
        ratio = found.ratio(arrangement, other, ours)
        if ratio is not None:
            parts.append(f"{cell_text(ratio)} x {entries[other]['title']}")
    middle = cell_text(found.median(arrangement, ours))
    against = f"; its rate is {', '.join(parts)}" if parts else ""
    return [f"{title}, {language}: rosplc takes {middle} µs there and back{against}."]
