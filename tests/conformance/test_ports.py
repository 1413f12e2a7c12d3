"""What carrying relies on in every kind of port, whatever the memory behind it is."""

from __future__ import annotations

import mmap
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rosplc._core import Fault
from rosplc.bridge.carrier import Carriers
from rosplc.bridge.port import Context, Counters, Port, Ports
from rosplc.bridge.status import PortStatus
from rosplc.clock import SYSTEM
from rosplc.codec import Codec, Wire
from rosplc.config import parse_config, resolve
from rosplc.config.resolve import TopicPlan
from rosplc.errors import ChannelError, RosplcError
from rosplc.layout import Limits, compute_layout
from rosplc.shm import Namespace, attach
from tests.lib.waiting import wait_for

STRING = "std_msgs/msg/String"


class Side:
    """A stream that writes down what its port tells it."""

    def __init__(self, plan: TopicPlan) -> None:
        self.plan = plan
        self.codec = Codec(plan.layout, Wire.CDR)
        self.counters = Counters()
        self.problem = ""
        self.still = False
        self.events: list[Any] = []

    def receive(self, data: bytes, flags: int, stamp_ns: int, stamp_clock: int) -> None:
        self.events.append(("received", data))

    def delivered(self, data: bytes, flags: int) -> None:
        self.events.append(("delivered", data))

    def refuse(self, fault: Fault, now_ns: int) -> None:
        self.events.append(("refused", self.codec.explain(fault).code))

    def note(self, now_ns: int, words: str, code: str = "") -> None:
        self.events.append(("noted", code))

    def fail(self, now_ns: int, error: Exception) -> None:
        self.problem = str(error)

    def renewed(self) -> None:
        """Nothing is remembered here."""

    def of(self, kind: str) -> list[Any]:
        return [value for event, value in self.events if event == kind]


class Rig:
    """One port over one kind of memory, and the PLC on its other side."""

    def __init__(self, namespace: Namespace, kind: str, to: str) -> None:
        self.kind, self.namespace = kind, namespace
        self.name = f"T{secrets.token_hex(6)}"
        classic = f", classic: {{name: {self.name}, wait: 1ms}}" if kind == "classic" else ", slots: 16"
        text = f"topics:\n  /t: {{type: {STRING}, to: {to}, limits: {{data: 9}}{classic}}}\n"
        (self.plan,) = resolve(parse_config(f"prefix: {namespace.prefix}\n{text}")).topics
        self.lock = namespace.lock_path("/t")
        if kind == "classic":
            self.lock = Path(f"/dev/shm/rosplc.classic.{self.name}")
        self.side = Side(self.plan)
        self.ports, self.port = self.make(self.side)

    def make(self, side: Side) -> tuple[Ports[Any], Port]:
        self.context = Context(self.namespace, "cell", bytes(16), "jazzy")
        ports = Carriers(self.context, 1_000_000).of(self.plan).ports
        return ports, ports.make(side)

    def open(self) -> None:
        self.port.open()
        self.ports.add(self.port)

    def turn(self) -> None:
        """Do what a carrier does in one round."""
        self.ports.poll(SYSTEM.monotonic_ns() + 1_000_000)
        self.ports.take(SYSTEM.monotonic_ns())

    def until(self, kind: str, count: int = 1) -> list[Any]:
        def there() -> bool:
            self.turn()
            return len(self.side.of(kind)) >= count

        wait_for(there, f"{count} {kind}, after {self.side.events}", every=0)
        return self.side.of(kind)

    def write(self, text: str) -> None:
        """Write as the PLC does."""
        record = bytes(self.plan.layout.pack({"data": text}))
        if self.kind == "channel":
            with attach(self.namespace, "/t", write=True) as found:
                found.writer(1000).publish(record)
            return
        with Path(f"/dev/shm/{self.name}").open("r+b") as file, mmap.mmap(file.fileno(), 0) as memory:
            memory[: len(record)] = record

    def read(self) -> str:
        """Return what the PLC finds."""
        record = bytearray(self.plan.layout.size)
        if self.kind == "channel":
            with attach(self.namespace, "/t") as found:
                found.reader(latched=True).peek(record)
        else:
            record[:] = Path(f"/dev/shm/{self.name}").read_bytes()[: len(record)]
        return str(self.plan.layout.to_dict(record)["data"])

    def close(self) -> None:
        self.ports.remove(self.port)
        self.port.close()
        for path in Path("/dev/shm").glob(f"*{self.name}*"):
            path.unlink()


@pytest.fixture(params=["channel", "classic"])
def kind(request: pytest.FixtureRequest) -> str:
    """Name a kind of port."""
    return str(request.param)


@pytest.fixture
def to_plc(shm_namespace: Namespace, kind: str) -> Iterator[Rig]:
    """Give a port towards the PLC, not open yet."""
    rig = Rig(shm_namespace, kind, "plc")
    yield rig
    rig.close()


@pytest.fixture
def to_ros(shm_namespace: Namespace, kind: str) -> Iterator[Rig]:
    """Give a port towards ROS, not open yet."""
    rig = Rig(shm_namespace, kind, "ros")
    yield rig
    rig.close()


@pytest.fixture(params=["plc", "ros"])
def either(request: pytest.FixtureRequest, shm_namespace: Namespace, kind: str) -> Iterator[Rig]:
    """Give a port of either direction, not open yet."""
    rig = Rig(shm_namespace, kind, str(request.param))
    yield rig
    rig.close()


def wire(text: str) -> bytes:
    """Return a message as ROS sends it."""
    layout = compute_layout(resolve(parse_config("")).store, STRING, Limits(string=100))
    return Codec(layout, Wire.CDR).encode(layout.pack({"data": text}))


def test_put_reaches_the_plc(to_plc: Rig) -> None:
    """Each message that is put is delivered or replaced by a newer one, and the last one arrives."""
    to_plc.open()
    for text in ("one", "two"):
        to_plc.port.put(wire(text), 5, 0, SYSTEM.monotonic_ns())
        assert to_plc.until("delivered")[-1] == wire(text)
        assert to_plc.read() == text
        to_plc.side.events.clear()


def test_put_refuses_what_does_not_fit(to_plc: Rig) -> None:
    """The stream is told why, and the PLC keeps what it had."""
    to_plc.open()
    to_plc.port.put(wire("fits"), 0, 0, SYSTEM.monotonic_ns())
    to_plc.until("delivered")
    to_plc.port.put(wire("x" * 10), 0, 0, SYSTEM.monotonic_ns())
    assert to_plc.until("refused") == ["COD004"]
    assert to_plc.read() == "fits"


def test_take_passes_on_what_is_new_once(to_ros: Rig) -> None:
    """Each message comes once, encoded; none comes after the port was removed."""
    to_ros.open()
    to_ros.turn()
    for number, text in enumerate(("one", "two", "three"), 1):
        to_ros.write(text)
        assert to_ros.until("received", number)[-1] == wire(text)
    for _ in range(5):
        to_ros.turn()
    to_ros.ports.remove(to_ros.port)
    to_ros.ports.remove(to_ros.port)
    to_ros.write("four")
    for _ in range(5):
        to_ros.turn()
    assert to_ros.side.of("received") == [wire("one"), wire("two"), wire("three")]


def test_a_name_has_one_owner(either: Rig) -> None:
    """A second port on the name is refused, until the first is closed; closing twice is harmless."""
    either.open()
    _, second = either.make(Side(either.plan))
    with pytest.raises(ChannelError, match="SHM116"):
        second.open()
    assert either.port.owned()
    either.ports.remove(either.port)
    either.port.close()
    either.port.close()
    second.open()
    second.close()


def test_the_last_state_outlives_the_port(to_plc: Rig) -> None:
    """The PLC still finds the last message when the port is closed, and after it was opened again."""
    to_plc.open()
    to_plc.port.put(wire("stays"), 0, 0, SYSTEM.monotonic_ns())
    to_plc.until("delivered")
    to_plc.ports.remove(to_plc.port)
    to_plc.port.close()
    assert to_plc.read() == "stays"
    to_plc.open()
    assert to_plc.port.adopted
    assert to_plc.read() == "stays"


def test_the_loss_of_the_name_is_seen(to_ros: Rig) -> None:
    """Another bridge has taken the name over: this one no longer owns it, and is told to open it again."""
    to_ros.open()
    assert to_ros.port.owned()
    assert not to_ros.port.check(SYSTEM.monotonic_ns())
    to_ros.lock.unlink()
    _, second = to_ros.make(Side(to_ros.plan))
    second.open()
    assert not to_ros.port.owned()
    assert to_ros.port.check(SYSTEM.monotonic_ns())
    second.close()


def test_a_port_reports_and_beats_in_every_state(either: Rig) -> None:
    """What threads beside the carrier call works before, while and after it is open."""

    def everything() -> None:
        either.context.beat()
        either.port.tell(3)
        either.ports.wake()
        assert isinstance(either.port.status(SYSTEM.monotonic_ns()), PortStatus)
        assert "7 messages" in either.port.loss(7)

    everything()
    either.open()
    everything()
    assert either.port.retained() is None
    either.ports.remove(either.port)
    either.port.close()
    everything()


def test_a_retired_port_leaves_the_name_free(either: Rig) -> None:
    """What is given up can be opened by another at once."""
    either.open()
    either.ports.remove(either.port)
    either.port.retire()
    _, second = either.make(Side(either.plan))
    second.open()
    second.close()


def test_a_wrong_direction_is_refused(to_ros: Rig) -> None:
    """Nothing is written where the PLC writes."""
    to_ros.open()
    with pytest.raises(RosplcError, match="SHM110"):
        to_ros.port.put(wire("no"), 0, 0, SYSTEM.monotonic_ns())
