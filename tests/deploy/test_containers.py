"""Bridge and PLC in two containers: namespaces of their own, one /dev/shm between them, or none."""

from __future__ import annotations

import json
import re
import secrets
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rosplc.shm import Namespace, attach
from tests.deploy.containers import WATCHDOG_S, Contained, contain
from tests.deploy.machine import need_namespaces
from tests.lib.waiting import wait_for
from tests.soak.cell import Cell
from tests.soak.messages import IN

pytestmark = pytest.mark.verifies("containers", real="Docker")

ROOT = Path(__file__).resolve().parents[2]
GROUP = 54_323
"""A number without a name, as in containers that share no /etc/group."""


@pytest.fixture
def volume() -> Iterator[Path]:
    """Give a folder on the machine's tmpfs that containers are started with as their /dev/shm."""
    need_namespaces()
    path = Path("/dev/shm") / f"pod{secrets.token_hex(6)}"
    path.mkdir()
    path.chmod(0o1777)
    yield path
    shutil.rmtree(path)


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    pytest.importorskip("cyclonedds")
    cell = Cell(tmp_path, "dds", private=False)
    yield cell
    cell.close()


def carry(cell: Cell) -> None:
    """Wait until every topic has carried something that was sent after now."""
    cell.await_flow(cell.marks())


def contained(cell: Cell, name: str, shm: Path | None, **rest: Any) -> Contained:
    """Put one of the cell's processes into a container."""
    part = Contained(cell.parts[name], shm=shm, **rest)
    cell.parts[name] = part
    return part


def test_two_containers_that_share_memory(cell: Cell, volume: Path) -> None:
    """Both are process 1, neither sees the other's processes, and either may be killed and come again."""
    bridge = contained(cell, "bridge", volume, network=True)
    plc = contained(cell, "plc", volume, network=False)
    cell.start()
    shared = Namespace(cell.prefix, str(volume))
    with attach(shared, IN[0]) as found:
        seen = found.snapshot()
        # The numbers are for people: the same for both sides here, so nothing can rest on them.
        assert (seen.writer.pid, seen.readers[0].pid) == (1, 1)
        generation = found.identity.generation
    for part in (plc, bridge, plc):
        part.kill()
        cell.ensure()
        carry(cell)
    assert bridge.terminate(WATCHDOG_S)  # process 1 ends when it is asked to
    bridge.start()
    carry(cell)
    with attach(shared, IN[0]) as found:
        assert found.identity.generation == generation
    assert cell.counters.violations() == {"torn": 0, "invented": 0, "disordered": 0}


WRITE = """
import sys, time
from rosplc.virtual_plc import WriteBlock

block = WriteBlock("/out", prefix=sys.argv[1])
while True:
    block.xEnable = block.msg is not None
    block()
    time.sleep(0.01)
"""


def test_liveness_crosses_containers(volume: Path, tmp_path: Path) -> None:
    """A PLC's container that is killed is reported, and its return too, though nobody sees its processes."""
    prefix = f"T{secrets.token_hex(6)}"
    config, log = tmp_path / "rosplc.yaml", tmp_path / "bridge.log"
    config.write_text(
        f"prefix: {prefix}\nbeat: 50ms\nros: {{backend: memory}}\n"
        "topics:\n  /out: {type: std_msgs/msg/Int32, to: ros}\n"
    )
    bridge = [sys.executable, "-m", "rosplc", "run", str(config), "--status", "0.2"]
    plc = contain([sys.executable, "-c", WRITE, prefix], shm=volume, network=False)
    running: list[subprocess.Popen[bytes]] = []

    def start(command: list[str]) -> subprocess.Popen[bytes]:
        with log.open("ab") as file:
            running.append(subprocess.Popen(command, cwd=ROOT, stdout=file, stderr=file))
        return running[-1]

    try:
        start(contain(bridge, shm=volume, network=False))
        first = start(plc)
        # More than one message: a writer is alive once something of it has changed.
        wait_for(lambda: re.search("in [0-9]+, out [1-9][0-9]", log.read_text()))
        first.kill()
        wait_for(lambda: "/out: ERROR: the PLC task that writes it stopped" in log.read_text())
        mark = log.stat().st_size
        start(plc)
        wait_for(lambda: re.search("/out: (OK|WARN)", log.read_bytes()[mark:].decode()))
    finally:
        for process in running:
            process.kill()
            process.wait()


SHARE = """
import ctypes, os, sys, time
from rosplc.shm import Namespace
from rosplc.shm import OwnedChannel
from rosplc.shm.files import Rights
from tests.lib.channels import describe, pattern

role, prefix, user, group, groups = sys.argv[1], sys.argv[2], *map(int, sys.argv[3:6])
os.setgroups([groups] if groups else [])
os.setgid(group)
os.setuid(user)
ctypes.CDLL(None).prctl(1, 9)  # PR_SET_PDEATHSIG, which another user's id has cleared
if role == "bridge":
    channel = OwnedChannel.open(Namespace(prefix), describe("/in"), record_size=64, rights=Rights(gid=groups))
    writer = channel.writer()
    print("ready", flush=True)
    for number in range(1, 1 << 30):
        writer.publish(pattern(number, 64))
        time.sleep(0.01)
from rosplc.shm import attach
from rosplc.errors import ChannelError
try:
    with attach(Namespace(prefix), "/in", write=True) as found:
        reader, out = found.reader(observe=False), bytearray(64)
        while reader.latest(out) is None:
            time.sleep(0.01)
        print("came")
except ChannelError as error:
    print(error.code)
"""


def test_users_are_compared_by_number(volume: Path) -> None:
    """Users without names share an object by a group's number; a user outside it may not open it."""
    prefix = f"T{secrets.token_hex(6)}"

    def command(role: str, user: int, group: int, more: int) -> list[str]:
        program = [sys.executable, "-c", SHARE, role, prefix, *map(str, (user, group, more))]
        return contain(program, shm=volume, network=False)

    with subprocess.Popen(
        command("bridge", 54_321, 54_321, GROUP), cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as bridge:
        try:
            assert bridge.stdout is not None and bridge.stdout.readline() == "ready\n"
            status = Namespace(prefix, str(volume)).path("/in").stat()
            assert (status.st_uid, status.st_gid) == (54_321, GROUP)
            for groups, said in ((GROUP, "came"), (0, "SHM102")):
                done = subprocess.run(
                    command("plc", 54_322, 54_322, groups),
                    cwd=ROOT,
                    capture_output=True,
                    text=True,
                    timeout=120,
                )
                assert done.stdout.strip() == said, done.stderr
        finally:
            bridge.kill()


def inside(cell: Cell, command: list[str], shm: Path | None, **rest: Any) -> str:
    """Run a program in a container to its end, and return what it printed."""
    done = subprocess.run(
        contain(command, shm=shm, network=False, **rest),
        env=cell.environment, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert "Traceback" not in done.stderr, done.stderr
    return done.stdout


def findings(output: str) -> dict[str, dict[str, Any]]:
    """Return what the doctor found and is not fine, by code."""
    return {each["code"]: each for each in json.loads(output)["findings"] if each["level"] != "ok"}


# Alone, as other tests' doctors would find this runtime too.
@pytest.mark.serial
def test_the_doctor_names_containers_that_share_nothing(cell: Cell, volume: Path) -> None:
    """With a /dev/shm each, the PLC's blocks wait with error 101, and the doctor says what is not shared."""
    contained(cell, "bridge", volume, network=True)
    cell.write_config()
    cell.parts["bridge"].start()
    shared = Namespace(cell.prefix, str(volume))
    wait_for(lambda: len(shared.topics()) == len(cell.topics))

    script = (
        "import sys\nfrom rosplc.virtual_plc import ReadBlock\n"
        "block = ReadBlock(sys.argv[2], prefix=sys.argv[1])\nblock()\nprint(block.udiError, flush=True)\n"
    )
    # A process with the runtime's name, and beside it a block that looks for its topic.
    beside = '"$@" & exec -a /opt/codesys/bin/codesyscontrol.bin sleep 300 >/dev/null'
    command = ["bash", "-c", beside, "bash", sys.executable, "-c", script, cell.prefix, IN[0]]
    runtime = subprocess.Popen(
        contain(command, shm=None, network=False),
        env=cell.environment, cwd=ROOT, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    doctor = [sys.executable, "-m", "rosplc", "doctor", str(cell.config), "--no-ros", "--json"]
    try:
        assert runtime.stdout is not None
        assert runtime.stdout.readline() == "101\n"
        # From the machine, which sees both.
        done = subprocess.run(
            doctor, env=cell.environment, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
        )
        apart = findings(done.stdout)["DOC304"]
        assert (apart["level"], done.returncode) == ("error", 1)
        assert "codesyscontrol.bin" in apart["seen"] and "its own /dev/shm" in apart["seen"]
        # From the bridge's container, which sees that it is one and no runtime.
        found = findings(inside(cell, ["env", "container=docker", *doctor], volume))
        assert "without a PLC runtime" in found["DOC305"]["seen"]
        assert "ipc" in found["DOC305"]["remedy"]
        assert "no running PLC task uses" in found["DOC603"]["seen"]
    finally:
        runtime.send_signal(signal.SIGKILL)
        runtime.communicate()
