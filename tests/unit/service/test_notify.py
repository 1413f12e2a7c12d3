"""What a service tells systemd, and when it stops telling that it lives."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.bridge.status import BridgeStatus, ServiceStatus
from rosplc.service.supervisor import Notifier, Supervisor, supervised
from rosplc.shm import Namespace


class Manager:
    """systemd's end of the socket."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self.socket.settimeout(60)

    def hear(self) -> dict[str, str]:
        """Return the next message."""
        text = self.socket.recv(65536).decode()
        return dict(line.split("=", 1) for line in text.splitlines())

    def until(self, key: str) -> str:
        """Return the value of the next message that has a key."""
        while key not in (said := self.hear()):
            pass
        return said[key]

    def all(self) -> list[str]:
        """Return the keys of everything that was said so far."""
        self.socket.setblocking(False)
        said: list[str] = []
        try:
            while True:
                said += self.hear()
        except BlockingIOError:
            self.socket.settimeout(60)
            return said


@pytest.fixture
def address(tmp_path: Path) -> str:
    return str(tmp_path / "notify")


@pytest.fixture
def manager(address: str) -> Iterator[Manager]:
    made = Manager(address)
    yield made
    made.socket.close()


class Bridge:
    """A bridge that stands as the test says."""

    def __init__(self) -> None:
        self.running = False
        self.still = ""
        self.fails = False
        self.services: tuple[ServiceStatus, ...] = ()

    def status(self) -> BridgeStatus:
        if self.fails:
            raise ValueError("no status")
        given = {"running": self.running, "notes": ("two\nlines",), "services": self.services}
        return BridgeStatus(bridge="cell1", backend="memory", **given)

    def stuck(self, longest_ns: int) -> str:
        assert longest_ns == 15_000_000_000
        return self.still


def test_the_watchdog_is_fed_while_the_bridge_goes_round(manager: Manager, address: str) -> None:
    """READY comes with the start, WATCHDOG with each look at a bridge that carries, STOPPING with the end."""
    bridge = Bridge()
    supervisor = Supervisor(bridge, Notifier(address, 30.0))
    supervisor.look()
    assert manager.all() == [], "a bridge that is not up has nothing to say"
    bridge.running = True
    assert supervisor.look() == 5.0
    assert manager.all() == ["READY", "STATUS", "STATUS", "WATCHDOG"]
    bridge.still = "the thread that beats stands still"
    supervisor.look()
    assert manager.all() == ["STATUS"]
    bridge.still = ""
    supervisor.look()
    assert manager.all() == ["STATUS", "WATCHDOG"]
    bridge.running = False
    supervisor.look()
    supervisor.look()
    assert manager.all() == ["STOPPING"]


def test_a_status_is_one_line(manager: Manager, address: str) -> None:
    """What a status says cannot become another key of the protocol."""
    bridge = Bridge()
    bridge.running = True
    Supervisor(bridge, Notifier(address, 30.0)).look()
    assert manager.hear()["STATUS"] == "0 of 0 topics fine over memory; in 0, out 0; two lines"
    manager.all()
    bridge.services = (ServiceStatus(type_name="std_srvs/srv/Trigger", server="ros", service="/grip"),)
    Supervisor(bridge, Notifier(address, 30.0)).look()
    assert "; 0 of 1 services and actions fine; two lines" in manager.until("STATUS")


def test_a_defect_feeds_no_watchdog(manager: Manager, address: str) -> None:
    """A look that fails is logged, does not end the looking, and does not say that the bridge lives."""
    bridge = Bridge()
    bridge.fails = True
    stop = threading.Event()
    supervisor = Supervisor(bridge, Notifier(address, 30.0))
    threading.Timer(0.2, stop.set).start()
    supervisor.run(stop)
    assert manager.all() == []


def test_without_a_manager_nothing_is_said() -> None:
    """A bridge from a terminal has no supervisor, and one whose manager has gone goes on."""
    with supervised(Bridge(), {}):
        assert "rosplc-supervisor" not in {thread.name for thread in threading.enumerate()}
    Notifier("/nowhere/at/all").tell("WATCHDOG=1")
    Notifier("@rosplc-nobody-listens").tell("READY=1")


def test_the_environment_is_systemds() -> None:
    """The watchdog's time is in microseconds and for one process; nonsense there means none."""
    pid = str(os.getpid())
    for environment, seconds in (
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": pid}, 30.0),
        ({"WATCHDOG_USEC": "30000000"}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "1"}, 0.0),
        ({"WATCHDOG_USEC": "soon"}, 0.0),
        ({}, 0.0),
    ):
        assert Notifier.of(environment).watchdog_s == seconds


def test_an_abstract_socket_is_reached() -> None:
    """An address in the abstract namespace, which systemd may give, is used as one."""
    address = f"@rosplc-test-{os.getpid()}-{os.urandom(4).hex()}"
    manager = Manager(address)
    Notifier(address).tell("WATCHDOG=1")
    assert manager.hear() == {"WATCHDOG": "1"}
    manager.socket.close()


def test_rosplc_run_as_a_service(
    manager: Manager, address: str, tmp_path: Path, shm_namespace: Namespace
) -> None:
    """The command tells a manager that it is ready, lives, how it stands, and that it ends."""
    file = tmp_path / "cell.yaml"
    file.write_text(
        f"prefix: {shm_namespace.prefix}\nros: {{backend: memory}}\n"
        "topics: {/in: {type: std_msgs/msg/Int32, to: plc}}\n"
    )
    child = subprocess.Popen(
        [sys.executable, "-m", "rosplc", "run", "--status", "0", str(file)],
        env={**os.environ, "NOTIFY_SOCKET": address, "WATCHDOG_USEC": "4000000"},
    )
    try:
        assert manager.until("READY") == "1"
        assert manager.until("WATCHDOG") == "1"
        assert "topics fine over memory" in manager.until("STATUS")
        assert manager.until("WATCHDOG") == "1"
        child.send_signal(signal.SIGTERM)
        assert manager.until("STOPPING") == "1"
        assert child.wait() == 0
    finally:
        child.kill()
        child.wait()
