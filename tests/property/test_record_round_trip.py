"""Record, replay, record again: the same bytes, for every bundled type and harder ones."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
from mcap.reader import make_reader

from rosplc.layout import Limits
from rosplc.model import DISTROS
from rosplc.recorder.replay import Player, PlcTarget, ReplayOptions
from rosplc.recorder.source import open_source
from rosplc.shm import Namespace
from tests.codec_oracle import Oracle, random_value
from tests.codec_types import hard_store
from tests.unit.recorder.making import Feed, received, recording, until

pytestmark = pytest.mark.verifies("recordings", real="mcap and rosbags")

_SAMPLES = 3
_STRING, _SEQUENCE = 9, 2


def messages(path: Path) -> dict[str, list[bytes]]:
    """Return each topic's messages, by the mcap library."""
    found: dict[str, list[bytes]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            found.setdefault(channel.topic, []).append(message.data)
    return found


@contextmanager
def beside(namespace: Namespace) -> Iterator[Namespace]:
    """Give another prefix, and remove what is left of it."""
    other = Namespace(namespace.prefix + "x", namespace.directory)
    try:
        yield other
    finally:
        for path in Path(other.directory).glob(f"{other.prefix}.*"):
            path.unlink()


def check(namespace: Namespace, folder: Path, distro: str, names: Sequence[str]) -> None:
    """Send random messages of these types, record and replay them, and compare every byte."""
    store = hard_store(distro)
    oracle = Oracle(store, _STRING, _SEQUENCE)
    topics = {f"/t{index}": name for index, name in enumerate(names)}
    feeds = [
        Feed(namespace, topic, name, slots=8, limits=Limits(_STRING, _SEQUENCE), store=store)
        for topic, name in topics.items()
    ]
    expected: dict[str, list[bytes]] = {}
    with recording(namespace, folder / "one") as recorder:
        for feed in feeds:
            for number in range(_SAMPLES):
                value = random_value(oracle, topics[feed.topic], random.Random(f"{feed.topic} {number}"))
                feed.send(value)
                expected.setdefault(feed.topic, []).append(oracle.cdr(topics[feed.topic], value))
        until(lambda: received(recorder) == len(topics) * _SAMPLES, recorder)
        first = recorder.stop().files[0].path
    for feed in feeds:
        feed.close()
    assert messages(first) == expected
    source = open_source(first)
    assert {name: topic.type_name for name, topic in source.topics.items()} == topics
    with beside(namespace) as other:
        target = PlcTarget(source.topics, other)
        with recording(other, folder / "two") as recorder:
            Player(source, target, source.topics, ReplayOptions(speed=0)).play(lambda _: False)
            until(lambda: received(recorder) == len(topics) * _SAMPLES, recorder)
            second = recorder.stop().files[0].path
        target.close()
    assert messages(second) == expected


@pytest.mark.parametrize("distro", ["jazzy", "noetic"])
def test_a_recording_of_a_replay_has_the_same_bytes(
    shm_namespace: Namespace, tmp_path: Path, distro: str
) -> None:
    """Some types of every run, and all the hard ones: recorded, replayed and recorded again, byte by byte."""
    names = hard_store(distro).names()
    hard = [name for name in names if name.startswith("hard_msgs/")]
    check(shm_namespace, tmp_path, distro, [*hard, *random.Random(5).sample(names, 20)])


@pytest.mark.verify(minutes=0.5)
@pytest.mark.parametrize("distro", DISTROS)
def test_every_type_survives_recording_and_replay(
    shm_namespace: Namespace, tmp_path: Path, distro: str
) -> None:
    """Every bundled type of every distribution, recorded, replayed and recorded again, byte by byte."""
    names = hard_store(distro).names()
    for start in range(0, len(names), 100):
        folder = tmp_path / str(start)
        folder.mkdir()
        check(shm_namespace, folder, distro, names[start : start + 100])
