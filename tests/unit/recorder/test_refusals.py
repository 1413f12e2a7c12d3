"""What cannot be a recording, or is one that somebody damaged, is refused in words that lead somewhere."""

from __future__ import annotations

import os
import random
from collections import Counter
from contextlib import closing
from pathlib import Path

import pytest

from rosplc.errors import RecordingError, RosplcError
from rosplc.recorder.source import open_source
from rosplc.recorder.store import repair
from rosplc.ros.bag import Bag
from tests.e2e.turtle_recording import write_recording
from tests.unit.init.robots import record

MAGIC = b"\x89MCAP0\r\n"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "no such file"),
        (b"", "not an MCAP file"),
        (b"hello, world", "not an MCAP file"),
        (MAGIC, "no complete record"),
        (MAGIC + b"\1" + b"\xff" * 64, "no complete record"),
    ],
)
def test_hopeless_files_are_not_sent_to_their_repair(
    tmp_path: Path, content: bytes | None, says: str
) -> None:
    """Where nothing can be saved, neither replay nor repair advises to repair."""
    path = tmp_path / "a.mcap"
    if content is not None:
        path.write_bytes(content)
    for refuse in (lambda: open_source(path), lambda: repair(path, tmp_path / "b.mcap")):
        with pytest.raises(RecordingError, match="REC003") as caught:
            refuse()
        assert says in caught.value.what and "--repair" not in caught.value.remedy
    assert not (tmp_path / "b.mcap").exists()


def test_what_is_no_plain_file_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    """A pipe, alone or in a folder, a device, and a folder where a file is due: each is an error at once."""
    folder = tmp_path / "folder"
    folder.mkdir()
    pipes = [tmp_path / "a.mcap", tmp_path / "a.bag", tmp_path / "a.db3", folder / "metadata.yaml"]
    for pipe in pipes:
        os.mkfifo(pipe)
    for path in (*pipes[:3], folder, Path("/dev/null")):
        with pytest.raises(RecordingError, match="not a regular file") as caught:
            open_source(path)
        assert caught.value.code == "REC003" and "--repair" not in caught.value.remedy
        with pytest.raises(RosplcError, match="ROS006"):
            Bag(path)
    for path, says in ((pipes[0], "not a regular file"), (folder, "a folder")):
        with pytest.raises(RecordingError, match=says):
            repair(path, tmp_path / "b.mcap")


def damaged(original: bytes, rng: random.Random) -> bytes:
    data = bytearray(original)
    for _ in range(rng.choice((1, 1, 2, 8))):
        data[rng.randrange(len(data))] = rng.choice((0, 0xFF, rng.randrange(256)))
    return bytes(data[: rng.randrange(len(data))] if rng.random() < 0.15 else data)


@pytest.mark.parametrize("kind", ["bag", "db3", "yaml"])
def test_damaged_bags_end_in_an_error_of_ours(tmp_path: Path, kind: str) -> None:
    """Whatever bytes of a bag, of SQLite or of metadata.yaml change: it is read, or refused in words."""
    if kind == "bag":
        path = target = tmp_path / "a.bag"
        write_recording(path, steps=8)
    else:
        path = record(tmp_path / "folder", "sqlite3", count=5)
        (target,) = path.glob(f"*.{kind}")
    original, rng, ended = target.read_bytes(), random.Random(7), Counter[str]()
    for _ in range(60):
        target.write_bytes(damaged(original, rng))
        for read in (replayed, scanned):
            try:
                read(path)
            except RosplcError as error:
                assert error.code == "ROS006"
                ended[error.code] += 1
            else:
                ended["read"] += 1
    assert ended["ROS006"] and ended["read"]


def test_errors_of_libraries_below_become_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of a class that nobody listed, as SQLite's wrapper has them, ends in ROS006 anyway."""
    path = record(tmp_path / "folder", "sqlite3", count=5)

    class ForeignError(Exception):
        """As apsw.CorruptError: derived from nothing that is usual."""

    def corrupt(*_: object, **__: object) -> None:
        raise ForeignError("database disk image is malformed")

    monkeypatch.setattr("rosbags.rosbag2.storage_sqlite3.Sqlite3Reader.messages", corrupt)
    for read in (replayed, scanned):
        with pytest.raises(RosplcError, match="ROS006") as caught:
            read(path)
        assert "malformed" in caught.value.what


def replayed(path: Path) -> None:
    source = open_source(path)
    try:
        for _ in source.messages(set(source.topics), 0, 2**63 - 1):
            pass
    finally:
        source.close()


def scanned(path: Path) -> None:
    with closing(Bag(path)) as bag:
        bag.topics()
        for _ in bag.messages():
            pass
