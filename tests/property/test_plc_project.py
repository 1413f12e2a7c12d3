"""Whole PLC projects from searched definitions and topics: every delivery stays well-formed."""

from __future__ import annotations

import re
from xml.etree import ElementTree

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rosplc.config.plans import ClassicPlan
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.plc.build import build_project
from rosplc.plc.delivery import project_files
from rosplc.plc.names import is_reserved
from rosplc.plc.plan import PlcTask, PlcTopic, ProjectOptions
from rosplc.plc.project import Enumeration
from tests.unit.plc.fake_scriptengine import Project, run

STORE = TypeStore.bundled("jazzy")
IDENTIFIER = re.compile(r"(?:[A-Za-z]|_(?=[A-Za-z0-9]))(?:_?[A-Za-z0-9])*\Z")
HOSTILE = [
    "type",
    "r",
    "end_if",
    "data",
    "data_count",
    "abpad1",
    "abpad4",
    "bool_to_int",
    "x",
    "x1",
    "x_2",
    "msg",
]
FIELD_NAMES = st.sampled_from(HOSTILE) | st.from_regex(r"[a-z](_?[a-z0-9]){0,12}", fullmatch=True)
KINDS = st.sampled_from(["bool", "int8", "uint16", "int64", "float32", "float64", "string", "byte"])
SHAPES = st.sampled_from(["", "[3]", "[]", "[<=2]"])
SEGMENTS = st.sampled_from(["a", "A", "a_b", "type", "robot1", "x_y_z", "b"])
TOPICS = st.lists(SEGMENTS, min_size=1, max_size=3).map(lambda parts: "/" + "/".join(parts))


@st.composite
def definitions(draw):
    names = draw(st.lists(FIELD_NAMES, min_size=0, max_size=8, unique=True))
    lines = [f"{draw(KINDS)}{draw(SHAPES)} {name}" for name in names]
    constants = draw(
        st.lists(st.sampled_from(["ADD", "DELETE", "POINTS", "X", "N"]), max_size=3, unique=True)
    )
    return "\n".join([*(f"uint8 {name}={number}" for number, name in enumerate(constants)), *lines]) + "\n"


def element_names(dut):
    """Return what a data unit type declares: members, or the names of an enumeration."""
    return [name for name, _ in dut.values] if isinstance(dut, Enumeration) else [m.name for m in dut.members]


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    texts=st.lists(definitions(), min_size=1, max_size=3),
    topics=st.lists(st.tuples(TOPICS, st.booleans(), st.integers(0, 2), st.integers(1, 3),
                              st.booleans()), max_size=8,
                    unique_by=lambda topic: topic[0]),
    tasks=st.sampled_from([["Ros"], ["Fast", "Slow"]]),
    pins=st.booleans(),
)  # fmt: skip
def test_any_project_is_well_formed_in_every_delivery(texts, topics, tasks, pins):
    """Names are apart and legal, XML is XML, files are apart, and the script runs twice without a change."""
    store = STORE
    for number, text in enumerate(texts):
        store = store.with_definition(f"cell_msgs/msg/T{number}", text)
    plans = []
    for index, (topic, reading, number, sequence, classic) in enumerate(topics):
        type_name = f"cell_msgs/msg/T{number % len(texts)}"
        layout = compute_layout(store, type_name, Limits(string=9, sequence=sequence))
        plans.append(
            PlcTopic(
                topic,
                layout,
                "read" if reading else "write",
                tasks[index % len(tasks)],
                classic=ClassicPlan(f"m{index}", f"s{index}") if classic else None,
            )
        )
    used = [PlcTask(name) for name in tasks if name in {plan.task for plan in plans}]
    made = build_project(store, plans, used, ProjectOptions(pins=pins))

    objects = [item.name for item in (*made.duts, *made.gvls, *made.pous)]
    scopes = [objects, *(element_names(dut) for dut in made.duts)]
    scopes += [[v.name for b in item.blocks for v in b.variables] for item in (*made.gvls, *made.pous)]
    for scope in scopes:
        assert len({name.upper() for name in scope}) == len(scope)
        assert all(IDENTIFIER.match(name) and not is_reserved(name) for name in scope)
    instances = [v for gvl in made.gvls for b in gvl.blocks for v in b.variables if v.arguments]
    assert sorted(v.arguments[0][1] for v in instances) == sorted(
        f"'{plan.classic.name if plan.classic else plan.topic}'" for plan in plans
    )

    files = project_files(made, [plan.layout for plan in plans], "rosplc")
    assert len({path.upper() for path in files}) == len(files)
    ElementTree.fromstring(files["rosplc.xml"])
    ide = Project()
    script = files["rosplc_import.py"].decode("ascii")
    run(script, ide)
    before, ide.changes = ide.tree(), []
    run(script, ide)
    assert ide.changes == []
    assert ide.tree() == before
    assert {path.rsplit("/", 1)[1] for path in before} >= set(objects)
