"""One node on a backend as the suite drives it: receivers by name, so that they can live elsewhere.

What a callback does is chosen by a word (:data:`RECEIVERS`) and not handed over as a function.
Thus the same test drives a node in its own process and one in a child process.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

from rosplc.model import TypeStore
from rosplc.ros import SERVICES, EndpointStatus, GraphInfo, Qos, Reply, open_backend

RECEIVERS = {
    "collect": "keeps the message",
    "gate": "keeps it, then waits until `release` is called, once and for all",
    "slow": "takes a millisecond for each",
    "fail": "keeps it, then raises an exception",
    "close": "keeps it, then closes its own subscription",
    "leave": "keeps it, then closes the whole backend",
}
"""What a subscription does with a message."""


@dataclass(frozen=True)
class Opening:
    """Everything that it takes to open a node, here or in a child process.

    Attributes:
        backend: The backend's name.
        node_name: The node's base name.
        distro: The ROS distribution.
        namespace: The node's namespace.
        domain: The ROS domain, where the backend has such a thing.
        remap: Topic → topic.
        environment: The environment of ROS.
        options: The backend's own keys of the configuration.
        definitions: Type name → definition text, added to the distribution's types.
    """

    backend: str
    node_name: str
    distro: str = "jazzy"
    namespace: str = "/"
    domain: int | None = None
    remap: Mapping[str, str] = field(default_factory=dict)
    environment: Mapping[str, str] = field(default_factory=dict)
    options: Mapping[str, object] = field(default_factory=dict)
    definitions: Mapping[str, str] = field(default_factory=dict)


class Inbox:
    """A subscription, and what came of it."""

    def __init__(self, node: Node, topic: str, type_name: str, qos: Qos, receiver: str) -> None:
        if receiver not in RECEIVERS:
            raise ValueError(f"no receiver {receiver!r}")
        self._node = node
        self._receiver = receiver
        self._got: list[tuple[bytes, int]] = []
        self._open = threading.Event()
        self._closed = False
        self._late = 0
        self._ready = threading.Event()  # the first message may come before `subscribe` has returned
        self._subscription = node.backend.subscribe(topic, type_name, qos, self._receive)
        self._ready.set()

    def _receive(self, payload: bytes, stamp_ns: int) -> None:
        if self._closed:
            self._late += 1
        self._got.append((payload, stamp_ns))
        if self._receiver == "gate":
            self._open.wait()
        elif self._receiver == "slow":
            time.sleep(0.001)
        elif self._receiver == "fail":
            raise RuntimeError("broken receiver")
        elif self._receiver == "close":
            self._ready.wait()
            self._subscription.close()
        elif self._receiver == "leave":
            self._ready.wait()
            self._node.backend.close()
        if self._closed:
            self._late += 1

    def since(self, number: int) -> list[tuple[bytes, int]]:
        """Return the messages from the given one on, each with its stamp."""
        return self._got[number:]

    def count(self) -> int:
        """Return how many messages have come."""
        return len(self._got)

    def late(self) -> int:
        """Return how many callbacks started or ended after ``close`` had returned."""
        return self._late

    def release(self) -> None:
        """Let a receiver of kind ``gate`` go on."""
        self._open.set()

    def topic(self) -> str:
        """Return the topic's full name."""
        return self._subscription.topic

    def matched(self) -> int:
        """Return how many publishers there are."""
        return self._subscription.matched

    def status(self) -> EndpointStatus:
        """Return the endpoint's status."""
        return self._subscription.status()

    def close(self) -> None:
        """Close the subscription."""
        self._subscription.close()
        self._closed = True


class Outbox:
    """A publisher."""

    def __init__(self, node: Node, topic: str, type_name: str, qos: Qos) -> None:
        self.publisher = node.backend.advertise(topic, type_name, qos)

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """Send one message."""
        return self.publisher.write(payload, stamp_ns)

    def write_all(self, payloads: list[bytes], pause: float = 0.0) -> int:
        """Send many messages, ``pause`` seconds apart; return how many the backend took."""
        taken = 0
        for payload in payloads:
            taken += self.publisher.write(payload)
            if pause:
                time.sleep(pause)
        return taken

    def topic(self) -> str:
        """Return the topic's full name."""
        return self.publisher.topic

    def matched(self) -> int:
        """Return how many subscribers there are."""
        return self.publisher.matched

    def status(self) -> EndpointStatus:
        """Return the endpoint's status."""
        return self.publisher.status()

    def close(self) -> None:
        """Close the publisher."""
        self.publisher.close()


def echo(request: bytes, ros1: bool) -> bytes:
    """Return the response of ``diagnostic_msgs/srv/AddDiagnostics`` with TRUE and the request's text."""
    return b"\1" + request if ros1 else request[:4] + b"\1\0\0\0" + request[4:]


class Served:
    """A server, and what it was asked.

    With the receiver ``echo`` it answers at once, with ``fail`` it raises, with ``close`` it closes itself;
    otherwise requests are kept until the test answers them.
    """

    def __init__(self, node: Node, service: str, type_name: str, receiver: str) -> None:
        self._node, self._receiver = node, receiver
        self._got: list[tuple[bytes, bytes, int]] = []
        self._ready = threading.Event()
        self._server = node.backend.serve(service, type_name, SERVICES, self._receive)
        self._ready.set()

    def _receive(self, payload: bytes, caller: bytes, stamp_ns: int) -> None:
        self._got.append((payload, caller, stamp_ns))
        self._ready.wait()
        if self._receiver == "echo":
            self._server.reply(caller, echo(payload, self._node.ros1))
        elif self._receiver == "fail":
            raise RuntimeError("broken receiver")
        elif self._receiver == "close":
            self._server.close()

    def requests(self) -> list[tuple[bytes, bytes, int]]:
        """Return what has been asked: payload, caller and stamp."""
        return list(self._got)

    def reply(self, caller: bytes, payload: bytes) -> bool:
        """Answer."""
        return self._server.reply(caller, payload)

    def refuse(self, caller: bytes, text: str = "no") -> bool:
        """Do not answer."""
        return self._server.refuse(caller, text)

    def present(self, caller: bytes) -> bool:
        """Return whether a caller still waits."""
        return self._server.present(caller)

    def remembers(self) -> bool:
        """Return whether another process can answer."""
        return self._server.remembers

    def name(self) -> str:
        """Return the service's full name."""
        return self._server.topic

    def matched(self) -> int:
        """Return how many clients there are."""
        return self._server.matched

    def status(self) -> EndpointStatus:
        """Return the endpoint's status."""
        return self._server.status()

    def close(self) -> None:
        """Close the server."""
        self._server.close()


class Calling:
    """A client, and the ends of its calls."""

    def __init__(self, node: Node, service: str, type_name: str) -> None:
        self._replies: list[tuple[int, Reply]] = []
        self._numbers: list[int] = []
        self.client = node.backend.client(service, type_name, SERVICES)

    def call(self, payload: bytes) -> int:
        """Call; return the call's place."""
        place = len(self._numbers)
        self._numbers.append(0)
        self._numbers[place] = self.client.call(payload, lambda reply: self._replies.append((place, reply)))
        return place

    def call_and_close(self, payload: bytes) -> None:
        """Call, and close the client when the reply comes."""

        def receive(reply: Reply) -> None:
            self.client.close()
            self._replies.append((0, reply))

        self.client.call(payload, receive)

    def call_all(self, payloads: Sequence[bytes]) -> None:
        """Call many times."""
        for payload in payloads:
            self.call(payload)

    def replies(self) -> list[tuple[int, Reply]]:
        """Return the ends of calls so far, each with its call's place."""
        return list(self._replies)

    def forget(self, place: int) -> None:
        """Wait no longer for a call."""
        self.client.forget(self._numbers[place])

    def ready(self) -> bool:
        """Return whether there is a server."""
        return self.client.ready

    def name(self) -> str:
        """Return the service's full name."""
        return self.client.topic

    def status(self) -> EndpointStatus:
        """Return the endpoint's status."""
        return self.client.status()

    def close(self) -> None:
        """Close the client."""
        self.client.close()


class Node:
    """A backend that has joined a graph."""

    def __init__(self, opening: Opening) -> None:
        store = TypeStore.bundled(opening.distro)
        for name, text in opening.definitions.items():
            store = store.with_definition(name, text)
        self.backend = open_backend(
            opening.backend,
            store,
            opening.node_name,
            opening.namespace,
            opening.domain,
            remap=opening.remap,
            environment=opening.environment,
            options=opening.options,
        )
        self.ros1 = opening.distro == "noetic"
        self._traffic: Traffic | None = None
        self._inboxes: list[Inbox] = []

    def name(self) -> str:
        """Return the backend's name."""
        return self.backend.name

    def capabilities(self) -> frozenset[str]:
        """Return what the backend can carry."""
        return self.backend.capabilities

    def subscribe(
        self, topic: str, type_name: str, qos: Qos | None = None, receiver: str = "collect"
    ) -> Inbox:
        """Receive a topic."""
        inbox = Inbox(self, topic, type_name, qos or Qos(), receiver)
        self._inboxes.append(inbox)
        return inbox

    def advertise(self, topic: str, type_name: str, qos: Qos | None = None) -> Outbox:
        """Send a topic."""
        return Outbox(self, topic, type_name, qos or Qos())

    def serve(self, service: str, type_name: str, receiver: str = "echo") -> Served:
        """Serve a service."""
        return Served(self, service, type_name, receiver)

    def client(self, service: str, type_name: str) -> Calling:
        """Call a service."""
        return Calling(self, service, type_name)

    def status(self) -> tuple[EndpointStatus, ...]:
        """Return the status of all endpoints."""
        return self.backend.status()

    def graph(self) -> GraphInfo:
        """Return what is seen of the others."""
        return self.backend.graph()

    def close(self) -> None:
        """Leave the graph."""
        self.backend.close()

    def end(self) -> None:
        """Leave the graph after a test, whatever state it left things in."""
        for inbox in self._inboxes:
            inbox.release()
        self.close()

    def start_traffic(self, topic: str, type_name: str) -> None:
        """Begin to open, close and ask from several threads (:class:`Traffic`)."""
        self._traffic = Traffic(self, topic, type_name)

    def stop_traffic(self) -> list[str]:
        """End that; return the exceptions that there were, as text."""
        assert self._traffic is not None
        return self._traffic.stop()

    def write_from_threads(self, outboxes: Sequence[Any], parts: Sequence[list[bytes]]) -> None:
        """Send each part, in order, on every outbox, all parts at once from threads of their own."""

        def write(payloads: list[bytes]) -> None:
            for payload in payloads:
                for outbox in outboxes:
                    outbox.write(payload)

        with ThreadPoolExecutor(len(parts)) as pool:
            list(pool.map(write, parts))

    def held(self) -> tuple[int, int]:
        """Return how many threads and file descriptors this process has."""
        return len(os.listdir("/proc/self/task")), len(os.listdir("/proc/self/fd"))


class Traffic:
    """Threads that open, close and ask on one node until they are told to stop."""

    def __init__(self, node: Node, topic: str, type_name: str) -> None:
        self._node = node
        self._topic, self._type = topic, type_name
        self._done = threading.Event()
        self._failures: list[str] = []
        work = (self._come_and_go, self._come_and_go, self._ask)
        self._threads = [threading.Thread(target=self._guarded, args=(one,)) for one in work]
        for thread in self._threads:
            thread.start()

    def _guarded(self, work: Any) -> None:
        try:
            while not self._done.is_set():
                work()
        except BaseException as error:
            self._failures.append(repr(error))

    def _come_and_go(self) -> None:
        publisher = self._node.backend.advertise(self._topic, self._type, Qos())
        subscription = self._node.backend.subscribe(self._topic, self._type, Qos(), lambda *_: None)
        publisher.close()
        subscription.close()

    def _ask(self) -> None:
        self._node.backend.status()
        self._node.backend.graph()
        time.sleep(0.001)

    def stop(self) -> list[str]:
        self._done.set()
        for thread in self._threads:
            thread.join()
        return self._failures
