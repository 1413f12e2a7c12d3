"""Fixtures for tests with real rclpy processes on rmw_fastrtps."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rosplc.model import TypeStore
from rosplc.ros import Backend, open_backend
from tests.interop.graphs import LOCAL, free_domain
from tests.lib.waiting import wait_for


def end(process: subprocess.Popen[str]) -> None:
    """Wait until a process whose input is closed has ended; one that hangs is killed, and fails the test."""
    try:
        process.wait(timeout=60)
    finally:
        process.kill()


class Peer:
    """A process of ``peer.py``; ``heard`` maps a topic to what it has received, each as printed."""

    def __init__(self, domain: int, name: str = "peer") -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("peer.py")), str(domain), name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **LOCAL},
        )
        self.heard: dict[str, list[dict[str, Any]]] = {}
        self._ready: set[str] = set()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            words = json.loads(line)
            if "ready" in words:
                self._ready.add(words["ready"])
            else:
                self.heard[words["heard"]].append(words)

    def tell(self, **order: object) -> None:
        """Send one line."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()

    def _wait_until_ready(self, topic: str) -> None:
        wait_for(lambda: topic in self._ready or self.process.poll() is not None, f"{topic} of the peer")
        assert self.process.poll() is None, "the peer has ended"

    def subscribe(self, topic: str, type_name: str, **qos: object) -> list[dict[str, Any]]:
        """Receive a topic; return the list that fills."""
        self.heard[topic] = []
        self.tell(subscribe=topic, type=type_name, **qos)
        self._wait_until_ready(topic)
        return self.heard[topic]

    def advertise(self, topic: str, type_name: str, **qos: object) -> None:
        """Send a topic."""
        self.tell(advertise=topic, type=type_name, **qos)
        self._wait_until_ready(topic)

    def serve(self, service: str, type_name: str) -> None:
        """Serve a service; its requests are heard on ``request:SERVICE``."""
        self.heard[f"request:{service}"] = []
        self.tell(serve=service, type=type_name)
        self._wait_until_ready(service)

    def proxy(self, service: str, type_name: str) -> None:
        """Get ready to call a service; responses are heard on ``response:SERVICE``."""
        self.heard[f"response:{service}"] = []
        self.tell(proxy=service, type=type_name)
        self._wait_until_ready(service)

    def call(self, service: str, payload: bytes, *, wait: bool = True) -> None:
        """Call a service as soon as it has a server, or at once."""
        self.tell(call=service, payload=base64.b64encode(payload).decode(), wait=wait)

    def counts(self, service: str) -> tuple[int, int, bool]:
        """Return how many readers and writers a client sees, and whether it finds a server."""
        found = self.heard.setdefault(f"ends:{service}", [])
        before = len(found)
        self.tell(ends=service)
        wait_for(lambda: len(found) > before)
        return tuple(found[-1]["counts"])

    def echo(self, topic: str, to: str, type_name: str) -> None:
        """Send whatever comes on one topic on another one: an object of rclpy's between the two."""
        self.tell(echo=topic, to=to, type=type_name)
        self._wait_until_ready(topic)

    def publish(self, topic: str, payload: bytes) -> None:
        """Send one message, given as it is serialized, as soon as there is a subscriber."""
        self.tell(publish=topic, payload=base64.b64encode(payload).decode())

    def payloads(self, topic: str) -> list[bytes]:
        """Return what was received on a topic, as rmw serializes it."""
        return [base64.b64decode(words["payload"]) for words in self.heard[topic]]

    def close(self) -> None:
        """Let it leave the graph by itself."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        end(self.process)
        self._reader.join()


@pytest.fixture
def domain() -> Iterator[int]:
    """Give a ROS domain of the test's own."""
    with free_domain() as number:
        yield number


@pytest.fixture
def peer(domain: int) -> Iterator[Peer]:
    """Give a process on rclpy in the domain."""
    started = Peer(domain)
    yield started
    started.close()


@pytest.fixture(params=["dds", "rclpy"])
def node(request: pytest.FixtureRequest, domain: int) -> Iterator[Backend]:
    """Give rosplc's side, over each of the backends that speak DDS."""
    store = TypeStore.bundled("kilted")
    backend = open_backend(request.param, store, "cell", domain=domain, environment=LOCAL)
    yield backend
    backend.close()
