"""Somebody with the right to write an object cuts it: what a bridge cannot prevent, and how it comes back.

An object cannot be sealed against this: the kernel seals memory files alone (the first test says so). What
touches a page that is gone gets SIGBUS. See docs/explanation/threat-model.md.
"""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rosplc.errors import ChannelError
from rosplc.shm import Namespace, attach
from tests.lib.waiting import WATCHDOG_S

pytestmark = pytest.mark.verifies("users", own="processes of other users")

_F_ADD_SEALS, _F_SEAL_SHRINK = 1033, 0x0002


def test_objects_cannot_be_sealed(shm_namespace: Namespace) -> None:
    """The kernel refuses to seal a file in /dev/shm; if this ever fails, objects should be sealed."""
    path = shm_namespace.path("/in")
    fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with pytest.raises(OSError, match=r"not permitted|Invalid"):
            fcntl.fcntl(fd, _F_ADD_SEALS, _F_SEAL_SHRINK)
    finally:
        os.close(fd)


def _start(file: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "rosplc", "run", "--status", "0", str(file)])


def _await_beats(namespace: Namespace, child: subprocess.Popen[bytes]) -> None:
    """Wait until the child's bridge beats in a whole object."""
    first = -1
    while True:
        assert child.poll() is None, "the bridge has ended"
        try:
            with attach(namespace, "/in") as channel:
                writer = channel.snapshot().writer
                if writer.pid == child.pid:
                    if first not in (-1, writer.beat):
                        return
                    first = writer.beat
        except ChannelError:
            pass
        time.sleep(0.02)


@pytest.mark.parametrize("size", [0, 100])
def test_a_bridge_whose_object_was_cut_comes_back(
    tmp_path: Path, shm_namespace: Namespace, size: int
) -> None:
    """The bridge dies of SIGBUS or creates the object again; restarted, it creates it again and carries."""
    file = tmp_path / "cell.yaml"
    file.write_text(
        f"prefix: {shm_namespace.prefix}\nros: {{backend: memory}}\nbeat: 20ms\n"
        "topics: {/in: {type: std_msgs/msg/Int32, to: plc}}\n"
    )
    child = _start(file)
    try:
        _await_beats(shm_namespace, child)
        os.truncate(shm_namespace.path("/in"), size)
        while child.poll() is None and shm_namespace.path("/in").stat().st_size == size:
            time.sleep(0.02)
        if child.poll() is not None:
            assert child.returncode == -signal.SIGBUS
            child = _start(file)
        _await_beats(shm_namespace, child)
        child.terminate()
        assert child.wait(WATCHDOG_S) == 0
    finally:
        child.kill()
        child.wait()
