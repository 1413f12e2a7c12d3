"""A bridge with one classic topic over the in-process graph, and the programs on the memory's other side."""

from __future__ import annotations

import fcntl
import hashlib
import os
import queue
import secrets
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from rosplc.bridge import Bridge
from rosplc.bridge.status import ClassicStatus, TopicStatus
from rosplc.clock import SystemClock
from rosplc.codec import Codec, Wire
from rosplc.config import parse_config, resolve
from rosplc.ros import DEFAULT, PRESETS
from rosplc.ros.memory import open_backend
from tests.lib.waiting import wait_for

PEERS = Path(__file__).parent / "interop" / "classic" / "peers"
CACHE = Path(__file__).parents[1] / ".cache" / "interop"
WORDS = 256
"""Words of the record of ``cell_msgs/msg/Words``; all hold the same number, so that a torn one shows."""
SIZE = 4 * WORDS
WATCHDOG_S = 100.0


def build_plc() -> Path:
    """Compile the PLC's half in C, once per content."""
    return build("plc.c", ["gcc", "-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror"])


def build(source: str, command: Sequence[str], *libraries: str) -> Path:
    """Compile one of the peers, once per content."""
    if shutil.which(command[0]) is None:
        pytest.skip(f"Debian package {command[0]} is missing")
    path = PEERS / source
    digest = hashlib.sha256(path.read_bytes() + repr((command, libraries)).encode()).hexdigest()[:16]
    program = CACHE / f"{path.stem}-{digest}"
    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / f"{path.stem}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not program.exists():
            partial = program.with_suffix(".partial")
            done = subprocess.run(
                [*command, str(path), "-o", str(partial), *libraries],
                capture_output=True,
                text=True,
                check=False,
            )
            assert done.returncode == 0, done.stderr
            partial.rename(program)
    return program


class Program:
    """A running peer; a context manager that kills it.

    Attributes:
        lines: What it has said so far, after ``ready``.
    """

    def __init__(self, command: Sequence[object], environment: Mapping[str, object] | None = None) -> None:
        variables = {key: str(value) for key, value in (environment or {}).items()}
        self.process = subprocess.Popen(
            [str(word) for word in command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **variables},
        )
        self.lines: list[str] = []
        self._news: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.wait_line("ready")

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._news.put(line.rstrip("\n"))
        self._news.put(None)

    def wait_line(self, start: str) -> str:
        """Return the next line that begins so."""
        while True:
            line = self._news.get(timeout=WATCHDOG_S)
            assert line is not None, f"the peer ended after {self.lines[-5:]}"
            self.lines.append(line)
            if line.startswith(start):
                return line

    def said(self) -> list[str]:
        """Return everything said so far."""
        while not self._news.empty():
            line = self._news.get()
            if line is not None:
                self.lines.append(line)
        return self.lines

    def kill(self) -> None:
        """End it at once, wherever it is."""
        self.process.kill()
        self.process.wait()
        self._reader.join()

    def stop(self) -> None:
        """Stop it."""
        self.process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Let it go on."""
        self.process.send_signal(signal.SIGCONT)

    def end(self) -> str:
        """Let it end by itself; return its last words."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(WATCHDOG_S)
        self._reader.join()
        return (self.said() or [""])[-1]

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                stream.close()


def unique_name() -> str:
    """Return a name for a memory of a test's own."""
    return f"T{secrets.token_hex(6)}"


def remove(*names: str) -> None:
    """Remove memory, semaphore and lock file of these names."""
    for name in names:
        for start in ("", "sem.", "rosplc.classic."):
            (Path("/dev/shm") / f"{start}{name}").unlink(missing_ok=True)


class _AskedClock(SystemClock):
    """The machine's clock, which counts how often the thread that carries classic topics has asked it."""

    def __init__(self) -> None:
        self.asked = 0

    def monotonic_ns(self) -> int:
        """Return nanoseconds since some fixed moment."""
        self.asked += threading.current_thread().name.startswith("rosplc-classic")
        return time.monotonic_ns()


class ClassicCell:
    """A bridge with one classic topic ``/t`` of ``cell_msgs/msg/Words``; a context manager.

    Args:
        folder: Where the type's definition is written.
        to: ``plc`` or ``ros``.
        keys: More keys of ``classic``, such as ``recover_after: 100ms``.
        entry: More keys of the topic.
        more: More of the configuration: topics, indented by two.
        name: The memory's name; one of its own by default.

    Attributes:
        got: The numbers of the messages that came to ROS; None stands for a torn one.
    """

    def __init__(
        self, folder: Path, to: str, keys: str = "", entry: str = "", more: str = "", name: str = ""
    ) -> None:
        self.name = name or unique_name()
        messages = folder / "cell_msgs" / "msg"
        messages.mkdir(parents=True, exist_ok=True)
        (messages / "Words.msg").write_text(f"uint32[{WORDS}] words\n")
        classic = f"{{name: {self.name}{', ' if keys else ''}{keys}}}{', ' if entry else ''}{entry}"
        text = (
            f"prefix: {self.name}\ntypes: {{paths: [{folder}]}}\nros: {{backend: memory}}\ntopics:\n"
            f"  /t: {{type: cell_msgs/msg/Words, to: {to}, classic: {classic}}}\n"
            f"{more}"
        )
        self.project = resolve(parse_config(text))
        self.plan = self.project.topic("/t")
        self.codec = Codec(self.plan.layout, Wire.CDR)
        domain = secrets.randbelow(200)
        self._bridge_side = open_backend(self.project.store, "bridge", domain=domain)
        self.ros = open_backend(self.project.store, "peer", domain=domain)
        self._clock = _AskedClock()
        self.bridge = Bridge(self.project, self._bridge_side, clock=self._clock)
        self.got: list[int | None] = []
        if to == "ros":
            self.ros.subscribe("/t", self.plan.type_name, DEFAULT, self._on_message)
        else:
            self._publisher = self.ros.advertise("/t", self.plan.type_name, PRESETS["latched"])

    def _on_message(self, data: bytes, _stamp_ns: int) -> None:
        words = set(self.plan.layout.to_dict(self.codec.decode(data))["words"])
        self.got.append(words.pop() if len(words) == 1 else None)

    def publish(self, number: int) -> None:
        """Publish a message with this number in every word."""
        self._publisher.write(self.codec.encode(number.to_bytes(4, "little") * WORDS), 0)

    @property
    def path(self) -> Path:
        """The memory's file."""
        return Path("/dev/shm") / self.name

    @property
    def image(self) -> bytes:
        """What the memory holds."""
        return self.path.read_bytes()

    def write(self, number: int) -> None:
        """Write a number into every word, as a peer that has the lock would."""
        with self.path.open("r+b") as file:
            file.write(number.to_bytes(4, "little") * WORDS)

    @property
    def status(self) -> TopicStatus:
        """How the topic stands."""
        return self.bridge.status().topic("/t")

    @property
    def classic(self) -> ClassicStatus:
        """How memory and lock stand."""
        found = self.status.classic
        assert found is not None
        return found

    def turns(self, number: int = 3) -> None:
        """Return once the bridge has looked at memory and lock so often again."""
        wanted = self._clock.asked + 2 * (number + 1)  # a turn asks twice, and one may be under way
        wait_for(lambda: self._clock.asked >= wanted, "the bridge to look at the memory")

    def plc(self, way: str, *, period_us: int = 1000, semaphore: str = "", **environment: object) -> Program:
        """Start the PLC's half in C, ``read`` or ``write``."""
        command = [build_plc(), way, self.name, semaphore or self.name, SIZE, period_us]
        return Program(command, environment)

    def __enter__(self) -> ClassicCell:
        self.bridge.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bridge.stop()
        self.ros.close()
        self._bridge_side.close()
        remove(self.name)
        for path in Path("/dev/shm").glob(f"{self.name}.*"):
            path.unlink()
