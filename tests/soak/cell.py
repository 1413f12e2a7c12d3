"""The system under test: a bridge, a PLC, ROS nodes, and a router or master where there is one."""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from rosplc.demo.plan import FreeDomain
from rosplc.shm import Namespace
from rosplc_bench.process import free_port
from tests.soak.messages import (
    ALL,
    CAPACITY,
    CLASSIC,
    GENERATIONS,
    ROS_DEPTH,
    TOPICS,
    TYPE,
    Counters,
    towards_plc,
)
from tests.soak.processes import ForkServer, Part
from tests.soak.st import build_program

ROOT = Path(__file__).resolve().parents[2]
WATCHDOG_S = 120.0
RECOVER_AFTER_S = 2
"""When the lock of a classic topic is freed for a holder that shows no life: longer than any SIGSTOP here."""
SHM = Path("/dev/shm")


class WatchdogError(Exception):
    """What was waited for did not come."""


class Cell:
    """The processes and what they share.

    Args:
        folder: For files; made and removed by the caller.
        backend: ``dds``, ``zenoh`` or ``rospy``.
        private: Whether ``/dev/shm`` is this campaign's own.
        plc: ``python``, the virtual PLC; or ``st``, generated Structured Text that is executed, with two
            classic topics more.

    Attributes:
        parts: Name → process.
        counters: What was sent and received.
        extra: Topics that reloading adds, changes and removes: name → entry of the configuration.
        options: More keys for the four topics' entries.
        slots_key: What the configuration calls a topic's slots; 0.1.0 has another word.
    """

    def __init__(self, folder: Path, backend: str, *, private: bool, plc: str = "python") -> None:
        self.folder = folder
        self.backend = backend
        self.private = private
        self.plc = plc
        self.topics = ALL if plc == "st" else TOPICS
        self.prefix = f"soak{secrets.token_hex(4)}"
        self.namespace = Namespace(self.prefix)
        self.counters = Counters(folder / "counters", create=True)
        self.extra: dict[str, str] = {}
        self.options = dict.fromkeys(ALL, "")
        self.slots_key = "slots"
        self.config = folder / "soak.yaml"
        self._plc_config, self._plc_built = folder / "plc.yaml", folder / "plc.built"
        self._generations = 0
        self._sender = {"publisher": 0, "plc": 0}
        self._domain = FreeDomain() if backend == "dds" else None
        self._port = free_port()
        self.environment = self._environment()
        modules = ("tests.soak.peers", "tests.soak.plc", *(("tests.soak.st",) if plc == "st" else ()))
        self._fork_server = ForkServer(self.environment, backend, modules)
        self.parts: dict[str, Part] = {}
        if backend != "dds":
            self._add("hub", self._hub)
        for name in ("bridge", "plc", "publisher", "subscriber"):
            self._add(name, getattr(self, f"_{name}"))

    def _environment(self) -> dict[str, str]:
        kept = {key: value for key, value in os.environ.items() if not key.startswith(("ROS", "CYCLONEDDS"))}
        kept["PYTHONPATH"] = os.pathsep.join((str(ROOT), str(ROOT / "src")))  # this checkout, and no other
        kept["PYTHONFAULTHANDLER"] = "1"  # SIGABRT: where every thread is
        if self.backend == "rospy":
            kept |= {"ROS_MASTER_URI": f"http://127.0.0.1:{self._port}", "ROS_IP": "127.0.0.1"}
        else:
            kept["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        return kept

    def _add(self, name: str, command: Callable[[], list[str]]) -> None:
        fork_server = None if name in ("hub", "bridge") else self._fork_server
        self.parts[name] = Part(name, command, self.environment, self.folder / f"{name}.log", fork_server)

    # -- command lines

    @property
    def _where(self) -> str:
        if self._domain is not None:
            return str(self._domain.number)
        return f"tcp/127.0.0.1:{self._port}" if self.backend == "zenoh" else "-"

    def _hub(self) -> list[str]:
        if self.backend == "zenoh":
            return [sys.executable, "-m", "tests.soak.router", self._where]
        return ["rosmaster", "--core", "-p", str(self._port)]

    def _bridge(self) -> list[str]:
        return [sys.executable, "-m", "rosplc", "run", str(self.config), "--status", "0"]

    def _next(self, role: str) -> str:
        self._generations += 1
        if self._generations >= GENERATIONS:
            raise WatchdogError("the counters is full: no campaign has so many rounds")
        self._sender[role] = self._generations
        return str(self._generations)

    def _plc(self) -> list[str]:
        arguments = [str(self.folder / "counters"), self._next("plc")]
        if self.plc == "st":
            arguments += [str(self._plc_config), str(self._plc_built)]
        else:
            arguments.append(self.prefix)
        return [sys.executable, "-m", "tests.soak.plc", *arguments]

    def _publisher(self) -> list[str]:
        return self._peer("publisher", self._next("publisher"))

    def _subscriber(self) -> list[str]:
        return self._peer("subscriber", "0")

    def _peer(self, role: str, generation: str) -> list[str]:
        path = str(self.folder / "counters")
        arguments = [role, path, generation, self.backend, self._where, *self.topics]
        return [sys.executable, "-m", "tests.soak.peers", *arguments]

    # -- configuration

    def write_config(self, wrong: str = "") -> None:
        """Write the bridge's configuration; ``wrong`` is a line that makes it refused."""
        lines = self._lines(wrong) + [f"  {topic}: {entry}" for topic, entry in self.extra.items()]
        # Replaced at once: a bridge that starts at this moment reads the old or the new, never half of it.
        fresh = self.config.with_suffix(".new")
        fresh.write_text("\n".join(lines) + "\n")
        fresh.rename(self.config)

    def _lines(self, wrong: str = "") -> list[str]:
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
            "diagnostics: {period: 100ms}",
            *([wrong] if wrong else []),
            "topics:",
        ]
        for topic in self.topics:
            way = "plc" if towards_plc(topic) else "ros"
            limits = "" if "limits" in self.options[topic] else f", limits: {{data: {CAPACITY}}}"
            if topic in CLASSIC:
                how = f"classic: {{name: {self.classic_name(topic)}, recover_after: {RECOVER_AFTER_S}s}}"
            else:
                how = f"every: {'true' if topic.endswith(('/in', '/out')) else 'false'}, {self.slots_key}: 64"
            if "qos" not in self.options[topic]:
                how += f", qos: {{{self._qos(topic)}}}"
            rest = f"{how}{limits}{self.options[topic]}"
            lines.append(f"  {topic}: {{type: {TYPE}, to: {way}, {rest}}}")
        return lines

    def _qos(self, topic: str) -> str:
        if towards_plc(topic):
            return f"depth: {ROS_DEPTH}"
        # Towards ROS the default is latched, and what is latched is kept in memory: a flood's seconds of it.
        # In ROS 1 whoever comes gets what is latched, asked for or not: an old message once more.
        return f"depth: {ROS_DEPTH // 5}" + (", durability: volatile" if self.backend == "rospy" else "")

    def classic_name(self, topic: str) -> str:
        """Return the name of a classic topic's memory."""
        return f"{self.prefix}_{topic.rpartition('_')[2]}"

    def hang_up(self, words: str) -> None:
        """Tell the bridge to reload, and wait until it has logged these words."""
        before = self.said(words)
        self.parts["bridge"].send(signal.SIGUSR1)
        self.wait(lambda: self.said(words) > before, f"the bridge says {words!r} after the reload")

    def said(self, words: str) -> int:
        """Return how often the bridge has logged some words since the round began."""
        return self.parts["bridge"].told().count(words)

    # -- life

    def start(self) -> None:
        """Start everything, and wait until all topics are carried."""
        self.write_config()
        if self.plc == "st":
            self._plc_config.write_text("\n".join(self._lines()) + "\n")
            build_program(self._plc_config, self._plc_built)
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
        self._fork_server.close()
        if self._domain is not None:
            self._domain.close()
        for path in SHM.glob(f"*{self.prefix}*"):
            path.unlink(missing_ok=True)

    # -- the flow

    def marks(self) -> list[tuple[int, int]]:
        """Return for each topic the sender's generation and the number it has come to."""
        found = []
        for index, topic in enumerate(self.topics):
            generation = self._sender["publisher" if towards_plc(topic) else "plc"]
            found.append((generation, int(self.counters.announced[generation, index])))
        return found

    def flows(self, marks: Iterable[tuple[int, int]]) -> list[str]:
        """Return the topics on which nothing newer than the marks has arrived."""
        silent = []
        for index, (generation, number) in enumerate(marks):
            came, last = self.counters.arrived(index)
            if came < generation or (came == generation and last <= number):
                silent.append(ALL[index])
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
        control = self.counters.control
        # A stamp far ahead is one of before the bridge's clock was set right again.
        self.wait(lambda: now < control["stamp_ns"] < now + 600 * 10**9, "diagnostics come")
        seen = int(control["diagnostics"])  # the status was taken a moment before it was stamped
        self.wait(lambda: control["diagnostics"] > seen, "diagnostics come")

    # -- shared memory

    def objects(self) -> set[str]:
        """Return the names of this cell's files in shared memory, lock files left out."""
        locks = (f"{self.prefix}.l.", "rosplc.classic.")
        return {path.name for path in SHM.glob(f"*{self.prefix}*") if not path.name.startswith(locks)}

    def is_classic(self, name: str) -> bool:
        """Return whether a file in shared memory is a classic topic's memory or semaphore."""
        return name.removeprefix("sem.").startswith(f"{self.prefix}_")

    def expected_objects(self) -> set[str]:
        """Return the names that should be there."""
        names = {self.namespace.object_name(topic) for topic in (*TOPICS, *self.extra)}
        for topic in set(self.topics) & set(CLASSIC):
            names |= {self.classic_name(topic), f"sem.{self.classic_name(topic)}"}
        return names

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
