"""The experiment: 100 numbers there and back, by every contender of this machine; and what waiting costs.

It repeats section 5.1 of the thesis that rosplc began with: a BeagleBone Black with CODESYS, 100 unsigned
integers of 16 bits each way per cycle. Its table 5.2 names its column Modbus too, by mistake: it is the one
of shared memory.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping
from typing import Any

from rosplc_bench.contenders import CONTENDERS, LIBMODBUS, ROSPLC_C, SEMAPHORE_C, SIGNAL_C
from rosplc_bench.figures import Cell, Figure, Series, cell_text
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
from rosplc_bench.report import Page, Section, Table, median_ratio, shown
from rosplc_bench.run import Context

MODBUS_S = {10: 0.075, 50: 0.371, 100: 0.750, 200: 1.515, 300: 2.278, 400: 3.055, 500: 3.820, 1000: 7.657}
"""Table 5.1 of the thesis, Modbus TCP: seconds by number of cycles."""
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
"""Table 5.2 of the thesis, shared memory with a semaphore."""
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
    load = [before, load_average()[0]]
    return {"cycles": list(CYCLES), "load": load, "arrangements": arrangements}


def render(data: Mapping[str, Any]) -> Page:
    """Return tables and figures of what was measured; see :class:`rosplc_bench.report.Section`."""
    found = Found(data["arrangements"])
    cycles: list[int] = data["cycles"]
    measured = [arrangement for arrangement in found if arrangement["contenders"]]
    tables = [table for table in (_ratios(found),) if table.rows]
    figures: list[Figure] = []
    for arrangement in measured:
        tables += [
            _by_cycles(
                arrangement,
                "duration by number of cycles (ms)",
                dict.fromkeys(cycles, 1000.0),
                "The reference rows are tables 5.1 and 5.2 of the thesis. Medians of the rounds; empty: more "
                "cycles than fit into a turn of this run.",
            ),
            _by_cycles(
                arrangement,
                "transmission rate (kbit/s, 3,200 bits a cycle)",
                dict.fromkeys(cycles),
                f"The thesis states {REFERENCE_KBIT_S['Modbus TCP']} and "
                f"{REFERENCE_KBIT_S['shared memory']} kbit/s; the reference rows are computed from its "
                "durations.",
            ),
            _latencies(arrangement),
        ]
        figures += [_duration_figure(arrangement), _rate_figure(arrangement)]
    about = {each["title"]: each["about"] for arrangement in found for each in arrangement["contenders"]}
    return Page(
        lead=("\n".join(f"* **{title}**: {text}." for title, text in about.items()),) if about else (),
        tables=tuple(tables),
        figures=tuple(figures),
        after=_after(found),
        summary=tuple(_summary(found)),
    )


_COMPARED = (
    (TWO_CORES, "in C", "rosplc-c", ("bare", "libmodbus", "semaphore-c")),
    (
        TWO_CORES,
        "in Python",
        "rosplc-python",
        ("pymodbus", "asyncua", "semaphore-python", "iceoryx2", "iceoryx2-blackboard"),
    ),
    (ONE_CORE, "in C", "rosplc-c", ("libmodbus", "libmodbus-fc23", "signal-c")),
    (ONE_CORE, "in Python", "rosplc-python", ("pymodbus", "asyncua", "iceoryx2", "iceoryx2-blackboard")),
)


def _ratios(found: Found) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for arrangement, language, ours, others in _COMPARED:
        entries = found.entries(arrangement.name)
        for other in others:
            if other in entries and ours in entries:
                rows.append(
                    (
                        f"{arrangement.title}, {language}",
                        f"{entries[other]['title']} ({entries[other]['waits']})",
                        found.median(arrangement.name, other),
                        found.median(arrangement.name, ours),
                        found.ratio(arrangement.name, other, ours),
                        found.ratio(arrangement.name, other, ours, "p99_us"),
                    )
                )
    return Table(
        "Compared with rosplc's channel: time of one cycle, there and back",
        ("", "compared", "its median run, µs", "rosplc's, µs", "ratio", "ratio of the 99th percentiles"),
        tuple(rows),
        "the first column names the arrangement, the second how the compared side waits",
        "A ratio is the median of the rounds' ratios. Where other programs use the cores, the 99th "
        "percentiles show those programs.",
    )


def _by_cycles(
    arrangement: Mapping[str, Any], what: str, scale: Mapping[int, float | None], note: str
) -> Table:
    """Return durations in seconds times ``scale``, or the rates where it is None."""
    lines: list[tuple[str, str, Mapping[int, float]]] = [
        (f"Modbus TCP ({_REFERENCE})", "not stated", MODBUS_S),
        (f"shared memory, semaphore ({_REFERENCE})", "not stated", SHARED_MEMORY_S),
        *((each["title"], each["waits"], durations(each)) for each in arrangement["contenders"]),
    ]
    rows: list[tuple[Cell, ...]] = []
    for name, waits, seconds in lines:
        cells: list[Cell] = []
        for count, factor in scale.items():
            if count not in seconds:
                cells.append(None)
            else:
                value = seconds[count]
                cells.append(kbit_per_second(count, value) if factor is None else value * factor)
        rows.append((name, waits, *cells))
    header = ("", "waits", *map(str, scale))
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
        f"{arrangement['title']}: one cycle, there and back (µs)",
        tuple(name for name, _ in columns),
        tuple(tuple(cell(each) for _, cell in columns) for each in arrangement["contenders"]),
        arrangement["waiting"],
        "The median run is the median of the runs' mean cycles; ratios are computed from it. Of fewer than "
        "100 cycles there is no p99, of fewer than 1,000 no p99.9. CPU is processor time of both processes "
        "per cycle, including the warm-up and start of a turn.",
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
        f"Transmission rate of the median run, 3,200 bits a cycle. {arrangement['title']}",
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


def _after(found: Found) -> tuple[str, ...]:
    wrong, runs = _counts(found)
    return (
        f"Torn, lost or repeated messages would leave other values than twice the number of cycles: "
        f"**{wrong} of {runs} runs** did.",
        "Each cycle includes the two additions and one reading of the clock, the same for every contender "
        "of a language: 100 additions and about 25 ns in C, one numpy addition of 100 numbers per side in "
        "Python.",
        "The same for all: 200 bytes each way, both processes pinned and started before, a connection or "
        "session that stays, a warm-up that does not count, one message under way at a time. rosplc's two "
        "methods are called directly in Python; where a contender needs several calls for one message, or a "
        "comparison to find what is new, a function of a few lines joins them, as its users would write it. "
        "In each round every contender has its turn, in another order.",
    )


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
            f"{cell_text(ratio)} x that of {other}"
            for other in others
            if (ratio := found.ratio(arrangement.name, other, ours)) is not None
        ]
        against = f"; its rate is {', '.join(ratios)}" if ratios else ""
        where = f"{arrangement.title}, {language}"
        yield f"{where}: rosplc takes {cell_text(middle)} µs there and back{against}."
    if cyclic := [part for each in CYCLIC if (part := _range(found, each))]:
        yield (
            f"Polling, there and back takes {' and '.join(cyclic)}. The programs' period decides, not what "
            "carries the data: one period, or more where an answer comes too late for it."
        )
    wrong, runs = _counts(found)
    if runs:
        yield f"Torn, lost or repeated messages: {wrong} of {runs:,} runs ended with wrong values."
        ratio = MODBUS_S[1000] / SHARED_MEMORY_S[1000]
        yield f"In the thesis, shared memory was {cell_text(ratio)} times as fast as Modbus TCP."


def _summary_table(found: Found) -> Iterator[str]:
    entries = {each.name: found.entries(each.name) for each in ARRANGEMENTS if found.entries(each.name)}
    titles = {name: each["title"] for one in entries.values() for name, each in one.items()}
    if not titles:
        return
    yield "100 numbers there and back, in microseconds:"
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
        yield " * sleeps in the socket: spinning is not possible there"
    yield ""


def _range(found: Found, arrangement: Arrangement) -> str:
    middle = [each["all"]["p50_us"] / 1000 for each in found.entries(arrangement.name).values()]
    if not middle:
        return ""
    cycle = f"in a cycle of {arrangement.period_ns / 1e6:g} ms"
    return f"{cell_text(min(middle))} to {cell_text(max(middle))} ms {cycle}"


EXPERIMENT = Section(
    "experiment",
    "100 numbers there and back",
    "Two processes exchange 100 unsigned integers of 16 bits: A writes 100, B reads them, adds one to each "
    "and writes 100 back, A reads and adds one; for 10 to 1000 cycles. The final values prove that nothing "
    "was torn, lost or repeated.",
    run,
    render,
    tuple(contender.name for contender in CONTENDERS),
)


# What waiting costs

_WAITERS = (SEMAPHORE_C, SIGNAL_C, ROSPLC_C, LIBMODBUS)


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
        for name, entry in found.entries(arrangement["name"]).items():
            middle, cpu, share = (
                found.median(arrangement["name"], name, key) for key in ("run_us", "cpu_us", "cpu_share")
            )
            rows.append(
                (
                    entry["title"],
                    arrangement["title"],
                    entry["waits"],
                    middle,
                    entry["all"]["p50_us"],
                    shown(entry["all"], "p99"),
                    cpu,
                    None if share is None else share * 100,
                )
            )
            label = f"{entry['title']}; {arrangement['title'].lower()}"
            bars.append(Series(label, (), (middle or 0.0,), group_of(label)))
    if not rows:
        return Page()
    table = Table(
        "One cycle, there and back, by the way to wait (µs)",
        ("", "where", "waits", "median run", "p50", "p99", "CPU of both", "CPU, % of one core"),
        tuple(rows),
        "the second and third column tell where and how",
        f"A cycle in the thesis: {MODBUS_S[1000]:.3f} ms over Modbus TCP, {SHARED_MEMORY_S[1000]:.3f} ms "
        "over shared memory.",
    )
    title = "One cycle, there and back, by the way to wait"
    figure = Figure("waiting", title, "", "µs (logarithmic)", tuple(bars), kind="bars", y_log=True)
    return Page(tables=(table,), figures=(figure,), after=_meaning(found), summary=_waiting_summary(found))


def _meaning(found: Found) -> tuple[str, ...]:
    each = [seconds / count * 1000 for count, seconds in SHARED_MEMORY_S.items()]
    text = [
        f"In the thesis, a cycle over shared memory takes {min(each):.2f} to {max(each):.2f} ms, with ten "
        "cycles as with a thousand: a constant, as of a wait, and thousands of times what copying 200 bytes "
        "takes."
    ]
    busy = found.median(ONE_CORE_BUSY.name, "semaphore-c")
    alone = found.median(TWO_CORES.name, "semaphore-c")
    if busy is not None and alone is not None:
        text.append(
            f"On one core of this machine the same design takes {cell_text(busy)} µs a cycle when it polls "
            f"without a pause, and {cell_text(alone)} µs on two cores, where neither side waits for a core: "
            f"**all but {cell_text(alone)} µs of that cycle is waiting** for the scheduler to take the core "
            "from the side that polls."
        )
    slept = found.median(ONE_CORE.name, "signal-c")
    if busy is not None and slept is not None:
        text.append(
            "The same memory and semaphores, with the semaphore as a signal instead of a lock, take "
            f"{cell_text(slept)} µs: {cell_text(busy / slept)} times less, and only the way to wait differs."
        )
    across = found.median(TWO_CORES_BLOCKING.name, "rosplc-c")
    asleep = found.median(ONE_CORE.name, "rosplc-c")
    if across is not None and asleep is not None:
        text.append(
            "With each side asleep on its own core, a cycle over rosplc's channel takes "
            f"{cell_text(across)} µs; where both share one core, {cell_text(asleep)} µs. An idle core must "
            "itself be woken first, in a virtual machine by the host."
        )
    modbus = found.ratio(ONE_CORE.name, "libmodbus", "rosplc-c")
    if modbus is not None:
        ratio = MODBUS_S[1000] / SHARED_MEMORY_S[1000]
        text.append(
            "With equal waiting, both asleep on one core until they are woken, libmodbus takes "
            f"{cell_text(modbus)} times as long as rosplc's channel; the thesis found {cell_text(ratio)}. "
            "It does not state how its programs waited. Its CODESYS side ran in the cycle of a task, and a "
            "cycle of a few milliseconds on one or both sides explains both of its figures as well: that is "
            "an inference."
        )
    return tuple(text)


def _waiting_summary(found: Found) -> tuple[str, ...]:
    busy = found.median(ONE_CORE_BUSY.name, "semaphore-c")
    alone = found.median(TWO_CORES.name, "semaphore-c")
    if busy is None or alone is None:
        return ()
    return (
        f"Shared memory and a semaphore on one core, polling without a pause: {cell_text(busy / 1000)} ms a "
        f"cycle, all but {cell_text(alone)} µs of it waiting (in the thesis: {SHARED_MEMORY_S[1000]:.2f} "
        "ms).",
    )


WAITING_SECTION = Section(
    "waiting",
    "What waiting costs",
    "The BeagleBone of the thesis has one core. Here its design, shared memory with a semaphore as a lock, "
    "runs on one core of this machine, and only the way to wait changes; two cores, where neither side "
    "waits for a core, show what the exchange itself costs.",
    run_waiting,
    render_waiting,
    tuple(contender.name for contender in _WAITERS),
)
