"""The blocks for OpenPLC in its own runtime, under its scheduler, with a live bridge and a ROS node over DDS.

``ROSPLC_OPENPLC`` names a checkout of OpenPLC Runtime 4.1 whose ``build/plc_main`` was built,
``ROSPLC_STRUCPP`` one of STruC++; no registry has them. The runtime's socket is in /run/runtime: no other
runtime may run on the machine meanwhile.
"""

from __future__ import annotations

import os
import random
import re
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from rosplc.codec import Codec, Wire
from rosplc.config.resolve import Project, load_project
from rosplc.demo.openplc import Runtime, compile_prepared, prepare
from rosplc.demo.plan import FreeDomain
from rosplc.layout import compute_layout
from rosplc.ros import SERVICES, Qos, open_backend
from rosplc.ros.backend import Reply
from rosplc.shm import Namespace
from tests.docs.pages import blocks
from tests.e2e.cell import Bridge
from tests.lib.waiting import wait_for
from tests.verification.crossing import random_record
from tests.verification.test_openplc import KINDS, PART

pytestmark = [
    pytest.mark.needs(variable="ROSPLC_OPENPLC"),
    pytest.mark.needs(variable="ROSPLC_STRUCPP"),
    pytest.mark.serial,
    pytest.mark.timeout(600),
    pytest.mark.verifies("openplc", real="OpenPLC's runtime (where a built checkout is available)"),
]
TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorial" / "openplc.md"
QOS = Qos(reliability="reliable", durability="volatile", depth=200)
# Two tasks; in the slower one the blocks and the message are retained. No program has the name of a task,
# which matiec's C would not compile.
PROGRAM = """PROGRAM Often
VAR
    there : kinds_All_Read;
    back : kinds_All_Write;
    more : BOOL;
END_VAR
there(sTopic := '/there', xInOrder := TRUE);
more := there.xNew;
WHILE more DO
    back.msg := there.msg;
    back(sTopic := '/back', xEnable := TRUE);
    more := there.Next();
END_WHILE;
back(sTopic := '/back', xEnable := FALSE);
END_PROGRAM
PROGRAM Seldom
VAR RETAIN
    there : kinds_All_Read;
    back : kinds_All_Write;
END_VAR
VAR
    more : BOOL;
END_VAR
there(sTopic := '/slow_there', xInOrder := TRUE, uiMaxPerScan := 64);
more := there.xNew;
WHILE more DO
    back.msg := there.msg;
    back(sTopic := '/slow_back', xEnable := TRUE);
    more := there.Next();
END_WHILE;
back(sTopic := '/slow_back', xEnable := FALSE);
END_PROGRAM
CONFIGURATION Config0
  RESOURCE Res0 ON PLC
    TASK fast(INTERVAL := T#10ms, PRIORITY := 2);
    TASK slow(INTERVAL := T#50ms, PRIORITY := 1);
    PROGRAM instance0 WITH fast : Often;
    PROGRAM instance1 WITH slow : Seldom;
  END_RESOURCE
END_CONFIGURATION
"""
CALLS = """PROGRAM Calls
VAR
    start : std_srvs_SetBool_Server;
    pick : std_srvs_SetBool_Client;
    pick_again : BOOL;
END_VAR
start(sName := '/start', xReply := start.xRequest);
start.response.success := start.request.data;
start.response.message := 'served by the PLC';
pick.request.data := pick.response.success;
pick(sName := '/close', xExecute := pick_again);
pick_again := NOT (pick.xDone OR pick.xError);
END_PROGRAM
CONFIGURATION Config0
  RESOURCE Res0 ON PLC
    TASK fast(INTERVAL := T#10ms, PRIORITY := 2);
    PROGRAM instance0 WITH fast : Calls;
  END_RESOURCE
END_CONFIGURATION
"""


class Plc:
    """OpenPLC's runtime with a program, in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._runtime: Runtime | None = None

    def load(self, project: Project, program: str, fault: Path | None = None) -> None:
        """Build a program; with ``fault`` a copy of a message breaks off half-way once that file is there."""
        prepare(self._folder, project, program)
        if fault is not None:
            blocks = self._folder / "core" / "generated" / "rosplc_blocks.cpp"
            text = blocks.read_text()
            half = re.compile(r"(void put\(uint8_t \*to, const KINDS_ALL &from\)\n\{\n(?:.*\n){12})")
            broken = f'if (!unlink("{fault}")) raise(SIGSEGV);'
            text, count = half.subn(rf"\1    {broken}\n", text)
            assert count == 1
            blocks.write_text(f"#include <signal.h>\n#include <unistd.h>\n{text}")
        compile_prepared(self._folder)

    def start(self) -> None:
        self._runtime = Runtime(self._folder)

    def kill(self) -> None:
        if self._runtime is not None:
            self._runtime.kill()
            self._runtime = None

    def restart(self) -> None:
        """Stop the program, and start it."""
        self.become("STOP", "STOPPED")
        self.become("START", "RUNNING")

    def become(self, command: str, state: str) -> None:
        """Give a command until it is taken, and wait for the state."""
        wait_for(lambda: f"{command}:OK" in Runtime.ask(command), f"{command} is taken")
        wait_for(lambda: state in Runtime.ask("STATUS"), state)


class Ros:
    """A ROS node that sends random messages and compares what comes back."""

    def __init__(self, project: Project, domain: int) -> None:
        self.node = open_backend("dds", project.store, "peer", domain=domain)
        self._draw = random.Random(15)
        self._layout = project.topics[0].layout
        self._codec = Codec(self._layout, Wire.CDR)
        self.heard: dict[str, list[bytes]] = {"": [], "slow_": []}
        self.sent: dict[str, list[bytes]] = {"": [], "slow_": []}
        self._out = {}
        for way, heard in self.heard.items():
            self._out[way] = self.node.advertise(f"/{way}there", "kinds/msg/All", QOS)

            def take(payload: bytes, *_: object, heard: list[bytes] = heard) -> None:
                heard.append(bytes(payload))

            self.node.subscribe(f"/{way}back", "kinds/msg/All", QOS, take)

    def matched(self) -> bool:
        return all(out.matched for out in self._out.values())

    def send(self, way: str) -> bytes:
        wire = self._codec.encode(random_record(self._layout, self._draw))
        self._out[way].write(wire)
        self.sent[way].append(wire)
        return wire

    def until_back(self) -> None:
        """Send on both ways until a message has come back on each."""
        for way in self.heard:
            begun = len(self.sent[way])

            def again(way: str = way, begun: int = begun) -> bool:
                self.send(way)
                time.sleep(0.02)
                return bool(set(self.sent[way][begun:]) & set(self.heard[way]))

            wait_for(again, f"/{way}back")

    def whole(self, count: int) -> None:
        """Have ``count`` messages cross each way, one every 5 ms, and all come back in order."""
        begun = {way: len(self.sent[way]) for way in self.sent}
        for _ in range(count):
            for way in self.sent:
                self.send(way)
            time.sleep(0.005)
        for way, heard in self.heard.items():
            last = self.sent[way][-1]
            wait_for(lambda heard=heard, last=last: last in heard, f"the last of /{way}back")
            sent = self.sent[way][begun[way] :]
            assert heard[heard.index(sent[0]) :] == sent

    def nothing_else(self) -> str:
        """Check that all that came back was sent, in order and once; say how many were lost."""
        lost = 0
        for way, heard in self.heard.items():
            place = {wire: number for number, wire in enumerate(self.sent[way])}
            numbers = [place[wire] for wire in heard]  # a KeyError is a wrong message
            assert numbers == sorted(set(numbers)), way
            lost += len(place) - len(numbers)
        return f"{sum(map(len, self.sent.values()))} sent, {lost} lost"

    def close(self) -> None:
        self.node.close()


class Cell:
    """A PLC's runtime, a bridge and a ROS node."""

    def __init__(self, folder: Path, prefix: str, domain: int, runtime: Callable[[Path], Any] = Plc) -> None:
        package = folder / "kinds" / "msg"
        package.mkdir(parents=True)
        (package / "Part.msg").write_text(PART)
        (package / "All.msg").write_text(KINDS)
        (folder / "kinds" / "package.xml").write_text("<package><name>kinds</name></package>")
        about = "type: kinds/msg/All, slots: 64, limits: {string: 20, sequence: 3, long: 200, 'longs[]': 150}"
        self.path = folder / "rosplc.yaml"
        self.path.write_text(
            f"prefix: {prefix}\ntypes: {{paths: [kinds]}}\nros: {{backend: dds, domain: {domain}}}\ntopics:\n"
            + "".join(
                f"  /{way}{name}: {{{about}, to: {to}, qos: {{depth: 200}}}}\n"
                for way in ("", "slow_")
                for name, to in (("there", "plc"), ("back", "ros"))
            )
            + "services:\n"
            "  /start: {type: std_srvs/srv/SetBool, server: plc}\n"
            "  /close: {type: std_srvs/srv/SetBool, server: ros}\n"
        )
        self.project = load_project(self.path)
        (folder / "runtime").mkdir()
        self.runtime = runtime(folder / "runtime")
        self.bridge = Bridge(self.path, os.environ)
        self.ros = Ros(self.project, domain)
        self.fault = folder / "fault"

    def begin(self, **how: Path) -> None:
        self.runtime.load(self.project, PROGRAM, **how)
        self.runtime.start()
        wait_for(self.ros.matched, "the bridge is seen")
        self.ros.until_back()

    def restart_ten_times(self) -> None:
        """Have messages cross on both ways between stops of the program."""
        self.begin()
        for _ in range(10):
            self.ros.whole(50)
            self.runtime.restart()
            self.ros.until_back()
        self.ros.whole(50)
        print(self.ros.nothing_else())

    def kill_three_times(self, who: str) -> None:
        """Have messages cross on both ways between kills of a side."""
        self.begin()
        for _ in range(3):
            self.ros.whole(20)
            self.ros.send("")
            if who == "runtime":
                self.runtime.kill()
                self.runtime.start()
            else:
                self.bridge.kill()
                self.bridge = Bridge(self.path, os.environ)
                wait_for(self.ros.matched, "the bridge is seen")
            self.ros.until_back()
        self.ros.whole(20)
        print(self.ros.nothing_else())

    def answer_calls(self) -> None:
        """Have a ROS client call the PLC, and the PLC a ROS server, between stops of the program."""
        store, node = self.project.store, self.ros.node
        ask, answer = (
            Codec(compute_layout(store, f"std_srvs/srv/SetBool_{part}"), Wire.CDR)
            for part in ("Request", "Response")
        )

        def packed(codec: Codec, **values: object) -> bytes:
            return codec.encode(bytes(codec.layout.pack(values)))

        asked: list[bool] = []

        def serve(request: bytes, caller: bytes, _: int) -> None:
            data = ask.layout.view(bytearray(ask.decode(request))).data
            asked.append(data)
            server.reply(caller, packed(answer, success=not data, message="served by ROS"))

        server = node.serve("/close", "std_srvs/srv/SetBool", SERVICES, serve)
        client = node.client("/start", "std_srvs/srv/SetBool", SERVICES)
        self.runtime.load(self.project, CALLS)
        self.runtime.start()
        wait_for(lambda: client.ready, "/start is seen")
        calls = 0
        for _ in range(3):
            for _ in range(100):
                calls += 1
                replies: list[Reply] = []
                client.call(packed(ask, data=calls % 3 == 0), replies.append)
                wait_for(lambda replies=replies: replies, f"the end of call {calls}")
                assert replies[0].payload is not None, (calls, replies[0])
                got = answer.layout.view(bytearray(answer.decode(replies[0].payload)))
                assert (got.success, got.message) == (calls % 3 == 0, "served by the PLC")
            begun = len(asked)
            self.runtime.restart()
            wait_for(lambda begun=begun: len(asked) > begun + 20, "calls of the PLC")
        # The PLC asks for the contrary of what it was told; what was under way at a STOP may be asked again.
        assert sum(one == after for one, after in pairwise(asked)) <= 3
        print(f"{calls} calls answered by the PLC, {len(asked)} by ROS")

    def close(self) -> None:
        self.runtime.kill()
        self.bridge.kill()
        self.ros.close()


@pytest.fixture
def cell(tmp_path: Path, shm_namespace: Namespace) -> Iterator[Cell]:
    """Give a cell of three programs; the runtime's is still to be loaded."""
    domain = FreeDomain()
    made = Cell(tmp_path, shm_namespace.prefix, domain.number)
    yield made
    made.close()
    domain.close()


def test_messages_cross_ten_starts(cell: Cell) -> None:
    """Every kind of field crosses in both directions in two tasks; ten times the program stops and starts."""
    cell.restart_ten_times()


def test_a_fault_in_mid_copy(cell: Cell) -> None:
    """A task that a fault ends half-way through a message shows nobody half a message, and starts again."""
    cell.begin(fault=cell.fault)
    for _ in range(3):
        cell.ros.whole(20)
        cell.fault.touch()
        wait_for(lambda: cell.ros.send("") and "ERROR" in Runtime.ask("STATUS"), "the fault")
        assert not cell.fault.exists()
        cell.runtime.become("START", "RUNNING")
        cell.ros.until_back()
    cell.ros.whole(20)
    print(cell.ros.nothing_else())


@pytest.mark.parametrize("who", ["runtime", "bridge"])
def test_either_side_is_killed(who: str, cell: Cell) -> None:
    """After SIGKILL and a new start messages cross as before; none comes wrong, twice or out of order."""
    cell.kill_three_times(who)


def test_the_tutorials_program(tmp_path: Path, shm_namespace: Namespace) -> None:
    """As docs/tutorial/openplc.md says, the wheels turn with the command, and stop when none comes."""
    shown = {block.directives.get("file"): block.text for block in blocks(TUTORIAL)}
    with ExitStack() as stack:
        domain = FreeDomain()
        stack.callback(domain.close)
        text = shown["rosplc.yaml"].replace("{distro: jazzy}", f"{{backend: dds, domain: {domain.number}}}")
        (tmp_path / "rosplc.yaml").write_text(f"prefix: {shm_namespace.prefix}\n{text}")
        project = load_project(tmp_path / "rosplc.yaml")
        codecs = {plan.topic: Codec(plan.layout, Wire.CDR) for plan in project.topics}
        stack.callback(Bridge(tmp_path / "rosplc.yaml", os.environ).kill)
        node = open_backend("dds", project.store, "peer", domain=domain.number)
        stack.callback(node.close)
        heard: list[float] = []

        def take(payload: bytes, *_: object) -> None:
            codec = codecs["/wheel_speed"]
            heard.append(codec.layout.view(codec.decode(payload)).data)

        node.subscribe("/wheel_speed", "std_msgs/msg/Float64", QOS, take)
        robot = node.advertise("/cmd_vel", "geometry_msgs/msg/Twist", QOS)
        (tmp_path / "runtime").mkdir()
        plc = Plc(tmp_path / "runtime")
        stack.callback(plc.kill)
        plc.load(project, shown["cell.st"])
        plc.start()
        codec = codecs["/cmd_vel"]
        wire = codec.encode(bytes(codec.layout.pack({"linear": {"x": 0.5}})))
        wait_for(lambda: heard and heard[-1] == 0.0, "wheels at rest")
        wait_for(lambda: robot.write(wire) and heard[-1] == 5.0, "wheels that turn")
        wait_for(lambda: heard[-1] == 0.0, "wheels at rest again")


def test_calls_are_answered(cell: Cell) -> None:
    """The PLC answers each call of a ROS client, and a ROS server each of the PLC, before and after STOPs."""
    cell.answer_calls()
