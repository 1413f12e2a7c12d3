"""Write what-is-verified.md's tables from the markers on tests; ``--verify`` only compares.

A test, or with ``pytestmark`` its module, is evidence for a statement of the table below::

    @pytest.mark.verifies("ros2-topics", real="rclpy on Fast DDS")
    @pytest.mark.verifies("parameters", own="translated Structured Text")

``real`` names other projects' software that takes part, ``own`` what this project wrote for the check.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from pathlib import Path

from generated_page import ROOT, filled, run

PAGE = ROOT / "docs" / "explanation" / "what-is-verified.md"
LEVELS = {"real": "● real", "own": "◐ own"}
"""A marker's argument → how the page shows it, the stronger first."""

TABLE = """\
ROS:
    ros2-topics | ROS 2 nodes exchange messages with a bridge over DDS
    ros2-types | rclpy and the backends exchange messages of every bundled type that is available as a wheel
    ros2-verbs | `rosplc pub`, `echo` and `hz` send and print the same messages as rclpy
    rclpy-calls | services and actions work in both directions over `rclpy`, even if processes are killed
    cyclone-calls | services and actions work over `dds` with nodes on Cyclone DDS
    fastdds-calls | over `dds`, service clients and servers on Fast DDS are refused
    learn | rosplc obtains missing message definitions from running ROS 2 nodes
    rosout | log messages of the bridge and the PLC are published on `/rosout`
    parameters | parameter values that are set from ROS reach the PLC's shared memory, or are refused
    ros-time | ROS time and simulated time reach the PLC's shared memory
    tf | the poses that rosplc computes from transforms equal those of tf2
    lifecycle | the bridge's lifecycle node follows the lifecycle state machine of ROS 2
    humble-jazzy | the `rclpy` backend is compatible with Humble and Jazzy
    colcon | `colcon build` builds the ROS 2 package
    zenoh | topics and services work over Zenoh, even if the router dies and restarts
    zenoh-actions | actions work over Zenoh
    ros1 | topics, services and actionlib work with ROS 1, even if the master dies and restarts
    ros1-definitions | message definitions from the network are used only if they are valid
    backends | all backends deliver and order messages, reconnect, and report problems in the same way
    init | `rosplc init` writes a valid configuration for any ROS graph or recording
    distribution | a ROS 2 installation, the `ros2` command, the launch file \
| rclpy on Fast DDS (Kilted, from wheels); test doubles for Humble and Jazzy
    rmw | nodes on rmw_cyclonedds or rmw_zenoh | independent implementations of the conventions of these two
Shared memory and conversion:
    spec | the specification is sufficient to implement the format
    vectors | layouts and objects match the specification
    c-layout | record layouts equal those of C compilers
    conversion | messages of every bundled type are converted without loss
    torn | a reader never accepts a torn message
    core | the C core follows the rules of the specification, at full speed and on emulated ARM
    calls-once | a call is executed at most once, and its outcome is reported correctly
    kills | if a process is killed at any time, the others continue and the new process takes over
    campaign | under faults, no message is torn, invented or lost without being counted, and nothing is leaked
    objects | objects are owned, adopted, replaced and retired according to the specification
    hostile | hostile bytes, files, objects and names are rejected with an error
    limits | the limits of all external input are enforced
    users | other users of the machine can neither read the messages of a running bridge nor block it
The PLC:
    st-messages | generated Structured Text exchanges messages with a bridge without loss
    compilers | other compilers parse the generated code; \
matiec compiles the blocks for OpenPLC v3 and Beremiz
    call-blocks | the blocks for services and actions follow their state tables
    blocks-conform | the blocks in C and for OpenPLC behave like those for CODESYS
    openplc | a bridge and OpenPLC Runtime 4.1.4 exchange messages and calls, even if processes are killed
    beremiz | a bridge and the Beremiz runtime exchange messages and calls, even if processes are killed
    ros-blocks | the blocks for logging, time, parameters and transforms exchange their data with a bridge
    fail-safe | the safe value or substitute replaces the messages of a stale topic
    classic | classic topics work with existing projects
    names | generated names and literals are valid, and DUTs have the layout of their records
    import-script | the import script creates, updates and removes only its own objects
    import-script-syntax | the import script is valid Python 2.7, as IronPython in CODESYS requires
    plcopen | the PLCopenXML file has the same structure as files that CODESYS exports
    example-cell | in the example cell, no step is executed twice or lost
    codesys | CODESYS: compiler, development system, runtime \
| generated code is translated to C and executed; [what only CODESYS can tell](#what-only-codesys-can-tell)
    openplc-v3 | the runtime of OpenPLC v3 | its compiler accepts the blocks
Tools and operation:
    configuration | a configuration error is reported with its line; \
a reload is applied completely or not at all
    views | the status views show the actual state and do not change it
    web | the web page works, but only for permitted users
    recordings | recordings contain every message or count it as lost, and other tools can read them
    recorder-killed | a killed recorder leaves a readable file
    doctor | `rosplc doctor` finds each problem, and reports it only where it exists
    comparison | the values that each contender in the comparison transfers are checked
    service | the systemd service has only the permissions that it needs
    real-time-settings | real-time settings are applied to the intended threads
    deb | the Debian package can be installed, upgraded and removed
    upgrade | a new release can replace an old one under load
    containers | containers share memory; the image and the compose file work
    arm-board | the bridge runs on 32-bit ARM, and needs less than 512 MB of memory
    pip | `pip install` installs a working `rosplc` command
    documentation | commands, configurations and programs in the documentation work
    generated | generated pages and drawings are up to date
    machines | a robot, or a second machine | all peers run on one machine
    arm | ARM hardware | cross-compilation, an emulator, and an exhaustive model of the memory-ordering rules
    managers | systemd as a service manager, podman, rootless engines \
| systemd's offline analysis; Docker from Debian 12
    times | real-time behaviour and timing | the tests check that something happens, never how fast
    viewers | Foxglove, PlotJuggler, `ros2 bag`, screen readers, browsers besides Chromium \
| the mcap and rosbags libraries; the accessibility rules of axe
"""
"""Title, then lines: key | statement. One that no test is marked for is not verified: | how far tests go."""

Evidence = Mapping[str, list[tuple[str, str, str]]]
"""A statement's key → the markers for it: argument, its text, and the test's file."""


def markers(folder: Path) -> Evidence:
    """Return what the tests below a folder are marked for, in the order of their files.

    Raises:
        ValueError: If a marker has no text.
    """
    found: dict[str, list[tuple[str, str, str]]] = {}
    for path in sorted(folder.rglob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and ast.unparse(node.func) == "pytest.mark.verifies"):
                continue
            key = ast.literal_eval(node.args[0])
            texts = {str(each.arg): ast.literal_eval(each.value) for each in node.keywords}
            if not texts or not texts.keys() <= LEVELS.keys() or not all(texts.values()):
                raise ValueError(f"{path}:{node.lineno}: real= or own= names the evidence")
            place = path.relative_to(folder).as_posix()
            found.setdefault(key, []).extend((level, text, place) for level, text in texts.items())
    return found


def parts(table: str, found: Evidence) -> dict[str, str]:
    """Return the page's generated parts: what is not verified, and the statements that are.

    Raises:
        ValueError: If a marker's statement is not in the table, or one without a marker has no note, or the
            other way round.
    """
    missing = ["| what | what the tests cover instead |", "| --- | --- |"]
    verified = []
    keys = set()
    for line in table.splitlines():
        if not line.startswith(" "):
            verified += ["", f"## {line.rstrip(':')}", ""]
            verified += ["| | statement | evidence | tests |", "| --- | --- | --- | --- |"]
            continue
        key, statement, *note = (part.strip() for part in line.split("|"))
        keys.add(key)
        if bool(note) == (key in found):
            raise ValueError(f"{key}: a statement has either a test that verifies it or a note")
        if note:
            missing.append(f"| {statement} | {note[0]} |")
        else:
            verified.append(_row(statement, found[key]))
    if unknown := found.keys() - keys:
        raise ValueError(f"no such statements: {', '.join(sorted(unknown))}")
    return {"not verified": "\n".join(missing), "verified": "\n".join(verified)}


def _row(statement: str, marked: list[tuple[str, str, str]]) -> str:
    """Return a statement's line: the strongest level, what was used for each, and the tests' files."""
    texts = {level: dict.fromkeys(text for each, text, _ in marked if each == level) for level in LEVELS}
    used = [level for level in LEVELS if texts[level]]
    evidence = "; own: ".join(", ".join(texts[level]) for level in used)
    places = ", ".join(dict.fromkeys(f"`{place}`" for *_, place in marked))
    return f"| {LEVELS[used[0]]} | {statement} | {evidence} | {places} |"


if __name__ == "__main__":
    raise SystemExit(run(__doc__, {PAGE: filled(PAGE, parts(TABLE, markers(ROOT / "tests")))}))
