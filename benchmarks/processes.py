"""Programs that a measurement needs beside it, and the bridge between them."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosplc.demo.plan import FreeDomain
from rosplc.demo.processes import remove_objects
from rosplc_bench.process import Side

__all__ = [
    "RosGraph",
    "bridge",
    "cpu_seconds",
    "environment",
    "lost_in_bridge",
    "peers",
    "ros_domain",
    "share",
]

ROOT = Path(__file__).resolve().parent.parent
_TICKS = os.sysconf("SC_CLK_TCK")


@contextmanager
def ros_domain() -> Iterator[int]:
    """Give a ROS domain that nothing else on this machine uses."""
    domain = FreeDomain()
    try:
        yield domain.number
    finally:
        domain.close()


@dataclass(frozen=True)
class RosGraph:
    """A ROS graph to measure on.

    Attributes:
        domain: The ROS domain.
        backend: How to reach it.
        distro: The ROS distribution.
        options: The backend's own settings.
        variables: What belongs into the environment.
    """

    domain: int
    backend: str = "dds"
    distro: str = "jazzy"
    options: Mapping[str, Any] = field(default_factory=dict)
    variables: Mapping[str, str] = field(default_factory=dict)

    def settings(self) -> str:
        """Return the configuration's section ``ros``."""
        own = {self.backend: dict(self.options)} if self.options else {}
        return json.dumps({"backend": self.backend, "distro": self.distro, "domain": self.domain, **own})

    def plan(self) -> dict[str, Any]:
        """Return what a peer has to know."""
        keys = ("domain", "backend", "distro")
        return {**{key: getattr(self, key) for key in keys}, "options": dict(self.options)}


def environment(domain: int, variables: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return an environment whose ROS nodes find each other on this machine alone."""
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]),
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONUNBUFFERED": "1",
        **(variables or {}),
    }


@contextmanager
def peers(
    roles: str, plan: Mapping[str, Any], domain: int = 0, variables: Mapping[str, str] | None = None
) -> Iterator[list[Side]]:
    """Run roles of :mod:`benchmarks.peers`, which are ready when the block begins and end with it."""
    with ExitStack() as stack:
        sides: list[Side] = []
        for role in roles.split():
            command = [sys.executable, "-m", "benchmarks.peers", role, json.dumps(plan)]
            sides.append(stack.enter_context(Side(role, command, environment(domain, variables))))
            stack.callback(sides[-1].kill)
        for side in sides:
            side.receive()
        yield sides


@contextmanager
def bridge(
    folder: Path,
    config: str,
    domain: int,
    variables: Mapping[str, str] | None = None,
    command: Sequence[str] = ("-m", "rosplc"),
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a bridge; it is up when the block begins, and its objects are gone when it has ended.

    ``command`` is what Python runs.
    """
    path, log = folder / "rosplc.yaml", folder / "bridge.log"
    path.write_text(config)
    with log.open("wb") as errors:
        process = subprocess.Popen(
            [sys.executable, *command, "run", str(path), "--status", "5"],
            env=environment(domain, variables),
            stdout=errors,
            stderr=errors,
        )
        try:
            while b"carries" not in log.read_bytes():
                if process.poll() is not None:
                    raise RuntimeError(log.read_text())
                time.sleep(0.01)
            yield process
        finally:
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            prefix = next(line.split()[1] for line in config.splitlines() if line.startswith("prefix:"))
            remove_objects(prefix)


def lost_in_bridge(folder: Path) -> int:
    """Wait for the next status line of a bridge that runs in a folder; return the losses that it counts."""
    log = folder / "bridge.log"

    def lines() -> list[bytes]:
        return re.findall(rb"status: .*, lost (\d+), refused", log.read_bytes())

    before = len(lines())
    while len(found := lines()) == before:
        time.sleep(0.1)
    return int(found[-1])


def cpu_seconds(pid: int) -> tuple[float, float]:
    """Return a process's user and system time."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return int(fields[11]) / _TICKS, int(fields[12]) / _TICKS


def pss_mb(pid: int, *kinds: str) -> float:
    """Return a process's proportional share of memory; of some kinds only, such as ``Anon`` and ``File``."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii")
    wanted = "|".join(f"_{kind}" for kind in kinds)
    return sum(map(int, re.findall(rf"^Pss(?:{wanted}):\s+(\d+) kB", text, re.MULTILINE))) / 1024


def share(pids: Mapping[str, int], seconds: float, rounds: int) -> dict[str, list[float]]:
    """Return the cores that processes use, in percent, round by round: user, system and their sum."""
    found: dict[str, list[float]] = {}
    for _ in range(rounds):
        before = {name: (*cpu_seconds(pid), time.monotonic()) for name, pid in pids.items()}
        time.sleep(seconds)
        for name, pid in pids.items():
            user, system = cpu_seconds(pid)
            old_user, old_system, then = before[name]
            took = time.monotonic() - then
            found.setdefault(f"{name}, user", []).append(100 * (user - old_user) / took)
            found.setdefault(f"{name}, system", []).append(100 * (system - old_system) / took)
            found.setdefault(name, []).append(100 * max(0.0, user + system - old_user - old_system) / took)
    return found
