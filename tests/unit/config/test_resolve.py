"""Settings become plans: types, layouts, sizes, and the errors that only these can show."""

from __future__ import annotations

from pathlib import Path

import pytest

from rosplc.config import ConfigErrors, load_config, load_project, parse_config, resolve
from rosplc.config.resolve import Project
from rosplc.project import generate
from rosplc.ros import Qos
from rosplc.shm import Direction

TWIST = "geometry_msgs/msg/Twist"
JOINTS = "sensor_msgs/msg/JointState"


def project(topics: str, more: str = "") -> Project:
    """Resolve a text with these topics."""
    return resolve(parse_config(f"{more}\ntopics:\n{topics}", name="c.yaml"))


def errors_of(text: str) -> list[tuple[str, str]]:
    """Return code and place of everything wrong with a text."""
    with pytest.raises(ConfigErrors) as caught:
        resolve(parse_config(text, name="c.yaml"))
    return [(error.code, error.where) for error in caught.value.errors]


def test_a_plan_has_everything_decided() -> None:
    """Defaults differ by direction: the source's towards ROS, ROS' usual ones towards the PLC."""
    made = project(f"  /a: {{type: geometry_msgs/Twist, to: plc}}\n  /b: {{type: {TWIST}, to: ros}}\n")
    to_plc, to_ros = made.topics
    assert (to_plc.type_name, to_plc.direction, to_plc.task) == (TWIST, Direction.TO_PLC, "RosTask")
    assert to_plc.qos == Qos("reliable", "volatile", 1000)
    assert (to_plc.every, to_plc.latched, to_plc.stale_after_ns, to_plc.truncate) == (
        False,
        False,
        10**9,
        False,
    )
    assert to_ros.qos == Qos("reliable", "transient_local", 1000)
    assert (to_ros.every, to_ros.latched, to_ros.stale_after_ns) == (True, False, 0)
    assert to_plc.layout == to_ros.layout
    assert made.topic("/b") is to_ros
    with pytest.raises(KeyError):
        made.topic("/c")


@pytest.mark.parametrize(
    ("entry", "qos", "latched"),
    [
        ("to: plc, qos: sensor_data", Qos("best_effort", "volatile", 5), False),
        ("to: ros, qos: default", Qos("reliable", "volatile", 10), False),
        ("to: plc, qos: latched", Qos("reliable", "transient_local", 1000), True),
        ("to: plc, latched: true", Qos("reliable", "transient_local", 1000), True),
        ("to: ros, latched: false", Qos("reliable", "volatile", 1000), False),
        ("to: ros, qos: {depth: 1}", Qos("reliable", "transient_local", 1), False),
        ("to: ros, qos: {preset: sensor_data, depth: 7}", Qos("best_effort", "volatile", 7), False),
        ("to: plc, qos: {reliability: best_effort}", Qos("best_effort", "volatile", 1000), False),
        ("to: ros, qos: {durability: volatile}", Qos("reliable", "volatile", 1000), False),
        ("to: ros, latched: true, qos: {durability: volatile}", Qos("reliable", "volatile", 1000), True),
        ("to: plc, latched: false, qos: latched", Qos("reliable", "volatile", 1000), False),
        (
            "to: plc, latched: false, qos: {durability: transient_local}",
            Qos("reliable", "transient_local", 1000),
            False,
        ),
    ],
)
def test_quality_of_service(entry: str, qos: Qos, latched: bool) -> None:
    """Single values come before the preset; ``latched`` and durability decide each other's default only."""
    (plan,) = project(f"  /a: {{type: {TWIST}, {entry}}}\n").topics
    assert (plan.qos, plan.latched) == (qos, latched)


def test_names_of_generated_programs(tmp_path: Path) -> None:
    """The configuration's prefix holds unless the caller gives one."""
    made = project(f"  /a: {{type: {TWIST}, to: plc}}\n", "programs: Robot")
    for given, prefix in ((None, "Robot"), ("Cell", "Cell")):
        written = generate(made, tmp_path / prefix, programs=given).written
        assert any(f"{prefix}_Read" in name for name in written)


def test_limits_of_file_topic_and_field() -> None:
    """A field's limit stands over the topic's default, that over the file's."""
    entry = f"  /a: {{type: {JOINTS}, to: plc, limits: {{name: 3, 'name[]': 5, string: 7}}}}\n"
    (plan,) = project(entry, "limits: {string: 20, sequence: 2}").topics
    nodes = {path: node for path, _, node in plan.layout.fields()}
    assert nodes["name"].capacity == 3  # type: ignore[union-attr]
    assert nodes["name[]"].capacity == 5  # type: ignore[union-attr]
    assert nodes["header.frame_id"].capacity == 7  # type: ignore[union-attr]
    assert nodes["position"].capacity == 2  # type: ignore[union-attr]


def test_tasks_and_slots() -> None:
    """Slots follow from rate and task; what is given is rounded up to a power of two."""
    made = project(
        f"  /a: {{type: {TWIST}, to: ros, task: Fast}}\n"
        f"  /b: {{type: {TWIST}, to: ros}}\n"
        f"  /c: {{type: {TWIST}, to: plc, slots: 9}}\n"
        f"  /d: {{type: {TWIST}, to: plc, every: true, expected_rate: 1kHz, task: Fast}}\n"
        f"  /e: {{type: {TWIST}, to: ros, task: Free}}\n"
        "  /f: {type: sensor_msgs/msg/Image, to: ros, limits: {data: 100000}, task: Fast}\n",
        "tasks: {Slow: {interval: 20ms}, Fast: {interval: 1ms}, Free: {kind: freewheeling}}",
    )
    assert [(plan.task, plan.slots) for plan in made.topics] == [
        ("Fast", 256),
        ("Slow", 16),
        ("Slow", 16),
        ("Fast", 32),
        ("Free", 16),
        ("Fast", 32),
    ]
    assert list(made.tasks) == ["Slow", "Fast", "Free"]


def test_custom_types(tmp_path: Path) -> None:
    """Folders are relative to the file."""
    (tmp_path / "msg" / "my_pkg" / "msg").mkdir(parents=True)
    (tmp_path / "msg" / "my_pkg" / "msg" / "Fan.msg").write_text("bool on\nuint16[] speeds\n")
    path = tmp_path / "rosplc.yaml"
    path.write_text(
        "types: {paths: [msg]}\ntopics:\n  /fan: {type: my_pkg/msg/Fan, to: plc, limits: {speeds: 3}}\n"
    )
    assert load_project(path).topic("/fan").layout.size == 1 + 3 + 4 + 6 + 2
    assert load_config(path).path == path


def test_errors_in_custom_types_name_both_places(tmp_path: Path) -> None:
    """The key of the topic that uses a type, and file and line of the mistake; unused types may have any."""
    (tmp_path / "my_pkg" / "msg").mkdir(parents=True)
    (tmp_path / "my_pkg" / "msg" / "Fan.msg").write_text("bool on\nuint17 speed\n")
    (tmp_path / "my_pkg" / "msg" / "Unused.msg").write_text("wstring text\n")
    path = tmp_path / "rosplc.yaml"
    path.write_text("bridge: a\ntypes:\n  paths: [my_pkg]\ntopics:\n  /fan: {type: my_pkg/Fan, to: plc}\n")
    with pytest.raises(ConfigErrors) as caught:
        load_config(path)
    (first,) = caught.value.errors
    assert first.where == f"{path}:5: topics./fan.type"
    assert "Fan.msg:2" in first.what
    path.write_text("bridge: a\ntypes:\n  paths: [missing, my_pkg, absent]\n")
    with pytest.raises(ConfigErrors) as caught:
        load_config(path)
    assert [(each.code, each.where) for each in caught.value.errors] == [
        ("CFG001", f"{path}:3: types.paths[0]"),
        ("CFG001", f"{path}:3: types.paths[2]"),
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "topics:\n  /a: {type: geometry_msgs/msg/Twst, to: plc}\n",
            [("TYP001", "c.yaml:2: topics./a.type")],
        ),
        (
            f"topics:\n  /a:\n    type: {JOINTS}\n    to: plc\n    limits:\n      name: 6\n      nmae: 6\n",
            [("LAY002", "c.yaml:7: topics./a.limits.nmae")],
        ),
        (
            f"topics:\n  /a:\n    type: {JOINTS}\n    to: plc\n    limits:\n      name: 0\n",
            [("LAY001", "c.yaml:6: topics./a.limits.name")],
        ),
        (
            f"topics:\n  /a:\n    type: {JOINTS}\n    to: plc\n    limits: {{name: 6, position: 99999999}}\n",
            [("LAY001", "c.yaml:5: topics./a.limits.position")],
        ),
        (
            f"topics:\n  /a: {{type: {JOINTS}, to: plc,\n    task: Slow}}\n",
            [("CFG004", "c.yaml:3: topics./a.task")],
        ),
        (
            "tasks: {A: {interval: 1ms}}\ntopics:\n"
            f"  /a: {{type: {TWIST}, to: plc, every: true, expected_rate: 10kHz,\n    slots: 4}}\n",
            [("CFG008", "c.yaml:4: topics./a.slots")],
        ),
        (
            f"tasks: {{A: {{interval: 100us}}}}\ntopics:\n  /a: {{type: {TWIST}, to: ros, slots: 8}}\n",
            [("CFG008", "c.yaml:3: topics./a.slots")],
        ),
        (
            "topics:\n  /a: {type: a/b, to: plc}\n  /b: {type: c/d, to: plc}\n",
            [("TYP001", "c.yaml:2: topics./a.type"), ("TYP001", "c.yaml:3: topics./b.type")],
        ),
        (  # an object has at most 2 GiB
            "topics:\n  /a: {type: std_msgs/ByteMultiArray, to: plc, limits: {data: 16777216},\n"
            "    slots: 128}\n",
            [("LAY003", "c.yaml:3: topics./a.slots")],
        ),
    ],
)
def test_errors(text: str, expected: list[tuple[str, str]]) -> None:
    """Mistakes that need types or arithmetic are found at the line of their key, all at once."""
    assert errors_of(text) == expected


def test_an_unknown_type_comes_with_the_nearest_one() -> None:
    """The text says what was probably meant."""
    with pytest.raises(ConfigErrors, match="geometry_msgs/msg/Twist"):
        project("  /a: {type: geometry_msgs/msg/Twst, to: plc}\n")


def test_two_topics_with_one_object_name() -> None:
    """Long names are shortened with a hash; the rare collision is found before it does harm."""
    start = "/" + "x" * 80 + "/t"
    one, other = f"{start}815295", f"{start}1103830"  # found by trying
    text = f"topics:\n  {one}: {{type: {TWIST}, to: plc}}\n  {other}: {{type: {TWIST}, to: ros}}\n"
    assert errors_of(text) == [("CFG007", f"c.yaml:3: topics.{other}")]
