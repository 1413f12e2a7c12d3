"""The fault campaign's judge: what it must find, it finds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.soak.messages import Counters, fill, read


@pytest.fixture
def counters(tmp_path: Path) -> Counters:
    """Give a counters in which generation 5 has announced a hundred messages on each topic."""
    made = Counters(tmp_path / "counters", create=True)
    for topic in range(4):
        made.announce(topic, 5, 100)
    return made


def test_what_was_sent_in_order_is_in_order(counters: Counters) -> None:
    """Whole messages in order violate nothing; what is left out between two is missing."""
    for number in (3, 4, 7):
        counters.take(1, fill(1, 5, number))
    assert counters.violations() == {"torn": 0, "invented": 0, "disordered": 0}
    assert counters.counters[1]["missing"] == 2
    assert counters.arrived(1) == (5, 7)


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [("disordered", (3, 3)), ("disordered", (4, 3)), ("invented", (101,)), ("invented", (0,))],
)
def test_wrong_numbers(counters: Counters, kind: str, numbers: tuple[int, ...]) -> None:
    """A message that comes twice or late, or that nobody has announced, is found."""
    for number in numbers:
        counters.take(0, fill(0, 5, number))
    assert counters.violations()[kind] == 1


def test_another_senders_message(counters: Counters) -> None:
    """A generation that has announced nothing cannot have sent."""
    counters.take(0, fill(0, 6, 1))
    assert counters.violations()["invented"] == 1


@pytest.mark.parametrize("place", [0, 1, 2, -1])
def test_one_foreign_word_is_found(counters: Counters, place: int) -> None:
    """A single word of another message, wherever it stands, makes a message torn."""
    words = fill(2, 5, 9).copy()
    words[place] = fill(2, 5, 10)[place] if place >= 0 else 0
    if place == 0:
        words[0] = 6
    counters.take(2, words)
    assert counters.violations()["torn"] == 1


def test_a_count_of_another_message_is_found() -> None:
    """Words of one message under the length of another are not whole, and neither is an empty one."""
    words = fill(0, 1, 1)
    assert read(0, words) is not None
    assert read(0, words[:-1]) is None
    assert read(0, np.append(words, np.uint32(0))) is None
    assert read(0, []) is None
    assert read(1, words) is None, "another topic's message"


def test_counters_outlive_their_writer(counters: Counters, tmp_path: Path) -> None:
    """A process that maps the file again finds what was written."""
    counters.take(3, fill(3, 5, 1))
    assert Counters(tmp_path / "counters").arrived(3) == (5, 1)
