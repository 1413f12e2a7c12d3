"""A bridge that dies: spec/shm-format.md, M1, M15, M19 and section 8."""

from __future__ import annotations

import random
import time
from pathlib import Path

import pytest

from rosplc.errors import ChannelError
from rosplc.shm import Direction, Namespace, attach
from tests.lib.channels import is_torn, open_channel, pattern, start_child, until

pytestmark = pytest.mark.verifies("kills", own="SIGKILL at random times, with counted messages")

_TOPIC = "/robot1/cmd_vel"

# Owns the channel towards the PLC and publishes its sequence numbers.
_TO_PLC = """
import sys
from rosplc.shm import Namespace
from tests.lib.channels import open_channel, pattern
channel = open_channel(Namespace(sys.argv[1]), record_size=4096)
writer = channel.writer(beat_ms=50)
print("ready", channel.adopted, writer.head, flush=True)
while True:
    writer.publish(pattern(writer.head + 1, 4096))
"""

# Owns the channel towards ROS and prints what it takes: what was printed counts as sent.
_TO_ROS = """
import sys
from rosplc.shm import Direction, Namespace
from tests.lib.channels import open_channel
channel = open_channel(Namespace(sys.argv[1]), Direction.TO_ROS, slots=64)
reader = channel.reader()
out = bytearray(64)
print("ready", flush=True)
while True:
    info = reader.next(out)
    if info:
        print("sent", info.sequence, int.from_bytes(out[:8], "little"), flush=True)
"""

# Creates objects of changing layouts as fast as it can.
_CREATOR = """
import sys
from rosplc.shm import Namespace
from tests.lib.channels import open_channel
print("ready", flush=True)
number = int(sys.argv[2])
while True:
    number += 1
    open_channel(Namespace(sys.argv[1]), record_size=4096, layout_id=f"{number:016x}").close()
"""


def _adopt_after_kills(namespace: Namespace, times: int) -> None:
    delays = random.Random(times)
    out = bytearray(4096)
    child = start_child(_TO_PLC, namespace.prefix)
    assert until(child, "ready") == "ready False 0"
    with attach(namespace, _TOPIC) as attached:
        reader = attached.reader()
        for _ in range(times):
            deadline = time.monotonic() + delays.uniform(0.0, 0.03)
            while time.monotonic() < deadline:
                before = reader.last
                info = reader.next(out)
                if info is not None:
                    assert not is_torn(out)
                    assert int.from_bytes(out[:8], "little") == info.sequence
                    assert before == 0 or info.sequence == before + info.lost + 1
            child.kill()
            child.wait()
            head = attached.snapshot().writer.head
            child = start_child(_TO_PLC, namespace.prefix)
            # The claim of the dead one holds up nobody: the lock says that it is dead.
            assert until(child, "ready") == f"ready True {head}"
            attached.valid()
            assert attached.still_there()
        child.kill()
        child.wait()
        assert reader.discontinuities == 0


def test_killed_bridge_is_succeeded(shm_namespace: Namespace) -> None:
    """The next bridge adopts the object and goes on; an attached PLC notices nothing but a pause."""
    _adopt_after_kills(shm_namespace, 10)


@pytest.mark.verify(minutes=1)
def test_bridge_killed_two_hundred_times(shm_namespace: Namespace) -> None:
    """The same, two hundred times."""
    _adopt_after_kills(shm_namespace, 200)


def _numbers(lines: list[str]) -> list[int]:
    """The sequences of whole lines "sent <sequence> <content>", which must agree."""
    words = [line.split() for line in lines if line.startswith("sent") and line.endswith("\n")]
    assert all(sequence == content for _, sequence, content in words)
    return [int(sequence) for _, sequence, _ in words]


def test_at_most_once_across_kills(shm_namespace: Namespace) -> None:
    """A killed bridge sends nothing twice, and at most one message per kill is lost (M15)."""
    kills = 8
    child = start_child(_TO_ROS, shm_namespace.prefix)
    until(child, "ready")
    sent: list[int] = []
    with attach(shm_namespace, _TOPIC, write=True) as attached:
        writer = attached.writer()
        for _ in range(kills):
            for _ in range(20):
                writer.publish(pattern(writer.head + 1, 64))
                time.sleep(0.0005)
            child.kill()
            child.wait()
            assert child.stdout is not None
            sent += _numbers(child.stdout.readlines())
            child = start_child(_TO_ROS, shm_namespace.prefix)
            until(child, "ready")
        total = writer.publish(pattern(writer.head + 1, 64))
        while not sent or sent[-1] != total:
            sent += _numbers([until(child, "sent") + "\n"])
        child.kill()
        child.wait()
    assert sent == sorted(set(sent)), "something was sent twice or out of order"
    assert len(sent) >= total - kills


def test_killed_during_creation(shm_namespace: Namespace) -> None:
    """Whenever a creator is killed, the name leads to a complete object or to none, and nothing piles up."""
    delays = random.Random(5)
    seen: set[str] = set()
    for round_ in range(12):
        child = start_child(_CREATOR, shm_namespace.prefix, round_ * 1_000_000)
        until(child, "ready")
        deadline = time.monotonic() + delays.uniform(0.0, 0.05)
        while time.monotonic() < deadline:
            try:
                with attach(shm_namespace, _TOPIC) as attached:
                    seen.add(attached.identity.layout_id)
                    assert attached.description.layout_id == attached.identity.layout_id
            except ChannelError as error:
                # Retired is what a reader may meet between its replacement's two steps.
                assert error.code in ("SHM101", "SHM111"), error
        child.kill()
        child.wait()
    with open_channel(shm_namespace) as channel:
        assert channel.still_there()
        names = sorted(path.name for path in Path("/dev/shm").glob(f"{shm_namespace.prefix}.*"))
        assert [name.split(".")[1] for name in names] == ["l", "t"]
    assert len(seen) > 1


def test_layout_change_while_attached(shm_namespace: Namespace) -> None:
    """One that is attached when the layout changes sees SHM111, opens again, and reads the new messages."""
    open_channel(shm_namespace).close()
    script = """
import sys
from rosplc.errors import ChannelError
from rosplc.shm import Namespace, attach
namespace = Namespace(sys.argv[1])
attached = attach(namespace, sys.argv[2])
reader = attached.reader(latched=True)
print("attached", attached.identity.record_size, flush=True)
while True:
    try:
        info = reader.latest(bytearray(attached.identity.record_size))
    except ChannelError as error:
        print("error", error.code, flush=True)
        attached.close()
        while True:
            try:
                attached = attach(namespace, sys.argv[2])
                break
            except ChannelError as error:
                assert error.code in ("SHM101", "SHM111"), error
        reader = attached.reader(latched=True)
        print("attached", attached.identity.record_size, flush=True)
        continue
    if info:
        print("read", info.sequence, flush=True)
"""
    child = start_child(script, shm_namespace.prefix, _TOPIC)
    assert until(child, "attached") == "attached 64"
    for size in (128, 256, 64):
        with open_channel(shm_namespace, record_size=size, layout_id=f"{size:016x}") as channel:
            assert until(child, "error") == "error SHM111"
            assert until(child, "attached") == f"attached {size}"
            channel.writer().publish(bytes(size))
            assert until(child, "read") == "read 1"
    child.kill()
    child.wait()


def test_two_bridges_race_for_one_name(shm_namespace: Namespace) -> None:
    """Of bridges that start together exactly one gets the name, and the next when it has died."""
    script = """
import sys
from rosplc.errors import ChannelError
from rosplc.shm import Direction, Namespace
from tests.lib.channels import open_channel
sys.stdin.readline()
try:
    channel = open_channel(Namespace(sys.argv[1]))
    print("answer mine", flush=True)
    sys.stdin.read()
except ChannelError as error:
    print("answer", error.code, flush=True)
"""
    for _ in range(3):
        children = [start_child(script, shm_namespace.prefix) for _ in range(3)]
        for child in children:
            assert child.stdin is not None
            child.stdin.write("go\n")
            child.stdin.flush()
        answers = sorted(until(child, "answer") for child in children)
        assert answers == ["answer SHM116", "answer SHM116", "answer mine"]
        for child in children:
            child.kill()
            child.communicate()


def test_swept_object_is_made_anew(shm_namespace: Namespace) -> None:
    """A bridge whose object was swept from the directory makes another, which a PLC finds and writes."""
    channel = open_channel(shm_namespace, Direction.TO_ROS)
    shm_namespace.path(_TOPIC).unlink()
    assert not channel.still_there()
    channel.close()
    with (
        open_channel(shm_namespace, Direction.TO_ROS) as channel,
        attach(shm_namespace, _TOPIC, write=True) as attached,
    ):
        reader = channel.reader()
        attached.writer().publish(pattern(1, 64))
        assert reader.next(bytearray(64)) is not None
