"""ROS time towards the PLC: where it comes from, and what the PLC's record has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rosplc.bridge import Bridge
from rosplc.bridge.ros_time import TOPIC, RosTime
from rosplc.codec import Codec, Wire
from rosplc.config import ConfigErrors, parse_config, resolve
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import Qos, RosArguments, open_backend
from tests.lib.clock import SteppedClock
from tests.lib.waiting import wait_for
from tests.unit.bridge.conftest import DOMAIN, INT, Cell, wire

CLOCK = "rosgraph_msgs/msg/Clock"
NONE = "  {}\n"
TIME = "time: {plc: true}"
SIM = "time: {plc: true, use_sim_time: true}"


def newest(cell: Cell) -> dict[str, Any] | None:
    return cell._plc[0].read() if cell._plc else cell.plc(TOPIC).read()


def test_the_time_of_the_system(cell: Cell) -> None:
    """It is written again and again, and the topic has a source."""
    clock = SteppedClock()
    bridge = cell.start(NONE, more=TIME, clock=clock)
    clock.until_waiting(3)
    cell.plc(TOPIC)
    for _ in range(3):
        clock.step(0.1)
        found = wait_for(lambda: newest(cell))
        assert (found["now"], found["sim"]) == (clock.time_ns(), False)
    (topic,) = bridge.status().topics
    assert (topic.topic, topic.matched, topic.stale) == (TOPIC, 1, False)


def test_the_time_of_clock(cell: Cell) -> None:
    """With use_sim_time /clock is subscribed to, and nothing is written before it has come."""
    bridge = cell.start(NONE, more=SIM)
    assert bridge.status().topics[0].matched == 0
    cell.plc(TOPIC)
    assert newest(cell) is None
    publisher = cell.publisher("/clock", CLOCK, Qos(depth=1))
    publisher.write(wire(CLOCK, {"clock": {"sec": 7, "nanosec": 5}}))
    found = wait_for(lambda: newest(cell))
    assert (found["now"], found["sim"]) == (7_000_000_005, True)
    wait_for(lambda: bridge.status().topics[0].matched == 1)
    cell.stop()
    assert publisher.matched == 0


@pytest.mark.parametrize("given", ["-p use_sim_time:=true", "-p rosplc_cell:use_sim_time:=True", "file"])
def test_the_parameter_of_the_command_line(cell: Cell, given: str, tmp_path: Path) -> None:
    """`-p use_sim_time:=true` says the same as the configuration, and so does a file of parameters."""
    if given == "file":
        (tmp_path / "p.yaml").write_text("rosplc_cell: {ros__parameters: {use_sim_time: true}}\n")
        given = f"--params-file {tmp_path / 'p.yaml'}"
    arguments = RosArguments.parse(given.split())
    publisher = cell.publisher("/clock", CLOCK)
    with Bridge(parse_config(cell.config(NONE, more=TIME)), arguments=arguments):
        assert publisher.matched == 1
    with Bridge(parse_config(cell.config(NONE, more=TIME)), arguments=RosArguments.parse([])):
        assert publisher.matched == 0


def test_clock_of_ros_1(cell: Cell) -> None:
    """Its message has no encapsulation."""
    text = cell.config(NONE, more=SIM).replace("backend: memory", "distro: noetic, backend: memory")
    store = TypeStore.bundled("noetic")
    peer = open_backend("memory", store, "peer1", domain=DOMAIN)
    layout = compute_layout(store, CLOCK)
    data = Codec(layout, Wire.ROS1).encode(layout.pack({"clock": {"sec": 9, "nanosec": 1}}))
    assert len(data) == 8
    with Bridge(parse_config(text)) as bridge:
        cell.bridge = bridge
        cell.plc(TOPIC)
        peer.advertise("/clock", CLOCK, Qos()).write(data)
        assert wait_for(lambda: newest(cell))["now"] == 9_000_000_001
        cell.bridge = None
    peer.close()


def test_a_slow_way_to_the_plc_is_told(cell: Cell) -> None:
    """The record has the longest way of late, so that the block's uncertainty has it, too."""
    clock = SteppedClock()
    project = resolve(parse_config(cell.config(NONE, more=TIME)))
    made = RosTime(project, cell.peer, clock, sim=False)
    layout = project.topic(TOPIC).layout
    told = []

    def take(data: bytes, _: int) -> None:
        told.append(layout.to_dict(Codec(layout, Wire.CDR).decode(data))["transfer"])
        clock.advance(ns=1_000_000 if len(told) == 1 else 0)

    made.write()  # before there is a stream
    made.subscribe(TOPIC, project.topic(TOPIC).type_name, Qos(), take)
    for _ in range(4):
        made.write()
    assert told == [0, 1_000_000, 900_000, 810_000]
    made.close()
    made.write()
    assert len(told) == 4


def test_the_topic_is_the_bridges_own(cell: Cell) -> None:
    """It is not on the graph, excludes one of the same name, and is kept by a reload."""
    bridge = cell.start(NONE, more=f"{TIME}\nrosout: {{bridge: false}}")
    assert TOPIC not in {end.topic for end in cell.peer.graph().endpoints}
    more = f"{TIME}\nrosout: {{bridge: false}}\ntasks: {{Other: {{}}}}"
    changes = bridge.reload(parse_config(cell.config(NONE, more=more)))
    assert [new.topic for _, new in changes.changed] == [TOPIC]
    cell.plc(TOPIC)
    assert wait_for(lambda: newest(cell))
    cell.stop()
    with pytest.raises(ConfigErrors, match="the bridge itself already carries /ros_time"):
        cell.make(f"  {TOPIC}: {{type: {INT}, to: plc}}\n", more=TIME)
