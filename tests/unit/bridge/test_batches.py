"""Messages that pass between DDS and channels without Python, and the ways back into Python."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")

from rosplc.bridge import Bridge
from rosplc.config import parse_config
from rosplc.model import TypeStore
from rosplc.ros import Backend, Publisher, Qos, open_backend
from rosplc.ros.dds import _batch, batches
from rosplc.shm import Attached, Direction, Namespace, Sink, attach
from rosplc.shm.constants import FLAG_FIRST
from tests.interop.graphs import LOCAL, STRING, free_domain, string
from tests.lib.waiting import wait_for

INT = "std_msgs/msg/Int32"
STORE = TypeStore.bundled("jazzy")
DEEP = Qos(depth=5000)


def number(value: int) -> bytes:
    """Return a serialized Int32."""
    return b"\0\1\0\0" + struct.pack("<i", value)


class Cell:
    """A bridge over DDS, another node, and what a PLC reads."""

    def __init__(self, namespace: Namespace, domain: int) -> None:
        self._namespace, self._domain = namespace, domain
        self.peer: Backend = open_backend("dds", STORE, "peer", domain=domain, environment=LOCAL)
        self.bridge: Bridge | None = None
        self._attached: list[Attached] = []

    def start(self, topic: str) -> Bridge:
        """Start a bridge with one topic, given as its line of the configuration."""
        text = (
            f"bridge: cell\nprefix: {self._namespace.prefix}\nros: {{backend: dds, domain: {self._domain}}}\n"
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
        attached = attach(self._namespace, topic, direction=Direction.TO_PLC, write=True)
        self._attached.append(attached)
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
        for attached in self._attached:
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
    cell.stream.port.channel.path.unlink()
    bridge.check(time.monotonic_ns())
    wait_for(lambda: cell.stream.port.user is not None and cell.stream.port.channel.still_there())
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
