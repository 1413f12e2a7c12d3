"""What a bridge in the foreground logs of its status."""

from __future__ import annotations

import logging
from dataclasses import replace

import pytest

from rosplc.bridge.run import _Reporter
from rosplc.bridge.status import BridgeStatus, ServiceStatus, TopicStatus
from rosplc.shm import Direction


def status(**topic: object) -> BridgeStatus:
    """Return a bridge with one topic that stands so."""
    state = TopicStatus("/in", "std_msgs/msg/Int32", Direction.TO_PLC, matched=1, **topic)  # type: ignore[arg-type]
    return BridgeStatus(bridge="cell", backend="dds", running=True, topics=(state,))


def test_only_news_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    """A topic that stays stale is named once, whatever its age; recovery is news again."""
    reporter = _Reporter()
    with caplog.at_level(logging.INFO, "rosplc.run"):
        for second in (2, 3, 4):
            reporter.report(status(stale=True, silent=True, age_ns=second * 10**9))
        for rate in (10.0, 11.0):
            reporter.report(status(rate_hz=rate, peer_alive=True))
    lines = [record.getMessage() for record in caplog.records if record.getMessage().startswith("/in: ")]
    assert len(lines) == 2
    assert lines[0].startswith("/in: STALE: last message 2")
    assert lines[1] == "/in: OK"


def test_services_are_counted_and_named(caplog: pytest.LogCaptureFixture) -> None:
    """A bridge without topics says how its services are."""
    reporter = _Reporter()
    state = ServiceStatus(service="/start", type_name="std_srvs/srv/Trigger", server="plc")
    with caplog.at_level(logging.INFO, "rosplc.run"):
        reporter.report(replace(status(), topics=(), services=(state,)))
        reporter.report(replace(status(), topics=(), services=(replace(state, peer_alive=True),)))
    lines = [record.getMessage() for record in caplog.records]
    assert [line.rpartition("; ")[2] for line in lines if line.startswith("status: ")] == [
        "0 of 1 services and actions fine",
        "1 of 1 services and actions fine",
    ]
    assert [line for line in lines if line.startswith("service /start")] == [
        "service /start: WARN: no PLC task serves it",
        "service /start: OK",
    ]
