"""zenoh-ros2-sdk as a peer: an implementation of rmw_zenoh's protocol by another project."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from rosplc.ros import Qos
from tests.interop.graphs import STRING, string
from tests.lib.waiting import wait_for

__all__ = ["TRANSIENT_LOCAL", "SdkInbox", "SdkOutbox", "SdkPeer"]

TRANSIENT_LOCAL = ":1:,10:,:,:,,"
"""The SDK's settings, as its tokens have them: reliable, transient_local, the last ten."""

_STRING_DEFINITION = "string data\n"
ADD = "diagnostic_msgs/srv/AddDiagnostics"
_ADD_DEFINITIONS = ["string load_namespace\n", "bool success\nstring message\n"]


class SdkInbox:
    """What an SDK subscriber has heard: each message as its fields."""

    def __init__(self) -> None:
        self.messages: list[dict[str, Any]] = []

    def since(self, number: int) -> list[tuple[bytes, int]]:
        """Return messages of ``std_msgs/msg/String`` as bytes, without stamps."""
        return [(string(fields["data"]), 0) for fields in self.messages[number:]]


class SdkOutbox:
    """An SDK publisher."""

    def __init__(self, peer: SdkPeer, topic: str) -> None:
        self._peer = peer
        self._topic = topic

    def publish(self, *messages: dict[str, Any], wait: bool = True) -> None:
        """Send messages, each given as its fields; first wait for a subscriber, unless told not to."""
        self._peer.tell(publish=self._topic, messages=messages, wait=wait)

    def write(self, payload: bytes) -> None:
        """Send one ``std_msgs/msg/String``."""
        length = int.from_bytes(payload[4:8], "little")
        self.publish({"data": payload[8 : 8 + length - 1].decode()})


class SdkPeer:
    """A process on the SDK.

    Args:
        port: The router's port on 127.0.0.1.
        domain: The ROS domain.
    """

    def __init__(self, port: int, domain: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("sdk_peer.py")), str(port), str(domain)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            # Whoever is killed would leave a segment of the library's in /dev/shm.
            env={**os.environ, "ZENOH_CONFIG_OVERRIDE": "transport/shared_memory/enabled=false"},
        )
        self._ready: set[str] = set()
        self._inboxes: dict[str, SdkInbox] = {}
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("{"):
                words = json.loads(line)
                if "ready" in words:
                    self._ready.add(words["ready"])
                else:
                    self._inboxes[words["heard"]].messages.append(words["message"])

    def tell(self, **order: object) -> None:
        """Send one line."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()

    def _open(self, what: str, topic: str, kind: str, definition: str, qos: Qos | str) -> None:
        encoded = qos if isinstance(qos, str) else ""
        self.tell(**{what: topic, "type": kind, "definition": definition, "qos": encoded})

    def _until_ready(self, topic: str) -> None:
        wait_for(lambda: topic in self._ready or self._process.poll() is not None)
        assert self._process.poll() is None, "the SDK's process ended"

    def subscribe(
        self,
        topic: str,
        kind: str = STRING,
        qos: Qos | str = "",
        definition: str = _STRING_DEFINITION,
        *,
        wait: bool = True,
    ) -> SdkInbox:
        """Receive a topic; without ``wait`` return before it is done."""
        inbox = self._inboxes[topic] = SdkInbox()
        self._open("subscribe", topic, kind, definition, qos)
        if wait:
            self._until_ready(topic)
        return inbox

    def advertise(
        self, topic: str, kind: str = STRING, qos: Qos | str = "", definition: str = _STRING_DEFINITION
    ) -> SdkOutbox:
        """Send a topic."""
        self._open("advertise", topic, kind, definition, qos)
        self._until_ready(topic)
        return SdkOutbox(self, topic)

    def serve(self, service: str) -> SdkInbox:
        """Serve ``diagnostic_msgs/srv/AddDiagnostics``; return what it is asked."""
        inbox = self._inboxes[service] = SdkInbox()
        self.tell(serve=service, type=ADD, definitions=_ADD_DEFINITIONS)
        self._until_ready(service)
        return inbox

    def call(self, service: str, text: str) -> SdkInbox:
        """Call ``diagnostic_msgs/srv/AddDiagnostics``; return what is answered."""
        return self.ask(service, ADD, _ADD_DEFINITIONS, {"load_namespace": text})

    def ask(
        self, service: str, kind: str, definitions: list[str], fields: dict[str, Any], **more: Any
    ) -> SdkInbox:
        """Call a service; ``more`` may be its type's ``hash``, and the types of ``nested`` fields."""
        inbox = self._inboxes.setdefault(service, SdkInbox())
        self.tell(call=service, type=kind, definitions=definitions, fields=fields, **more)
        return inbox

    def kill(self) -> None:
        """End it without a goodbye."""
        self._process.kill()
        self.close()

    def close(self) -> None:
        """Let it leave the graph by itself."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(20)
        self._process.kill()
        self._process.wait()
        self._reader.join()

    def __enter__(self) -> SdkPeer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
