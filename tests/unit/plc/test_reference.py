"""Each function block has a page, with the inputs and outputs of the code that is generated."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.config import parse_config, resolve
from rosplc.plc.build import plc_project
from rosplc.plc.plan import ProjectOptions
from rosplc.plc.project import project_texts

ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"
PAGES = {path.stem: path for path in (DOCS / "reference/blocks").glob("*.md") if path.stem != "README"}
TEMPLATES = ROOT / "src/rosplc/plc/templates"
CONFIGURATION = """
topics:
  /a: {type: sensor_msgs/msg/Joy, to: plc}
  /b: {type: sensor_msgs/msg/Joy, to: ros}
  /c: {type: sensor_msgs/msg/Joy, to: plc, classic: {name: c}}
  /d: {type: sensor_msgs/msg/Joy, to: ros, classic: {name: d}}
services:
  /e: {type: std_srvs/srv/SetBool, server: ros}
  /f: {type: std_srvs/srv/SetBool, server: plc}
actions:
  /g: {type: tf2_msgs/action/LookupTransform, server: ros}
  /h: {type: tf2_msgs/action/LookupTransform, server: plc}
rosout: {plc: true}
time: {plc: true}
transforms: {tool: {target: base, source: tool}}
parameters: {declare: {limit: {type: double, value: 1}}}
"""
CODE = project_texts(plc_project(resolve(parse_config(CONFIGURATION)), ProjectOptions()))
HEAD = re.compile(r"^FUNCTION_BLOCK (?:ABSTRACT )?(\w+)(?: EXTENDS (\w+))?$", re.MULTILINE)
PIN = re.compile(r"    (\w+) : (.+?)(?: := (.+?))?;(?: // (.*))?")
INNER = ("RosPlc_CallReader", "RosPlc_CallWriter")
"""What the blocks extend that exist only inside the blocks of services and actions."""


def _key(name: str) -> str:
    return name if name.startswith("RosPlc_") else name.rpartition("_")[2]


BLOCKS = sorted(name for name, text in CODE.items() if (head := HEAD.search(text)) and head[2] not in INNER)


def pins(name: str, kind: str) -> Iterator[tuple[str, ...]]:
    """Yield name, type with initial value, and meaning, as a compiler reads them, inherited ones first."""
    text = CODE[name].partition("END_FUNCTION_BLOCK")[0]
    head = HEAD.search(text)
    assert head is not None
    if head[2]:
        yield from pins(head[2], kind)
    for block in re.findall(rf"^{kind}\n(.*?)^END_VAR$", text, re.MULTILINE | re.DOTALL):
        for line in block.splitlines():
            found = PIN.fullmatch(line)
            assert found is not None, line
            variable, type_, initial, meaning = found.groups()
            yield variable, f"{type_} := {initial}" if initial else type_, meaning or ""


def rows(page: str, title: str) -> Iterator[tuple[str, ...]]:
    """Yield the same from a page, without the marks for code and links."""
    for heading in (f"Inherited {title.lower()}", title):
        _, _, rest = page.partition(f"\n## {heading}\n\n")
        for line in rest.partition("\n\n")[0].splitlines()[2:]:
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            plain = (re.sub(r"\[(.*?)\]\(.*?\)", r"\1", cell).replace("\\|", "|") for cell in cells[:2])
            yield *(cell.replace("`", "") for cell in plain), cells[2].replace("\\|", "|")


@pytest.mark.parametrize("name", BLOCKS)
def test_a_page_has_the_inputs_and_outputs_of_its_block(name):
    """Name, type, initial value and meaning; a type of the user's is described."""
    page = PAGES[_key(name)].read_text(encoding="utf-8")
    picture = (DOCS / f"images/blocks/{_key(name)}.svg").read_text(encoding="utf-8")
    assert f"images/blocks/{_key(name)}.svg)" in page
    for kind, title, side, outside in (
        ("VAR_INPUT", "Inputs", "left", "right"),
        ("VAR_OUTPUT", "Outputs", "right", "left"),
    ):
        expected, shown = list(pins(name, kind)), list(rows(page, title))
        drawn, types = (
            re.findall(rf'class="pin {place}">(.*?)<', picture) for place in (side, f"dim {outside}")
        )
        assert [pin[0] for pin in shown] == [pin[0] for pin in expected] == drawn
        for pin, cells, drawn_type in zip(expected, shown, types, strict=True):
            if re.fullmatch("the (message|service|action)'s type", cells[1]):
                assert f"TYPE {pin[1]} :\nSTRUCT" in CODE[pin[1]] and drawn_type == f"‹{cells[1][4:-7]}›"
                assert cells[::2] == pin[::2]
            else:
                assert cells == pin and pin[1].partition(" := ")[0].endswith(drawn_type.removeprefix("…"))
            assert pin[2] or pin[0].endswith("Hi"), f"{pin[0]} has no meaning"


def test_each_block_has_a_page_that_is_listed():
    """Every block of the generated code and of the templates, and no page without a block."""
    templates = {
        path.stem
        for path in TEMPLATES.glob("*/*.st")
        if path.parent.name != "openplc" and re.search("^FUNCTION_BLOCK ", path.read_text(), re.M)
    }
    assert set(PAGES) == {_key(name) for name in BLOCKS} == templates
    listed = re.findall(
        r"^\| \[.*?\]\((\w+)\.md\) \|", (DOCS / "reference/blocks/README.md").read_text(), re.M
    )
    assert sorted(listed) == sorted(PAGES)
