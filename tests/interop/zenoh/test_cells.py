"""Cells joined beyond one network, and other versions of the library, over real routers."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from rosplc.model import TypeStore
from rosplc.ros import Backend, Qos, open_backend
from tests.interop.zenoh.processes import Router, free_port
from tests.lib.waiting import wait_for

ROOT = Path(__file__).parents[3]
STRING = "std_msgs/msg/String"
DOMAIN = 13


def string(text: str) -> bytes:
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data + bytes(-len(data) % 4)


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def join(stack: ExitStack, name: str, router: Router, mode: str) -> Backend:
    """Open a node of the backend at a router."""
    options = {"mode": mode, "connect": [router.endpoint]}
    store = TypeStore.bundled("jazzy")
    backend = open_backend("zenoh", store, name, domain=DOMAIN, options=options, environment={})
    stack.callback(backend.close)
    return backend


def crosses(sender: Backend, receiver: Backend, topic: str) -> None:
    """Messages of one node reach the other, with its name in the graph."""
    got: list[bytes] = []
    subscription = receiver.subscribe(topic, STRING, Qos(depth=10), lambda data, _: got.append(data))
    publisher = sender.advertise(topic, STRING, Qos(depth=10))
    wait_for(lambda: subscription.matched == 1 and publisher.matched == 1)
    while not got:  # what is sent while the way changes is lost
        publisher.write(string(topic))
        time.sleep(0.05)
    assert set(got) == {string(topic)}


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_cells_are_joined_by_their_routers(stack: ExitStack, mode: str) -> None:
    """Nodes of two cells exchange messages once one router connects to the other, also after its restart."""
    ports = [stack.enter_context(free_port()) for _ in range(2)]
    one = stack.enter_context(Router(ports[0]))
    other = stack.enter_context(Router(ports[1], one.endpoint))
    here, there = join(stack, "here", one, mode), join(stack, "there", other, mode)
    crosses(here, there, "/to_there")
    crosses(there, here, "/to_here")
    wait_for(lambda: "/there" in here.graph().nodes)
    other.kill()
    other.start()
    crosses(here, there, "/after_the_router")


def test_peers_that_know_each_other_need_no_router(stack: ExitStack) -> None:
    """Peers learn of each other by gossip, and go on when the router is gone."""
    router = stack.enter_context(Router(stack.enter_context(free_port())))
    peers = [join(stack, name, router, "peer") for name in ("one", "two")]
    got: list[bytes] = []
    subscription = peers[1].subscribe("/data", STRING, Qos(depth=10), lambda data, _: got.append(data))
    publisher = peers[0].advertise("/data", STRING, Qos(depth=10))
    wait_for(lambda: subscription.matched == 1)
    while not got:
        publisher.write(string("with"))
        time.sleep(0.05)
    router.kill()
    while string("without") not in got:
        publisher.write(string("without"))
        time.sleep(0.05)


@pytest.fixture(scope="module")
def oldest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the oldest version of the library that rosplc allows into a folder of its own."""
    wish = re.search(r'"eclipse-zenoh>=([\d.]+),', (ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert wish is not None
    version = ".".join([*wish[1].split("."), "0", "0"][:3])
    folder = tmp_path_factory.mktemp("zenoh")
    # Bounded, since a machine without a network is no failure of the backend.
    bounds = ["--quiet", "--retries", "1", "--timeout", "30"]
    pip = [sys.executable, "-m", "pip", "install", *bounds, "--no-deps", "--target", str(folder)]
    wanted = f"eclipse-zenoh=={version}"
    done = subprocess.run([*pip, wanted], capture_output=True, text=True, check=False)
    if done.returncode:
        why = (done.stderr.strip().splitlines() or ["pip says nothing"])[-1]
        pytest.skip(f"{wanted} cannot be installed here: {why}")
    return folder


@pytest.mark.verify(minutes=1)
@pytest.mark.timeout(300)
@pytest.mark.parametrize("mode", ["peer", "client"])
def test_router_of_the_oldest_version(stack: ExitStack, oldest: Path, mode: str) -> None:
    """Nodes on today's library find each other around a router of the oldest version."""
    old = ("env", f"PYTHONPATH={oldest}")
    router = stack.enter_context(Router(stack.enter_context(free_port()), prefix=old))
    here, there = join(stack, "here", router, mode), join(stack, "there", router, mode)
    crosses(here, there, "/forth")
    crosses(there, here, "/back")


@pytest.mark.verify(minutes=3)
@pytest.mark.timeout(600)
def test_oldest_version_passes_the_suite(oldest: Path) -> None:
    """The backend passes the suite of all backends on the oldest version of the library that it allows."""
    # zenoh-ros2-sdk, the suite's independent peer, needs a newer one.
    chosen = ["tests/conformance/test_backends.py", "-k", "zenoh and not foreign"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not verify", *chosen],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(oldest), "PYTEST_ADDOPTS": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-5000:]
    assert re.search(r"\b[4-9]\d passed|\b1\d\d passed", done.stdout), done.stdout[-500:]
