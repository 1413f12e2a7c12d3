"""A source that falls silent and comes back: what the bridge passes on, marks, counts and reports."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import defaultdict
from types import SimpleNamespace

import pytest

from rosplc.bridge import Level
from rosplc.bridge.carrier import Carriers
from rosplc.bridge.channel import PortToRos
from rosplc.bridge.port import Context
from rosplc.bridge.stream import ToPlc
from rosplc.config import parse_config, resolve
from rosplc.monitor import Watch
from rosplc.ros import Qos
from rosplc.shm import Namespace
from rosplc.shm.attach import Peer, WriterProcess
from rosplc.shm.constants import FLAG_FIRST
from tests.lib.clock import SteppedClock
from tests.lib.waiting import wait_for
from tests.unit.bridge.conftest import INT, Cell, PlcTopic, numbers, unwire, wire

pytestmark = pytest.mark.verifies("fail-safe", own="rosplc alone")

BOOL = "std_msgs/msg/Bool"
SUBSTITUTED = (
    f"  /out: {{type: {INT}, to: ros, stale_after: 150ms, on_stale: {{value: {{data: -7}}, period: 20ms}}}}\n"
)
LATCHED = Qos("reliable", "transient_local", 100)
MS = 1_000_000


def flags(messages: list[bytes]) -> list[bool]:
    """Return what Bool messages hold."""
    return [unwire(BOOL, data)["data"] for data in messages]


def mark_of(plc: PlcTopic) -> int:
    """Return the flags of the next message that the PLC gets."""
    wait_for(plc.read)
    assert plc.reader is not None
    info = plc.reader.peek(bytearray(plc.layout.size))
    assert info is not None
    return info.flags


def test_a_silent_plc_is_substituted_and_ros_can_tell(cell: Cell) -> None:
    """The substitute comes again and again, is counted apart, and a latched flag tells of it."""
    messages = cell.listen("/out", INT)
    said = cell.listen("/out/substituted", BOOL, LATCHED)
    bridge = cell.start(SUBSTITUTED)
    plc = cell.plc("/out")
    assert flags(wait_for(lambda: said))[:1] == [False]
    wait_for(lambda: len(messages) >= 3)
    assert set(numbers(messages)) == {-7}
    assert flags(said) == [False, True]
    status = bridge.status().topic("/out")
    assert (status.received, status.published, status.substituting) == (0, 0, True)
    assert status.substituted >= 3
    plc.write({"data": 1})
    wait_for(lambda: 1 in numbers(messages))
    wait_for(lambda: flags(said)[:3] == [False, True, False])
    wait_for(lambda: bridge.status().topic("/out").published == 1)
    wait_for(lambda: numbers(messages)[-1] == -7)
    late = cell.listen("/out/substituted", BOOL, LATCHED)
    assert flags(wait_for(lambda: late))[-1] is True
    status = bridge.status().topic("/out")
    assert (status.received, status.published, status.recovered) == (1, 1, 1)


def test_what_the_plc_says_is_never_mixed_with_substitutes(cell: Cell) -> None:
    """Each of the PLC's messages arrives once and in order, whatever stands between them."""
    cell.start(SUBSTITUTED)
    messages = cell.listen("/out", INT)
    plc = cell.plc("/out")
    for number in range(6):
        plc.write({"data": number})
        wait_for(lambda number=number: number in numbers(messages))
        wait_for(lambda: numbers(messages)[-1] == -7)
    assert [number for number in numbers(messages) if number != -7] == list(range(6))


def test_what_waits_for_a_subscriber_comes_before_the_substitute(cell: Cell) -> None:
    """A message that the PLC sent at the start is not overtaken by its substitute."""
    bridge = cell.start(SUBSTITUTED)
    cell.plc("/out").write({"data": 5})
    wait_for(lambda: bridge.status().topic("/out").substituted >= 2)
    messages = cell.listen("/out", INT, Qos("reliable", "transient_local", 1000))
    heard = numbers(wait_for(lambda: len(messages) > 2 and messages))
    assert (heard[0], set(heard[1:])) == (5, {-7})


def test_without_being_asked_for_nothing_is_published(cell: Cell) -> None:
    """By default a PLC that is silent leaves ROS without messages, and there is no flag either."""
    bridge = cell.start(f"  /out: {{type: {INT}, to: ros, stale_after: 20ms}}\n")
    messages = cell.listen("/out", INT)
    wait_for(lambda: bridge.status().topic("/out").silent)
    assert messages == []
    assert "/out/substituted" not in cell.peer.graph().topics
    assert bridge.status().topic("/out").substituted == 0


def test_a_message_after_a_substitute_is_news_though_it_equals_the_last(cell: Cell) -> None:
    """On_change compares with what ROS got last, and that was the substitute."""
    cell.start(SUBSTITUTED.replace("to: ros", "to: ros, on_change: true"))
    messages = cell.listen("/out", INT)
    plc = cell.plc("/out")
    plc.write({"data": 1})
    wait_for(lambda: 1 in numbers(messages) and numbers(messages)[-1] == -7)
    plc.write({"data": 1})
    wait_for(lambda: numbers(messages).count(1) == 2)


def test_the_first_message_after_silence_is_marked_for_the_plc(cell: Cell) -> None:
    """The mark comes with the first message after the source was stale, without a restart of the bridge."""
    bridge = cell.start(f"  /in: {{type: {INT}, to: plc, stale_after: 300ms}}\n")
    plc = cell.plc("/in")
    publisher = cell.publisher("/in", INT)
    publisher.write(wire(INT, {"data": 1}))
    assert mark_of(plc) == FLAG_FIRST
    wait_for(lambda: bridge.status().topic("/in").stale)
    publisher.write(wire(INT, {"data": 2}))
    assert mark_of(plc) == FLAG_FIRST
    assert bridge.status().topic("/in").recovered == 1


def test_the_first_message_of_another_publisher_is_marked(cell: Cell) -> None:
    """Once the bridge has seen that nobody publishes, the next one begins again."""
    cell.start(f"  /in: {{type: {INT}, to: plc, stale_after: never}}\n")
    plc = cell.plc("/in")
    publisher = cell.publisher("/in", INT)
    publisher.write(wire(INT, {"data": 1}))
    assert mark_of(plc) == FLAG_FIRST
    wait_for(lambda: plc.attached.snapshot().writer.sources == 1)
    publisher.write(wire(INT, {"data": 2}))
    assert mark_of(plc) == 0
    publisher.close()
    wait_for(lambda: plc.attached.snapshot().writer.sources == 0)
    cell.publisher("/in", INT).write(wire(INT, {"data": 3}))
    assert mark_of(plc) == FLAG_FIRST


def test_one_late_message_changes_no_level(shm_namespace: Namespace) -> None:
    """Silence is reported once it outlasts stale_after and the debounce, and is over as slowly."""
    (plan,) = resolve(parse_config(f"topics:\n  /in: {{type: {INT}, to: plc, stale_after: 200ms}}\n")).topics
    clock = SteppedClock()
    context = Context(shm_namespace, "cell", bytes(16), "jazzy", debounce_ns=1000 * MS, clock=clock)
    stream = Carriers(context, MS).make(plan)
    assert isinstance(stream, ToPlc)
    seen = []
    for at in range(0, 6000, 100):
        # On time, once late, on time, silent for two seconds, on time, once late, on time.
        if not (1000 < at <= 1400 or 2000 < at < 4000 or 4300 < at <= 4700):
            stream.on_message(b"", 0)
        status = stream.status(clock.advance(ns=1))
        clock.advance(ns=100 * MS - 1)
        if not seen or seen[-1][1:] != (status.stale, status.silent):
            seen.append((at, status.stale, status.silent))
    assert seen == [
        (0, False, False),
        (1200, True, False),  # late, but for no longer than the debounce
        (1500, False, False),
        (2200, True, False),
        (3200, True, True),  # silent for 200 ms and the debounce
        (4000, False, True),  # speaks again
        (4500, True, True),  # and stops before that counted
        (4800, False, True),
        (5800, False, False),  # a second after it began to speak without a gap
    ]
    assert stream.counters.recovered == 3


def test_a_plc_that_stopped_is_an_error_and_one_that_never_ran_is_not(cell: Cell) -> None:
    """Both sides of the PLC are watched: who was there and is gone is told apart from who never came."""
    bridge = cell.start(f"  /out: {{type: {INT}, to: ros}}\n  /never: {{type: {INT}, to: ros}}\n")
    plc = cell.plc("/out")
    assert plc.writer is not None

    def alive() -> bool:
        assert plc.writer is not None
        plc.writer.beat()
        return bool(bridge.status().topic("/out").peer_alive)

    wait_for(alive)
    assert bridge.status().topic("/out").peer_gone_ns is None
    plc.writer.release()
    wait_for(lambda: bridge.status().topic("/out").peer_gone_ns is not None)
    assert bridge.status().topic("/out").judgement[0] is Level.ERROR
    assert bridge.status().topic("/never").judgement[0] is Level.WARN
    assert bridge.status().topic("/never").peer_gone_ns is None


@pytest.mark.parametrize(("beat_ms", "lives"), [(0, True), (100, False)])
def test_a_client_that_writes_rarely_is_not_called_dead(beat_ms: int, lives: bool) -> None:
    """A writer without a promised beat lives until it gives its claim up; one with a promise must keep it."""
    words = {"head": 1, "epoch": 77, "beat": 0, "beat_ms": beat_ms}
    region = SimpleNamespace(words=lambda *_: tuple(words.values()), word=lambda _: 0)
    channel = SimpleNamespace(region=region, process=WriterProcess(0, 0))
    port = object.__new__(PortToRos)
    port._peers, port._lived = defaultdict(Peer), 0
    assert not port._observe(channel, 0), "it may be what a dead one has left"  # type: ignore[arg-type]
    words["head"] += 1
    assert port._observe(channel, 10**9)  # type: ignore[arg-type]
    assert port._observe(channel, 3600 * 10**9) is lives  # type: ignore[arg-type]
    words["epoch"] = 0
    assert not port._observe(channel, 3601 * 10**9)  # type: ignore[arg-type]


CLIENT = """
import sys, rosplc
with rosplc.attach("/out", prefix=sys.argv[1], write=True) as channel:
    for line in sys.stdin:
        channel.write({"data": int(line)})
        print("written", flush=True)
"""


def test_a_client_that_writes_rarely_is_missed_once_it_was_killed(cell: Cell) -> None:
    """Bridge and views go by the process of a writer that promises no beat, however long it is quiet."""
    bridge = cell.start(f"  /out: {{type: {INT}, to: ros}}\n")
    command = [sys.executable, "-c", CLIENT, cell.namespace.prefix]
    clock = SteppedClock()

    def alive() -> bool | None:
        return watch.look().channels[0].writer_alive

    with (
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as client,
        Watch(cell.namespace.prefix, clock=clock) as watch,
    ):
        assert client.stdin is not None
        assert client.stdout is not None
        try:
            client.stdin.write("1\n")
            client.stdin.flush()
            assert client.stdout.readline() == "written\n"
            wait_for(lambda: bridge.status().topic("/out").peer_alive)
            for _ in range(3):
                clock.advance(60)
                assert alive()
        finally:
            client.kill()
        wait_for(lambda: bridge.status().topic("/out").peer_gone_ns is not None)
        assert bridge.status().topic("/out").judgement[0] is Level.ERROR
        assert not alive()


@pytest.mark.parametrize("pid", [0, os.getppid(), 2**22 - 1, 2**32 - 1])
def test_of_a_process_that_has_not_the_object_mapped_nothing_is_claimed(cell: Cell, pid: int) -> None:
    """A number may be damaged, or mean another process in this PID namespace."""
    cell.start(f"  /out: {{type: {INT}, to: ros}}\n")
    process = cell.plc("/out").attached.process
    assert process.runs(77, pid) is None
    assert process.runs(77, os.getpid()) is True
    assert process.runs(78, pid) is None
