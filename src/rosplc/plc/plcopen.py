"""Write a project as PLCopenXML (TC6, version 2.00) as CODESYS exports and imports it.

Each object contains its declaration twice, from the same model: structured, as in the schema,
and as plain text in ``addData``, which keeps comments, attributes and arguments of
``FB_Init``. The form follows exports of CODESYS V3.5 SP15 and SP21. The importer creates no
tasks, so the file has none: the script creates them, or the technician by hand.
"""

from __future__ import annotations

import re
import uuid
from collections.abc import Iterable, Iterator, Sequence
from xml.etree import ElementTree as ET

from rosplc._version import __version__
from rosplc.plc.names import IEC_TYPES
from rosplc.plc.project import (
    Dut,
    Enumeration,
    Gvl,
    Item,
    Method,
    PlcProject,
    Pou,
    VarBlock,
    Variable,
    declaration,
    method_declaration,
)

_NAMESPACE = "http://www.plcopen.org/xml/tc6_0200"
_XHTML = "http://www.w3.org/1999/xhtml"
_DATA = "http://www.3s-software.com/plcopenxml"
_WHEN = "2000-01-01T00:00:00"  # the file depends on its input alone, not on the day

LIBRARY_NAMESPACES = {"SysTypes2 Interfaces": "SysTypes"}  # namespaces that are not the library's name
_ELEMENTARY = frozenset({*IEC_TYPES.values(), "WORD", "DWORD", "LWORD", "TIME", "DATE", "DT", "TOD"})
_NOT_SET = (
    "HideWhenReferencedAsDependency", "PublishSymbolsInContainer", "SystemLibrary", "LinkAllContent",
)  # fmt: skip
_POU_TYPES = {"FUNCTION_BLOCK": "functionBlock", "FUNCTION": "function", "PROGRAM": "program"}
_SECTIONS = {
    "VAR_INPUT": "inputVars",
    "VAR_OUTPUT": "outputVars",
    "VAR_IN_OUT": "inOutVars",
    "VAR": "localVars",
    "VAR_TEMP": "tempVars",
}
_ARRAY = re.compile(r"ARRAY\[(?P<lower>[^.\]]+)\.\.(?P<upper>[^\]]+)\] OF (?P<element>.+)\Z")
_STRING = re.compile(r"STRING\((?P<length>\d+)\)\Z")


def plcopen_xml(project: PlcProject) -> bytes:
    """Return the file's bytes; the same project always gives the same bytes."""
    root = ET.Element("project", {"xmlns": _NAMESPACE})
    _header(root, project.name)
    types = ET.SubElement(root, "types")
    data_types = ET.SubElement(types, "dataTypes")
    for dut in project.duts:
        _data_type(data_types, dut)
    pous = ET.SubElement(types, "pous")
    for pou in project.pous:
        _pou(pous, pou)
    ET.SubElement(ET.SubElement(root, "instances"), "configurations")
    extra = ET.SubElement(root, "addData")
    for gvl in project.gvls:
        _gvl(_data(extra, "globalvars"), gvl)
    _libraries(extra, project)
    _structure(extra, project)
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=False)
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + text + b"\n"


def _header(root: ET.Element, name: str) -> None:
    product = {"companyName": "", "productName": "rosplc", "productVersion": __version__}
    ET.SubElement(root, "fileHeader", product, creationDateTime=_WHEN)
    content = ET.SubElement(root, "contentHeader", name=name, modificationDateTime=_WHEN)
    coordinates = ET.SubElement(content, "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        ET.SubElement(ET.SubElement(coordinates, language), "scaling", x="1", y="1")
    ET.SubElement(_data(ET.SubElement(content, "addData"), "projectinformation"), "ProjectInformation")


def _data(parent: ET.Element, name: str, unknown: str = "implementation") -> ET.Element:
    return ET.SubElement(parent, "data", name=f"{_DATA}/{name}", handleUnknown=unknown)


def _xhtml(parent: ET.Element, text: str) -> None:
    ET.SubElement(parent, "xhtml", {"xmlns": _XHTML}).text = text or None


def _documentation(parent: ET.Element, text: str) -> None:
    if text:
        _xhtml(ET.SubElement(parent, "documentation"), text)


def _identify(extra: ET.Element, item: Item) -> None:
    _plain_text(_data(extra, "interfaceasplaintext"), declaration(item))
    ET.SubElement(_data(extra, "objectid", "discard"), "ObjectId").text = _identity(item.name)


def _identity(name: str) -> str:
    """Return the object's id, derived from its name, so that a repeated import finds the object."""
    return str(uuid.uuid5(uuid.NAMESPACE_URL, f"rosplc:plc:{name}"))


def _type(parent: ET.Element, text: str) -> None:
    """Append the element for a type given as Structured Text."""
    if match := _ARRAY.match(text):
        array = ET.SubElement(parent, "array")
        ET.SubElement(array, "dimension", lower=match["lower"], upper=match["upper"])
        _type(ET.SubElement(array, "baseType"), match["element"])
    elif match := _STRING.match(text):
        ET.SubElement(parent, "string", length=match["length"])
    elif text.startswith("POINTER TO "):
        _type(ET.SubElement(ET.SubElement(parent, "pointer"), "baseType"), text.removeprefix("POINTER TO "))
    elif text in _ELEMENTARY:
        ET.SubElement(parent, text)
    else:
        ET.SubElement(parent, "derived", name=text)


def _variable(parent: ET.Element, variable: Variable) -> None:
    element = ET.SubElement(parent, "variable", name=variable.name)
    _type(ET.SubElement(element, "type"), variable.type)
    if variable.initial is not None:
        _initial(ET.SubElement(element, "initialValue"), variable.initial)
    if variable.arguments:
        data = _data(ET.SubElement(element, "addData"), "inputassignments")
        assignments = ET.SubElement(data, "InputAssignments")
        for name, value in variable.arguments:
            assignment = ET.SubElement(assignments, "InputAssignment")
            ET.SubElement(assignment, "Name").text = name
            ET.SubElement(assignment, "Value").text = value
    _documentation(element, f" {variable.comment}" if variable.comment else "")


def _initial(parent: ET.Element, text: str) -> None:
    """Append the element for an initial value given as Structured Text."""
    if text.startswith("["):
        array = ET.SubElement(parent, "arrayValue")
        for item in _items(text[1:-1]):
            match = re.fullmatch(r"(\d+)\((.*)\)", item)
            attributes = {"repetitionValue": match[1]} if match else {}
            _initial(ET.SubElement(array, "value", attributes), match[2] if match else item)
    elif text.startswith("("):
        struct = ET.SubElement(parent, "structValue")
        for item in _items(text[1:-1]):
            member, _, value = item.partition(" := ")
            _initial(ET.SubElement(struct, "value", member=member), value)
    else:
        ET.SubElement(parent, "simpleValue", value=text)


def _items(text: str) -> Iterator[str]:
    """Yield the items between commas; strings, arrays and structures may contain commas."""
    start = depth = 0
    for match in re.finditer(r"'(?:[^'$]|\$.)*'|[][(),]", text):
        if match[0] in ("(", "["):
            depth += 1
        elif match[0] in (")", "]"):
            depth -= 1
        elif match[0] == "," and not depth:
            yield text[start : match.start()].strip()
            start = match.end()
    yield text[start:].strip()


def _attributes(extra: ET.Element, attributes: Iterable[tuple[str, str]]) -> None:
    pairs = list(attributes)
    if pairs:
        element = ET.SubElement(_data(extra, "attributes"), "Attributes")
        for name, value in pairs:
            ET.SubElement(element, "Attribute", Name=name, Value=value)


def _data_type(parent: ET.Element, dut: Dut | Enumeration) -> None:
    element = ET.SubElement(parent, "dataType", name=dut.name)
    base = ET.SubElement(element, "baseType")
    if isinstance(dut, Enumeration):
        enum = ET.SubElement(base, "enum")
        values = ET.SubElement(enum, "values")
        for name, value in dut.values:
            ET.SubElement(values, "value", name=name, value=str(value))
        _type(ET.SubElement(enum, "baseType"), dut.base)
    else:
        struct = ET.SubElement(base, "struct")
        for member in dut.members:
            _variable(struct, member)
    extra = ET.SubElement(element, "addData")
    _attributes(extra, dut.attributes)
    _identify(extra, dut)
    _documentation(element, dut.comment)


def _plain_text(parent: ET.Element, text: str) -> None:
    _xhtml(ET.SubElement(parent, "InterfaceAsPlainText"), text)


def _interface(parent: ET.Element, blocks: Sequence[VarBlock], return_type: str | None) -> ET.Element:
    for block in blocks:
        if block.kind not in _SECTIONS:  # nothing may get lost silently
            raise ValueError(f"PLCopenXML has no section for {block.kind}")
    interface = ET.SubElement(parent, "interface")
    if return_type:
        _type(ET.SubElement(interface, "returnType"), return_type)
    for section, tag in _SECTIONS.items():
        for block in blocks:
            if block.kind == section and block.variables:
                element = ET.SubElement(interface, tag, {"constant": "true"} if block.constant else {})
                for variable in block.variables:
                    _variable(element, variable)
    return interface


def _body(parent: ET.Element, text: str) -> None:
    _xhtml(ET.SubElement(ET.SubElement(parent, "body"), "ST"), text)


def _pou(parent: ET.Element, pou: Pou) -> None:
    element = ET.SubElement(parent, "pou", name=pou.name, pouType=_POU_TYPES[pou.kind])
    interface = _interface(element, pou.blocks, pou.return_type)
    # ABSTRACT is in the plain text alone: no export at hand shows another place for it.
    if pou.extends or pou.attributes:
        extra = ET.SubElement(interface, "addData")
        if pou.extends:
            inheritance = ET.SubElement(_data(extra, "pouinheritance"), "Inheritance")
            ET.SubElement(inheritance, "Extends").text = pou.extends
        _attributes(extra, pou.attributes)
    _documentation(interface, pou.comment)
    _body(element, pou.implementation)
    extra = ET.SubElement(element, "addData")
    for method in pou.methods:
        _method(_data(extra, "method"), pou, method)
    _identify(extra, pou)


def _method(parent: ET.Element, pou: Pou, method: Method) -> None:
    identity = _identity(f"{pou.name}.{method.name}")
    element = ET.SubElement(parent, "Method", name=method.name, ObjectId=identity)
    interface = _interface(element, method.blocks, method.return_type)
    if method.access != "PUBLIC":
        extra = _data(ET.SubElement(interface, "addData"), "accessmodifiers")
        ET.SubElement(extra, "AccessModifiers", {method.access.capitalize(): "true"})
    _documentation(interface, method.comment)
    _body(element, method.implementation)
    # Anywhere else in a Method the importer ignores the text.
    _plain_text(element, method_declaration(method))
    ET.SubElement(element, "addData")


def _gvl(parent: ET.Element, gvl: Gvl) -> None:
    for index, block in enumerate(gvl.blocks):
        attributes = {"constant": "true"} if block.constant else {}
        element = ET.SubElement(parent, "globalVars", {"name": gvl.name, **attributes})
        for variable in block.variables:
            _variable(element, variable)
        if index == 0:
            extra = ET.SubElement(element, "addData")
            _attributes(extra, gvl.attributes)
            _identify(extra, gvl)
        _documentation(element, gvl.comment if index == 0 else "")


def _libraries(extra: ET.Element, project: PlcProject) -> None:
    if not project.libraries:
        return
    element = ET.SubElement(_data(extra, "libraries"), "Libraries")
    for library in project.libraries:
        names = {"Name": f"#{library}", "Namespace": LIBRARY_NAMESPACES.get(library, library)}
        resolution = {"DefaultResolution": f"{library}, * (System)"}
        ET.SubElement(element, "Library", {**names, **dict.fromkeys(_NOT_SET, "false"), **resolution})


def _structure(extra: ET.Element, project: PlcProject) -> None:
    """Append the folders, which the importer may ignore."""
    root = ET.SubElement(_data(extra, "projectstructure", "discard"), "ProjectStructure")
    folders: dict[str, ET.Element] = {"": root}

    def folder(path: str) -> ET.Element:
        if path not in folders:
            above, _, name = path.rpartition("/")
            folders[path] = ET.SubElement(folder(above), "Folder", Name=name)
        return folders[path]

    for item in project.items:
        element = ET.SubElement(folder(item.folder), "Object", Name=item.name, ObjectId=_identity(item.name))
        if isinstance(item, Pou):
            for method in item.methods:
                identity = _identity(f"{item.name}.{method.name}")
                ET.SubElement(element, "Object", Name=method.name, ObjectId=identity)
