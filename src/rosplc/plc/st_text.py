"""Render objects of the project model as Structured Text.

Two forms: the whole text of an object, as it stands in a ``.st`` file, and the split into
declaration and implementation that CODESYS keeps (there the ``END_…`` lines of blocks and
methods are left out).
"""

from __future__ import annotations

from collections.abc import Iterable

from rosplc.plc.project import Dut, Enumeration, Gvl, Item, Method, PlcProject, Pou, VarBlock, Variable

__all__ = ["declaration", "method_declaration", "object_text", "project_texts"]


def _comment(text: str) -> list[str]:
    return [f"// {line}".rstrip() for line in text.splitlines()]


def _attributes(attributes: Iterable[tuple[str, str]]) -> list[str]:
    return [
        f"{{attribute '{name}' := '{value}'}}" if value else f"{{attribute '{name}'}}"
        for name, value in attributes
    ]


def _variable(variable: Variable) -> str:
    arguments = ""
    if variable.arguments:
        arguments = "(" + ", ".join(value for _, value in variable.arguments) + ")"
    initial = f" := {variable.initial}" if variable.initial is not None else ""
    comment = f" // {variable.comment}" if variable.comment else ""
    return f"    {variable.name} : {variable.type}{arguments}{initial};{comment}"


def _blocks(blocks: Iterable[VarBlock]) -> list[str]:
    lines: list[str] = []
    for block in blocks:
        if not block.variables:
            continue
        lines.append(f"{block.kind} CONSTANT" if block.constant else block.kind)
        lines.extend(_variable(variable) for variable in block.variables)
        lines.append("END_VAR")
    return lines


def declaration(item: Item) -> str:
    """Return the declaration part as CODESYS keeps it, ending with a line feed."""
    lines = [*_comment(item.comment), *_attributes(item.attributes)]
    if isinstance(item, Dut):
        lines += [f"TYPE {item.name} :", "STRUCT", *map(_variable, item.members), "END_STRUCT", "END_TYPE"]
    elif isinstance(item, Enumeration):
        values = [f"    {name} := {value}" for name, value in item.values]
        lines += [f"TYPE {item.name} :", "(", ",\n".join(values), f") {item.base};", "END_TYPE"]
    elif isinstance(item, Gvl):
        lines += _blocks(item.blocks)
    else:
        head = item.kind + (" ABSTRACT" if item.abstract else "") + f" {item.name}"
        if item.extends:
            head += f" EXTENDS {item.extends}"
        if item.return_type:
            head += f" : {item.return_type}"
        lines += [head, *_blocks(item.blocks)]
    return "\n".join(lines) + "\n"


def method_declaration(method: Method) -> str:
    """Return a method's declaration part as CODESYS keeps it, ending with a line feed."""
    head = f"METHOD {method.access} {method.name}"
    if method.return_type:
        head += f" : {method.return_type}"
    return "\n".join([*_comment(method.comment), head, *_blocks(method.blocks)]) + "\n"


def object_text(item: Item) -> str:
    """Return the whole text of an object, as a ``.st`` file holds it."""
    text = declaration(item)
    if not isinstance(item, Pou):
        return text
    parts = [text + _body(item.implementation) + f"END_{item.kind}\n"]
    parts += [method_declaration(m) + _body(m.implementation) + "END_METHOD\n" for m in item.methods]
    return "\n".join(parts)


def _body(text: str) -> str:
    return f"{text}\n" if text else ""


def project_texts(project: PlcProject) -> dict[str, str]:
    """Return the whole text of every object by its name, in the order of the project."""
    return {item.name: object_text(item) for item in project.items}
