"""PLCopenXML: every element stands where CODESYS writes it, and the file says what the model says.

The checks know the places by themselves, from exports of CODESYS V3.5 SP15 and SP21 and from its
help; they share nothing with the writer. The schema itself belongs to PLCopen and is not part of
this repository: ``ROSPLC_PLCOPEN_XSD`` may name a copy of ``tc6_xml_v200.xsd``.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from lxml import etree

from rosplc.layout import Limits
from rosplc.model import DISTROS, TypeStore
from rosplc.plc.build import build_type_library
from rosplc.plc.plan import ProjectOptions
from rosplc.plc.plcopen import plcopen_xml
from rosplc.plc.project import (
    Enumeration,
    PlcProject,
    Pou,
    VarBlock,
    Variable,
    declaration,
    method_declaration,
)
from tests.unit.plc.projects import JOINTS, STORE, TWIST, custom, layout, project, read, write

pytestmark = pytest.mark.verifies("plcopen", own="checks of the structure, the schema (where available)")

PLC = "{http://www.plcopen.org/xml/tc6_0200}"
XHTML = "{http://www.w3.org/1999/xhtml}"
DATA = "http://www.3s-software.com/plcopenxml/"
# Children of each element, in the order in which the importer wants them; None: any number.
ORDER = {
    "project": ["fileHeader", "contentHeader", "types", "instances", "addData"],
    "contentHeader": ["coordinateInfo", "addData"],
    "types": ["dataTypes", "pous"],
    "dataType": ["baseType", "initialValue", "addData", "documentation"],
    "pou": ["interface", "body", "addData"],
    "interface": [
        "returnType", "inputVars", "outputVars", "inOutVars", "localVars", "tempVars", "addData",
        "documentation",
    ],
    "variable": ["type", "initialValue", "addData", "documentation"],
    "globalVars": ["variable", "addData", "documentation"],
    "Method": ["interface", "body", "InterfaceAsPlainText", "addData"],
    "array": ["dimension", "baseType"],
}  # fmt: skip


def local(element):
    return etree.QName(element).localname


def data(element, kind):
    """Return what is in an element's own addData under a name of CODESYS."""
    found = element.findall(f"{PLC}addData/{PLC}data[@name='{DATA}{kind}']")
    return [entry[0] if len(entry) else None for entry in found]


def plain(element):
    return element.find(f"{XHTML}xhtml").text or ""


def type_text(element):
    """Return a type as Structured Text, from its element."""
    kind = local(element)
    if kind == "array":
        dimension, base = element.find(f"{PLC}dimension"), element.find(f"{PLC}baseType")
        return f"ARRAY[{dimension.get('lower')}..{dimension.get('upper')}] OF {type_text(base[0])}"
    if kind == "pointer":
        return f"POINTER TO {type_text(element.find(f'{PLC}baseType')[0])}"
    if kind == "string":
        return f"STRING({element.get('length')})"
    return element.get("name") if kind == "derived" else kind


def value_text(element):
    if local(element) == "simpleValue":
        return element.get("value")
    items = []
    for value in element:
        text = value_text(value[0])
        items.append(f"{value.get('repetitionValue')}({text})" if value.get("repetitionValue") else text)
    return f"[{', '.join(items)}]"


def variables(section):
    result = []
    for element in section.findall(f"{PLC}variable"):
        initial = element.find(f"{PLC}initialValue")
        arguments = [
            (entry.findtext(f"{PLC}Name"), entry.findtext(f"{PLC}Value"))
            for assignments in data(element, "inputassignments")
            for entry in assignments
        ]
        result.append(
            (
                element.get("name"),
                type_text(element.find(f"{PLC}type")[0]),
                value_text(initial[0]) if initial is not None else None,
                tuple(arguments),
            )
        )
    return result


SECTIONS = {
    "VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR_IN_OUT": "inOutVars", "VAR": "localVars",
    "VAR_TEMP": "tempVars",
}  # fmt: skip


def check_interface(interface, blocks, return_type):
    found = interface.find(f"{PLC}returnType")
    assert (type_text(found[0]) if found is not None else None) == return_type
    for kind, section in SECTIONS.items():
        for constant in (False, True):
            wanted = [
                (v.name, v.type, v.initial, v.arguments)
                for b in blocks
                if (b.kind, b.constant) == (kind, constant)
                for v in b.variables
            ]
            elements = interface.findall(f"{PLC}{section}")
            given = [v for e in elements if (e.get("constant") == "true") is constant for v in variables(e)]
            assert given == wanted


# PLCopen gives it to everybody, but it may not be passed on: the variable names a copy of tc6_xml_v200.xsd.
needs_schema = pytest.mark.needs(variable="ROSPLC_PLCOPEN_XSD")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A project with everything: defaults, constants, variants, pins, tasks, all base blocks."""
    limits = Limits(fields={"name": 6, "name[]": 20})
    return project(
        read("/pose"), read("/type", JOINTS, limits=limits), read("/joints", JOINTS),
        write("/cmd_vel", TWIST), read("/marker", "visualization_msgs/msg/Marker", task="Slow"), pins=True,
    )  # fmt: skip


@pytest.fixture(scope="module")
def root(made):
    return etree.fromstring(plcopen_xml(made))


def test_the_file_begins_as_an_xml_file_in_the_namespace_of_version_2_00(made, root):
    """Declaration, UTF-8 and the one namespace that CODESYS reads."""
    assert plcopen_xml(made).startswith(
        b'<?xml version="1.0" encoding="utf-8"?>\n<project xmlns="http://www.'
    )
    assert root.tag == f"{PLC}project"
    assert {etree.QName(e).namespace for e in root.iter()} == {PLC[1:-1], XHTML[1:-1]}


def test_children_stand_in_the_order_that_the_importer_wants(root):
    """An element in the wrong place makes the importer refuse the file, or lose it silently."""
    for element in root.iter():
        names = ORDER.get(local(element))
        if names is None or (local(element) == "interface" and local(element.getparent()) == "data"):
            continue
        places = [names.index(local(child)) for child in element]
        assert places == sorted(places), f"{local(element)} {element.get('name')}"


def test_no_configuration_is_invented(root):
    """A configuration of another name is refused, and everything in it with it."""
    assert [local(e) for e in root.find(f"{PLC}instances").iter()] == ["instances", "configurations"]


def test_every_data_block_names_what_codesys_knows(root):
    """Only names that are in real exports, each with the handling that it has there."""
    known = dict.fromkeys(
        ("projectinformation", "attributes", "method", "interfaceasplaintext", "pouinheritance", "globalvars",
         "accessmodifiers", "inputassignments", "libraries"),
        "implementation",
    )  # fmt: skip
    known |= {"objectid": "discard", "projectstructure": "discard"}
    for element in root.iter(f"{PLC}data"):
        kind = element.get("name").removeprefix(DATA)
        assert element.get("handleUnknown") == known[kind], kind


def test_duts_say_what_the_model_says(made, root):
    """Members with types and initial values, attributes, and the same declaration as text."""
    elements = root.findall(f"{PLC}types/{PLC}dataTypes/{PLC}dataType")
    assert [element.get("name") for element in elements] == [dut.name for dut in made.duts]
    for element, dut in zip(elements, made.duts, strict=True):
        if isinstance(dut, Enumeration):
            values = [(v.get("name"), int(v.get("value"))) for v in element.iter(f"{PLC}value")]
            assert values == list(dut.values)
        else:
            struct = element.find(f"{PLC}baseType/{PLC}struct")
            assert variables(struct) == [(m.name, m.type, m.initial, ()) for m in dut.members]
        attributes = [(a.get("Name"), a.get("Value")) for block in data(element, "attributes") for a in block]
        assert attributes == list(dut.attributes)
        (text,) = data(element, "interfaceasplaintext")
        assert plain(text) == declaration(dut)


def test_messages_have_the_pack_mode(made, root):
    """Every DUT that is mapped into shared memory says 8, whatever the device's default is."""
    for element in root.iter(f"{PLC}dataType"):
        if element.get("name") in ("RosPlc_YawPitchRoll", "RosPlc_Error"):
            continue  # never in shared memory
        (attributes,) = data(element, "attributes")
        assert [(a.get("Name"), a.get("Value")) for a in attributes] == [("pack_mode", "8")]


def test_pous_say_what_the_model_says(made, root):
    """Interface, body, base and the declaration as text, which is in addData behind the body."""
    elements = root.findall(f"{PLC}types/{PLC}pous/{PLC}pou")
    assert [element.get("name") for element in elements] == [pou.name for pou in made.pous]
    kinds = {"functionBlock": "FUNCTION_BLOCK", "function": "FUNCTION", "program": "PROGRAM"}
    for element, pou in zip(elements, made.pous, strict=True):
        assert kinds[element.get("pouType")] == pou.kind
        interface = element.find(f"{PLC}interface")
        check_interface(interface, pou.blocks, pou.return_type)
        bases = [block.findtext(f"{PLC}Extends") for block in data(interface, "pouinheritance")]
        assert bases == ([pou.extends] if pou.extends else [])
        assert plain(element.find(f"{PLC}body/{PLC}ST")) == pou.implementation
        (text,) = data(element, "interfaceasplaintext")
        assert plain(text) == declaration(pou)
        assert not data(interface, "interfaceasplaintext")


def test_methods_say_what_the_model_says(made, root):
    """Their text is a direct child behind the body: anywhere else the importer ignores it."""
    for pou in made.pous:
        (element,) = root.findall(f"{PLC}types/{PLC}pous/{PLC}pou[@name='{pou.name}']")
        methods = data(element, "method")
        assert [method.get("name") for method in methods] == [method.name for method in pou.methods]
        for found, method in zip(methods, pou.methods, strict=True):
            interface = found.find(f"{PLC}interface")
            check_interface(interface, method.blocks, method.return_type)
            assert plain(found.find(f"{PLC}body/{PLC}ST")) == method.implementation
            assert plain(found.find(f"{PLC}InterfaceAsPlainText")) == method_declaration(method)
            modifiers = [dict(block.attrib) for block in data(interface, "accessmodifiers")]
            expected = [] if method.access == "PUBLIC" else [{method.access.capitalize(): "true"}]
            assert modifiers == expected
            assert local(found[-1]) == "addData"
            assert len(found[-1]) == 0


def test_variable_lists_stand_in_the_projects_own_data(made, root):
    """An import below an application takes them from there and from nowhere else."""
    lists = data(root, "globalvars")
    assert [element.get("name") for element in lists] == [gvl.name for gvl in made.gvls]
    assert len(root.findall(f".//{PLC}globalVars")) == len(lists)
    for element, gvl in zip(lists, made.gvls, strict=True):
        (block,) = gvl.blocks
        assert variables(element) == [(v.name, v.type, v.initial, v.arguments) for v in block.variables]
        assert (element.get("constant") == "true") is block.constant
        attributes = [(a.get("Name"), a.get("Value")) for entry in data(element, "attributes") for a in entry]
        assert attributes == list(gvl.attributes)
        (text,) = data(element, "interfaceasplaintext")
        assert plain(text) == declaration(gvl)


def test_arguments_of_instances_are_assignments(root):
    """The compiler takes an instance's FB_Init arguments from there, not from the text."""
    (gvl,) = (element for element in data(root, "globalvars") if element.get("name") == "ROS_Read")
    arguments = {name: given for name, _, _, given in variables(gvl)}
    assert arguments["pose"] == (("sTopic", "'/pose'"),)
    assert arguments["_type"] == (("sTopic", "'/type'"),)


def test_libraries_are_placeholders(root):
    """As an export lists a placeholder: the device or the project decides on the version."""
    (libraries,) = data(root, "libraries")
    names = ("SysShm", "SysMem", "SysTypes2 Interfaces")
    assert [entry.get("Name") for entry in libraries] == [f"#{name}" for name in names]
    assert [entry.get("DefaultResolution") for entry in libraries] == [f"{n}, * (System)" for n in names]
    assert [entry.get("Namespace") for entry in libraries] == ["SysShm", "SysMem", "SysTypes"]
    attributes = {
        "Name", "Namespace", "HideWhenReferencedAsDependency", "PublishSymbolsInContainer", "SystemLibrary",
        "LinkAllContent", "DefaultResolution",
    }  # fmt: skip
    assert all(set(entry.attrib) == attributes for entry in libraries)


def test_object_ids_are_unique_and_the_folders_name_them(made, root):
    """Each object and method has an id of its own, and stands once in the project's folders."""
    ids = [element.text for element in root.iter(f"{PLC}ObjectId")]
    ids += [element.get("ObjectId") for element in root.iter(f"{PLC}Method")]
    assert len(set(ids)) == len(ids)
    assert all(re.fullmatch(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", text) for text in ids)
    (structure,) = data(root, "projectstructure")
    places = {}
    for element in structure.iter(f"{PLC}Object"):
        above = [e.get("Name") for e in element.iterancestors() if local(e) in ("Folder", "Object")]
        places[element.get("ObjectId")] = "/".join([*reversed(above), element.get("Name")])
    assert sorted(places) == sorted(ids)
    expected = {f"{item.folder}/{item.name}" for item in (*made.duts, *made.gvls, *made.pous)}
    expected |= {f"{p.folder}/{p.name}/{m.name}" for p in made.pous for m in p.methods if isinstance(p, Pou)}
    assert set(places.values()) == expected


def test_ids_stay_when_the_project_grows(made, root):
    """A second import meets the objects of the first one again."""
    small = etree.fromstring(plcopen_xml(project(read("/pose"))))

    def ids(tree):
        (structure,) = data(tree, "projectstructure")
        return {
            e.get("Name"): e.get("ObjectId")
            for e in structure.iter(f"{PLC}Object")
            if e.getparent() is not None
        }

    before = {name: value for name, value in ids(small).items() if name.startswith("geometry_msgs")}
    assert before.items() <= ids(root).items()


def test_texts_survive_the_way_through_xml(tmp_path):
    """Quotes, ampersands, comparison signs and commas inside strings come back as they were."""
    lines = (
        r"""string NAME="<a> & 'b', \"c\"" """.rstrip(),
        r"""string[<=4] words ["a,b", "[x]", "3(y)", "d'e"]""",
        "int32[] many [1, 2]",
    )
    text = "\n".join(lines) + "\n"
    store = custom(tmp_path, Text=text)
    made = build_type_library(store, [layout("cell_msgs/msg/Text", store=store)])
    tree = etree.fromstring(plcopen_xml(made))
    dut = next(dut for dut in made.duts if dut.name == "cell_msgs_Text")
    (element,) = tree.findall(f".//{PLC}dataType[@name='cell_msgs_Text']")
    struct = element.find(f"{PLC}baseType/{PLC}struct")
    assert variables(struct) == [(m.name, m.type, m.initial, ()) for m in dut.members]
    assert {"words", "many"} <= {v.name for v in dut.members}


@needs_schema
@pytest.mark.parametrize("distro", DISTROS)
def test_every_type_of_a_distribution_validates_against_the_schema(distro):
    """With pins and without, against PLCopen's own schema for version 2.00."""
    path = os.environ["ROSPLC_PLCOPEN_XSD"]
    schema = etree.XMLSchema(etree.parse(Path(path)))
    store = TypeStore.bundled(distro)
    layouts = [layout(name, store=store) for name in store.names()]
    for pins in (False, True):
        schema.assertValid(
            etree.fromstring(plcopen_xml(build_type_library(store, layouts, ProjectOptions(pins=pins))))
        )


@needs_schema
def test_a_project_validates_against_the_schema(made):
    """Programs, variable lists with instances and all."""
    path = os.environ["ROSPLC_PLCOPEN_XSD"]
    etree.XMLSchema(etree.parse(Path(path))).assertValid(etree.fromstring(plcopen_xml(made)))


def test_every_bundled_type_can_be_written():
    """The largest project there is has every object once."""
    made = build_type_library(STORE, [layout(name) for name in STORE.names()])
    tree = etree.fromstring(plcopen_xml(made))
    assert len(tree.findall(f".//{PLC}dataType")) == len(made.duts)
    assert len(tree.findall(f".//{PLC}pou")) == len(made.pous)


def test_variables_without_a_section_are_an_error():
    """A kind of variables that the writer does not know is not left out silently."""
    variables_ = VarBlock("VAR_IN_OUT CONSTANT", (Variable("x", "STRING(80)"),))
    with pytest.raises(ValueError, match="VAR_IN_OUT CONSTANT"):
        plcopen_xml(PlcProject("ROS", pous=(Pou("F", "FUNCTION", (variables_,), "", return_type="BOOL"),)))
