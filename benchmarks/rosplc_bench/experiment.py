"""The experiment: 100 numbers there and back, by every contender of this machine; and what waiting costs.

It repeats section 5.1 of the thesis that rosplc began with: a BeagleBone Black with CODESYS, 100 unsigned
integers of 16 bits each way per cycle. Its table 5.2 names its column Modbus too, by mistake: it is the one
of shared memory.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rosplc_bench.contenders import CONTENDERS
from rosplc_bench.draw import Cell, Figure, Series, cell_text
from rosplc_bench.machine import load_average
from rosplc_bench.pairs import (
    ARRANGEMENTS,
    CYCLES,
    CYCLIC,
    ONE_CORE,
    ONE_CORE_BUSY,
    TWO_CORES,
    TWO_CORES_BLOCKING,
    WAITING,
    Arrangement,
    take_turns,
)
from rosplc_bench.report import Page, Section, Table, median_ratio, paragraphs, shown, text
from rosplc_bench.run import Context

_MODBUS = (0.075, 0.371, 0.750, 1.515, 2.278, 3.055, 3.820, 7.657)
_SHARED_MEMORY = (0.039, 0.181, 0.350, 0.683, 1.018, 1.352, 1.684, 3.353)
MODBUS_S = dict(zip(CYCLES, _MODBUS, strict=True))
"""Table 5.1 of the thesis, Modbus TCP: seconds by number of cycles."""
SHARED_MEMORY_S = dict(zip(CYCLES, _SHARED_MEMORY, strict=True))
"""Table 5.2 of the thesis, shared memory with a semaphore."""
REFERENCE_RATIO = MODBUS_S[1000] / SHARED_MEMORY_S[1000]
REFERENCE_KBIT_S = {"Modbus TCP": 423, "shared memory": 919}
"""The rates of the thesis, from its figure 5.4 and the text above it."""
BITS_PER_CYCLE = 3200
"""200 numbers of 16 bits."""


def kbit_per_second(cycles: int, seconds: float) -> float:
    """Return the rate at 3,200 bits a cycle."""
    return BITS_PER_CYCLE * cycles / seconds / 1000


class Found:
    """The data of :func:`rosplc_bench.pairs.take_turns`.

    Args:
        arrangements: Its list.
    """

    def __init__(self, arrangements: list[Mapping[str, Any]]) -> None:
        self._arrangements = {each["name"]: each for each in arrangements}

    def __iter__(self) -> Iterator[Mapping[str, Any]]:
        return iter(self._arrangements.values())

    def entries(self, arrangement: str) -> dict[str, Mapping[str, Any]]:
        """Return the contenders of an arrangement by name; none if it was not measured."""
        found = self._arrangements.get(arrangement)
        return {} if found is None else {each["name"]: each for each in found["contenders"]}

    def values(self, arrangement: str, contender: str, key: str) -> list[float]:
        """Return a key's value of each round; none if it was not measured."""
        entry = self.entries(arrangement).get(contender)
        return [] if entry is None else [each[key] for each in entry["rounds"]]

    def ratio(self, arrangement: str, slower: str, faster: str, key: str = "run_us") -> float | None:
        """Return the median over the rounds of ``slower`` divided by ``faster``; None without both."""
        these = self.values(arrangement, slower, key)
        those = self.values(arrangement, faster, key)
        return median_ratio(these, those) if these and those else None

    def median(self, arrangement: str, contender: str, key: str = "run_us") -> float | None:
        """Return the median of the rounds; None if it was not measured."""
        values = self.values(arrangement, contender, key)
        return statistics.median(values) if values else None


def group_of(title: str) -> str:
    """Return the group of a series: whose figure it is."""
    return next((group for group in ("reference:", "rosplc") if title.startswith(group)), "").rstrip(":")


def durations(entry: Mapping[str, Any]) -> dict[int, float]:
    """Return the median of the rounds' durations in seconds, by number of cycles."""
    gathered: dict[int, list[float]] = {}
    for each in entry["rounds"]:
        for count, seconds in each["durations_s"].items():
            gathered.setdefault(int(count), []).append(seconds)
    return {count: statistics.median(values) for count, values in gathered.items()}


# The experiment

_REFERENCE = "reference: BeagleBone Black, CODESYS"


def run(context: Context) -> dict[str, Any]:
    """Measure; see :class:`rosplc_bench.report.Section`."""
    before = load_average()[0]
    arrangements = take_turns(context, CONTENDERS, ARRANGEMENTS)
    return {"cycles": list(CYCLES), "load": [before, load_average()[0]], "arrangements": arrangements}


def render(data: Mapping[str, Any]) -> Page:
    """Return tables and figures of what was measured; see :class:`rosplc_bench.report.Section`."""
    found = Found(data["arrangements"])
    tables = [table for table in (_ratios(found),) if table.rows]
    figures: list[Figure] = []
    thesis = {"modbus": REFERENCE_KBIT_S["Modbus TCP"], "memory": REFERENCE_KBIT_S["shared memory"]}
    for each in found:
        if each["contenders"]:
            tables += [
                _by_cycles(
                    each, "duration by number of cycles (ms)", data["cycles"], text("experiment durations")
                ),
                _by_cycles(
                    each,
                    "transmission rate (kbit/s, 3,200 bits per cycle)",
                    data["cycles"],
                    text("experiment rates", **thesis),
                    rate=True,
                ),
                _latencies(each),
            ]
            figures += [_duration_figure(each), _rate_figure(each)]
    about = {each["title"]: each["about"] for arrangement in found for each in arrangement["contenders"]}
    wrong, runs = _counts(found)
    return Page(
        lead=("\n".join(f"* **{title}**: {words}." for title, words in about.items()),) if about else (),
        tables=tuple(tables),
        figures=tuple(figures),
        after=paragraphs("experiment after", wrong=wrong, runs=runs),
        summary=tuple(_summary(found)),
    )


_PYTHON = ("pymodbus", "asyncua", "iceoryx2", "iceoryx2-blackboard")
_COMPARED = (
    (TWO_CORES, "in C", "rosplc-c", ("bare", "libmodbus", "semaphore-c")),
    (TWO_CORES, "in Python", "rosplc-python", (*_PYTHON[:2], "semaphore-python", *_PYTHON[2:])),
    (ONE_CORE, "in C", "rosplc-c", ("libmodbus", "libmodbus-fc23", "signal-c")),
    (ONE_CORE, "in Python", "rosplc-python", _PYTHON),
)


def _ratios(found: Found) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for arrangement, language, ours, others in _COMPARED:
        here = arrangement.name
        entries = found.entries(here)
        for other in others if ours in entries else ():
            if other in entries:
                times = (found.median(here, each) for each in (other, ours))
                ratios = (found.ratio(here, other, ours, key) for key in ("run_us", "p99_us"))
                compared = f"{entries[other]['title']} ({entries[other]['waits']})"
                rows.append((f"{arrangement.title}, {language}", compared, *times, *ratios))
    return Table(
        "Compared with rosplc's channel: time of one cycle (round trip)",
        ("", "compared", "median run, µs", "rosplc, µs", "ratio", "ratio of the 99th percentiles"),
        tuple(rows),
        "the first column shows the arrangement, the second how the compared contender waits",
        text("experiment ratios"),
    )


def _by_cycles(
    arrangement: Mapping[str, Any], what: str, cycles: Sequence[int], note: str, *, rate: bool = False
) -> Table:
    """Return durations in milliseconds, or the rates."""
    rows: list[tuple[Cell, ...]] = []
    for name, waits, seconds in (
        (f"Modbus TCP ({_REFERENCE})", "not stated", MODBUS_S),
        (f"shared memory, semaphore ({_REFERENCE})", "not stated", SHARED_MEMORY_S),
        *((each["title"], each["waits"], durations(each)) for each in arrangement["contenders"]),
    ):
        found = {n: kbit_per_second(n, value) if rate else value * 1000 for n, value in seconds.items()}
        rows.append((name, waits, *map(found.get, cycles)))
    header = ("", "waits", *map(str, cycles))
    return Table(f"{arrangement['title']}: {what}", header, tuple(rows), arrangement["waiting"], note)


def _latencies(arrangement: Mapping[str, Any]) -> Table:
    columns = (
        ("", lambda each: each["title"]),
        ("waits", lambda each: each["waits"]),
        ("median run", lambda each: statistics.median(one["run_us"] for one in each["rounds"])),
        ("p50", lambda each: each["all"]["p50_us"]),
        ("p99", lambda each: shown(each["all"], "p99")),
        ("p99.9", lambda each: shown(each["all"], "p999")),
        ("max", lambda each: each["all"]["max_us"]),
        ("CPU of both", lambda each: statistics.fmean(one["cpu_us"] for one in each["rounds"])),
        ("cycles", lambda each: each["all"]["count"]),
        ("runs with wrong values", lambda each: f"{each['wrong']} of {each['runs']}"),
    )
    return Table(
        f"{arrangement['title']}: one cycle (round trip, µs)",
        tuple(name for name, _ in columns),
        tuple(tuple(cell(each) for _, cell in columns) for each in arrangement["contenders"]),
        arrangement["waiting"],
        text("experiment latencies"),
    )


def _duration_figure(arrangement: Mapping[str, Any]) -> Figure:
    lines = [
        ("reference: Modbus TCP", MODBUS_S),
        ("reference: shared memory", SHARED_MEMORY_S),
        *((each["title"], durations(each)) for each in arrangement["contenders"]),
    ]
    return Figure(
        f"duration-{arrangement['name']}",
        f"Duration by number of cycles. {arrangement['title']}",
        "cycles",
        "s",
        tuple(
            Series(name, tuple(map(float, found)), tuple(found.values()), group_of(name))
            for name, found in lines
        ),
        x_log=True,
        y_log=True,
    )


def _rate_figure(arrangement: Mapping[str, Any]) -> Figure:
    bars = [(f"reference: {name}", float(value)) for name, value in REFERENCE_KBIT_S.items()]
    for each in arrangement["contenders"]:
        middle_us = statistics.median(one["run_us"] for one in each["rounds"])
        bars.append((each["title"], kbit_per_second(1, middle_us / 1e6)))
    return Figure(
        f"rate-{arrangement['name']}",
        f"Transmission rate of the median run, 3,200 bits per cycle. {arrangement['title']}",
        "",
        "kbit/s",
        tuple(Series(name, (), (value,), group_of(name)) for name, value in bars),
        kind="bars",
        y_log=True,
    )


def _counts(found: Found) -> tuple[int, int]:
    """Return how many runs ended with wrong values, and how many there were."""
    entries = [entry for arrangement in found for entry in arrangement["contenders"]]
    return sum(entry["wrong"] for entry in entries), sum(entry["runs"] for entry in entries)


_COLUMNS = {
    TWO_CORES.name: ("two cores,", "spinning"),
    ONE_CORE.name: ("one core,", "asleep"),
    CYCLIC[0].name: ("polling", "at 1 ms"),
    CYCLIC[1].name: ("polling", "at 10 ms"),
}
_TITLE, _COLUMN = 39, 10


def _summary(found: Found) -> Iterator[str]:
    """Yield the table for the terminal, then one line per arrangement and language, then the check."""
    yield from _summary_table(found)
    for arrangement, language, ours, others in _COMPARED:
        if (middle := found.median(arrangement.name, ours)) is None:
            continue
        ratios = [
            f"{cell_text(ratio)} times that of {other}"
            for other in others
            if (ratio := found.ratio(arrangement.name, other, ours)) is not None
        ]
        against = f"; its rate is {', '.join(ratios)}" if ratios else ""
        where = f"{arrangement.title}, {language}"
        yield f"{where}: rosplc takes {cell_text(middle)} µs per round trip{against}."
    if cyclic := [part for each in CYCLIC if (part := _range(found, each))]:
        yield (
            f"With polling, a round trip takes {' and '.join(cyclic)}. This depends on the period, not on "
            "the transport: one period, or more if a response arrives too late."
        )
    wrong, runs = _counts(found)
    if runs:
        yield f"Torn, lost or repeated messages: {wrong} of {runs:,} runs ended with wrong values."
        yield f"In the thesis, shared memory was {cell_text(REFERENCE_RATIO)} times as fast as Modbus TCP."


def _summary_table(found: Found) -> Iterator[str]:
    entries = {each.name: found.entries(each.name) for each in ARRANGEMENTS if found.entries(each.name)}
    titles = {name: each["title"] for one in entries.values() for name, each in one.items()}
    if not titles:
        return
    yield "Round trip of 100 numbers, in microseconds:"
    for row in range(2):
        yield (
            f" {'':{_TITLE}}" + "".join(f"{_COLUMNS[name][row]:>{_COLUMN - 1}} " for name in entries).rstrip()
        )
    stars = False
    for contender, title in titles.items():
        cells = ""
        for name, here in entries.items():
            # A socket cannot be polled without a pause: the column marks a contender that waits otherwise.
            star = (
                name == TWO_CORES.name
                and contender in here
                and not here[contender]["waits"].startswith("spins")
            )
            stars |= star
            cells += f"{cell_text(found.median(name, contender))}{'*' if star else ' '}".rjust(_COLUMN)
        yield f" {title[:_TITLE]:{_TITLE}}{cells}".rstrip()
    if stars:
        yield " * blocks on the socket, because it cannot spin"
    yield ""


def _range(found: Found, arrangement: Arrangement) -> str:
    middle = [each["all"]["p50_us"] / 1000 for each in found.entries(arrangement.name).values()]
    if not middle:
        return ""
    cycle = f"in a cycle of {arrangement.period_ns / 1e6:g} ms"
    return f"{cell_text(min(middle))} to {cell_text(max(middle))} ms {cycle}"


EXPERIMENT = Section(
    "experiment",
    "Round trip of 100 numbers",
    text("experiment question"),
    run,
    render,
    tuple(contender.name for contender in CONTENDERS),
)


# What waiting costs

_NAMES = ("semaphore-c", "signal-c", "rosplc-c", "libmodbus")
_WAITERS = [each for name in _NAMES for each in CONTENDERS if each.name == name]


def run_waiting(context: Context) -> dict[str, Any]:
    """Measure; see :class:`rosplc_bench.report.Section`."""
    return {"arrangements": take_turns(context, _WAITERS, (*WAITING, TWO_CORES))}


def render_waiting(data: Mapping[str, Any]) -> Page:
    """Return the table of ways to wait, and what follows from it for the figures of the thesis."""
    found = Found(data["arrangements"])
    rows: list[tuple[Cell, ...]] = []
    bars = [
        Series(f"reference: {name}", (), (values[1000] * 1000,), "reference")
        for name, values in (("Modbus TCP", MODBUS_S), ("shared memory", SHARED_MEMORY_S))
    ]
    for arrangement in found:
        here, where = arrangement["name"], arrangement["title"]
        for name, entry in found.entries(here).items():
            middle, cpu, share = (found.median(here, name, key) for key in ("run_us", "cpu_us", "cpu_share"))
            times = (middle, entry["all"]["p50_us"], shown(entry["all"], "p99"), cpu)
            percent = None if share is None else share * 100
            rows.append((entry["title"], where, entry["waits"], *times, percent))
            label = f"{entry['title']}; {where.lower()}"
            bars.append(Series(label, (), (middle or 0.0,), group_of(label)))
    if not rows:
        return Page()
    title = "One cycle (round trip), by method of waiting"
    table = Table(
        f"{title} (µs)",
        ("", "where", "waits", "median run", "p50", "p99", "CPU of both", "CPU, % of one core"),
        tuple(rows),
        "see the second and third columns",
        f"In the thesis, a cycle takes {MODBUS_S[1000]:.3f} ms over Modbus TCP and "
        f"{SHARED_MEMORY_S[1000]:.3f} ms over shared memory.",
    )
    figure = Figure("waiting", title, "", "µs (logarithmic)", tuple(bars), kind="bars", y_log=True)
    return Page((), (table,), (figure,), tuple(_meaning(found)), tuple(_waiting_summary(found)))


def _meaning(found: Found) -> Iterator[str]:
    each = [seconds / count * 1000 for count, seconds in SHARED_MEMORY_S.items()]
    busy, alone = (found.median(here.name, "semaphore-c") for here in (ONE_CORE_BUSY, TWO_CORES))
    across, asleep = (found.median(here.name, "rosplc-c") for here in (TWO_CORES_BLOCKING, ONE_CORE))
    slept = found.median(ONE_CORE.name, "signal-c")
    modbus = found.ratio(ONE_CORE.name, "libmodbus", "rosplc-c")
    times = busy / slept if busy and slept else None
    yield text("waiting always", least=min(each), most=max(each))
    for key, values in (
        ("busy", {"busy": busy, "alone": alone}),
        ("signal", {"slept": slept, "times": times}),
        ("asleep", {"across": across, "asleep": asleep}),
        ("equal", {"modbus": modbus, "thesis": REFERENCE_RATIO}),
    ):
        if None not in values.values():
            yield text(f"waiting {key}", **{name: cell_text(value) for name, value in values.items()})


def _waiting_summary(found: Found) -> Iterator[str]:
    busy, alone = (found.median(here.name, "semaphore-c") for here in (ONE_CORE_BUSY, TWO_CORES))
    if busy is not None and alone is not None:
        yield (
            "Shared memory and a semaphore on one core, polling without a pause: "
            f"{cell_text(busy / 1000)} ms per cycle, of which all but {cell_text(alone)} µs is waiting "
            f"(in the thesis: {SHARED_MEMORY_S[1000]:.2f} ms)."
        )


WAITING_SECTION = Section(
    "waiting", "What waiting costs", text("waiting question"), run_waiting, render_waiting, _NAMES
)
