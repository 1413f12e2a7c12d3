"""Generation of every type of a distribution: time by step, and size of the text per type.

usage: python benchmarks/bench_generate.py [--rounds N] [--distro NAME] [--json]

Both blocks of each type are built and written into memory, as ``rosplc generate --all-types`` does
before it writes files. Steps are measured in every round, in turn, so that a slow moment of the
machine hits them alike.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from typing import Any

from rosplc.layout import Layout, compute_layout
from rosplc.layout.c_header import c_header
from rosplc.model import DISTROS, TypeStore
from rosplc.plc.build import build_type_library
from rosplc.plc.delivery import project_files
from rosplc.plc.plcopen import plcopen_xml
from rosplc.plc.project import Dut, Gvl, PlcProject, Pou
from rosplc.plc.script import import_script
from rosplc.plc.st_text import object_text
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
    """Measure in ``rounds`` rounds.

    Returns:
        ``types``: their number; ``steps``: ``median_ms`` and ``worst_ms`` of the rounds by step;
        ``files`` and ``bytes`` of the whole delivery; ``text_bytes``: median, largest and sum of the
        Structured Text per type, and which type is the largest.
    """
    steps = contenders(distro)
    times: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(rounds):
        for name, step in steps.items():
            start = time.perf_counter_ns()
            step()
            times[name].append((time.perf_counter_ns() - start) / 1e6)
    store = TypeStore.bundled(distro)
    layouts = [compute_layout(store, name) for name in store.names()]
    project = build_type_library(store, layouts)
    files = project_files(project, layouts, "rosplc")
    text = sizes(store, layouts, project)
    largest = max(text, key=lambda name: text[name])
    return {
        "distro": distro,
        "types": len(layouts),
        "steps": {
            name: {"median_ms": statistics.median(values), "worst_ms": max(values)}
            for name, values in times.items()
        },
        "files": len(files),
        "bytes": {
            "st": sum(len(content) for path, content in files.items() if path.startswith("st/")),
            **{path: len(content) for path, content in files.items() if "/" not in path},
        },
        "text_bytes": {
            "median": statistics.median(text.values()),
            "largest": text[largest],
            "largest_type": largest,
            "sum": sum(text.values()),
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--distro", choices=DISTROS, default="jazzy")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    result = run(arguments.rounds, arguments.distro)
    if arguments.json:
        print(json.dumps(result, indent=2))
        return
    print(f"{result['types']} types of {result['distro']}, both blocks each: {result['files']} files")
    print(f"{'ms':<24}{'median':>10}{'worst':>10}")
    for name, row in result["steps"].items():
        print(f"  {name:<22}{row['median_ms']:>10.1f}{row['worst_ms']:>10.1f}")
    print(f"{'bytes':<24}")
    for name, size in result["bytes"].items():
        print(f"  {name:<22}{size:>10}")
    text = result["text_bytes"]
    print(f"Structured Text per type: median {text['median']:.0f}, largest {text['largest']}", end=" ")
    print(f"({text['largest_type']}), sum {text['sum']}")


if __name__ == "__main__":
    main()
