"""Fixtures of the interop tests: foreign peers as processes, and a ROS domain for each test."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.interop.graphs import LOCAL, Graph, free_domain
from tests.interop.peers.build import KINDS, NEEDS, build

# Unicast on this machine, for Cyclone; the Fast DDS peer sets the same itself.
_CYCLONE = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    '<Peers><Peer Address="localhost"/></Peers></Discovery></Domain></CycloneDDS>'
)


class Peer:
    """A running peer program; ``lines`` are what it has said so far."""

    def __init__(self, program: Path, *arguments: object) -> None:
        self._process = subprocess.Popen(
            [program, *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **LOCAL, "CYCLONEDDS_URI": _CYCLONE},
        )
        self.lines: list[str] = []
        self._news: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._news.put(line.rstrip("\n"))
        self._news.put(None)

    def wait(self, condition: Callable[[list[str]], object]) -> list[str]:
        """Return all lines as soon as the condition holds for them; pytest's timeout is the watchdog."""
        while not condition(self.lines):
            line = self._news.get()
            assert line is not None, f"the peer ended after {self.lines}"
            self.lines.append(line)
        return self.lines

    def messages(self, count: int) -> list[str]:
        """Return the first ``count`` messages, without the word before them."""
        lines = self.wait(lambda lines: sum(line.startswith("message") for line in lines) >= count)
        return [line.removeprefix("message ") for line in lines if line.startswith("message")]

    def messages_until(self, last: str) -> list[str]:
        """Return the messages up to ``last``."""
        lines = self.wait(lambda lines: f"message {last}" in lines)
        return [line.removeprefix("message ") for line in lines if line.startswith("message")]

    def poll(self) -> None:
        """Take in what the program says within the next moment, if anything."""
        with contextlib.suppress(queue.Empty):
            if (line := self._news.get(timeout=0.02)) is not None:
                self.lines.append(line)

    def stop(self) -> None:
        """Stop the program."""
        self._process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Let the program go on."""
        self._process.send_signal(signal.SIGCONT)

    def kill(self) -> None:
        """End the program without letting it say goodbye."""
        self._process.kill()

    def close(self) -> None:
        """Let the program end by itself."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()
        self._reader.join()
        assert self._process.stdout is not None
        self._process.stdout.close()


@pytest.fixture
def graph() -> Iterator[Graph]:
    """Backends on DDS in a domain of their own."""
    pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    with free_domain() as domain:
        graph = Graph("dds", domain)
        yield graph
        graph.close()


StartPeer = Callable[..., Peer]


def _marked(kind: str) -> object:
    return pytest.param(kind, marks=pytest.mark.needs(*NEEDS[kind.partition("-")[0]]))


@pytest.fixture(params=map(_marked, KINDS))
def peer(request: pytest.FixtureRequest, graph: Graph) -> Iterator[StartPeer]:
    """Start peers in the graph's domain: ``peer("sub", "String", "rt/chatter", …)``."""
    running: list[Peer] = []

    def start(
        role: str,
        kind: str = "",
        topic: str = "",
        reliability: str = "reliable",
        durability: str = "volatile",
        depth: int = 1000,
        count: int = 10,
        user_data: str = "",
        defines: tuple[str, ...] = (),
    ) -> Peer:
        # Cyclone 0.10 crashes when it looks up a type with bounded strings that was built by a newer
        # release. ROS's own layers on it announce no type information, so neither does this peer.
        untyped = request.param == "cyclone" and kind == "Nodes"
        program = build("cyclone-untyped" if untyped else request.param, *defines)
        settings: list[object] = []
        if role != "discover":
            settings = [kind, topic, reliability, durability, depth, count]
            if user_data:
                settings.append(user_data)
        running.append(Peer(program, graph.domain, role, *settings))
        running[-1].wait(lambda lines: "ready" in lines)
        return running[-1]

    start.kind = request.param  # type: ignore[attr-defined]
    yield start
    for one in running:
        one.close()
