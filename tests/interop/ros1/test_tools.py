"""ROS 1's own command line tools see the backend's node as any other."""

from __future__ import annotations

import re
import struct
import subprocess
import threading
import time
from collections.abc import Iterator

import pytest

from rosplc.model import TypeStore
from rosplc.ros import LATCHED, Backend, Qos, open_backend
from tests.interop.ros1.graph import PACKAGES, Graph, lend
from tests.interop.ros1.test_peers import Inbox, string, values
from tests.lib.waiting import wait_for

pytestmark = [
    pytest.mark.needs(*PACKAGES),
    pytest.mark.timeout(120),
    pytest.mark.verifies("ros1", real="`rostopic`, `rosnode`"),
]

STORE = TypeStore.bundled("noetic")
STRING = "std_msgs/msg/String"


@pytest.fixture
def ros1() -> Iterator[Graph]:
    with lend() as graph:
        yield graph


@pytest.fixture
def cell(ros1: Graph) -> Iterator[Backend]:
    backend = open_backend("rospy", STORE, "cell", environment=ros1.environment)
    yield backend
    backend.close()


def said(program: subprocess.Popen[str]) -> list[str]:
    """Collect the lines that a program prints, as they come."""
    lines: list[str] = []

    def read() -> None:
        assert program.stdout is not None
        lines.extend(iter(program.stdout.readline, ""))

    threading.Thread(target=read, daemon=True).start()
    return lines


def test_lists_and_infos_show_the_node(ros1: Graph, cell: Backend) -> None:
    """The tools list the node, its topics with types, and its connections; it answers a ping."""
    outbox = cell.advertise("/joint_states", "sensor_msgs/msg/JointState", Qos())
    cell.subscribe("/cmd_vel", "geometry_msgs/msg/Twist", Qos(), Inbox())
    peer = ros1.peer("roscpp", "peer")
    peer.subscribe("/joint_states", "sensor_msgs/JointState")
    wait_for(lambda: outbox.matched)
    wait_for(lambda: "/cmd_vel" in ros1.run("rostopic", "list"))
    assert {"/cell", "/peer"} <= set(ros1.run("rosnode", "list").split())
    node = ros1.run("rosnode", "info", "/cell")
    assert "* /joint_states [sensor_msgs/JointState]" in node
    assert "* /cmd_vel [" in node  # rosnode knows the types of published topics alone
    assert re.search(r"topic: /joint_states\n\s+\* to: /peer\n\s+\* direction: outbound", node)
    assert "Pid:" in node
    assert "xmlrpc reply from" in ros1.run("rosnode", "ping", "-c", "1", "/cell")
    topic = ros1.run("rostopic", "info", "/joint_states")
    assert topic.startswith("Type: sensor_msgs/JointState")
    assert re.search(r"Publishers: \n \* /cell .*\n\nSubscribers: \n \* /peer ", topic)
    assert ros1.run("rostopic", "type", "/cmd_vel").strip() == "geometry_msgs/Twist"


def test_echo_prints_what_is_sent(ros1: Graph, cell: Backend) -> None:
    """What rostopic echo shows are the values of a message that the backend sent."""
    outbox = cell.advertise("/cmd_vel", "geometry_msgs/msg/Twist", LATCHED)
    outbox.write(values("geometry_msgs/msg/Twist", 2)[1])
    shown = ros1.run("rostopic", "echo", "-n", "1", "/cmd_vel")
    assert re.search(r"linear: *\n +x: 1\.5\n +y: -0\.333333", shown)
    assert "z: 0.25" in shown


def test_hz_measures_the_rate(ros1: Graph, cell: Backend) -> None:
    """What rostopic hz counts are the messages of the backend's topic."""
    outbox = cell.advertise("/chatter", STRING, Qos())
    lines = said(ros1.start("rostopic", "hz", "/chatter"))
    wait_for(lambda: outbox.matched)

    def measured() -> bool:
        outbox.write(string("x"))
        time.sleep(0.02)
        return any("average rate" in line for line in lines)

    wait_for(measured)


def test_pub_reaches_the_backend(ros1: Graph, cell: Backend) -> None:
    """What rostopic pub sends arrives, latched as it is."""
    ros1.start("rostopic", "pub", "/cmd_vel", "geometry_msgs/Twist", "{linear: {x: 0.5}, angular: {z: -2}}")
    inbox = Inbox()
    cell.subscribe("/cmd_vel", "geometry_msgs/msg/Twist", Qos(), inbox)
    wait_for(lambda: inbox)
    assert struct.unpack("<6d", inbox[0]) == (0.5, 0, 0, 0, 0, -2)


def test_sums_are_those_of_rosmsg(ros1: Graph) -> None:
    """The MD5 sums that the backend announces are those that rosmsg prints."""
    for name in ("std_msgs/Header", "std_msgs/String", "std_msgs/UInt8MultiArray"):
        assert ros1.run("rosmsg", "md5", name).strip() == STORE.md5(name)


def test_rosnode_kill_is_reported(ros1: Graph, cell: Backend) -> None:
    """A node that rosnode kill ends leaves the graph, and its status says who told it to."""
    inbox = cell.subscribe("/in", STRING, Qos(), Inbox())
    wait_for(lambda: "/cell" in ros1.run("rosnode", "list"))
    assert "killed" in ros1.run("rosnode", "kill", "/cell")
    wait_for(lambda: inbox.status().code == "ROS015")
    assert re.search("asked node /cell to shut down", inbox.status().reason)
    wait_for(lambda: "/cell" not in ros1.run("rosnode", "list"))
