"""Output fits a terminal: nothing breaks inside a word, names are shortened in the middle."""

from __future__ import annotations

import pytest

from rosplc.cli.text import columns, wrap
from rosplc.harmless import in_bytes, plural, shorten

TOPIC = "/robot1/left_arm/joint_trajectory_controller/state"
ROW = (TOPIC, "→ PLC", "control_msgs/msg/JointTrajectoryControllerState", 12, "alive")
HEADER = ("topic", "way", "type", "bytes", "writer")


@pytest.mark.parametrize("width", [60, 80, 100])
def test_a_table_fits_its_width(width):
    """Long names lose their middle; columns of short words and numbers stay whole."""
    lines = columns(
        [ROW, ("/tf", "→ PLC", "tf2_msgs/msg/TFMessage", 4, "silent")], header=HEADER, width=width
    )
    assert max(map(len, lines)) <= width
    assert lines[1].startswith("/rob") and "…" in lines[1]
    assert "12" in lines[1] and "alive" in lines[1] and "/tf" in lines[2]


def test_a_sentence_in_a_table_is_wrapped_between_words():
    """A value that is a sentence continues in its own column, with every word whole."""
    text = "the PLC keeps the last message, and xStale is never set; an unchanged record counts as silent"
    lines = columns([("when silent", text), ("QoS", "reliable")], width=60, indent=2)
    assert max(map(len, lines)) <= 60
    assert " ".join(line[15:] for line in lines[:-1]) == text
    assert all(line.startswith(" " * 15) for line in lines[1:-1])


def test_without_a_terminal_nothing_is_shortened():
    """A pipe gets every name whole: programs may read it."""
    assert columns([ROW], header=HEADER)[1].split()[0] == TOPIC


def test_a_paragraph_is_wrapped_between_words_and_keeps_its_indent():
    """Words are never broken, a path longer than the width included."""
    path = "/a/very/long/path/" + "x" * 60
    text = f"  where: {path} is not a file that the bridge may read"
    lines = wrap(text, 40).split("\n")
    assert " ".join(line.strip() for line in lines) == text.strip()
    assert path in "".join(lines) and all(line.startswith("  ") for line in lines)


def test_a_name_is_shortened_in_the_middle():
    """Both ends stay: the robot's name and what the topic is."""
    short = shorten(TOPIC, 20)
    assert len(short) == 20 and short.startswith("/robot") and short.endswith("/state")
    assert shorten("/tf", 20) == "/tf"


@pytest.mark.parametrize(
    ("count", "noun", "text"),
    [
        (1, "topic", "1 topic"),
        (0, "topic", "0 topics"),
        (2, "entry", "2 entries"),
        (2, "library", "2 libraries"),
    ],
)
def test_a_number_and_its_noun_agree(count, noun, text):
    """One topic, two topics."""
    assert plural(count, noun) == text


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "0 bytes"), (1, "1 byte"), (1023, "1023 bytes"), (1536, "1.5 KiB"), (3 << 30, "3072.0 MiB")],
)
def test_sizes_have_a_fitting_unit(count, text):
    """Small sizes are exact, large ones rounded."""
    assert in_bytes(count) == text
