"""What ``on_stale`` may say, and what is refused with file, line and key."""

from __future__ import annotations

import pytest

from rosplc.config import ConfigErrors, parse_config, resolve
from rosplc.config.plans import StalePlan

TWIST = "geometry_msgs/msg/Twist"


def plan_of(entry: str) -> StalePlan:
    """Return the plan of a Twist's entry."""
    (plan,) = resolve(parse_config(f"topics:\n  /a: {{type: {TWIST}, {entry}}}\n")).topics
    return plan.on_stale


def error_of(topics: str) -> tuple[str, str, str]:
    """Return code, place and words of the one thing that is wrong."""
    with pytest.raises(ConfigErrors) as caught:
        resolve(parse_config(f"topics:\n{topics}", name="c.yaml"))
    (error,) = caught.value.errors
    return error.code, error.where, error.what


def test_the_defaults_hold_and_stop() -> None:
    """Without a word the PLC keeps the last message, and ROS gets none."""
    assert plan_of("to: plc") == StalePlan("hold")
    assert plan_of("to: ros") == StalePlan("stop")
    assert plan_of("to: plc, on_stale: hold, stale_after: never") == StalePlan("hold")


def test_values_become_records() -> None:
    """Fields that are given are in the record, the others are initial."""
    assert plan_of("to: plc, on_stale: zero").action == "zero"
    plan = plan_of("to: plc, on_stale: {value: {angular: {z: 0.5}}}")
    assert (plan.action, plan.record[40:], any(plan.record[:40])) == (
        "value",
        b"\0\0\0\0\0\0\xe0\x3f",
        False,
    )
    plan = plan_of("to: ros, stale_after: 1s, on_stale: {value: {}, period: 10Hz}")
    assert (plan.action, plan.record, plan.period_ns) == ("substitute", bytes(48), 10**8)


@pytest.mark.parametrize(
    ("entry", "key", "words"),
    [
        ("to: plc, on_stale: stop", "", "cannot be used with to: plc"),
        ("to: ros, stale_after: 1s, on_stale: zero", "", "cannot be used with to: ros"),
        ("to: plc, on_stale: zeros", "", "did you mean 'zero'"),
        ("to: plc, on_stale: 5", "", "5 is not valid"),
        ("to: plc, on_stale: {value: {linear: {x: fast}}}", ".value.linear.x", "is not a valid float64"),
        ("to: plc, on_stale: {value: {linear: {speed: 1}}}", ".value.linear", "no field 'speed'"),
        ("to: plc, on_stale: {value: {}, period: 1s}", ".period", "period has no effect"),
        ("to: plc, on_stale: {valeu: {}, value: {}}", ".valeu", "not a valid key here; did you mean 'value'"),
        ("to: plc, stale_after: never, on_stale: zero", "", "stale_after is never"),
        ("to: plc, on_change: true, on_stale: zero", "", "on_change drops equal messages"),
        ("to: plc, rate_limit: 1s, on_stale: zero", "", "the interval of rate_limit must be shorter"),
        (
            "to: ros, stale_after: 1s, rate_limit: 1s, on_stale: {value: {}, period: 1s}",
            "",
            "the interval of rate_limit must be shorter",
        ),
        ("to: ros, on_stale: {value: {}, period: 1s}", "", "the default for to: ros"),
        ("to: ros, stale_after: 1s, on_stale: {value: {}}", "", "'period' is missing"),
        ("to: ros, stale_after: 1s, on_stale: {value: {}, period: 1us}", ".period", "below the minimum, 1ms"),
        (
            "to: ros, classic: true, stale_after: 1s, on_stale: {value: {}, period: 1s}",
            "",
            "a silent PLC looks like a PLC",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(entry: str, key: str, words: str) -> None:
    """Every contradiction is an error at its line and key, before anything runs."""
    code, where, what = error_of(f"  /a: {{type: {TWIST}, {entry}}}\n")
    assert code in ("CFG004", "CFG003")
    assert where == f"c.yaml:2: topics./a.on_stale{key}"
    assert words in what


def test_values_that_structured_text_cannot_write() -> None:
    """Infinity and unprintable characters are refused, wherever they stand."""
    entry = "  /a:\n    type: sensor_msgs/msg/JointState\n    to: plc\n    on_stale:\n      value:\n"
    code, where, what = error_of(entry + "        position:\n        - 1.0\n        - 1.0e999\n")
    assert (code, where) == ("CFG004", "c.yaml:9: topics./a.on_stale.value.position[1]")
    assert "inf" in what
    code, where, what = error_of(entry + '        name: ["a", "b\\x1b"]\n')
    assert (code, where) == ("CFG004", "c.yaml:7: topics./a.on_stale.value.name[1]")
    code, where, what = error_of(entry + f"        name: [{'x' * 81}]\n")
    assert where == "c.yaml:7: topics./a.on_stale.value.name[0]"
    assert "its limit is 80" in what


def test_the_flag_topic_is_taken() -> None:
    """A topic of the file cannot be where ROS is told of substitutes."""
    code, where, what = error_of(
        f"  /a: {{type: {TWIST}, to: ros, stale_after: 1s, on_stale: {{value: {{}}, period: 1s}}}}\n"
        f"  /a/substituted: {{type: {TWIST}, to: ros}}\n"
    )
    assert (code, where) == ("CFG004", "c.yaml:2: topics./a.on_stale")
    assert "/a/substituted is reserved" in what
