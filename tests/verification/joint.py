"""A PLC of a configuration (executed Structured Text), its bridge, and a ROS node on the other side."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from rosplc.bridge import Bridge
from rosplc.clock import SYSTEM, Clock
from rosplc.codec import Codec, Wire
from rosplc.config import parse_config, resolve
from rosplc.plc.build import plc_project
from rosplc.plc.plan import ProjectOptions
from rosplc.plc.project import project_texts
from rosplc.ros import open_backend
from rosplc_st.build import Build, build
from rosplc_st.machine import LibraryMachine
from tests.interop.zenoh.processes import Router, free_port
from tests.verification.plc_cell import TARGETS, layout_of, store

WATCHDOG_S = 100.0
RULES = ["64-bit", "delayed", pytest.param("32-bit-with-barrier", marks=pytest.mark.foreign)]
"""How a PLC's program can be made: with fences, without them, and for 32 bits."""


@cache
def built(config: str, own: str = "", rule: str = "64-bit") -> tuple[Build, tuple[str, ...]]:
    """Return the PLC's program, generated from a configuration, and what its tasks call.

    ``own`` is a further program, ``Own``, called after the first; ``rule`` is one of RULES.
    """
    project = resolve(parse_config(config.replace("FOLDER", "/dev/shm")))
    # A PLC that a busy machine stops for a while is no silent one.
    target, delayed = TARGETS.get(rule, TARGETS["64-bit"]), rule == "delayed"
    made = plc_project(
        project, ProjectOptions(beat_ms=10_000, target="arm" if delayed else target[2], fenced=not delayed)
    )
    names = [name for task in made.tasks for name in task.programs]
    texts = project_texts(made)
    if own:
        names.insert(1, "Own")
        texts = {**texts, "Own": own}
    return build(texts, target[0]), tuple(names)


def codec(message: str) -> Codec:
    return Codec(layout_of(message), Wire.CDR)


def encode(message: str, /, **fields: Any) -> bytes:
    """Return a message as ROS sends it."""
    return codec(message).encode(layout_of(message).pack(fields))


def decode(message: str, payload: bytes) -> dict[str, Any]:
    """Return the fields of a message that came from ROS."""
    return layout_of(message).to_dict(codec(message).decode(payload))


class Joint:
    """A PLC, a bridge and a ROS node; FOLDER in the configuration is where the objects are.

    Args:
        config: The configuration.
        gvl: The list of the instances.
        domain: The ROS domain.
        backend: ``memory``, or another: the bridge is a process of its own then.
        own, rule: As for :func:`built`.
        clock: The bridge's, with ``memory``.
        options: The backend's own, for the node on the other side.
    """

    def __init__(
        self,
        config: str,
        gvl: str,
        domain: int,
        backend: str = "memory",
        own: str = "",
        clock: Clock = SYSTEM,
        rule: str = "64-bit",
        options: Mapping[str, object] | None = None,
    ) -> None:
        self.clock = clock
        self.config, self.gvl, self.backend = config, gvl, backend
        self.folder = Path(tempfile.mkdtemp(prefix="T", dir="/dev/shm"))
        made, self.programs = built(config, own, rule)
        self.machine = LibraryMachine(made, str(self.folder))
        self.machine.start()
        self.peer: Any = None  # of ROS 1 a test has its own
        if backend != "rospy":
            self.peer = open_backend(backend, store(), "peer", domain=domain, options=options or {})
        self.bridge: Bridge | subprocess.Popen[bytes] | None = None
        self.start_bridge()

    def start_bridge(self) -> None:
        text = self.config.replace("FOLDER", str(self.folder))
        if self.backend == "memory":
            self.bridge = Bridge(parse_config(text), clock=self.clock)
            self.bridge.start()
        else:
            path = self.folder / "rosplc.yaml"
            path.write_text(text)
            self.bridge = subprocess.Popen([sys.executable, "-m", "rosplc", "run", str(path)])

    def kill_bridge(self) -> None:
        """Kill the bridge, which is a process of its own."""
        assert isinstance(self.bridge, subprocess.Popen)
        self.bridge.kill()
        self.bridge.wait()
        self.bridge = None

    def stop_bridge(self) -> None:
        if isinstance(self.bridge, Bridge):
            self.bridge.stop()
        elif self.bridge is not None:
            self.bridge.terminate()
            self.bridge.wait()
        self.bridge = None

    def close(self) -> None:
        self.stop_bridge()
        if self.peer is not None:
            self.peer.close()
        shutil.rmtree(self.folder)

    def restart_plc(self) -> None:
        """STOP → RUN."""
        self.machine.stop()
        self.machine.start()

    def get(self, instance: str, *names: str) -> Any:
        """Return pins of an instance: one value, or a tuple."""
        values = tuple(self.machine.get(f"{self.gvl}.{instance}.{name}") for name in names)
        return values[0] if len(values) == 1 else values

    def set(self, instance: str, **pins: Any) -> None:
        """Set inputs of an instance."""
        for name, value in pins.items():
            self.machine.set(f"{self.gvl}.{instance}.{name}", value)

    def scan(self, step: int = 2, count: int = 1) -> None:
        """Run every task ``count`` times; ``step``: ms on the PLC's clock for each."""
        for _ in range(count):
            self.machine.scan(*self.programs, step=step)

    def until(self, condition: Callable[[], Any], what: str, step: int = 2) -> Any:
        """Let the PLC run until something holds; return it."""
        deadline = time.monotonic() + WATCHDOG_S
        while not (found := condition()):
            assert time.monotonic() < deadline, f"still waiting for {what}"
            time.sleep(0.002)
            self.scan(step)
        return found


@contextlib.contextmanager
def made_joint(*arguments: Any, **others: Any) -> Iterator[Joint]:
    """Give a joint of these arguments, and close it."""
    made = Joint(*arguments, **others)
    try:
        yield made
    finally:
        made.close()


@contextlib.contextmanager
def ros_side(backend: str, domain: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Give what a configuration has under ``ros`` for a backend, and its own settings.

    Over Zenoh a router is the only way: nothing is lost because links change.
    """
    with contextlib.ExitStack() as stack:
        options: dict[str, Any] = {}
        if backend == "zenoh":
            router = stack.enter_context(Router(stack.enter_context(free_port())))
            options = {"mode": "client", "connect": [router.endpoint]}
        own = f", {backend}: {json.dumps(options)}" if options else ""
        yield f"backend: {backend}, domain: {domain}{own}", options
