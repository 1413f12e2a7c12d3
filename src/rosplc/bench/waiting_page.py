"""What waiting costs, for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rosplc.bench import source
from rosplc.bench.arrangements import ONE_CORE, ONE_CORE_BUSY, TWO_CORES, TWO_CORES_BLOCKING
from rosplc.bench.found import Found, group_of
from rosplc.bench.markdown import cell_text
from rosplc.bench.results import Cell, Figure, Page, Series, Table
from rosplc.bench.stats import shown

__all__ = ["page"]

_DESIGN = "semaphore-c"


def page(data: Mapping[str, Any]) -> Page:
    """Return the table of ways to wait, and what follows from it for the source's figures."""
    found = Found(data["arrangements"])
    rows: list[tuple[Cell, ...]] = []
    bars = [
        Series(f"source: {name}", (), (values[1000] * 1000,), group="source")
        for name, values in (("Modbus TCP", source.MODBUS_S), ("shared memory", source.SHARED_MEMORY_S))
    ]
    for arrangement in found:
        for name, entry in found.entries(arrangement["name"]).items():
            middle = found.median(arrangement["name"], name)
            cpu = found.median(arrangement["name"], name, "cpu_us")
            share = found.median(arrangement["name"], name, "cpu_share")
            every = entry["all"]
            rows.append(
                (
                    entry["title"],
                    arrangement["title"],
                    entry["waits"],
                    middle,
                    every["p50_us"],
                    shown(every, "p99"),
                    cpu,
                    None if share is None else share * 100,
                )
            )
            label = f"{entry['title']}; {arrangement['title'].lower()}"
            bars.append(Series(label, (), (middle or 0.0,), group=group_of(label)))
    if not rows:
        return Page()
    table = Table(
        "One cycle, there and back, by the way to wait (µs)",
        ("", "where", "waits", "median run", "p50", "p99", "CPU of both", "CPU, % of one core"),
        tuple(rows),
        "the second and third column say where and how",
        f"The source's cycle: {source.MODBUS_S[1000]:.3f} ms over Modbus TCP, "
        f"{source.SHARED_MEMORY_S[1000]:.3f} ms over shared memory.",
    )
    figure = Figure(
        "waiting",
        "One cycle, there and back, by the way to wait",
        "",
        "µs (logarithmic)",
        tuple(bars),
        kind="bars",
        y_log=True,
    )
    return Page(tables=(table,), figures=(figure,), after=_meaning(found), summary=_summary(found))


def _meaning(found: Found) -> tuple[str, ...]:
    each = [seconds / count * 1000 for count, seconds in source.SHARED_MEMORY_S.items()]
    text = [
        f"The source's cycle over shared memory takes {min(each):.2f} to {max(each):.2f} ms, whether ten "
        "or a thousand follow each other: a constant, as of a wait, and thousands of times what copying 200 "
        "bytes takes."
    ]
    busy = found.median(ONE_CORE_BUSY.name, _DESIGN)
    alone = found.median(TWO_CORES.name, _DESIGN)
    if busy is not None and alone is not None:
        text.append(
            f"On one core of this machine the source's design takes {cell_text(busy)} µs a cycle when it "
            f"looks again at once, and {cell_text(alone)} µs on two cores, where nobody waits for a core: "
            f"**all but {cell_text(alone)} µs of that cycle is waiting**, for the scheduler to take the core "
            "from the one that looks in vain."
        )
    slept = found.median(ONE_CORE.name, "signal-c")
    if busy is not None and slept is not None:
        text.append(
            "The same memory and semaphores, with the semaphore as a signal instead of a lock, take "
            f"{cell_text(slept)} µs: {cell_text(busy / slept)} times less, and only the way to wait was "
            "changed."
        )
    across = found.median(TWO_CORES_BLOCKING.name, "rosplc-c")
    asleep = found.median(ONE_CORE.name, "rosplc-c")
    if across is not None and asleep is not None:
        text.append(
            f"Asleep on a core each, a cycle over rosplc's channel takes {cell_text(across)} µs; where both "
            f"share one core, {cell_text(asleep)} µs. A core that has gone idle must itself be woken "
            "first, in a virtual machine by the host: that is the guest's price, not the transport's."
        )
    modbus = found.ratio(ONE_CORE.name, "libmodbus", "rosplc-c")
    if modbus is not None:
        ratio = source.MODBUS_S[1000] / source.SHARED_MEMORY_S[1000]
        text.append(
            "With equal waiting, both asleep on one core until they are woken, libmodbus takes "
            f"{cell_text(modbus)} times as long as rosplc's channel; the source found {cell_text(ratio)}. "
            "How its programs waited it does not say. Its CODESYS side ran in the cycle of a task, and a "
            "cycle of a few milliseconds on one or both sides explains both of its figures as well: that is "
            "an inference."
        )
    return tuple(text)


def _summary(found: Found) -> tuple[str, ...]:
    busy = found.median(ONE_CORE_BUSY.name, _DESIGN)
    alone = found.median(TWO_CORES.name, _DESIGN)
    if busy is None or alone is None:
        return ()
    return (
        f"The source's design on one core, looking again at once: {cell_text(busy / 1000)} ms a cycle, all "
        f"but {cell_text(alone)} µs of it waiting (the source's figure: "
        f"{source.SHARED_MEMORY_S[1000]:.2f} ms).",
    )
