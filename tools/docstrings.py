"""Docstrings of Google's style as Markdown, and signatures as people write them."""

from __future__ import annotations

import dataclasses
import enum
import inspect
import re
import textwrap
from collections.abc import Iterator
from typing import Any

HEADINGS = {"Args": "Arguments"}
SECTION = re.compile(r"^(Args|Attributes|Returns|Yields|Raises):$")
FIELD = re.compile(r"^    (\w+): ")
ITEM = re.compile(r"^(\*{0,2}[\w., ]+?): (.*)$")


def markdown(text: str) -> str:
    """Return a docstring's inline markup as Markdown."""
    text = re.sub(r":\w+:`~(?:[\w]+\.)*(\w+)`", r"`\1`", text)
    text = re.sub(r":\w+:`([^`]+)`", r"`\1`", text)
    return text.replace("``", "`")


def body(docstring: str) -> Iterator[str]:
    """Yield a docstring's lines as Markdown: paragraphs, lists of arguments, errors and attributes."""
    section, code = "", False
    for line in docstring.splitlines():
        example = not section and line.startswith("    ")
        if example and not code:
            yield "```text"
        elif code and line and not example:
            yield "```\n"
        code = example or (code and not line)
        if match := SECTION.match(line):
            section = match[1]
            yield f"*{HEADINGS.get(section, section)}*\n"
        elif code:
            yield line[4:]
        else:
            items = section in ("Args", "Attributes", "Raises")
            text = markdown(line.strip())
            item = ITEM.match(text) if items and not line.startswith("        ") else None
            yield f"* `{item[1]}`: {item[2]}" if item else f"  {text}" if items and text else text
    if code:
        yield "```"


def comments(thing: Any) -> Iterator[str]:
    """Yield what comments say about the fields of a dataclass: behind them, or above."""
    if not (isinstance(thing, type) and dataclasses.is_dataclass(thing)):
        return
    above: list[str] = []
    found = []
    for line in inspect.getsource(thing).splitlines():
        field = FIELD.match(line)
        behind = field and line.partition("  # ")[2]
        if field and (text := behind or " ".join(above)):
            found.append(f"* `{field[1]}`: {markdown(text)}")
        above = [*above, line[6:]] if line.startswith("    # ") else []
    if found:
        yield from ("", "*Attributes*", "", *found)


def describe(thing: Any) -> str:
    """Return what an object's docstring says; code of an example is not run."""
    lines = "\n".join([*body(inspect.getdoc(thing) or ""), *comments(thing)])
    lines = re.sub(r"\n+```$", "\n```", re.sub(r"\n{3,}", "\n\n", lines), flags=re.MULTILINE)
    return re.sub(r"::$", ":", lines, flags=re.MULTILINE).strip()


def _annotation(value: Any) -> str:
    if isinstance(value, str):
        return value
    return getattr(value, "__name__", "") or str(value)


def _default(name: str, value: Any) -> str:
    if name == "mode" and isinstance(value, int):
        return oct(value)
    if isinstance(value, enum.Enum):
        return f"{type(value).__name__}.{value.name}"
    text = repr(value)
    return text if not text.startswith("<") else "…"


def signature(name: str, function: Any, *, bound: bool = False, width: int = 96) -> str:
    """Return a call's signature, on one line if it fits.

    Args:
        name: What stands before the parenthesis.
        function: The function, method or class.
        bound: Leave out the first parameter.
        width: Characters of a line.
    """
    found = inspect.signature(function)
    parts: list[str] = []
    starred = False
    for parameter in list(found.parameters.values())[bound:]:
        text = parameter.name
        if parameter.kind is parameter.VAR_POSITIONAL:
            text, starred = f"*{text}", True
        elif parameter.kind is parameter.VAR_KEYWORD:
            text = f"**{text}"
        elif parameter.kind is parameter.KEYWORD_ONLY and not starred:
            parts.append("*")
            starred = True
        if parameter.annotation is not parameter.empty:
            text += f": {_annotation(parameter.annotation)}"
        if parameter.default is not parameter.empty:
            text += f" = {_default(parameter.name, parameter.default)}"
        parts.append(text)
    returned = (
        "" if found.return_annotation in (found.empty, "None") else _annotation(found.return_annotation)
    )
    arrow = f" -> {returned}" if returned and not inspect.isclass(function) else ""
    line = f"{name}({', '.join(parts)}){arrow}"
    if len(line) <= width:
        return line
    inner = textwrap.indent(",\n".join(parts) + ",", "    ")
    return f"{name}(\n{inner}\n){arrow}"
