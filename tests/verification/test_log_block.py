"""The blocks of ``rosout: {plc: true}``, executed: lines of the PLC's program on /rosout, and their limit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from rosplc.ros import Qos
from tests.verification.joint import RULES, Joint, made_joint

pytestmark = pytest.mark.verifies("ros-blocks", own="translated Structured Text")

DOMAIN = 58
TYPE = "rcl_interfaces/msg/Log"
CONFIG = f"""bridge: cell
ros: {{backend: memory, domain: {DOMAIN}, namespace: /line}}
shm: {{directory: FOLDER}}
diagnostics: {{enabled: false}}
rosout: {{plc: true}}
topics:
  /in: {{type: std_msgs/msg/Int32, to: plc}}
"""
OWN = """PROGRAM Own
VAR
    fbLog : RosPlc_Log;
    fbOther : RosPlc_Log;
END_VAR
fbLog();
fbOther();
END_PROGRAM
"""


@pytest.fixture(params=RULES)
def joint(request: pytest.FixtureRequest) -> Iterator[Joint]:
    with made_joint(CONFIG, "ROS_Write", DOMAIN, own=OWN, rule=request.param) as made:
        yield made


def listen(joint: Joint) -> list[Any]:
    """Return the list that fills with the PLC's lines."""
    store, found = get_typestore(Stores.ROS2_JAZZY), []

    def take(data: bytes, _: int) -> None:
        line: Any = store.deserialize_cdr(data, TYPE)
        if line.name.endswith(".plc"):
            found.append(line)

    joint.peer.subscribe("/rosout", TYPE, Qos(durability="transient_local", depth=1000), take)
    return found


def log(joint: Joint, block: str, text: str, level: int = 20, step: int = 2) -> tuple[bool, bool]:
    """Give a block a rising edge; return xDone and xSuppressed."""
    for pins in ({"xExecute": False}, {"sText": text, "eLevel": level, "xExecute": True}):
        for name, value in pins.items():
            joint.machine.set(f"Own.{block}.{name}", value)
        joint.scan(step)
    return joint.machine.get(f"Own.{block}.xDone"), joint.machine.get(f"Own.{block}.xSuppressed")


def test_a_line_of_each_block_reaches_rosout_once(joint: Joint) -> None:
    """With level, text, the node's name and a stamp; a block that stays executed logs once."""
    lines = listen(joint)
    assert log(joint, "fbLog", "door open", 30) == (True, False)
    assert log(joint, "fbOther", "x" * 200, 50) == (True, False)
    joint.scan(count=20)
    joint.until(lambda: len(lines) == 2, "both lines")
    assert [(line.level, line.msg, line.name) for line in lines] == [
        (30, "door open", "line.rosplc_cell.plc"),
        (50, "x" * 200, "line.rosplc_cell.plc"),
    ]
    assert all(line.stamp.sec > 1_600_000_000 for line in lines)
    joint.machine.set("Own.fbLog.xExecute", False)
    joint.scan()
    assert joint.machine.get("Own.fbLog.xDone") is False


def test_more_lines_than_the_limit_are_suppressed_and_counted(joint: Joint) -> None:
    """A burst of ten, then one in a second; the next line tells how many were kept back."""
    lines = listen(joint)
    found = [log(joint, "fbLog", f"line {number}") for number in range(14)]
    assert found == [(True, False)] * 10 + [(False, True)] * 4
    assert joint.machine.get("Own.fbLog.uliSuppressed") == 4
    joint.until(lambda: len(lines) == 10, "ten lines")
    assert joint.get("rosout", "uliSuppressed") == 4
    joint.scan(step=1000)
    assert log(joint, "fbOther", "later") == (True, False)
    assert log(joint, "fbOther", "too early") == (False, True)
    joint.until(lambda: len(lines) == 11, "the line after them")
    assert lines[-1].msg == "later (the PLC suppressed 4 lines before it)"


def test_lines_wait_for_the_bridge(joint: Joint) -> None:
    """What is logged while no bridge runs is sent when one does."""
    joint.until(lambda: joint.get("rosout", "xReady"), "the claim")
    joint.stop_bridge()
    assert log(joint, "fbLog", "alone") == (True, False)
    lines = listen(joint)
    joint.start_bridge()
    joint.until(lambda: lines, "the line")
    assert lines[0].msg == "alone"
