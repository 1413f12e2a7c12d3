"""A node in a process of its own: to be killed, or because a middleware allows one per process.

The child is forked from a server that has imported everything (multiprocessing's forkserver), so
that a start takes milliseconds. Requests and answers go over a pipe, one at a time.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from rosplc.ros import BACKENDS, EndpointStatus, GraphInfo, Qos
from tests.conformance.backends.node import Calling, Inbox, Node, Opening, Outbox, Served

_context = multiprocessing.get_context("forkserver")


def _preload(backend: str) -> list[str]:
    """Return what the server should have imported: our own modules, and those of the middleware."""
    return [__name__, BACKENDS[backend]] if backend in BACKENDS else [__name__]


@dataclass(frozen=True)
class _Handle:
    """An endpoint of the other process, as an argument."""

    number: int


class RemoteInbox:
    """An :class:`Inbox` in another process."""

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call
        self._got: list[tuple[bytes, int]] = []

    def since(self, number: int) -> list[tuple[bytes, int]]:
        """See :meth:`Inbox.since`."""
        self._got += self._call("since", len(self._got))
        return self._got[number:]

    def count(self) -> int:
        """See :meth:`Inbox.count`."""
        count: int = self._call("count")
        return count

    def late(self) -> int:
        """See :meth:`Inbox.late`."""
        late: int = self._call("late")
        return late

    def release(self) -> None:
        """See :meth:`Inbox.release`."""
        self._call("release")

    def topic(self) -> str:
        """See :meth:`Inbox.topic`."""
        return str(self._call("topic"))

    def matched(self) -> int:
        """See :meth:`Inbox.matched`."""
        return int(self._call("matched"))

    def status(self) -> EndpointStatus:
        """See :meth:`Inbox.status`."""
        status: EndpointStatus = self._call("status")
        return status

    def close(self) -> None:
        """See :meth:`Inbox.close`."""
        self._call("close")


class RemoteOutbox:
    """An :class:`Outbox` in another process."""

    def __init__(self, call: Callable[..., Any], handle: int) -> None:
        self._call = call
        self.handle = handle

    def write(self, payload: bytes, stamp_ns: int | None = None) -> bool:
        """See :meth:`Outbox.write`."""
        return bool(self._call("write", payload, stamp_ns))

    def write_all(self, payloads: list[bytes], pause: float = 0.0) -> int:
        """See :meth:`Outbox.write_all`."""
        return int(self._call("write_all", payloads, pause))

    def topic(self) -> str:
        """See :meth:`Outbox.topic`."""
        return str(self._call("topic"))

    def matched(self) -> int:
        """See :meth:`Outbox.matched`."""
        return int(self._call("matched"))

    def status(self) -> EndpointStatus:
        """See :meth:`Outbox.status`."""
        status: EndpointStatus = self._call("status")
        return status

    def close(self) -> None:
        """See :meth:`Outbox.close`."""
        self._call("close")


class RemoteEnd:
    """A :class:`Served` or :class:`Calling` in another process."""

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return partial(self._call, name)


class RemoteNode:
    """A :class:`Node` in another process; its methods do what those of a node here do.

    Args:
        opening: What to open.
        make: The class of the node, for backends whose nodes need more; it takes an opening.
    """

    def __init__(self, opening: Opening, make: Callable[[Opening], Any] = Node) -> None:
        _context.set_forkserver_preload(_preload(opening.backend))
        self._pipe, theirs = _context.Pipe()
        self._lock = threading.Lock()
        self._process = _context.Process(
            target=_serve, args=(theirs, opening, make), name=opening.node_name, daemon=True
        )
        self._process.start()
        theirs.close()
        try:
            self._answer()
        except BaseException:
            self.end()
            raise

    def _answer(self) -> Any:
        try:
            good, value = self._pipe.recv()
        except EOFError:
            self._process.join()
            raise RuntimeError(
                f"the process of {self._process.name} ended with {self._process.exitcode}"
            ) from None
        if not good:
            raise value
        return value

    def call(self, handle: int, method: str, *arguments: Any) -> Any:
        """Call a method in the other process; 0 is the node, other numbers are its endpoints."""
        with self._lock:
            self._pipe.send((handle, method, arguments))
            return self._answer()

    def name(self) -> str:
        """See :meth:`Node.name`."""
        return str(self.call(0, "name"))

    def capabilities(self) -> frozenset[str]:
        """See :meth:`Node.capabilities`."""
        found: frozenset[str] = self.call(0, "capabilities")
        return found

    def subscribe(
        self, topic: str, type_name: str, qos: Qos | None = None, receiver: str = "collect"
    ) -> RemoteInbox:
        """See :meth:`Node.subscribe`."""
        handle = self.call(0, "subscribe", topic, type_name, qos, receiver)
        return RemoteInbox(lambda *arguments: self.call(handle, *arguments))

    def advertise(self, topic: str, type_name: str, qos: Qos | None = None) -> RemoteOutbox:
        """See :meth:`Node.advertise`."""
        handle = self.call(0, "advertise", topic, type_name, qos)
        return RemoteOutbox(lambda *arguments: self.call(handle, *arguments), handle)

    def serve(self, service: str, type_name: str, receiver: str = "echo") -> RemoteEnd:
        """See :meth:`Node.serve`."""
        return RemoteEnd(partial(self.call, self.call(0, "serve", service, type_name, receiver)))

    def client(self, service: str, type_name: str) -> RemoteEnd:
        """See :meth:`Node.client`."""
        return RemoteEnd(partial(self.call, self.call(0, "client", service, type_name)))

    def status(self) -> tuple[EndpointStatus, ...]:
        """See :meth:`Node.status`."""
        found: tuple[EndpointStatus, ...] = self.call(0, "status")
        return found

    def graph(self) -> GraphInfo:
        """See :meth:`Node.graph`."""
        found: GraphInfo = self.call(0, "graph")
        return found

    def start_traffic(self, topic: str, type_name: str) -> None:
        """See :meth:`Node.start_traffic`."""
        self.call(0, "start_traffic", topic, type_name)

    def stop_traffic(self) -> list[str]:
        """See :meth:`Node.stop_traffic`."""
        found: list[str] = self.call(0, "stop_traffic")
        return found

    def write_from_threads(self, outboxes: Sequence[Any], parts: Sequence[list[bytes]]) -> None:
        """See :meth:`Node.write_from_threads`."""
        self.call(0, "write_from_threads", [_Handle(outbox.handle) for outbox in outboxes], parts)

    def held(self) -> tuple[int, int]:
        """See :meth:`Node.held`."""
        found: tuple[int, int] = self.call(0, "held")
        return found

    def close(self) -> None:
        """Leave the graph; the process stays, and still answers."""
        if self._process.is_alive():
            self.call(0, "close")

    def leave(self) -> int | None:
        """Let the process end by itself; return its exit code (0 if nothing kept it)."""
        if self._process.is_alive():
            self.call(0, "close")
            self._pipe.send(None)
        self._process.join()
        return self._process.exitcode

    def kill(self) -> None:
        """End the process without letting it say goodbye."""
        self._process.kill()
        self._process.join()

    def stop(self) -> None:
        """Stop the process."""
        assert self._process.pid is not None
        os.kill(self._process.pid, signal.SIGSTOP)

    def resume(self) -> None:
        """Let it go on."""
        assert self._process.pid is not None
        os.kill(self._process.pid, signal.SIGCONT)

    def end(self) -> None:
        """Make sure that the process is no more."""
        self.kill()
        self._pipe.close()


def _serve(pipe: Connection, opening: Opening, make: Callable[[Opening], Any]) -> None:
    for module in _preload(opening.backend)[1:]:
        importlib.import_module(module)
    try:
        objects: list[Any] = [make(opening)]
    except BaseException as error:
        pipe.send((False, error))
        return
    pipe.send((True, None))
    while (request := pipe.recv()) is not None:
        handle, method, arguments = request
        arguments = [_resolve(argument, objects) for argument in arguments]
        try:
            value = getattr(objects[handle], method)(*arguments)
        except BaseException as error:
            pipe.send((False, error))
            continue
        if isinstance(value, Inbox | Outbox | Served | Calling):
            objects.append(value)
            value = len(objects) - 1
        pipe.send((True, value))


def _resolve(argument: Any, objects: list[Any]) -> Any:
    if isinstance(argument, list):
        return [_resolve(one, objects) for one in argument]
    return objects[argument.number] if isinstance(argument, _Handle) else argument
