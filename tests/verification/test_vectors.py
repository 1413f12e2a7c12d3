"""The specification's vectors, read by the generated Structured Text."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

from rosplc_st.build import Build
from rosplc_st.machine import Machine
from tests.verification.c_plc import LANGUAGES, CMachine
from tests.verification.plc_cell import Cell, cell_texts, needs_armhf, target

VECTORS = Path(__file__).parents[2] / "spec" / "vectors"
FOLDERS = ("regions", "hostile")
PROBE = "Probes.probe"
# How a Read block is made one of the vectors' type: any layout, given at run time, 12 bytes.
RECORD = 12


@lru_cache
def probe_build(name: str) -> Build:
    """Return a project with a Read block for the vectors' records, and calls of the sequence functions."""
    text = cell_texts()["geometry_msgs_Twist_Read"].replace("geometry_msgs_Twist", "Sample")
    head, _, rest = text.partition("udiLayoutLo := ")
    low, _, rest = rest.partition(", udiLayoutHi := ")
    high, _, rest = rest.partition(", udiRecordSize := 48)")
    assert low.startswith("16#") and high.startswith("16#"), "the block's text has another form"
    text = f"{head}udiLayoutLo := udiWantLo, udiLayoutHi := udiWantHi, udiRecordSize := udiWantSize){rest}"
    text = text.replace(
        "VAR_INPUT\n",
        "VAR_INPUT\n    udiWantLo : UDINT;\n    udiWantHi : UDINT;\n    udiWantSize : UDINT := 12;\n",
        1,
    )
    more = {
        "Sample": "TYPE Sample :\nSTRUCT\n    abData : ARRAY[0..11] OF BYTE;\nEND_STRUCT\nEND_TYPE\n",
        "Sample_Read": text,
        "Probes": "{attribute 'qualified_only'}\nVAR_GLOBAL\n    probe : Sample_Read('/v');\nEND_VAR\n",
        "Probe": "PROGRAM Probe\nRosPlc_State.axMayOpen[0] := TRUE;\nProbes.probe();\nEND_PROGRAM\n",
        "Sequences": "PROGRAM Sequences\nVAR\n    a : UDINT;\n    b : UDINT;\n    n : UDINT;\n"
        "    d : UDINT;\n    s : UDINT;\n"
        "END_VAR\nd := RosPlc_Distance(a, b, n);\ns := RosPlc_Advance(a, b, n);\nEND_PROGRAM\n",
    }
    return target(name, more)


CODESYS = ["64-bit", pytest.param("armhf", marks=needs_armhf)]


def made_cell(kind: str) -> Cell:
    if kind in LANGUAGES:
        return Cell(machine=lambda folder: CMachine(kind, folder))
    return Cell(probe_build(kind))


@pytest.fixture(scope="module", params=[*CODESYS, "C11"])
def cell(request: pytest.FixtureRequest) -> Iterator[Cell]:
    with made_cell(request.param) as made:
        yield made


@pytest.fixture
def machine(cell: Cell) -> Iterator[Any]:
    cell.machine.start()
    if isinstance(cell.machine, CMachine):
        cell.machine.add(PROBE, "/v", (0, 0), RECORD)
    else:
        cell.machine.option("return_size", 1)
    yield cell.machine
    cell.machine.stop()
    assert cell.machine.counters().open_handles == 0


def vectors(kind: str) -> list[Any]:
    """Return the vectors that are refused, or that are read."""
    found = []
    for folder in FOLDERS:
        for path in sorted((VECTORS / folder).glob("*.json")):
            vector = json.loads(path.read_text())
            direction = (vector.get("identity") or {}).get("direction", 1)
            refused = vector.get("error") not in (None, 113)
            # A Read block expects its own direction, and the probe has records of one size.
            if (vector.get("identity") or {}).get("record_size", RECORD) != RECORD:
                continue
            if direction != 1 or vector.get("expect", {}).get("direction", 1) != 1:
                continue
            if refused == (kind == "refused"):
                found.append(pytest.param(folder, vector, id=path.stem))
    assert found, "no vectors"
    return found


def place(cell: Cell, folder: str, vector: dict[str, Any]) -> tuple[int, int]:
    """Put a vector's object at the name; return the layout that its opener expects."""
    path = cell.namespace.path("/v")
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    path.unlink(missing_ok=True)
    layout = bytes(8)
    if "image" in vector:
        image = (VECTORS / folder / vector["image"]).read_bytes()
        path.write_bytes(image)
        os.truncate(path, vector["size"])
        layout = image[64:72].ljust(8, b"\0")
    elif vector["file"] == "link":
        path.symlink_to(cell.folder / "elsewhere")
        (cell.folder / "elsewhere").write_bytes(bytes(1344))
    elif vector["file"] == "directory":
        path.mkdir()
    elif vector["file"] == "pipe":
        os.mkfifo(path)
    words = int.from_bytes(layout[:4], "little"), int.from_bytes(layout[4:], "little")
    wanted = vector.get("expect", {}).get("layout_id")
    if wanted:
        # The id's hexadecimal digits are its eight bytes in order.
        data = bytes.fromhex(wanted)
        words = int.from_bytes(data[:4], "little"), int.from_bytes(data[4:], "little")
    return words


def attach(cell: Cell, machine: Machine, words: tuple[int, int]) -> None:
    machine.set(f"{PROBE}.udiWantLo", words[0])
    machine.set(f"{PROBE}.udiWantHi", words[1])
    machine.scan("Probe", count=10)


@pytest.mark.parametrize(("folder", "vector"), vectors("refused"))
def test_refused(cell: Cell, machine: Machine, folder: str, vector: dict[str, Any]) -> None:
    """A hostile object is refused with the number of section 9, where a PLC can see the reason."""
    machine.set(f"{PROBE}.udiWantSize", vector.get("expect", {}).get("record_size", RECORD))
    attach(cell, machine, place(cell, folder, vector))
    # Links, folders and pipes are the runtime's matter: to a program in CODESYS they cannot be opened.
    hidden = {} if isinstance(machine, CMachine) else {121: 101}
    expected = hidden.get(vector["error"], vector["error"])
    assert machine.get(f"{PROBE}.udiError") == expected
    assert machine.get(f"{PROBE}.xAttached") is False


@pytest.mark.parametrize(("folder", "vector"), vectors("read"))
def test_read(cell: Cell, machine: Machine, folder: str, vector: dict[str, Any]) -> None:
    """An object that opens gives the messages, losses and discontinuities that the vector names."""
    words = place(cell, folder, vector)
    attach(cell, machine, words)
    assert machine.get(f"{PROBE}.udiError") in (0, 125)
    assert machine.get(f"{PROBE}.xAttached") is True
    for reading in vector.get("readings", ()):
        check_reading(machine, reading)


def check_reading(machine: Machine, reading: dict[str, Any]) -> None:
    """Let the block read on from a reading's ``last``, and compare all that it takes."""
    for name, value in (("udiLast", reading["last"]), ("udiLost", 0), ("udiDiscontinuities", 0),
                        ("xShow", False),
                        ("xPending", False), ("xInOrder", reading["order"] == "in_order")):  # fmt: skip
        machine.set(f"{PROBE}.{name}", value)
    taken: list[dict[str, Any]] = []
    idle, lost = 0, 0
    while idle < 3:
        machine.scan("Probe", step=0)
        assert machine.get(f"{PROBE}.xAttached") is True
        if not machine.get(f"{PROBE}.xNew"):
            idle += 1
            continue
        idle = 0
        now = machine.get(f"{PROBE}.udiLost")
        stamp = machine.get(f"{PROBE}.udiStampHi") << 32 | machine.get(f"{PROBE}.udiStampLo")
        flags = sum(
            bit
            for bit, name in ((1, "xFirst"), (2, "xTruncated"), (4, "xSubstituted"))
            if machine.get(f"{PROBE}.{name}")
        )
        taken.append({
            "sequence": machine.get(f"{PROBE}.udiSequence"), "lost": now - lost, "flags": flags,
            "stamp_ns": stamp,
            "record": machine.read(f"{PROBE}.msg").hex(),
        })  # fmt: skip
        lost = now
    expected = [
        {key: message[key] for key in ("sequence", "lost", "flags", "stamp_ns", "record")}
        for message in reading["messages"]
    ]
    for message in expected:
        message["flags"] &= 7
    assert taken == expected
    assert machine.get(f"{PROBE}.udiLast") == reading["last_after"]
    for name, key in (("udiLost", "lost"), ("udiDiscontinuities", "discontinuities")):
        assert reading[key] == machine.get(f"{PROBE}.{name}")


NAMES = json.loads((VECTORS / "names.json").read_text())


def test_names(cell: Cell, machine: Machine) -> None:
    """Prefix and topic give the object's name, shortened with the same hash; what is no topic gives 118."""
    assert NAMES["valid"]
    for vector in NAMES["valid"]:
        assert name_of(machine, vector["prefix"], vector["topic"]) == vector["object"]


def test_no_names(cell: Cell, machine: Machine) -> None:
    """What is not a topic is refused with 118, before anything is opened."""
    tried = 0
    for vector in NAMES["invalid_topics"] if "invalid_topics" in NAMES else NAMES["invalid"]:
        topic = vector["topic"] if isinstance(vector, dict) else vector
        if topic is None or not topic.isascii() or "\0" in topic:
            continue  # a string literal of the generated text cannot hold it
        tried += 1
        assert name_of(machine, "rosplc", topic) is None, topic
    assert tried


def name_of(machine: Machine, prefix: str, topic: str) -> str | None:
    """Return the name that a block derives; None: it says 118."""
    if isinstance(machine, CMachine):
        return machine.name_of(prefix, topic)
    machine.stop()
    machine.start()
    machine.set("RosPlc_Settings.sPrefix", prefix)
    machine.set(f"{PROBE}.sTopicName", topic)
    opens = machine.counters().opens
    machine.scan("Probe")
    machine.set("RosPlc_Settings.sPrefix", "rosplc")
    if machine.get(f"{PROBE}.udiError") == 118:
        assert machine.counters().opens == opens
        return None
    return str(machine.get(f"{PROBE}.sName"))


@pytest.mark.parametrize("cell", CODESYS, indirect=True)
def test_sequences(machine: Machine) -> None:
    """Next, distance and advance agree with the vectors, near the wrap above all."""
    data = json.loads((VECTORS / "sequences.json").read_text())

    def run(a: int, b: int, slots: int) -> tuple[int, int]:
        for name, value in (("a", a), ("b", b), ("n", slots)):
            machine.set(f"Sequences.{name}", value)
        machine.scan("Sequences")
        return machine.get("Sequences.d"), machine.get("Sequences.s")

    assert data["next"] and data["distance"] and data["advance"]
    for v in data["next"]:
        assert run(v["sequence"], 1, v["slots"])[1] == v["next"], v
    for v in data["distance"]:
        assert run(v["from"], v["to"], v["slots"])[0] == v["distance"], v
    for v in data["advance"]:
        assert run(v["sequence"], v["count"], v["slots"])[1] == v["result"], v
