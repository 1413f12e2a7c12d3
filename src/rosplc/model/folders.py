"""Custom definitions in files: which are found, of which package; and definitions from elsewhere, written."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.etree import ElementTree

from rosplc.errors import MessageTypeError
from rosplc.model.parse import MAX_TEXT, ParsedType, full_name, parse_definition

MAX_FILES = 10_000  # Most files with definitions below one folder.
MAX_ENTRIES = 200_000  # Most files and folders below one folder: more is no folder of messages, but a disk.

_SEPARATOR = re.compile(r"^={80}\s*\nMSG:\s*(\S+)\s*\n", re.MULTILINE)
_PACKAGE = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
_SUFFIXES = {".msg": "message", ".srv": "service", ".action": "action"}


def parse_paths(
    paths: Iterable[Path], ros_version: int
) -> tuple[list[ParsedType], dict[str, list[Path]], dict[str, MessageTypeError], list[MessageTypeError]]:
    """Parse every ``.msg`` file below some folders, or single files, in the order of folders and paths.

    A file's package is the folder above ``msg/``, ``srv/`` or ``action/`` (or the file's own folder), or the
    name in the ``package.xml`` there. What is wrong with one file concerns its type alone: a workspace has
    types that are not carried. Returns the types; service or action → its files, which are not read yet; type
    → error of those that cannot be parsed; errors of files that give no type's name. Raises MessageTypeError
    TYP008 if there is nothing to read, or too much.
    """
    names: dict[Path, str] = {}
    nameless: list[MessageTypeError] = []
    for file in dict.fromkeys(file for path in paths for file in _files(path)):
        try:
            names[file] = _name_of(file)
        except MessageTypeError as error:
            nameless.append(error)
    parsed: list[ParsedType] = []
    interfaces: dict[str, list[Path]] = {}
    broken: dict[str, MessageTypeError] = {}
    siblings = set(names.values())
    for file, name in names.items():
        if file.suffix != ".msg":
            interfaces.setdefault(name, []).append(file)
            continue
        try:
            text = read(file)
            parsed += parse_definition(
                name, text, where=str(file), ros_version=ros_version, siblings=siblings
            )
        except MessageTypeError as error:
            broken.setdefault(name, error)
    return parsed, interfaces, broken, nameless


def _files(path: Path) -> list[Path]:
    try:
        files = [path] if path.is_file() else _below(path)
        exists = path.exists()
    except (OSError, ValueError) as error:
        what = getattr(error, "strerror", None) or str(error)
        raise MessageTypeError("TYP008", f"cannot be read: {what}", where=str(path)) from None
    if not exists:
        raise MessageTypeError("TYP008", "this path does not exist", where=str(path))
    if not files or files[0].suffix not in _SUFFIXES:
        raise MessageTypeError("TYP008", "this path contains no .msg, .srv or .action file", where=str(path))
    return files


def _below(path: Path) -> list[Path]:
    """Return the files with definitions below a folder.

    Links to folders, hidden folders, those that colcon and catkin are told to ignore, and pipes are left out.
    """
    files: list[Path] = []
    number = 0
    folders = [path]
    for folder in folders:  # grows
        for entry in folder.iterdir():
            number += 1
            if number > MAX_ENTRIES:
                raise ValueError(f"it contains more than {MAX_ENTRIES} files and folders")
            if entry.suffix in _SUFFIXES and entry.is_file():
                files.append(entry)
            elif entry.is_dir() and not entry.is_symlink() and not _ignored(entry):
                folders.append(entry)
        if len(files) > MAX_FILES:
            raise ValueError(f"it contains more than {MAX_FILES} definitions")
    return sorted(files)


def _ignored(folder: Path) -> bool:
    tools = ("COLCON", "AMENT", "CATKIN")
    return folder.name.startswith(".") or any((folder / f"{tool}_IGNORE").exists() for tool in tools)


def read(file: Path) -> str:
    """Return a file's text. Raises MessageTypeError TYP002, TYP007 or TYP008, with the file's name."""
    try:
        with file.open("rb") as stream:
            data = stream.read(MAX_TEXT + 1)
        if len(data) > MAX_TEXT:
            raise MessageTypeError("TYP007", f"the file has more than {MAX_TEXT} bytes", where=str(file))
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise MessageTypeError("TYP002", "the text is not UTF-8", where=f"{file}:{line}") from None
    except OSError as error:
        raise MessageTypeError("TYP008", f"cannot be read: {error.strerror}", where=str(file)) from None


def _name_of(file: Path) -> str:
    if not _PACKAGE.match(file.stem):
        what = f"{file.stem!r} is not a valid {_SUFFIXES[file.suffix]} name"
        raise MessageTypeError("TYP002", what, where=str(file))
    return f"{_package_of(file)}/{file.suffix[1:]}/{file.stem}"


def _package_of(file: Path) -> str:
    folder = file.resolve().parent
    if folder.name == file.suffix[1:] or (folder / "../package.xml").resolve().is_file():
        folder = folder.parent
    name = _name_in(folder / "package.xml") or folder.name
    if not _PACKAGE.match(name):
        raise MessageTypeError("TYP002", f"{name!r} is not a valid package name", where=str(file))
    return name


def _name_in(manifest: Path) -> str:
    if not manifest.is_file():
        return ""
    try:
        with manifest.open("rb") as file:
            text = file.read(MAX_TEXT)  # what is longer is cut off, and so no XML
        return (ElementTree.fromstring(text).findtext("name") or "").strip()
    except (ElementTree.ParseError, OSError, ValueError):
        raise MessageTypeError("TYP002", "this manifest cannot be read", where=str(manifest)) from None


# -- writing


def split_definition(type_name: str, text: str) -> dict[str, str]:
    """Return the parts of a text that parses by full type name, ``type_name`` first."""
    first, *others = _SEPARATOR.split(text.replace("\r\n", "\n"))
    parts = {full_name(type_name): first.strip("\n") + "\n"}
    for name, part in zip(others[::2], others[1::2], strict=True):
        parts.setdefault(full_name(name), part.strip("\n") + "\n")
    return parts


def save_definitions(texts: Mapping[str, str], folder: Path) -> tuple[Path, ...]:
    """Write ``package/msg/Name.msg`` below a folder, which is made, for each text; return the files.

    A file that has the same text already is left as it is. Raises MessageTypeError TYP001 if a name is none,
    TYP009 if a file has another text (nothing is written in these cases) or cannot be written.
    """
    wanted = {}
    for name, text in texts.items():
        package, _, base = full_name(name).split("/")
        wanted[folder / package / "msg" / f"{base}.msg"] = text
    for file, text in wanted.items():  # all or nothing
        _check(file, text)
    for file, text in wanted.items():
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        except OSError as error:
            what = f"cannot be written: {error.strerror}"
            raise MessageTypeError("TYP009", what, where=str(file)) from None
    return tuple(wanted)


def _check(file: Path, text: str) -> None:
    try:
        if file.read_text(encoding="utf-8") != text:
            raise MessageTypeError("TYP009", "the file contains another definition", where=str(file))
    except FileNotFoundError:
        pass
    except (OSError, UnicodeDecodeError) as error:
        what = getattr(error, "strerror", None) or "not UTF-8 text"
        raise MessageTypeError("TYP009", f"cannot read the existing file: {what}", where=str(file)) from None
