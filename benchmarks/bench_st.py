"""One Read and one Write block per cycle, in compiled Structured Text, against the C core doing the same.

usage: python -m benchmarks.bench_st [--rounds N] [--json]

The generated text is translated to C (tests/st/rosplc_st) and compiled with the same options as the core. A
cycle of Read takes one message in order, a cycle of Write publishes one; both look at the object's state
and beat. What is compared is the text's rules and copies, not a PLC: CODESYS' compiler makes other code of
it. Needs gcc and blark.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import measure
from rosplc.described import description_of
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.plc.build import build_project
from rosplc.plc.plan import PlcTask, PlcTopic
from rosplc.plc.project import object_text
from rosplc.shm import Direction, Namespace, OwnedChannel
from rosplc_bench.compiling import CORE, SOURCES
from rosplc_bench.process import Side
from rosplc_st.translator import translate

HERE = Path(__file__).resolve().parent
RUNTIME = HERE.parent / "tests" / "st" / "rosplc_st" / "runtime"
SLOTS = 32
TASK = "Bench"


@dataclass(frozen=True)
class Case:
    """A message type with its capacities, and how many cycles make a value."""

    type_name: str
    limits: Limits
    batch: int


CASES = {
    "Twist": Case("geometry_msgs/msg/Twist", Limits(), 2000),
    "JointState (6)": Case("sensor_msgs/msg/JointState", Limits(sequence=6), 1000),
    "Imu": Case("sensor_msgs/msg/Imu", Limits(), 1000),
    "Image, 64 KiB": Case("sensor_msgs/msg/Image", Limits(fields={"data": 65536}), 32),
}


def texts(store: TypeStore, layouts: list[Layout]) -> dict[str, str]:
    """Return a project with both blocks of each layout, and a program for each block."""
    topics = [
        PlcTopic(f"/{verb}{index}", layout, direction=direction, task=TASK)
        for index, layout in enumerate(layouts)
        for verb, direction in (("in", "read"), ("out", "write"))
    ]
    project = build_project(store, topics, [PlcTask(TASK)])
    found = {item.name: object_text(item) for item in (*project.duts, *project.gvls, *project.pous)}
    for index in range(len(layouts)):
        found[f"Read{index}"] = _program(
            f"Read{index}", f"ROS_Read.in{index}", "uiTask := 0, xInOrder := TRUE", "xNew"
        )
        found[f"Write{index}"] = _program(
            f"Write{index}", f"ROS_Write.out{index}", "uiTask := 0, xEnable := TRUE", "xPublished"
        )
    return found


def _program(name: str, block: str, inputs: str, moved: str) -> str:
    return (
        f"PROGRAM {name}\nVAR\n    udiCount : UDINT;\nEND_VAR\nRosPlc_State.axMayOpen[0] := TRUE;\n"
        f"{block}({inputs});\nIF {block}.{moved} THEN\n    udiCount := udiCount + 1;\nEND_IF;\nEND_PROGRAM\n"
    )


def build(folder: Path, objects: Mapping[str, str]) -> Path:
    """Translate and compile, together with the loop."""
    compiler = shutil.which("gcc")
    if compiler is None:
        raise RuntimeError("Debian package gcc is missing")
    source, program = folder / "plc.c", folder / "st_loop"
    source.write_text(translate(objects).code)
    flags = ("-std=gnu11", "-O2", "-w", "-fwrapv", "-fno-strict-aliasing")
    sources = (HERE / "st_loop.c", source, RUNTIME / "st_runtime.c", RUNTIME / "st_semaphore.c")
    headers = [f"-I{folder}" for folder in (CORE, SOURCES, RUNTIME)]
    subprocess.run([compiler, *flags, *headers, "-o", program, *sources, "-lm", "-pthread"], check=True)
    return program


@contextmanager
def objects_of(namespace: Namespace, index: int, layout: Layout) -> Iterator[list[str]]:
    """Make the objects of a case; give their file names: in, out, and the core's own out."""
    with ExitStack() as stack:
        names = []
        for verb, direction in (
            ("in", Direction.TO_PLC),
            ("out", Direction.TO_ROS),
            ("own", Direction.TO_ROS),
        ):
            about = description_of(layout, f"/{verb}{index}", direction, bridge="bench")
            channel = OwnedChannel.open(namespace, about, record_size=layout.size, slots=SLOTS)
            stack.callback(channel.close)
            names.append(channel.path.name)
        yield names


def compare(name: str, case: Case, layout: Layout, values: Mapping[str, list[float]]) -> dict[str, Any]:
    """Return a case's table."""
    rows = []
    for verb in ("read", "write"):
        core, text = values[f"C core, {verb}"], values[f"ST, {verb}"]
        rows.append(measure.row(f"C core, {verb}", core, ratio=1.0))
        rows.append(measure.row(f"ST, {verb}", text, ratio=measure.median_ratio(text, core)))
    facts = {"record": f"{layout.size} B", "type": case.type_name}
    return measure.table(f"{name}, one cycle", "ns", "no waiting", rows, facts)


def run(rounds: int, cases: Mapping[str, Case] | None = None) -> dict[str, Any]:
    """Measure in ``rounds`` rounds; returns a :func:`measure.report`."""
    before = measure.environment()
    cases = CASES if cases is None else cases
    store = TypeStore.bundled("jazzy")
    layouts = [compute_layout(store, case.type_name, case.limits) for case in cases.values()]
    tables = []
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory(dir="/dev/shm") as memory:
        program = build(Path(folder), texts(store, layouts))
        namespace = Namespace("rosplc", memory)
        for index, (name, case) in enumerate(cases.items()):
            with objects_of(namespace, index, layouts[index]) as names:
                arguments = (memory, *names, f"READ{index}", f"WRITE{index}", case.batch)
                with Side("st_loop", [str(program), *map(str, arguments)]) as loop:
                    values = measure.turns({"both": partial(loop.ask, "")}, rounds)
            tables.append(compare(name, case, layouts[index], values))
    return measure.report(tables, before)


if __name__ == "__main__":
    measure.main(run, __doc__, 20)
