"""Write the script (IronPython 2.7, so plain ASCII Python 2.7) that builds the project in the CODESYS IDE.

It is a hand-written program, ``templates/import_script.py.txt``, with the project's objects as literals.
"""

from __future__ import annotations

from importlib.resources import files

from rosplc.plc.build import SAFE_GVL
from rosplc.plc.project import Dut, Enumeration, Gvl, Item, PlcProject, Pou, declaration, method_declaration

_KINDS = {Dut: "DUT", Enumeration: "ENUM", Gvl: "GVL"}


def import_script(project: PlcProject) -> str:
    """Return the script's text; the same project always gives the same text."""
    program = files("rosplc.plc").joinpath("templates/import_script.py.txt").read_text(encoding="ascii")
    lines = [
        program,
        f"PROGRAMS = ({_text(f'{project.programs}_Read')}, {_text(f'{project.programs}_Write')})",
        f"LIBRARIES = [{', '.join(_text(name) for name in project.libraries)}]",
        "NOTES = [",
        *(f"    {_text(note)}," for note in project.notes),
        "]",
        "TASKS = [",
    ]
    for task, programs in project.tasks:
        cyclic = task.kind == "cyclic"
        interval_us = task.interval_ns // 1000 if cyclic else 0
        lines += [
            "    {",
            f"        'name': {_text(task.name)}, 'cyclic': {cyclic},",
            f"        'interval_us': {interval_us}, 'priority': {task.priority},",
            f"        'watchdog_us': {task.watchdog_ns // 1000}, 'sensitivity': {task.watchdog_sensitivity},",
            f"        'programs': [{', '.join(_text(name) for name in programs)}],",
            "    },",
        ]
    lines += ["]", "OBJECTS = ["]
    for item in project.items:
        lines += _object(item)
    lines += ["]", "", "main()", ""]
    return "\n".join(lines)


def _object(item: Item) -> list[str]:
    # Variables whose start values the compiler would keep: arguments of FB_Init, and the safe messages.
    instances = isinstance(item, Gvl) and (
        item.name == SAFE_GVL or any(v.arguments for block in item.blocks for v in block.variables)
    )
    kind = item.kind if isinstance(item, Pou) else _KINDS[type(item)]
    lines = [
        "    {",
        f"        'kind': {_text(kind)}, 'name': {_text(item.name)}, 'folder': {_text(item.folder)},",
        f"        'instances': {instances},",
    ]
    if isinstance(item, Pou):
        lines.append(
            f"        'base': {_text(item.extends or '')}, 'returns': {_text(item.return_type or '')},"
        )
        lines += _long("        ", "implementation", item.implementation)
    else:
        lines.append("        'base': '', 'returns': '', 'implementation': None,")
    lines += _long("        ", "declaration", declaration(item))
    lines.append("        'methods': [")
    for method in item.methods if isinstance(item, Pou) else ():
        lines.append("            {")
        lines.append(
            f"                'name': {_text(method.name)}, 'returns': {_text(method.return_type or '')},"
        )
        lines += _long("                ", "declaration", method_declaration(method))
        lines += _long("                ", "implementation", method.implementation)
        lines.append("            },")
    lines += ["        ],", "    },"]
    return lines


def _long(indent: str, key: str, text: str) -> list[str]:
    """Return ``'key': (…),`` with one literal a line, so that a diff of two scripts can be read."""
    if not text:
        return [f"{indent}'{key}': '',"]
    parts = [f"{indent}    {_text(line)}" for line in text.splitlines(keepends=True)]
    return [f"{indent}'{key}': (", *parts, f"{indent}),"]


def _text(text: str) -> str:
    """Return a literal that Python 2.7 and 3 read alike; what is not ASCII is escaped."""
    escaped = ascii(text)
    return f"u{escaped}" if "\\u" in escaped or "\\x" in escaped or "\\U" in escaped else escaped
