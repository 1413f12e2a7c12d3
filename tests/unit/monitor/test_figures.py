"""Rates, cells and what becomes of states."""

from __future__ import annotations

import pytest

from rosplc.levels import Level
from rosplc.monitor import Event, State, numbers
from rosplc.monitor.picture import MARKS, age_text, count_text, grouped, rate_text
from rosplc.monitor.tracked import Rate


def rates(period_ms, *, look_ms, seconds):
    """Return what a counter that grows every ``period_ms`` reads as, look by look."""
    rate = Rate()
    return [rate.of(now // period_ms, now * 1_000_000) for now in range(0, int(seconds * 1000) + 1, look_ms)]


@pytest.mark.parametrize("period_ms", [1, 10, 100, 500, 1000, 5000])
def test_a_steady_rate_reads_as_steady(period_ms):
    """From a thousand a second to one in five seconds, within the width of a look."""
    seen = rates(period_ms, look_ms=250, seconds=40)[80:]
    assert all(value == pytest.approx(1000 / period_ms, rel=0.15) for value in seen)


def test_a_rate_falls_to_zero_when_messages_stop():
    """After two seconds without one, and after five periods of a slow topic."""
    rate = Rate()
    for now in range(0, 3000, 100):
        rate.of(now // 10, now * 1_000_000)
    last = rate.of(290, 3_000_000_000)
    assert last and last > 80
    assert rate.of(290, 6_000_000_000) == 0.0


def test_a_rate_is_unknown_at_first_and_zero_where_nothing_comes():
    """One look tells nothing."""
    rate = Rate()
    assert rate.of(5, 0) is None
    assert rate.of(5, 3_000_000_000) == 0.0


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (0, "0"),
        (99_999, "99999"),
        (100_000, "100k"),
        (999_499, "999k"),
        (999_600, "1M"),
        (4294967295, "4.29G"),
    ],
)
def test_counters_take_five_characters(count, text):
    """However large."""
    assert count_text(count) == text
    assert len(text) <= 5


def test_ages_and_rates_are_short():
    """Five or six characters, as a column has."""
    assert [age_text(age) for age in (None, 0, 99_999_999, 1_200_000_000, 14 * 10**9, 300 * 10**9)] == [
        "never",
        "0 ms",
        "99 ms",
        "1.2 s",
        "10 s",
        "5 min",
    ]
    assert [rate_text(rate) for rate in (None, 0.0, 0.2, 12.34, 999.6)] == ["-", "0", "0.2", "12.3", "1000"]


def test_states_stand_in_the_order_of_severity():
    """The worst first; every level that is not OK has a mark of its own."""
    order = [state.severity for state in State]
    assert order == sorted(order, reverse=True)
    assert State.OK.severity == 0
    marks = [MARKS[state.level] for state in State if state.level]
    assert set(marks) == {"!", "X", "~"}


def test_numbers_have_paths():
    """Structs, arrays up to a limit, BOOLs; what is no finite number is left out."""
    values = {"a": {"b": 1}, "c": [1.5, float("nan"), 2.5, 3.5], "d": "text", "e": True, "f": [{"g": 2}]}
    assert dict(numbers(values, elements=3)) == {
        "a.b": 1.0,
        "c[0]": 1.5,
        "c[2]": 2.5,
        "e": 1.0,
        "f[0].g": 2.0,
    }


def test_events_of_one_look_with_the_same_words_are_one_line():
    """Twenty channels that appear take one line; another time or other words another."""
    several = [
        Event(1, "appeared", Level.OK, f"c{n}", "p", f"/t{n}", "the channel appeared") for n in range(20)
    ]
    late = Event(2, "appeared", Level.OK, "d", "p", "/d", "the channel appeared")
    assert [event.topic for event in grouped([*several, late])] == ["/t0 and 19 more", "/d"]
