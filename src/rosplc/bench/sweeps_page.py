"""What people read of the sweeps; made from their data alone."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from typing import Any

from rosplc.bench.results import Cell, Figure, Page, Series, Table

__all__ = ["PAYLOAD_NAMES", "TOPIC_NAMES", "render"]

PAYLOAD_NAMES = {
    "memcpy": "memcpy in and out (C)",
    "rosplc": "rosplc (C)",
    "semaphore": "shm, semaphore (C)",
    "memcpy-python": "memcpy in and out (Python)",
    "rosplc-python": "rosplc (Python)",
    "libmodbus": "Modbus TCP (libmodbus, C)",
    "pymodbus": "Modbus TCP (pymodbus)",
    "asyncua": "OPC UA (asyncua)",
}
"""Contender → its name where the size of the message varies."""

TOPIC_NAMES = {
    "rosplc": "rosplc (C)",
    "rosplc-batched": "rosplc, one call for all (Python)",
    "rosplc-single": "rosplc, one by one (Python)",
    "libmodbus": "Modbus TCP (libmodbus, C)",
    "pymodbus": "Modbus TCP (pymodbus)",
    "asyncua": "OPC UA (asyncua)",
}
"""Contender → its name where the number of topics varies."""

_WAITING = (
    "rosplc, memcpy and semaphore: nobody waits, one process writes and takes; Modbus and OPC UA: the "
    "client sleeps until the answer to each request comes, the server until a request comes, wherever "
    "the kernel puts the two"
)


def render(data: Mapping[str, Any]) -> Page:
    """Return the page; see :class:`rosplc.bench.section.Section`."""
    payload = _medians(data["payload"], "size")
    topics = _medians(data["topics"], "topics")
    return Page(
        lead=_LEAD,
        tables=(_payload_table(payload), _topic_table(topics)),
        figures=(
            Figure(
                "sweep-payload",
                "One message one way (nobody waits but for Modbus' and OPC UA's answers)",
                "bytes",
                "µs",
                _series(PAYLOAD_NAMES, payload, lambda _size, ns: ns / 1000),
                x_log=True,
                y_log=True,
            ),
            Figure(
                "sweep-topics",
                "Messages per second over so many topics (nobody waits but for Modbus' and OPC UA's answers)",
                "topics",
                "messages per second",
                _series(TOPIC_NAMES, topics, lambda count, ns: count / ns * 1e9),
                x_log=True,
                y_log=True,
            ),
        ),
        after=_after(data),
        summary=_summary(payload, topics),
    )


def _medians(entries: list[Mapping[str, Any]], key: str) -> dict[str, dict[int, float]]:
    found: dict[str, dict[int, float]] = {}
    for one in entries:
        found.setdefault(one["contender"], {})[one[key]] = statistics.median(one["ns"])
    return found


def _series(names: Mapping[str, str], found: Mapping[str, Mapping[int, float]], y: Any) -> tuple[Series, ...]:
    return tuple(
        Series(
            name,
            tuple(map(float, found[key])),
            tuple(y(x, ns) for x, ns in found[key].items()),
            group="rosplc" if key.startswith("rosplc") else "",
        )
        for key, name in names.items()
        if key in found
    )


def _table(
    title: str,
    first: str,
    names: Mapping[str, str],
    found: Mapping[str, Mapping[int, float]],
    y: Any,
    note: str,
) -> Table:
    shown = [key for key in names if key in found]
    points = sorted({x for values in found.values() for x in values})
    rows: list[tuple[Cell, ...]] = [
        (
            _size(x) if first == "size" else x,
            *(y(x, found[key][x]) if x in found[key] else None for key in shown),
        )
        for x in points
    ]
    return Table(title, (first, *(names[key] for key in shown)), tuple(rows), _WAITING, note)


def _payload_table(found: Mapping[str, Mapping[int, float]]) -> Table:
    return _table(
        "One message one way by its size, µs",
        "size",
        PAYLOAD_NAMES,
        found,
        lambda _size, ns: ns / 1000,
        "Medians of the rounds. Shared memory: written and taken; Modbus and OPC UA: written and "
        "acknowledged. Modbus takes 246 bytes per request and has addresses for 128 KiB in all.",
    )


def _topic_table(found: Mapping[str, Mapping[int, float]]) -> Table:
    return _table(
        "Messages per second by number of topics (a Twist each)",
        "topics",
        TOPIC_NAMES,
        found,
        lambda count, ns: count / ns * 1e9,
        "Medians of the rounds. In a round every topic is written once and read once. rosplc from "
        "Python also encodes each message for ROS, as the bridge does; Modbus carries 32-bit numbers.",
    )


def _size(size: int) -> str:
    for unit, name in ((1 << 20, "MiB"), (1 << 10, "KiB")):
        if size >= unit:
            return f"{size // unit} {name}"
    return f"{size} B"


def _summary(
    payload: Mapping[str, Mapping[int, float]], topics: Mapping[str, Mapping[int, float]]
) -> tuple[str, ...]:
    lines = []
    if "rosplc" in payload and "memcpy" in payload:
        size = max(payload["rosplc"])
        ratio = payload["rosplc"][size] / payload["memcpy"][size]
        lines.append(f"{_size(size)} through rosplc cost {ratio:.2f} times what memcpy in and out costs.")
    batched, single = topics.get("rosplc-batched"), topics.get("rosplc-single")
    if batched and single:
        most = max(batched)
        lines.append(
            f"{most} topics from Python: {most / batched[most] * 1e3:.2f} million messages per second "
            f"in one call for all, {most / single[most] * 1e3:.2f} one by one."
        )
    return tuple(lines)


_LEAD = (
    "By size: one message is written and taken (shared memory), or written and acknowledged (Modbus, "
    "OPC UA). By topics: each of so many topics gets a new message, and all are read. What arrived is "
    "compared with what was sent.",
)


def _after(data: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        "**What this means.** Up to some kilobytes a message costs what the call costs, not what its "
        "bytes cost: nanoseconds in C, a fraction of a microsecond from Python. From there on all "
        "shared memory costs what memcpy costs (from Python a taking copies once more, into a private "
        "buffer first, so that a rejected copy never shows), and the semaphore's lock is held as long "
        "as the copy takes. A request costs a journey through the kernel to another process and back, "
        "many times if the message does not fit into one.",
        "**What it does not.** Nobody waits for a message here, so this is no latency: the "
        "experiment's tables show that. Everything lies in the caches of one core where it fits, which "
        "is kind to shared memory; on two cores each line travels once more. The semaphore of that "
        "column is an unnamed one in the shared memory itself, which is what a named one maps too. "
        f"asyncua's server was asked for at most {data['server_most']:,} topics: it takes seconds to make "
        "the nodes of more.",
    )
