"""``rosplc generate``: from a configuration file to a folder, and what wrong input says."""

from __future__ import annotations

import json

import pytest
import yaml

from rosplc.config.resolve import load_project, object_plans
from rosplc.model import TypeStore
from rosplc.plc.delivery import MANIFEST
from rosplc.shm import Description, Direction, Namespace, OwnedChannel, attach
from tests.command import rosplc

TOPICS = {
    "/robot1/pose": {"type": "geometry_msgs/msg/PoseStamped", "to": "plc", "stale_after": "500ms"},
    "/joints": {"type": "sensor_msgs/msg/JointState", "to": "plc", "limits": {"name": 6}, "task": "Slow"},
    "/cmd_vel": {"type": "geometry_msgs/msg/Twist", "to": "ros"},
}
TASKS = {"Fast": {"interval": "2ms", "priority": 1}, "Slow": {"interval": "500ms"}}


def generate(*arguments, code=0):
    return rosplc("generate", *arguments, code=code).output


@pytest.fixture
def config(tmp_path):
    def write(topics=None, tasks=None, name="rosplc.yaml", **more):
        path = tmp_path / name
        content = {"tasks": tasks or TASKS, "topics": topics or TOPICS, **more}
        path.write_text(yaml.safe_dump(content, sort_keys=False))
        return path

    return write


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_configuration_becomes_a_folder(config, tmp_path):
    """All deliveries, with what the configuration says in them."""
    output = generate(config(), "--out", tmp_path / "plc")
    found = files(tmp_path / "plc")
    assert {
        "rosplc.xml",
        "rosplc_import.py",
        "rosplc.h",
        MANIFEST,
        "st/ROS_Read.st",
        "st/ROS_Write.st",
    } <= set(found)
    call = found["st/SharedMemory_Read_Fast.st"].decode()
    assert "ROS_Read.robot1_pose(uiTask := 0, udiMapSize := " in call
    assert "tStaleAfter := T#500ms" in call
    assert "ARRAY[0..5] OF STRING(80)" in found["st/Types/sensor_msgs_JointState.st"].decode()
    assert "files written, 0 unchanged, 0 removed" in output
    assert "Execute Script File" in output
    settings = found["st/Base/RosPlc_Settings.st"].decode()
    assert "audiBeatMs : ARRAY[0..15] OF UDINT := [250, 5000, 14(1000)];" in settings


def test_the_map_size_is_the_size_of_the_bridges_object(config, tmp_path, shm_namespace):
    """The PLC asks for exactly the bytes that the bridge's object has."""
    path = config({"/joints": TOPICS["/joints"]})
    plan = load_project(path).topics[0]
    description = Description(
        topic="/joints", type=plan.type_name, distro="jazzy", direction=Direction.TO_PLC,
        limits=plan.layout.limits.to_dict(), layout_id=plan.layout.layout_id, bridge="rosplc",
        definition=plan.layout.store.definition_text(plan.type_name),
    )  # fmt: skip
    (made,) = object_plans(load_project(path), plan).values()
    size = made.object_size
    with OwnedChannel.open(shm_namespace, description, record_size=plan.layout.size, slots=plan.slots):
        channel = attach(shm_namespace, "/joints")
        assert abs(channel.identity.object_size - size) <= 64  # the bridge's own name is in the text
        channel.close()
    generate(path, "--out", tmp_path / "plc")
    assert f"udiMapSize := {size}" in (tmp_path / "plc/st/SharedMemory_Read.st").read_text()
    assert isinstance(shm_namespace, Namespace)


def test_a_second_run_says_that_nothing_changed(config, tmp_path):
    """JSON for programs: the same facts as the text."""
    first = json.loads(generate(config(), "--out", tmp_path / "plc", "--json"))
    second = json.loads(generate(config(), "--out", tmp_path / "plc", "--json"))
    assert sorted(first["written"]) == sorted(second["unchanged"])
    assert (second["written"], second["removed"]) == ([], [])
    assert first["folder"] == str(tmp_path / "plc")
    assert isinstance(first["notes"], list)


def test_an_edited_file_is_named_and_force_overwrites_it(config, tmp_path):
    """Exit status 1 with PLC001, and the work is still there."""
    generate(config(), "--out", tmp_path / "plc")
    edited = tmp_path / "plc/st/ROS_Read.st"
    edited.write_text("// mine\n")
    output = generate(config(), "--out", tmp_path / "plc", code=1)
    assert "PLC001" in output
    assert "st/ROS_Read.st" in output
    assert edited.read_text() == "// mine\n"
    generate(config(), "--out", tmp_path / "plc", "--force")
    assert "VAR_GLOBAL" in edited.read_text()


def test_targets_and_fences(config, tmp_path, monkeypatch):
    """ARM is generated for the delayed rule unless the user vouches for the fence; the default is here."""
    for name, machine, options, arm, fenced in (
        ("pc", "x86_64", (), "FALSE", "TRUE"),
        ("board", "aarch64", (), "TRUE", "FALSE"),
        ("other board", "armv7l", ("--target", "x86"), "FALSE", "TRUE"),
        ("arm", "x86_64", ("--target", "arm"), "TRUE", "FALSE"),
        ("fenced", "x86_64", ("--target", "arm", "--fences"), "TRUE", "TRUE"),
    ):
        monkeypatch.setattr("platform.machine", lambda found=machine: found)
        generate(config(), "--out", tmp_path / name, *options)
        text = (tmp_path / name / "st/Base/RosPlc_Settings.st").read_text()
        assert f"xArm : BOOL := {arm};" in text
        assert f"xFenced : BOOL := {fenced};" in text
    assert "sparc" in generate(config(), "--target", "sparc", code=2)


def test_pins_are_an_option(config, tmp_path):
    """Ladder users get a pin per field."""
    generate(config(), "--out", tmp_path / "plc", "--pins")
    assert (
        "pin_pose : geometry_msgs_Pose;"
        in (tmp_path / "plc/st/Blocks/geometry_msgs_PoseStamped_Read.st").read_text()
    )


def test_every_type_of_a_distribution(tmp_path):
    """Both blocks of each type, without topics and tasks."""
    facts = json.loads(generate("--all-types", "humble", "--out", tmp_path / "plc", "--json"))
    blocks = {path for path in facts["written"] if path.startswith("st/Blocks/")}
    assert len(blocks) == 2 * len(TypeStore.bundled("humble").names())
    assert not [path for path in facts["written"] if "SharedMemory_" in path]


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ((), 2, "no configuration file was given"),
        (("rosplc.yaml", "--all-types", "jazzy"), 2, "use a configuration file"),
        (("--all-types", "bouncy"), 1, "TYP006"),
        (("missing.yaml",), 2, "missing.yaml"),
    ],
)
def test_a_call_that_makes_no_sense_says_why(arguments, code, said, tmp_path, monkeypatch):
    """A word on what is wrong, and nothing written."""
    monkeypatch.chdir(tmp_path)
    assert said in generate(*arguments, code=code)
    assert not (tmp_path / "plc").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("uint8 state\nflaot32 force\n", "Broken.msg:2"),
        ("uint8 state\n\nuint8 state\n", "Broken.msg"),
        ("uint8 1st\n", "Broken.msg:1"),
        ("uint8[ x\n", "Broken.msg:1"),
        ("Broken inner\n", "TYP003"),
        ("wstring x\n", "TYP004"),
    ],
)
def test_a_mistake_in_a_definition_shows_file_and_line(config, tmp_path, text, said):
    """The technician sees where to look, and nothing is written."""
    folder = tmp_path / "msg" / "cell_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Broken.msg").write_text(text)
    topics = {"/broken": {"type": "cell_msgs/msg/Broken", "to": "plc"}}
    output = generate(config(topics, types={"paths": ["./msg"]}), "--out", tmp_path / "plc", code=2)
    assert said in output.replace("\n", "")
    assert not (tmp_path / "plc").exists()


def test_tasks_that_differ_by_case_only_are_refused(config, tmp_path):
    """CODESYS would make one task of them."""
    tasks = {"fast": {}, "Fast": {"interval": "1ms"}}
    topics = {f"/{n}": {"type": "std_msgs/msg/Bool", "to": "plc", "task": n} for n in tasks}
    output = generate(config(topics, tasks), "--out", tmp_path / "plc", code=1)
    assert "PLC005" in output
    assert "fast and Fast" in output
