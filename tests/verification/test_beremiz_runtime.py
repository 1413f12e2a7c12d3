"""The blocks for matiec, built by Beremiz, in its runtime, with a live bridge and a ROS node over DDS.

``ROSPLC_BEREMIZ`` names a folder with a checkout of Beremiz in ``beremiz``, matiec, built, beside it in
``matiec``, and a Python with what Beremiz requires in ``venv``; no registry has the first two.
"""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.config.resolve import Project
from rosplc.demo.plan import FreeDomain
from rosplc.shm import Namespace
from tests.lib.waiting import wait_for
from tests.verification.test_openplc import for_matiec
from tests.verification.test_openplc_runtime import Cell

pytestmark = [
    pytest.mark.needs(variable="ROSPLC_BEREMIZ"),
    pytest.mark.serial,
    pytest.mark.timeout(600),
    pytest.mark.verifies("beremiz", real="Beremiz (where an installation is available)"),
]
PROJECT = """<?xml version="1.0" encoding="utf-8"?>
<project xmlns="http://www.plcopen.org/xml/tc6_0201" xmlns:xhtml="http://www.w3.org/1999/xhtml">
<fileHeader companyName="-" productName="-" productVersion="1" creationDateTime="2026-01-01T00:00:00"/>
<contentHeader name="cell"><coordinateInfo>
<fbd><scaling x="0" y="0"/></fbd><ld><scaling x="0" y="0"/></ld><sfc><scaling x="0" y="0"/></sfc>
</coordinateInfo></contentHeader>
<types><dataTypes/><pous>{programs}</pous></types>
<instances><configurations><configuration name="Config0"><resource name="Res0">{tasks}</resource>
</configuration></configurations></instances>
</project>
"""
ROOT = """<BeremizRoot URI_location="LOCAL://"><TargetType><Linux/></TargetType>
<Libraries Enable_Python_Library="false" Enable_Native_Library="false"/></BeremizRoot>
"""
EMPTY = ["globals", "initFunction", "cleanUpFunction", "retrieveFunction", "publishFunction"]
EXTENSION = f"""<CFile xmlns:xhtml="http://www.w3.org/1999/xhtml">
<includes><xhtml:p><![CDATA[#include "rosplc_blocks.c"]]></xhtml:p></includes><variables/>
{"".join(f"<{part}><xhtml:p><![CDATA[]]></xhtml:p></{part}>" for part in EMPTY)}</CFile>
"""


def project_xml(program: str) -> str:
    """Return what Beremiz' editor would save for programs in Structured Text and their configuration."""
    programs = ""
    for name, text in re.findall(r"^PROGRAM (\w+)\n(.*?)^END_PROGRAM", program, re.S | re.M):
        variables = ""
        for retained, declared in re.findall(r"^VAR( RETAIN)?\n(.*?)^END_VAR\n", text, re.S | re.M):
            variables += f'<localVars retain="{"true" if retained else "false"}">'
            for variable, of in re.findall(r"(\w+) : (\w+);", declared):
                kind = "<BOOL/>" if of == "BOOL" else f'<derived name="{of}"/>'
                variables += f'<variable name="{variable}"><type>{kind}</type></variable>'
            variables += "</localVars>"
        body = f"<ST><xhtml:p><![CDATA[{text.rpartition('END_VAR')[2]}]]></xhtml:p></ST>"
        inside = f"<interface>{variables}</interface><body>{body}</body>"
        programs += f'<pou name="{name}" pouType="program">{inside}</pou>'
    tasks = ""
    for task, interval, priority in re.findall(
        r"TASK (\w+)\(INTERVAL := (\S+), PRIORITY := (\d+)\)", program
    ):
        tasks += f'<task name="{task}" priority="{priority}" interval="{interval}">'
        for name, of in re.findall(rf"PROGRAM (\w+) WITH {task} : (\w+);", program):
            tasks += f'<pouInstance name="{name}" typeName="{of}"/>'
        tasks += "</task>"
    return PROJECT.format(programs=programs, tasks=tasks)


class Beremiz:
    """Beremiz' runtime with a program that Beremiz built, in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self._at = Path(os.environ["ROSPLC_BEREMIZ"]).resolve()
        self._folder = folder
        self._work = folder / "work"
        self._log = folder / "log"
        self._process: subprocess.Popen[bytes] | None = None
        with socket.create_server(("127.0.0.1", 0)) as free:
            self._port = free.getsockname()[1]

    def load(self, project: Project, program: str) -> None:
        """Build a program, and transfer it into a runtime, which keeps it for the next one."""
        _, program = for_matiec(project, self._folder / "plc", program)
        home, generated = self._folder / "home", self._folder / "plc" / "generated"
        extension = home / "rosplc@c_ext"
        extension.mkdir(parents=True)
        shutil.copy(self._folder / "plc" / "rosplc.st", home / "raw_plc.st")
        (home / "plc.xml").write_text(project_xml(program))
        (home / "beremiz.xml").write_text(ROOT)
        (extension / "baseconfnode.xml").write_text('<BaseParams Name="rosplc" IEC_Channel="0"/>')
        flags = f"-I{generated} -I{home / 'build'} "
        (extension / "confnode.xml").write_text(f'<CExtension CFLAGS="{flags}" LDFLAGS=""/>')
        (extension / "cfile.xml").write_text(EXTENSION)
        built = self._command("build")
        assert "Successfully built." in built, built
        self._work.mkdir()
        self._serve("eRPC port", "0")
        self._command("transfer")
        self.kill()

    def start(self) -> None:
        """Start the runtime with the program that it has."""
        self._serve("PLC started", "1")

    def _serve(self, told: str, autostart: str) -> None:
        times = self._times(told)
        options = ["-i", "127.0.0.1", "-p", str(self._port), "-x", "0", "-t", "0", "-a", autostart]
        service = self._at / "beremiz" / "Beremiz_service.py"
        command = [str(self._at / "venv/bin/python"), str(service), *options, str(self._work)]
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(command, stdout=log, stderr=log)
        self._told(told, times + 1)

    def restart(self) -> None:
        """Stop the program, and start it."""
        for command, told in (("stop", "PLC stopped"), ("run", "PLC started")):
            times = self._times(told)
            self._command(command)
            self._told(told, times + 1)

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _command(self, *commands: str) -> str:
        """Have Beremiz' command line do something for the project; return what it prints."""
        line = [str(self._at / "venv/bin/python"), str(self._at / "beremiz" / "Beremiz_cli.py")]
        line += ["--uri", f"ERPC://127.0.0.1:{self._port}", "--project-home", str(self._folder / "home")]
        done = subprocess.run([*line, *commands], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def _times(self, told: str) -> int:
        return self._log.read_text().count(told) if self._log.exists() else 0

    def _told(self, told: str, times: int) -> None:
        wait_for(lambda: self._times(told) >= times, told)


@pytest.fixture
def cell(tmp_path: Path, shm_namespace: Namespace) -> Iterator[Cell]:
    """Give a cell of three programs; the runtime's is still to be loaded."""
    domain = FreeDomain()
    made = Cell(tmp_path, shm_namespace.prefix, domain.number, Beremiz)
    yield made
    made.close()
    domain.close()


def test_messages_cross_ten_starts(cell: Cell) -> None:
    """Every kind of field crosses in both directions in two tasks; ten times the program stops and starts."""
    cell.restart_ten_times()


@pytest.mark.parametrize("who", ["runtime", "bridge"])
def test_either_side_is_killed(who: str, cell: Cell) -> None:
    """After SIGKILL and a new start messages cross as before; none comes wrong, twice or out of order."""
    cell.kill_three_times(who)


def test_calls_are_answered(cell: Cell) -> None:
    """The PLC answers each call of a ROS client, and a ROS server each of the PLC, before and after STOPs."""
    cell.answer_calls()
