"""Classic blocks on one side, a C program of an existing project on the other; names are the cell's own."""

from __future__ import annotations

import contextlib
import hashlib
import os
import signal
import subprocess
import uuid
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any

from rosplc.config.plans import ClassicPlan
from rosplc.layout import Limits
from rosplc.plc.build import build_project
from rosplc.plc.plan import PlcTask, PlcTopic, ProjectOptions
from rosplc.plc.project import project_texts
from rosplc_st.build import Build, Toolchain, build
from rosplc_st.machine import LibraryMachine, Machine, ProcessMachine
from tests.verification.plc_cell import READ, TARGETS, TWIST, WRITE, Blocks, layout_of, store

__all__ = ["TOPICS", "TWIST", "ClassicCell", "Peer", "classic_build", "classic_target"]

SHM = Path("/dev/shm")
JOINTS = "sensor_msgs/msg/JointState"
LARGE = "geometry_msgs/msg/PoseWithCovariance"  # 43 doubles: long enough for a copy to be interrupted
_SMALL = Limits(8, 16, {"name": 3, "position": 3, "velocity": 3, "effort": 3})
# Topic → type, direction, semaphore, and what else the configuration says.
TOPICS: dict[str, tuple[str, str, str, dict[str, Any]]] = {
    "/in": (TWIST, "read", "in", {"stale_after_ns": 200_000_000}),
    "/latched": (TWIST, "read", "latched", {"latched": True}),
    "/zero": (TWIST, "read", "zero", {"stale_after_ns": 200_000_000, "on_stale": "zero"}),
    "/bare": (TWIST, "read", "", {}),
    "/joints": (JOINTS, "read", "joints", {}),
    "/out": (TWIST, "write", "out", {}),
    "/bare_out": (TWIST, "write", "", {}),
    "/large": (LARGE, "read", "large", {}),
    "/large_out": (LARGE, "write", "large_out", {}),
}

PATIENT = """PROGRAM Patient
ROS_Read.in(tWait := T#49d17h2m47s295ms);
END_PROGRAM
"""


@lru_cache
def classic_texts() -> dict[str, str]:
    """Return the objects of a project with classic topics alone."""
    topics = []
    for topic, (type_name, direction, semaphore, more) in TOPICS.items():
        layout = layout_of(type_name, "jazzy", _SMALL if type_name == JOINTS else None)
        classic = ClassicPlan(topic[1:], semaphore, 5_000_000)
        topics.append(PlcTopic(topic, layout, direction, "RosTask", classic=classic, **more))
    texts = project_texts(build_project(store(), topics, [PlcTask("RosTask")], ProjectOptions()))
    return {**texts, "Patient": PATIENT}


def classic_build(*, program: bool = False) -> Build:
    """Return the project, built for this machine."""
    return build(classic_texts(), program=program)


def classic_target(name: str) -> Build:
    """Return the project, built for a target of `plc_cell`."""
    options, toolchain, _ = TARGETS[name]
    return build(classic_texts(), options, toolchain, program=toolchain is not None)


@lru_cache
def _peer_program(toolchain: Toolchain) -> Path:
    source = Path(__file__).with_name("classic_peer.c")
    digest = hashlib.sha256(source.read_bytes() + repr(toolchain).encode()).hexdigest()[:24]
    target = Path(__file__).resolve().parents[2] / ".cache" / "st" / f"peer-{digest}"
    if not target.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        new = target.with_suffix(f".{os.getpid()}")
        command = [toolchain.compiler, "-O1", "-Wall", "-Werror", str(source), "-o", str(new), "-pthread"]
        subprocess.run(command, check=True, timeout=120)
        new.replace(target)
    return target


class Peer:
    """The C program; a context manager that ends it."""

    def __init__(
        self, name: str, size: int = 48, way: str = "find", toolchain: Toolchain | None = None
    ) -> None:
        toolchain = toolchain or Toolchain()
        self.process = subprocess.Popen(
            [*toolchain.runner, str(_peer_program(toolchain)), name, str(size), way],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self._line() == "ready"

    def __enter__(self) -> Peer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()

    def kill(self) -> None:
        """Kill the program where it stands."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()

    def send(self, text: str) -> None:
        """Send a command; `answer` waits for what it says."""
        assert self.process.stdin is not None
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()

    def answer(self) -> str:
        """Return the answer of the command sent last."""
        return self._line()

    def ask(self, text: str) -> str:
        """Send a command and return its answer."""
        self.send(text)
        answer = self._line()
        assert answer != "?", text
        return answer

    def write(self, data: bytes) -> None:
        """Write the record under the lock."""
        self.ask(f"write {data.hex()}")

    def read(self) -> bytes:
        """Return the record, read under the lock."""
        return bytes.fromhex(self.ask("read"))

    def _line(self) -> str:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"the peer ended with {self.process.wait()}")
        return line.rstrip("\n")


class ClassicCell(Blocks):
    """A PLC with classic blocks, and names that nobody else has; a context manager."""

    def __init__(self, built: Build | None = None, *, start: bool = True, **options: int) -> None:
        self.prefix = f"T{uuid.uuid4().hex[:10]}_"
        self.built = built or classic_build()
        self.peers: list[Peer] = []
        self.machines: list[Machine] = []
        self.options = options
        if start:
            self.start()

    def start(self, *, process: bool = False, user: int | None = None) -> Machine:
        """Start a PLC, one more or in place of one that ended; the cell's own is the newest."""
        built = classic_build(program=True) if process else self.built
        kind = ProcessMachine if process or built.toolchain.runner else LibraryMachine
        self.machine = kind(built)
        self.machines.append(self.machine)
        self.machine.may_create = True
        self.machine.set_prefix(self.prefix)
        for name, value in self.options.items():
            self.machine.option(name, value)
        if user is not None:
            assert isinstance(self.machine, ProcessMachine)
            self.machine.become(user)
        self.machine.start()
        return self.machine

    def __enter__(self) -> ClassicCell:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for peer in self.peers:
            peer.kill()
        for machine in self.machines:
            if isinstance(machine, ProcessMachine):
                machine.kill()
        for pattern in (f"{self.prefix}*", f"sem.{self.prefix}*", f"rosplc.classic.{self.prefix}*"):
            for path in SHM.glob(pattern):
                if path.is_dir():
                    path.rmdir()
                else:
                    path.unlink()

    def peer(self, topic: str, way: str = "find", size: int = 48) -> Peer:
        """Start the other side of a topic."""
        bare = "bare" if not TOPICS[topic][2] else way
        self.peers.append(Peer(self.name(topic), size, bare, self.built.toolchain))
        return self.peers[-1]

    def name(self, topic: str) -> str:
        """Return the name of a topic's memory, and of its semaphore."""
        return self.prefix + topic[1:]

    def memory(self, topic: str) -> Path:
        """Return the file of a topic's memory."""
        return SHM / self.name(topic)

    def semaphore(self, topic: str) -> Path:
        """Return the file of a topic's semaphore."""
        return SHM / f"sem.{self.name(topic)}"

    def block(self, topic: str) -> str:
        """Return the path of a topic's block."""
        return f"ROS_{'Read' if TOPICS[topic][1] == 'read' else 'Write'}.{topic[1:]}"

    def put(self, topic: str, data: bytes) -> None:
        """Set a topic's msg and let it be written from the next scan on."""
        self.machine.write(f"{self.block(topic)}.msg", data)
        self.set(topic, "xEnable", True)

    def scan(self, count: int = 1, step: int = 10) -> None:
        """Run both programs ``count`` times."""
        for _ in range(count):
            self.machine.scan(READ, WRITE, step=step)
