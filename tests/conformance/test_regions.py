"""Every region vector, read by the product and by an independent reader, means what is written beside it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol

import pytest

from rosplc.errors import ChannelError
from rosplc.shm import SERVICE, Attached, Direction, GoalNotes, Namespace, Part, Reader, attach
from rosplc.shm.attach import belong_together
from tests.region_reader import Refused, StaticReader, open_object

pytestmark = pytest.mark.verifies("vectors", own="vectors from an independent implementation")

VECTORS = Path(__file__).parents[2] / "spec" / "vectors"
TOPIC = "/v"


class Opened(Protocol):
    """An object that an implementation has opened."""

    def identity(self) -> dict[str, Any]: ...
    def description(self) -> dict[str, Any]: ...
    def head(self) -> int: ...
    def read(self, order: str, last: int) -> dict[str, Any]: ...


class Independent:
    """The reader of tests/region_reader.py."""

    def __init__(self, path: Path, expect: dict[str, Any]) -> None:
        self._object = open_object(path, expect)

    def identity(self) -> dict[str, Any]:
        data = self._object.data
        return {**self._object.fields, "layout_id": self._object.layout_id, "bridge_id": data[76:92].hex()}

    def description(self) -> dict[str, Any]:
        return self._object.description()

    def head(self) -> int:
        return self._object.word(128)

    def read(self, order: str, last: int) -> dict[str, Any]:
        reader = StaticReader(self._object, last)
        messages = []
        while message := reader.take(order):
            messages.append(message)
        return {
            "messages": messages,
            "last_after": reader.last,
            "lost": reader.lost,
            "discontinuities": reader.discontinuities,
        }


class Product:
    """rosplc.shm."""

    def __init__(self, attached: Attached) -> None:
        self._attached = attached

    def identity(self) -> dict[str, Any]:
        found = self._attached.identity
        names = [name for name in found.__dataclass_fields__ if name != "bridge_id"]
        return {**{name: getattr(found, name) for name in names}, "bridge_id": found.bridge_id.hex()}

    def description(self) -> dict[str, Any]:
        return dict(json.loads(self._attached.description.to_json()))

    def head(self) -> int:
        return self._attached.snapshot().writer.head

    def read(self, order: str, last: int) -> dict[str, Any]:
        reader = Reader(self._attached.region, last)
        take = {"newest": reader.latest, "in_order": reader.next}[order]
        out = bytearray(b"\xa5" * self._attached.region.record_size)
        messages = []
        while info := take(out):
            messages.append({
                "sequence": info.sequence,
                "lost": info.lost,
                "flags": info.flags,
                "stamp_ns": info.stamp_ns,
                "stamp_clock": info.stamp_clock,
                "correlation": info.correlation,
                "record": out.hex(),
            })  # fmt: skip
        if not messages:
            assert set(out) == {0xA5}, "a copy that was not accepted reached the caller"
        return {
            "messages": messages,
            "last_after": reader.last,
            "lost": reader.lost,
            "discontinuities": reader.discontinuities,
        }


@contextmanager
def opened(implementation: str, directory: Path, expect: dict[str, Any]) -> Iterator[Opened]:
    """Open the object of TOPIC; raise Refused with the number of section 9 otherwise."""
    namespace = Namespace(directory=directory)
    if implementation == "independent":
        yield Independent(namespace.path(TOPIC), expect)
        return
    wanted = {**expect, **({"direction": Direction(expect["direction"])} if "direction" in expect else {})}
    try:
        with attach(namespace, TOPIC, **wanted) as attached:
            yield Product(attached)
    except ChannelError as error:
        raise Refused(int(error.code.removeprefix("SHM"))) from error


def place(vector: dict[str, Any], folder: str, directory: Path) -> None:
    """Put a vector's object where TOPIC's is looked for."""
    path = Namespace(directory=directory).path(TOPIC)
    match vector.get("file"):
        case None:
            path.write_bytes((VECTORS / folder / vector["image"]).read_bytes())
            os.truncate(path, vector["size"])
        case "link":
            (directory / "elsewhere").write_bytes(b"")
            path.symlink_to(directory / "elsewhere")
        case "directory":
            path.mkdir()
        case "pipe":
            os.mkfifo(path)
        case other:
            assert other == "missing"


def load(folder: str) -> dict[str, dict[str, Any]]:
    return {
        path.stem: json.loads(path.read_text("utf-8")) for path in sorted((VECTORS / folder).glob("*.json"))
    }


VALID = load("regions")
HOSTILE = load("hostile")
REFUSED = {name: one for name, one in HOSTILE.items() if "error" in one}
SCRIBBLED = {name: one for name, one in HOSTILE.items() if "readings" in one}
IMPLEMENTATIONS = ("product", "independent")


CALLS = load("calls")


def place_call(name: str, directory: Path) -> dict[str, Any]:
    vector = CALLS[name]
    path = directory / vector["object"]
    path.write_bytes((VECTORS / "calls" / vector["image"]).read_bytes())
    os.truncate(path, vector["size"])
    return {"part": Part[vector["open"]["part"].upper()], "client": vector["open"]["client"]}


@pytest.mark.parametrize("name", [name for name, one in CALLS.items() if "messages" in one])
def test_an_object_of_a_call_is_read(name: str, tmp_path: Path) -> None:
    """Identity, self-description and messages of a service's or action's object are those beside it."""
    vector = CALLS[name]
    with attach(Namespace(directory=tmp_path), TOPIC, **place_call(name, tmp_path)) as attached:
        found = Product(attached)
        identity = found.identity()
        assert {key: identity[key] for key in vector["identity"]} == vector["identity"]
        assert found.description() == vector["description"]
        reader, out = Reader(attached.region, 0), bytearray(attached.region.record_size)
        for wanted in vector["messages"]:
            info = reader.next(out)
            assert info is not None
            values = {key: getattr(info, key) for key in wanted if key not in ("client", "record")}
            assert values | {"client": info.client.hex(), "record": out.hex()} == wanted
        assert reader.next(out) is None
    expect = {"kind": vector["identity"]["kind"], "direction": vector["identity"]["direction"]}
    assert open_object(tmp_path / vector["object"], expect).description() == vector["description"]
    with pytest.raises(Refused, match="110"):
        open_object(tmp_path / vector["object"], {})


@pytest.mark.parametrize("name", [name for name in CALLS if name.startswith("refused-")])
def test_a_wrong_object_of_a_call_is_refused(name: str, tmp_path: Path) -> None:
    """Another part's object, or one whose self-description does not agree with it, is refused."""
    with (
        pytest.raises(ChannelError) as caught,
        attach(Namespace(directory=tmp_path), TOPIC, **place_call(name, tmp_path)) as attached,
    ):
        attached.description  # noqa: B018 - read when it is looked at
    assert caught.value.code == f"SHM{CALLS[name]['error']}"


@pytest.mark.parametrize("name", [name for name in CALLS if name.startswith("notes-")])
def test_what_a_bridge_has_left_about_a_goal(name: str, tmp_path: Path) -> None:
    """The newest whole entry about the goal counts; what is written next spares it, and is found again."""
    vector = CALLS[name]
    uuid, note = bytes.fromhex(vector["uuid"]), bytes.fromhex(vector["note"])
    with attach(Namespace(directory=tmp_path), TOPIC, write=True, **place_call(name, tmp_path)) as attached:
        notes = GoalNotes(attached)
        assert notes.left(uuid) == note
        assert notes.left(bytes(16)) == b""
        notes.write(bytes(16), b"another goal's")
        assert GoalNotes(attached).left(uuid) == note
        notes.write(uuid, b"x" * 1024)
        assert GoalNotes(attached).left(uuid) == b"x" * 1024


@pytest.mark.parametrize("name", [name for name in CALLS if name.startswith("pair-")])
def test_objects_of_a_call_belong_together(name: str, tmp_path: Path) -> None:
    """Tools open those that name each other's layout ids, and no others."""
    place_call(name, tmp_path)
    place_call(CALLS[name]["partner"], tmp_path)
    try:
        with ExitStack() as stack:
            opened = (attach(Namespace(directory=tmp_path), TOPIC, part=part) for part in SERVICE)
            belong_together(dict(zip(SERVICE, map(stack.enter_context, opened), strict=True)))
    except ChannelError as error:
        assert error.code == f"SHM{CALLS[name]['error']}"
    else:
        assert "error" not in CALLS[name]


def compare_readings(implementation: str, object_: Opened, readings: list[dict[str, Any]]) -> None:
    assert readings
    for wanted in readings:
        found = object_.read(wanted["order"], wanted["last"])
        case = f"{implementation}, {wanted['order']}, last {wanted['last']}"
        for member, value in wanted.items():
            if member in found:
                assert found[member] == value, f"{case}: {member}"


@pytest.mark.parametrize("folder", ["regions", "hostile"])
def test_there_are_vectors(folder: str) -> None:
    """An empty folder of vectors is a failure, and so is an image without a meaning."""
    names = {path.stem for path in (VECTORS / folder).glob("*.json")}
    images = {path.stem for path in (VECTORS / folder).glob("*.bin")}
    assert len(names) > 20
    assert images <= names


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
@pytest.mark.parametrize("name", VALID)
def test_a_valid_object_is_read(name: str, implementation: str, tmp_path: Path) -> None:
    """Identity, self-description, head and messages are those written beside the image."""
    vector = VALID[name]
    place(vector, "regions", tmp_path)
    with opened(implementation, tmp_path, {}) as found:
        identity = found.identity()
        assert {key: identity[key] for key in vector["identity"]} == vector["identity"]
        description = found.description()
        known = {key: value for key, value in vector["description"].items() if key in description}
        assert known == {key: description[key] for key in known}
        assert len(known) >= 9
        assert found.head() == vector["head"]
        compare_readings(implementation, found, vector["readings"])


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
@pytest.mark.parametrize("name", VALID)
def test_a_valid_object_is_the_expected_one(name: str, implementation: str, tmp_path: Path) -> None:
    """An opener that expects exactly this layout, record size and direction gets it."""
    vector = VALID[name]
    place(vector, "regions", tmp_path)
    expect = {key: vector["identity"][key] for key in ("layout_id", "record_size", "direction")}
    with opened(implementation, tmp_path, expect) as found:
        assert found.head() == vector["head"]


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
@pytest.mark.parametrize("name", REFUSED)
def test_a_hostile_object_is_refused(name: str, implementation: str, tmp_path: Path) -> None:
    """The opener stops at the first check of section 9 that fails, with its number."""
    vector = REFUSED[name]
    place(vector, "hostile", tmp_path)
    with pytest.raises(Refused) as refused, opened(implementation, tmp_path, vector["expect"]) as found:
        if vector.get("still_readable"):
            assert found.read("newest", 1)["last_after"] == 2
            found.description()
    assert refused.value.number == vector["error"], str(refused.value.__cause__)


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
@pytest.mark.parametrize("name", SCRIBBLED)
def test_a_scribbled_object_yields_nothing_wrong(name: str, implementation: str, tmp_path: Path) -> None:
    """A head or slot that somebody wrote over may cost messages; it invents and repeats none."""
    vector = SCRIBBLED[name]
    place(vector, "hostile", tmp_path)
    with opened(implementation, tmp_path, {}) as found:
        compare_readings(implementation, found, vector["readings"])


def test_every_number_of_attach_has_a_vector() -> None:
    """Each check of section 9 that an image can fail has a vector (102 needs another user)."""
    assert {one["error"] for one in REFUSED.values()} == {101, 121, *range(103, 114)}


def test_the_vectors_are_what_the_generator_writes() -> None:
    """Nobody edited a vector by hand, or the generator without running it."""
    command = [sys.executable, str(VECTORS / "generate_regions.py"), "--verify"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr


def test_the_generator_does_not_know_the_product() -> None:
    """The generator runs without rosplc, and without anything but the standard library."""
    program = (
        f"import sys; sys.path.insert(0, {str(VECTORS)!r});"
        "import generate_regions; generate_regions.generate();"
        "assert not any(name.split('.')[0] == 'rosplc' for name in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-S", "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
