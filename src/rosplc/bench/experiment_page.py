"""The experiment for people: the source's two tables and two figures with the measured ones beside them."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from rosplc.bench import source
from rosplc.bench.arrangements import ONE_CORE, TWO_CORES
from rosplc.bench.experiment_goals import goals
from rosplc.bench.experiment_summary import summary
from rosplc.bench.found import Found, durations, group_of
from rosplc.bench.markdown import cell_text
from rosplc.bench.results import Cell, Figure, Page, Series, Table
from rosplc.bench.stats import shown

__all__ = ["page"]

_SOURCE = "source, BeagleBone, CODESYS"


def page(data: Mapping[str, Any]) -> Page:
    """Return tables, figures and goals of what was measured."""
    found = Found(data["arrangements"])
    cycles: list[int] = data["cycles"]
    tables: list[Table] = []
    figures: list[Figure] = []
    for arrangement in found:
        if not arrangement["contenders"]:
            continue
        tables += [
            _durations(arrangement, cycles),
            _rates(arrangement, cycles),
            _latencies(arrangement),
        ]
        figures += [_duration_figure(arrangement), _rate_figure(arrangement)]
    return Page(
        lead=_who(found),
        tables=tuple(tables),
        figures=tuple(figures),
        goals=goals(found, max(data.get("load", [0.0]))),
        after=_after(found),
        summary=summary(found),
    )


def _who(found: Found) -> tuple[str, ...]:
    about = {each["title"]: each["about"] for arrangement in found for each in arrangement["contenders"]}
    return ("\n".join(f"* **{title}**: {text}." for title, text in about.items()),) if about else ()


def _source_rows(
    values: Sequence[tuple[str, Mapping[int, float]]],
) -> list[tuple[str, str, dict[int, float]]]:
    return [(f"{name} ({_SOURCE})", "not stated", dict(found)) for name, found in values]


def _rows(
    arrangement: Mapping[str, Any], cycles: Sequence[int], *, rates: bool
) -> tuple[tuple[Cell, ...], ...]:
    lines = _source_rows(
        [("Modbus TCP", source.MODBUS_S), ("shared memory, semaphore", source.SHARED_MEMORY_S)]
    )
    lines += [(each["title"], each["waits"], durations(each)) for each in arrangement["contenders"]]
    rows: list[tuple[Cell, ...]] = []
    for name, waits, seconds in lines:
        cells: list[Cell] = [
            None
            if count not in seconds
            else source.kbit_per_second(count, seconds[count])
            if rates
            else seconds[count] * 1000
            for count in cycles
        ]
        rows.append((name, waits, *cells))
    return tuple(rows)


def _durations(arrangement: Mapping[str, Any], cycles: Sequence[int]) -> Table:
    return Table(
        f"{arrangement['title']}: duration by number of cycles (ms)",
        ("", "waits", *map(str, cycles)),
        _rows(arrangement, cycles, rates=False),
        arrangement["waiting"],
        "The source's rows are its tables 5.1 and 5.2. Medians of the rounds; empty: more cycles than fit "
        "into a turn of this run.",
    )


def _rates(arrangement: Mapping[str, Any], cycles: Sequence[int]) -> Table:
    return Table(
        f"{arrangement['title']}: transmission rate (kbit/s, 3,200 bits a cycle)",
        ("", "waits", *map(str, cycles)),
        _rows(arrangement, cycles, rates=True),
        arrangement["waiting"],
        f"The source states {source.SOURCE_KBIT_S['Modbus TCP']} and "
        f"{source.SOURCE_KBIT_S['shared memory']} kbit/s; its rows are computed from its durations.",
    )


def _latencies(arrangement: Mapping[str, Any]) -> Table:
    rows = []
    for each in arrangement["contenders"]:
        every = each["all"]
        cpu = sum(one["cpu_us"] for one in each["rounds"]) / len(each["rounds"])
        rows.append(
            (
                each["title"],
                each["waits"],
                statistics.median(one["run_us"] for one in each["rounds"]),
                every["p50_us"],
                shown(every, "p99"),
                shown(every, "p999"),
                every["max_us"],
                cpu,
                every["count"],
                f"{each['wrong']} of {each['runs']}",
            )
        )
    return Table(
        f"{arrangement['title']}: one cycle, there and back (µs)",
        (
            "",
            "waits",
            "median run",
            "p50",
            "p99",
            "p99.9",
            "max",
            "CPU of both",
            "cycles",
            "runs with wrong values",
        ),
        tuple(rows),
        arrangement["waiting"],
        "The median run is the median of the runs' mean cycles: what ratios and goals are computed from. Of "
        "fewer than 100 cycles there is no p99, of fewer than 1,000 no p99.9. CPU is processor time of both "
        "processes per cycle, warm-up and start of a turn included.",
    )


def _duration_figure(arrangement: Mapping[str, Any]) -> Figure:
    lines = [
        ("source: Modbus TCP", source.MODBUS_S),
        ("source: shared memory", source.SHARED_MEMORY_S),
        *((each["title"], durations(each)) for each in arrangement["contenders"]),
    ]
    return Figure(
        f"duration-{arrangement['name']}",
        f"Duration by number of cycles. {arrangement['title']}",
        "cycles",
        "s",
        tuple(
            Series(name, tuple(map(float, found)), tuple(found.values()), group=group_of(name))
            for name, found in lines
        ),
        x_log=True,
        y_log=True,
    )


def _rate_figure(arrangement: Mapping[str, Any]) -> Figure:
    bars = [
        ("source: Modbus TCP", float(source.SOURCE_KBIT_S["Modbus TCP"])),
        ("source: shared memory", float(source.SOURCE_KBIT_S["shared memory"])),
    ]
    for each in arrangement["contenders"]:
        middle_us = statistics.median(one["run_us"] for one in each["rounds"])
        bars.append((each["title"], source.kbit_per_second(1, middle_us / 1e6)))
    return Figure(
        f"rate-{arrangement['name']}",
        f"Transmission rate of the median run, 3,200 bits a cycle. {arrangement['title']}",
        "",
        "kbit/s",
        tuple(Series(name, (), (value,), group=group_of(name)) for name, value in bars),
        kind="bars",
        y_log=True,
    )


def _after(found: Found) -> tuple[str, ...]:
    wrong = sum(each["wrong"] for arrangement in found for each in arrangement["contenders"])
    runs = sum(each["runs"] for arrangement in found for each in arrangement["contenders"])
    requests = [
        f"{cell_text(ratio)} times as long as rosplc's in C ({words})"
        for arrangement, words in (
            (TWO_CORES, "two cores, rosplc spinning"),
            (ONE_CORE, "one core, both asleep"),
        )
        if (ratio := found.ratio(arrangement.name, "libmodbus-fc23", "rosplc-c")) is not None
    ]
    combined = (
        "libmodbus with the one request that writes and reads (FC23), which the goals do not use because "
        f"the source wrote and read apart, takes {' and '.join(requests)}.",
    )
    return (
        *(combined if requests else ()),
        f"Torn, lost or repeated messages would leave other values than twice the number of cycles: "
        f"**{wrong} of {runs} runs** did.",
        "Each cycle includes the two additions and one look at the clock, the same for every contender of a "
        "language: 100 additions and about 25 ns in C, one numpy addition of 100 numbers per side in Python.",
        "The same for all: the same 200 bytes each way, both processes pinned and started before, a "
        "connection or session that stays, a warm-up that does not count, one message under way at a time. "
        "In Python rosplc's two methods are called as they are; where a contender needs several calls for "
        "one message, or a comparison to find what is new, a function of a few lines joins them, as its "
        "users would write it. In each round every contender has its turn, in another order, and a ratio is"
        " the median of the rounds' ratios.",
    )
