"""The PLC's process with ``--plc st``: runs the compiled Structured Text scan by scan.

All that a PLC would do, the Structured Text does: open, check, take, steer, send. This host calls
its programs in the task's order. The texts are what the generator writes, the PLC program, and a recorder,
which passes on every message of a scan.
"""

from __future__ import annotations

import importlib.util
import json
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rosplc
from rosplc.demo.outside import STEER, TAKEN, Outside
from rosplc.demo.plan import COMMAND, Plan, robot_topics
from rosplc.demo.plc import serve_demo
from rosplc.demo.processes import Commands, report
from rosplc.errors import GenerationError, RosplcError, SetupError
from rosplc.plc.names import instance_names
from rosplc.plc.project import PlcProject, project_texts
from rosplc.virtual_plc import CycleStats


@dataclass(frozen=True)
class Translator:
    """The translator of a checkout, whose top folder is ``root``."""

    root: Path

    @property
    def programs(self) -> Path:
        """The folder of the demonstration's own Structured Text."""
        return self.root / "examples" / "st"

    def build(self, texts: Mapping[str, str], on_parsed: Callable[[int, int], None] | None = None) -> Any:
        """Translate and compile texts by object name; those known from before come from ``.cache``.

        ``on_parsed`` is called with how many of the new texts are parsed, and of how many. Raises
        GenerationError PLC004, a text cannot be translated; SetupError SYS001, gcc does not compile it.
        """
        from rosplc_st.build import build
        from rosplc_st.translator.source import TranslationError

        try:
            return build(texts, progress=on_parsed)
        except TranslationError as error:
            where = f"{error.file}.st:{error.line}"
            raise GenerationError("PLC004", str(error.what), where=where) from error
        except RuntimeError as error:
            if type(error) is not RuntimeError:
                raise  # what ends a command line is a RuntimeError, too
            raise SetupError(
                "SYS001", str(error).strip(), remedy="sudo apt-get install gcc libc6-dev"
            ) from error

    def machine(self, built: Any) -> Any:
        """Load a built program into this process, by the machine's own clock."""
        from rosplc_st.machine import LibraryMachine

        machine = LibraryMachine(built)
        machine.option("real_clock")
        return machine


def find_translator() -> Translator:
    """Return the translator of the checkout that this package runs from.

    Raises SetupError SYS001, there is none, or what it needs is missing; the remedy says how to get it.
    """
    root = Path(rosplc.__file__).resolve().parents[2]
    if not (root / "tests" / "st" / "pyproject.toml").is_file():
        raise SetupError(
            "SYS001",
            "the Structured Text translator is missing; it is not part of the installed package",
            where=str(root),
            remedy="Check out the rosplc sources, run `make setup` there, and then "
            "`.venv/bin/rosplc demo --plc st`.",
        )
    if shutil.which("gcc") is None:
        raise SetupError("SYS001", "gcc is missing", remedy="sudo apt-get install gcc libc6-dev")
    if importlib.util.find_spec("rosplc_st") is None or importlib.util.find_spec("blark") is None:
        raise SetupError(
            "SYS001",
            "the Python package rosplc-st, which translates Structured Text, is missing",
            remedy=f"pip install -e {shlex.quote(str(root / 'tests' / 'st'))}",
        )
    return Translator(root)


# The task's programs in the order of their calls.
READ, RECORDER, MAIN, WRITE = "SharedMemory_Read", "Demo_Recorder", "PLC_PRG", "SharedMemory_Write"


def write_texts(folder: Path, plan: Plan, project: PlcProject, programs: Path) -> None:
    """Write the whole PLC project into an empty folder, one ``.st`` file per object.

    ``project`` is what the generator makes of the run's configuration, ``programs`` the folder of the
    demonstration's own Structured Text.
    """
    texts = project_texts(project)
    for path in (STEER, *sorted(programs.glob("*.st"))):
        texts[path.stem] = path.read_text(encoding="utf-8")
    texts[RECORDER] = _recorder(plan)
    for name, text in texts.items():
        (folder / f"{name}.st").write_text(text, encoding="utf-8")
    # The order in which objects depend on each other is the generator's.
    (folder / "objects.json").write_text(json.dumps(list(texts)), encoding="utf-8")


def read_texts(folder: Path) -> dict[str, str]:
    """Return what :func:`write_texts` wrote: text by object name."""
    names = json.loads((folder / "objects.json").read_text(encoding="utf-8"))
    return {name: (folder / f"{name}.st").read_text(encoding="utf-8") for name in names}


def _recorder(plan: Plan) -> str:
    reads = instance_names(list(robot_topics(plan.topics)))
    writes = instance_names([COMMAND[0], *(f"{TAKEN}{topic}" for topic in reads)])
    lines = []
    for topic, name in reads.items():
        read, write = f"ROS_Read.{name}", f"ROS_Write.{writes[f'{TAKEN}{topic}']}"
        lines.append(
            f"""{read}.uiMaxPerScan := {plan.per_scan};
xMore := {read}.xNew;
WHILE xMore DO
    {write}.msg := {read}.msg;
    {write}.uliStamp := uliNow;
    {write}.xEnable := TRUE;
    {write}();
    xMore := {read}.Next();
END_WHILE;
{write}.xEnable := FALSE;
"""
        )
    return f"""// Passes on every message of the scan to be counted and checked.
PROGRAM {RECORDER}
VAR_INPUT
    uliNow : ULINT; // ns since 1970
END_VAR
VAR
    xMore : BOOL;
END_VAR
{"".join(lines)}END_PROGRAM
"""


class StructuredText:
    """The Structured Text as a program of the virtual PLC's task."""

    def __init__(self, folder: Path) -> None:
        translator = find_translator()
        self._machine = translator.machine(translator.build(read_texts(folder)))
        self._machine.start()
        self._stats = CycleStats()

    def __call__(self) -> None:
        """Run one scan, and measure it."""
        began = time.perf_counter_ns()
        self._run(READ)
        self._machine.set(f"{RECORDER}.uliNow", time.time_ns())
        for program in (RECORDER, MAIN, WRITE):
            self._run(program)
        self._stats.add(0, time.perf_counter_ns() - began)

    def alone(self) -> dict[str, float]:
        """Return mean and longest time of a scan, in µs."""
        return {"mean_us": self._stats.cycle_mean / 1000, "max_us": self._stats.cycle_max / 1000}

    def _run(self, program: str) -> None:
        try:
            self._machine.scan(program)
        except AssertionError as error:
            raise SetupError("SYS002", f"executing the Structured Text failed: {error}") from error

    def stop(self) -> None:
        """End the program as a PLC's stop does; its claims are given back."""
        self._machine.stop()


def main() -> None:
    """Run the PLC until told to stop."""
    commands = Commands()
    plan, folder = Plan.from_json(sys.argv[1]), Path(sys.argv[2])
    try:
        with ExitStack() as stack:
            watcher = Outside(plan, commands, folder, stack)
            program = StructuredText(folder)
            stack.callback(program.stop)

            def facts() -> dict[str, Any]:
                return {**watcher.status(), "program": program.alone()}

            serve_demo(program, plan.interval, commands, watcher.arrivals, facts)
    except RosplcError as error:
        report("error", **error.to_dict())
        sys.exit(1)


if __name__ == "__main__":
    main()
