"""What ``rosplc check`` says about a source that falls silent."""

from __future__ import annotations

import pytest

from rosplc.config import parse_config, resolve
from rosplc.project import check

INT = "std_msgs/msg/Int32"


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("to: plc", "after 1s the PLC keeps the last message and sets xStale"),
        ("to: plc, stale_after: never", "the PLC keeps the last message, and xStale is never set"),
        (
            "to: plc, on_stale: zero",
            "after 1s every byte of the PLC's msg is zero, with xSubstituted and xStale set, "
            "whether or not the bridge runs",
        ),
        (
            "to: plc, on_stale: {value: {data: 5}}",
            'after 1s the PLC\'s msg is {"data": 5}, with xSubstituted and xStale set, '
            "whether or not the bridge runs",
        ),
        (
            "to: plc, classic: true, on_stale: {value: {}}",
            "after 1s the PLC's msg is the type's initial message, with xSubstituted and xStale set, "
            "whether or not the bridge runs; a source whose record does not change counts as silent",
        ),
        ("to: ros", "ROS receives nothing"),
        ("to: ros, stale_after: 2s", "ROS receives nothing; 500ms later /diagnostics shows STALE"),
        (
            "to: ros, stale_after: 2s, on_stale: {value: {data: -1}, period: 5Hz}",
            'after 2s ROS receives {"data": -1} every 200ms, and /a/substituted is true; '
            "500ms later /diagnostics shows STALE",
        ),
    ],
)
def test_each_topic_says_what_happens_when_its_source_is_silent(entry: str, words: str) -> None:
    """One sentence per topic, without a word that only a programmer knows."""
    project = resolve(parse_config(f"ros: {{backend: memory}}\ntopics:\n  /a: {{type: {INT}, {entry}}}\n"))
    made = check(project)
    assert made["topics"]["/a"]["when_silent"] == words
    assert len(made["warnings"]) == ("classic" in entry)


def test_programs_get_the_same_as_data() -> None:
    """Action, value, period and flag are in the JSON, too."""
    entry = "to: ros, stale_after: 2s, on_stale: {value: {data: -1}, period: 5Hz}"
    project = resolve(parse_config(f"ros: {{backend: memory}}\ntopics:\n  /a: {{type: {INT}, {entry}}}\n"))
    assert check(project)["topics"]["/a"]["on_stale"] == {
        "action": "substitute",
        "value": {"data": -1},
        "period_ms": 200.0,
        "flag_topic": "/a/substituted",
    }
