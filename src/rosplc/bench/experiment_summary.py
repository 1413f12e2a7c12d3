"""The experiment's answer: a small table, and a few sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rosplc.bench.arrangements import ARRANGEMENTS, CYCLIC, ONE_CORE, TWO_CORES, Arrangement
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
    lines = list(_table(found))
    for arrangement in (TWO_CORES, ONE_CORE):
        for ours, language, others in _PAIRS:
            lines += _line(found, arrangement.name, arrangement.title, ours, language, others)
    cyclic = [part for each in CYCLIC if (part := _times(found, each))]
    if cyclic:
        lines.append(
            f"Polling, there and back takes {' and '.join(cyclic)}. The programs' period decides, not what "
            "carries the data: one period, or more where an answer comes too late for it."
        )
    entries_of_all = [entry for arrangement in found for entry in arrangement["contenders"]]
    if entries_of_all:
        wrong, runs = (sum(entry[key] for entry in entries_of_all) for key in ("wrong", "runs"))
        lines.append(f"Torn, lost or repeated messages: {wrong} of {runs:,} runs ended with wrong values.")
        ratio = MODBUS_S[1000] / SHARED_MEMORY_S[1000]
        lines.append(f"The source found shared memory {cell_text(ratio)} times as fast as Modbus TCP.")
    return tuple(lines)


_COLUMNS = {
    TWO_CORES.name: ("two cores,", "spinning"),
    ONE_CORE.name: ("one core,", "asleep"),
    CYCLIC[0].name: ("polling", "at 1 ms"),
    CYCLIC[1].name: ("polling", "at 10 ms"),
}
_TITLE, _COLUMN = 39, 10


def _table(found: Found) -> Iterator[str]:
    here = [each.name for each in ARRANGEMENTS if found.entries(each.name)]
    entries = {name: found.entries(name) for name in here}
    titles = {name: each["title"] for one in entries.values() for name, each in one.items()}
    if not titles:
        return
    yield "100 numbers there and back, in microseconds:"
    for row in range(2):
        yield f" {'':{_TITLE}}" + "".join(f"{_COLUMNS[name][row]:>{_COLUMN - 1}} " for name in here).rstrip()
    stars = False
    for contender, title in titles.items():
        cells = ""
        for name in here:
            # A socket cannot be spun on: no column may hide who waited otherwise than it says.
            entry = entries[name].get(contender)
            star = name == TWO_CORES.name and entry is not None and not _spins(entry)
            stars |= star
            cells += f"{cell_text(found.median(name, contender))}{'*' if star else ' '}".rjust(_COLUMN)
        yield f" {title[:_TITLE]:{_TITLE}}{cells}".rstrip()
    if stars:
        yield " * sleeps in the socket: nobody can spin there"
    yield ""


def _spins(entry: Mapping[str, Any]) -> bool:
    return str(entry["waits"]).startswith("spins")


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
            parts.append(f"{cell_text(ratio)} x that of {other}")
    middle = cell_text(found.median(arrangement, ours))
    against = f"; its rate is {', '.join(parts)}" if parts else ""
    return [f"{title}, {language}: rosplc takes {middle} µs there and back{against}."]


def _times(found: Found, arrangement: Arrangement) -> str:
    middle = [each["all"]["p50_us"] / 1000 for each in found.entries(arrangement.name).values()]
    if not middle:
        return ""
    cycle = f"in a cycle of {arrangement.period_ns / 1e6:g} ms"
    return f"{cell_text(min(middle))} to {cell_text(max(middle))} ms {cycle}"
