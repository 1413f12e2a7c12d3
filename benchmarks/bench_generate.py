"""Generation of every type of a distribution: time by step, and size of the text per type.

usage: python -m benchmarks.bench_generate [--rounds N] [--json]

Both blocks of each type are built and written into memory, as ``rosplc generate --all-types`` does
before it writes files. Steps are measured in every round, in turn, so that a slow moment of the
machine hits them alike.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from functools import partial
from typing import Any

from benchmarks import measure
from rosplc.layout import Layout, compute_layout
from rosplc.layout.c_header import c_header
from rosplc.model import TypeStore
from rosplc.plc.build import build_type_library
from rosplc.plc.delivery import import_script, project_files
from rosplc.plc.plcopen import plcopen_xml
from rosplc.plc.project import Dut, Gvl, PlcProject, Pou, object_text
from rosplc.plc.types import DutBuilder


def contenders(distro: str) -> dict[str, Callable[[], object]]:
    """Return the steps of a generation, each on the result of the one before."""
    store = TypeStore.bundled(distro)
    layouts = [compute_layout(store, name) for name in store.names()]
    project = build_type_library(store, layouts)
    items: list[Dut | Gvl | Pou] = [*project.duts, *project.gvls, *project.pous]
    return {
        "layouts": lambda: [compute_layout(store, name) for name in store.names()],
        "project": lambda: build_type_library(store, layouts),
        "st": lambda: [object_text(item) for item in items],
        "plcopen xml": lambda: plcopen_xml(project),
        "import script": lambda: import_script(project),
        "c header": lambda: c_header(layouts),
        "all deliveries": lambda: project_files(project, layouts, "rosplc"),
    }


def sizes(store: TypeStore, layouts: list[Layout], project: PlcProject) -> dict[str, int]:
    """Return the bytes of Structured Text that belong to each type: its DUT and its two blocks."""
    builder = DutBuilder(store)
    owner = {builder.add(layout): layout.type_name for layout in layouts}
    result: dict[str, int] = dict.fromkeys(owner.values(), 0)
    items: list[Dut | Pou] = [*project.duts, *project.pous]
    for item in items:
        name = item.name.removesuffix("_Read").removesuffix("_Write")
        type_name = owner.get(item.name) or owner.get(name)
        if type_name:
            result[type_name] += len(object_text(item))
    return result


def run(rounds: int, distro: str = "jazzy") -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`: time by step, and sizes as facts."""
    before = measure.environment()
    steps = {name: partial(_milliseconds, name, step) for name, step in contenders(distro).items()}
    times = measure.turns(steps, rounds)
    store = TypeStore.bundled(distro)
    layouts = [compute_layout(store, name) for name in store.names()]
    project = build_type_library(store, layouts)
    files = project_files(project, layouts, "rosplc")
    text = sizes(store, layouts, project)
    largest = max(text, key=lambda name: text[name])
    facts = {
        "types": len(layouts),
        "files": len(files),
        "bytes of Structured Text": sum(len(each) for path, each in files.items() if path.startswith("st/")),
        **{f"bytes of {path}": len(content) for path, content in files.items() if "/" not in path},
        "text per type, median": statistics.median(text.values()),
        "text per type, largest": text[largest],
        "largest type": largest,
        "text per type, sum": sum(text.values()),
    }
    rows = [measure.row(name, values, worst=max(values)) for name, values in times.items()]
    title = f"generate --all-types, {distro}"
    return measure.report([measure.table(title, "ms", "no waiting", rows, facts)], before)


def _milliseconds(name: str, step: Callable[[], object]) -> dict[str, list[float]]:
    return {name: [measure.mean_ns(step, 1) / 1e6]}


if __name__ == "__main__":
    measure.main(run, __doc__, 5)
