"""The PLC's process with ``--plc openplc``: starts OpenPLC's runtime with the PLC program, and watches it.

The program passes on every message that it took, over channels of this process, which counts and checks
each with the very code that the Python program is counted with.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

import rosplc
from rosplc.config.resolve import Project, load_project
from rosplc.demo.plan import COMMAND, Plan, robot_topics
from rosplc.demo.plc import Arrivals
from rosplc.demo.processes import Commands, report
from rosplc.described import description_of
from rosplc.errors import RosplcError, SetupError
from rosplc.monitor.watch import Watch
from rosplc.plc.base import render
from rosplc.plc.names import instance_names, time_literal
from rosplc.shm import Namespace, OwnedChannel

RUN = Path("/run/runtime")  # OpenPLC's own folder for its sockets
_BUILT = {"ROSPLC_OPENPLC": "build/plc_main", "ROSPLC_STRUCPP": "dist/index.js"}
_CONFIGURATION = "rosplc.yaml"
_DRIVE, _TAKEN = "/demo/drive", "/demo/taken"


def find_openplc() -> tuple[Path, Path]:
    """Return the folders of OpenPLC's runtime and of STruC++, which ROSPLC_OPENPLC and ROSPLC_STRUCPP name.

    Raises SetupError: SYS001, something is missing; SYS002, a runtime is running already.
    """
    for variable, file in _BUILT.items():
        if not (Path(os.environ.get(variable) or "/nowhere") / file).is_file():
            raise SetupError(
                "SYS001",
                f"{variable} does not name a folder with {file}",
                where=os.environ.get(variable, ""),
                remedy="Build OpenPLC Runtime 4.1 and STruC++ as docs/tutorial/openplc.md says, and let "
                "ROSPLC_OPENPLC and ROSPLC_STRUCPP name their folders.",
            )
    for program, package in (("node", "nodejs"), ("g++", "g++"), ("make", "make")):
        if shutil.which(program) is None:
            raise SetupError("SYS001", f"{program} is missing", remedy=f"sudo apt-get install {package}")
    if Runtime.ask("STATUS"):
        what = "another OpenPLC runtime is running"
        raise SetupError("SYS002", what, where=str(RUN), remedy="End it: a machine can have one.")
    openplc, strucpp = (Path(os.environ[variable]).resolve() for variable in _BUILT)
    return openplc, strucpp


def prepare(folder: Path, project: Project, program: str) -> None:
    """Lay out a runtime's folder, and have STruC++ compile a program in Structured Text for a configuration.

    Raises SetupError as :func:`find_openplc`, and SYS002: it does not compile.
    """
    openplc, strucpp = find_openplc()
    for name in ("scripts", "core/src", "core/strucpp_runtime"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).symlink_to(openplc / name)
    (folder / "plugins.conf").touch()
    rosplc.generate(project, folder / "plc", plc="openplc")
    (folder / "program.st").write_text(program, encoding="ascii")
    _run(folder, "node", "plc/build.mjs", str(strucpp), "program.st", "core/generated")


def compile_prepared(folder: Path) -> None:
    """Have the runtime's own scripts compile what STruC++ wrote. Raises SetupError SYS002."""
    for script in ("compile.sh", "compile-clean.sh"):
        _run(folder, "bash", f"scripts/{script}")


def _run(folder: Path, *command: str) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        output = "\n".join((done.stdout + done.stderr).splitlines()[-15:])
        raise SetupError("SYS002", f"{command[1]} failed:\n{output}", where=str(folder))


class Runtime:
    """OpenPLC's runtime, running the program of a folder that was prepared and compiled; ends with us.

    Raises SetupError: SYS001, its folder is missing and this user cannot make it; SYS002, it ended.
    """

    def __init__(self, folder: Path) -> None:
        try:
            RUN.mkdir(exist_ok=True)
        except OSError as error:
            what, remedy = f"it cannot be made: {error.strerror}", f"sudo install -d -o $USER {RUN}"
            raise SetupError("SYS001", what, where=str(RUN), remedy=remedy) from error
        main = Path(os.environ["ROSPLC_OPENPLC"]).resolve() / _BUILT["ROSPLC_OPENPLC"]
        command = ["setpriv", "--pdeathsig", "KILL", str(main), "--print-logs"]
        self._process = subprocess.Popen(command, cwd=folder, stdout=sys.stderr)
        while "RUNNING" not in self.ask("STATUS"):
            if self._process.poll() is not None:
                raise SetupError("SYS002", "OpenPLC's runtime has ended", where=str(folder))
            time.sleep(0.05)

    @staticmethod
    def ask(command: str) -> str:
        """Return the answer of this machine's runtime; empty if there is none."""
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(5)
            try:
                connection.connect(str(RUN / "plc_runtime.socket"))
                connection.sendall(f"{command}\n".encode())
                return connection.recv(65536).decode()
            except OSError:
                return ""

    def kill(self) -> None:
        """End it; 4.1.4 itself faults at any other end."""
        self._process.kill()
        self._process.wait()


def write_program(folder: Path, plan: Plan) -> tuple[Project, str]:
    """Write the configuration of the PLC's half into a folder; return it, and the PLC program's text."""
    kinds = robot_topics(plan.topics)
    configuration = plan.configuration()
    topics = configuration["topics"]
    topics |= {f"{_TAKEN}{topic}": {**topics[topic], "to": "ros"} for topic in kinds}
    topics[_DRIVE] = {"type": "std_msgs/msg/Bool", "to": "plc"}
    (folder / _CONFIGURATION).write_text(json.dumps(configuration), encoding="utf-8")
    program = render(
        "openplc/demo.st",
        steer=(Path(__file__).parent / "st/Demo_Steer.st").read_text(encoding="ascii"),
        kinds=kinds,
        names=instance_names(list(kinds)),
        command=COMMAND[0],
        drive=_DRIVE,
        taken=_TAKEN,
        per_scan=plan.per_scan,
        interval=time_literal(round(plan.interval * 1e9)),
    )
    return load_project(folder / _CONFIGURATION), program


class Outside:
    """The runtime's program, seen from the outside: what it passed on, and what its channels say."""

    def __init__(self, plan: Plan, commands: Commands, folder: Path, stack: ExitStack) -> None:
        self._commands = commands
        self._kinds = robot_topics(plan.topics)
        self._arrivals = Arrivals(self._kinds)
        project = load_project(folder / _CONFIGURATION)
        self._plans = {topic.topic: topic for topic in project.topics}
        channels = {}
        for topic, own in self._plans.items():
            if topic.startswith("/demo/"):
                about = description_of(own.layout, topic, own.direction, bridge="demo")
                size = own.layout.size
                opened = OwnedChannel.open(Namespace(plan.prefix), about, record_size=size, slots=plan.slots)
                stack.callback(opened.close)
                channels[topic] = opened
        self._drive = channels[_DRIVE].writer()
        self._readers = {topic: channels[f"{_TAKEN}{topic}"].reader() for topic in self._kinds}
        self._halted = 0  # the first message that told the program to drive no more
        self._watch = stack.enter_context(Watch(plan.prefix))

    def look(self) -> None:
        """Set the operator's switch, and count what the program passed on."""
        halt = self._commands.drain.is_set()
        driving = self._commands.go.is_set() and not halt
        number = self._drive.publish(self._plans[_DRIVE].layout.pack({"data": driving}))
        self._halted = self._halted or number * halt
        for topic, reader in self._readers.items():
            layout, open_message = self._plans[topic].layout, self._kinds[topic].open
            record = bytearray(layout.size)
            while taken := reader.next(record):
                self._arrivals.add(topic, open_message(layout.view(record)), taken.stamp_ns)
            reader.beat()

    def status(self) -> dict[str, Any]:
        """Return what the parent shows and compares."""
        views = {view.topic: view for view in self._watch.look().channels}
        alive = {topic for topic, view in views.items() if view.plc_alive and view.bridge_alive}
        waiting = {
            topic: views[topic].words if topic in views else "" for topic in self._plans.keys() - alive
        }
        # The switch was taken before the commands were counted.
        drained = 0 < self._halted <= max((line.taken for line in views[_DRIVE].readers), default=0)
        command = views.get(COMMAND[0])
        return {
            "ready": not waiting,
            "waiting": waiting,
            "drained": drained,
            "sent": {COMMAND[0]: command.received if command else 0},
            "received": {topic: asdict(tally) for topic, tally in self._arrivals.tallies.items()},
            "counters": {topic: {"lost": views[topic].lost} for topic in self._kinds if topic in views},
            "age": self._arrivals.recent(),
            "ages": self._arrivals.summary(),
            "cycle": _cycle(Runtime.ask("STATS")),
        }


def _cycle(stats: str) -> Mapping[str, float]:
    """Return what the runtime says of its task; times in µs."""
    (task,) = json.loads(stats.partition(":")[2] or '{"tasks": [{}]}')["tasks"] or [{}]
    names = {"scans": "scan_count", "missed": "overruns"}
    names |= {"cycle_mean_us": "scan_time_avg", "cycle_max_us": "scan_time_max"}
    return {ours: task.get(name) or 0 for ours, name in names.items()}


def main() -> None:
    """Run the PLC until told to stop."""
    commands = Commands()
    plan = Plan.from_json(sys.argv[1])
    try:
        with ExitStack() as stack:
            folder = Path(sys.argv[2])
            program = Outside(plan, commands, folder, stack)
            stack.callback(Runtime(folder).kill)
            due = 0.0
            while not commands.stop.wait(plan.interval):
                program.look()
                if time.monotonic() >= due:
                    due = time.monotonic() + 0.1
                    report("status", **program.status())
            report("status", **program.status())
    except RosplcError as error:
        report("error", **error.to_dict())
        sys.exit(1)


if __name__ == "__main__":
    main()
