"""Goals as a user records them: ``rosplc record`` beside ``rosplc run``, and ``rosplc replay`` afterwards."""

from __future__ import annotations

import json
import os
import secrets
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from rosplc.codec import Codec, Wire
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.ros import ActionClient, ActionServer, Backend, GoalEvent, open_backend
from rosplc.shm import Namespace
from rosplc.virtual_plc import ActionClient as PlcClient
from rosplc.virtual_plc import ActionServer as PlcServer
from rosplc.virtual_plc import Task
from tests.lib.waiting import wait_for

TYPE = "example_interfaces/action/Fibonacci"
STORE = TypeStore.bundled("jazzy")
GOAL, RESULT, FEEDBACK = (
    Codec(compute_layout(STORE, f"{TYPE}_{part}", Limits(sequence=16)), Wire.CDR)
    for part in ("Goal", "Result", "Feedback")
)
COUNT, MOVE = "/cell/count", "/arm/move"  # carried out by the PLC, and by ROS


def wire(codec: Codec, **fields: object) -> bytes:
    return codec.encode(codec.layout.pack(fields))


class Plc:
    """Carries out what it is sent, with one feedback, and sends one goal when it is told to."""

    def __init__(self, prefix: str) -> None:
        self.server, self.client = PlcServer(COUNT, prefix=prefix), PlcClient(MOVE, prefix=prefix)
        self.got: list[int] = []
        self.go = False
        self.fed = False
        self.task = Task("RosTask", 0.002, programs=[self.scan])

    def scan(self) -> None:
        server, client = self.server, self.client
        server()
        if server.xGoal and not server.xAccept:
            self.got.append(server.goal.order)
            self.fed = False
        server.xAccept = server.xGoal
        server.xSucceed = server.xActive and self.fed
        server.xSendFeedback = server.xActive and not self.fed
        if server.xActive:
            self.fed = True
            server.feedback.update({"sequence": [0, 1]})
            server.result.update({"sequence": [0, 1, 1]})
        if client.goal is not None:
            client.goal.order = 9
        client.xExecute = self.go
        client()

    def close(self) -> None:
        self.task.stop()
        self.server.close()
        self.client.close()


class Robot:
    """A node of ROS that carries out goals at once, with one feedback, and sends some."""

    def __init__(self, node: Backend) -> None:
        self.got: list[int] = []
        self.events: list[GoalEvent] = []
        self.server = ActionServer(node, STORE, MOVE, TYPE, on_goal=self._on_goal, on_cancel=lambda _: None)
        self.client = ActionClient(node, STORE, COUNT, TYPE, self.events.append)

    def _on_goal(self, uuid: bytes, payload: bytes) -> None:
        self.got.append(GOAL.layout.to_dict(GOAL.decode(payload))["order"])
        self.server.accept(uuid)
        self.server.execute(uuid)
        self.server.feedback(uuid, wire(FEEDBACK, sequence=[5]))
        self.server.succeed(uuid, wire(RESULT, sequence=[5, 5]))


@contextmanager
def rosplc(*arguments: str, **how: Any) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen([sys.executable, "-m", "rosplc", *arguments], text=True, **how)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def replayed(bag: Path, *arguments: str, domain: int) -> dict[str, Any]:
    """Replay a recording; return what became of its one topic's messages."""
    command = [sys.executable, "-m", "rosplc", "replay", str(bag), "--json", "--speed", "max", *arguments]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    done = subprocess.run(
        [*command, "--wait", "90s"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    [count] = json.loads(done.stdout)["topics"].values()
    found: dict[str, Any] = count
    return found


def told(bag: Path) -> dict[str, list[Any]]:
    """Return what a recording tells of each action, as rosbags reads it: no numbers and times."""
    found: dict[str, list[Any]] = {COUNT: [], MOVE: []}
    with AnyReader([bag]) as reader:  # which compares the hashes with the definitions
        for connection, _, data in reader.messages():
            name, _, kind = connection.topic.partition("/_action/")
            message: Any = reader.deserialize(data, connection.msgtype)
            if kind == "status":
                what: tuple[Any, ...] = (*(one.status for one in message.status_list),)
            elif kind == "feedback":
                what = tuple(message.feedback.sequence)
            else:
                [content] = [*message.request, *message.response]
                what = (message.info.event_type,)
                if hasattr(content, "goal"):
                    what += (content.goal.order,)
                elif hasattr(content, "result"):
                    what += tuple(content.result.sequence)
            found[name].append((kind.split("/")[0], *what))
    return found


def test_goals_both_ways_are_recorded_and_sent_again(
    tmp_path: Path, shm_namespace: Namespace, dds_domain: int
) -> None:
    """A recording beside a running bridge has each step of both goals, and a replay sends each once."""
    config, bag = tmp_path / "rosplc.yaml", tmp_path / "shift"
    config.write_text(
        f"prefix: {shm_namespace.prefix}\nros: {{backend: dds, domain: {dds_domain}}}\n"
        "actions:\n"
        f"  {COUNT}: {{type: {TYPE}, server: plc, accept_within: 60s}}\n"
        f"  {MOVE}: {{type: {TYPE}, server: ros, when_plc_down: keep}}\n"
    )
    with ExitStack() as stack:
        node = open_backend("dds", STORE, "robot", domain=dds_domain)
        stack.callback(node.close)
        robot, plc = Robot(node), Plc(shm_namespace.prefix)
        stack.callback(plc.close)
        bridge = stack.enter_context(rosplc("run", str(config)))
        plc.task.start()
        wait_for(lambda: robot.client.ready and plc.client.xServer and plc.server.xPeerAlive, "the bridge")
        recorder = stack.enter_context(
            rosplc(
                *("record", "--config", str(config), "--bag", "--output", str(bag), "--json"),
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
            )
        )
        assert recorder.stderr is not None
        assert "recording 10 topics" in recorder.stderr.readline()
        robot.client.send(secrets.token_bytes(16), wire(GOAL, order=4))
        wait_for(lambda: [one for one in robot.events if one.kind == "result"], "the PLC's result")
        plc.go = True
        wait_for(lambda: plc.client.xDone, "the robot's result")
        recorder.send_signal(signal.SIGINT)
        result = json.loads(recorder.communicate(timeout=100)[0])
        bridge.send_signal(signal.SIGTERM)
        assert bridge.wait(100) == 0
        assert (plc.got, robot.got, result["lost"]) == ([4], [9], 0)
        with Reader(bag) as reader:
            counts = Counter({one.topic: one.msgcount for one in reader.connections})
            assert reader.message_count == counts.total() == result["received"]
            assert all(one.ext.offered_qos_profiles for one in reader.connections)  # type: ignore[union-attr]
        found = told(bag)
        assert found[COUNT] == [
            ("send_goal", 1, 4), ("send_goal", 2), ("get_result", 1), ("status", 2),
            ("feedback", 0, 1), ("status", 4), ("get_result", 2, 0, 1, 1),
        ]  # fmt: skip
        assert found[MOVE][0] == ("send_goal", 0, 9)
        assert found[MOVE][-2:] == [("status", 4), ("get_result", 3, 5, 5)]
        once = replayed(bag, "--to", "plc", "--config", str(config), "--action", COUNT, domain=dds_domain)
        assert (once["sent"], plc.got, robot.got) == (1, [4, 4], [9])
        again = replayed(bag, "--to", "ros", "--backend", "dds", "--action", MOVE, domain=dds_domain)
        assert (again["sent"], plc.got, robot.got) == (1, [4, 4], [9, 9])
