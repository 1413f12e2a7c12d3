"""What is proposed from what was seen."""

from __future__ import annotations

import pytest

from rosplc.init.found import Length, Seen, Topic
from rosplc.init.propose import propose
from rosplc.model import TypeStore
from rosplc.ros import LATCHED, SENSOR_DATA, Qos

pytestmark = pytest.mark.verifies("init", own="random graphs")

STORE = TypeStore.bundled("jazzy").with_definition(
    "t_msgs/msg/T", 'string name\nstring<=20 short\nint32[] n\nint32[<=5] few\nstring label "none"\n'
)
JOINTS = "sensor_msgs/msg/JointState"


def entry(type_name: str, messages: int = 100, *, to="plc", offered=(), gap=0.01, rate=50.0, **lengths):
    seen = Seen(
        messages,
        seconds=5.0,
        rate_hz=rate,
        longest_gap_s=gap,
        lengths={path.replace("__", "[]"): Length(*pair) for path, pair in lengths.items()},
    )
    topic = Topic("/t", (type_name,), ("/robot",), (), offered)
    return propose(topic, type_name, to, STORE, seen if messages is not None else None)


def limits(*arguments, **named):
    return {path: most for path, (most, _) in entry(*arguments, **named).limits.items()}


def settings(*arguments, **named):
    return {key: value for key, (value, _) in entry(*arguments, **named).settings.items()}


def test_lengths_that_never_changed_are_taken_as_they_are() -> None:
    """Six joints in a hundred messages are six joints; a changing number gets half as much again."""
    assert limits(JOINTS, name=(6, 6), position=(4, 6)) == {"name": 6, "position": 12}


@pytest.mark.parametrize(("most", "capacity"), [(1, 48), (24, 48), (25, 64), (100, 208), (65534, 65534)])
def test_strings_get_twice_the_longest(most: int, capacity: int) -> None:
    """Rounded up to a multiple of 16, at least 48, at most what a string can have."""
    assert limits("std_msgs/msg/String", data=(1, most)) == {"data": capacity}


def test_few_messages_lower_nothing() -> None:
    """With fewer than ten messages the default is kept where it is larger, left where it is smaller."""
    assert limits(JOINTS, 9, name=(6, 6), position=(40, 40)) == {"position": 60}


def test_what_was_always_empty_keeps_the_default_and_is_named() -> None:
    """Nothing was learnt of an empty sequence, and the file says so."""
    made = entry(JOINTS, name=(6, 6), effort=(0, 0))
    assert list(made.limits) == ["name"]
    assert any("always empty" in text and "effort" in text for text in made.about)


def test_without_a_message_the_defaults_hold_and_it_says_so() -> None:
    """A silent topic gets no limit, and a remark."""
    made = entry(JOINTS, 0)
    assert not made.limits
    assert any("No message was seen in 5 s" in text for text in made.about)
    assert any("not seen yet" in text for text in made.about)


def test_bounds_and_defaults_of_the_definition_win() -> None:
    """No capacity exceeds a bound, and none is too small for a default value."""
    assert limits("t_msgs/msg/T", short=(15, 15), few=(1, 4), n=(1, 2)) == {"n": 4}
    assert limits("t_msgs/msg/T", short=(1, 1), few=(2, 2)) == {"few": 2}
    assert entry("t_msgs/msg/T", label=(1, 1)).limits.keys() == {"label"}


def test_best_effort_publishers_are_asked_for_best_effort() -> None:
    """A reliable subscription would get nothing of them."""
    assert settings(JOINTS, offered=(SENSOR_DATA, Qos())) == {"qos": "{reliability: best_effort}"}
    assert settings(JOINTS, offered=(Qos(),)) == {}
    assert settings(JOINTS, to="ros", offered=(SENSOR_DATA,)) == {}


def test_what_is_sent_once_is_latched_and_never_stale() -> None:
    """A retained message is asked for; with one message there is no period to be late by."""
    wanted = {"latched": "true", "stale_after": "never"}
    assert settings("std_msgs/msg/String", 1, offered=(LATCHED,), gap=0.0, rate=0.0) == wanted
    assert settings("std_msgs/msg/String", 30, offered=(LATCHED,)) == {"latched": "true"}


def test_slow_and_fast_topics_get_their_times() -> None:
    """Stale is three times the longest pause above a second; from 100 Hz on the rate is written."""
    assert settings(JOINTS, 5, gap=2.1, rate=0.5) == {"stale_after": "7s"}
    assert settings(JOINTS, gap=0.001, rate=1000.0) == {"expected_rate": "1500Hz"}
    assert settings(JOINTS, gap=0.02, rate=99.0) == {}
