"""The PLC's process with ``--plc openplc``: starts OpenPLC's runtime with the PLC program, and watches it."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import rosplc
from rosplc.config.resolve import Project
from rosplc.demo.outside import DRIVE, STEER, TAKEN, Outside
from rosplc.demo.plan import COMMAND, Plan, robot_topics
from rosplc.demo.processes import Commands, report
from rosplc.errors import RosplcError, SetupError
from rosplc.plc.base import render
from rosplc.plc.names import instance_names, time_literal

RUN = Path("/run/runtime")  # OpenPLC's own folder for its sockets
_BUILT = {"ROSPLC_OPENPLC": "build/plc_main", "ROSPLC_STRUCPP": "dist/index.js"}


def find_openplc() -> tuple[Path, Path]:
    """Return the folders of OpenPLC's runtime and of STruC++, which ROSPLC_OPENPLC and ROSPLC_STRUCPP name.

    Raises SetupError: SYS001, something is missing; SYS002, a runtime is running already.
    """
    for variable, file in _BUILT.items():
        if not (Path(os.environ.get(variable) or "/nowhere") / file).is_file():
            raise SetupError(
                "SYS001",
                f"{variable} is not set to a folder that contains {file}",
                where=os.environ.get(variable, ""),
                remedy="Build OpenPLC Runtime 4.1 and STruC++ as described in docs/tutorial/openplc.md, "
                "and set ROSPLC_OPENPLC and ROSPLC_STRUCPP to their folders.",
            )
    for program, package in (("node", "nodejs"), ("g++", "g++"), ("make", "make")):
        if shutil.which(program) is None:
            raise SetupError("SYS001", f"{program} is missing", remedy=f"sudo apt-get install {package}")
    if Runtime.ask("STATUS"):
        what = "another OpenPLC runtime is running"
        raise SetupError("SYS002", what, where=str(RUN), remedy="Stop it. A machine can run only one.")
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
            what, remedy = f"cannot create this folder: {error.strerror}", f"sudo install -d -o $USER {RUN}"
            raise SetupError("SYS001", what, where=str(RUN), remedy=remedy) from error
        main = Path(os.environ["ROSPLC_OPENPLC"]).resolve() / _BUILT["ROSPLC_OPENPLC"]
        command = ["setpriv", "--pdeathsig", "KILL", str(main), "--print-logs"]
        self._process = subprocess.Popen(command, cwd=folder, stdout=sys.stderr)
        while "RUNNING" not in self.ask("STATUS"):
            self.check()
            time.sleep(0.05)

    def check(self) -> None:
        """Raise SetupError SYS002 if it has ended."""
        if self._process.poll() is not None:
            raise SetupError("SYS002", "the OpenPLC runtime stopped unexpectedly")

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


def program_text(plan: Plan) -> str:
    """Return the PLC program for OpenPLC."""
    kinds = robot_topics(plan.topics)
    return render(
        "openplc/demo.st",
        steer=STEER.read_text(encoding="ascii"),
        kinds=kinds,
        names=instance_names(list(kinds)),
        command=COMMAND[0],
        drive=DRIVE,
        taken=TAKEN,
        per_scan=plan.per_scan,
        interval=time_literal(round(plan.interval * 1e9)),
    )


def _cycle() -> dict[str, float]:
    """Return what the runtime says of its task; times in µs."""
    (task,) = json.loads(Runtime.ask("STATS").partition(":")[2] or '{"tasks": [{}]}')["tasks"] or [{}]
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
            runtime = Runtime(folder)
            stack.callback(runtime.kill)
            arrivals = program.arrivals
            while not commands.stop.wait(0.1):
                runtime.check()
                report("status", cycle=_cycle(), age=arrivals.recent(), **program.status())
            report("status", cycle=_cycle(), **program.status(), ages=arrivals.summary())
    except RosplcError as error:
        report("error", **error.to_dict())
        sys.exit(1)


if __name__ == "__main__":
    main()
