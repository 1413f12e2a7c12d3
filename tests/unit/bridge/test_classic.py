"""Classic topics of a running bridge: what is carried, what is noticed, what is said of it."""

from __future__ import annotations

import os
import subprocess
import threading
import time
from pathlib import Path

import posix_ipc
import pytest

from rosplc.bridge import Bridge
from rosplc.bridge.diagnostics import diagnostic_status
from rosplc.bridge.status import Level
from rosplc.errors import ChannelError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import DEFAULT
from rosplc.shm import Namespace, attach
from tests.classic_cell import SIZE, WORDS, ClassicCell, remove, unique_name
from tests.lib.waiting import wait_for

FAST = "recover_after: 150ms, wait: 2ms"


def full(number: int) -> bytes:
    """Return a record with one number in every word."""
    return number.to_bytes(4, "little") * WORDS


def replace_semaphore(name: str) -> None:
    """Do what the thesis' class does at every start."""
    posix_ipc.unlink_semaphore(f"/{name}")
    posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, mode=0o600, initial_value=1).close()


def test_messages_go_both_ways(tmp_path: Path) -> None:
    """A message is in the memory as the record's bytes at offset 0; a changed image is a message."""
    with ClassicCell(tmp_path, "plc") as cell:
        assert cell.image == bytes(SIZE)
        cell.publish(5)
        wait_for(lambda: cell.image == full(5))
        wait_for(lambda: cell.status.published == 1)
    with ClassicCell(tmp_path, "ros") as cell:
        for number in (1, 2, 3):
            cell.write(number)
            wait_for(lambda number=number: cell.got[-1:] == [number])
        assert cell.got == [1, 2, 3]


@pytest.mark.parametrize("to", ["plc", "ros"])
def test_what_stood_there_before_is_no_message(tmp_path: Path, to: str) -> None:
    """A bridge that starts later invents nothing and changes nothing."""
    name = unique_name()
    Path(f"/dev/shm/{name}").write_bytes(full(9))
    with ClassicCell(tmp_path, to, name=name) as cell:
        cell.turns()
        assert cell.got == [] and cell.image == full(9)
        if to == "ros":
            cell.write(10)
            wait_for(lambda: cell.got == [10])


def test_what_stood_there_before_is_a_message_where_that_is_asked_for(tmp_path: Path) -> None:
    """latched: true makes the image that the bridge finds a message."""
    name = unique_name()
    Path(f"/dev/shm/{name}").write_bytes(full(9))
    with ClassicCell(tmp_path, "ros", entry="latched: true", name=name) as cell:
        wait_for(lambda: cell.got == [9])


def test_a_memory_made_again_is_followed_towards_ros(tmp_path: Path) -> None:
    """Its zeros are no message; what is written into it is."""
    with ClassicCell(tmp_path, "ros") as cell:
        for number in range(1, 6):
            cell.path.unlink()
            if number % 2:
                cell.path.write_bytes(bytes(SIZE))
            wait_for(cell.path.exists)
            cell.write(number)
            wait_for(lambda number=number: cell.got[-1:] == [number])
        assert cell.got == [1, 2, 3, 4, 5]


@pytest.mark.parametrize(("entry", "image"), [("", bytes(SIZE)), ("latched: true", full(1))])
def test_a_memory_made_again_is_followed_towards_the_plc(tmp_path: Path, entry: str, image: bytes) -> None:
    """The next message goes into the new memory; the last one does only where that is asked for."""
    with ClassicCell(tmp_path, "plc", entry=entry) as cell:
        cell.publish(1)
        wait_for(lambda: cell.status.published == 1)
        cell.path.unlink()
        wait_for(cell.path.exists)
        wait_for(lambda: cell.image == image)
        cell.turns()
        assert cell.image == image
        cell.publish(2)
        wait_for(lambda: cell.image == full(2))


@pytest.mark.parametrize("to", ["plc", "ros"])
def test_a_semaphore_made_again_is_followed(tmp_path: Path, to: str) -> None:
    """Messages go on under the new lock, and no old image becomes a message."""
    with ClassicCell(tmp_path, to) as cell:
        for number in range(1, 6):
            replace_semaphore(cell.name)
            if to == "plc":
                cell.publish(number)
                wait_for(lambda number=number: cell.image == full(number))
            else:
                cell.write(number)
                wait_for(lambda number=number: cell.got[-1:] == [number])
        posix_ipc.unlink_semaphore(f"/{cell.name}")
        wait_for(Path(f"/dev/shm/sem.{cell.name}").exists, "the bridge to make one")
        assert to == "plc" or cell.got == [1, 2, 3, 4, 5]


def test_an_image_left_by_one_that_died_with_the_old_semaphore_is_no_message(tmp_path: Path) -> None:
    """If the lock was taken when it was replaced, what is there may be half written."""
    with ClassicCell(tmp_path, "ros", "recover_after: 1h") as cell:
        cell.write(1)
        wait_for(lambda: cell.got == [1])
        posix_ipc.Semaphore(f"/{cell.name}").acquire(1)
        with cell.path.open("r+b") as file:
            file.write(full(2)[: SIZE // 2])
        wait_for(lambda: cell.classic.timeouts)
        replace_semaphore(cell.name)
        cell.turns()
        assert cell.got == [1]
        cell.write(3)
        wait_for(lambda: cell.got == [1, 3])


@pytest.mark.parametrize("to", ["plc", "ros"])
def test_a_memory_that_is_too_small_is_named_with_both_sizes(tmp_path: Path, to: str) -> None:
    """The topic is not carried until the other side has the right size; others are."""
    name = unique_name()
    Path(f"/dev/shm/{name}").write_bytes(bytes(100))
    with ClassicCell(tmp_path, to, name=name) as cell:
        wait_for(lambda: cell.status.problem)
        assert cell.status.judgement == (
            Level.ERROR,
            f"the memory has 100 bytes, but the record needs {SIZE} [SHM129]",
        )
        assert not cell.classic.attached
        if to == "plc":
            for number in (1, 2, 3):
                cell.publish(number)
        os.truncate(cell.path, SIZE)
        wait_for(lambda: not cell.status.problem)
        if to == "plc":
            wait_for(lambda: cell.image == full(3))
            assert cell.status.lost == 2
        else:
            cell.write(4)
            wait_for(lambda: cell.got == [4])


@pytest.mark.parametrize("to", ["plc", "ros"])
def test_a_memory_that_shrinks_in_use_is_named(tmp_path: Path, to: str) -> None:
    """A peer with a smaller struct calls ftruncate while the bridge reads and writes."""
    with ClassicCell(tmp_path, to) as cell:
        os.truncate(cell.path, 12)
        cell.publish(1) if to == "plc" else None
        wait_for(lambda: "12 bytes" in cell.status.problem)
        assert cell.path.stat().st_size == 12


def test_an_odd_size_is_named(tmp_path: Path) -> None:
    """A larger memory is carried; if it is not larger by whole pages the other struct is suspected."""
    name = unique_name()
    Path(f"/dev/shm/{name}").write_bytes(bytes(SIZE + 8))
    with ClassicCell(tmp_path, "plc", name=name) as cell:
        assert (cell.status.code, cell.status.problem) == ("SHM130", "")
        cell.publish(1)
        wait_for(lambda: cell.image == full(1) + bytes(8))


def test_the_newest_waits_for_the_lock(tmp_path: Path) -> None:
    """While the lock is taken messages are lost but for the newest, which is written when it is free."""
    with ClassicCell(tmp_path, "plc", "recover_after: 1h, wait: 1ms") as cell:
        semaphore = posix_ipc.Semaphore(f"/{cell.name}")
        semaphore.acquire(1)
        cell.publish(1)
        wait_for(lambda: cell.classic.timeouts == 1)
        for number in range(2, 6):
            cell.publish(number)
        cell.turns()
        assert cell.image == bytes(SIZE)
        semaphore.release()
        wait_for(lambda: cell.image == full(5))
        wait_for(lambda: cell.status.published == 1)
        assert cell.status.lost == 4
        assert cell.status.code == "SHM127" or cell.status.recent


def test_a_lock_that_is_held_delays_no_other_topic(tmp_path: Path) -> None:
    """Classic and default topics of the same bridge go on in both directions beside one that waits."""
    other = unique_name()
    more = (
        f"  /classic: {{type: cell_msgs/msg/Words, to: plc, classic: {{name: {other}}}}}\n"
        "  /default: {type: cell_msgs/msg/Words, to: plc}\n"
        "  /back: {type: cell_msgs/msg/Words, to: ros}\n"
    )
    try:
        with ClassicCell(tmp_path, "plc", "recover_after: 1h, wait: 1s", more=more) as cell:
            posix_ipc.Semaphore(f"/{cell.name}").acquire(1)
            cell.publish(1)
            back: list[bytes] = []
            cell.ros.subscribe("/back", cell.plan.type_name, DEFAULT, lambda data, _: back.append(data))
            message = cell.codec.encode(full(2))
            for topic in ("/classic", "/default"):
                cell.ros.advertise(topic, cell.plan.type_name, DEFAULT).write(message, 0)
            record = bytearray(SIZE)
            namespace = Namespace(cell.name)
            with attach(namespace, "/default") as found, attach(namespace, "/back", write=True) as out:
                reader = found.reader()
                reader.peek(record)
                out.writer(1000).publish(full(3))
                wait_for(lambda: reader.peek(record) is not None and bytes(record) == full(2))
            wait_for(lambda: Path(f"/dev/shm/{other}").read_bytes() == full(2))
            wait_for(lambda: back == [cell.codec.encode(full(3))])
            assert cell.image == bytes(SIZE)  # still held
    finally:
        remove(other)


def test_every_look_is_a_message_where_that_is_asked_for(tmp_path: Path) -> None:
    """on_change: false publishes what is there at every look, as the thesis' class does."""
    with ClassicCell(tmp_path, "ros", entry="on_change: false, expected_rate: 100Hz") as cell:
        cell.write(1)
        wait_for(lambda: cell.got.count(1) > 5)


def test_a_rate_limit_keeps_the_newest(tmp_path: Path) -> None:
    """Towards ROS and the PLC alike no more pass than the rate allows, and the last is never dropped."""
    with ClassicCell(tmp_path, "ros", entry="rate_limit: 100ms") as cell:
        began = time.monotonic()
        cell.write(1)
        wait_for(lambda: cell.got == [1])
        for number in range(2, 31):
            cell.write(number)
        wait_for(lambda: cell.got[-1:] == [30])
        assert 2 <= len(cell.got) <= 2 + (time.monotonic() - began) / 0.1
    with ClassicCell(tmp_path, "plc", entry="rate_limit: 100ms") as cell:
        began = time.monotonic()
        for number in range(1, 31):
            cell.publish(number)
        wait_for(lambda: cell.image == full(30))
        wait_for(lambda: cell.status.published + cell.status.skipped == 30)
        assert cell.status.lost == 0 and cell.status.published <= 2 + (time.monotonic() - began) / 0.1


def test_a_message_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    """It is counted and named, and the memory keeps what it had."""
    with ClassicCell(tmp_path, "plc") as cell:
        cell.publish(1)
        wait_for(lambda: cell.status.published == 1)
        cell._publisher.write(b"\0\1\0\0short", 0)
        wait_for(lambda: cell.status.refused == 1)
        assert cell.status.code == "COD001" and cell.image == full(1)


def test_staleness_goes_by_the_last_change(tmp_path: Path) -> None:
    """There is no beat in such a memory: whether the PLC lives is not known, and nothing else is said."""
    with ClassicCell(tmp_path, "ros", entry="stale_after: 100ms") as cell:
        cell.write(1)
        wait_for(lambda: cell.got == [1])
        assert cell.status.peer_alive is None
        wait_for(lambda: cell.status.silent)
        assert cell.status.judgement[0] is Level.STALE
        document = cell.bridge.status().to_dict()["topics"][0]
        assert document["peer_alive"] is None and document["classic"]["memory"] == cell.name


def test_diagnostics_say_what_is_known(tmp_path: Path) -> None:
    """Memory, lock and what was corrected are beside the topic's counters, within what a message holds."""
    with ClassicCell(tmp_path, "plc", FAST) as cell:
        posix_ipc.Semaphore(f"/{cell.name}").release()
        wait_for(lambda: cell.classic.mended == 1)
        values = diagnostic_status(cell.bridge.status().topics[0], "cell")["values"]
        assert values["PLC alive"] == "unknown"
        assert values["classic memory"] == f"{cell.name}, {SIZE} bytes"
        assert "corrected: 1" in values["lock"]
        assert len(values) <= 20


def test_a_second_bridge_on_one_memory_is_refused(tmp_path: Path) -> None:
    """Two bridges that write one record would overwrite each other."""
    with ClassicCell(tmp_path, "plc") as cell:
        second = Bridge(cell.project, cell._bridge_side)
        with pytest.raises(ChannelError) as error:
            second.start()
        assert error.value.code == "SHM116"
        cell.publish(1)
        wait_for(lambda: cell.image == full(1))


def test_a_bridge_can_be_started_again(tmp_path: Path) -> None:
    """Stopping leaves memory and semaphore; starting again goes on, and no thread is left behind."""
    before = threading.active_count()
    with ClassicCell(tmp_path, "ros") as cell:
        cell.write(1)
        wait_for(lambda: cell.got == [1])
        cell.bridge.stop()
        assert cell.path.exists()
        cell.write(2)
        cell.bridge.start()
        cell.turns()
        cell.write(3)
        wait_for(lambda: cell.got == [1, 3])
    wait_for(lambda: threading.active_count() <= before)


ROBIN_MSG = """\
bool flag
byte raw
int16 small
uint64 large
float32 single
float64 double
string label
geometry_msgs/Pose pose
string[5] names
"""

ROBIN_C = """
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
struct Pose { double position[3]; double orientation[4]; };
struct Test {
    uint8_t flag; int8_t raw; int16_t small; uint64_t large; float single; double twice;
    char label[81]; struct Pose pose; char names[5][81];
};
#define AT(member) printf("%zu\\n", offsetof(struct Test, member))
int main(void) {
    AT(flag); AT(raw); AT(small); AT(large); AT(single); AT(twice); AT(label); AT(pose); AT(names);
    printf("%zu\\n", sizeof(struct Test));
}
"""


def test_a_struct_as_robin_writes_it_has_the_records_layout(tmp_path: Path) -> None:
    """char[81] is a string with the limit 80; nested structs and fixed arrays lie as a compiler puts them."""
    folder = tmp_path / "robin_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Test.msg").write_text(ROBIN_MSG)
    (tmp_path / "test.c").write_text(ROBIN_C)
    subprocess.run(["gcc", "-o", tmp_path / "test", tmp_path / "test.c"], check=True)
    printed = subprocess.run([tmp_path / "test"], check=True, capture_output=True, text=True).stdout.split()
    store = TypeStore.bundled("noetic").with_paths([tmp_path])
    layout = compute_layout(store, "robin_msgs/msg/Test", Limits(string=80))
    offsets = {path: offset for path, offset, _ in layout.fields()}
    names = ("flag", "raw", "small", "large", "single", "double", "label", "pose.position.x", "names")
    assert [offsets[name] for name in names] == [int(number) for number in printed[:-1]]
    assert layout.size == int(printed[-1])
