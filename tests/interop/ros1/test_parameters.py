"""Parameters of the PLC (executed Structured Text) on a real master, set by rosparam and rospy."""

from __future__ import annotations

import ast
import random
import struct
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from tests.interop.ros1.graph import PACKAGES, PYTHON, Graph, lend
from tests.verification.joint import Joint, made_joint
from tests.verification.test_parameters_bridge import CONFIG as ROS2
from tests.verification.test_parameters_bridge import INITIAL, NEW, held, some

pytestmark = [
    pytest.mark.needs(*PACKAGES, "python3-rosparam"),
    pytest.mark.timeout(300),
    pytest.mark.verifies("ros1", real="rosparam"),
]

CONFIG = ROS2.replace("backend: memory, domain: 57", "backend: rospy, distro: noetic")
PLACE = "/rosplc_params"


class Cell:
    """A PLC and its bridge, with programs of ROS 1 that run while the PLC does."""

    def __init__(self, ros1: Graph, joint: Joint) -> None:
        self.ros1, self.joint = ros1, joint
        self.log = ros1.peer("rospy", "ears").subscribe("/rosout", "rosgraph_msgs/msg/Log")

    def run(self, *command: str) -> str:
        """Run a program of ROS 1 to its end; return what it prints."""
        program = subprocess.Popen(
            command, env=self.ros1.variables, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self.joint.until(lambda: program.poll() is not None, "the end of a program")
        said = program.communicate()[0]
        assert program.returncode == 0, said
        return said

    def set(self, name: str, value: object) -> None:
        self.run("rosparam", "set", f"{PLACE}/{name}", str(value))

    def rospy(self, call: str) -> Any:
        """Return what an expression of rospy says."""
        return ast.literal_eval(self.run(PYTHON, "-c", f"import rospy; print(repr(rospy.{call}))"))

    def values(self) -> dict[str, Any]:
        """Return the node's parameters on the master, by the PLC's names."""
        tree: dict[str, Any] = self.rospy(f"get_param('{PLACE}', {{}})")
        inner = {f"arm.{name}": value for name, value in tree.pop("arm", {}).items()}
        return tree | inner

    def until_said(self, *words: str) -> None:
        """Wait for a line of the bridge's in /rosout that a node of rospy has received."""

        def said() -> bool:
            lines = [data.decode(errors="replace") for data in self.log.payloads()]
            return any(all(word in line for word in words) for line in lines)

        self.joint.until(said, words[0])

    def until_values(self, values: dict[str, Any]) -> None:
        """Wait until the master has them: bytes as numbers, and numbers of more than 32 bits as doubles."""
        expected = {n: list(v) if isinstance(v, bytes) else v for n, v in values.items()}
        expected["arm.ints"] = [float(n) if abs(n) >= 2**31 else n for n in expected["arm.ints"]]
        texts = {name: repr(value) for name, value in expected.items()}
        self.joint.until(lambda: {n: repr(v) for n, v in self.values().items()} == texts, "the values")


@pytest.fixture
def ros1(monkeypatch: pytest.MonkeyPatch) -> Iterator[Graph]:
    with lend() as graph:
        for name, value in graph.environment.items():
            monkeypatch.setenv(name, value)
        yield graph
        graph.kill_master()  # its parameters are no other test's


@pytest.fixture
def cell(ros1: Graph) -> Iterator[Cell]:
    with made_joint(CONFIG, "ROS_Parameters", 0, "rospy") as joint:
        yield Cell(ros1, joint)


def test_values_and_refusals(cell: Cell) -> None:
    """All kinds are on the master; what is set is in the program; what cannot be is set back, with words."""
    cell.joint.until(lambda: cell.joint.get("block", "xValid"), "the PLC")
    cell.until_values(INITIAL)
    cell.set("count", 7)
    cell.joint.until(lambda: held(cell.joint)["count"] == 7, "the set in the program")
    new = {n: list(v) if isinstance(v, bytes) else v for n, v in NEW.items()}
    arm = {name.partition(".")[2]: new.pop(name) for name in list(new) if name.startswith("arm.")}
    sets = cell.joint.get("block", "udiSets")
    cell.rospy(f"set_param('{PLACE}', {new | {'arm': arm, 'serial': 'A-1'}!r})")
    cell.joint.until(lambda: held(cell.joint) == some(NEW), "the set")
    assert cell.joint.get("block", "udiSets") == sets + 1
    cell.until_values(INITIAL | NEW)

    for name, value, why in (
        ("max_speed", 9.0, "max_speed must be within 0.0 … 2.0"),
        ("count", "many", "'many' is not of type integer"),
        ("serial", "B", "it is read-only"),
        ("arm/gains", "[1, 2, 3, 4]", "arm.gains can have at most 3 elements, not 4"),
    ):
        cell.set(name, value)
        cell.until_values(INITIAL | NEW)
        cell.until_said(f"{PLACE}/{name} is reset to", why)
    cell.set("arm", 5)  # the whole group is gone, and comes again
    cell.until_values(INITIAL | NEW)
    cell.run("rosparam", "delete", f"{PLACE}/count")
    cell.until_values(INITIAL | NEW)

    cell.joint.machine.set("ROS_Parameters.values.serial", "C-3")
    cell.set("max_speed", "1")  # a whole number is a double, too
    cell.until_values(INITIAL | NEW | {"serial": "C-3", "max_speed": 1.0})
    dumped = str(cell.joint.folder / "dumped.yaml")
    cell.run("rosparam", "dump", dumped, PLACE)
    cell.set("count", 12)
    cell.joint.until(lambda: held(cell.joint)["count"] == 12, "another set")
    cell.run("rosparam", "load", dumped, PLACE)
    cell.joint.until(lambda: held(cell.joint)["count"] == -4, "the values of the file")


def test_no_plc_and_another_master(cell: Cell) -> None:
    """What no PLC takes is set back; a master that begins again gets all values, and is followed."""
    cell.joint.until(lambda: cell.joint.get("block", "xValid"), "the PLC")
    cell.until_values(INITIAL)
    cell.joint.machine.stop()
    cell.joint.scan = lambda *_, **__: None  # type: ignore[method-assign]
    cell.set("count", 5)
    cell.until_values(INITIAL)
    cell.until_said(f"{PLACE}/count is reset to 3 on the parameter server: PLC is not running")
    del cell.joint.scan  # type: ignore[attr-defined]
    cell.joint.machine.start()
    cell.ros1.kill_master()
    cell.ros1.start_master()
    cell.until_values(INITIAL)
    cell.set("count", 6)
    cell.joint.until(lambda: held(cell.joint)["count"] == 6, "a set at the new master")


def test_values_that_a_launch_file_has_set(ros1: Graph) -> None:
    """They replace those of the configuration; those of a PLC that has run before are kept."""
    ros1.run("rosparam", "set", f"{PLACE}/count", "8")
    ros1.run("rosparam", "set", f"{PLACE}/max_speed", "9.0")
    with made_joint(CONFIG, "ROS_Parameters", 0, "rospy") as joint:
        cell = Cell(ros1, joint)
        joint.until(lambda: joint.get("block", "xValid"), "the PLC")
        assert (held(joint)["count"], held(joint)["max_speed"]) == (8, 0.5)
        cell.until_values(INITIAL | {"count": 8})
        joint.kill_bridge()
        joint.machine.set("ROS_Parameters.values.count", 9)
        cell.set("count", 10)
        joint.start_bridge()
        cell.until_values(INITIAL | {"count": 9})
        assert held(joint)["count"] == 9


def test_kills_between_a_set_and_its_taking(cell: Cell) -> None:
    """The master has in the end what the PLC has: the set, or what was before."""
    dice, outcomes = random.Random(14), {"taken": 0, "not": 0}
    cell.joint.until(lambda: cell.joint.get("block", "xValid"), "the PLC")
    for number in range(1, 7):
        before = 1000 * number
        # A bridge that has just begun sets back what was set before.
        while held(cell.joint)["count"] != before:
            cell.set("count", before)
            cell.joint.scan(count=20)
        cell.set("count", before + 1)
        scans = iter(range(dice.randrange(60)))
        cell.joint.until(lambda scans=scans: next(scans, None) is None, "the moment of the kill")
        cell.joint.kill_bridge()
        cell.joint.scan(count=20)
        now = held(cell.joint)["count"]
        assert now in (before, before + 1)
        outcomes["taken" if now > before else "not"] += 1
        cell.joint.start_bridge()
        cell.until_values(INITIAL | {"count": now})
        assert held(cell.joint)["count"] == now
    print("COUNTED", outcomes)


LOG = """PROGRAM Own
VAR
    fbLog : RosPlc_Log;
END_VAR
fbLog(sText := 'door open', eLevel := 30, xExecute := TRUE);
END_PROGRAM
"""


def test_the_time_of_clock_and_both_logs(ros1: Graph) -> None:
    """The master's /use_sim_time holds for the PLC's block, at once; rospy hears the bridge and the PLC."""
    config = CONFIG.replace("parameters:\n", "time: {plc: true}\nrosout: {plc: true}\nparameters:\n")
    with made_joint(config, "ROS_Parameters", 0, "rospy", own=LOG) as joint:
        cell = Cell(ros1, joint)
        seen = lambda name: joint.machine.get(f"ROS_Read.ros_time.{name}")  # noqa: E731
        joint.until(lambda: seen("xKnown"), "the time")
        clock = ros1.peer("rospy", "sim").advertise("/clock", "rosgraph_msgs/msg/Clock")
        assert not seen("xSim")
        cell.run("rosparam", "set", "/use_sim_time", "true")
        message = struct.pack("<II", 7, 5)
        joint.until(
            lambda: clock.write(message) or (seen("xSim") and seen("uliNow") == 7_000_000_005), "/clock"
        )
        cell.run("rosparam", "set", "/use_sim_time", "false")
        joint.until(lambda: not seen("xSim") and seen("uliNow") > 10**18, "the system's time")
        assert cell.rospy("get_param('/use_sim_time')") is False

        cell.until_said("door open", "/rosplc_params.plc")
        cell.set("count", "many")
        cell.until_said(f"{PLACE}/count is reset to 3", "/rosplc_params")
        levels = {
            text: data[struct.calcsize("<III") + int.from_bytes(data[12:16], "little") + 4]
            for data in cell.log.payloads()
            for text in ("door open", "is reset")
            if text.encode() in data
        }
        assert levels == {"door open": 4, "is reset": 4}  # rosgraph_msgs/Log.WARN
