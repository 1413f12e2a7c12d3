"""From topics to a project: programs per task, instances, notes, and the same bytes every time."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

import pytest

from rosplc._version import __version__
from rosplc.errors import GenerationError
from rosplc.layout import Limits
from rosplc.plc.build import build_project, build_type_library
from rosplc.plc.delivery import project_files
from rosplc.plc.plan import PlcTask
from rosplc.plc.project import Dut, Gvl, Pou
from tests.unit.plc.projects import JOINTS, POSE, STORE, TWIST, layout, named, project, read, write

FAST, SLOW = PlcTask("Fast", 1_000_000, 1), PlcTask("Slow", 100_000_000, 10, watchdog_ns=500_000)


def instances(made, name):
    (block,) = named(made.gvls, name).blocks
    return {v.name: (v.type, v.arguments) for v in block.variables}


def programs(made):
    return {pou.name: pou.implementation for pou in made.pous if pou.kind == "PROGRAM"}


def test_a_topic_becomes_an_instance_that_its_program_calls():
    """The thesis' arrangement: one block per topic in a variable list, called once a cycle."""
    made = project(read("/robot1/pose"), write("/cmd_vel"))
    assert instances(made, "ROS_Read") == {
        "robot1_pose": ("geometry_msgs_PoseStamped_Read", (("sTopic", "'/robot1/pose'"),))
    }
    assert instances(made, "ROS_Write") == {
        "cmd_vel": ("geometry_msgs_Twist_Write", (("sTopic", "'/cmd_vel'"),))
    }
    assert "ROS_Read.robot1_pose(uiTask := 0, udiMapSize := 0);" in programs(made)["SharedMemory_Read"]
    assert programs(made)["SharedMemory_Write"] == "ROS_Write.cmd_vel(uiTask := 0, udiMapSize := 0);"


def test_tasks_keep_urgent_and_slow_topics_apart():
    """Each task has a reading and a writing program with the topics of this task alone."""
    made = project(
        read("/fast", task="Fast"), read("/slow", task="Slow"), write("/out", task="Slow"), tasks=(SLOW, FAST)
    )
    assert {task.name: programs for task, programs in made.tasks} == {
        "Fast": ("SharedMemory_Read_Fast",),
        "Slow": ("SharedMemory_Read_Slow", "SharedMemory_Write_Slow"),
    }
    texts = programs(made)
    assert "/fast".strip("/") in texts["SharedMemory_Read_Fast"]
    assert "ROS_Read.slow" not in texts["SharedMemory_Read_Fast"]
    assert "axMayOpen[0]" in texts["SharedMemory_Read_Fast"]
    assert "axMayOpen[1]" in texts["SharedMemory_Read_Slow"]
    assert [task for task, _ in made.tasks] == [FAST, SLOW]


def test_a_task_that_only_writes_may_open_too():
    """The reset of the open attempts is in a reading program even if nothing is read."""
    made = project(write("/out"))
    assert list(programs(made)) == ["SharedMemory_Read", "SharedMemory_Write"]
    assert "axMayOpen[0] := TRUE;" in programs(made)["SharedMemory_Read"]


def test_a_task_without_topics_is_left_out():
    """No program and no task without work."""
    made = project(read("/a", task="Fast"), tasks=(FAST, SLOW))
    assert [task.name for task, _ in made.tasks] == ["Fast"]


def test_settings_of_a_topic_reach_its_call():
    """Stale time, its consequence, order and retention are arguments of the generated call."""
    made = project(
        read("/a", object_size=4096, stale_after_ns=1_500_000, on_stale="zero", in_order=True, latched=True)
    )
    call = "udiMapSize := 4096, tStaleAfter := T#2ms, uiOnStale := 1, xInOrder := TRUE, xLatched := TRUE"
    assert f"ROS_Read.a(uiTask := 0, {call});" in programs(made)["SharedMemory_Read"]


def test_sixteen_tasks_are_served_and_seventeen_refused():
    """The blocks keep one open attempt per task for 16 tasks."""
    tasks = [PlcTask(f"T{number}") for number in range(17)]
    topics = [read(f"/t{number}", task=f"T{number}") for number in range(17)]
    made = build_project(STORE, topics[:16], tasks[:16])
    assert len(made.tasks) == 16
    assert all(int(text.split("[")[1].split("]")[0]) < 16 for text in programs(made).values())
    with pytest.raises(GenerationError) as caught:
        build_project(STORE, topics, tasks)
    assert caught.value.code == "PLC003"
    assert "17" in str(caught.value)


@pytest.mark.parametrize("make", [read, write])
def test_a_topic_of_255_characters_is_served_and_a_longer_one_refused(make):
    """CODESYS would cut the name off, and the block would wait for an object that never comes."""
    longest = "/" + "a" * 254
    assert f"'{longest}'" in str(project(make(longest)).gvls)
    with pytest.raises(GenerationError) as caught:
        project(make(longest + "a"))
    assert caught.value.code == "PLC006"
    assert longest + "a" in str(caught.value)


def test_topics_that_share_an_instance_name_are_told_apart_by_suffixes():
    """Neither keeps the plain name, so that it never comes to stand for another topic."""
    made = project(read("/a/b"), read("/a_b", TWIST), read("/A/b"))
    names = instances(made, "ROS_Read")
    assert len(names) == 3
    assert all(name.upper().startswith("A_B_") for name in names)
    by_topic = {arguments[0][1]: name for name, (_, arguments) in names.items()}
    for topic, name in by_topic.items():
        assert any(topic.strip("'") in note and name in note for note in made.notes)
    alone = instances(project(read("/a/b"), read("/A/b")), "ROS_Read")
    assert by_topic["'/a/b'"] in alone


def test_a_topic_may_be_named_like_a_keyword():
    """The instance's name changes and the topic's stays."""
    made = project(read("/type"), read("/robot/__x"))
    assert instances(made, "ROS_Read")["_type"][1] == (("sTopic", "'/type'"),)


def test_types_of_a_package_named_like_the_base_do_not_take_its_names(tmp_path):
    """All objects of a project share one namespace in which case does not count."""
    folder = tmp_path / "types"
    for package, name in (("rosplc", "Channel"), ("rosplc", "Handshake"), ("ros", "Read")):
        path = folder / package / "msg" / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("uint8 x\n")
    store = STORE.with_paths([folder])
    layouts = [
        layout(f"{p}/msg/{n}", store=store)
        for p, n in (("rosplc", "Channel"), ("rosplc", "Handshake"), ("ros", "Read"))
    ]
    made = build_type_library(store, layouts)
    names = [item.name.upper() for item in (*made.duts, *made.gvls, *made.pous)]
    assert len(set(names)) == len(names)
    assert {"ROSPLC_CHANNEL_2", "ROSPLC_HANDSHAKE_2"} <= set(names)
    assert any("rosplc/msg/Channel" in note and "rosplc_Channel_2" in note for note in made.notes)


def test_a_large_message_is_noted_with_its_number_of_bytes():
    """The technician learns how much of the data area a topic takes."""
    image = Limits(fields={"data": 1_000_000})
    made = project(read("/camera", "sensor_msgs/msg/Image", limits=image), read("/small"))
    size = layout("sensor_msgs/msg/Image", image).size
    (note,) = (note for note in made.notes if note.startswith("/camera"))
    assert str(size) in note
    assert not [note for note in made.notes if note.startswith("/small")]


def test_a_message_without_fields_can_be_carried():
    """Empty is a trigger: both blocks exist, with the one byte of its record."""
    made = project(read("/go", "std_msgs/msg/Empty"), write("/done", "std_msgs/msg/Empty"))
    assert "udiRecordSize := 1)" in named(made.pous, "std_msgs_Empty_Read").implementation
    assert "udiRecordSize := 1)" in named(made.pous, "std_msgs_Empty_Write").implementation


def test_blocks_are_built_once_per_type_and_direction():
    """Ten topics of one type need one block, and only of the directions in use."""
    made = project(*(read(f"/p{number}") for number in range(10)))
    assert [pou.name for pou in made.pous].count("geometry_msgs_PoseStamped_Read") == 1
    assert "geometry_msgs_PoseStamped_Write" not in [pou.name for pou in made.pous]


def test_settings_fix_prefix_ordering_and_beat():
    """What holds for the whole project is in one constant list."""
    made = project(read("/a"), prefix="cell7", target="arm", fenced=False, beat_ms=3000)
    (block,) = named(made.gvls, "RosPlc_Settings").blocks
    assert block.constant
    assert {v.name: v.initial for v in block.variables} == {
        "sVersion": f"'{__version__}'", "sPrefix": "'cell7'", "xArm": "TRUE", "xFenced": "FALSE",
        "audiBeatMs": "[3000, 15(1000)]",
    }  # fmt: skip


def test_a_task_promises_ten_of_its_cycles_as_beat():
    """A writer that dies keeps its claim for three such times; 250 ms at least, 10 s at most."""
    cycles = {"a": 1, "b": 10, "c": 100, "d": 5000}
    tasks = [PlcTask(name, interval_ns=ms * 1_000_000) for name, ms in cycles.items()]
    tasks.append(PlcTask("e", kind="freewheeling"))
    made = project(*(read(f"/{task.name}", task=task.name) for task in tasks), tasks=tuple(tasks))
    (block,) = named(made.gvls, "RosPlc_Settings").blocks
    beats = next(v.initial for v in block.variables if v.name == "audiBeatMs")
    assert beats == "[250, 250, 1000, 10000, 1000, 11(1000)]"


def test_programs_take_the_prefix_that_was_asked_for():
    """Their names, the deliveries' text and what the script looks for begin with it."""
    made = project(read("/a"), write("/b"), programs="Cell7")
    assert [pou.name for pou in made.pous if pou.kind == "PROGRAM"] == ["Cell7_Read", "Cell7_Write"]
    files = project_files(made, [], "rosplc")
    assert b"PROGRAMS = ('Cell7_Read', 'Cell7_Write')" in files["rosplc_import.py"]
    assert b"Cell7_Read (first)" in files["README.txt"]
    assert not [path for path, content in files.items() if b"SharedMemory_" in content]
    with pytest.raises(GenerationError, match="PLC008"):
        project(read("/a"), programs="2 cells")


def test_a_project_without_topics_is_base_and_helpers():
    """No topics, no programs, no tasks, no error."""
    made = build_project(STORE, [], [])
    assert made.tasks == ()
    assert not [gvl for gvl in made.gvls if gvl.name in ("ROS_Read", "ROS_Write")]
    assert project_files(made, [], "rosplc")["rosplc.xml"]


def test_every_type_that_an_object_uses_is_part_of_the_project():
    """Blocks, variables and functions refer to objects of the project or to elementary types."""
    made = project(read("/a"), write("/b"), read("/j", JOINTS), pins=True)
    names = {item.name for item in (*made.duts, *made.pous)}
    known = {
        "BOOL", "BYTE", "UINT", "UDINT", "ULINT", "DINT", "DWORD", "LREAL", "REAL", "USINT", "INT", "TIME",
        "LTIME", "LDT", "__UXINT", "RTS_IEC_HANDLE", "RTS_IEC_RESULT",
    }  # fmt: skip
    items = [(dut.name, v.type) for dut in made.duts if isinstance(dut, Dut) for v in dut.members]
    for item in (*made.gvls, *made.pous):
        blocks = [*item.blocks, *(b for m in getattr(item, "methods", ()) for b in m.blocks)]
        items += [(item.name, v.type) for b in blocks for v in b.variables]
        if isinstance(item, Pou):
            items += [(item.name, t) for t in (item.extends, item.return_type) if t]
        assert isinstance(item, (Gvl, Pou))
    for where, text in items:
        element = text.removeprefix("POINTER TO ").rsplit(" OF ", 1)[-1]
        assert element in names | known or element.startswith("STRING("), f"{where}: {text}"


GENERATE = """
import hashlib, sys
from rosplc.layout import Limits
from rosplc.plc.delivery import project_files
from rosplc.config.plans import ClassicPlan
from tests.unit.plc.projects import JOINTS, TWIST, project, read, write
topics = [read("/z"), read("/a/b"), read("/a_b"), write("/t", TWIST), read("/j", JOINTS, task="Slow"),
          read("/k", JOINTS, limits=Limits(fields={"name[]": 9, "name": 3})),
          read("/img", "sensor_msgs/msg/Image", limits=Limits(fields={"data": 100000})),
          read("/m", "visualization_msgs/msg/Marker"), write("/n", TWIST, classic=ClassicPlan("n", "n"))]
if sys.argv[1] == "back":
    topics.reverse()
layouts = [topic.layout for topic in sorted(topics, key=lambda topic: topic.topic)]
files = project_files(project(*topics), layouts, "rosplc")
for path in sorted(files):
    print(path, hashlib.sha256(files[path]).hexdigest())
"""


def test_output_is_the_same_byte_for_byte():
    """Whatever the hash seed and the order of the topics, every file has the same bytes."""
    outputs = []
    for seed, order in (("0", "forth"), ("1", "back"), ("4242", "forth"), ("random", "back")):
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": os.getcwd()}
        command = [sys.executable, "-c", GENERATE, order]
        result = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=120, check=False
        )
        assert result.returncode == 0, result.stderr
        outputs.append(result.stdout.splitlines())
    assert len(outputs[0]) > 50
    for other in outputs[1:]:
        assert [a for a, b in zip(outputs[0], other, strict=True) if a != b] == []


def test_a_changed_limit_changes_the_files_that_hold_the_type_alone():
    """A diff in git shows what a change of the configuration does, and nothing else."""
    first = project(read("/p", POSE), read("/j", JOINTS))
    second = project(read("/p", POSE), read("/j", JOINTS, limits=Limits(sequence=6)))
    a, b = (project_files(made, [], "rosplc") for made in (first, second))
    changed = {path for path in a if path.startswith("st/") and a[path] != b[path]}
    assert changed == {"st/Types/sensor_msgs_JointState.st", "st/Blocks/sensor_msgs_JointState_Read.st"}
    assert hashlib.sha256(a["rosplc.xml"]).digest() != hashlib.sha256(b["rosplc.xml"]).digest()


def test_every_message_without_a_fence_is_noted():
    """In order on a PLC without fences: the note says how many messages it can take."""
    topics = (read("/every", in_order=True), read("/newest"), write("/out"))
    notes = project(*topics, fenced=False).notes
    assert len(notes) == 1 and notes[0].startswith("/every: ") and "one message every two scans" in notes[0]
    assert project(*topics).notes == ()
