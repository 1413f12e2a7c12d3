"""Comparison of generated PLC code with the configuration and with the running bridge.

The doctor reads the Structured Text itself, not a separate list, because the PLC executes that text. The
patterns below match the few lines that it needs; a test reads everything that the generator can write.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rosplc.doctor.finding import Finding
from rosplc.doctor.kinds import fine, found, judged
from rosplc.doctor.objects import Carried, Objects
from rosplc.harmless import listed, plural
from rosplc.layout import Layout
from rosplc.shm import Direction, Namespace, Part
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
    """A function block's instance and an object that it opens; a service or action has one per object.

    ``use`` is the topic, ``service /gripper/close left``, or a classic memory's name, whose ``layout_id`` is
    empty; ``label`` distinguishes the objects of a use, which ``called`` and ``client`` identify. ``name`` is
    the type of the block that reads or writes, ``record_size`` the size of its record in bytes.
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
    """The code in a folder: its instances, and the settings that it was generated with.

    ``fenced``: the code relies on a memory fence. ``programs``: the beginning of its programs' names.
    """

    blocks: tuple[Block, ...]
    prefix: str
    fenced: bool
    arm: bool = False
    programs: str = "SharedMemory"


def read_generated(folder: Path) -> Generated:
    """Read the output folder of `rosplc generate`, or the folder ``st`` in it.

    Raises ValueError with the reason if there is no such code or it cannot be parsed.
    """
    base = folder / "st" if (folder / "st").is_dir() else folder
    settings = {name: value for name, _, value in _SETTING.findall(_text(base / "Base/RosPlc_Settings.st"))}
    if {"sPrefix", "xFenced"} - set(settings):
        raise ValueError(f"{base / 'Base/RosPlc_Settings.st'} does not define a prefix")
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
    raise ValueError(f"{path} contains neither a layout id nor a record size")


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


_ARM = ("aarch64", "armv8l", "armv7l", "armv6l")


def against_config(
    code: Generated,
    wanted: Sequence[Carried],
    prefix: str,
    command: str,
    *,
    differences: Mapping[str, str] | None = None,
) -> Iterator[Finding]:
    """Compare each block with what ``command`` would generate now for the objects ``wanted``.

    ``differences`` maps a type to the difference in its declaration.
    """
    other = f"the code's prefix is {code.prefix}, but the configuration's prefix is {prefix}"
    same, well = code.prefix == prefix, f"code and configuration have the prefix {prefix}"
    yield judged("DOC706", "" if same else other, well, command=command)
    blocks = {block.label: block for block in code.blocks}
    missing, stale = [], []
    for each in wanted:
        block = blocks.pop(each.name, None)
        if block is None or block.to_plc is not (each.direction is Direction.TO_PLC):
            missing.append(each.use if block is None else f"{each.use} (in this direction)")
        elif what := _difference(block, each.layout):
            more = (differences or {}).get(each.layout.type_name, "")
            where = each.name if block.layout_id else each.use
            stale.append(found("DOC702", f"{where}: {what}{f'; {more}' if more else ''}", command=command))
    count = plural(len(wanted) - len(missing), "object")
    yield from stale or [fine("DOC702", f"code and configuration have the same layout for {count}")]
    what = f"the code has no block for {listed(dict.fromkeys(missing))}" if missing else ""
    yield judged("DOC704", what, "the code has a block for every topic, service and action", command=command)
    more = listed(dict.fromkeys(block.use for block in blocks.values()))
    what = f"the configuration has no entry for these blocks of the code: {more}" if more else ""
    yield judged("DOC705", what, "every block in the code has an entry in the configuration", command=command)


def _difference(block: Block, layout: Layout) -> str:
    same = block.record_size == layout.size
    if not block.layout_id:
        return "" if same else f"{block.record_size} bytes in the code but {layout.size} in the configuration"
    if block.layout_id == layout.layout_id:
        return ""
    sizes = "" if same else f" ({block.record_size} and {layout.size} bytes)"
    return f"layout {block.layout_id} in {block.name}, but {layout.layout_id} in the configuration{sizes}"


def against_live(code: Generated, objects: Objects, directory: Path) -> Iterator[Finding]:
    """Compare each block with the object that it would open now."""
    namespace = Namespace(code.prefix, directory)
    count, wrong = 0, []
    for block in code.blocks:
        seen = objects.of(namespace, block.called, block.part, block.client) if block.layout_id else None
        if seen is None or seen.identity is None or not seen.live:
            continue
        count += 1
        identity, word = seen.identity, seen.identity.direction.word
        if block.to_plc is not (identity.direction is Direction.TO_PLC):
            wrong.append(f"{block.label}: the object's direction, {word}, differs from the block's [SHM110]")
        elif identity.layout_id != block.layout_id:
            sizes = f"{block.record_size} and {identity.record_size} bytes"
            what = f"layout {block.layout_id} in the code, but {identity.layout_id} in the bridge ({sizes})"
            wrong.append(f"{block.label}: {what} [SHM112]")
    for what in wrong:
        yield found("DOC703", what)
    if count and not wrong:
        yield fine("DOC703", f"code and running bridge have the same layout for {plural(count, 'object')}")


def fences(code: Generated, machine: str, command: str) -> Iterator[Finding]:
    """Judge whether the memory fences in the code are right for this machine."""
    wrong = not code.arm and code.fenced and machine in _ARM
    what = f"the code relies on the memory fence of x86, but this machine is {machine}" if wrong else ""
    well = "the memory fences in the code suit this machine"
    yield judged("DOC707", what, well, command=f"{command} --target arm")


def files(folder: Path, expected: Mapping[str, bytes], command: str) -> tuple[list[Finding], dict[str, str]]:
    """Compare the files with those that would be generated now: path below the output folder → content.

    Return the finding to report if no layout differs, and type → the first difference in its declaration.
    """
    other, differences = [], {}
    for path, content in sorted(expected.items()):
        if not path.startswith("st/"):
            continue
        try:
            actual = (folder / path).read_bytes()
        except OSError:
            continue  # a missing topic is found by its own
        if actual != content:
            other.append(path)
            if path.startswith("st/Types/") and (line := _first_difference(actual, content)):
                head = content.decode("ascii", "replace").splitlines()[0].removeprefix("// ")
                differences[head.partition(",")[0]] = line
    what = f"these files differ from newly generated code: {listed(other)}" if other else ""
    return [judged("DOC708", what, "the files match newly generated code", command=command)], differences


def _first_difference(actual: bytes, expected: bytes) -> str:
    old, new = (text.decode("ascii", "replace").splitlines()[1:] for text in (actual, expected))
    first = {"- ": "", "+ ": ""}
    for line in difflib.ndiff(old, new):
        if not first.get(line[:2], "-"):
            first[line[:2]] = line[2:].partition("//")[0].strip().rstrip(";")
    gone, come = first.values()
    if gone and come:
        return f"first difference: `{gone}` in the code, `{come}` expected"
    return f"first difference: {'unexpected' if gone else 'missing'} `{gone or come}`" if gone or come else ""
