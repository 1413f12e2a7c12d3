"""Types learnt from a node: what is taken from its answer, and what hostile answers come to."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from rosplc.config import ConfigErrors, load_project
from rosplc.errors import MessageTypeError
from rosplc.init.learn import Definitions, load, take
from rosplc.model import TypeStore
from tests.interop.graphs import free_domain
from tests.interop.zenoh.processes import Router, free_port
from tests.lib.waiting import WATCHDOG_S
from tests.unit.init.robots import PART, SIDE_TEXT, SOURCES, STORE, Robot, answer_about

HASH = STORE.type_hash(PART)


@pytest.fixture
def answer() -> dict[str, Any]:
    """What an honest node answers about PART."""
    return copy.deepcopy(answer_about(STORE, PART, SOURCES))


def taken(answer: dict[str, Any], name: str = PART, type_hash: str = HASH) -> Definitions:
    """Return what has been learnt."""
    definitions = Definitions("jazzy", environment={})
    take(definitions, answer, name, type_hash, "node /robot")
    return definitions


def fields(answer: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the first type's fields."""
    return answer["type_description"]["type_description"]["fields"]


def test_an_answer(answer: dict[str, Any]) -> None:
    """The texts are the sources', with their comments."""
    definitions = taken(answer)
    assert definitions.texts == SOURCES
    assert {*definitions.origins.values()} == {"node /robot"}
    assert definitions.store[PART] == STORE[PART]


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ({"encoding": "idl"}, "IDL"),
        ({"raw_file_contents": f"{SIDE_TEXT}bool right\n"}, "another field"),
        ({"raw_file_contents": "bool left\nuint8 FOR = 300\n"}, "a wrong constant"),
        ({"raw_file_contents": "bool \ud800"}, "half a character"),
        ({"raw_file_contents": f"{SIDE_TEXT}{'=' * 80}\nMSG: std_msgs/Own\nbool evil\n"}, "a second type"),
        ({"raw_file_contents": "# " + "x" * (1 << 20)}, "a long text"),
        ({"type_name": "cell_msgs/msg/Other"}, "no source"),
    ],
)
def test_a_source_that_does_not_fit_is_not_used(
    answer: dict[str, Any], source: dict[str, str], reason: str
) -> None:
    """The fields are known nevertheless, and the origin says what is not."""
    answer["type_sources"][1] |= source
    definitions = taken(answer)
    assert definitions.texts == {**SOURCES, "cell_msgs/msg/Side": "bool left\n"}, reason
    assert "without constants" in definitions.origins["cell_msgs/msg/Side"]
    assert definitions.store.type_hash(PART) == HASH


def test_constants_and_defaults_come_from_a_source() -> None:
    """The hash does not cover them."""
    name, text = (
        "cell_msgs/msg/Mode",
        "uint8 FAST = 2\nuint8 mode 1\nstring<=4 name\nfloat64[3] a\nint8[<=9] b\n",
    )
    store = TypeStore.bundled("jazzy").with_definition(name, text)
    answer = answer_about(store, name, {name: text})
    assert taken(answer, name, store.type_hash(name)).store[name] == store[name]
    bare = taken(answer | {"type_sources": []}, name, store.type_hash(name)).store[name]
    assert (bare.constants, [field.default for field in bare.fields]) == ((), [None] * 4)
    assert [field.type for field in bare.fields] == [field.type for field in store[name].fields]


def deep(answer: dict[str, Any], depth: int) -> None:
    """Nest a chain of types below Side, so deep; the last needs the first where it is circular."""
    others = answer["type_description"]["referenced_type_descriptions"]
    for number in range(depth):
        part = copy.deepcopy(others[0])
        part["type_name"] = f"cell_msgs/msg/Level{number}"
        part["fields"][0]["type"] |= {"type_id": 1, "nested_type_name": f"cell_msgs/msg/Level{number + 1}"}
        others.append(part)
    others[0]["fields"][0]["type"] |= {"type_id": 1, "nested_type_name": "cell_msgs/msg/Level0"}


HOSTILE: dict[str, tuple[str, Callable[[dict[str, Any]], object]]] = {
    "refused": ("TYP010", lambda a: a.update(successful=False, failure_reason="no\x1b[2J\nsuch type")),
    "another type": ("TYP010", lambda a: a["type_description"]["type_description"].update(type_name="a/B")),
    "another hash": ("TYP010", lambda a: fields(a).pop()),
    "renamed": ("TYP010", lambda a: fields(a)[0].update(name="sort")),
    "a line more": ("TYP010", lambda a: fields(a)[0].update(name="kind\nuint8 more")),
    "no name": ("TYP002", lambda a: fields(a)[0].update(name="9\x1b")),
    "no type": ("TYP002", lambda a: fields(a)[0]["type"].update(type_id=255)),
    "no length": ("TYP002", lambda a: fields(a)[0]["type"].update(type_id=51, capacity=0)),
    "wide strings": ("TYP004", lambda a: fields(a)[0]["type"].update(type_id=18)),
    "missing": ("TYP001", lambda a: a["type_description"]["referenced_type_descriptions"].clear()),
    "recursive": ("TYP003", lambda a: a["type_description"]["referenced_type_descriptions"][0]["fields"][0]
                  ["type"].update(type_id=1, nested_type_name=PART)),
    "deep": ("TYP007", lambda a: deep(a, 200)),
    "many types": ("TYP007", lambda a: deep(a, 501)),
    "many fields": ("TYP007", lambda a: fields(a).extend(
        {**fields(a)[0], "name": f"f{number}"} for number in range(10_001))),
    "long": ("TYP007", lambda a: fields(a)[0].update(name="k" * (1 << 20))),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_answers(answer: dict[str, Any], case: str) -> None:
    """Each is an error with a code, whose text is harmless on a terminal."""
    code, spoil = HOSTILE[case]
    spoil(answer)
    with pytest.raises(MessageTypeError) as refused:
        taken(answer)
    assert refused.value.code == code
    assert "\x1b" not in refused.value.what


def test_a_known_type_with_other_fields(answer: dict[str, Any]) -> None:
    """It is not replaced: other topics use it."""
    definitions = Definitions("jazzy", environment={})
    definitions.learn("cell_msgs/msg/Side", "bool right\n", "elsewhere")
    with pytest.raises(MessageTypeError, match="cell_msgs/msg/Side differs") as refused:
        take(definitions, answer, PART, HASH, "node /robot")
    assert refused.value.code == "TYP005"
    assert PART not in definitions.store


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, and an environment that names no ROS."""
    for name in ("ROS_DISTRO", "ROS_MASTER_URI", "ROS_DOMAIN_ID", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return tmp_path


def configured(folder: Path, **ros: object) -> Path:
    """Write a configuration with a topic of a type that it does not define."""
    path = folder / "rosplc.yaml"
    topics = {"/parts": {"type": PART, "to": "plc"}}
    path.write_text(json.dumps({"ros": {"distro": "jazzy", **ros}, "topics": topics}))
    return path


@pytest.mark.parametrize(
    "backend", ["memory", *(pytest.param(x, marks=pytest.mark.foreign) for x in ("dds", "zenoh"))]
)
def test_a_bridge_learns_and_keeps(
    backend: str, here: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a node describes is saved beside the configuration, logged, and found without the node."""
    for patience in ("_LOOK_S", "_PATIENCE_S"):
        monkeypatch.setattr(f"rosplc.init.learn.{patience}", WATCHDOG_S)
    caplog.set_level("INFO", "rosplc.run")
    with ExitStack() as stack:
        domain, options = stack.enter_context(free_domain()), {}
        if backend == "zenoh":
            router = stack.enter_context(Router(stack.enter_context(free_port())))
            options = {"connect": [router.endpoint]}
        path = configured(here, backend=backend, domain=domain, **({"zenoh": options} if options else {}))
        with pytest.raises(ConfigErrors, match=r"TYP001.*rosplc run"):
            load_project(path)
        stack.enter_context(Robot(backend, domain, describes=True, **options))
        assert load(path).topic("/parts").type_name == PART
    assert f"learned {PART} from node /robot; saved in {here}/learned_types" in caplog.text
    assert (here / "learned_types/cell_msgs/msg/Side.msg").read_text() == SIDE_TEXT
    store = load_project(path).topic("/parts").layout.store
    assert store.type_hash(PART) == HASH


@pytest.mark.parametrize(
    ("distro", "describes", "words"),
    [
        ("jazzy", False, "node /robot cannot describe the type: no node serves"),
        ("humble", True, "humble (ros.distro) has no service"),
    ],
)
def test_a_bridge_that_cannot_learn(
    distro: str, describes: bool, words: str, here: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The log has the reason, and the error the remedy."""
    with (
        free_domain() as domain,
        Robot("memory", domain, describes=describes),
        pytest.raises(ConfigErrors, match=r"TYP001.*types\.paths"),
    ):
        load(configured(here, backend="memory", distro=distro, domain=domain))
    assert words in caplog.text
    assert not (here / "learned_types").exists()


def test_what_is_learnt_cannot_be_kept(here: Path) -> None:
    """A bridge that could start once, and not again, does not start."""
    (here / "learned_types").write_text("in the way")
    with (
        free_domain() as domain,
        Robot("memory", domain, describes=True),
        pytest.raises(MessageTypeError) as refused,
    ):
        load(configured(here, backend="memory", domain=domain))
    assert refused.value.code == "TYP009"
