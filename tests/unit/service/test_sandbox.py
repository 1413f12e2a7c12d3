"""A bridge carries within exactly what the service's unit allows, as a user without rights."""

from __future__ import annotations

import ctypes.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.errors import ChannelError
from rosplc.ros import Qos
from rosplc.service.install import Plan, drop_in, template
from rosplc.shm import Namespace, attach
from tests.interop.graphs import LOCAL, Graph, free_domain
from tests.lib.waiting import wait_for
from tests.unit.service.test_install import AS_NOBODY

SANDBOX = Path(__file__).with_name("sandbox.py")
INT32_7 = bytes([0, 1, 0, 0, 7, 0, 0, 0])

pytestmark = [pytest.mark.needs("systemd"), pytest.mark.verifies("service", real="systemd's analysis")]


@pytest.fixture
def folder() -> Iterator[Path]:
    """Give a folder that another user may look into, as those of pytest are not."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.fixture
def unit(folder: Path) -> Path:
    """Give the text of an installed unit."""
    plan = Plan(
        "cell1", "rosplc", Path("/etc/rosplc/cell1.yaml"), Path("/opt/rosplc/bin/rosplc"), group="plc"
    )
    path = folder / "unit"
    path.write_text(template(plan) + drop_in(plan))
    return path


def confined(unit: Path, *command: str, **settings: object) -> subprocess.Popen[str]:
    """Start a command under the unit's rules."""
    return subprocess.Popen(
        [*AS_NOBODY, sys.executable, str(SANDBOX), str(unit), *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        **settings,  # type: ignore[call-overload]
    )


_FORBIDDEN = """
import ctypes, mmap, os, socket, sys
def refused(work):
    try:
        work()
    except PermissionError:
        return True
    return False
print("packet", refused(lambda: socket.socket(socket.AF_PACKET, socket.SOCK_RAW)))
print("chroot", refused(lambda: os.chroot("/")))
print("fifo", refused(lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))))
print("inet", not refused(lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM).close()))
try:
    mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
    print("code", sys.argv[1] == "without")
except OSError:
    print("code", True)
"""


def _has_mdwe() -> bool:
    return ctypes.CDLL(None).prctl(66, 0, 0, 0, 0) >= 0  # PR_GET_MDWE


def test_the_sandbox_is_one(unit: Path) -> None:
    """What the unit forbids fails here as it would under systemd: this test's premise."""
    child = confined(unit, sys.executable, "-c", _FORBIDDEN, "with" if _has_mdwe() else "without")
    output, _ = child.communicate()
    assert output.split() == [
        "packet",
        "True",
        "chroot",
        "True",
        "fifo",
        "True",
        "inet",
        "True",
        "code",
        "True",
    ]


@pytest.fixture
def domain() -> Iterator[int]:
    with free_domain() as number:
        yield number


def test_a_bridge_over_dds_carries_in_the_sandbox(
    unit: Path, folder: Path, shm_namespace: Namespace, domain: int
) -> None:
    """Objects, group, DDS and its callbacks work within the limits; a message reaches shared memory."""
    pytest.importorskip("cyclonedds")
    file = folder / "cell.yaml"
    file.write_text(
        f"prefix: {shm_namespace.prefix}\nros: {{backend: dds, domain: {domain}}}\n"
        f"shm: {{group: {65534 if AS_NOBODY else os.getgid()}}}\n"
        "topics: {/in: {type: std_msgs/msg/Int32, to: plc}}\n"
    )
    environment = {**os.environ, **LOCAL, "HOME": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    bridge = confined(
        unit, sys.executable, "-m", "rosplc", "run", "--status", "1", str(file), env=environment
    )
    graph = Graph("dds", domain)
    try:
        writer = graph.node("talker").advertise("/in", "std_msgs/msg/Int32", Qos())
        wait_for(lambda: bridge.poll() is not None or shm_namespace.path("/in").exists())
        assert bridge.poll() is None, bridge.communicate()[0]
        with attach(shm_namespace, "/in") as channel:
            reader, out = channel.reader(), bytearray(channel.identity.record_size)

            def carried() -> bool:
                assert bridge.poll() is None, bridge.communicate()[0]
                writer.write(INT32_7, 0)
                return reader.latest(out) is not None

            wait_for(carried)
            assert out[:4] == b"\7\0\0\0"
        bridge.terminate()
        output, _ = bridge.communicate()
        assert bridge.returncode == 0, output
        assert "rror" not in output, output
    finally:
        graph.close()
        bridge.kill()
        bridge.wait()


def test_a_bridge_over_zenoh_starts_in_the_sandbox(
    unit: Path, folder: Path, shm_namespace: Namespace
) -> None:
    """Zenoh's threads and sockets stay within the unit's limits."""
    pytest.importorskip("zenoh")
    file = folder / "cell.yaml"
    file.write_text(
        f"prefix: {shm_namespace.prefix}\nros: {{backend: zenoh, zenoh: {{mode: peer, connect: []}}}}\n"
        "topics: {/in: {type: std_msgs/msg/Int32, to: plc}}\n"
    )
    bridge = confined(unit, sys.executable, "-m", "rosplc", "run", str(file), env={**os.environ, **LOCAL})
    try:

        def beats() -> bool:
            assert bridge.poll() is None, bridge.communicate()[0]
            try:
                with attach(shm_namespace, "/in") as channel:
                    return channel.snapshot().writer.beat > 3
            except ChannelError:
                return False

        wait_for(beats)
        bridge.terminate()
        output, _ = bridge.communicate()
        assert bridge.returncode == 0, output
    finally:
        bridge.kill()
        bridge.wait()
