"""The system under test: a bridge, a PLC, ROS nodes, and a router or master where there is one."""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from rosplc.demo.domain import FreeDomain
from rosplc.shm import Namespace
from soak.ledger import GENERATIONS, Ledger
from soak.parts import Part
from soak.pattern import CAPACITY, IN, TOPICS, TYPE

__all__ = ["Cell", "Extra", "WatchdogError"]

ROOT = Path(__file__).resolve().parent.parent
WATCHDOG_S = 60.0
SHM = Path("/dev/shm")


class WatchdogError(Exception):
    """What was waited for did not come."""


class Extra(dict[str, str]):
    """Topics that reloading adds, changes and removes: name → entry of the configuration."""


class Cell:
    """The processes and what they share.

    Args:
        folder: For files; made and removed by the caller.
        backend: ``dds``, ``zenoh`` or ``rospy``.
        private: Whether ``/dev/shm`` is this campaign's own.

    Attributes:
        parts: Name → process.
        ledger: What was sent and received.
        extra: Topics beside those that carry patterns.
        options: More keys for the four topics' entries.
    """

    def __init__(self, folder: Path, backend: str, *, private: bool) -> None:
        self.folder = folder
        self.backend = backend
        self.private = private
        self.prefix = f"soak{secrets.token_hex(4)}"
        self.namespace = Namespace(self.prefix)
        self.ledger = Ledger(folder / "ledger", create=True)
        self.extra = Extra()
        self.options = dict.fromkeys(TOPICS, "")
        self.config = folder / "soak.yaml"
        self._generations = 0
        self._sender = {"publisher": 0, "plc": 0}
        self._domain = FreeDomain() if backend == "dds" else None
        self._port = _free_port()
        self.environment = self._environment()
        self.parts: dict[str, Part] = {}
        if backend != "dds":
            self._add("hub", self._hub)
        for name in ("bridge", "plc", "publisher", "subscriber"):
            self._add(name, getattr(self, f"_{name}"))

    def _environment(self) -> dict[str, str]:
        kept = {key: value for key, value in os.environ.items() if not key.startswith(("ROS", "CYCLONEDDS"))}
        kept |= {"PYTHONPATH": str(ROOT), "PYTHONFAULTHANDLER": "1"}  # SIGABRT: where every thread is
        if self.backend == "rospy":
            kept |= {"ROS_MASTER_URI": f"http://127.0.0.1:{self._port}", "ROS_IP": "127.0.0.1"}
        else:
            kept["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        return kept

    def _add(self, name: str, command: Callable[[], list[str]]) -> None:
        self.parts[name] = Part(name, command, self.environment, self.folder / f"{name}.log")

    # -- command lines

    @property
    def _where(self) -> str:
        if self._domain is not None:
            return str(self._domain.number)
        return f"tcp/127.0.0.1:{self._port}" if self.backend == "zenoh" else "-"

    def _hub(self) -> list[str]:
        if self.backend == "zenoh":
            return [sys.executable, "-m", "soak.router", self._where]
        return ["rosmaster", "--core", "-p", str(self._port)]

    def _bridge(self) -> list[str]:
        return [sys.executable, "-m", "rosplc", "run", str(self.config), "--status", "0"]

    def _next(self, role: str) -> str:
        self._generations += 1
        if self._generations >= GENERATIONS:
            raise WatchdogError("the ledger is full: no campaign has so many rounds")
        self._sender[role] = self._generations
        return str(self._generations)

    def _plc(self) -> list[str]:
        arguments = [str(self.folder / "ledger"), self._next("plc"), self.prefix]
        return [sys.executable, "-m", "soak.plc", *arguments]

    def _publisher(self) -> list[str]:
        return self._peer("publisher", self._next("publisher"))

    def _subscriber(self) -> list[str]:
        return self._peer("subscriber", "0")

    def _peer(self, role: str, generation: str) -> list[str]:
        path = str(self.folder / "ledger")
        return [sys.executable, "-m", "soak.peers", role, path, generation, self.backend, self._where]

    # -- configuration

    def write_config(self, wrong: str = "") -> None:
        """Write the bridge's configuration; ``wrong`` is a line that makes it refused."""
        ros = {
            "dds": f"backend: dds, domain: {self._domain.number if self._domain else 0}",
            "zenoh": f"backend: zenoh, zenoh: {{connect: ['{self._where}']}}",
            "rospy": "backend: rospy, distro: noetic",
        }[self.backend]
        lines = [
            "bridge: soak",
            f"prefix: {self.prefix}",
            f"ros: {{{ros}}}",
            "beat: 50ms",
            "diagnostics: {period: 200ms}",
            *([wrong] if wrong else []),
            "topics:",
        ]
        for topic in TOPICS:
            way = "plc" if topic in IN else "ros"
            every = "true" if topic.endswith(("/in", "/out")) else "false"
            limits = "" if "limits" in self.options[topic] else f", limits: {{data: {CAPACITY}}}"
            rest = f"every: {every}, depth: 64{limits}{self.options[topic]}"
            lines.append(f"  {topic}: {{type: {TYPE}, to: {way}, {rest}}}")
        lines += [f"  {topic}: {entry}" for topic, entry in self.extra.items()]
        # Replaced at once: a bridge that starts at this moment reads the old or the new, never half of it.
        fresh = self.config.with_suffix(".new")
        fresh.write_text("\n".join(lines) + "\n")
        fresh.rename(self.config)

    def hang_up(self, words: str) -> None:
        """Send SIGHUP to the bridge, and wait until it has logged these words."""
        before = self.said(words)
        self.parts["bridge"].send(signal.SIGHUP)
        self.wait(lambda: self.said(words) > before, f"the bridge says {words!r} after SIGHUP")

    def said(self, words: str) -> int:
        """Return how often the bridge has logged some words."""
        log = self.parts["bridge"].log
        return log.read_text(errors="replace").count(words) if log.exists() else 0

    # -- life

    def start(self) -> None:
        """Start everything, and wait until all topics are carried."""
        self.write_config()
        self.ensure()
        self.await_flow(self.marks())

    def ensure(self) -> list[str]:
        """Start what does not run, as a service manager does; return their names."""
        dead = [name for name, part in self.parts.items() if not part.alive]
        for name in dead:
            self.parts[name].start()
        return dead

    def close(self) -> None:
        """End everything, and remove what it leaves in shared memory."""
        for part in self.parts.values():
            part.send(signal.SIGCONT)
            part.kill()
        if self._domain is not None:
            self._domain.close()
        for path in SHM.glob(f"*{self.prefix}*"):
            path.unlink(missing_ok=True)

    # -- the flow

    def marks(self) -> list[tuple[int, int]]:
        """Return for each topic the sender's generation and the number it has come to."""
        found = []
        for index, topic in enumerate(TOPICS):
            generation = self._sender["publisher" if topic in IN else "plc"]
            found.append((generation, int(self.ledger.announced[generation, index])))
        return found

    def flows(self, marks: Iterable[tuple[int, int]]) -> list[str]:
        """Return the topics on which nothing newer than the marks has arrived."""
        silent = []
        for index, (generation, number) in enumerate(marks):
            came, last = self.ledger.arrived(index)
            if came < generation or (came == generation and last <= number):
                silent.append(TOPICS[index])
        return silent

    def await_flow(self, marks: list[tuple[int, int]]) -> float:
        """Wait until every topic carries newer messages; return the seconds that took."""
        began = time.monotonic()
        while silent := self.flows(marks):
            if time.monotonic() - began > WATCHDOG_S:
                raise WatchdogError(f"nothing arrives on {', '.join(silent)} after {WATCHDOG_S:.0f} s")
            time.sleep(0.005)
        return time.monotonic() - began

    def wait(self, condition: Callable[[], object], what: str) -> None:
        """Wait for a condition."""
        deadline = time.monotonic() + WATCHDOG_S
        while not condition():
            if time.monotonic() > deadline:
                raise WatchdogError(f"waited {WATCHDOG_S:.0f} s: {what}")
            time.sleep(0.01)

    def await_diagnostics(self) -> None:
        """Wait until the bridge has said how it stands now, and not how it stood when the subscriber hung."""
        now = time.time_ns()
        control = self.ledger.control
        # A stamp far ahead is one of before the bridge's clock was set right again.
        self.wait(lambda: now < control["stamp_ns"] < now + 600 * 10**9, "diagnostics come")
        seen = int(control["diagnostics"])  # the status was taken a moment before it was stamped
        self.wait(lambda: control["diagnostics"] > seen, "diagnostics come")

    # -- shared memory

    def objects(self) -> set[str]:
        """Return the names of this cell's files in shared memory, lock files left out."""
        locks = f"{self.prefix}.l."
        return {path.name for path in SHM.glob(f"*{self.prefix}*") if not path.name.startswith(locks)}

    def expected_objects(self) -> set[str]:
        """Return the names that should be there."""
        return {self.namespace.object_name(topic) for topic in (*TOPICS, *self.extra)}

    def remove(self, names: Iterable[str]) -> None:
        """Remove files from shared memory, as session clean-up and container restarts do."""
        for name in names:
            (SHM / name).unlink(missing_ok=True)

    def keep_logs(self, where: Path) -> None:
        """Copy the logs to a folder."""
        where.mkdir(parents=True, exist_ok=True)
        for part in self.parts.values():
            if part.log.exists():
                shutil.copy(part.log, where / part.log.name)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
