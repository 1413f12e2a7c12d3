"""A bridge that was stopped, lost its lock files, and is resumed beside the one that took its topics over."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import accumulate, count
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", exc_type=ImportError)

from rosplc.codec import Codec, Wire
from rosplc.demo.plan import FreeDomain
from rosplc.ros import DEFAULT, LATCHED, open_backend
from rosplc.shm import Namespace, attach
from tests.channels import STORE, layout_of
from tests.lib.waiting import wait_for

pytestmark = [pytest.mark.timeout(240), pytest.mark.verifies("kills", own="SIGSTOP")]

INT = "std_msgs/msg/Int32"
LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
LAYOUT = layout_of(INT)
ROUNDS = 3


class Bridge:
    """``rosplc run`` as a process."""

    def __init__(self, config: Path, log: Path) -> None:
        self._log = log
        with log.open("wb") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "rosplc", "run", str(config)],
                stderr=errors,
                env={**os.environ, **LOCAL},
            )

    def sees_another(self) -> bool:
        """Return whether it has said of both topics that another bridge carries them."""
        return self._log.read_text().count("SHM116") >= 2

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


def late(values: list[int]) -> list[int]:
    """Return the values that came after a larger one, or a second time."""
    return [
        value for before, value in zip(accumulate(values, max), values[1:], strict=False) if value <= before
    ]


class Load:
    """Numbers that count up, in both directions, about a thousand a second."""

    def __init__(self, namespace: Namespace, domain: int) -> None:
        self.to_ros: list[int] = []
        self.to_plc: list[int] = []
        self._namespace = namespace
        self._backend = open_backend("dds", STORE, "peer", domain=domain, environment=LOCAL)
        self._codec = Codec(LAYOUT, Wire.CDR)
        self._publisher = self._backend.advertise("/in", INT, DEFAULT)
        self._subscription = self._backend.subscribe("/out", INT, DEFAULT, self._hear)
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=work) for work in (self._write_plc, self._write_ros, self._read_plc)
        ]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def _hear(self, data: bytes, _stamp_ns: int) -> None:
        self.to_ros.append(LAYOUT.to_dict(self._codec.decode(data))["data"])

    def _pack(self, number: int) -> bytes:
        return bytes(LAYOUT.pack({"data": number}))

    def _write_plc(self) -> None:
        with attach(self._namespace, "/out", write=True) as attached:
            writer = attached.writer()
            for number in count(1):
                if self._stop.wait(0.001):
                    return
                writer.publish(self._pack(number))

    def _write_ros(self) -> None:
        for number in count(1):
            if self._stop.wait(0.001):
                return
            self._publisher.write(self._codec.encode(self._pack(number)), 0)

    def _read_plc(self) -> None:
        out = bytearray(LAYOUT.size)
        with attach(self._namespace, "/in") as attached:
            reader = attached.reader()
            while not self._stop.wait(0.0005):
                while reader.next(out) is not None:
                    self.to_plc.append(LAYOUT.to_dict(bytes(out))["data"])

    def stop(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self._subscription.close()
        self._backend.close()


@pytest.fixture
def dds_domain() -> Iterator[int]:
    """Give a ROS domain that nobody on this machine uses, and keep it from others meanwhile."""
    domain = FreeDomain()
    yield domain.number
    domain.close()


@pytest.mark.foreign
def test_a_resumed_bridge_carries_nothing_more(
    tmp_path: Path, shm_namespace: Namespace, dds_domain: int
) -> None:
    """Under load, in both directions: at most the one message in hand comes late, nothing else goes back."""
    config = tmp_path / "rosplc.yaml"
    config.write_text(
        f"prefix: {shm_namespace.prefix}\nros: {{backend: dds, domain: {dds_domain}}}\n"
        f"topics:\n  /in: {{type: {INT}, to: plc, every: true, slots: 4096}}\n"
        f"  /out: {{type: {INT}, to: ros, slots: 4096}}\n"
    )
    with ExitStack() as stack:

        def start(name: str) -> Bridge:
            bridge = Bridge(config, tmp_path / f"{name}.log")
            stack.callback(bridge.kill)
            return bridge

        first = start("0")
        wait_for(lambda: all(shm_namespace.path(topic).exists() for topic in ("/in", "/out")))
        load = Load(shm_namespace, dds_domain)
        load.start()
        stack.callback(load.stop)

        def both_go_on(messages: int = 200) -> None:
            wanted = [len(values) + messages for values in (load.to_ros, load.to_plc)]
            wait_for(lambda: len(load.to_ros) > wanted[0] and len(load.to_plc) > wanted[1], "more messages")

        both_go_on()
        for number in range(1, ROUNDS + 1):
            before = len(late(load.to_ros)), len(late(load.to_plc))
            first.process.send_signal(signal.SIGSTOP)
            for topic in ("/in", "/out"):
                shm_namespace.lock_path(topic).unlink()
            second = start(str(number))
            both_go_on()
            first.process.send_signal(signal.SIGCONT)
            wait_for(first.sees_another, "the resumed bridge to notice")
            both_go_on()
            assert len(late(load.to_ros)) <= before[0] + 1
            assert len(late(load.to_plc)) <= before[1] + 1
            first.kill()
            first = second


@pytest.mark.foreign
def test_a_bridge_stopped_beyond_the_lease_repeats_nothing_it_retains(
    tmp_path: Path, shm_namespace: Namespace, dds_domain: int
) -> None:
    """DDS discovers the resumed bridge again, and its publisher would send what it keeps once more."""
    config = tmp_path / "rosplc.yaml"
    config.write_text(
        f"prefix: {shm_namespace.prefix}\nros: {{backend: dds, domain: {dds_domain}}}\n"
        f"topics:\n  /out: {{type: {INT}, to: ros, latched: true}}\n"
    )
    codec, heard = Codec(LAYOUT, Wire.CDR), list[int]()

    def hear(data: bytes, _stamp_ns: int) -> None:
        heard.append(LAYOUT.to_dict(codec.decode(data))["data"])

    with ExitStack() as stack:
        backend = open_backend("dds", STORE, "peer", domain=dds_domain, environment=LOCAL)
        stack.callback(backend.close)
        subscription = backend.subscribe("/out", INT, LATCHED, hear)
        first = Bridge(config, tmp_path / "0.log")
        stack.callback(first.kill)
        wait_for(lambda: subscription.matched == 1, "the first bridge")
        attached = stack.enter_context(attach(shm_namespace, "/out", write=True))
        writer = attached.writer()

        def write(number: int) -> None:
            writer.publish(bytes(LAYOUT.pack({"data": number})))
            wait_for(lambda: number in heard, f"message {number}")

        write(1)
        first.process.send_signal(signal.SIGSTOP)
        wait_for(lambda: subscription.matched == 0, "the end of the lease")
        shm_namespace.lock_path("/out").unlink()
        second = Bridge(config, tmp_path / "1.log")
        stack.callback(second.kill)
        wait_for(lambda: subscription.matched == 1, "the second bridge")
        write(2)
        before = len(heard)
        first.process.send_signal(signal.SIGCONT)
        wait_for(lambda: "SHM116" in (tmp_path / "0.log").read_text(), "the resumed bridge to notice")

        def both_are_seen() -> bool:
            return [found.topic for found in backend.graph().endpoints].count("/diagnostics") == 2

        wait_for(both_are_seen, "the resumed node in the graph")
        for number in range(3, 30):
            write(number)
        assert heard[before:] == list(range(3, 30))
