"""The main job on real input: a recording crosses into the PLC, and its answers come back.

Four programs take part: a player, the bridge, the PLC, and a listener that has nothing to do
with rosplc's own processes. A recording of our own making is always used; set
ROSPLC_RECORDING to the path of a ``.bag`` file with turtlesim topics to try a real one.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rosplc.model import TypeStore
from rosplc.recorder.convert import Conversion, renamed
from rosplc.recorder.source import Source, open_source
from tests.e2e.turtle_recording import write_recording

ROOT = Path(__file__).parents[2]
HERE = Path(__file__).parent
POSE = "/turtle1/pose"
COMMAND = "/turtle1/plc_cmd_vel"
JAZZY = TypeStore.bundled("jazzy")


def recordings() -> list[str]:
    """Return what to play: a made one, and the user's own if there is one."""
    real = os.environ.get("ROSPLC_RECORDING", "")
    return ["made", real] if real else ["made"]


@contextmanager
def program(*command: str, environment: dict[str, str], log: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a program with its output in a file; it is dead when the block ends."""
    with log.open("w") as errors:
        process = subprocess.Popen(
            command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(10)
                except subprocess.TimeoutExpired:
                    process.kill()
            process.communicate()


def write_config(path: Path, recording: Source, prefix: str) -> None:
    """Configure every topic of the recording towards the PLC, and one command topic back."""
    folders = path.parent / "msg"
    lines = [
        f"bridge: {prefix}", f"prefix: {prefix}", "ros: {backend: dds, distro: jazzy}",
        "limits: {string: 200, sequence: 16}",
        "rosout: {bridge: false}", "tasks: {RosTask: {interval: 5ms}}", "topics:",
    ]  # fmt: skip
    for topic in recording.topics.values():
        type_name = renamed(topic.type_name, JAZZY)
        if type_name not in JAZZY:
            assert topic.definition is not None
            package, _, name = type_name.partition("/msg/")
            file = folders / package / "msg" / f"{name}.msg"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(topic.definition.partition("=" * 80)[0])
        lines.append(
            f"  {topic.name}: {{type: {type_name}, to: plc, every: true, slots: 4096, "
            "qos: {durability: transient_local, depth: 1000}}"
        )
    lines.append(f"  {COMMAND}: {{type: geometry_msgs/msg/Twist, to: ros, slots: 4096}}")
    if folders.exists():  # not every recording has types that are not bundled
        lines.insert(0, f"types: {{paths: [{folders}]}}")
    path.write_text("\n".join(lines) + "\n")


def values(recording: Source) -> dict[str, list[Any]]:
    """Return topic → its messages as ROS 2's types, decoded by the rosbags library."""
    library = get_typestore(Stores.ROS2_JAZZY)
    conversions = {}
    for name, topic in recording.topics.items():
        own = topic.types()
        store, wanted = JAZZY.with_types_of(own, topic.type_name), renamed(topic.type_name, JAZZY)
        conversions[name] = Conversion(own, topic.type_name, store, wanted, from_ros1=topic.ros1), wanted
        if wanted not in library.fielddefs:
            library.register(get_types_from_msg(store.definition_text(wanted), wanted))
    found: dict[str, list[Any]] = defaultdict(list)
    for message in recording.messages(recording.topics.keys(), 0, 2**63 - 1):
        convert, wanted = conversions[message.topic]
        found[message.topic].append(library.deserialize_cdr(convert(message.data), wanted))
    return found


def equal(left: Any, right: Any) -> bool:
    """Compare a rosbags message with plain data, exactly (NaN equals NaN)."""
    if isinstance(right, dict):
        return all(equal(getattr(left, name), value) for name, value in right.items())
    if isinstance(right, (list, tuple)) or isinstance(left, np.ndarray):
        return len(left) == len(right) and all(equal(a, b) for a, b in zip(left, right, strict=True))
    return bool(left == right) or (left != left and right != right)


@pytest.mark.timeout(240)
@pytest.mark.parametrize("source", recordings())
def test_every_recorded_message_arrives_equal_and_every_answer_comes_back(
    source: str, tmp_path: Path, dds_domain: int, shm_prefix: str
) -> None:
    """Every message of a recording reaches the scan cycle value by value, and each command a listener."""
    bag = Path(source)
    if source == "made":
        bag = tmp_path / "turtle.bag"
        write_recording(bag)
    out = tmp_path / "plc.pickle"
    config = tmp_path / "rosplc.yaml"
    recording = open_source(bag)
    write_config(config, recording, shm_prefix)
    topics = list(recording.topics)
    expected = values(recording)
    recording.close()
    environment = {**os.environ, "ROS_DOMAIN_ID": str(dds_domain), "PYTHONUNBUFFERED": "1"}
    environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    python = sys.executable
    with ExitStack() as stack:
        stack.enter_context(
            program(
                python,
                "-m",
                "rosplc",
                "run",
                str(config),
                environment=environment,
                log=tmp_path / "bridge.log",
            )
        )
        plc = stack.enter_context(
            program(
                python,
                str(HERE / "plc_program.py"),
                shm_prefix,
                str(out),
                json.dumps(topics),
                COMMAND,
                POSE,
                environment=environment,
                log=tmp_path / "plc.log",
            )
        )
        listener = stack.enter_context(
            program(
                python,
                str(HERE / "listener.py"),
                COMMAND,
                environment=environment,
                log=tmp_path / "listener.log",
            )
        )
        assert plc.stdout is not None and listener.stdout is not None
        assert plc.stdout.readline() == "attached\n", (tmp_path / "plc.log").read_text()
        assert listener.stdout.readline() == "matched\n", (tmp_path / "listener.log").read_text()
        player = subprocess.run(
            [python, str(ROOT / "examples" / "play_recording.py"), str(bag), "--speed", "2"],
            env=environment, capture_output=True, text=True, check=False, timeout=200,
        )  # fmt: skip
        assert player.returncode == 0, player.stderr
        plc.communicate("stop\n", timeout=100)
        heard = json.loads(listener.communicate("stop\n", timeout=100)[0])
    result = pickle.loads(out.read_bytes())
    assert result["lost"] == dict.fromkeys(topics, 0)
    for topic in topics:
        got = result["seen"][topic]
        assert len(got) == len(expected[topic]), topic
        for index, (before, after) in enumerate(zip(expected[topic], got, strict=True)):
            assert equal(before, after), f"{topic} message {index}: {before} became {after}"
    assert len(result["sent"]) > 0
    assert [tuple(pair) for pair in heard] == result["sent"]
    if source == "made":
        assert "Header has no such field" in player.stdout
        assert "tf/msg/tfMessage is converted to tf2_msgs/msg/TFMessage" in player.stdout
        assert "rosgraph_msgs/msg/Log is converted to rcl_interfaces/msg/Log" in player.stdout
