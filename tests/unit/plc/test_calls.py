"""Services and actions in a generated project: names, objects, calls, and what is left when they go."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from rosplc.config import Project, parse_config, resolve
from rosplc.config.plans import ActionPlan, CallPlan, ServicePlan
from rosplc.errors import GenerationError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.plc.base import ACTION_NAMES, CALL_NAMES, call_objects
from rosplc.plc.build import build_project, plc_project
from rosplc.plc.delivery import project_files
from rosplc.plc.plan import PlcTask, ProjectOptions
from rosplc.plc.plcopen import plcopen_xml
from rosplc.plc.project import Enumeration, PlcProject, object_text, project_texts
from rosplc.project import check
from rosplc.reasons import Reason

STORE = TypeStore.bundled("jazzy")
FIBONACCI, SET_BOOL = "example_interfaces/action/Fibonacci", "std_srvs/srv/SetBool"


def use(name: str, kind: str, role: str, client: str = "", limits: Limits | None = None) -> CallPlan:
    plan = ActionPlan if "/action/" in kind else ServicePlan
    about: Any = {plan.kind: name, "type_name": kind, "client": client, "task": "RosTask"}
    for part in plan.parts:
        about[part.word] = compute_layout(STORE, f"{kind}_{part.word.capitalize()}", limits or Limits())
    return plan(server="plc" if role.endswith("Server") else "ros", **about)


def project(*calls: CallPlan) -> PlcProject:
    return build_project(STORE, (), [PlcTask("RosTask")] if calls else (), calls=calls)


def lines(text: str, pattern: str) -> list[str]:
    return [line.strip() for line in text.splitlines() if re.search(pattern, line)]


def test_each_use_has_an_instance_that_is_called_once():
    """Lists, names from service and client, and one call a scan in the task's reading program."""
    made = project(
        use("/lamp", SET_BOOL, "Client", "left"),
        use("/lamp", SET_BOOL, "Client"),
        use("/start", SET_BOOL, "Server"),
        use("/move", FIBONACCI, "ActionClient"),
        use("/cycle", FIBONACCI, "ActionServer"),
    )
    texts = project_texts(made)
    declared = [line.partition(";")[0] for line in lines(texts["ROS_Services"], " : ")]
    assert declared == [
        "lamp : std_srvs_SetBool_Client('/lamp', '')",
        "lamp_left : std_srvs_SetBool_Client('/lamp', 'left')",
        "start : std_srvs_SetBool_Server('/start')",
    ]
    declared = [line.partition(";")[0] for line in lines(texts["ROS_Actions"], " : ")]
    assert declared == [
        "cycle : example_interfaces_Fibonacci_ActionServer('/cycle')",
        "_move : example_interfaces_Fibonacci_ActionClient('/move', '')",
    ]
    called = lines(texts["SharedMemory_Read"], r"^ROS_")
    assert called == [
        "ROS_Services.lamp(uiTask := 0);",
        "ROS_Services.lamp_left(uiTask := 0);",
        "ROS_Services.start(uiTask := 0);",
        "ROS_Actions.cycle(uiTask := 0);",
        "ROS_Actions._move(uiTask := 0);",
    ]
    assert "instance of /move: move was renamed to _move" in made.notes
    assert "SharedMemory_Write" not in texts


def test_objects_for_calls_are_part_of_a_project_only_where_calls_are():
    """A project of topics alone has none of them; one of services none of actions."""
    of_calls = set(CALL_NAMES) | set(ACTION_NAMES)
    assert not of_calls & set(project_texts(project()))
    texts = project_texts(project(use("/s", SET_BOOL, "Server")))
    assert of_calls & set(texts) == set(CALL_NAMES)
    texts = project_texts(project(use("/a", FIBONACCI, "ActionServer")))
    assert of_calls <= set(texts)


def test_a_type_of_several_sizes_has_a_block_for_each():
    """The second block's name follows from its layouts, whatever else the project has."""
    wide = Limits(string=200)
    made = project(use("/a", SET_BOOL, "Client"), use("/b", SET_BOOL, "Client", limits=wide))
    blocks = [name for name in project_texts(made) if name.startswith("std_srvs_SetBool_Client")]
    assert blocks[0] == "std_srvs_SetBool_Client"
    assert re.fullmatch(r"std_srvs_SetBool_Client_[0-9a-f]{6}", blocks[1])
    again = project(use("/b", SET_BOOL, "Client", limits=wide), use("/a", SET_BOOL, "Client"))
    assert project_texts(again) == project_texts(made)


def test_names_that_collide():
    """A use named as another service is told apart from it; parts share one scope with the rest."""
    made = project(use("/lamp", SET_BOOL, "Client", "left"), use("/lamp/left", SET_BOOL, "Client"))
    declared = lines(project_texts(made)["ROS_Services"], " : ")
    names = [line.partition(" ")[0] for line in declared]
    assert len(set(names)) == 2
    assert all(re.fullmatch(r"lamp_left_[0-9a-f]{4}", name) for name in names)
    texts = project_texts(made)
    assert len({name.upper() for name in texts}) == len(texts)


@pytest.mark.parametrize(
    ("name", "client", "code"),
    [("/a b", "", "PLC008"), ("/a", "b-c", "PLC008"), ("/" + "a" * 300, "", "PLC006")],
)
def test_names_that_are_none(name, client, code):
    """What is no name is refused before it gets into a literal."""
    with pytest.raises(GenerationError) as caught:
        project(use(name, SET_BOOL, "Client", client))
    assert caught.value.code == code


def test_constants_of_parts_are_constants_of_the_project():
    """Constants of a request, a response or a feedback are those of a message."""
    kind = "rcl_interfaces/srv/ListParameters"
    texts = project_texts(project(use("/list", kind, "Client")))
    (name,) = [name for name in texts if name.endswith("ListParameters_Request_Const")]
    assert "DEPTH_RECURSIVE : ULINT := 0;" in texts[name]


def test_reasons_are_those_of_the_format():
    """The enumeration has each number once, under the format's names."""
    (found,) = [item for item in call_objects("ROS/Base", actions=False) if isinstance(item, Enumeration)]
    assert [number for _, number in found.values] == [reason.value for reason in Reason]
    assert [name for name, _ in found.values][1:] == [reason.name for reason in Reason][1:]


def test_deliveries_have_the_instances_inside_blocks():
    """PLCopenXML and text give the argument of a block inside a block; the README tells of calls."""
    made = project(use("/s", SET_BOOL, "Server"))
    block = next(pou for pou in made.pous if pou.name == "std_srvs_SetBool_Server")
    assert "    fbRequest : std_srvs_SetBool_Request_Read('');" in object_text(block)
    xml = plcopen_xml(made).decode()
    assert xml.count("<InputAssignment>") == 3  # the instance, and a block for each part
    files = project_files(made, [], "rosplc")
    assert b"ROS_Services.cell_start.xReply" in files["README.txt"]
    assert b"ROS_Services" not in project_files(project(), [], "rosplc")["README.txt"]


def test_blocks_differ_only_in_their_part_of_the_layout():
    """What a technician reads of a type is short: the state machine is in the base."""
    for role, most in (("Client", 40), ("Server", 40)):
        text = project_texts(project(use("/s", SET_BOOL, role)))[f"std_srvs_SetBool_{role}"]
        assert len(text.splitlines()) < most


CELL = """
types: {paths: [FOLDER]}
tasks: {Fast: {interval: 2ms}, Slow: {interval: 100ms}, Idle: {interval: 1s}}
services:
  /Go: {type: cell/srv/Move, server: ros, clients: {left: {task: Fast}, right: {task: Slow}}}
  /go: {type: cell/srv/MOVE, server: plc, task: Slow}
actions:
  /Go: {type: cell/action/Move, server: ros, clients: {left: {task: Fast}, right: {task: Slow}}}
  /go: {type: cell/action/Move, server: plc, task: Fast}
"""


@pytest.fixture
def cell(tmp_path: Path) -> Project:
    texts = {
        "package.xml": "<package><name>cell</name></package>",
        "srv/Move.srv": "uint8 LEFT=1\n---\nuint8 DONE=2",
        "srv/MOVE.srv": "bool b\n---\nbool b",
        "action/Move.action": "uint8 FAR=3\n---\nuint8 THERE=4\n---\nuint8 ON_THE_WAY=5",
        "msg/MoveGoal.msg": "uint8 x",
    }
    for name, text in texts.items():
        (tmp_path / "cell" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "cell" / name).write_text(text)
    return resolve(parse_config(CELL.replace("FOLDER", str(tmp_path / "cell"))))


def test_a_configuration_of_services_and_actions(cell: Project) -> None:
    """A service and an action of one name and type, uses in two tasks, and names that differ in capitals."""
    made = plc_project(cell, ProjectOptions())
    texts = project_texts(made)
    assert len({name.upper() for name in texts}) == len(texts)
    assert [task.task.name for task in made.tasks] == ["Fast", "Slow"]
    names = ("Go_left", "Go_right", "go")
    for gvl in ("ROS_Services", "ROS_Actions"):
        assert tuple(re.findall(r"^ +(\w+) :", texts[gvl], re.MULTILINE)) == names
    called = {task: lines(texts[f"SharedMemory_Read_{task}"], r"^ROS_") for task in ("Fast", "Slow")}
    assert called == {
        "Fast": [
            "ROS_Services.Go_left(uiTask := 0);",
            "ROS_Actions.Go_left(uiTask := 0);",
            "ROS_Actions.go(uiTask := 0);",
        ],
        "Slow": [
            "ROS_Services.Go_right(uiTask := 1);",
            "ROS_Services.go(uiTask := 1);",
            "ROS_Actions.Go_right(uiTask := 1);",
        ],
    }
    blocks = re.findall(r": (\w+)\(", texts["ROS_Services"] + texts["ROS_Actions"])
    assert len({name.upper() for name in blocks}) == len(set(blocks)) == 4
    assert set(blocks) <= set(texts)
    constants = "\n".join(text for name, text in texts.items() if name.endswith("_Const"))
    assert sorted(re.findall(r"^ +(\w+) : USINT := \d;", constants, re.MULTILINE)) == [
        *("DONE", "FAR", "LEFT", "ON_THE_WAY", "THERE")
    ]


def test_check_tells_what_is_generated(cell: Project) -> None:
    """Each use has its instance and block there, as the lists have them."""
    facts, texts = check(cell), project_texts(plc_project(cell, ProjectOptions()))
    found = {fact["instance"]: fact["block"] for fact in facts["services"] + facts["actions"]}
    assert len(found) == 6
    for instance, block in found.items():
        gvl, name = instance.split(".")
        assert lines(texts[gvl], rf"^ +{name} : {block}\(")
