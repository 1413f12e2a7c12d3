"""The objects that a folder of generated PLC code opens, their layout ids, and the prefix.

Read from the Structured Text, not from a list beside it, so that it is what the PLC will do. The few lines
that are read are written by the generator as they are here; a test reads every delivery.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from rosplc.shm import Part
from rosplc.shm.header import layout_id_text

LARGEST_FILE = 4 << 20
_INSTANCE = re.compile(r"^ +\w+ : (\w+)\('((?:[^'$]|\$.)*)'(?:, '((?:[^'$]|\$.)*)')?\);", re.MULTILINE)
_PART = re.compile(r"^ +fb(Request|Response|Goal|Result|Feedback) : (\w+)\(''\);", re.MULTILINE)
_IDS = re.compile(
    r"Begin(Read|Write)\(udiLayoutLo := 16#([0-9A-F]{8}), udiLayoutHi := 16#([0-9A-F]{8}), "
    r"udiRecordSize := (\d+)\)"
)
_CLASSIC = re.compile(r"IF NOT Begin\(udiRecordSize := (\d+)\)")
_PROGRAM = re.compile(r"^PROGRAM (\w+?)_(?:Read|Write)(?:_\w+)?$", re.MULTILINE)
_SETTING = re.compile(r"^ +(sPrefix|xFenced|xArm) : [^:]+ := ('?)(\w[\w-]*)\2;", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A function block's instance, and an object that it opens; for a service or action it opens several.

    ``use`` is the topic, ``service /gripper/close left``, or a classic memory's name, whose ``layout_id`` is
    empty; ``label`` tells the objects of a use apart, ``called`` and ``client`` lead to them. ``name`` is the
    type of the block that reads or writes, ``record_size`` the bytes of its record.
    """

    called: str
    name: str
    to_plc: bool
    layout_id: str
    record_size: int
    part: Part = Part.TOPIC
    client: str = ""

    @property
    def use(self) -> str:
        """The topic, or the service or action with its client, as the plans' ``name``."""
        return self._named(f"{self.part.kind} ", "")

    @property
    def label(self) -> str:
        """The object, as ``Seen.label``."""
        return self._named("", f" {self.part.word}")

    def _named(self, before: str, behind: str) -> str:
        own = f"{before}{self.called}{behind} {self.client}".rstrip()
        return self.called if self.part is Part.TOPIC else own


@dataclass(frozen=True)
class Generated:
    """A folder's code: its instances, and the settings that it was generated with.

    ``fenced``: it relies on a memory fence. ``programs``: what the names of its programs begin with.
    """

    blocks: tuple[Block, ...]
    prefix: str
    fenced: bool
    arm: bool = False
    programs: str = "SharedMemory"


def read_generated(folder: Path) -> Generated:
    """Read the output folder of `rosplc generate`, or the folder ``st`` in it.

    Raises ValueError with what is wrong: there is no such code, or it is not understood.
    """
    base = folder / "st" if (folder / "st").is_dir() else folder
    settings = {name: value for name, _, value in _SETTING.findall(_text(base / "Base/RosPlc_Settings.st"))}
    if {"sPrefix", "xFenced"} - set(settings):
        raise ValueError(f"{base / 'Base/RosPlc_Settings.st'} names no prefix")
    lists = [base / f"{name}.st" for name in ("ROS_Read", "ROS_Write", "ROS_Services", "ROS_Actions")]
    blocks = [block for path in lists if path.exists() for block in _instances(base / "Blocks", path)]
    programs = [match[1] for path in sorted(base.glob("*.st")) if (match := _PROGRAM.search(_text(path)))]
    return Generated(
        tuple(blocks),
        settings["sPrefix"],
        settings["xFenced"] == "TRUE",
        settings.get("xArm") == "TRUE",
        *programs[:1],
    )


def _instances(folder: Path, path: Path) -> Iterator[Block]:
    """Yield the instances of a variable list, for each object that they open."""
    for name, called, more in _INSTANCE.findall(_text(path)):
        parts = _PART.findall(_text(_block_file(folder, name)))
        for word, inner in parts:
            yield _block(folder, Block(called, inner, False, "", 0, Part[word.upper()], more))
        if not parts:
            yield _block(folder, Block(called, name, path.stem == "ROS_Read", "", 0))


def _block(folder: Path, found: Block) -> Block:
    text = _text(path := _block_file(folder, found.name))
    if ids := _IDS.search(text):
        layout_id = layout_id_text(int(ids[2], 16), int(ids[3], 16))
        return replace(found, to_plc=ids[1] == "Read", layout_id=layout_id, record_size=int(ids[4]))
    if classic := _CLASSIC.search(text):
        return replace(found, record_size=int(classic[1]))
    raise ValueError(f"{path} names no layout")


def _block_file(folder: Path, name: str) -> Path:
    """Return the file of a block; those of very long names are shortened with a hash."""
    path = folder / f"{name}.st"
    if path.is_file():
        return path
    head = re.compile(rf"^FUNCTION_BLOCK {re.escape(name)} ", re.MULTILINE)
    for other in sorted(folder.glob(f"{name[:100]}*.st")):
        if head.search(_text(other)):
            return other
    return path


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE)
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}") from error
    return content.decode("ascii", "replace").replace("\r\n", "\n")
