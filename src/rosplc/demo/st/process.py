"""The PLC's process with ``--plc st``: runs the compiled Structured Text scan by scan.

All that a PLC would do, the Structured Text does: open, check, take, steer, send. This host calls
its programs in the task's order, works the operator's switch, and looks at memory after the
scan, to count and check what came, with the very code that the Python program is counted with.

The texts are what the generator writes, the PLC program, and a recorder, which keeps every message of a scan,
so that each is counted and checked and not only the one that ``msg`` holds in the end. It uses the blocks as
any program does.
"""

from __future__ import annotations

import importlib.util
import json
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rosplc
from rosplc.config.resolve import load_project
from rosplc.demo.plan import COMMAND, Plan, robot_topics
from rosplc.demo.plc import Program, serve_demo
from rosplc.demo.processes import Commands, report
from rosplc.errors import CODES, GenerationError, RosplcError, SetupError
from rosplc.layout import Layout
from rosplc.plc.names import instance_names
from rosplc.plc.project import PlcProject, project_texts


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
            "the translator for Structured Text is missing; it is no part of the installed package",
            where=str(root),
            remedy="Take a checkout of rosplc's sources, `make setup` there, and run "
            "`.venv/bin/rosplc demo --plc st`.",
        )
    if shutil.which("gcc") is None:
        raise SetupError("SYS001", "gcc is missing", remedy="sudo apt-get install gcc libc6-dev")
    if importlib.util.find_spec("rosplc_st") is None or importlib.util.find_spec("blark") is None:
        raise SetupError(
            "SYS001",
            "the Python package rosplc-st is missing, which translates Structured Text",
            remedy=f"pip install -e {shlex.quote(str(root / 'tests' / 'st'))}",
        )
    return Translator(root)


CONFIGURATION = "rosplc.yaml"
# The task's programs in the order of their calls.
READ, RECORDER, MAIN, WRITE = "SharedMemory_Read", "Demo_Recorder", "PLC_PRG", "SharedMemory_Write"
INBOX = "Demo_Inbox"


def write_configuration(folder: Path, plan: Plan) -> None:
    """Write the run's configuration, of which the generator makes the PLC project."""
    (folder / CONFIGURATION).write_text(json.dumps(plan.configuration(), indent=2), encoding="utf-8")


def write_texts(folder: Path, plan: Plan, project: PlcProject, programs: Path) -> None:
    """Write the whole PLC project into an empty folder, one ``.st`` file per object.

    ``project`` is what the generator makes of the run's configuration, ``programs`` the folder of the
    demonstration's own Structured Text.
    """
    texts = project_texts(project)
    for path in (Path(__file__).parent / "Demo_Steer.st", *sorted(programs.glob("*.st"))):
        texts[path.stem] = path.read_text(encoding="utf-8")
    texts |= _recorder(plan, project)
    for name, text in texts.items():
        (folder / f"{name}.st").write_text(text, encoding="utf-8")
    # The order in which objects depend on each other is the generator's.
    (folder / "objects.json").write_text(json.dumps(list(texts)), encoding="utf-8")


def read_texts(folder: Path) -> dict[str, str]:
    """Return what :func:`write_texts` wrote: text by object name."""
    names = json.loads((folder / "objects.json").read_text(encoding="utf-8"))
    return {name: (folder / f"{name}.st").read_text(encoding="utf-8") for name in names}


def _recorder(plan: Plan, project: PlcProject) -> dict[str, str]:
    names = instance_names(list(robot_topics(plan.topics)))
    duts = _message_types(project)
    inbox, body = [], []
    for name in names.values():
        inbox.append(f"    udi_{name} : UDINT; // messages of this scan")
        inbox.append(f"    ast_{name} : ARRAY[0..{plan.per_scan - 1}] OF {duts[name]};")
        body.append(
            f"""ROS_Read.{name}.uiMaxPerScan := {plan.per_scan};
{INBOX}.udi_{name} := 0;
xMore := ROS_Read.{name}.xNew;
WHILE xMore DO
    {INBOX}.ast_{name}[{INBOX}.udi_{name}] := ROS_Read.{name}.msg;
    {INBOX}.udi_{name} := {INBOX}.udi_{name} + 1;
    xMore := ROS_Read.{name}.Next();
END_WHILE;"""
        )
    gvl = ["// What came in this scan.", "{attribute 'qualified_only'}", "VAR_GLOBAL", *inbox, "END_VAR"]
    program = [
        "// Keeps every message of the scan to be counted and checked.",
        f"PROGRAM {RECORDER}",
        "VAR",
        "    xMore : BOOL;",
        "END_VAR",
        *body,
        "END_PROGRAM",
    ]
    return {INBOX: "\n".join(gvl) + "\n", RECORDER: "\n".join(program) + "\n"}


def _message_types(project: PlcProject) -> dict[str, str]:
    """Return the type of ``msg`` of each instance in ROS_Read."""
    types = {
        pou.name: {each.name: each.type for block in pou.blocks for each in block.variables}
        for pou in project.pous
    }
    (reads,) = (gvl for gvl in project.gvls if gvl.name == "ROS_Read")
    return {each.name: types[each.type]["msg"] for block in reads.blocks for each in block.variables}


class Word:
    """A BOOL or UINT or UDINT of the PLC's memory, by its path."""

    def __init__(self, machine: Any, path: str) -> None:
        self._machine = machine
        self._address, type_ = machine.find(path)
        self._size = machine.size(type_)

    def get(self) -> int:
        """Return its value."""
        return int.from_bytes(self._machine.peek(self._address, self._size), "little")

    def set(self, value: int) -> None:
        """Change it."""
        self._machine.poke(self._address, value.to_bytes(self._size, "little"))


class Inbox:
    """The messages of a topic that the recorder kept in this scan."""

    def __init__(self, machine: Any, instance: str, layout: Layout) -> None:
        self._machine = machine
        self._layout = layout
        self._count = Word(machine, f"{INBOX}.udi_{instance}")
        self._address, dut = machine.find(f"{INBOX}.ast_{instance}[0]")
        if machine.size(dut) != layout.size:
            raise SetupError(
                "SYS002",
                f"{layout.type_name} takes {machine.size(dut)} bytes in C, {layout.size} in its layout",
            )

    def messages(self) -> list[Any]:
        """Return views of copies."""
        size = self._layout.size
        return [
            self._layout.view(self._machine.peek(self._address + number * size, size))
            for number in range(self._count.get())
        ]


class Outputs:
    """The outputs of a block in the PLC's memory."""

    def __init__(self, machine: Any, path: str, *more: str) -> None:
        names = ("xPeerAlive", "udiError", *more)
        self._words = {name: Word(machine, f"{path}.{name}") for name in names}

    def __getattr__(self, name: str) -> int:
        return self._words[name].get()

    @property
    def reason(self) -> str:
        """Its error in words."""
        return CODES[f"SHM{error}"].title if (error := self.udiError) else ""


class StructuredText(Program):
    """The Structured Text as a program of the virtual PLC's task."""

    def __init__(self, plan: Plan, commands: Commands, folder: Path) -> None:
        translator = find_translator()
        self._machine = machine = translator.machine(translator.build(read_texts(folder)))
        machine.start()
        self._commands = commands
        self._kinds = robot_topics(plan.topics)
        layouts = {topic.topic: topic.layout for topic in load_project(folder / CONFIGURATION).topics}
        names = instance_names(list(self._kinds))
        self._inboxes = {topic: Inbox(machine, names[topic], layouts[topic]) for topic in self._kinds}
        write = instance_names([COMMAND[0]])[COMMAND[0]]
        super().__init__(
            {
                topic: Outputs(machine, f"ROS_Read.{names[topic]}", "udiSequence", "udiLost")
                for topic in names
            },
            Outputs(machine, f"ROS_Write.{write}", "xReady", "udiPublished"),
        )
        self._drive = Word(machine, f"{MAIN}.xDrive")
        self._scans = 0
        self._sum_ns = 0
        self._longest_ns = 0

    def __call__(self) -> None:
        """Run one scan, then count what it took."""
        self._drive.set(self._commands.go.is_set() and not self._commands.drain.is_set())
        began = time.perf_counter_ns()
        self._run(READ)
        self._run(RECORDER)
        taken_ns = time.time_ns()
        self._run(MAIN)
        self._run(WRITE)
        lasted_ns = time.perf_counter_ns() - began
        self._scans += 1
        self._sum_ns += lasted_ns
        self._longest_ns = max(self._longest_ns, lasted_ns)
        for topic, inbox in self._inboxes.items():
            for message in inbox.messages():
                self.arrivals.add(topic, self._kinds[topic].open(message), taken_ns)
        alone = {"mean_us": self._sum_ns / self._scans / 1000, "max_us": self._longest_ns / 1000}
        self.note(self.write.udiPublished, program=alone)

    def _run(self, program: str) -> None:
        try:
            self._machine.scan(program)
        except AssertionError as error:
            raise SetupError("SYS002", f"the Structured Text went wrong: {error}") from error

    def stop(self) -> None:
        """End the program as a PLC's stop does; its claims are given back."""
        self._machine.stop()


def main() -> None:
    """Run the PLC until told to stop."""
    commands = Commands()
    plan = Plan.from_json(sys.argv[1])
    try:
        program = StructuredText(plan, commands, Path(sys.argv[2]))
        serve_demo(program, plan.interval, commands)
    except RosplcError as error:
        report("error", **error.to_dict())
        sys.exit(1)
    program.stop()


if __name__ == "__main__":
    main()
