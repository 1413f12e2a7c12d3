"""Whether generated PLC code says what its model says, and nothing that a name has smuggled in.

Structured Text is cut into tokens, XML and the import script are parsed, and what is in them is
compared with the project: a name or a text that became syntax shows as one statement, one element or
one object too many.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import PurePosixPath
from xml.etree import ElementTree

from rosplc.layout import Layout
from rosplc.plc.delivery import project_files
from rosplc.plc.names import is_reserved
from rosplc.plc.project import (
    Dut,
    Enumeration,
    Gvl,
    Item,
    PlcProject,
    Pou,
    Variable,
    declaration,
    object_text,
)

__all__ = ["check_project", "tokens"]

_TOKEN = re.compile(
    r"(?P<comment>//[^\n]*|\(\*.*?\*\))|(?P<pragma>\{[^{}]*\})|(?P<string>'(?:[^'$]|\$.)*')"
    r"|(?P<word>[A-Za-z_][A-Za-z0-9_]*)|(?P<number>[0-9][A-Za-z0-9_.#]*(?:E[+-]?[0-9]+)?)"
    r"|(?P<sign>:=|=>|\.\.|<>|<=|>=|\*\*|[-+*/:;,.()\[\]<>=#^&])|(?P<space>[ \t\n]+)",
    re.DOTALL,
)
_IDENTIFIER = re.compile(r"(?:[A-Za-z]|_(?=[A-Za-z0-9]))(?:_?[A-Za-z0-9])*\Z")
_STRUCTURE = re.compile(r"(?:END_)?(?:TYPE|STRUCT|VAR\w*|FUNCTION_BLOCK|FUNCTION|PROGRAM|METHOD)\Z")
_C_LINE = re.compile(
    r"(?:/\* [\w/ ().,;:-]* \*/|typedef struct \w+ \{|    \w+ \w+(?:\[\d+\])*;|\} \w+;|#\w+.*|"
    r"ROSPLC_ASSERT\([\w() ,<>=]+\);|)\Z"
)


def tokens(text: str) -> Iterator[tuple[str, str]]:
    """Yield kind and text of each token but spaces and comments.

    Raises:
        AssertionError: Something is no token of Structured Text.
    """
    at = 0
    while at < len(text):
        found = _TOKEN.match(text, at)
        assert found is not None, f"no token: {text[at : at + 40]!r}"
        at = found.end()
        if found.lastgroup not in ("space", "comment", "pragma"):
            yield str(found.lastgroup), found[0]


def check_project(project: PlcProject, layouts: list[Layout]) -> None:
    """Look at every delivery of a project.

    Raises:
        AssertionError: One of them says something else than the project.
    """
    project = _generated_part(project)
    delivered = project_files(project, layouts, "rosplc")
    for path in delivered:
        parts = PurePosixPath(path).parts
        assert ".." not in parts
        assert not path.startswith("/")
        assert len(path) < 240
        assert all(part.isascii() and part.isprintable() for part in parts), path
    for item in project.items:
        _check_names(item)
        _check_text(item)
    _check_xml(delivered["rosplc.xml"], project)
    _check_script(delivered["rosplc_import.py"].decode("ascii"), project)
    _check_c(delivered["rosplc.h"].decode("ascii"))


def _generated_part(project: PlcProject) -> PlcProject:
    """Leave out the blocks that are written by hand: they are the same each time, and long."""
    return replace(
        project,
        duts=tuple(item for item in project.duts if not _written_by_hand(item.name)),
        gvls=tuple(item for item in project.gvls if not _written_by_hand(item.name)),
        pous=tuple(item for item in project.pous if not _written_by_hand(item.name)),
    )


def _written_by_hand(name: str) -> bool:
    return name.startswith("RosPlc_") and name not in ("RosPlc_Settings", "RosPlc_Header_2")


def _variables(item: Item) -> Sequence[Variable]:
    if isinstance(item, Dut):
        return item.members
    assert not isinstance(item, Enumeration)  # the only one is written by hand
    return [variable for block in item.blocks for variable in block.variables]


def _check_names(item: Item) -> None:
    names = [item.name, *(variable.name for variable in _variables(item))]
    assert all(_IDENTIFIER.match(name) and not is_reserved(name) for name in names), names
    assert len({name.upper() for name in names[1:]}) == len(names) - 1, names


def _check_text(item: Item) -> None:
    """Each variable is one statement of the declaration, and nothing else is a structure's begin or end."""
    text = object_text(item)
    assert text.isascii()
    assert text.replace("\n", "").isprintable()
    words = [word for kind, word in tokens(text) if kind == "word" and _STRUCTURE.match(word)]
    if isinstance(item, Dut):
        assert words == ["TYPE", "STRUCT", "END_STRUCT", "END_TYPE"], words
    elif isinstance(item, Gvl):
        ends = words.count("END_VAR")
        assert words == ["VAR_GLOBAL", "END_VAR"] * ends
        assert ends == sum(1 for block in item.blocks if block.variables)
    elif isinstance(item, Pou):
        assert words.count(f"END_{item.kind}") == 1
        assert words.count("END_METHOD") == words.count("METHOD") == len(item.methods)
    if not isinstance(item, Dut | Gvl):
        return
    assert [statement[:2] for statement in _statements(item)] == [
        [("word", variable.name), ("sign", ":")] for variable in _variables(item)
    ]


def _statements(item: Dut | Gvl) -> list[list[tuple[str, str]]]:
    """Return the tokens of each declared variable."""
    found = list(tokens(declaration(item)))
    if isinstance(item, Dut):
        assert found[:4] == [("word", "TYPE"), ("word", item.name), ("sign", ":"), ("word", "STRUCT")]
        found = found[4:-2]
    frame = ("VAR_GLOBAL", "CONSTANT", "END_VAR") if isinstance(item, Gvl) else ()
    statements: list[list[tuple[str, str]]] = [[]]
    for token in found:
        if token == ("sign", ";"):
            statements.append([])
        elif token[1] not in frame:
            statements[-1].append(token)
    assert not statements.pop()
    return statements


def _check_xml(data: bytes, project: PlcProject) -> None:
    root = ElementTree.fromstring(data)
    space = "{http://www.plcopen.org/xml/tc6_0200}"
    assert [element.get("name") for element in root.iter(f"{space}dataType")] == [
        d.name for d in project.duts
    ]
    assert [element.get("name") for element in root.iter(f"{space}pou")] == [p.name for p in project.pous]
    texts = {element.text or "" for element in root.iter("{http://www.w3.org/1999/xhtml}xhtml")}
    for item in project.items:
        assert declaration(item) in texts, item.name


@cache
def _program() -> str:
    return files("rosplc.plc").joinpath("templates/import_script.py.txt").read_text(encoding="ascii")


def _check_script(text: str, project: PlcProject) -> None:
    """Behind the program are six statements: five lists of literals, and its start."""
    assert text.startswith(_program())
    *lists, start = ast.parse(text.removeprefix(_program())).body
    assert ast.unparse(start) == "main()"
    values = {}
    for statement in lists:
        assert isinstance(statement, ast.Assign)
        values[ast.unparse(statement.targets[0])] = ast.literal_eval(statement.value)
    assert list(values) == ["PROGRAMS", "LIBRARIES", "NOTES", "TASKS", "OBJECTS"]
    assert values["NOTES"] == list(project.notes)
    assert [task["name"] for task in values["TASKS"]] == [task.task.name for task in project.tasks]
    items = project.items
    assert [one["name"] for one in values["OBJECTS"]] == [item.name for item in items]
    assert [one["declaration"] for one in values["OBJECTS"]] == [declaration(item) for item in items]


def _check_c(text: str) -> None:
    """Every line is of one of the forms that the header has."""
    body = text.split("sizeof(double) == 8);\n", 1)[1]
    for line in body.splitlines():
        assert _C_LINE.match(line), line
