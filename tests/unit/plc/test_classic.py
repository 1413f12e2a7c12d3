"""Blocks of classic topics as they are generated, in every delivery; tests/verification executes them."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from lxml import etree

from rosplc.config.plans import ClassicPlan as Classic
from rosplc.errors import GenerationError
from rosplc.plc.base import CLASSIC_NAMES, classic_objects
from rosplc.plc.build import build_type_library
from rosplc.plc.delivery import import_script, project_files
from rosplc.plc.names import is_reserved
from rosplc.plc.plan import PlcTask, classic_wait
from rosplc.plc.plcopen import plcopen_xml
from rosplc.plc.project import Pou
from tests.unit.plc.fake_scriptengine import Project, run
from tests.unit.plc.projects import JOINTS, STORE, TWIST, layout, named, project, read, write
from tests.unit.plc.test_script_syntax import newer

PLC = "{http://www.plcopen.org/xml/tc6_0200}"
MS = 1_000_000


def classic(name="cmd_vel", semaphore=None, wait_ms=2):
    return Classic(name, name if semaphore is None else semaphore, wait_ms * MS)


@pytest.fixture
def made():
    return project(
        read("/cmd_vel", TWIST, classic=classic(), stale_after_ns=500 * MS),
        read("/joints", JOINTS, classic=classic("joints", "lock"), latched=True),
        write("/speed", TWIST, classic=classic("speed", "")),
        read("/plain", TWIST),
        write("/back", TWIST),
        pins=True,
    )


def instance(made, gvl, name):
    (found,) = (v for block in named(made.gvls, gvl).blocks for v in block.variables if v.name == name)
    return found


def test_instances_take_the_names_of_memory_and_semaphore(made):
    """FB_Init gets both, without a slash; '' stands for no semaphore."""
    assert instance(made, "ROS_Read", "cmd_vel").type == "geometry_msgs_Twist_ClassicRead"
    assert instance(made, "ROS_Read", "joints").arguments == (
        ("sMemory", "'joints'"), ("sSemaphore", "'lock'"),
    )  # fmt: skip
    assert instance(made, "ROS_Write", "speed").type == "geometry_msgs_Twist_ClassicWrite"
    assert instance(made, "ROS_Write", "speed").arguments == (("sMemory", "'speed'"), ("sSemaphore", "''"))
    # A project mixes both kinds; they share the DUT.
    assert instance(made, "ROS_Read", "plain").type == "geometry_msgs_Twist_Read"
    assert instance(made, "ROS_Write", "back").arguments == (("sTopic", "'/back'"),)
    assert [dut.name for dut in made.duts].count("geometry_msgs_Twist") == 1
    assert b"Classic topics" in project_files(made, [], "rosplc")["README.txt"]


def test_calls_say_what_the_configuration_says(made):
    """The generated programs call them like the others; what a record cannot have is left out."""
    text = named(made.pous, "SharedMemory_Read").implementation
    assert "ROS_Read.cmd_vel(uiTask := 0, tWait := T#2ms, tStaleAfter := T#500ms);" in text
    assert "ROS_Read.joints(uiTask := 0, tWait := T#2ms, xLatched := TRUE);" in text
    assert (
        "ROS_Write.speed(uiTask := 0, tWait := T#2ms);"
        in named(made.pous, "SharedMemory_Write").implementation
    )


def test_methods_are_those_of_the_original_design(made):
    """FB_Init and MEM_Read or MEM_Write are in the block, FB_Exit in what it extends."""
    for name, method in (("ClassicRead", "MEM_Read"), ("ClassicWrite", "MEM_Write")):
        block = named(made.pous, f"geometry_msgs_Twist_{name}")
        public = [m.name for m in block.methods if m.access == "PUBLIC"]
        assert public == ["FB_Init", method]
        inputs = [v.name for b in block.methods[0].blocks for v in b.variables]
        assert inputs == ["bInitRetains", "bInCopyCode", "sMemory", "sSemaphore"]
    assert "FB_Exit" in [m.name for m in named(made.pous, "RosPlc_Classic").methods]


def test_no_wait_without_a_limit_and_nothing_deleted(made):
    """No Enter has a literal wait but 0, and Delete is never called: it would take the names away."""
    for pou in made.pous:
        for text in (pou.implementation, *(m.implementation for m in pou.methods)):
            assert "SysSemProcessDelete" not in text
            assert "SysSharedMemoryDelete" not in text
            for wait in re.findall(r"SysSemProcessEnter\(hSem, (\w+)\)", text):
                assert wait in ("0", "udiWait")


def test_memory_is_touched_only_inside_the_lock(made):
    """In the copying methods the shared record is used between Lock and Unlock alone."""
    for name, method in (("ClassicRead", "MEM_Read"), ("ClassicWrite", "MEM_Write")):
        text = named(named(made.pous, f"geometry_msgs_Twist_{name}").methods, method).implementation
        before, _, rest = text.partition("END_IF;\n")
        inside, _, after = rest.partition("Unlock();")
        assert "Lock()" in before
        assert "pstRecord^" in inside
        assert "pbMemory" not in before + after and "pstRecord" not in before + after


@pytest.mark.parametrize(
    ("wait_ms", "cycle_ms", "expected"), [(2, 10, 2), (5, 10, 5), (8, 10, 5), (5, 1, 0), (5, 0, 5)]
)
def test_a_wait_takes_half_a_cycle_at_most(wait_ms, cycle_ms, expected):
    """A lock that is not free must not make the task late; 0 looks without waiting."""
    assert classic_wait(classic(wait_ms=wait_ms), cycle_ms * MS) == expected
    if cycle_ms:
        tasks = (PlcTask("Ros", cycle_ms * MS),)
        made = project(read("/cmd_vel", TWIST, classic=classic(wait_ms=wait_ms)), tasks=tasks)
        assert f"tWait := T#{expected}ms" in named(made.pous, "SharedMemory_Read").implementation
        assert any("the wait for" in note for note in made.notes) == (expected < wait_ms)


def test_the_library_is_asked_for_where_it_is_needed(made):
    """SysSemProcess is in the project with classic topics, and in no other."""
    assert "SysSemProcess" in made.libraries
    assert "SysSemProcess" not in project(read("/plain", TWIST)).libraries
    root = etree.fromstring(plcopen_xml(made))
    assert "#SysSemProcess" in [e.get("Name") for e in root.iter("{*}Library")]
    ide = Project()
    run(import_script(made), ide)
    names = [reference.name for reference in ide.active_application.libraries.references]
    assert "#SysSemProcess" in names


def test_a_project_without_classic_topics_has_nothing_of_them():
    """No object of theirs, and none that refers to one."""
    made = project(read("/plain", TWIST), write("/back", TWIST))
    files = project_files(made, [layout(TWIST)], "rosplc")
    assert not [path for path, content in files.items() if b"RosPlc_Classic" in content or "lassic" in path]
    library = build_type_library(STORE, [layout(TWIST)])
    assert not [pou.name for pou in library.pous if "Classic" in pou.name]


def test_xml_has_the_arguments_and_validates(made):
    """CODESYS' compiler takes the arguments from the variable's addData; the schema has the last word."""
    root = etree.fromstring(plcopen_xml(made))
    variable = next(e for e in root.iter(f"{PLC}variable") if e.get("name") == "joints")
    pairs = [(e.findtext("{*}Name"), e.findtext("{*}Value")) for e in variable.iter("{*}InputAssignment")]
    assert pairs == [("sMemory", "'joints'"), ("sSemaphore", "'lock'")]
    if path := os.environ.get("ROSPLC_PLCOPEN_XSD"):
        etree.XMLSchema(etree.parse(Path(path))).assertValid(root)


def test_the_script_runs_twice_and_is_python_2(made):
    """The second run of the import changes nothing."""
    script, ide = import_script(made), Project()
    assert newer(script) == []
    run(script, ide)
    before, ide.changes = ide.tree(), []
    run(script, ide)
    assert (ide.changes, ide.tree()) == ([], before)


@pytest.mark.parametrize("name", ["/cmd_vel", "a b", "", "x" * 81, "grün"])
def test_a_name_that_cannot_be_is_refused(name):
    """Runtimes do not say what they make of a slash; names longer than a STRING would be cut off."""
    with pytest.raises(GenerationError) as caught:
        project(read("/cmd_vel", TWIST, classic=Classic(name, name)))
    assert caught.value.code == "PLC007"


def test_names_of_the_base_are_taken():
    """A message type cannot take the name of a block that classic topics extend."""
    store = STORE.with_definition("rosplc/msg/Classic", "int32 x\n")
    made = build_type_library(store, [layout("rosplc/msg/Classic", store=store)])
    assert [dut.name for dut in made.duts if dut.comment.startswith("rosplc/msg/Classic")] == [
        "rosplc_Classic_2"
    ]
    objects = [item for item in classic_objects("ROS/Base") if isinstance(item, Pou)]
    methods = [method.name for item in objects for method in item.methods]
    assert not any(is_reserved(name) for name in (*CLASSIC_NAMES, *methods))


def test_every_input_and_output_is_explained():
    """A variable without a word on what it means would be of no use."""
    made = project(read("/a", TWIST, classic=classic("a")), write("/b", TWIST, classic=classic("b")))
    for pou in made.pous:
        if not isinstance(pou, Pou) or "Classic" not in pou.name:
            continue
        for block in pou.blocks:
            if block.kind in ("VAR_INPUT", "VAR_OUTPUT"):
                assert all(variable.comment for variable in block.variables), pou.name
