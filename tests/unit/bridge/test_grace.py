"""What a PLC wrote while the bridge was down reaches subscribers that find the bridge a moment later."""

from __future__ import annotations

import pytest

from rosplc.bridge import to_ros
from rosplc.bridge.grace import GRACE_NS, Grace
from tests.unit.bridge.conftest import INT, Cell, numbers, wait_for

TOPICS = (
    f"  /out: {{type: {INT}, to: ros, latched: false}}\n  /other: {{type: {INT}, to: ros, latched: false}}\n"
)


def test_items_wait_for_somebody() -> None:
    """Items wait in order until somebody is there, and later ones follow them at once."""
    there: list[bool] = []
    grace: Grace[int] = Grace(1000, 10, lambda: bool(there))
    assert [grace.offer(item, 0) for item in (1, 2)] == [True, True]
    assert grace.due_ns == 1000  # the end comes before the next look
    assert list(grace.release(10)) == []
    there.append(True)
    assert not grace.offer(3, 20)
    assert list(grace.release(20)) == [1, 2]
    assert (grace.over, grace.due_ns) == (True, None)
    there.clear()
    assert not grace.offer(4, 30)  # it never opens again


def test_waiting_ends() -> None:
    """When the time is over, or when there are too many, everything goes."""
    grace: Grace[int] = Grace(1000, 10, lambda: False)
    assert grace.offer(1, 0)
    assert list(grace.release(1000)) == [1]
    full: Grace[int] = Grace(1000, 2, lambda: False)
    assert [full.offer(item, 0) for item in (1, 2, 3)] == [True, True, False]
    assert list(full.release(0)) == [1, 2]
    stopped: Grace[int] = Grace(1000, 2, lambda: False)
    stopped.offer(1, 0)
    assert list(stopped.release(0, anyway=True)) == [1]


def test_newest_alone_waits_where_the_newest_alone_counts() -> None:
    """With room for one, a newer item takes the place of the one that waits."""
    grace: Grace[int] = Grace(1000, 1, lambda: False)
    assert [grace.offer(item, 0) for item in (1, 2, 3)] == [True, True, True]
    assert grace.replaced == 2
    assert list(grace.release(1000)) == [3]
    assert GRACE_NS == 10**9


def test_subscriber_that_finds_the_bridge_late_misses_nothing(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Volatile subscribers get what was written before the start; other topics wait for nobody."""
    monkeypatch.setattr(to_ros, "GRACE_NS", 10**15)  # no machine is too slow for this test
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
    monkeypatch.setattr(to_ros, "GRACE_NS", 50_000_000)
    bridge = cell.start(TOPICS)
    cell.plc("/out").write({"data": 1})
    wait_for(lambda: bridge.status().topic("/out").published == 1)
    cell.stop()
    monkeypatch.setattr(to_ros, "GRACE_NS", 10**15)
    bridge = cell.start(TOPICS)
    cell.plc("/other").write({"data": 2})
    wait_for(lambda: bridge.status().topic("/other").received == 1)
    cell.stop()
    assert bridge.status().topic("/other").published == 1
