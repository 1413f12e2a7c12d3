"""The cell as a whole: starts hall, bridge and PLC, breaks what is to be broken, and counts in the end."""

from __future__ import annotations

import os
import random
import secrets
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rosplc
from examples.assembly_cell.world import PLACING, REMOVING
from rosplc.demo.plan import FreeDomain
from rosplc.demo.processes import Child, remove_objects
from rosplc.errors import SetupError

__all__ = ["FAULTS", "Cell", "Result"]

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PACKAGE = "examples.assembly_cell"
FAULTS = ("bridge", "estop", "plc")
_POLL_S = 0.02
_BRIDGE_AWAY_S = 1.0
_STOPPED_S = 1.0
_WATCHDOG_S = 300.0
"""How long nothing may happen; on the most loaded machine a step takes a few seconds."""


@dataclass(frozen=True)
class Result:
    """What came of it.

    Attributes:
        asked: Handles that were to be made.
        delivered: Serial numbers in the box, in order.
        mishaps: What must never have happened: done twice, collided, unfinished.
        faults: What was broken, and during what.
        plc: ``python`` or ``st``.
        seconds: How long it took.
    """

    asked: int
    delivered: list[int]
    mishaps: list[str]
    faults: list[str]
    plc: str
    seconds: float

    @property
    def good(self) -> bool:
        """Every handle was delivered once, in order, and nothing else happened."""
        return self.delivered == list(range(1, self.asked + 1)) and not self.mishaps


@dataclass
class Cell:
    """Three processes around one machine; a context manager that leaves nothing behind.

    Args:
        plc: ``python`` for the virtual PLC, ``st`` for the Structured Text.
        handles: How many handles are made.
        faults: Whether to break bridge, robot and PLC on the way.
        seed: Break them at random moments instead of those that are foreseen.
        on_tick: Called some fifty times a second with the cell, to draw it.

    Attributes:
        prefix: The bridge's prefix.
        broken: What was broken, and during what.
        away: What is broken at present.
    """

    plc: str = "python"
    handles: int = 8
    faults: bool = True
    seed: int | None = None
    on_tick: Callable[[Cell], None] = lambda cell: None
    prefix: str = field(default_factory=lambda: f"assembly-{secrets.token_hex(3)}")
    broken: list[str] = field(default_factory=list)
    away: str = ""

    def __enter__(self) -> Cell:
        self._folder = Path(tempfile.mkdtemp(prefix="rosplc-assembly-"))
        self._domain = FreeDomain()
        self._environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
            "ROS_DOMAIN_ID": str(self._domain.number),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }
        self._children: list[Child] = []
        self._facts: dict[str, Any] = {}
        self._changed = time.monotonic()
        self._changes = 0
        self._bridge: Child | None = None
        self._built: Path | None = None
        try:
            self._prepare()
            wires = self._folder / "wires"
            self._hall = self._start("hall", f"{PACKAGE}.hall", self._domain.number, wires, self.handles)
            self._wait(lambda: bool(self._hall.status), "the hall")
            self._start_bridge()
            self._start_plc()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def world(self) -> dict[str, Any]:
        """What is really there, as the hall last told."""
        return self._hall.status

    @property
    def program(self) -> dict[str, Any]:
        """What the PLC's program last told."""
        return self._plc.status

    @property
    def bridge_pid(self) -> int | None:
        """The bridge's process; None while it is away."""
        return None if self._bridge is None else self._bridge.pid

    @property
    def folder(self) -> Path:
        """Where this run's files are."""
        return self._folder

    def run(self) -> Result:
        """Make all handles.

        Raises:
            SetupError: SYS002, a process failed; SYS004, nothing goes on any more.
        """
        began = time.monotonic()
        plan = self._plan() if self.faults else iter(())
        fault = next(plan, None)
        while len(self.world["box"]) < self.handles:
            self._tick()
            if fault is not None and fault[1]():
                self._break(fault[0])
                fault = next(plan, None)
        return Result(
            self.handles,
            self.world["box"],
            self.world["mishaps"],
            self.broken,
            self.plc,
            time.monotonic() - began,
        )

    # -- faults

    def _plan(self) -> Iterator[tuple[str, Callable[[], bool]]]:
        """Yield what is to be broken, and when it is time."""
        if self.seed is not None:
            chance = random.Random(self.seed)
            while True:
                # By what happened and not by the clock: on a slow machine the cell must get on as well.
                at = self._changes + chance.randint(2, 12)
                late = chance.uniform(0.0, 0.3)
                yield (
                    chance.choice(FAULTS),
                    lambda at=at, late=late: self._changes >= at and time.monotonic() > self._changed + late,
                )
        last = 0
        for kind, phase, share in (("bridge", PLACING, 5), ("estop", REMOVING, 3), ("plc", PLACING, 2)):
            least = max(last, self.handles // share)  # in the course of things, each during a hand-over
            last = least + 1
            yield (
                kind,
                lambda phase=phase, least=least: (
                    self.world["phase"] == phase and len(self.world["box"]) >= least
                ),
            )
        pressing = max(last, self.handles * 3 // 4)
        yield "plc", lambda: self.world["cylinder"] > 0.2 and len(self.world["box"]) >= pressing

    def _break(self, kind: str) -> None:
        word = ("idle", "assembling", "placing", "removing")[self.world["phase"]]
        where = "pressing" if self.world["cylinder"] > 0 else word
        self.broken.append(f"{kind}: during {where} handle {self.world['placed']}")
        self.away = kind
        if kind == "bridge" and self._bridge is not None:
            self._kill(self._bridge)
            self._bridge = None
            self._pause(_BRIDGE_AWAY_S)
            self._start_bridge()
        elif kind == "plc":
            self._kill(self._plc)
            self._start_plc()
        else:
            self._hall.order("estop")
            self._wait(lambda: self.world["stopped"], "the protective stop")
            self._pause(_STOPPED_S)
            self._hall.order("reset")
            self._wait(lambda: not self.world["stopped"], "the reset")
        self.away = ""

    def _pause(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self._look()

    # -- processes

    def _prepare(self) -> None:
        """Write this run's configuration, and for Structured Text its project."""
        text = (HERE / "rosplc.yaml").read_text(encoding="utf-8")
        config = self._folder / "rosplc.yaml"
        config.write_text(text.replace("prefix: assembly", f"prefix: {self.prefix}"), encoding="utf-8")
        shutil.copytree(HERE / "msg", self._folder / "msg")
        if self.plc == "st":
            self._built = generate(config, self._folder / "plc")

    def _start(self, role: str, module: str, *arguments: object) -> Child:
        child = Child(role, module, [str(each) for each in arguments], self._environment)
        self._children.append(child)
        return child

    def _start_plc(self) -> None:
        self._plc = self._start("PLC", f"{PACKAGE}.plc_{self.plc}", self._folder, self.prefix)

    def _start_bridge(self) -> None:
        # `rosplc run`, ended by this process's pipe: no bridge outlives its cell.
        self._bridge = self._start("bridge", "rosplc.demo.bridge", self._folder / "rosplc.yaml", self.prefix)

    def _kill(self, child: Child) -> None:
        child.kill()
        self._children.remove(child)
        child.close()

    def _look(self) -> None:
        for child in self._children:
            child.check()
        self.on_tick(self)
        time.sleep(_POLL_S)

    def _tick(self) -> None:
        """Look, and notice when nothing goes on any more."""
        self._look()
        facts = {key: value for key, value in self.world.items() if key != "cylinder"}
        now = time.monotonic()
        if facts != self._facts:
            self._facts, self._changed = facts, now
            self._changes += 1
        if now - self._changed > _WATCHDOG_S:
            raise SetupError("SYS004", f"nothing goes on any more: {self.world}, the PLC: {self.program}")

    def _wait(self, condition: Callable[[], bool], what: str) -> None:
        until = time.monotonic() + _WATCHDOG_S
        while not condition():
            for child in self._children:
                child.check()
            if time.monotonic() > until:
                raise SetupError("SYS004", f"{what} did not come")
            time.sleep(_POLL_S)

    def close(self) -> None:
        """End everything, and remove what it left."""
        for child in reversed(self._children):
            child.finish()
            child.close()
        self._children.clear()
        if self._built is not None:
            self._built.unlink(missing_ok=True)  # it has this run's prefix in it
        remove_objects(self.prefix)
        shutil.rmtree(self._folder, ignore_errors=True)
        self._domain.close()


def generate(config: Path, folder: Path) -> Path:
    """Write the PLC project of a configuration with the cell's programs; return what was translated."""
    from rosplc.demo.st.process import find_translator

    translator = find_translator()
    rosplc.generate(config, folder)
    shutil.copytree(HERE / "st", folder / "st" / "Programs")
    from rosplc_st.run_project import load_texts

    return Path(translator.build(load_texts(folder)).path)
