"""What a configuration decides about classic topics."""

from __future__ import annotations

import pytest

from rosplc.config import ConfigErrors, parse_config, resolve
from rosplc.config.plans import ClassicPlan, classic_name
from rosplc.config.resolve import TopicPlan


def plan(entry: str, more: str = "", topic: str = "/cmd_vel") -> TopicPlan:
    """Return the plan of one topic."""
    text = f"{more}\ntopics:\n  {topic}: {{type: geometry_msgs/msg/Twist, {entry}}}\n"
    return resolve(parse_config(text)).topics[0]


def wrong(entry: str, more: str = "", topic: str = "/cmd_vel") -> str:
    """Return what is said of a wrong entry."""
    with pytest.raises(ConfigErrors) as caught:
        plan(entry, more, topic)
    return str(caught.value)


def test_defaults_are_those_of_existing_projects() -> None:
    """Memory and semaphore have the topic's name, and the lock is waited for a bounded time."""
    made = plan("to: plc, classic: true")
    assert made.classic == ClassicPlan("cmd_vel", "cmd_vel", 5_000_000, 1_000_000_000)
    assert (made.every, made.slots, made.on_change) == (False, 1, False)
    assert plan("to: plc").classic is None


def test_names_have_no_slash() -> None:
    """Inner slashes of a topic become dots, since a name in shared memory has none."""
    assert classic_name("/robot1/cmd_vel") == "robot1.cmd_vel"
    made = plan("to: plc, classic: true", topic="/robot1/cmd_vel").classic
    assert made is not None and (made.name, made.semaphore) == ("robot1.cmd_vel", "robot1.cmd_vel")


def test_the_semaphore_follows_the_memory_unless_it_is_named() -> None:
    """One name serves both; another can be given, or none at all."""
    made = [
        plan(f"to: plc, classic: {keys}").classic
        for keys in ("{name: io}", "{name: io, semaphore: lock}", "{name: io, semaphore: none}")
    ]
    assert [(c.name, c.semaphore) for c in made if c] == [("io", "io"), ("io", "lock"), ("io", "")]


def test_a_change_is_a_message_unless_every_look_is() -> None:
    """Towards ROS changes count by default; on_change: false publishes at every look, once per cycle."""
    by_default, written = plan("to: ros, classic: true"), plan("to: ros, classic: true, on_change: false")
    assert by_default.classic is not None and written.classic is not None
    assert (by_default.on_change, by_default.classic.poll_ns) == (True, 1_000_000)
    assert (written.on_change, written.classic.poll_ns) == (False, 10_000_000)
    slow = plan("to: ros, classic: true, on_change: false, rate_limit: 2Hz").classic
    assert slow is not None and slow.poll_ns == 500_000_000


def test_what_stood_there_before_counts_where_it_is_asked_for() -> None:
    """Latching is every topic's default towards ROS, so only a written one makes an old image a message."""
    entries = ("classic: true", "classic: true, latched: true", "classic: true, qos: latched")
    assert [plan(f"to: ros, {entry}").latched for entry in entries] == [False, True, True]


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("to: plc, classic: true, slots: 8", "has one record"),
        ("to: plc, classic: true, every: true", "every: true cannot be set with classic"),
        ("to: plc, classic: {name: a/b}", "at most 80 letters, digits"),
        ("to: plc, classic: {name: sem.a}", "or sem."),
        ("to: plc, classic: {name: rosplc.t.a}", "reserved for the bridge's objects"),
        ("to: plc, classic: {wait: 2s}", "is not between 100us and 1s"),
        ("to: plc, classic: {recover_after: 1ms}", "is not between 20ms and 1h"),
        ("to: plc, classic: {lock: x}", "'lock' is not a valid key here"),
    ],
)
def test_what_does_not_go_together_is_named(entry: str, words: str) -> None:
    """A wrong entry is an error that says what would be right."""
    assert words in wrong(entry)


def test_a_name_that_a_plc_cannot_hold_is_refused() -> None:
    """A PLC's STRING has 80 characters; a longer name asks for another."""
    assert "has 81 characters" in wrong("to: plc, classic: true", topic="/" + "a" * 81)


def test_another_directory_is_refused() -> None:
    """Semaphores are in /dev/shm and nowhere else, so a classic topic does too."""
    assert "must be in /dev/shm" in wrong("to: plc, classic: true", more="shm: {directory: /tmp}")


def test_two_topics_in_one_memory_are_refused() -> None:
    """A memory belongs to one topic."""
    text = """
topics:
  /a: {type: geometry_msgs/msg/Twist, to: plc, classic: {name: io}}
  /b: {type: geometry_msgs/msg/Twist, to: ros, classic: {name: io}}
"""
    with pytest.raises(ConfigErrors, match="have the same object name, io"):
        resolve(parse_config(text))
