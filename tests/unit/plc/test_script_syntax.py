"""The IDE runs the import script with IronPython 2.7: nothing newer may are in it."""

from __future__ import annotations

import ast
import io
import os
import subprocess
import tokenize
from pathlib import Path

import pytest

from rosplc.layout import Limits
from rosplc.plc.build import build_type_library
from rosplc.plc.delivery import import_script
from tests.unit.plc.projects import JOINTS, STORE, TWIST, custom, layout, project, read, write

NEWER = (
    ast.JoinedStr,
    ast.AnnAssign,
    ast.Nonlocal,
    ast.AsyncFunctionDef,
    ast.AsyncFor,
    ast.AsyncWith,
    ast.Await,
    ast.YieldFrom,
    ast.NamedExpr,
    ast.MatMult,
    ast.Starred,
)


@pytest.fixture(scope="module", params=["topics", "types"])
def script(request, tmp_path_factory):
    """Scripts with everything that a project can hold, texts that are not ASCII included."""
    if request.param == "topics":
        slow = (read("/k", JOINTS, limits=Limits(sequence=3)), write("/t", TWIST))
        return import_script(project(read("/j", JOINTS, task="Fast"), *slow))
    text = 'string NAME="grün"\nstring text "it\'s 5 $"\n'
    store = custom(tmp_path_factory.mktemp("types"), Text=text)
    names = ["cell_msgs/msg/Text", *STORE.names()]
    return import_script(build_type_library(store, [layout(name, store=store) for name in names]))


def newer(text: str) -> list[str]:
    """Return what Python 2.7 would not read, or would read otherwise."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, NEWER):
            found.append(type(node).__name__)
        if isinstance(node, ast.FunctionDef):
            arguments = node.args
            everything = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
            annotated = [a for a in everything if a.annotation] or node.returns
            if annotated or arguments.kwonlyargs or arguments.posonlyargs:
                found.append(f"signature of {node.name}")
        if isinstance(node, ast.Raise) and node.cause:
            found.append("raise from")
        if isinstance(node, ast.Dict) and None in node.keys:
            found.append("** in a dict")
        if isinstance(node, ast.ClassDef) and node.keywords:
            found.append("metaclass")
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "super":
            found.append("super()")
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.NUMBER and ("_" in token.string or token.string.lower().startswith("0o")):
            found.append(token.string)
    return found


def test_nothing_newer_than_python_2_7_stands_in_it(script):
    """No f-string, annotation, nonlocal, keyword-only argument or the like."""
    assert newer(script) == []
    assert script.isascii()
    assert "from __future__ import print_function" in script


@pytest.mark.parametrize(
    "text",
    [
        'f"{x}"', "x: int = 1", "def f(a: int): pass", "def f(*, a): pass", "def f() -> int: pass",
        "def f():\n    x = 1\n    def g():\n        nonlocal x", "a, *b = c", "raise A from B", "{**a}",
        "(y := 3)", "1_000", "async def f(): pass", "class A(metaclass=B): pass", "a @ b",
        "def f(a, /): pass",
    ],
)  # fmt: skip
def test_the_check_finds_what_is_newer(text):
    """Each construct that the check looks for is found in a text that has it."""
    assert newer(text)


@pytest.mark.needs(variable="PYTHON27")
@pytest.mark.verifies("import-script-syntax", real="Python 2.7 (where available)")
def test_python_2_7_compiles_it(script, tmp_path: Path):
    """The Python 2.7 that PYTHON27 names has the last word."""
    path = tmp_path / "rosplc_import.py"
    path.write_text(script, encoding="ascii")
    command = [os.environ["PYTHON27"], "-c", f"compile(open({str(path)!r}).read(), 'script', 'exec')"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
