"""Finding custom ``.msg`` files: which files, of which package."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from rosplc.errors import MessageTypeError
from rosplc.model.parse import MAX_TEXT, parse_definition

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rosplc.model.parse import ParsedType

__all__ = ["MAX_ENTRIES", "MAX_FILES", "parse_folder"]

MAX_FILES = 10_000
"""Most ``.msg`` files below one folder."""
MAX_ENTRIES = 200_000
"""Most files and folders below one folder: more is no folder of messages, but a disk."""

_PACKAGE = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")


def parse_folder(path: Path, ros_version: int) -> Iterator[ParsedType]:
    """Parse every ``.msg`` file below a folder, in the order of their paths.

    A file's package is the folder above ``msg/`` (or the file's own folder), or the name in
    the ``package.xml`` there. One ``.msg`` file instead of a folder is accepted too.

    Raises:
        MessageTypeError: TYP008 if there is nothing to read, or too much, and what
            :func:`rosplc.model.parse.parse_definition` raises, with file and line.
    """
    try:
        files = [path] if path.is_file() else _below(path)
        exists = path.exists()
    except (OSError, ValueError) as error:
        what = getattr(error, "strerror", None) or str(error)
        raise MessageTypeError("TYP008", f"cannot be read: {what}", where=str(path)) from None
    if not exists:
        raise MessageTypeError("TYP008", "does not exist", where=str(path))
    if not files or files[0].suffix != ".msg":
        raise MessageTypeError("TYP008", "holds no .msg file", where=str(path))
    names = {file: _name_of(file) for file in files}
    for file, name in names.items():
        yield from parse_definition(
            name, _read(file), where=str(file), ros_version=ros_version, siblings=names.values()
        )


def _below(path: Path) -> list[Path]:
    """Return the ``.msg`` files below a folder; links to folders are not followed, and no pipe is opened."""
    files: list[Path] = []
    for number, entry in enumerate(path.rglob("*")):
        if number >= MAX_ENTRIES:
            raise ValueError(f"there are more than {MAX_ENTRIES} files below it")
        if entry.suffix == ".msg" and entry.is_file():
            files.append(entry)
        if len(files) > MAX_FILES:
            raise ValueError(f"there are more than {MAX_FILES} .msg files below it")
    return sorted(files)


def _read(file: Path) -> str:
    try:
        with file.open("rb") as stream:
            data = stream.read(MAX_TEXT + 1)
        if len(data) > MAX_TEXT:
            raise MessageTypeError("TYP007", f"has more than {MAX_TEXT} bytes", where=str(file))
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise MessageTypeError("TYP002", "is not UTF-8 text", where=f"{file}:{line}") from None
    except OSError as error:
        raise MessageTypeError("TYP008", f"cannot be read: {error.strerror}", where=str(file)) from None


def _name_of(file: Path) -> str:
    if not _PACKAGE.match(file.stem):
        raise MessageTypeError("TYP002", f"{file.stem!r} is no message name", where=str(file))
    return f"{_package_of(file)}/msg/{file.stem}"


def _package_of(file: Path) -> str:
    folder = file.resolve().parent
    if folder.name == "msg" or (folder / "../package.xml").resolve().is_file():
        folder = folder.parent
    name = _name_in(folder / "package.xml") or folder.name
    if not _PACKAGE.match(name):
        raise MessageTypeError("TYP002", f"{name!r} is no package name", where=str(file))
    return name


def _name_in(manifest: Path) -> str:
    if not manifest.is_file():
        return ""
    try:
        with manifest.open("rb") as file:
            text = file.read(MAX_TEXT)  # what is longer is cut off, and so no XML
        return (ElementTree.fromstring(text).findtext("name") or "").strip()
    except (ElementTree.ParseError, OSError, ValueError):
        raise MessageTypeError("TYP002", "is not a readable package manifest", where=str(manifest)) from None
