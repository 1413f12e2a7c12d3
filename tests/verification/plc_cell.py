"""What the tests share: a generated project, built once, and the bridge's side of its channels."""

from __future__ import annotations

import shutil
import struct
import tempfile
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import pytest

from rosplc.described import description_of
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.plc.build import build_project
from rosplc.plc.plan import PlcTask, PlcTopic, ProjectOptions
from rosplc.plc.project import project_texts
from rosplc.shm import Direction, Namespace, OwnedChannel
from rosplc_st.build import ARMHF, Build, Toolchain, build
from rosplc_st.machine import LibraryMachine, Machine, ProcessMachine
from rosplc_st.translator import Options

__all__ = [
    "READ", "TARGETS", "TWIST", "WRITE", "Blocks", "Cell", "cell_build", "cell_texts", "layout_of",
    "needs_armhf", "pattern", "store", "target", "targets", "twist",
]  # fmt: skip

READ, WRITE = "SharedMemory_Read", "SharedMemory_Write"


@lru_cache
def store(distro: str = "jazzy") -> TypeStore:
    return TypeStore.bundled(distro)


@lru_cache
def layout_of(name: str, distro: str = "jazzy", limits: Limits | None = None) -> Layout:
    return compute_layout(store(distro), name, limits or Limits())


def twist(number: float) -> dict[str, Any]:
    """Return a Twist whose six numbers are all ``number``."""
    vector = {"x": number, "y": number, "z": number}
    return {"linear": vector, "angular": vector}


def pattern(number: float) -> bytes:
    """Return a Twist's record whose six numbers are all ``number``."""
    return struct.pack("<6d", *[float(number)] * 6)


TWIST = "geometry_msgs/msg/Twist"
# The topics of the cell that the tests of the state machine use.
TOPICS: dict[str, dict[str, Any]] = {
    "/plain": {"direction": "read", "stale_after_ns": 200_000_000},
    "/in_order": {"direction": "read", "in_order": True},
    "/latched": {"direction": "read", "latched": True},
    "/zero": {"direction": "read", "stale_after_ns": 200_000_000, "on_stale": "zero"},
    "/value": {"direction": "read", "stale_after_ns": 200_000_000, "on_stale": "value"},
    "/safe": {
        "direction": "read",
        "stale_after_ns": 200_000_000,
        "on_stale": "value",
        "safe": {"linear": {"x": 0.25}, "angular": {"y": -1e-3, "z": 5}},
    },
    "/out": {"direction": "write"},
    "/out2": {"direction": "write"},
}
CONSUME = """PROGRAM Consume
VAR
    adValues : ARRAY[0..31] OF LREAL;
    uiCount : UINT;
    xMore : BOOL;
END_VAR
uiCount := 0;
xMore := ROS_Read.in_order.xNew;
WHILE xMore DO
    adValues[uiCount] := ROS_Read.in_order.msg.linear.x;
    uiCount := uiCount + 1;
    xMore := ROS_Read.in_order.Next();
END_WHILE;
END_PROGRAM
"""


@lru_cache
def cell_texts(**target: Any) -> dict[str, str]:
    """Return the cell's objects; ``target``: further options of the generation."""
    topics = [PlcTopic(topic, layout_of(TWIST), task="RosTask", **rest) for topic, rest in TOPICS.items()]
    project = build_project(store(), topics, [PlcTask("RosTask")], ProjectOptions(**target))
    return {**project_texts(project), "Consume": CONSUME}


def cell_build(
    options: Options | None = None,
    toolchain: Toolchain | None = None,
    *,
    program: bool = False,
    more: Mapping[str, str] | None = None,
    **generated: Any,
) -> Build:
    """Return the cell, built; ``more``: further objects, ``generated``: further options of the generation."""
    return build({**cell_texts(**generated), **(more or {})}, options, toolchain, program=program)


_BARRIER = ("pou: MemoryBarrier.MemoryBarrier",)
TARGETS: dict[str, tuple[Options, Toolchain | None, Literal["x86", "arm"]]] = {
    "64-bit": (Options(), None, "x86"),
    "32-bit-with-barrier": (Options(cpu_bits=32, defined=_BARRIER), None, "arm"),
    "armhf": (Options(cpu_bits=32, defined=_BARRIER), ARMHF, "arm"),
}


needs_armhf = pytest.mark.needs("gcc-arm-linux-gnueabihf", "libc6-dev-armhf-cross", "qemu-user")


def targets(*marks: pytest.MarkDecorator) -> list[object]:
    """Return the names of all targets as parameters; ``marks`` are for all but the 64-bit one."""
    return [
        pytest.param(
            name, marks=[*(marks if name != "64-bit" else ()), *([needs_armhf] if name == "armhf" else ())]
        )
        for name in TARGETS
    ]


def target(name: str, more: Mapping[str, str] | None = None) -> Build:
    """Return the cell, built for a target."""
    options, toolchain, processor = TARGETS[name]
    return cell_build(options, toolchain, program=toolchain is not None, more=more, target=processor)


class Blocks:
    """A PLC's blocks, by the topic of each."""

    machine: Machine

    def block(self, topic: str) -> str:
        """Return the path of a topic's block."""
        raise NotImplementedError

    def get(self, topic: str, *names: str) -> Any:
        """Return variables of a topic's block: one value, or a tuple."""
        values = tuple(self.machine.get(f"{self.block(topic)}.{name}") for name in names)
        return values[0] if len(values) == 1 else values

    def set(self, topic: str, name: str, value: Any) -> None:
        """Set an input of a topic's block."""
        self.machine.set(f"{self.block(topic)}.{name}", value)

    def record(self, topic: str) -> bytes:
        """Return a topic's msg."""
        return self.machine.read(f"{self.block(topic)}.msg")


class Cell(Blocks):
    """A folder of shared memory, the bridge's channels in it, and a PLC; a context manager."""

    def __init__(
        self, machine_of: Build | None = None, machine: Machine | Callable[[str], Any] | None = None
    ) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="T", dir="/dev/shm"))
        self.namespace = Namespace("rosplc", str(self.folder))
        self.channels: list[OwnedChannel] = []
        if isinstance(machine, Machine):
            self.machine = machine
        elif machine is not None:
            self.machine = machine(str(self.folder))
        else:
            built = machine_of or cell_build()
            kind = ProcessMachine if built.toolchain.runner else LibraryMachine
            self.machine = kind(built, str(self.folder))
        if not isinstance(machine, Machine):
            self.machine.start()
            for topic in ("/out", "/out2"):
                self.set(topic, "xEnable", True)

    def __enter__(self) -> Cell:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for channel in self.channels:
            channel.close()
        if isinstance(self.machine, ProcessMachine):
            self.machine.kill()
        shutil.rmtree(self.folder)

    def channel(
        self, topic: str, layout: Layout | None = None, direction: Direction | None = None, slots: int = 4
    ) -> OwnedChannel:
        """Own a topic's object, as the bridge does."""
        layout = layout or layout_of(TWIST)
        if direction is None:
            direction = Direction.TO_PLC if TOPICS[topic]["direction"] == "read" else Direction.TO_ROS
        about = description_of(layout, topic, direction, bridge="test")
        channel = OwnedChannel.open(self.namespace, about, record_size=layout.size, slots=slots)
        self.channels.append(channel)
        return channel

    def drop(self, channel: OwnedChannel) -> None:
        """Close a channel before the test ends, leaving its object."""
        self.channels.remove(channel)
        channel.close()

    def block(self, topic: str) -> str:
        """Return the path of a topic's block."""
        kind = "Read" if TOPICS[topic]["direction"] == "read" else "Write"
        return f"ROS_{kind}.{topic.strip('/')}"

    def scan(self, count: int = 1, step: int = 10, beats: Iterable[Any] = ()) -> None:
        """Run both programs ``count`` times; ``beats``: the bridge's ends, which beat before each scan."""
        for _ in range(count):
            for end in beats:
                end.beat()
            self.machine.scan(READ, WRITE, step=step)

    def until(self, topic: str, name: str, value: Any, scans: int = 2000, beats: Iterable[Any] = ()) -> int:
        """Scan until an output has a value; return how many scans it took."""
        beats = list(beats)
        for done in range(scans):
            if self.get(topic, name) == value:
                return done
            self.scan(beats=beats)
        raise AssertionError(
            f"{topic}: {name} is {self.get(topic, name)!r} after {scans} scans, not {value!r}"
        )
