"""Files that rosplc's commands find beside their own: PLC code and its manifest, definitions, tokens."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rosplc.doctor.code import read_generated
from rosplc.errors import GenerationError, MessageTypeError, WebError
from rosplc.model import TypeStore
from rosplc.plc.delivery import MANIFEST, write_files
from rosplc.web.access import read_token
from tests.fuzz.choices import Choices
from tests.fuzz.oracle import refusals
from tests.fuzz.scratch import emptied

__all__ = ["check", "seeds"]

_FILES = {"st/a.st": b"a\n", "rosplc.xml": b"<x/>\n"}


def _put(path: Path, content: bytes) -> bool:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    except (OSError, ValueError):  # no name that a file can have
        return False
    return True


def _delivery(choices: Choices) -> None:
    """A folder that was generated before, with a manifest that anybody may have edited."""
    folder = emptied("files")
    out, outside = folder / "out", folder / "outside.txt"
    outside.write_bytes(b"keep")
    _put(out / MANIFEST, choices.part())
    _put(out / "st/old.st", choices.part())
    force = choices.flag()
    with refusals(GenerationError):
        write_files(out, _FILES, force=force)
        assert (out / "st/a.st").read_bytes() == b"a\n"
        assert write_files(out, _FILES).written == ()
    assert outside.read_bytes() == b"keep"
    assert sorted(path.name for path in folder.iterdir()) == ["out", "outside.txt"]


def _generated(choices: Choices) -> None:
    """PLC code that the doctor reads."""
    folder = emptied("files")
    for name in ("Base/RosPlc_Settings", "ROS_Read", "ROS_Write", "Blocks/B"):
        _put(folder / f"st/{name}.st", choices.part())
    try:
        code = read_generated(folder)
    except ValueError as error:
        assert len(str(error)) < 4000
        return
    assert all(len(block.layout_id) in (0, 16) for block in code.blocks)


def _definitions(choices: Choices) -> None:
    """A folder of definitions with names and a manifest of somebody's choice."""
    folder = emptied("files")
    manifest = choices.part()
    if manifest:
        _put(folder / "own_msgs/package.xml", manifest)
    for _ in range(1 + choices.below(3)):
        name = choices.text()[:60].replace("/", "_").replace("\0", "_")
        _put(folder / f"own_msgs/msg/{name or 'Own'}.msg", choices.part())
    _put(folder / "own_msgs/srv/Own.srv", choices.part())
    _put(folder / "own_msgs/action/Own.action", choices.part())
    for version in ("jazzy", "noetic"):
        with refusals(MessageTypeError):
            store = TypeStore.bundled(version).with_paths([folder])
            for name in set(store.names()) - set(TypeStore.bundled(version).names()):
                store.definition_text(name)
            if "own_msgs/action/Own" in store.actions():
                goal = store.action("own_msgs/Own").goal
                assert TypeStore.from_definition(goal.name, store.definition_text(goal.name))[goal.name]
            store.service_md5("own_msgs/Own") if version == "noetic" else store.service_hash("own_msgs/Own")


def _token(choices: Choices) -> None:
    path = emptied("files") / "token"
    path.write_bytes(choices.rest())
    path.chmod(0o600)
    with refusals(WebError):
        assert 16 <= len(read_token(path)) <= 256


def check(data: bytes) -> None:
    """Whatever the files hold, nothing outside of their folder is touched, and what is wrong is named."""
    choices = Choices(data)
    choices.pick((_delivery, _generated, _definitions, _token))(choices)


def seeds() -> Iterator[bytes]:
    """Sound files, and names that lead elsewhere."""
    manifest = b'{"files": {"st/old.st": "aa", "../outside.txt": "x", "/etc/passwd": "y", "a\\u0000b": "z"}}'
    digest = b"ca978112ca1bbdcafac231b39a23dc4da786eff8147c4e72b9807785afee48bb"  # of the letter a
    yield b"\0" + manifest + b"\xffa\xff\1"
    yield b"\0" + b'{"files": {"st/old.st": "' + digest + b'"}}\xffa\xff\0'
    yield b"\0" + b'{"files": {"st": "", "": "", ".": ""}}\xffa\xff\1'
    settings = b"VAR_GLOBAL CONSTANT\n    sPrefix : STRING(32) := 'rosplc'; // p\n"
    settings += b"    xFenced : BOOL := TRUE;\nEND_VAR\n"
    block = b"BeginRead(udiLayoutLo := 16#00000001, udiLayoutHi := 16#0000000A, udiRecordSize := 48)"
    yield b"\1" + b"\xff".join((settings, b"    x : B('/cmd_vel');\n", b"", block))
    package = b"<package><name>own_msgs</name></package>"
    yield b"\2" + package + b"\xff\1Own\xffuint8 a\nOther o\n\xffOther\xffstring s\n"
    yield b"\2\xff\0A\xffbool a\n\xffbool x\n---\nOther[] o\n\xff---\nstring B=x\n---\ntime t\n"
    bomb = b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'
    bomb += b"<package><name>&b;</name></package>"
    yield b"\2" + bomb + b"\xff\0Own\xffuint8 a\n"
    yield b"\3" + b"0123456789abcdef\n"
