"""Twenty topics in each direction at once, over real DDS, with every message counted and compared.

Four programs take part: a ROS peer, the bridge, a PLC, and this one. The peers check each byte of each
message (benchmarks/peers.py).
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from benchmarks.bench_bridge import begin, load_config
from benchmarks.peers import names
from benchmarks.processes import bridge, peers

TOPICS = 20


def carry(folder: Path, text: str, order: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Let both peers send ``count`` messages per topic; return what the ROS peer and the PLC saw."""
    domain = order["domain"]
    with ExitStack() as stack:
        stack.enter_context(bridge(folder, text, domain))
        sides = stack.enter_context(peers("plc ros", order, domain))
        begin(*sides)
        for side in sides:
            reported = side.receive_json(180) | side.receive_json(180)  # in either order
            assert reported == {"sent": order["count"], "arrived": True}
        ros, plc = (side.ask("stop") for side in reversed(sides))
    return ros, plc


@pytest.mark.foreign
@pytest.mark.timeout(240)
@pytest.mark.parametrize(
    ("rate", "seconds"),
    [
        pytest.param(200, 5, id="200Hz"),
        pytest.param(1000, 60, id="1kHz", marks=[pytest.mark.serial, pytest.mark.verify(minutes=3)]),
    ],
)
def test_nothing_is_lost_where_depth_allows_it(
    rate: int, seconds: int, tmp_path: Path, dds_domain: int, shm_prefix: str
) -> None:
    """Of 20 topics in each direction every message arrives once, in order, with every byte as it was."""
    order: dict[str, Any] = {
        "topics": TOPICS,
        "count": rate * seconds,
        "rate": rate,
        "per_scan": 1,
        "qos_depth": 5000,
        "until_last": True,
    }
    order |= {"prefix": shm_prefix, "domain": dds_domain}
    ros, plc = carry(tmp_path, load_config(shm_prefix, TOPICS, depth=4096), order)
    whole = {"received": rate * seconds, "missing": 0, "wrong": 0, "last": rate * seconds}
    assert plc["seen"] == dict.fromkeys(names("in", TOPICS), whole)
    assert ros["seen"] == dict.fromkeys(names("out", TOPICS), whole)
    assert set(plc["lost"].values()) == set(ros["lost"].values()) == {0}
    assert ros["refused"] == 0


@pytest.mark.foreign
@pytest.mark.timeout(240)
@pytest.mark.parametrize(
    ("rate", "seconds"),
    [
        pytest.param(1000, 5, id="5s"),
        pytest.param(1000, 60, id="60s", marks=[pytest.mark.serial, pytest.mark.verify(minutes=3)]),
    ],
)
def test_what_too_small_a_depth_loses_is_counted_to_the_message(
    rate: int, seconds: int, tmp_path: Path, dds_domain: int, shm_prefix: str
) -> None:
    """Where four slots meet a scan of 20 ms, messages that arrive and messages counted as lost are all."""
    order: dict[str, Any] = {
        "topics": TOPICS,
        "count": rate * seconds,
        "rate": rate,
        "per_scan": 20,
        "qos_depth": 5000,
        "until_last": True,
    }
    order |= {"prefix": shm_prefix, "domain": dds_domain}
    ros, plc = carry(tmp_path, load_config(shm_prefix, TOPICS, depth=4, cycle="20ms"), order)
    for seen, lost, kind in ((plc["seen"], plc["lost"], "in"), (ros["seen"], plc["lost"], "out")):
        for topic in names(kind, TOPICS):
            tally = seen[topic]
            assert tally["wrong"] == 0, topic
            # The newest message always stays, so that the last one arrives and every gap lies before it.
            assert tally["last"] == rate * seconds, topic
            assert 0 < lost[topic] == tally["missing"], topic
            assert tally["received"] + lost[topic] == rate * seconds, topic
    assert set(ros["lost"].values()) == {0}
    assert ros["refused"] == 0
