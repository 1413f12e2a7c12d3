"""Services between the rclpy backend and processes of a real rclpy, both ways, with kills of either side."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from rosplc.model import TypeStore
from rosplc.reasons import Reason
from rosplc.ros import SERVICES, Backend, Reply, open_backend
from tests.interop.graphs import LOCAL
from tests.interop.ros2.conftest import Peer
from tests.lib.waiting import WATCHDOG_S, wait_for
from tests.unit.ros.test_rclpy_services import NO, SET_BOOL, YES, Requests, response

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(120), pytest.mark.verifies("rclpy-calls", real="rclpy")]


@pytest.fixture
def cell(domain: int) -> Iterator[Backend]:
    backend = open_backend("rclpy", TypeStore.bundled("kilted"), "cell", domain=domain, environment=LOCAL)
    yield backend
    backend.close()


def heard(peer: Peer, topic: str) -> list[bytes]:
    """Return the first byte of the body of each message that a peer has heard, and its header."""
    return [payload[:5] for payload in peer.payloads(topic)]


def test_a_process_calls(cell: Backend, peer: Peer) -> None:
    """Requests of a real client wait together; each is answered later, in any order."""
    requests = Requests()
    server = cell.serve("/start", SET_BOOL, SERVICES, requests)
    peer.proxy("/start", SET_BOOL)
    for number in range(10):
        peer.call("/start", YES if number % 2 else NO)
    wait_for(lambda: len(requests.open) == 10)
    assert server.matched == 1
    for payload, caller, _ in reversed(requests.open):
        assert server.reply(caller, response(payload[4] == 1, "done"))
    wait_for(lambda: len(peer.heard["response:/start"]) == 10)
    assert heard(peer, "response:/start") == [response(number % 2 == 0, "")[:5] for number in range(10)]


def test_a_process_is_called(cell: Backend, peer: Peer) -> None:
    """A real server answers calls of several threads at once; each gets one response."""
    peer.serve("/empty", "std_srvs/srv/Empty")
    client = cell.client("/empty", "std_srvs/srv/Empty", SERVICES)
    wait_for(lambda: client.ready)
    replies: list[Reply] = []

    def call() -> None:  # services_default keeps ten requests: so many open calls lose none
        for _ in range(50):
            ended: queue.SimpleQueue[Reply] = queue.SimpleQueue()
            client.call(b"\0\1\0\0\0\0\0\0", ended.put)
            replies.append(ended.get(timeout=WATCHDOG_S))

    threads = [threading.Thread(target=call) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    wait_for(lambda: len(replies) == 200)
    assert all(reply.payload is not None for reply in replies)
    assert len(peer.heard["request:/empty"]) == 200


def test_a_server_that_is_killed(cell: Backend, domain: int) -> None:
    """The open call's fate is unknown, the next is not executed; a successor is found."""
    peer = Peer(domain)
    peer.serve("/empty", "std_srvs/srv/Empty")
    client: Any = cell.client("/empty", "std_srvs/srv/Empty", SERVICES)
    wait_for(lambda: client.ready)
    replies: list[Reply] = []
    peer.process.send_signal(19)  # SIGSTOP: the call stays open
    client.call(b"\0\1\0\0\0\0\0\0", replies.append)
    peer.process.kill()
    wait_for(lambda: replies)
    assert (replies[0].outcome, replies[0].reason) == ("fate unknown", Reason.SERVER_GONE)
    client.call(b"\0\1\0\0\0\0\0\0", replies.append)
    assert (replies[1].outcome, replies[1].reason) == ("not executed", Reason.NO_SERVER)
    peer.close()
    peer = Peer(domain, "successor")
    peer.serve("/empty", "std_srvs/srv/Empty")
    wait_for(lambda: client.ready)
    client.call(b"\0\1\0\0\0\0\0\0", replies.append)
    wait_for(lambda: len(replies) == 3)
    assert replies[2].payload is not None
    peer.close()


def test_a_caller_that_is_killed(cell: Backend, domain: int) -> None:
    """Its answer goes nowhere, and the next caller is served."""
    requests = Requests()
    server = cell.serve("/start", SET_BOOL, SERVICES, requests)
    peer = Peer(domain)
    peer.proxy("/start", SET_BOOL)
    peer.call("/start", YES)
    wait_for(lambda: requests.open)
    peer.process.kill()
    peer.close()
    wait_for(lambda: not server.matched)
    server.reply(requests.open[0][1], response(True, "late"))
    peer = Peer(domain, "successor")
    peer.proxy("/start", SET_BOOL)
    peer.call("/start", NO)
    wait_for(lambda: len(requests.open) == 2)
    assert server.reply(requests.open[1][1], response(False, "done"))
    wait_for(lambda: peer.heard["response:/start"])
    peer.close()
