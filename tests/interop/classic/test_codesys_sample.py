"""CODESYS' own shared-memory sample: two integers, no lock, and a configuration is all it takes."""

from __future__ import annotations

import fcntl
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.bridge import Bridge
from rosplc.config import parse_config, resolve
from rosplc.ros import DEFAULT
from rosplc.ros.memory import open_backend
from tests.classic_cell import CACHE, Program, build_plc, remove
from tests.lib.waiting import wait_for

pytestmark = pytest.mark.verifies("classic", own="a program based on the CODESYS sample")

PREFIX = "_CODESYS_SharedMemoryTest"
TYPE = "plc_msgs/msg/DataExchange"
CONFIG = """
prefix: sample
types: {{paths: [{folder}]}}
topics:
  /to_plc:   {{type: {type}, to: plc, classic: {{name: _CODESYS_SharedMemoryTest_Read, semaphore: none}}}}
  /from_plc: {{type: {type}, to: ros, classic: {{name: _CODESYS_SharedMemoryTest_Write, semaphore: none}}}}
"""


@pytest.fixture
def sample_names(tmp_path: Path) -> Iterator[None]:
    """Have the sample's fixed names to oneself."""
    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / "codesys-sample.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        names = (f"{PREFIX}_Read", f"{PREFIX}_Write")
        if any((Path("/dev/shm") / name).exists() for name in names):
            pytest.skip("the sample's memories stand on this machine already")
        yield
        remove(*names)


def test_the_sample_runs_with_a_configuration_alone(tmp_path: Path, sample_names: None) -> None:
    """Both integers arrive on either side, whichever side made the memory, and no semaphore is made."""
    messages = tmp_path / "plc_msgs" / "msg"
    messages.mkdir(parents=True)
    (messages / "DataExchange.msg").write_text("int32 value1\nint32 value2\n")
    project = resolve(parse_config(CONFIG.format(folder=tmp_path, type=TYPE)))
    ros = open_backend(project.store, "peer", domain=203)
    side = open_backend(project.store, "bridge", domain=203)
    got: list[tuple[int, int]] = []
    ros.subscribe("/from_plc", TYPE, DEFAULT, lambda data, _: got.append(struct.unpack("<4x2i", data)))
    publisher = ros.advertise("/to_plc", TYPE, DEFAULT)

    def one_round(value: int) -> None:
        with Program([build_plc(), "sample", PREFIX]) as plc:
            wait_for(lambda: (3, -3) in got and (4, -4) in got, "messages of the sample")
            publisher.write(b"\0\1\0\0" + struct.pack("<2i", value, -value), 0)
            plc.wait_line(f"read {value} {-value}")
            plc.end()
        got.clear()

    try:
        with Bridge(project, side) as bridge:  # the bridge makes the memories
            one_round(7)
            one_round(8)  # a PLC that restarts
            assert not list(Path("/dev/shm").glob(f"sem.{PREFIX}*"))
            assert [topic.problem for topic in bridge.status().topics] == ["", ""]
        remove(f"{PREFIX}_Read", f"{PREFIX}_Write")
        with Program([build_plc(), "sample", PREFIX]) as plc, Bridge(project, side):  # the PLC makes them
            wait_for(lambda: got, "messages of the sample")
            assert all(first == -second for first, second in got)
            plc.end()
    finally:
        ros.close()
        side.close()
