"""A ROS 1 graph of a test's own: a master on a free port of the loopback interface, and peers.

Everything is started by the test as a program of Debian's; what is not installed is said as the
package to install.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import hashlib
import os
import queue
import signal
import socket
import subprocess
import tempfile
import threading
import xmlrpc.client
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rosplc.ros import Qos
from tests.lib.waiting import wait_for

HERE = Path(__file__).parent
PYTHON = "/usr/bin/python3"
_CACHE = HERE.parents[2] / ".cache" / "interop"

PACKAGES = (
    "python3-rosmaster", "python3-rostopic", "python3-rosnode", "python3-rosmsg", "g++", "python3-rospy",
    "python3-rosservice", "python3-std-srvs", "python3-std-msgs", "python3-geometry-msgs",
    "python3-sensor-msgs", "libroscpp-dev", "libstd-msgs-dev", "libgeometry-msgs-dev", "libsensor-msgs-dev",
)  # fmt: skip
"""The Debian packages that ROS 1's peers need."""

LIBRARIES = (
    "-lroscpp", "-lrosconsole", "-lroscpp_serialization", "-lrostime", "-lcpp_common", "-lboost_thread",
    "-lboost_system", "-lpthread",
)  # fmt: skip
"""What programs of roscpp are linked with."""


class Graph:
    """A master, and the environment to reach it; :func:`lend` gives one.

    Attributes:
        port: The master's port.
        environment: ``ROS_MASTER_URI`` and ``ROS_IP``.
    """

    def __init__(self) -> None:
        # Bound and not listening, it keeps the port from being given away, also while the master is dead.
        self._holder = socket.socket()
        self._holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._holder.bind(("127.0.0.1", 0))
        self.port: int = self._holder.getsockname()[1]
        self._home = tempfile.TemporaryDirectory(prefix="rosplc-ros1-")
        self.environment = {
            "ROS_MASTER_URI": f"http://127.0.0.1:{self.port}",
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": self._home.name,
            "ROS_LOG_DIR": self._home.name,
        }
        self._master: subprocess.Popen[bytes] | None = None
        self._peers: list[Peer] = []
        self._programs: list[subprocess.Popen[str]] = []
        self.start_master()

    @property
    def variables(self) -> dict[str, str]:
        """The whole environment for a program."""
        return {**os.environ, **self.environment, "PYTHONUNBUFFERED": "1"}

    def start_master(self) -> None:
        """Start the master and wait until it listens."""
        self._master = subprocess.Popen(
            # setpriv: a test run that is killed leaves no master behind.
            ["setpriv", "--pdeathsig", "KILL", "rosmaster", "--core", "-p", str(self.port)],
            env=self.variables,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

        def listens() -> bool:
            assert self._master is not None and self._master.poll() is None, "rosmaster ended"
            with socket.socket() as probe:
                return probe.connect_ex(("127.0.0.1", self.port)) == 0

        wait_for(listens)

    def kill_master(self) -> None:
        """End the master without a word."""
        if self._master is not None:
            self._master.kill()
            self._master.wait()
            self._master = None

    def freeze_master(self, frozen: bool) -> None:
        """Stop the master, or let it continue."""
        assert self._master is not None
        self._master.send_signal(signal.SIGSTOP if frozen else signal.SIGCONT)

    def is_empty(self) -> bool:
        """End the programs; return whether the master runs and knows no node any more."""
        self._end_programs()
        try:
            master = xmlrpc.client.ServerProxy(self.environment["ROS_MASTER_URI"])
            return master.getSystemState("/test")[2] == [[], [], []]  # type: ignore[index]
        except OSError:
            return False

    def _end_programs(self) -> None:
        for peer in self._peers:
            peer.close()  # says goodbye to the master, unless it was killed
        for program in self._programs:
            program.send_signal(signal.SIGINT)
            program.communicate()
        self._peers.clear()
        self._programs.clear()

    def peer(self, kind: str, name: str, *defines: str) -> Peer:
        """Start a ``rospy``, ``actionlib`` or ``roscpp`` peer."""
        command: list[Any] = [PYTHON, HERE / "peers" / f"{kind}_peer.py", name]
        if kind == "roscpp":
            command = [build(*defines), name]
        self._peers.append(Peer(command, self.variables))
        return self._peers[-1]

    def run(self, *command: str) -> str:
        """Run a tool of ROS 1 to its end; return what it prints."""
        done = subprocess.run(command, env=self.variables, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def start(self, *command: str) -> subprocess.Popen[str]:
        """Start a tool of ROS 1 that runs on; its output is a pipe."""
        program = subprocess.Popen(
            command, env=self.variables, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self._programs.append(program)
        return program

    def close(self) -> None:
        """End everything."""
        self._end_programs()
        self.kill_master()
        self._holder.close()
        self._home.cleanup()


_idle: list[Graph] = []


@contextlib.contextmanager
def lend() -> Iterator[Graph]:
    """Give a graph whose master knows nobody; masters are used again, as starting one takes a second."""
    graph = _idle.pop() if _idle else Graph()
    try:
        yield graph
    finally:
        if graph.is_empty():
            _idle.append(graph)
        else:
            graph.close()


@atexit.register
def _end() -> None:
    for graph in _idle:
        graph.close()


class Peer:
    """A running peer program."""

    def __init__(self, command: Sequence[Any], environment: dict[str, str]) -> None:
        self._process = subprocess.Popen(
            [str(word) for word in command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=environment,
        )
        self._answers: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._got: dict[str, list[bytes]] = {}
        self._lock = threading.Lock()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        assert self._answer() == "ready"

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            word, *rest = line.split()
            if word == "message":
                payload = b"" if rest[1] == "-" else bytes.fromhex(rest[1])
                self._got.setdefault(rest[0], []).append(payload)
            elif word in ("ready", "done", "matched"):
                self._answers.put(line.strip())
        self._answers.put(None)

    def _answer(self) -> str:
        line = self._answers.get()
        assert line is not None, f"the peer ended with {self._process.wait()}"
        return line

    def _ask(self, *words: object) -> str:
        with self._lock:
            assert self._process.stdin is not None
            self._process.stdin.write(" ".join(map(str, words)) + "\n")
            self._process.stdin.flush()
            return self._answer()

    def subscribe(self, topic: str, type_name: str, qos: Qos | None = None) -> PeerInbox:
        """Receive a topic."""
        self._ask("subscribe", topic, type_name.replace("/msg/", "/"), qos.depth if qos else 1000)
        return PeerInbox(self._got.setdefault(topic, []))

    def advertise(self, topic: str, type_name: str, qos: Qos | None = None) -> PeerOutbox:
        """Send a topic."""
        latch = qos is not None and qos.durability == "transient_local"
        depth = qos.depth if qos else 1000
        self._ask("advertise", topic, type_name.replace("/msg/", "/"), depth, int(latch))
        return PeerOutbox(lambda payload: self._ask("write", topic, payload.hex() or "-"))

    def unadvertise(self, topic: str) -> None:
        """Withdraw a topic."""
        self._ask("unadvertise", topic)

    def serve(self, service: str, type_name: str) -> list[bytes]:
        """Serve a service; return the list that its requests fill."""
        self._ask("serve", service, type_name.replace("/srv/", "/"))
        return self._got.setdefault(f"request:{service}", [])

    def unserve(self, service: str) -> None:
        """Withdraw a service."""
        self._ask("unserve", service)

    def proxy(self, service: str, type_name: str, persistent: bool = False) -> PeerProxy:
        """Get ready to call a service."""
        self._ask("proxy", service, type_name.replace("/srv/", "/"), int(persistent))
        replies, errors = (self._got.setdefault(f"{what}:{service}", []) for what in ("reply", "error"))
        return PeerProxy(lambda payload: self._ask("call", service, payload.hex() or "-"), replies, errors)

    def act(self, *words: object) -> None:
        """Give a command to an ``actionlib`` peer."""
        self._ask(*words)

    def told(self, what: str) -> list[str]:
        """Return the list of texts that an ``actionlib`` peer's messages have filled so far."""
        return [text.decode() for text in self._got.get(what, [])]

    def matched(self, topic: str) -> int:
        """Return how many peers the program counts on a topic."""
        return int(self._ask("matched", topic).split()[2])

    def stop(self) -> None:
        """Stop it."""
        self._process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Let it go on."""
        self._process.send_signal(signal.SIGCONT)

    def kill(self) -> None:
        """End it without letting it say goodbye."""
        if self._process.stdin is not None and not self._process.stdin.closed:
            self._process.kill()
            self._process.wait()
            self._reader.join()
            self._process.stdin.close()
            assert self._process.stdout is not None
            self._process.stdout.close()

    def close(self) -> None:
        """Let it end by itself; harmless if it has ended."""
        assert self._process.stdin is not None
        if self._process.stdin.closed:
            return
        self._process.stdin.close()
        self._process.wait()
        self._reader.join()
        assert self._process.stdout is not None
        self._process.stdout.close()


class PeerProxy(NamedTuple):
    """What a peer calls through, and what came of its calls."""

    call: Callable[[bytes], object]
    replies: list[bytes]
    errors: list[bytes]


class PeerInbox:
    """What a peer has received."""

    def __init__(self, got: list[bytes]) -> None:
        self._got = got

    def since(self, number: int) -> list[tuple[bytes, int]]:
        """Return the messages from the given one on; ROS 1 has no stamps."""
        return [(payload, 0) for payload in self._got[number:]]

    def payloads(self) -> list[bytes]:
        """Return all messages."""
        return list(self._got)


class PeerOutbox:
    """What a peer sends through."""

    def __init__(self, send: Callable[[bytes], object]) -> None:
        self._send = send

    def write(self, payload: bytes) -> None:
        """Send one message."""
        self._send(payload)


def build(*defines: str) -> Path:
    """Compile the roscpp peer, once per content."""
    source = HERE / "peers" / "roscpp_peer.cpp"
    digest = hashlib.sha256(source.read_bytes() + repr(defines).encode()).hexdigest()[:16]
    program = _CACHE / f"roscpp-{digest}"
    _CACHE.mkdir(parents=True, exist_ok=True)
    with (_CACHE / "roscpp.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not program.exists():
            partial = program.with_suffix(".partial")
            command = ["g++", "-std=c++17", "-O1", *(f"-D{each}" for each in defines), str(source)]
            done = subprocess.run(
                [*command, "-o", str(partial), *LIBRARIES],
                capture_output=True,
                text=True,
                check=False,
            )
            assert done.returncode == 0, done.stderr
            partial.rename(program)
    return program
