"""The small parts of the bridge: repeated warnings, slot arithmetic, ages, quantities."""

from __future__ import annotations

import logging

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosplc.bridge.port import QUIET_NS, RepeatedWarnings
from rosplc.bridge.status import BridgeStatus, Level, TopicStatus, format_age
from rosplc.config.plans import slot_numbers
from rosplc.config.quantities import format_duration, parse_duration, parse_mode, parse_rate
from rosplc.shm import Direction

MS = 1_000_000
SECOND = 1000 * MS


def test_repeated_warnings_are_held_back_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    """One line at once, one per ten seconds, other kinds unaffected."""
    warnings = RepeatedWarnings(logging.getLogger("rosplc.test"))
    for step in range(5):
        warnings.warn("a", step, "first kind")
    warnings.warn("b", 5, "second kind")
    warnings.warn("a", QUIET_NS, "first kind")
    assert [record.message for record in caplog.records] == [
        "first kind",
        "second kind",
        "first kind (similar messages suppressed: 4)",
    ]


@pytest.mark.parametrize(
    ("demand", "least", "usual"),
    [
        ((0, 10 * MS, 100, False), 4, 4),
        ((0, 10 * MS, 100, True), 4, 16),
        ((10 * MS, MS, 100, True), 4, 4),
        ((MS, MS, 100, True), 4, 32),
        ((MS, 10 * MS, 100, False), 4, 4),
        ((MS, 10 * MS, 100, True), 16, 32),
        ((100_000, MS, 100, False), 16, 16),
        ((MS, MS, 4 << 20, False), 32, 32),
    ],
)
def test_slots(demand: tuple[int, int, int, bool], least: int, usual: int) -> None:
    """The slots outlast a copy plus a preemption, and where every message counts the reader's absence."""
    assert slot_numbers(*demand) == (least, usual)


@given(st.integers(0, 10**9), st.integers(1, 10**9), st.integers(1, 2**30), st.booleans())
def test_slots_are_valid_and_enough(period: int, visit: int, size: int, every: bool) -> None:
    """Any demand gives a power of two that the format allows, the usual number never the smaller one."""
    least, usual = slot_numbers(period, visit, size, every)
    assert 4 <= least <= usual <= 65536
    assert least & (least - 1) == usual & (usual - 1) == 0
    if period and least < 65536:
        assert (least - 2) * period >= size * 5
        assert not every or (least - 1) * period >= visit


@pytest.mark.parametrize(
    ("text", "ns"),
    [("200ms", 200 * MS), ("1s", SECOND), ("10us", 10_000), ("10 µs", 10_000), ("0.5s", SECOND // 2),
     ("2min", 120 * SECOND), ("24h", 86_400 * SECOND), ("1ns", 1)],
)  # fmt: skip
def test_durations(text: str, ns: int) -> None:
    """A number and a unit are exact nanoseconds."""
    assert parse_duration(text) == ns


@pytest.mark.parametrize(
    "value",
    ["", "10", 10, 1.5, None, True, "ms", "-1s", "1e3s", "0s", "25h", "0.5ns", "1 week", "1s 2ms", "١s"],
)
def test_durations_refused(value: object) -> None:
    """Everything else is refused with an example or the units."""
    with pytest.raises(ValueError, match=r"such as|unknown unit|not between"):
        parse_duration(value)


@given(st.integers(1, 86_400 * SECOND))
def test_durations_read_back(ns: int) -> None:
    """What format_duration writes, parse_duration reads."""
    assert parse_duration(format_duration(ns)) == ns


@pytest.mark.parametrize(
    ("text", "ns"),
    [("50Hz", 20 * MS), ("1kHz", MS), ("0.5Hz", 2 * SECOND), ("100mHz", 10 * SECOND), ("30Hz", 33_333_333),
     ("5ms", 5 * MS)],
)  # fmt: skip
def test_rates(text: str, ns: int) -> None:
    """A rate is the period between two messages."""
    assert parse_rate(text) == ns


@pytest.mark.parametrize("value", ["", "50", 50, "0Hz", "2MHz", "2000kHz", "0.000000001mHz", "5hz", "-5Hz"])
def test_rates_refused(value: object) -> None:
    """Everything else is refused."""
    with pytest.raises(ValueError, match=r"such as|unknown unit|not between"):
        parse_rate(value)


@pytest.mark.parametrize(
    ("text", "mode"), [("0660", 0o660), ("660", 0o660), ("0o600", 0o600), ("0664", 0o664)]
)
def test_modes(text: str, mode: int) -> None:
    """Octal digits as text."""
    assert parse_mode(text) == mode


@pytest.mark.parametrize("value", [660, 0o660, "rw", "0880", "0060", "0770", "06600", None])
def test_modes_refused(value: object) -> None:
    """Numbers, other text, and modes that lock the bridge out are refused."""
    with pytest.raises(ValueError, match="0660"):
        parse_mode(value)


@pytest.mark.parametrize(
    ("age", "text"),
    [(0, "0.0 s"), (1240 * MS, "1.2 s"), (14 * SECOND, "10 s"), (300 * SECOND, "5 min"), (10**13, "2 h")],
)
def test_ages(age: int, text: str) -> None:
    """Ages get coarser as they grow."""
    assert format_age(age) == text


IN = {"topic": "/a", "type_name": "std_msgs/msg/Bool", "direction": Direction.TO_PLC}
OUT = {**IN, "direction": Direction.TO_ROS}


SILENT = {"stale": True, "silent": True}


@pytest.mark.parametrize(
    ("fields", "level", "text"),
    [
        ({**IN, "problem": "no room [SHM117]", **SILENT}, Level.ERROR, "no room"),
        ({**IN, "reason": "other", "code": "ROS003", "recent": True}, Level.ERROR, "other"),
        ({**IN, "reason": "other", "code": "ROS003", "recent": True, "matched": 1}, Level.WARN, "other"),
        ({**IN, "reason": "refused", "code": "COD004", "recent": True, **SILENT}, Level.WARN, "refused"),
        ({**IN, **SILENT, "matched": 1, "age_ns": 5 * SECOND}, Level.STALE, "5.0 s ago from ROS"),
        ({**IN, **SILENT}, Level.STALE, "no publisher"),
        ({**OUT, **SILENT, "age_ns": 5 * SECOND}, Level.STALE, "from the PLC"),
        ({**IN, "matched": 1, "reason": "long ago"}, Level.WARN, "no PLC task reads"),
        ({**OUT, "matched": 1}, Level.WARN, "no PLC task writes"),
        ({**OUT, "peer_gone_ns": 5 * SECOND, **SILENT}, Level.ERROR, "writes it stopped 5.0 s ago"),
        ({**OUT, **SILENT, "age_ns": 1, "substituting": True}, Level.STALE, "substitutes are published"),
        ({**IN, "silent": True, "age_ns": 1}, Level.STALE, "messages from ROS have resumed"),
        ({**IN, "stale": True, "age_ns": 1, "peer_alive": True}, Level.OK, "no publisher"),
        ({**IN, "peer_alive": True}, Level.OK, "no publisher"),
        ({**OUT, "peer_alive": True}, Level.OK, "no subscriber"),
        ({**OUT, "peer_alive": True, "matched": 2, "rate_hz": 49.96}, Level.OK, "50 Hz"),
    ],
)  # fmt: skip
def test_judgement_of_a_topic(fields: dict[str, object], level: Level, text: str) -> None:
    """The worst that holds decides, and its words say why."""
    status = TopicStatus(**fields)  # type: ignore[arg-type]
    assert status.judgement[0] is level
    assert text in status.judgement[1]
    assert status.to_dict()["level"] == level.name


def test_judgement_of_the_bridge() -> None:
    """A bridge that does not run is an error, notes are warnings."""
    assert BridgeStatus("a").judgement[0] is Level.ERROR
    assert BridgeStatus("a", "dds", True, notes=("edited",)).judgement == (Level.WARN, "edited")
    fine = BridgeStatus("a", "dds", True, topics=(TopicStatus(**IN),))  # type: ignore[arg-type]
    assert fine.judgement == (Level.OK, "1 topics over dds")
    assert fine.to_dict()["topics"][0]["direction"] == "to_plc"
    with pytest.raises(KeyError):
        fine.topic("/b")
