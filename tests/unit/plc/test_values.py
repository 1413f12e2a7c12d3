"""Messages as initial values, and where a project keeps them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from rosplc.plc.build import build_project
from rosplc.plc.delivery import import_script
from rosplc.plc.plan import PlcTask, PlcTopic
from rosplc.plc.plcopen import plcopen_xml
from rosplc.plc.project import PlcProject
from rosplc.plc.types import DutBuilder, initial_value
from tests.unit.plc.projects import JOINTS, POSE, STORE, TWIST, custom, layout, named, project, read


@pytest.mark.parametrize(
    ("type_name", "value", "text"),
    [
        (TWIST, {}, None),
        (TWIST, {"linear": {"x": 1}, "angular": {}}, "(linear := (x := 1.0))"),
        (
            JOINTS,
            {"header": {"frame_id": "a,(b"}, "name": ["'"]},
            "(header := (frame_id := 'a,(b'), name_count := 1, name := ['$'', 15('')])",
        ),
        (JOINTS, {"name": []}, "(name_count := 0, name := [16('')])"),
        (
            "geometry_msgs/msg/Polygon",
            {"points": [{"x": 1}, {}]},
            "(points_count := 2, points := [(x := 1.0), (x := 0.0)])",
        ),
        (POSE, {"pose": {"orientation": {"w": -1e-9}}}, "(pose := (orientation := (w := -1.0E-9)))"),
    ],
)
def test_fields_that_are_given_are_written(
    type_name: str, value: dict[str, object], text: str | None
) -> None:
    """Fields that are left out stay out, so that the structure's own initial values hold for them."""
    assert initial_value(layout(type_name).root, value, DutBuilder(STORE)) == text


def test_elements_without_fields_of_their_own(tmp_path: Path) -> None:
    """An element that nobody filled is written with its defaults, whatever its first member is."""
    store = custom(tmp_path, Point="int32[3] where\nint8 kind 7\n", Path="Point[<=3] points\nint8 kind 7\n")
    text = initial_value(
        layout("cell_msgs/msg/Path", store=store).root, {"points": [{"kind": 1}, {}]}, DutBuilder(store)
    )
    assert text == "(points_count := 2, points := [(kind := 1), (where := [0])])"


def with_safe() -> PlcProject:
    return project(
        read("/b/cmd", TWIST, stale_after_ns=10**9, on_stale="value", safe={"linear": {"x": 0.5}}),
        read("/a", TWIST, stale_after_ns=10**9, on_stale="value", safe={}),
        read("/c", TWIST, stale_after_ns=10**9, on_stale="value"),
        read("/d", TWIST, stale_after_ns=10**9, on_stale="zero"),
    )


def test_safe_messages_are_constants_that_the_program_hands_over() -> None:
    """They hold when the bridge is dead, too: they are in the project."""
    made = with_safe()
    gvl = named(made.gvls, "ROS_Safe")
    (block,) = gvl.blocks
    assert block.constant
    assert [(v.name, v.type, v.initial) for v in block.variables] == [
        ("a", "geometry_msgs_Twist", None),
        ("b_cmd", "geometry_msgs_Twist", "(linear := (x := 0.5))"),
    ]
    calls = named(made.pous, "SharedMemory_Read").implementation
    assert "uiOnStale := 2, stSafe := ROS_Safe.b_cmd);" in calls
    assert "ROS_Read.c(uiTask := 0, udiMapSize := 0, tStaleAfter := T#1000ms, uiOnStale := 2);" in calls
    assert "ROS_Safe" not in [gvl.name for gvl in project(read("/a")).gvls]


def test_plcopen_has_structures_and_arrays() -> None:
    """An initial value becomes nested elements, one per member, with repetitions as attributes."""
    safe = {"header": {"frame_id": "x,'y"}, "name": ["a"], "position": [1.5]}
    made = build_project(
        STORE,
        [PlcTopic("/j", layout(JOINTS), "read", "Ros", stale_after_ns=1, on_stale="value", safe=safe)],
        [PlcTask("Ros")],
    )
    root = ET.fromstring(plcopen_xml(made))
    name = "{http://www.plcopen.org/xml/tc6_0200}"
    (gvl,) = (item for item in root.iter(f"{name}globalVars") if item.get("name") == "ROS_Safe")
    (value,) = gvl.iter(f"{name}initialValue")

    def plain(element: ET.Element) -> object:
        kind = element.tag.removeprefix(name)
        if kind == "simpleValue":
            return element.get("value")
        if kind == "structValue":
            return {item.get("member"): plain(item[0]) for item in element}
        return [(item.get("repetitionValue"), plain(item[0])) for item in element]

    assert plain(value[0]) == {
        "header": {"frame_id": "'x,$'y'"},
        "name_count": "1",
        "name": [(None, "'a'"), ("15", "''")],
        "position_count": "1",
        "position": [(None, "1.5"), ("15", "0.0")],
    }


def test_the_import_script_makes_safe_messages_anew() -> None:
    """The compiler keeps the values of constants that it knows, so a change replaces the whole list."""
    text = import_script(with_safe())
    start = text.index("'name': 'ROS_Safe'")
    assert "'instances': True," in text[start : start + 120]
    start = text.index("'name': 'RosPlc_Settings'")
    assert "'instances': False," in text[start : start + 120]
