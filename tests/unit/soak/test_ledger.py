"""The fault campaign's judge: what it must find, it finds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.soak.ledger import Ledger
from tests.soak.pattern import fill, read


@pytest.fixture
def ledger(tmp_path: Path) -> Ledger:
    """Give a ledger in which generation 5 has announced a hundred messages on each topic."""
    made = Ledger(tmp_path / "ledger", create=True)
    for topic in range(4):
        made.announce(topic, 5, 100)
    return made


def test_what_was_sent_in_order_is_in_order(ledger: Ledger) -> None:
    """Whole messages in order violate nothing; what is left out between two is missing."""
    for number in (3, 4, 7):
        ledger.take(1, fill(1, 5, number))
    assert ledger.violations() == {"torn": 0, "invented": 0, "disordered": 0}
    assert ledger.counters[1]["missing"] == 2
    assert ledger.arrived(1) == (5, 7)


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [("disordered", (3, 3)), ("disordered", (4, 3)), ("invented", (101,)), ("invented", (0,))],
)
def test_wrong_numbers(ledger: Ledger, kind: str, numbers: tuple[int, ...]) -> None:
    """A message that comes twice or late, or that nobody has announced, is found."""
    for number in numbers:
        ledger.take(0, fill(0, 5, number))
    assert ledger.violations()[kind] == 1


def test_another_senders_message(ledger: Ledger) -> None:
    """A generation that has announced nothing cannot have sent."""
    ledger.take(0, fill(0, 6, 1))
    assert ledger.violations()["invented"] == 1


@pytest.mark.parametrize("place", [0, 1, 2, -1])
def test_one_foreign_word_is_found(ledger: Ledger, place: int) -> None:
    """A single word of another message, wherever it stands, makes a message torn."""
    words = fill(2, 5, 9).copy()
    words[place] = fill(2, 5, 10)[place] if place >= 0 else 0
    if place == 0:
        words[0] = 6
    ledger.take(2, words)
    assert ledger.violations()["torn"] == 1


def test_a_count_of_another_message_is_found() -> None:
    """Words of one message under the length of another are not whole, and neither is an empty one."""
    words = fill(0, 1, 1)
    assert read(0, words) is not None
    assert read(0, words[:-1]) is None
    assert read(0, np.append(words, np.uint32(0))) is None
    assert read(0, []) is None
    assert read(1, words) is None, "another topic's message"


def test_counters_outlive_their_writer(ledger: Ledger, tmp_path: Path) -> None:
    """Whoever maps the file again finds what was written."""
    ledger.take(3, fill(3, 5, 1))
    assert Ledger(tmp_path / "ledger").arrived(3) == (5, 1)
