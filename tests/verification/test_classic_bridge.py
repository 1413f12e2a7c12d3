"""Classic blocks, as generated, and the bridge: a ROS node on one side, a PLC on the other."""

from __future__ import annotations

import itertools
import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rosplc.bridge import Bridge
from rosplc.codec import Codec, Wire
from rosplc.config import parse_config
from rosplc.ros import Publisher, Qos
from rosplc.ros.memory import open_backend
from rosplc_st.machine import ProcessMachine
from tests.verification.classic_cell import TWIST, ClassicCell
from tests.verification.plc_cell import READ, WRITE, layout_of, pattern, store
from tests.verification.test_classic_crash import stop_inside

DOMAIN = 47
WATCHDOG_S = 100.0
_CODEC = Codec(layout_of(TWIST), Wire.CDR)


class Joint:
    """A PLC, a bridge and a ROS node around the topics /in and /out."""

    def __init__(self, recover_after: str = "300ms") -> None:
        self.cell = ClassicCell(start=False)
        self.peer = open_backend(store(), "peer", domain=DOMAIN)
        self.received: list[bytes] = []
        qos = Qos(depth=1000)
        prefix = self.cell.prefix
        self.topics = {way: f"/{prefix}{way}" for way in ("in", "out")}
        lines = [
            f"  {topic}: {{type: {TWIST}, to: {'plc' if way == 'in' else 'ros'}, "
            f"classic: {{name: {prefix}{way}, recover_after: {recover_after}}}}}"
            for way, topic in self.topics.items()
        ]
        self.config = (
            f"bridge: classic\nprefix: {prefix}r\nros: {{backend: memory, domain: {DOMAIN}}}\n"
            "diagnostics: {enabled: false}\ntopics:\n" + "\n".join(lines) + "\n"
        )
        self.bridge: Bridge | None = None
        self.written: set[bytes] = set()
        self._met = False
        self.publisher: Publisher = self.peer.advertise(self.topics["in"], TWIST, qos)
        self.peer.subscribe(self.topics["out"], TWIST, qos, lambda data, _: self.received.append(data))

    def start_bridge(self) -> None:
        self._met = False
        self.bridge = Bridge(parse_config(self.config))
        self.bridge.start()

    def stop_bridge(self) -> None:
        if self.bridge is not None:
            self.bridge.stop()
        self.bridge = None

    def close(self) -> None:
        self.stop_bridge()
        self.peer.close()
        self.cell.__exit__(None, None, None)

    def publish(self, number: float) -> None:
        """Send a Twist towards the PLC."""
        self.publisher.write(_CODEC.encode(pattern(number)), 0)

    def scan_until(self, condition: Callable[[], Any], what: str) -> None:
        """Let the PLC run until something holds."""
        deadline = time.monotonic() + WATCHDOG_S
        self.cell.machine.scan(READ, WRITE)
        while not condition():
            assert time.monotonic() < deadline, f"still waiting for {what}"
            time.sleep(0.002)
            self.cell.machine.scan(READ, WRITE)

    def write(self, number: float) -> bytes:
        """Let the PLC write a Twist from its next scan on; returns what ROS gets."""
        self.cell.put("/out", pattern(number))
        sent = _CODEC.encode(pattern(number))
        self.written.add(sent)
        return sent

    def meet(self, number: float) -> None:
        """Let the PLC write ever new numbers until one arrives in ROS.

        What the memory holds at the bridge's first look is no message, nor what a freed lock held
        (classic mode, 3.4 and 4.4).
        """
        had, numbers = len(self.received), itertools.count(1)

        def arrived() -> bool:
            self.write(-number + next(numbers) / 1e6)
            return len(self.received) > had

        self.scan_until(arrived, "any number in ROS")
        self._met = True

    def exchange(self, number: float) -> None:
        """Send a number both ways, and see it arrive."""
        self.publish(number)
        if not self._met:
            self.meet(number)
        sent = self.write(-number)
        self.scan_until(lambda: self.cell.record("/in") == pattern(number), f"{number} in the PLC")
        self.scan_until(lambda: sent in self.received, f"{-number} in ROS")


@pytest.fixture
def joint() -> Iterator[Joint]:
    made = Joint()
    yield made
    made.close()


@pytest.mark.parametrize("first", ["bridge", "plc"])
def test_values_cross_both_ways(joint: Joint, first: str) -> None:
    """The side that starts first makes the names, and every number arrives on the other side."""
    for starter in (joint.start_bridge, joint.cell.start)[:: 1 if first == "bridge" else -1]:
        starter()
    for number in range(1, 20):
        joint.exchange(number)
    assert joint.cell.get("/in", "udiError", "udiMended") == (0, 0)
    assert joint.cell.get("/out", "udiError", "udiSurplus") == (0, 0)


def test_a_semaphore_born_locked_is_mended_once(joint: Joint) -> None:
    """The PLC's runtime makes locked semaphores: one side frees them, and no lock lets two in."""
    joint.cell.options = {"sem_born_locked": 1}
    joint.cell.start()
    joint.start_bridge()
    joint.exchange(1)
    for _ in range(300):
        joint.cell.machine.scan(READ, WRITE)
    probe = joint.cell.peer("/in"), joint.cell.peer("/out")
    for peer in probe:
        assert peer.ask("count") in "01"  # 0: the other side is just inside
    joint.exchange(2)


def test_either_side_starts_again(joint: Joint) -> None:
    """Bridge and PLC end and come back in any order, and messages flow on."""
    joint.start_bridge()
    joint.cell.start()
    joint.exchange(1)
    joint.stop_bridge()
    for _ in range(20):
        joint.cell.machine.scan(READ, WRITE)
    assert joint.cell.record("/in") == pattern(1)
    joint.start_bridge()
    joint.exchange(2)
    joint.cell.machine.stop()
    joint.cell.start()
    joint.exchange(3)
    joint.cell.machine.online_change()
    joint.exchange(4)


def test_plc_killed_inside_the_lock(joint: Joint) -> None:
    """The bridge frees a lock whose holder, the PLC, was killed; the PLC's successor goes on."""
    joint.start_bridge()
    machine = joint.cell.start(process=True)
    assert isinstance(machine, ProcessMachine)
    joint.exchange(1)
    stop_inside(machine)
    joint.publish(2)
    machine.kill()
    joint.cell.start()
    joint.scan_until(lambda: joint.cell.record("/in") == pattern(2), "the message sent meanwhile")
    joint.exchange(3)
    assert joint.cell.get("/in", "udiError", "udiMended") == (0, 0)


def test_plc_that_stood_still_inside_the_lock(joint: Joint) -> None:
    """A PLC halted inside the lock until the bridge has freed it goes on, and no lock lets two in."""
    joint.start_bridge()
    machine = joint.cell.start(process=True)
    assert isinstance(machine, ProcessMachine)
    joint.exchange(1)
    stop_inside(machine)
    probe = joint.cell.peer("/in")
    deadline = time.monotonic() + WATCHDOG_S
    while probe.ask("count") == "0":
        assert time.monotonic() < deadline, "the bridge never freed the lock"
        time.sleep(0.01)
    os.kill(machine.process.pid, signal.SIGCONT)
    machine._line()
    for number in range(2, 6):
        joint.exchange(number)
    joint.scan_until(lambda: probe.ask("count") in "01", "one lock")


@pytest.mark.parametrize("rounds", [3, pytest.param(60, marks=pytest.mark.verify(minutes=2))])
def test_plc_killed_anywhere(joint: Joint, rounds: int) -> None:
    """Killed with -9 at any instant and started again, the PLC gets what was sent, and so does ROS."""
    joint.start_bridge()
    for number in range(1, rounds + 1):
        machine = joint.cell.start(process=True)
        assert isinstance(machine, ProcessMachine)
        joint.exchange(number)
        machine.send("scan SHAREDMEMORY_READ 100000000 10")
        for late in range(20):
            joint.publish(number + late / 100)
            time.sleep(0.0007)
        machine.kill()
        joint.cell.machines.remove(machine)
    joint.cell.start()
    joint.exchange(1000)
    assert set(joint.received) <= joint.written
