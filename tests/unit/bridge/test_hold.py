"""What holds messages back: the stages of the pipeline, with times that the test chooses."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosplc.bridge import hold
from rosplc.bridge.hold import Grace, Hold, OnChange, RateLimiter, Silence, Stage, Substitute
from tests.lib.waiting import wait_for
from tests.unit.bridge.conftest import INT, Cell, numbers

TOPICS = (
    f"  /out: {{type: {INT}, to: ros, latched: false}}\n  /other: {{type: {INT}, to: ros, latched: false}}\n"
)


class Sent:
    """A pipeline over some stages, and what came out of it."""

    def __init__(self, *stages: Stage) -> None:
        self.out: list[bytes] = []
        self.hold = Hold(stages, lambda data, _stamp_ns, _now_ns: self.out.append(data))

    def offer(self, items: str, now_ns: int) -> None:
        for item in items:
            self.hold.offer((item.encode(), 0), now_ns)

    def __str__(self) -> str:
        return b"".join(self.out).decode()


def test_rate_limiter_lets_one_through_per_interval() -> None:
    """The first goes at once, the newest of those in between when its time has come."""
    sent = Sent(RateLimiter(100))
    sent.offer("a", 1000)
    sent.offer("bc", 1010)
    assert (str(sent), sent.hold.due_ns, sent.hold.skipped) == ("a", 1100, 1)
    sent.hold.flush(1099)
    assert str(sent) == "a"
    sent.hold.flush(1100)
    sent.hold.flush(1300)
    assert str(sent) == "ac"
    sent.offer("d", 1150)
    sent.offer("e", 1200)
    assert (str(sent), sent.hold.due_ns, sent.hold.skipped) == ("ace", None, 2)


@given(st.lists(st.tuples(st.integers(0, 40), st.booleans()), max_size=60))
def test_rate_limiter_keeps_the_last_message_and_the_interval(steps: list[tuple[int, bool]]) -> None:
    """Whatever the times: nothing is passed on early, in wrong order or twice, and the last one arrives."""
    passed: list[tuple[int, int]] = []
    hold = Hold([RateLimiter(100)], lambda _data, number, now_ns: passed.append((now_ns, number)))
    now, offered = 0, 0
    for delay, offer in steps:
        now += delay
        if offer:
            offered += 1
            hold.offer((b"", offered), now)
        else:
            hold.flush(now)
    hold.flush(now + 100)
    items = [item for _, item in passed]
    assert items == sorted(set(items))
    assert items[-1:] == ([offered] if offered else [])
    assert all(later - earlier >= 100 for (earlier, _), (later, _) in pairwise(passed))
    assert len(items) + hold.skipped == offered


def test_messages_wait_for_a_subscriber() -> None:
    """They wait in order until there is one, later ones follow at once, and the stage leaves the pipeline."""
    there: list[bool] = []
    sent = Sent(Grace(1000, 10, lambda: bool(there)))
    sent.offer("ab", 0)
    assert sent.hold.due_ns == 1000  # the end comes before the next look
    sent.hold.flush(10)
    there.append(True)
    sent.offer("c", 20)
    assert str(sent) == "abc"
    sent.hold.flush(20)
    assert not sent.hold.stages


@pytest.mark.parametrize(
    ("most", "offered", "at_once", "at_the_end", "skipped"),
    [(10, "a", "", "a", 0), (2, "abc", "abc", "abc", 0), (1, "abc", "", "c", 2)],
    ids=["time is over", "too many", "newest alone"],
)
def test_waiting_ends(most: int, offered: str, at_once: str, at_the_end: str, skipped: int) -> None:
    """When the time is over or there are too many all of them go; with room for one, the newest alone."""
    sent = Sent(Grace(1000, most, lambda: False))
    sent.offer(offered, 0)
    assert str(sent) == at_once
    sent.hold.flush(1000)
    assert (str(sent), sent.hold.skipped) == (at_the_end, skipped)


def test_what_waits_goes_in_the_end_whatever_holds_it() -> None:
    """At the end of a stream every stage gives up what it has, in order."""
    sent = Sent(OnChange(), RateLimiter(100), Grace(10**9, 10, lambda: False))
    sent.offer("aab", 0)
    assert str(sent) == ""
    sent.hold.flush(0, anyway=True)
    assert (str(sent), sent.hold.skipped) == ("ab", 1)


def test_what_the_receiver_lacks_is_news() -> None:
    """The same message again is dropped, unless the receiver does not have it."""
    sent = Sent(OnChange())
    sent.offer("aa", 0)
    sent.hold.forget()
    sent.offer("ab", 0)
    assert (str(sent), sent.hold.skipped) == ("aab", 1)


def test_substitutes_take_a_silent_sources_place() -> None:
    """They come at their rate after what was held, end with the next message, and a pause owes none."""
    silence, events = Silence(100, 0, 0), list[str]()
    limiter = RateLimiter(1000)
    substitute = Substitute(
        silence, 10, lambda now: events.append(f"{now}"), lambda on: events.append(str(on))
    )
    hold = Hold([limiter, substitute], lambda data, _stamp, _now: events.append(data.decode()))
    silence.heard(0)
    hold.offer((b"a", 0), 0)
    hold.offer((b"b", 0), 0)
    assert hold.due_ns == 100
    for now in (99, 100, 109, 110, 150):
        hold.flush(now)
    assert events == ["a", "b", "True", "100", "110", "150"]
    silence.heard(2000)
    hold.offer((b"c", 0), 2000)
    hold.flush(2050)
    assert events[-2:] == ["False", "c"] and hold.due_ns == 2100


def test_subscriber_that_finds_the_bridge_late_misses_nothing(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Volatile subscribers get what was written before the start; other topics wait for nobody."""
    monkeypatch.setattr(hold, "GRACE_NS", 10**15)  # no machine is too slow for this test
    cell.start(TOPICS)
    out, other = cell.plc("/out"), cell.plc("/other")
    cell.stop()
    for number in range(3):
        out.write({"data": number})
        other.write({"data": 10 + number})
    there = cell.listen("/other", INT)
    bridge = cell.start(TOPICS)
    wait_for(lambda: len(there) == 3)
    wait_for(lambda: bridge.status().topic("/out").received == 3)
    assert bridge.status().topic("/out").published == 0
    late = cell.listen("/out", INT)
    wait_for(lambda: len(late) == 3)
    out.write({"data": 3})
    wait_for(lambda: len(late) == 4)
    assert (numbers(late), numbers(there)) == ([0, 1, 2, 3], [10, 11, 12])
    assert bridge.status().topic("/out").published == 4


def test_nobody_comes_and_nothing_is_kept_for_ever(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a subscriber messages go out when the time is over, or when the bridge stops."""
    monkeypatch.setattr(hold, "GRACE_NS", 50_000_000)
    bridge = cell.start(TOPICS)
    cell.plc("/out").write({"data": 1})
    wait_for(lambda: bridge.status().topic("/out").published == 1)
    cell.stop()
    monkeypatch.setattr(hold, "GRACE_NS", 10**15)
    bridge = cell.start(TOPICS)
    cell.plc("/other").write({"data": 2})
    wait_for(lambda: bridge.status().topic("/other").received == 1)
    cell.stop()
    assert bridge.status().topic("/other").published == 1
