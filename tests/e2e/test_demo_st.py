"""The demonstration with its PLC in Structured Text: generated, translated to C, run by a real bridge."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="no cyclonedds wheel for this machine")
pytest.importorskip("blark")
if shutil.which("gcc") is None:
    pytest.skip("Debian package gcc is missing", allow_module_level=True)

from rosplc.demo.outside import write_configuration
from rosplc.demo.plan import COMMAND, Plan, command, open_command, steer
from rosplc.demo.st.process import (
    MAIN,
    find_translator,
    read_texts,
    write_texts,
)
from rosplc.demo.supervisor import Demo
from rosplc.errors import GenerationError
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.plc.build import plc_project
from rosplc.plc.plan import ProjectOptions
from tests.e2e.test_demo import (
    alive,
    demo,
    everything_arrived,
    objects,
    one_piece_is_missing,
    prefix_of,
    processes,
)
from tests.lib.waiting import wait_for

# One worker translates first, the others' share would be the same texts again. With nothing in the
# cache that takes a minute or two.
pytestmark = [
    pytest.mark.xdist_group("structured-text"),
    pytest.mark.timeout(600),
    pytest.mark.verifies("st-messages", own="translated Structured Text"),
]

POSE, TWIST = "geometry_msgs/msg/PoseStamped", COMMAND[1]
STORE = TypeStore.bundled("jazzy")


def plc_processes(parent):
    """Return role → process id, once all three are there; the translation comes first."""
    pids = processes(parent)
    return pids and {role.removeprefix("st.process") or "plc": pid for role, pid in pids.items()}


def finish(child):
    return child.communicate(timeout=300)


@pytest.mark.foreign
def test_everything_arrives_in_both_directions():
    """What one side counts as sent the Structured Text took, whole and once, and the status is 0."""
    with demo("--plc", "st", "--duration", "3s", "--json") as child:
        pids = wait_for(lambda: plc_processes(child), "three processes", seconds=300)
        prefix = prefix_of(pids)
        out, err = finish(child)
    assert child.returncode == 0, out + err
    result = json.loads(out)
    assert result["plan"]["plc"] == "st"
    everything_arrived(result)
    assert 0 < result["program"]["mean_us"] <= result["program"]["max_us"]
    assert result["program"]["mean_us"] < result["cycle"]["cycle_mean_us"]
    assert objects(prefix) == []
    assert not any(alive(pid) for pid in pids.values())


@pytest.mark.foreign
def test_many_messages_in_one_scan_are_all_taken():
    """Several messages per scan and topic come out of the blocks in order, through Next()."""
    with demo("--plc", "st", "--duration", "3s", "--rate", "500", "--topics", "4", "--json") as child:
        out, err = finish(child)
    assert child.returncode == 0, out + err
    result = json.loads(out)
    assert result["complete"], result
    assert result["to_plc"]["received"] > 4 * result["cycle"]["scans"], "one per scan would have done"


@pytest.mark.foreign
def test_a_killed_plc_ends_it_with_a_clear_message():
    """The process that runs the Structured Text is named when it dies, and nothing is left behind."""
    with demo("--plc", "st", "--duration", "600s") as child:
        pids = wait_for(lambda: plc_processes(child), "three processes", seconds=300)
        prefix = prefix_of(pids)
        wait_for(lambda: objects(prefix), "objects in shared memory")
        folder = Path(Path(f"/proc/{pids['plc']}/cmdline").read_bytes().decode().split("\0")[4])
        assert (folder / "PLC_PRG.st").is_file()
        os.kill(pids["plc"], signal.SIGKILL)
        out, err = finish(child)
    assert child.returncode == 1, out + err
    assert "SYS002" in err and "the PLC process failed" in err and "SIGKILL" in err
    assert "Traceback" not in err
    assert not folder.exists()
    assert objects(prefix) == []
    assert not any(alive(pid) for pid in pids.values())


@pytest.mark.foreign
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_and_nothing_is_left(number, tmp_path):
    """Ctrl-C and SIGTERM end it while it still prepares the PLC, and the project's folder goes."""
    command = [sys.executable, "-m", "rosplc", "demo", "--plc", "st", "--duration", "600s"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as child:
        wait_for(lambda: list(tmp_path.glob("rosplc-demo-st-*/PLC_PRG.st")), "the project's folder")
        child.send_signal(number)
        _, err = finish(child)
    # CPython ends itself by SIGINT where Ctrl-C came inside an exec(), as dataclasses use it at import.
    # To a shell both are 130.
    assert child.returncode in (130, -signal.SIGINT), err
    assert "Traceback" not in err
    assert list(tmp_path.glob("rosplc-*")) == []


@pytest.mark.foreign
def test_a_killed_bridge_is_survived():
    """The Structured Text outlives its bridge: one piece is missing, nothing is torn, both ways go on."""
    with demo("--plc", "st", "--duration", "3s", "--kill", "--json") as child:
        out, err = finish(child)
    assert child.returncode == 0, out + err
    one_piece_is_missing(json.loads(out))


START = "import sys; sys.argv[0] = 'rosplc'; from rosplc.cli import main; main()"


def refused(*arguments, path=None, program=("-m", "rosplc"), folder=None):
    """Return status and stderr of a demonstration that cannot run."""
    environment = {**os.environ, **({} if path is None else {"PATH": path})}
    command = [sys.executable, *program, "demo", "--plc", *arguments]
    done = subprocess.run(
        command, env=environment, cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done.returncode, " ".join(done.stderr.split())


def test_without_gcc_it_says_what_to_install(tmp_path):
    """A machine without gcc gets SYS001 and the apt command."""
    status, words = refused("st", path=str(tmp_path))
    assert status == 1
    assert "gcc is missing" in words and "SYS001" in words and "apt-get install gcc" in words


@pytest.mark.foreign
def test_without_blark_it_says_what_to_install():
    """An environment without blark, which no dependency brings, gets SYS001 and the pip command."""
    hide = "import sys; sys.modules['blark'] = None; " + START
    status, words = refused("st", program=("-c", hide))
    assert status == 1
    assert "rosplc-st, which translates Structured Text, is missing" in words and "SYS001" in words
    assert "pip install -e " in words and "-m /" not in words


@pytest.mark.foreign
def test_without_a_checkout_it_says_so(tmp_path):
    """The installed package alone gets SYS001: the translator is no part of it."""
    package = Path(str(importlib.util.find_spec("rosplc").origin)).parent
    site = tmp_path / "lib" / "site"
    shutil.copytree(package, site / "rosplc", ignore=shutil.ignore_patterns("__pycache__"))
    program = f"import sys; sys.path.insert(0, {str(site)!r}); {START}"
    status, words = refused("st", program=("-c", program), folder=tmp_path)
    assert status == 1
    assert "not part of the installed package" in words and "checkout" in words and "SYS001" in words


def test_another_language_is_refused():
    """--plc takes python and st, and says so."""
    status, words = refused("c")
    assert status == 2
    assert "python" in words and "st" in words


def test_a_mistake_in_the_program_is_named_with_its_line():
    """Structured Text that does not parse, or narrows, is PLC004 with file and line."""
    translator = find_translator()
    head = "PROGRAM Broken\nVAR\n    uiA : UINT"
    for rest, line in (("\nEND_VAR\nEND_PROGRAM\n", 4), (";\nEND_VAR\nuiA := udiB;\nEND_PROGRAM\n", 5)):
        text = head + rest
        with pytest.raises(GenerationError) as caught:
            translator.build({"Broken": text})
        assert caught.value.code == "PLC004"
        assert caught.value.where == f"Broken.st:{line}"


def generate(folder, plan, options):
    """Write the PLC project of a run into a folder and build it."""
    project = plc_project(write_configuration(folder, plan), options)
    translator = find_translator()
    write_texts(folder, plan, project, translator.programs)
    return translator, translator.build(read_texts(folder))


@pytest.mark.verify(minutes=1)
@pytest.mark.parametrize("kill", [False, True])
def test_a_plc_without_fences_works_with_the_bridge(kill, tmp_path, dds_domain):
    """By the delayed rule all arrives, too; a killed bridge is survived, and nothing is torn."""
    plan = Plan(domain=dds_domain, rate=30.0, topics=3)
    _, built = generate(tmp_path, plan, ProjectOptions(fenced=False))
    try:
        with Demo(plan, plc="rosplc.demo.st.process", folder=tmp_path) as run:
            result = run.run(8.0, kill=kill)
    finally:
        built.path.unlink(missing_ok=True)
    assert result.good, result
    assert result.drained
    assert result.totals("plc", "ros")["torn"] == 0


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """Load the demonstration's PLC, which finds no bridge."""
    plan = Plan(prefix="demo-nobody", domain=1, rate=100.0, topics=1)
    translator, built = generate(tmp_path_factory.mktemp("project"), plan, ProjectOptions())
    loaded = translator.machine(built)
    loaded.start()
    return loaded


def test_the_program_steers_as_the_python_program_does(machine):
    """The same poses give the same commands, numbered and sealed, whether in Python or in ST."""
    pose, twist = compute_layout(STORE, POSE), compute_layout(STORE, TWIST)
    read, write = "ROS_Read.turtle_pose", "ROS_Write.turtle_cmd_vel"
    machine.write("ROS_Read.demo_drive.msg", b"\1")
    machine.set(f"{read}.xValid", True)
    machine.set(f"{write}.xReady", True)
    random_ = random.Random(5)
    corner, corners = 0, set()
    places = [(2.0, 0.05), (1.95, 2.0), (0.0, 1.98), (0.05, 0.0)]  # each corner in turn
    for number in range(1, 400):
        x, y = (
            places[number // 10 % 4] if number % 10 == 0 else (random_.uniform(-1, 3), random_.uniform(-1, 3))
        )
        heading = random_.uniform(-math.pi, math.pi)
        orientation = {"x": 0.0, "y": 0.0, "z": math.sin(heading / 2), "w": math.cos(heading / 2)}
        value = {"pose": {"position": {"x": x, "y": y, "z": 0.0}, "orientation": orientation}}
        machine.write(f"{read}.msg", bytes(pose.pack(value)))
        machine.scan(MAIN)
        forward, turn, corner = steer(x, y, heading, corner)
        corners.add(corner)
        sent = twist.view(machine.read(f"{write}.msg"))
        assert (sent.linear.x, sent.angular.z) == pytest.approx((forward, turn), abs=1e-9)
        opened = open_command(sent)
        assert (opened.whole, opened.number) == (True, number)
        assert sent.angular.x == command(number, sent.linear.x, sent.angular.z)["angular"]["x"]
    assert corners == {0, 1, 2, 3}


@pytest.mark.parametrize(("name", "value"), [("xValid", False), ("xStale", True)])
def test_without_a_fresh_pose_nothing_is_sent(machine, name, value):
    """A pose that is missing or stale stops the commands, and so does the operator."""
    read, enable = f"ROS_Read.turtle_pose.{name}", "ROS_Write.turtle_cmd_vel.xEnable"
    machine.set("ROS_Read.turtle_pose.xValid", True)
    machine.write("ROS_Read.demo_drive.msg", b"\1")
    machine.scan(MAIN)
    assert machine.get(enable)
    before = machine.get(read)
    machine.set(read, value)
    machine.scan(MAIN)
    assert not machine.get(enable)
    machine.set(read, before)
    machine.write("ROS_Read.demo_drive.msg", b"\0")
    machine.scan(MAIN)
    assert not machine.get(enable)
