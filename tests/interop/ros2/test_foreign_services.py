"""The dds backend beside services on rmw_fastrtps, which misread each other: neither is harmed."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from rosplc.model import TypeStore
from rosplc.ros import SERVICES, Backend, Reply, open_backend
from tests.interop.graphs import LOCAL
from tests.interop.ros2.conftest import Peer
from tests.lib.waiting import wait_for

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(120), pytest.mark.verifies("fastdds-calls", real="rclpy")]

SET_BOOL = "std_srvs/srv/SetBool"
YES = b"\0\1\0\0\1\0\0\0"


@pytest.fixture
def cell(domain: int) -> Iterator[Backend]:
    backend = open_backend("dds", TypeStore.bundled("kilted"), "cell", domain=domain, environment=LOCAL)
    yield backend
    backend.close()


def test_a_client_is_no_worse_off(cell: Backend, peer: Peer, domain: int) -> None:
    """It takes our server for none; one of its own kind beside ours answers it; we execute nothing."""
    asked: list[bytes] = []
    server = cell.serve("/start", SET_BOOL, SERVICES, lambda payload, *_: asked.append(payload))
    peer.proxy("/start", SET_BOOL)
    wait_for(lambda: server.status().code == "ROS021")
    wait_for(lambda: "node /peer calls /start" in server.status().reason)
    wait_for(lambda: peer.counts("/start")[:2] == (1, 2))
    assert peer.counts("/start") == (1, 2, False)
    assert server.matched == 0

    peer.call("/start", YES, wait=False)
    wait_for(lambda: server.status().rejected == 1)

    other = Peer(domain, "other")
    other.serve("/start", SET_BOOL)
    wait_for(lambda: peer.counts("/start") == (2, 2, True))
    wait_for(lambda: "node /other serves /start" in server.status().reason)
    peer.call("/start", YES)
    wait_for(lambda: peer.heard["response:/start"])
    assert other.payloads("request:/start") == [YES]
    wait_for(lambda: server.status().rejected == 2)
    other.close()
    wait_for(lambda: peer.counts("/start") == (1, 2, False))
    assert asked == []


def test_a_server_is_not_called(cell: Backend, peer: Peer) -> None:
    """It is seen and named; a call is not executed, and nothing reaches it."""
    replies: list[Reply] = []
    client = cell.client("/start", SET_BOOL, SERVICES)
    peer.serve("/start", SET_BOOL)
    wait_for(lambda: client.status().code == "ROS021")
    assert not client.ready
    client.call(YES, replies.append)
    assert [reply.outcome for reply in replies] == ["not executed"]
    peer.proxy("/start", SET_BOOL)
    peer.call("/start", b"\0\1\0\0\0\0\0\0")
    wait_for(lambda: peer.heard["response:/start"])
    assert peer.payloads("request:/start") == [b"\0\1\0\0\0\0\0\0"]
