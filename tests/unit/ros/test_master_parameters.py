"""Parameters on ROS 1's parameter server: what becomes of values, and of sets, with a master in memory."""

from __future__ import annotations

import math
import xmlrpc.client
from types import SimpleNamespace
from typing import Any

import pytest

from rosplc.ros.parameters import Parameter
from rosplc.ros.rospy.parameters import MasterParameters
from tests.lib.clock import SteppedClock

DECLARED = [
    Parameter("count", "integer", 3, range=(-(2**40), 2**40, 0)),
    Parameter("speed", "double", 0.5),
    Parameter("label", "string", "a"),
    Parameter("arm.raw", "byte_array", b"\1\xff"),
    Parameter("arm.fixed", "bool", True, read_only=True),
]


NESTED: list[Any] = []
for _ in range(5000):
    NESTED = [NESTED]


class Master:
    """A parameter server that keeps what XML-RPC makes of values."""

    def __init__(self) -> None:
        self.tree: dict[str, Any] = {}
        self.subscribed = 0

    def setting(self, name: str) -> Any:
        found: Any = self.tree
        for part in name.strip("/").split("/"):
            found = found.get(part) if isinstance(found, dict) else None
        return found

    def call(self, method: str, *arguments: Any) -> Any:
        if method == "subscribeParam":
            self.subscribed += 1
            return self.setting(arguments[1]) or {}
        assert method == "setParam"
        self.put(*arguments)
        return 0

    def put(self, name: str, value: Any) -> None:
        *groups, last = name.strip("/").split("/")
        place = self.tree
        for group in groups:
            if not isinstance(place.get(group), dict):
                place[group] = {}
            place = place[group]
        plain = value is not NESTED  # which Python cannot write
        place[last] = xmlrpc.client.loads(xmlrpc.client.dumps((value,)))[0][0] if plain else value


class Cell:
    """The parameters of a node ``/cell``, and what was asked of its PLC."""

    def __init__(self) -> None:
        self.clock, self.master = SteppedClock(), Master()
        self.asked: list[Any] = []
        node = SimpleNamespace(node="/cell", uri="http://cell:1", clock=self.clock, wake=lambda: None)
        self.node: Any = node
        self.parameters = MasterParameters(node, DECLARED, lambda *asked: self.asked.append(asked))

    def look(self) -> Any:
        self.parameters.notice()
        self.parameters.look(self.master)  # type: ignore[arg-type]
        return self.master.tree.get("cell")

    def end(self, why: str = "") -> None:
        """End the oldest set."""
        values, done = self.asked.pop(0)
        if not why:
            self.parameters.changed(values)
        done(why)


@pytest.fixture
def cell() -> Cell:
    made = Cell()
    made.parameters.changed({})
    made.look()
    return made


def test_nothing_before_values_are_known() -> None:
    """Those that the PLC has are not known at first; then they are put there, instead of others."""
    cell = Cell()
    cell.master.put("/cell/count", 8)
    assert cell.look() == {"count": 8}
    cell.parameters.changed({"count": 4})
    assert cell.look()["count"] == 4
    assert not cell.asked


@pytest.mark.parametrize(
    ("name", "value", "there"),
    [
        ("count", 2**31 - 1, 2**31 - 1),
        ("count", -(2**31) - 1, -(2.0**31) - 1),
        ("label", "a\rb\0\ud800", "a\ufffdb\ufffd\ufffd"),
        ("label", " <&>\n", " <&>\n"),
        ("arm.raw", b"", []),
        ("speed", math.inf, math.inf),
    ],
)
def test_what_a_program_changes(cell: Cell, name: str, value: Any, there: Any) -> None:
    """The server has it as XML-RPC can say it, and nobody has set that."""
    assert cell.look() == {"count": 3, "speed": 0.5, "label": "a", "arm": {"raw": [1, 255], "fixed": True}}
    cell.parameters.changed({name: value})
    cell.look()
    assert repr(cell.master.setting(f"/cell/{name.replace('.', '/')}")) == repr(there)
    cell.look()
    assert not cell.asked


def test_no_number_is_put_once(cell: Cell) -> None:
    """NaN differs from itself, and yet nobody has set it."""
    cell.parameters.changed({"speed": math.nan})
    assert math.isnan(cell.look()["speed"])
    cell.master.call = lambda *_: pytest.fail("nothing is to be done")  # type: ignore[method-assign]
    cell.look()
    assert not cell.asked


@pytest.mark.parametrize(
    ("path", "value", "taken"),
    [
        ("count", 2.0**40, {"count": 2**40}),
        ("speed", 2, {"speed": 2.0}),
        ("arm/raw", xmlrpc.client.Binary(b"\2"), {"arm.raw": b"\2"}),
        ("arm", {"raw": [3]}, {"arm.raw": b"\3"}),
    ],
)
def test_what_is_set(cell: Cell, path: str, value: Any, taken: dict[str, Any]) -> None:
    """It is asked for once, and then there as its parameter's type."""
    cell.master.put(f"/cell/{path}", value)
    cell.look()
    cell.look()
    assert [values for values, _ in cell.asked] == [taken]
    cell.end()
    before = cell.look()
    assert not cell.asked
    (name,) = taken
    assert cell.parameters.values[name] == taken[name]
    assert cell.look() == before


@pytest.mark.parametrize(
    ("path", "value", "why"),
    [
        ("count", 2.0**41, "count must be within"),
        ("count", 1.5, "1.5 is not of type integer"),
        ("speed", True, "True is not of type double"),
        ("arm", 5, ""),
        ("arm/raw", [256], "256 is not of type byte"),
        ("arm/fixed", False, "read-only"),
        ("label", {"a": 1}, "{'a': 1} is not of type string"),
        ("arm/raw", NESTED, "recursion"),
    ],
)
def test_what_cannot_be(
    cell: Cell, caplog: pytest.LogCaptureFixture, path: str, value: Any, why: str
) -> None:
    """It is set back, with a line in the log."""
    before = repr(cell.look())
    cell.master.put(f"/cell/{path}", value)
    assert sorted(repr(cell.look())) == sorted(before)
    assert why in caplog.text
    assert not cell.asked


def test_a_set_that_fails_and_one_that_follows(cell: Cell, caplog: pytest.LogCaptureFixture) -> None:
    """The last wish holds in the end, also one that asks for what has been."""
    cell.master.put("/cell/count", 5)
    cell.look()
    cell.end("PLC is not running")
    assert cell.look()["count"] == 3
    assert "/cell/count is reset to 3 on the parameter server: PLC is not running" in caplog.text
    cell.master.put("/cell/count", 5)
    assert cell.look()["count"] == 5
    cell.master.put("/cell/count", 3)
    cell.look()
    cell.end()
    cell.look()
    cell.end()
    assert cell.look()["count"] == cell.parameters.values["count"] == 3
    assert not cell.asked


def test_a_master_that_begins_again(cell: Cell) -> None:
    """It gets all values, and is asked to tell of sets."""
    before, cell.master.tree = cell.look(), {}
    assert (cell.look(), cell.master.subscribed) == (before, 2)
    cell.parameters.close()
    assert cell.node.parameters is None


def test_a_global_parameter() -> None:
    """It is taken when it is set, and never put there."""
    cell, taken = Cell(), list[bool]()
    sim = Parameter("use_sim_time", "bool", False, take=taken.append)
    cell.parameters = MasterParameters(cell.node, [sim], lambda *_: None)
    assert cell.look() is None
    for value in (True, True, "no", False):
        cell.master.put("/use_sim_time", value)
        cell.look()
    assert taken == [True, False]
    assert cell.master.tree == {"use_sim_time": False}
