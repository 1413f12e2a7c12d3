"""Any byte of an object overwritten: spec/shm-format.md, M3, M7, M12 and M16.

The C side's own scribble test runs under sanitizers (tests/unit/core/channel_test.c); here the whole
of bridge, readers and their Python faces must neither crash nor present what was not sent.
"""

from __future__ import annotations

import mmap
import random

import pytest

import rosplc._core as _native
from rosplc.codec import Codec, Wire
from rosplc.errors import ChannelError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Direction, Namespace, OwnedChannel, attach
from tests.lib.channels import open_channel

pytestmark = pytest.mark.verifies("hostile", own="overwritten objects")

_TOPIC = "/robot1/state"
_EXPECTED = {f"SHM{number}" for number in (104, 105, 106, 107, 108, 109, 110, 111, 112, 113, 114, 115)}


@pytest.fixture(scope="module")
def codec() -> Codec:
    store = TypeStore.bundled("jazzy")
    return Codec(compute_layout(store, "sensor_msgs/msg/JointState", Limits(string=15, sequence=4)), Wire.CDR)


def _own(namespace: Namespace, direction: Direction, codec: Codec) -> OwnedChannel:
    return open_channel(namespace, direction, topic=_TOPIC, record_size=codec.layout.size)


def _poke(memory: mmap.mmap, dice: random.Random) -> None:
    """Write a few random bytes, mostly over the control words."""
    for _ in range(dice.randint(1, 4)):
        at = dice.randrange(128, 512) if dice.random() < 0.6 else dice.randrange(len(memory))
        memory[at] = dice.choice((0, 1, 0x7F, 0x80, 0xFF, dice.randrange(256)))


def _round(namespace: Namespace, codec: Codec, dice: random.Random) -> tuple[int, int]:
    """One object, scribbled over while all sides use it; returns how often they succeeded and failed."""
    record = codec.layout.pack({"name": ["a", "b"], "position": [1.0, 2.0]})
    out = bytearray(codec.layout.size)
    done = failed = 0
    with _own(namespace, Direction.TO_ROS, codec) as channel:
        group = _native.Group()
        mine = channel.reader()
        group.add_reader(mine, codec.plan, dice.randint(0, 1))
        with attach(namespace, _TOPIC, write=True) as attached, channel.path.open("r+b") as file:
            reader = attached.reader("observer", observe=False)
            writer = attached.writer(beat_ms=1)
            memory = mmap.mmap(file.fileno(), 0)
            for _ in range(60):
                _poke(memory, dice)
                for call in (
                    lambda: writer.publish(record, stamp_ns=5),
                    group.take,
                    lambda: reader.next(out),
                    lambda: reader.latest(out),
                    lambda: reader.peek(out),
                    lambda: reader.peek_wire(codec.plan),
                    lambda: _native.beat([mine, writer]),
                    lambda: group.wait(0, 0),
                    channel.snapshot,
                    channel.still_there,
                ):
                    try:
                        call()
                        done += 1
                    except ChannelError as error:
                        assert error.code in _EXPECTED
                        failed += 1
                    except _native.Fault:
                        failed += 1
            memory.close()
    # Whatever is left, the next bridge gets a sound object, and messages flow again.
    with (
        _own(namespace, Direction.TO_ROS, codec) as channel,
        attach(namespace, _TOPIC, write=True) as attached,
    ):
        bridge = channel.reader()
        claim = attached.writer_claim()
        writer_again = claim.attempt(0) or claim.attempt(10**12)
        assert writer_again is not None
        for _ in range(2):
            writer_again.publish(record)
        taken = None
        while (message := bridge.next_wire(codec.plan)) is not None:
            taken = message
        assert taken is not None
        assert taken[1].sequence == writer_again.head
        assert taken[0] == codec.encode(record)
        channel.retire()
    return done, failed


def _rounds(namespace: Namespace, codec: Codec, count: int, seed: int) -> None:
    dice = random.Random(seed)
    done = failed = 0
    for _ in range(count):
        more_done, more_failed = _round(namespace, codec, dice)
        done += more_done
        failed += more_failed
    assert done > count * 60
    assert failed > count


def test_scribbled_object(shm_namespace: Namespace, codec: Codec) -> None:
    """Thousands of scribbles later nobody has crashed, and the next bridge carries messages again."""
    _rounds(shm_namespace, codec, 60, seed=1)


@pytest.mark.verify(minutes=1)
def test_scribbled_object_for_long(shm_namespace: Namespace, codec: Codec) -> None:
    """A hundred thousand scribbles."""
    _rounds(shm_namespace, codec, 2000, seed=2)


def test_attach_to_scribbled_objects(shm_namespace: Namespace, codec: Codec) -> None:
    """Attaching to an object with any damage either works or raises one of the format's numbers."""
    dice = random.Random(3)
    with _own(shm_namespace, Direction.TO_PLC, codec) as channel:
        image = channel.path.read_bytes()
    path = shm_namespace.path(_TOPIC)
    outcomes = set()
    for _ in range(3000):
        damaged = bytearray(image)
        for _ in range(dice.randint(1, 3)):
            damaged[dice.randrange(900)] = dice.randrange(256)
        size = dice.choice((len(image), len(image), dice.randrange(len(image))))
        path.write_bytes(damaged[:size])
        try:
            with attach(shm_namespace, _TOPIC) as attached:
                attached.reader(latched=True).latest(bytearray(codec.layout.size))
                outcomes.add("attached")
                _ = attached.description
                outcomes.add("described")
        except ChannelError as error:
            outcomes.add(error.code)
    assert outcomes <= _EXPECTED | {"attached", "described", "SHM103"}
    assert {"attached", "SHM107", "SHM104", "SHM109", "SHM113"} <= outcomes
