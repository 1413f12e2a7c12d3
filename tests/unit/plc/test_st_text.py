"""Objects as text: what is written is what was read, and nothing that is not understood gets lost."""

from __future__ import annotations

from importlib.resources import files

import pytest

from rosplc.plc.base import (
    ACTION_NAMES,
    CALL_NAMES,
    HELPER_NAMES,
    base_objects,
    parse_object,
    read_objects,
    render,
)
from rosplc.plc.names import is_reserved
from rosplc.plc.project import Gvl, Pou, declaration, object_text
from tests.unit.plc.projects import JOINTS, project, read, write

TEMPLATES = sorted(
    (folder, path.name.removesuffix(".st"))
    for folder in ("base", "calls", "helpers")
    for path in files("rosplc.plc").joinpath(f"templates/{folder}").iterdir()
    if path.name.endswith(".st")
)


@pytest.mark.parametrize(("folder", "name"), TEMPLATES)
def test_a_template_comes_out_as_it_was_written(folder, name):
    """Reading and writing an object gives the same text, byte for byte."""
    text = render(f"{folder}/{name}.st")
    assert object_text(parse_object(text, name)) == text


def test_every_template_is_part_of_a_project():
    """A file that nobody lists would be a block that no project has."""
    base = {item.name for item in base_objects("ROS/Base")}
    known = {"base": base, "calls": (*CALL_NAMES, *ACTION_NAMES), "helpers": HELPER_NAMES}
    assert {(folder, name) for folder, names in known.items() for name in names} == set(TEMPLATES)


@pytest.mark.parametrize(("folder", "name"), TEMPLATES)
def test_a_template_declares_no_keyword(folder, name):
    """Names of objects, methods and variables are none of the compiler's own."""
    (item,) = read_objects(folder, [name], "ROS")
    blocks = [*getattr(item, "blocks", ())]
    methods = getattr(item, "methods", ())
    blocks += [block for method in methods for block in method.blocks]
    names = [item.name, *(m.name for m in methods), *(v.name for b in blocks for v in b.variables)]
    names += [member.name for member in getattr(item, "members", ())]
    names += [name for name, _ in getattr(item, "values", ())]
    assert not [each for each in names if is_reserved(each) or "__" in each or each.endswith("_")]


def test_generated_objects_can_be_read_again():
    """What the generator writes is of the form of the hand-written objects, so one reader serves both."""
    made = project(read("/a", JOINTS), write("/b"), read("/m", "visualization_msgs/msg/Marker"))
    for item in (*made.duts, *made.gvls, *made.pous):
        if isinstance(item, Gvl) and any(v.arguments for b in item.blocks for v in b.variables):
            continue  # instances with arguments are no part of the hand-written form
        again = parse_object(object_text(item), item.name, item.folder)
        assert object_text(again) == object_text(item)
        assert type(again) is type(item)
        assert declaration(again) == declaration(item)


def test_every_text_is_ascii_and_ends_with_a_line_feed():
    """Editors and compilers differ in what they make of anything else."""
    made = project(read("/a", JOINTS), write("/b"), pins=True)
    for item in (*made.duts, *made.gvls, *made.pous):
        text = object_text(item)
        assert text.isascii()
        assert text.endswith("\n")
        assert "\t" not in text
        assert "\r" not in text


@pytest.mark.parametrize(
    "text",
    [
        "",
        "// only a comment\n",
        "TYPE X :\nSTRUCT\n    a, b : INT;\nEND_STRUCT\nEND_TYPE\n",
        "TYPE X :\nSTRUCT\n    a : INT\nEND_STRUCT\nEND_TYPE\n",
        "TYPE X : INT;\nEND_TYPE\n",
        "TYPE X :\n(\n    A\n) UDINT;\nEND_TYPE\n",
        "TYPE Y :\nSTRUCT\n    a : INT;\nEND_STRUCT\nEND_TYPE\n",
        "VAR_GLOBAL\n    a : INT;\nEND_VAR\nVAR_GLOBAL\n",
        "VAR_GLOBAL\n    a : INT;\nEND_VAR\nx := 1;\n",
        "FUNCTION_BLOCK Y\nEND_FUNCTION_BLOCK\n",
        "FUNCTION_BLOCK X\nVAR\n    a : INT;\nEND_FUNCTION_BLOCK\n",
        "FUNCTION_BLOCK X IMPLEMENTS I\nEND_FUNCTION_BLOCK\n",
        "FUNCTION_BLOCK X\nEND_FUNCTION_BLOCK\n\nMETHOD A : BOOL\nEND_METHOD\n",
        "FUNCTION_BLOCK X\nEND_FUNCTION_BLOCK\n\nMETHOD PUBLIC A : BOOL\nx := 1;\n",
        "FUNCTION_BLOCK X\nEND_FUNCTION_BLOCK\n\nPROPERTY P : BOOL\nEND_PROPERTY\n",
        "PROGRAM X\nx := 1;\n",
    ],
)
def test_what_is_not_understood_is_an_error(text):
    """The reader knows one form, and refuses every other instead of losing a part."""
    with pytest.raises(ValueError, match=r"\S"):
        parse_object(text, "X")


def test_abstract_blocks_and_bases_are_kept():
    """The head of a block says all that the compiler needs."""
    reader = next(item for item in base_objects("ROS/Base") if item.name == "RosPlc_Reader")
    assert isinstance(reader, Pou)
    assert (reader.abstract, reader.extends) == (True, "RosPlc_Channel")
    assert "FUNCTION_BLOCK ABSTRACT RosPlc_Reader EXTENDS RosPlc_Channel\n" in object_text(reader)
