"""Recorders that are killed, and disks that are full: what was written stays readable."""

from __future__ import annotations

import random
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from rosplc.recorder.store import repair
from rosplc.shm import Namespace
from tests.lib.channels import start_child, until
from tests.lib.isolated import mounted
from tests.lib.waiting import WATCHDOG_S
from tests.unit.recorder.making import Feed, read_from_the_front

pytestmark = pytest.mark.verifies("recorder-killed", own="SIGKILL, full disks, truncated files")

_ROOT = Path(__file__).resolve().parents[2]

_RECORDER = """
import sys, time
from pathlib import Path
from rosplc.recorder import RecordingOptions, Recorder
from rosplc.shm import Namespace
namespace, base = Namespace(sys.argv[1]), Path(sys.argv[2])
recorder = Recorder(RecordingOptions(namespace, base, flush_ns=int(sys.argv[3]), chunk_bytes=4096))
recorder.start()
print("ready", flush=True)
while True:
    time.sleep(0.02)
    recorder.look_after()
"""


@contextmanager
def talking(namespace: Namespace, topics: int = 3) -> Iterator[None]:
    """Publish numbers on some topics all the time."""
    feeds = [Feed(namespace, f"/t{index}", slots=4096) for index in range(topics)]
    stop = threading.Event()

    def talk() -> None:
        number = 0
        while not stop.wait(0.002):
            number += 1
            for feed in feeds:
                feed.number(number)

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        for feed in feeds:
            feed.close()


def gapless(messages: list[tuple[str, int, bytes]]) -> bool:
    """Return whether each topic's sequences follow one another."""
    last: dict[str, int] = {}
    for topic, sequence, _ in messages:
        if topic in last and sequence != last[topic] + 1:
            return False
        last[topic] = sequence
    return True


def kills(namespace: Namespace, folder: Path, times: int, seed: int) -> None:
    """Kill a recorder at random instants, and read what it left."""
    moments = random.Random(seed)
    for number in range(times):
        path = folder / f"k{number}.mcap"
        child = start_child(
            _RECORDER, namespace.prefix, folder / f"k{number}", moments.choice((1, 10**7, 10**8))
        )
        until(child, "ready")
        deadline = time.monotonic() + 60
        while len(before := read_from_the_front(path)) < 10:
            assert time.monotonic() < deadline and child.poll() is None
            time.sleep(0.01)
        time.sleep(moments.uniform(0.0, 0.2))
        size = path.stat().st_size
        child.kill()
        child.communicate()
        left = read_from_the_front(path)
        assert path.stat().st_size >= size and left[: len(before)] == before and gapless(left)
        done = repair(path, folder / f"r{number}.mcap")
        assert done.messages == len(left)
        with AnyReader([done.path]) as bag:
            assert sum(1 for _ in bag.messages()) == len(left)


def test_a_killed_recorder_leaves_a_readable_file(shm_namespace: Namespace, tmp_path: Path) -> None:
    """After kill -9 at any instant mcap reads every message up to it, and rosbags the repaired file."""
    with talking(shm_namespace):
        kills(shm_namespace, tmp_path, 3, seed=1)


@pytest.mark.verify(minutes=0.5)
def test_a_recorder_killed_often(shm_namespace: Namespace, tmp_path: Path) -> None:
    """The same, twelve times, with more topics."""
    with talking(shm_namespace, topics=8):
        kills(shm_namespace, tmp_path, 12, seed=2)


_FULL = """
import sys, time
from pathlib import Path
from rosplc.errors import RecordingError
from rosplc.recorder import RecordingOptions, Recorder
from rosplc.shm import Namespace
options = RecordingOptions(Namespace(sys.argv[1]), Path(sys.argv[2]), flush_ns=10**7, compression="none")
recorder = Recorder(options)
recorder.start()
try:
    end = time.monotonic() + 120
    while time.monotonic() < end:
        time.sleep(0.02)
        recorder.look_after()
    raise SystemExit("it was never full")
except RecordingError as error:
    assert error.code == "REC002", error
    recorder.stop()
    [file] = recorder.result.files
    assert file.complete, file
    topics = recorder.result.topics.values()
    lost = sum(topic.lost for topic in topics)
    assert sum(topic.received for topic in topics) == sum(file.counts.values())
    print("fine", sum(file.counts.values()), recorder.result.lost > 0, flush=True)
"""


def whole(path: Path, count: int) -> None:
    """See that a file is complete and has so many messages."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_summary() is not None
        assert sum(1 for _ in reader.iter_messages()) == count > 0


def test_a_full_disk_ends_a_recording_cleanly(shm_namespace: Namespace, tmp_path: Path) -> None:
    """On a disk that is full the file gets its end and can be read; what did not fit is counted."""
    disk, copy = tmp_path / "disk", tmp_path / "copy.mcap"
    disk.mkdir()
    record = f'"$0" -c "$1" {shm_namespace.prefix} {disk}/a && cp {disk}/a.mcap {copy}'
    with talking(shm_namespace):
        done = mounted(disk, "size=200k", record, sys.executable, _FULL)
    word, count, lost = done.stdout.split()
    assert (word, lost) == ("fine", "True"), done.stderr
    whole(copy, int(count))


def test_a_limit_on_file_sizes_ends_a_recording_cleanly(shm_namespace: Namespace, tmp_path: Path) -> None:
    """A file that may not become larger still gets its end."""
    limited = "import resource, signal\nresource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000))\n" + _FULL
    with talking(shm_namespace):
        child = start_child(limited, shm_namespace.prefix, tmp_path / "a")
        _, count, lost = until(child, "fine").split()
        child.communicate(timeout=WATCHDOG_S)
    assert lost == "True"
    whole(tmp_path / "a.mcap", int(count))
