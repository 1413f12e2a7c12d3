"""Topics, blocks, layout ids and prefix of a folder of generated PLC code.

Read from the Structured Text, not from a list beside it, so that it is what the PLC will do. The few lines
that are read are written by the generator as they are here; a test reads every delivery.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from rosplc.shm.header import layout_id_text

LARGEST_FILE = 4 << 20
_INSTANCE = re.compile(r"^ +\w+ : (\w+)\('((?:[^'$]|\$.)*)'(?:, '(?:[^'$]|\$.)*')?\);", re.MULTILINE)
_IDS = re.compile(
    r"Begin(?:Read|Write)\(udiLayoutLo := 16#([0-9A-F]{8}), udiLayoutHi := 16#([0-9A-F]{8}), "
    r"udiRecordSize := (\d+)\)"
)
_CLASSIC = re.compile(r"IF NOT Begin\(udiRecordSize := (\d+)\)")
_PROGRAM = re.compile(r"^PROGRAM (\w+?)_(?:Read|Write)(?:_\w+)?$", re.MULTILINE)
_SETTING = re.compile(r"^ +(sPrefix|xFenced|xArm) : [^:]+ := ('?)(\w[\w-]*)\2;", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A function block's instance.

    ``topic`` is the memory's name if it is classic, and ``layout_id`` empty; ``name`` is the block's type,
    ``record_size`` the bytes of its record.
    """

    topic: str
    name: str
    to_plc: bool
    classic: bool
    layout_id: str
    record_size: int


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
    blocks = []
    for name, to_plc in (("ROS_Read", True), ("ROS_Write", False)):
        path = base / f"{name}.st"
        if path.exists():
            blocks += [_block(base, kind, topic, to_plc) for kind, topic in _INSTANCE.findall(_text(path))]
    programs = [match[1] for path in sorted(base.glob("*.st")) if (match := _PROGRAM.search(_text(path)))]
    return Generated(
        tuple(blocks),
        settings["sPrefix"],
        settings["xFenced"] == "TRUE",
        settings.get("xArm") == "TRUE",
        *programs[:1],
    )


def _block(base: Path, name: str, topic: str, to_plc: bool) -> Block:
    text = _text(path := _block_file(base / "Blocks", name))
    if found := _IDS.search(text):
        layout_id = layout_id_text(int(found[1], 16), int(found[2], 16))
        return Block(topic, name, to_plc, False, layout_id, int(found[3]))
    if found := _CLASSIC.search(text):
        return Block(topic, name, to_plc, True, "", int(found[1]))
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
