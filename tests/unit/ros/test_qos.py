"""Settings of topics, and which of them fit each other."""

from __future__ import annotations

import pytest

from rosplc.errors import BackendError
from rosplc.ros import DEFAULT, LATCHED, PRESETS, SENSOR_DATA, Qos, incompatibility


def test_presets_are_those_of_ros() -> None:
    """The presets have the values that rmw's profiles have."""
    assert Qos("reliable", "volatile", 10, "keep_last") == DEFAULT
    assert Qos("best_effort", "volatile", 5, "keep_last") == SENSOR_DATA
    assert Qos("reliable", "transient_local", 1000, "keep_last") == LATCHED
    assert PRESETS == {"default": DEFAULT, "sensor_data": SENSOR_DATA, "latched": LATCHED}


@pytest.mark.parametrize(
    "wrong",
    [
        {"reliability": "maybe"},
        {"durability": "persistent"},
        {"history": "keep_all"},
        {"depth": 0},
        {"depth": -1},
        {"depth": 1.5},
        {"depth": True},
        {"depth": 2**31},
    ],
    ids=str,
)
def test_wrong_values_are_refused(wrong: dict[str, object]) -> None:
    """A value that is none of the allowed ones is refused, with its name."""
    with pytest.raises(BackendError, match=f"{next(iter(wrong))}.*ROS007"):
        Qos(**wrong)  # type: ignore[arg-type]


# Offered, requested, and whether ROS 2's documentation calls the pair compatible.
TABLE = [
    ("best_effort volatile", "best_effort volatile", True),
    ("best_effort volatile", "reliable volatile", False),
    ("reliable volatile", "best_effort volatile", True),
    ("reliable volatile", "reliable volatile", True),
    ("reliable volatile", "reliable transient_local", False),
    ("reliable transient_local", "reliable volatile", True),
    ("reliable transient_local", "reliable transient_local", True),
    ("best_effort volatile", "reliable transient_local", False),
]


@pytest.mark.parametrize(("offered", "requested", "fits"), TABLE)
def test_compatibility_follows_the_table(offered: str, requested: str, fits: bool) -> None:
    """Pairs are compatible as ROS 2's table says, whatever their depths."""
    words = incompatibility(Qos(*offered.split(), depth=1), Qos(*requested.split(), depth=99))  # type: ignore[arg-type]
    assert (words is None) == fits


def test_words_name_both_sides() -> None:
    """The reason names each setting with what either side has."""
    words = incompatibility(SENSOR_DATA, LATCHED)
    assert words == (
        "the publisher is best_effort and the subscriber requests reliable; "
        "the publisher is volatile and the subscriber requests transient_local"
    )
