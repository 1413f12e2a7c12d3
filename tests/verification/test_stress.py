"""Torn data: a fast peer on another core, Structured Text on one side, in both roles and under both rules."""

from __future__ import annotations

import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import pytest

from rosplc.layout import Layout, compute_layout
from rosplc.plc.build import build_project
from rosplc.plc.plan import PlcTask, PlcTopic
from rosplc.shm import Direction
from rosplc_st.build import Build, Toolchain, build
from rosplc_st.machine import ProcessMachine
from tests.verification.plc_cell import Cell, project_texts, store

pytestmark = pytest.mark.verifies("st-messages", own="translated Structured Text")

_ROOT = Path(__file__).resolve().parents[2]
_TYPE = "test_msgs/msg/Block"
_COUNT = 2048  # 16 KiB: a copy takes long enough to be overtaken
_CHECK = f"""PROGRAM Check
VAR
    uiAt : UINT;
    udiNew : UDINT;
    udiTorn : UDINT;
    udiBack : UDINT;
    ulLast : ULINT;
END_VAR
RosPlc_State.axMayOpen[0] := TRUE;
ROS_Read.block();
IF ROS_Read.block.xNew THEN
    udiNew := udiNew + 1;
    FOR uiAt := 1 TO {_COUNT - 1} DO
        IF ROS_Read.block.msg.data[uiAt] <> ROS_Read.block.msg.data[0] THEN
            udiTorn := udiTorn + 1;
            EXIT;
        END_IF;
    END_FOR;
    IF ROS_Read.block.msg.data[0] <= ulLast THEN
        udiBack := udiBack + 1;
    END_IF;
    ulLast := ROS_Read.block.msg.data[0];
END_IF;
END_PROGRAM
"""
_PRODUCE = f"""PROGRAM Produce
VAR
    uiAt : UINT;
    ulNumber : ULINT;
END_VAR
RosPlc_State.axMayOpen[0] := TRUE;
ulNumber := ulNumber + 1;
FOR uiAt := 0 TO {_COUNT - 1} DO
    ROS_Write.back.msg.data[uiAt] := ulNumber;
END_FOR;
ROS_Write.back.xEnable := TRUE;
ROS_Write.back();
END_PROGRAM
"""
_WRITER = """
import struct, sys
from tests.verification.test_stress import block_layout
from rosplc.described import description_of
from rosplc.shm import Direction, Namespace, OwnedChannel
layout = block_layout()
about = description_of(layout, "/block", Direction.TO_PLC, bridge="test")
channel = OwnedChannel.open(Namespace("rosplc", sys.argv[1]), about, record_size=layout.size)
writer, number = channel.writer(), 0
print("ready", flush=True)
while True:
    number += 1
    writer.publish(struct.pack("<Q", number) * (layout.size // 8))
"""


@lru_cache
def block_layout() -> Layout:
    """Return the layout of a message that is one array."""
    types = store().with_definition(_TYPE, f"uint64[{_COUNT}] data\n")
    return compute_layout(types, _TYPE)


def stress_build(broken: bool = False) -> Build:
    """Return a PLC with one topic each way; ``broken``: its reader accepts whatever it has copied."""
    layout = block_layout()
    topics = [PlcTopic("/block", layout, "read", "T"), PlcTopic("/back", layout, "write", "T")]
    texts = project_texts(build_project(layout.store, topics, [PlcTask("T")]))
    if broken:
        before = texts["RosPlc_Reader"]
        texts["RosPlc_Reader"] = before.replace("IF NOT Proven THEN", "Proven := TRUE;\nIF NOT Proven THEN")
        assert texts["RosPlc_Reader"] != before
    texts |= {"Check": _CHECK, "Produce": _PRODUCE}
    return build(texts, None, Toolchain(flags=("-O1",)), program=True)


@contextmanager
def started(built: Build, fenced: bool) -> Iterator[tuple[Cell, ProcessMachine]]:
    """Give a cell and its PLC, which is killed with the block."""
    plc = ProcessMachine(built)
    with Cell(machine=plc) as cell:
        plc._ask(f"directory {cell.folder}")
        plc.start()
        plc.set("RosPlc_Settings.xFenced", fenced)
        yield cell, plc


def read_stress(built: Build, seconds: float, fenced: bool) -> dict[str, int]:
    """Let Structured Text read from a bridge that publishes without a pause; return what it counted."""
    with started(built, fenced) as (cell, plc):
        child = subprocess.Popen(
            [sys.executable, "-c", _WRITER, str(cell.folder)], stdout=subprocess.PIPE, cwd=_ROOT
        )
        try:
            assert child.stdout is not None and child.stdout.readline() == b"ready\n"
            end = time.monotonic() + seconds
            while time.monotonic() < end or (plc.get("Check.udiNew") < 100 and child.poll() is None):
                plc.scan("Check", count=200, step=1)
            plc.check()
            counted = {name: plc.get(f"Check.{name}") for name in ("udiNew", "udiTorn", "udiBack")}
            return {**counted, "udiRetries": plc.get("ROS_Read.block.udiRetries")}
        finally:
            child.send_signal(signal.SIGKILL)
            child.wait()
            if child.stdout is not None:
                child.stdout.close()
            plc.kill()


def write_stress(built: Build, seconds: float, fenced: bool) -> tuple[int, int]:
    """Let Structured Text write without a pause to a bridge that reads; return messages and torn ones."""
    layout = block_layout()
    with started(built, fenced) as (cell, plc):
        reader = cell.channel("/back", layout, Direction.TO_ROS).reader()
        plc.scan("Produce", count=50, step=10)
        assert plc.get("ROS_Write.back.xReady")
        plc.send("scan PRODUCE 100000000 0")
        out = bytearray(layout.size)
        taken = torn = last = 0
        end = time.monotonic() + seconds
        while time.monotonic() < end or taken < 100:
            if reader.latest(out) is None:
                continue
            number = struct.unpack_from("<Q", out)[0]
            torn += bytes(out[8:]) != bytes(out[:-8])
            assert number > last
            last, taken = number, taken + 1
        plc.kill()
        return taken, torn


@pytest.mark.parametrize("fenced", [True, False], ids=["fences", "delayed"])
def test_reader(fenced: bool) -> None:
    """Structured Text never takes a torn message, or an older one, from a writer that never pauses."""
    counted = read_stress(stress_build(), 2, fenced)
    assert (counted["udiTorn"], counted["udiBack"]) == (0, 0), counted
    assert counted["udiNew"] >= 100


@pytest.mark.parametrize("fenced", [True, False], ids=["fences", "delayed"])
def test_writer(fenced: bool) -> None:
    """A bridge never takes a torn message, or an older one, from Structured Text that never pauses."""
    taken, torn = write_stress(stress_build(), 2, fenced)
    assert torn == 0
    assert taken >= 100


@pytest.mark.serial
@pytest.mark.verify(minutes=3)
@pytest.mark.timeout(600)
def test_long() -> None:
    """A minute in each role and rule finds nothing; without the check after the copy it finds torn data."""
    for fenced in (True, False):
        counted = read_stress(stress_build(), 30, fenced)
        assert (counted["udiTorn"], counted["udiBack"]) == (0, 0), counted
        assert write_stress(stress_build(), 30, fenced)[1] == 0
    counted = read_stress(stress_build(broken=True), 10, True)
    assert counted["udiTorn"] > 0, "the stress cannot find what it looks for"
