"""The product against spec_peer.c, whose author knew the specification alone, and a delayed writer in C."""

from __future__ import annotations

import re
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rosplc.shm import Attached, Description, Direction, Namespace, OwnedChannel, attach
from rosplc.shm.constants import WRITER_LINE
from tests.conformance.test_regions import HOSTILE, TOPIC, VALID, place

pytestmark = pytest.mark.verifies("spec", own="a C peer written from the specification alone")

MESSAGES = 30_000
SIZE = 256
DESCRIPTION = Description("/peer", "std_msgs/msg/Empty", "jazzy", Direction.TO_ROS, {}, "00" * 8, "peer", "")
STARTS = {"from empty": 0, "over the wrap": 2**32 - MESSAGES // 2}


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both programs, compiled."""
    folder = tmp_path_factory.mktemp("peers")
    for name in ("spec_peer", "delayed_writer"):
        source = Path(__file__).with_name(f"{name}.c")
        options = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror"]
        subprocess.run(["gcc", *options, str(source), "-o", str(folder / name)], check=True)
    return folder


@pytest.fixture(params=STARTS)
def channel(request: pytest.FixtureRequest, shm_namespace: Namespace) -> Iterator[OwnedChannel]:
    with OwnedChannel.open(shm_namespace, DESCRIPTION, record_size=SIZE, slots=8) as opened:
        opened.region.store(WRITER_LINE["head"], STARTS[request.param])
        yield opened


def record(number: int) -> bytes:
    return number.to_bytes(8, "little") + bytes([number & 255]) * (SIZE - 8)


@pytest.mark.parametrize("rule", ["fences", "delayed", "handover"])
def test_product_reads_what_the_peer_writes(programs: Path, channel: OwnedChannel, rule: str) -> None:
    """Every message is whole and in order, and what is missed is counted, whatever the writer's rule."""
    reader = channel.reader()
    start, out, taken, number = reader.last, bytearray(SIZE), 0, 0
    command = [str(programs / "delayed_writer"), str(channel.path), str(MESSAGES), rule]
    if rule == "fences":
        command = [str(programs / "spec_peer"), "write", str(channel.path), str(MESSAGES), "20"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as writer:
        while number < MESSAGES and (writer.poll() is None or reader.last != channel.region.word(128)):
            info = reader.next(out)
            if info is None:
                continue
            before, number = number, struct.unpack_from("<Q", out)[0]
            assert out == record(number)
            assert number > before
            if taken or start:
                assert number - before == info.lost + 1
            taken += 1
        _, errors = writer.communicate(timeout=100)
        assert writer.returncode == 0, errors
    assert number == MESSAGES
    assert taken > 100
    assert reader.discontinuities == 0


def test_peer_reads_what_the_product_writes(programs: Path, channel: OwnedChannel) -> None:
    """The peer finds every message whole and in order, and counts exactly what it missed."""
    start = channel.region.word(WRITER_LINE["head"])
    with attach(Namespace(channel.path.name.split(".")[0]), "/peer", write=True) as attached:
        writer = attached.writer()
        command = [str(programs / "spec_peer"), "read", str(channel.path), str(MESSAGES), "100"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as reader:
            while not any(line.claim for line in attached.snapshot().readers):
                assert reader.poll() is None
            taken = 0
            for number in range(1, MESSAGES + 1):
                writer.publish(record(number))
                while number % 100 == 0 and taken == (taken := newest_taken(attached)):  # it has had a turn
                    assert reader.poll() is None
            while attached.snapshot().writer.head != newest_taken(attached):
                assert reader.poll() is None
            reader.terminate()
            output, errors = reader.communicate(timeout=100)
        assert reader.returncode == 0, errors
        counts = dict(re.findall(r"(\w+)=(\d+)", output))
        messages, lost = int(counts["messages"]), int(counts["lost"])
        assert counts["torn"] == counts["discontinuities"] == "0"
        assert "miscounted" not in errors
        assert messages > 100
        assert messages + lost == MESSAGES or (start == 0 and messages + lost < MESSAGES)


def newest_taken(attached: Attached) -> int:
    return max(line.taken for line in attached.snapshot().readers)


def test_peer_reads_every_vector(programs: Path, tmp_path: Path) -> None:
    """The vectors mean to the peer what is written beside them, as they do to the product."""
    for folder, vectors in (("regions", VALID), ("hostile", HOSTILE)):
        for name, vector in vectors.items():
            directory = tmp_path / name
            directory.mkdir()
            place(vector, folder, directory)
            path, expect = Namespace(directory=directory).path(TOPIC), vector.get("expect", {})
            if (error := vector.get("error")) and error != 113:  # the peer has no use for the description
                done = take(programs, path, "newest", 0, expect)
                assert (done.returncode, done.stderr[:7]) == (3, f"SHM{error}:"), name
            for reading in vector.get("readings", ()):
                done = take(programs, path, reading["order"], reading["last"], expect)
                members = ("sequence", "lost", "flags", "stamp_ns", "stamp_clock", "correlation", "record")
                wanted = [" ".join(str(one[member]) for member in members) for one in reading["messages"]]
                end = " ".join(str(reading[member]) for member in ("last_after", "lost", "discontinuities"))
                assert done.stdout.splitlines() == [*wanted, f"end {end}"], (name, reading["order"])


def take(
    programs: Path, path: Path, order: str, last: int, expect: dict[str, Any]
) -> subprocess.CompletedProcess[str]:
    """Let the peer take what a reader of a vector takes."""
    low, high = struct.unpack("<II", bytes.fromhex(expect.get("layout_id", "00" * 8)))
    layout = f"{low:x}:{high:x}" if "layout_id" in expect else "any"
    wanted = [layout, str(expect.get("record_size", 0)), str(expect.get("direction", 0))]
    command = [str(programs / "spec_peer"), "take", str(path), order, str(last), *wanted]
    return subprocess.run(command, capture_output=True, text=True, check=False)
