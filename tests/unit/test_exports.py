"""The public surface: what packages export, and that its types are shipped."""

from __future__ import annotations

import ast
import importlib
import re
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import rosplc
from tests.doubles.ros2 import double

PACKAGE = Path(rosplc.__file__).parent
ROOT = Path(__file__).parents[2]
PUBLIC = sorted(
    ".".join(("rosplc", *path.parent.relative_to(PACKAGE).parts))
    for path in PACKAGE.rglob("__init__.py")
    if "_core" not in path.parts
)
MODULES = sorted(
    ".".join(("rosplc", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")
    for path in PACKAGE.rglob("*.py")
    if "_core" not in path.parts and path.name != "__main__.py"
)


def literal_all(path: Path) -> list[str] | None:
    """Return ``__all__`` as the source writes it; None if it is missing or computed."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign):
            targets, value = node.targets, node.value
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets, value = [node.target], node.value
        else:
            continue
        if any(isinstance(target, ast.Name) and target.id == "__all__" for target in targets):
            try:
                return list(ast.literal_eval(value))
            except ValueError:
                return None
    return None


MIDDLEWARE = {"dds": "cyclonedds", "zenoh": "zenoh"}  # backend → what it imports and pip installs


def cases(names: list[str]) -> list[Any]:
    """Return a parameter per module; those whose middleware has no wheel for this machine are listed."""
    return [
        pytest.param(name, marks=pytest.mark.needs(when=found(name), why=f"no middleware for {name}"))
        for name in names
    ]


def found(name: str) -> bool:
    parts = name.split(".")
    middleware = MIDDLEWARE.get(parts[2]) if parts[1:2] == ["ros"] and len(parts) > 2 else None
    return middleware is None or find_spec(middleware) is not None


def imported(name: str) -> ModuleType:
    """Return a module; the backend rclpy, where there is none, over the double."""
    if name.startswith("rosplc.ros.rclpy") and find_spec("rclpy") is None:
        with double():
            return importlib.import_module(name)
    return importlib.import_module(name)


@pytest.mark.parametrize("name", cases(PUBLIC))
def test_package_exports_what_its_literal_all_says(name: str) -> None:
    """Every package has a literal __all__ without doubles, and every name in it exists."""
    module = imported(name)
    assert module.__file__ is not None
    exported = literal_all(Path(module.__file__))
    assert exported is not None, f"{name} has no literal __all__"
    assert len(exported) == len(set(exported))
    for attribute in exported:
        assert hasattr(module, attribute), f"{name}.{attribute}"


@pytest.mark.parametrize("name", cases(MODULES))
def test_module_says_what_it_is_for(name: str) -> None:
    """Every module can be imported by itself and has a docstring."""
    assert imported(name).__doc__


def test_public_names_are_documented() -> None:
    """Every function and class that rosplc itself exports has a docstring of its own."""
    for attribute in rosplc.__all__:
        value = getattr(rosplc, attribute)
        if callable(value):
            assert value.__doc__, attribute


def test_types_are_shipped() -> None:
    """py.typed is in the package, so that users' type checkers believe the annotations."""
    assert resources.files("rosplc").joinpath("py.typed").is_file()


def test_version_is_a_release_number() -> None:
    """The version has three numbers and equals the one in the installed metadata."""
    from importlib.metadata import version

    assert len(rosplc.__version__.split(".")) == 3
    assert version("rosplc") == rosplc.__version__


@pytest.mark.parametrize(
    ("places", "pattern"),
    [
        ("CITATION.cff", r"(?m)^version: (.+)$"),
        ("benchmarks/pyproject.toml", r'(?m)(?:^version = |rosplc==)"?([^"]+)"'),
        ("tests/st/pyproject.toml", r'(?m)^version = "([^"]+)"'),
        ("packaging/ros2/rosplc_bridge/package.xml", r"<version>(.+)</version>"),
        ("docs/howto/deploy-*.md", r"rosplc[-_](\d[^-_]*)[-_]"),
    ],
)
def test_every_place_has_the_version(places: str, pattern: str) -> None:
    """What is released together carries one version."""
    found = [re.findall(pattern, path.read_text("utf-8")) for path in ROOT.glob(places)]
    assert {each for several in found for each in several} == {rosplc.__version__}


def test_the_newest_section_of_the_change_log_is_this_release() -> None:
    """And its date is that of CITATION.cff."""
    (date,) = re.findall(r"(?m)^date-released: (.+)$", (ROOT / "CITATION.cff").read_text("utf-8"))
    log = (ROOT / "CHANGELOG.md").read_text("utf-8")
    assert re.findall(r"(?m)^## \[(\d.*)\] - (.+)$", log)[0] == (rosplc.__version__, date)


def imports(path: Path) -> set[str]:
    """Return the modules that a source file imports, those inside functions included."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def test_no_module_takes_the_public_names_from_the_front_door() -> None:
    """`from rosplc import attach` inside the package would be a way around the dependency rule."""
    for path in sorted(PACKAGE.rglob("*.py")):
        assert not {f"rosplc.{name}" for name in rosplc.__all__} & imports(path), path
