"""A node's parameters: what the six services answer, and what is said about changes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from rosplc.model import TypeStore
from rosplc.ros import Qos, fields
from rosplc.ros.memory import open_apart
from rosplc.ros.parameters import EVENTS, KINDS, Parameter, ParameterServer, shown_parameters
from tests.lib.waiting import wait_for

STORE = TypeStore.bundled("jazzy")
VALUES: dict[str, Any] = {
    "bool": True, "integer": -3, "double": 2.5, "string": "grün", "byte_array": b"\x01\xff",
    "bool_array": [True, False], "integer_array": [2**40, -1], "double_array": [0.5],
    "string_array": ["a", ""],
}  # fmt: skip
DECLARED = [
    *(Parameter(f"kinds.{kind}", kind, VALUES[kind], f"a {kind}", most=2, longest=5) for kind in KINDS),
    Parameter("speed", "double", 0.5, range=(0.0, 2.0, 0.25)),
    Parameter("count", "integer", 4, range=(1, 10, 3)),
    Parameter("fixed", "integer", 1, read_only=True),
]


class Node:
    """A node that asks, and the server with a PLC that takes values when it is told to."""

    def __init__(self) -> None:
        self.own, self.peer = open_apart(STORE, "cell", "peer")
        self.events: list[dict[str, Any]] = []
        event = "rcl_interfaces/msg/ParameterEvent"
        self.peer.subscribe(EVENTS, event, Qos(), lambda data, _: self.events.append(unpack(event, data)))
        self.asked: list[Any] = []
        self.server = ParameterServer(self.own, STORE, DECLARED, lambda *asked: self.asked.append(asked))

    def begin(self, service: str, **request: Any) -> list[dict[str, Any]]:
        """Call a service; return the list that its response comes into."""
        kind, answers = f"rcl_interfaces/srv/{service}", []
        name = "".join(f"_{char.lower()}" if char.isupper() else char for char in service)[1:]
        client = self.peer.client(f"/cell/{name}", kind, Qos())
        client.call(
            fields.pack(STORE, f"{kind}_Request", request),
            lambda reply: answers.append(unpack(f"{kind}_Response", reply.payload or b"")),
        )
        return answers

    def ask(self, service: str, **request: Any) -> dict[str, Any]:
        answers = self.begin(service, **request)
        wait_for(lambda: answers, f"the answer of {service}")
        return answers[0]


def unpack(name: str, data: bytes) -> dict[str, Any]:
    return fields.unpack(STORE, name, data)


def wish(name: str, kind: str, value: Any) -> dict[str, Any]:
    return {"name": name, "value": {"type": KINDS.index(kind) + 1, f"{kind}_value": value}}


@pytest.fixture
def node() -> Iterator[Node]:
    made = Node()
    yield made
    made.server.close()
    made.own.close()
    made.peer.close()


def test_every_kind_is_got_and_described(node: Node) -> None:
    """Values, numbers of types and descriptions of all nine kinds."""
    names = [f"kinds.{kind}" for kind in KINDS]
    values = node.ask("GetParameters", names=names)["values"]
    found = {kind: value[f"{kind}_value"] for kind, value in zip(KINDS, values, strict=True)}
    assert found == VALUES
    assert [value["type"] for value in values] == list(range(1, 10))
    assert list(node.ask("GetParameterTypes", names=names)["types"]) == list(range(1, 10))
    described = node.ask("DescribeParameters", names=[*names, "speed", "count", "fixed"])["descriptors"]
    assert [each["description"] for each in described[:9]] == [f"a {kind}" for kind in KINDS]
    assert described[9]["floating_point_range"] == [{"from_value": 0.0, "to_value": 2.0, "step": 0.25}]
    assert described[10]["integer_range"] == [{"from_value": 1, "to_value": 10, "step": 3}]
    assert [each["read_only"] for each in described[9:]] == [False, False, True]
    assert node.ask("GetParameters", names=["speed", "nothing"]) == {"values": []}


def test_names_are_listed_as_rclpy_lists_them(node: Node) -> None:
    """All, up to a depth, and below a prefix."""
    every = [each.name for each in DECLARED]
    assert node.ask("ListParameters")["result"] == {"names": every, "prefixes": ["kinds"]}
    flat = {"names": ["speed", "count", "fixed"], "prefixes": []}
    assert node.ask("ListParameters", depth=1)["result"] == flat
    assert node.ask("ListParameters", prefixes=["kinds"], depth=1)["result"]["names"] == every[:9]
    assert node.ask("ListParameters", prefixes=["kin", "speed"])["result"]["names"] == ["speed"]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (wish("nothing", "bool", True), "nothing is not declared"),
        (wish("fixed", "integer", 2), "fixed is read-only"),
        (wish("speed", "integer", 1), "speed is of type double and cannot change to integer"),
        (wish("speed", "double", 2.01), "speed must be within 0.0 … 2.0"),
        (wish("speed", "double", float("nan")), "speed must be within 0.0 … 2.0"),
        (wish("speed", "double", 0.3), "speed must be 0.0 plus a multiple of 0.25"),
        (wish("count", "integer", 5), "count must be 1 plus a multiple of 3"),
        (wish("kinds.string", "string", "grüün"), "the text for kinds.string has more than 5 bytes"),
        (wish("kinds.bool_array", "bool_array", [True] * 3), "can have at most 2 elements, not 3"),
        ({"name": "speed", "value": {}}, "speed is of type double and cannot change to not set"),
    ],
)
def test_refusals_have_words(node: Node, asked: dict[str, Any], words: str) -> None:
    """Nothing is asked of the PLC; an atomic set is refused as a whole."""
    good = wish("count", "integer", 10)
    result = node.ask("SetParametersAtomically", parameters=[good, asked])["result"]
    assert (result["successful"], node.asked) == (False, [])
    assert words in result["reason"]
    assert words in node.ask("SetParameters", parameters=[asked])["results"][0]["reason"]


def test_a_set_waits_for_the_plc(node: Node) -> None:
    """No answer before; one refused wish of a set that is not atomic hinders no other."""
    wishes = [wish("speed", "double", 2.0), wish("fixed", "integer", 2), wish("count", "integer", 7)]
    answers = node.begin("SetParameters", parameters=wishes)
    wait_for(lambda: node.asked, "the set")
    values, done = node.asked.pop()
    assert (values, answers) == ({"speed": 2.0, "count": 7}, [])
    node.server.changed({**values, "kinds.bool": True})
    done("")
    wait_for(lambda: answers, "the answer")
    assert [each["successful"] for each in answers[0]["results"]] == [True, False, True]
    wait_for(lambda: len(node.events) == 2, "the event")
    assert node.events[0]["node"] == "/cell"
    assert [each["name"] for each in node.events[0]["new_parameters"]] == [each.name for each in DECLARED]
    changed = {each["name"]: each["value"] for each in node.events[1]["changed_parameters"]}
    assert (list(changed), changed["speed"]["double_value"]) == (["speed", "count"], 2.0)
    answers = node.begin("SetParametersAtomically", parameters=wishes[:1])
    wait_for(lambda: node.asked, "the set")
    node.asked.pop()[1]("PLC is not running")
    wait_for(lambda: answers, "the answer")
    assert answers[0]["result"] == {"successful": False, "reason": "PLC is not running"}


def test_what_a_node_shows() -> None:
    """Texts and lists of texts, read-only, with the version."""
    shown = shown_parameters({"bridge": "cell", "topics": []})
    assert [(each.name, each.kind, each.read_only) for each in shown] == [
        ("version", "string", True), ("bridge", "string", True), ("topics", "string_array", True),
    ]  # fmt: skip
