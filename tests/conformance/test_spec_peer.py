"""The product against spec_peer.c, a writer and a reader in C written from the specification alone."""

from __future__ import annotations

import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.shm import Description, Direction, Namespace, OwnedChannel, attach
from rosplc.shm.constants import WRITER_LINE

SOURCE = Path(__file__).with_name("spec_peer.c")
MESSAGES = 30_000
WORDS = 64
DESCRIPTION = Description("/peer", "std_msgs/msg/Empty", "jazzy", Direction.TO_ROS, {}, "00" * 8, "peer", "")
STARTS = {"from empty": 0, "over the wrap": 2**32 - MESSAGES // 2}


@pytest.fixture(scope="module")
def peer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("peer") / "spec_peer"
    command = ["gcc", "-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror", str(SOURCE), "-o", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


@pytest.fixture(params=STARTS)
def channel(request: pytest.FixtureRequest, shm_namespace: Namespace) -> Iterator[OwnedChannel]:
    with OwnedChannel.open(shm_namespace, DESCRIPTION, record_size=4 * WORDS, slots=8) as opened:
        opened.region.store(WRITER_LINE["head"], STARTS[request.param])
        yield opened


def record(number: int) -> bytes:
    return struct.pack("<I", number) * WORDS


@pytest.mark.parametrize("rule", ["fences", "delayed", "handover"])
def test_product_reads_what_the_peer_writes(peer: Path, channel: OwnedChannel, rule: str) -> None:
    """Every message is whole and in order, and what is missed is counted, whatever the writer's rule."""
    reader = channel.reader()
    start, out, taken, number = reader.last, bytearray(4 * WORDS), 0, 0
    command = [str(peer), "write", str(channel.path), str(MESSAGES), rule]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as writer:
        while number < MESSAGES and (writer.poll() is None or reader.last != channel.region.word(128)):
            info = reader.next(out)
            if info is None:
                continue
            before, number = number, struct.unpack_from("<I", out)[0]
            assert out == record(number)
            assert number > before
            if taken or start:
                assert number - before == info.lost + 1
            taken += 1
        assert writer.wait(100) == 0, writer.stderr and writer.stderr.read()
    assert number == MESSAGES
    assert taken > 100
    assert reader.discontinuities == 0


def test_peer_reads_what_the_product_writes(peer: Path, channel: OwnedChannel) -> None:
    """The peer finds every message whole and in order, and counts exactly what it missed."""
    start = channel.region.word(WRITER_LINE["head"])
    with attach(Namespace(channel.path.name.split(".")[0]), "/peer", write=True) as attached:
        writer = attached.writer()
        command = [str(peer), "read", str(channel.path), str(start), str(MESSAGES)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as reader:
            for number in range(1, MESSAGES + 1):
                writer.publish(record(number))
            output, errors = reader.communicate(timeout=100)
        assert reader.returncode == 0, errors
        taken, lost, discontinuities, last = map(int, output.split())
        assert last == writer.head
        assert discontinuities == 0
        assert taken + lost <= MESSAGES
        assert taken + lost == MESSAGES or start == 0, "what came before its first message is no loss"
