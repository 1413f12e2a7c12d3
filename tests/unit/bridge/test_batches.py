"""Messages that pass between DDS and channels without Python, and the ways back into Python."""

from __future__ import annotations

import mmap
import queue
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")

from cyclonedds.domain import DomainParticipant

from rosplc.bridge import Bridge
from rosplc.config import parse_config
from rosplc.model import TypeStore
from rosplc.ros import Backend, Publisher, Qos, open_backend
from rosplc.ros.dds import _batch, batches, native
from rosplc.shm import Attached, Direction, Namespace, Sink, Writer, attach
from rosplc.shm.constants import FLAG_FIRST, READER_LINES_OFFSET
from tests.interop.graphs import LOCAL, STRING, free_domain, string
from tests.lib.waiting import wait_for

INT = "std_msgs/msg/Int32"
STORE = TypeStore.bundled("jazzy")
DEEP = Qos(depth=5000)


def number(value: int) -> bytes:
    """Return a serialized Int32."""
    return b"\0\1\0\0" + struct.pack("<i", value)


def test_what_an_inlet_cannot_have_is_refused() -> None:
    """Keys, room and times are bounded, and one thread waits at a time."""
    _batch.load(native.library._name)
    inlet, capsule, results = _batch.Inlet(), Sink().capsule, queue.SimpleQueue[object]()
    for key, reader in ((-1, 1), (1 << 20, 1), (0, 0)):
        with pytest.raises(ValueError, match="between 0 and"):
            inlet.add(key, reader, capsule)
    for room, timeout_ns in ((0, 0), ((1 << 20) + 1, 0), (1 << 61, 0), (1, -1)):
        with pytest.raises(ValueError, match="room must be 1 to"):
            inlet.wait(0, room, timeout_ns)

    def wait(ref: int) -> None:
        try:
            results.put(inlet.wait(ref, 1, 2**63 - 1))
        except RuntimeError as error:
            results.put(str(error))

    with free_domain() as domain:
        participant = DomainParticipant(domain)
        waitset = native.WaitSet(participant._ref)
        threads = [threading.Thread(target=wait, args=(waitset.ref,), daemon=True) for _ in range(2)]
        for thread in threads:
            thread.start()
        assert results.get(timeout=10) == "another thread is already waiting"
        waitset.wake()
        assert results.get(timeout=10) == ([-1], [])
        waitset.close()
        native.delete(participant)


_ADD_AND_REMOVE = """
import sys, threading
from rosplc.ros.dds import _batch, native
from rosplc.shm import Sink

sys.setswitchinterval(1e-6)
_batch.load(native.library._name)
inlet, capsule, ending = _batch.Inlet(), Sink().capsule, threading.Event()

def remove():
    while not ending.is_set():
        inlet.remove(0)

def work():
    while not ending.is_set():
        pass

threads = [threading.Thread(target=each) for each in (remove, remove, work)]
for thread in threads:
    thread.start()
for _ in range(1000):
    new = _batch.Inlet()
    new.add(0, 1, capsule)
    inlet = new
    for size in range(5, 14):
        inlet.add(1 << size, 1, capsule)
ending.set()
for thread in threads:
    thread.join()
print("passed")
"""


def test_threads_that_add_and_remove_readers_do_not_wait_for_each_other() -> None:
    """The table grows in one thread while another one lets go of an entry."""
    command = [sys.executable, "-c", _ADD_AND_REMOVE]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.stdout == "passed\n", done.stderr


class Cell:
    """A bridge over DDS, another node, and what a PLC reads."""

    def __init__(self, namespace: Namespace, domain: int) -> None:
        self.namespace, self._domain = namespace, domain
        self.peer: Backend = open_backend("dds", STORE, "peer", domain=domain, environment=LOCAL)
        self.bridge: Bridge | None = None
        self.attached: list[Attached] = []

    def start(self, topic: str) -> Bridge:
        """Start a bridge with one topic, given as its line of the configuration."""
        text = (
            f"bridge: cell\nprefix: {self.namespace.prefix}\nros: {{backend: dds, domain: {self._domain}}}\n"
            f"diagnostics: {{enabled: false}}\ntopics:\n  {topic}\n"
        )
        self.bridge = Bridge(parse_config(text))
        self.bridge.start()
        return self.bridge

    def publisher(self, topic: str, type_name: str = INT) -> Publisher:
        """Return a publisher that has found the bridge."""
        made = self.peer.advertise(topic, type_name, DEEP)
        wait_for(lambda: made.matched > 0)
        return made

    def reading(self, topic: str) -> Callable[[], list[tuple[bytes, int]]]:
        """Return what takes every record that has come since, with its flags."""
        attached = attach(self.namespace, topic, direction=Direction.TO_PLC, write=True)
        self.attached.append(attached)
        reader, record = attached.reader("plc", observe=False), bytearray(attached.identity.record_size)

        def take() -> list[tuple[bytes, int]]:
            found = []
            while (info := reader.next(record)) is not None:
                found.append((bytes(record), info.flags))
            return found

        return take

    @property
    def status(self) -> Any:
        """The status of the only topic."""
        assert self.bridge is not None
        return self.bridge.status().topics[0]

    @property
    def stream(self) -> Any:
        """The only stream."""
        assert self.bridge is not None
        return self.bridge._streams[0]

    def close(self) -> None:
        """End everything."""
        if self.bridge is not None:
            self.bridge.stop()
        for attached in self.attached:
            attached.close()
        self.peer.close()


@pytest.fixture
def cell(shm_namespace: Namespace, monkeypatch: pytest.MonkeyPatch) -> Iterator[Cell]:
    """Give a cell in a domain of its own."""
    for name, value in LOCAL.items():
        monkeypatch.setenv(name, value)
    with free_domain() as domain:
        made = Cell(shm_namespace, domain)
        try:
            yield made
        finally:
            made.close()


def values(records: list[tuple[bytes, int]]) -> list[int]:
    """Return the numbers in Int32 records."""
    return [struct.unpack("<i", record[:4])[0] for record, _ in records]


def send(publisher: Publisher, numbers: range) -> None:
    """Publish numbers, in small bursts."""
    for value in numbers:
        assert publisher.write(number(value))


def test_this_wheel_is_the_one_that_was_declared() -> None:
    """The trial passes with the wheel that the tests install: otherwise nothing below would pass in C."""
    assert batches.obstacle() == ""


@pytest.mark.parametrize("in_c", [True, False])
def test_every_message_reaches_the_plc(cell: Cell, monkeypatch: pytest.MonkeyPatch, in_c: bool) -> None:
    """All arrive in order and are counted; only with batches do they pass in C."""
    if not in_c:
        for module in ("backend", "endpoint"):
            monkeypatch.setattr(f"rosplc.ros.dds.{module}.obstacle", lambda: "not now")
    cell.start(f"/in: {{type: {INT}, to: plc, every: true, slots: 4096, qos: {{depth: 5000}}}}")
    take, source = cell.reading("/in"), cell.publisher("/in")
    seen: list[tuple[bytes, int]] = []

    def came(count: int) -> bool:
        seen.extend(take())
        return len(seen) >= count

    send(source, range(1))
    wait_for(lambda: came(1))
    send(source, range(1, 1000))
    wait_for(lambda: came(1000))
    assert values(seen) == [*range(1000)]
    assert [flags for _, flags in seen] == [FLAG_FIRST, *[0] * 999]
    status = cell.status
    assert (status.received, status.published, status.lost, status.refused) == (1000, 1000, 0, 0)
    assert cell.stream.endpoint().messages == 1000
    assert 0 <= status.age_ns < 10_000_000_000
    assert (cell.stream.port.sink.messages > 900) is in_c
    assert (cell.stream.port.sink.messages == 0) is not in_c


def test_a_message_that_does_not_fit_is_explained(cell: Cell) -> None:
    """It is refused with words, in its place among the others, which pass."""
    cell.start(f"/in: {{type: {STRING}, to: plc, every: true, slots: 64, limits: {{string: 5}}}}")
    take, source = cell.reading("/in"), cell.publisher("/in", STRING)
    count = 0
    for texts in (["a"], ["b", "c"], ["much too long", "d"], ["e"], ["f"]):
        count += len(texts)
        for text in texts:
            assert source.write(string(text))
        wait_for(lambda count=count: cell.status.received == count)
    assert [record.rstrip(b"\0") for record, _ in take()] == [text.encode() for text in "abcdef"]
    status = cell.status
    assert (status.received, status.published, status.refused) == (7, 6, 1)
    assert status.code == "COD004", status
    assert cell.stream.port.sink.messages > 0


def test_shortened_messages_are_counted(cell: Cell) -> None:
    """What ``truncate`` shortens counts in C as it does in Python."""
    setting = "limits: {string: 5}, on_overflow: truncate"
    cell.start(f"/in: {{type: {STRING}, to: plc, every: true, slots: 64, {setting}}}")
    take, source = cell.reading("/in"), cell.publisher("/in", STRING)
    for count in range(1, 4):
        assert source.write(string("much too long"))
        wait_for(lambda count=count: cell.status.published == count)
    assert [record.rstrip(b"\0") for record, _ in take()] == [b"much "] * 3
    assert cell.status.truncated == 3 and cell.stream.port.sink.truncated == 2


def test_a_source_that_was_stale_is_first_again(cell: Cell) -> None:
    """A message after too long a silence goes through Python, which counts the recovery and marks it."""
    cell.start(f"/in: {{type: {INT}, to: plc, every: true, slots: 64, stale_after: 300ms}}")
    take, source = cell.reading("/in"), cell.publisher("/in")
    send(source, range(1))
    wait_for(lambda: cell.status.published == 1)
    send(source, range(1, 3))
    wait_for(lambda: cell.status.published == 3)
    before = cell.status.recovered
    wait_for(lambda: cell.status.stale)
    send(source, range(3, 4))
    wait_for(lambda: cell.status.published == 4)
    found = take()
    assert values(found) == [0, 1, 2, 3] and found[3][1] & FLAG_FIRST
    assert cell.status.recovered == before + 1 and not cell.status.stale


@pytest.mark.parametrize("setting", ["on_change: true", "rate_limit: 1kHz", "print: true"])
def test_what_python_has_to_see_does_not_pass(cell: Cell, setting: str) -> None:
    """A stream that compares, holds back or prints its messages gets each of them."""
    cell.start(f"/in: {{type: {INT}, to: plc, every: true, slots: 64, {setting}}}")
    source = cell.publisher("/in")
    for value in range(5):
        send(source, range(value, value + 1))
        wait_for(lambda value=value: cell.status.received == value + 1)
    assert cell.stream.port.sink.messages == 0


def test_an_object_that_was_removed_is_created_again(cell: Cell) -> None:
    """Nothing is written into the old one any more once the new one is there."""
    bridge = cell.start(f"/in: {{type: {INT}, to: plc, every: true, slots: 64}}")
    source = cell.publisher("/in")
    for count in range(1, 4):
        send(source, range(count, count + 1))
        wait_for(lambda count=count: cell.status.published == count)
    removed = cell.stream.port.channel
    removed.path.unlink()
    bridge.check(time.monotonic_ns())
    wait_for(lambda: cell.stream.port.channel not in (None, removed))
    take = cell.reading("/in")
    send(source, range(9, 10))
    wait_for(lambda: cell.status.published == 4)
    assert [(value, flags & FLAG_FIRST) for value, (_, flags) in zip([9], take(), strict=True)] == [(9, 1)]


def test_another_definition_is_refused_message_by_message(cell: Cell) -> None:
    """While a publisher announces another definition nothing passes in C: Python tells its messages apart."""
    cell.start(f"/in: {{type: {INT}, to: plc, every: true, slots: 64}}")
    source = cell.publisher("/in")
    for count in range(1, 3):
        send(source, range(count, count + 1))
        wait_for(lambda count=count: cell.status.published == count)
    subscription = cell.stream._endpoint
    subscription.strangers = frozenset({12345})
    subscription._node.route(subscription)
    passed = cell.stream.port.sink.messages
    for count in range(3, 6):
        send(source, range(count, count + 1))
        wait_for(lambda count=count: cell.status.published == count)
    assert cell.stream.port.sink.messages == passed > 0


def out(cell: Cell, setting: str) -> tuple[Writer, list[tuple[int, int]]]:
    """Start a bridge with one topic to ROS; return the PLC's writer, and what the other node hears."""
    cell.start(f"/out: {{type: {INT}, to: ros, slots: 4096, {setting}}}")
    heard: list[tuple[int, int]] = []
    qos = Qos(depth=5000)
    cell.peer.subscribe("/out", INT, qos, lambda data, at: heard.append((struct.unpack("<4xi", data)[0], at)))
    wait_for(lambda: cell.stream.endpoint().matched > 0)
    attached = attach(cell.namespace, "/out", direction=Direction.TO_ROS, write=True)
    cell.attached.append(attached)
    return attached.writer(1000), heard


def warm(cell: Cell, writer: Writer, heard: list[tuple[int, int]]) -> None:
    """Send until messages pass in C: the first waits for subscribers, and goes through Python."""
    while not cell.stream.port.sink.messages:
        before = len(heard)
        writer.publish(struct.pack("<i", 0))
        wait_for(lambda before=before: len(heard) > before)
    heard.clear()


@pytest.mark.parametrize("latched", ["true", "false"])
@pytest.mark.parametrize("in_c", [True, False])
def test_every_message_reaches_ros(
    cell: Cell, monkeypatch: pytest.MonkeyPatch, in_c: bool, latched: str
) -> None:
    """All arrive in order, with their stamps, and are counted; only with batches do they pass in C."""
    if not in_c:
        for module in ("backend", "endpoint"):
            monkeypatch.setattr(f"rosplc.ros.dds.{module}.obstacle", lambda: "not now")
    writer, heard = out(cell, f"latched: {latched}")
    for value in range(1000):
        writer.publish(struct.pack("<i", value), stamp_ns=10**18 + value)
        if value % 100 == 0:
            wait_for(lambda value=value: len(heard) == value + 1)
    wait_for(lambda: len(heard) == 1000)
    assert heard == [(value, 10**18 + value) for value in range(1000)]
    status = cell.status
    assert (status.received, status.published, status.lost, status.refused) == (1000, 1000, 0, 0)
    assert cell.stream.endpoint().messages == 1000
    assert 0 <= status.age_ns < 10_000_000_000
    if in_c:
        assert cell.stream.port.sink.messages > 800
    else:
        assert cell.stream.port.sink is None


def test_a_message_without_a_time_gets_the_present(cell: Cell) -> None:
    """A stamp of the PLC's own clock, or none, means nothing in ROS."""
    writer, heard = out(cell, "latched: false")
    warm(cell, writer, heard)
    before, passed = time.time_ns(), cell.stream.port.sink.messages
    for count, stamp in enumerate(({}, {}, {"stamp_ns": 5, "stamp_clock": 2}, {"stamp_ns": 2**63 - 1}), 1):
        writer.publish(struct.pack("<i", count), **stamp)  # type: ignore[arg-type]
        wait_for(lambda count=count: len(heard) == count)
    assert all(before <= at <= time.time_ns() for _, at in heard)
    assert cell.stream.port.sink.messages == passed + 4


def test_another_bridge_that_takes_over_is_noticed(cell: Cell) -> None:
    """What comes after this bridge lost its line is not sent in C either."""
    writer, heard = out(cell, "latched: false")
    warm(cell, writer, heard)
    with (
        cell.stream.port.channel.path.open("r+b") as file,
        mmap.mmap(file.fileno(), READER_LINES_OFFSET + 4) as words,
    ):
        words[READER_LINES_OFFSET] ^= 1  # another's claim of the line
    writer.publish(struct.pack("<i", 9))
    wait_for(lambda: "SHM116" in cell.status.problem or cell.status.lost)
    assert heard == []


@pytest.mark.parametrize("setting", ["on_change: true", "rate_limit: 1kHz", "print: true"])
def test_what_python_has_to_see_is_not_sent_in_c(cell: Cell, setting: str) -> None:
    """A stream that compares, holds back or prints its messages gets each of them."""
    writer, heard = out(cell, setting)
    for count in range(1, 4):
        writer.publish(struct.pack("<i", count))
        wait_for(lambda count=count: len(heard) == count)
    assert cell.stream.port.sink.messages == 0


def test_a_large_message_is_warned_of(cell: Cell, caplog: pytest.LogCaptureFixture) -> None:
    """One that others lose goes through Python once, which says so; later ones pass in C."""
    writer, heard = out(cell, "latched: false")
    warm(cell, writer, heard)
    cell.stream._publisher._large = 4
    cell.stream._publisher.open_sink(0)
    passed = cell.stream.port.sink.messages
    for count in range(1, 6):
        writer.publish(struct.pack("<i", count))
        wait_for(lambda count=count: len(heard) == count)
    assert caplog.text.count("does not fit into a default receive buffer") == 1
    assert cell.stream.port.sink.messages == passed + 4


def test_a_closed_sink_takes_nothing() -> None:
    """A sink needs a live writer of its own records, and reports what it has."""
    sink = Sink()
    assert (sink.messages, sink.truncated, sink.last_ns) == (0, 0, 0)
    sink.close()
    with pytest.raises(TypeError):
        sink.open(None, None, False, 0)  # type: ignore[arg-type]
    capsule = sink.capsule
    del sink
    inlet = _batch.Inlet()
    inlet.add(7, 1, capsule)  # the capsule keeps it
    inlet.remove(7)
    inlet.remove(7000)
    with pytest.raises(ValueError, match="key"):
        inlet.add(-1, 1, capsule)
    with pytest.raises(ValueError, match="PyCapsule"):
        inlet.add(1, 1, object())


def test_another_release_of_the_wheel_is_not_used(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The log says why, and the functions are not even looked for."""
    monkeypatch.setattr(batches, "version", lambda _: "11.9.9")
    monkeypatch.setattr(_batch, "load", None)
    why = batches.obstacle.__wrapped__()
    monkeypatch.undo()
    assert "11.0.1" in why and "11.9.9" in why and why in caplog.text


@pytest.mark.parametrize("problem", ["not loaded", "no function", "other bytes"])
def test_a_failed_trial_is_reported(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, problem: str
) -> None:
    """A library that lacks something, or gives back something else, is not used."""
    if problem == "not loaded":
        monkeypatch.setattr(batches.native.library, "_name", "/nonexistent/libddsc.so")
    elif problem == "no function":
        monkeypatch.setattr(batches.native.library, "_name", "libc.so.6")
    else:
        monkeypatch.setattr(batches, "_SAMPLE", b"\0\1\0\0\xff\0\0\0trial\0\0\0")
    why = batches.obstacle.__wrapped__()
    monkeypatch.undo()
    _batch.load(batches.native.library._name)
    assert why and why in caplog.text
