"""A writer that dies at any instruction: spec/shm-format.md, M6, M7, M12 and M18."""

from __future__ import annotations

import random
import subprocess
import time

import pytest

from rosplc.shm import Direction, Namespace, attach
from tests.lib.channels import is_torn, open_channel, start_child, until
from tests.lib.waiting import WATCHDOG_S

pytestmark = pytest.mark.verifies("kills", own="SIGKILL at random times, with counted messages")

_TOPIC = "/robot1/cmd_vel"

# Publishes numbers in order, each filling a record, from the sequence that the channel is at.
_WRITER = """
import sys
from rosplc.errors import ChannelError
from rosplc.shm import Namespace, attach
from tests.lib.channels import pattern
attached = attach(Namespace(sys.argv[1]), sys.argv[2], write=True)
size = attached.identity.record_size
while True:
    try:
        writer = attached.writer(beat_ms=1)
        break
    except ChannelError as error:
        assert error.code == "SHM114", error  # the one before is still to die
print("ready", writer.head, flush=True)
while True:
    writer.publish(pattern(writer.head + 1, size))
"""


def _kills(namespace: Namespace, size: int, times: int, seed: int) -> None:
    """Kill a writer ``times`` times, and check every message that readers accept in between."""
    delays = random.Random(seed)
    out = bytearray(size)
    accepted = 0
    restarts = 0
    with (
        open_channel(namespace, Direction.TO_ROS, record_size=size) as channel,
        attach(namespace, _TOPIC) as attached,
    ):
        in_order, newest = channel.reader(), attached.reader()
        child: subprocess.Popen[str] = start_child(_WRITER, namespace.prefix, _TOPIC)
        for _ in range(times):
            head_seen = int(until(child, "ready").split()[1])
            assert head_seen == channel.snapshot().writer.head or channel.snapshot().writer.head > head_seen
            last_before = in_order.last
            # The next one starts now, and waits for the claim of the one that is about to die.
            successor = start_child(_WRITER, namespace.prefix, _TOPIC)
            deadline = time.monotonic() + delays.uniform(0.0, 0.02)
            while time.monotonic() < deadline or in_order.last == last_before:
                assert time.monotonic() < deadline + WATCHDOG_S, "the writer writes no more"
                for reader, take in ((in_order, in_order.next), (newest, newest.latest)):
                    before = reader.last
                    info = take(out)
                    if info is None:
                        continue
                    accepted += 1
                    assert not is_torn(out), "half a message was accepted"
                    assert int.from_bytes(out[:8], "little") == info.sequence, "not the message it says"
                    assert before == 0 or info.sequence == before + info.lost + 1, (
                        "repeated, invented or lost uncounted"
                    )
                    restarts += info.flags & 1 if reader is in_order else 0
            child.kill()
            child.wait()
            head = channel.snapshot().writer.head
            info = newest.peek(out)
            assert info is not None, "the last complete message is gone"
            assert info.sequence == head
            assert not is_torn(out)
            child = successor
        child.kill()
        child.wait()
        assert in_order.discontinuities == newest.discontinuities == 0
    assert accepted > times


@pytest.mark.parametrize(("size", "times"), [(64, 12), (4096, 12), (1 << 20, 12)])
def test_killed_writer(shm_namespace: Namespace, size: int, times: int) -> None:
    """Readers see whole messages in order whenever a writer is killed, and the next one continues."""
    _kills(shm_namespace, size, times, seed=size)


@pytest.mark.verify(minutes=1.5)
@pytest.mark.parametrize(("size", "times"), [(64, 300), (4096, 300), (65536, 200), (1 << 20, 200)])
def test_writer_killed_a_thousand_times(shm_namespace: Namespace, size: int, times: int) -> None:
    """The same, a thousand times in all."""
    _kills(shm_namespace, size, times, seed=size + 1)


@pytest.mark.parametrize("bridge_first", [True, False])
def test_either_side_may_start_first(shm_namespace: Namespace, bridge_first: bool) -> None:
    """A PLC that starts before its bridge finds no object, waits, and then loses nothing."""
    script = """
import sys, time
from rosplc.errors import ChannelError
from rosplc.shm import Namespace, attach
namespace = Namespace(sys.argv[1])
print("started", flush=True)
while True:
    try:
        attached = attach(namespace, sys.argv[2], write=True)
        break
    except ChannelError as error:
        assert error.code == "SHM101", error
        time.sleep(0.01)
attached.writer().publish(bytes(64))
print("sent", flush=True)
sys.stdin.read()
"""
    if bridge_first:
        open_channel(shm_namespace, Direction.TO_ROS).close()
    child = start_child(script, shm_namespace.prefix, _TOPIC)
    until(child, "started")
    with open_channel(shm_namespace, Direction.TO_ROS) as channel:
        reader = channel.reader()
        until(child, "sent")
        info = reader.next(bytearray(64))
        assert info is not None
        assert info.sequence == 1
        child.kill()
        child.wait()
