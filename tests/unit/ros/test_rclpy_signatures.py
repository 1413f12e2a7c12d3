"""The double of rclpy has rclpy's signatures, as its sources have them; so has an installed rclpy."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import os
from collections.abc import Iterator

import pytest

from tests.doubles.rclpy_signatures import ALSO, BASES, DIFFERENT, EVERY, HANDLES
from tests.doubles.ros2 import double

pytestmark = pytest.mark.verifies("humble-jazzy", own="a strict test double, checked against rclpy's sources")

REAL = importlib.util.find_spec("rclpy") is not None


def expected(distro: str) -> dict[str, str]:
    other = {name: by[distro] for name, by in DIFFERENT.items() if distro in by}
    return EVERY | other


def found(name: str) -> object:
    """Return what stands under ``module:qualified.name``, properties as such."""
    module, _, path = name.partition(":")
    here: object = importlib.import_module(module)
    for part in path.split("."):
        here = inspect.getattr_static(here, part)
    return here


def written(thing: object) -> str:
    """Return a signature as the table writes it."""
    if isinstance(thing, property) or not callable(thing):
        return "property"
    words: list[str] = []
    starred = False
    for parameter in inspect.signature(thing).parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and not starred:
            words.append("*")
            starred = True
        prefix = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
        starred = starred or prefix == "*"
        default = parameter.default
        if default is parameter.empty:
            words.append(prefix + parameter.name)
        else:
            plain = default is None or type(default) in (bool, int, float, str, list)
            words.append(f"{parameter.name}={default!r}" if plain else f"{parameter.name}=...")
    return f"({', '.join(words)})"


@pytest.fixture(params=["humble", "jazzy"])
def distro(request: pytest.FixtureRequest) -> Iterator[str]:
    with double(request.param):
        yield request.param


def test_double_has_the_recorded_signatures(distro: str) -> None:
    """Every recorded function of the distribution is there, with its parameters, defaults and kinds."""
    table = expected(distro)
    assert len(table) > 60
    assert {name: written(found(name)) for name in table} == table


def test_double_lacks_what_the_distribution_lacks(distro: str) -> None:
    """What rclpy has in another distribution only cannot be found."""
    missing = [name for name, by in DIFFERENT.items() if distro not in by]
    assert len(missing) > 1
    for name in missing:
        with pytest.raises((AttributeError, ImportError)):
            found(name)


def test_double_has_nothing_of_its_own(distro: str) -> None:
    """A public name that rclpy's classes do not have, none of the double's has."""
    members: dict[str, set[str]] = {}
    for name in expected(distro):
        where, _, member = name.rpartition(".")
        if ":" in where:
            members.setdefault(where, set()).add(member)
    assert len(members) > 10
    for where in members:
        kinds = (where, *BASES.get(where, ()))
        known = set().union(*(members[kind] | ALSO.get(kind, frozenset()) for kind in kinds))
        public = {name for name in dir(found(where)) if not name.startswith("_")}
        assert public <= known, where


def test_handles_of_the_double(distro: str) -> None:
    """The handles have what the backend uses of the C++ ones."""
    handle = importlib.import_module("rclpy.node")._Handle
    public = {name for name in dir(handle) if not name.startswith("_")}
    assert public == HANDLES["subscription"] | HANDLES["publisher"]
    assert list(inspect.signature(handle.take_message).parameters) == ["self", "pymsg_type", "raw"]
    implementation = importlib.import_module("rclpy.impl.implementation_singleton").rclpy_implementation
    assert {name for name in dir(implementation.WaitSet) if name[0] != "_"} == HANDLES["wait set"]


# Made by rclpy itself and read only; later releases moved or reshaped them.
NOT_CALLED = ("rclpy.topic_endpoint_info:", "rclpy.type_hash:")


def fits(recorded: str, installed: object) -> bool:
    """Return whether every call that the recorded signature allows by name is still possible."""
    if recorded == "property":
        return written(installed) == "property"
    parameters = inspect.signature(installed).parameters  # type: ignore[arg-type]
    if any(one.kind is one.VAR_KEYWORD for one in parameters.values()):
        return True
    known = {word.partition("=")[0] for word in recorded[1:-1].split(", ") if not word.startswith("*")}
    new = [one for name, one in parameters.items() if name not in known]
    return known <= set(parameters) and all(
        one.default is not one.empty or one.kind is one.VAR_POSITIONAL for one in new
    )


@pytest.mark.parametrize(
    ("recorded", "expected_to_fit"),
    [
        ("(self, a, *, b=None)", True),
        ("(self, a, *, b=None, c=None)", True),
        ("(self, a, b=None)", True),
        ("(self)", False),  # a new parameter without a default
        ("(self, a, *, gone=None)", False),
        ("property", False),
    ],
)
def test_comparison_with_an_installed_rclpy_can_fail(recorded: str, expected_to_fit: bool) -> None:
    """A later release may add what has a default; what is taken away or demanded is noticed."""

    def installed(self, a, *, b=None, c=None):  # type: ignore[no-untyped-def]
        raise NotImplementedError

    assert fits(recorded, installed) is expected_to_fit


@pytest.mark.ros2
def test_installed_rclpy_takes_the_recorded_calls() -> None:
    """An installed rclpy has what the backend relies on."""
    distro = os.environ.get("ROS_DISTRO", "")
    table = expected(distro if distro in ("humble", "jazzy") else "rolling")
    called = {name: text for name, text in table.items() if not name.startswith(NOT_CALLED)}
    assert [name for name, text in called.items() if not fits(text, found(name))] == []
    implementation = importlib.import_module("rclpy.impl.implementation_singleton").rclpy_implementation
    assert set(dir(implementation.WaitSet)) >= HANDLES["wait set"]
