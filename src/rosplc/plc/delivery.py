"""Writes a project's files without overwriting edited files.

A generated folder contains a manifest with the hash of every file as it was written. A file
that differs from its hash was edited: it is kept, and the generation is refused until the
file is removed or overwriting is forced. Files that are no longer generated are removed.

The script that builds the project in the CODESYS IDE (IronPython 2.7, so plain ASCII Python 2.7) is the
hand-written program ``templates/import_script.py.txt``, followed by the project's objects as literals.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from rosplc.errors import GenerationError
from rosplc.harmless import listed
from rosplc.layout import Layout
from rosplc.layout.c_header import c_header
from rosplc.plc.build import ACTION_GVL, SAFE_GVL, SERVICE_GVL
from rosplc.plc.plan import LIBRARY
from rosplc.plc.plcopen import plcopen_xml
from rosplc.plc.project import (
    Dut,
    Enumeration,
    Gvl,
    Item,
    PlcProject,
    Pou,
    declaration,
    method_declaration,
    object_text,
)

_KINDS = {Dut: "DUT", Enumeration: "ENUM", Gvl: "GVL"}


def import_script(project: PlcProject) -> str:
    """Return the script's text; the same project always gives the same text."""
    lines = [
        _template("import_script.py.txt"),
        f"PROGRAMS = ({_text(f'{project.programs}_Read')}, {_text(f'{project.programs}_Write')})",
        f"LIBRARIES = [{', '.join(_text(name) for name in project.libraries)}]",
        "NOTES = [",
        *(f"    {_text(note)}," for note in project.notes),
        "]",
        "TASKS = [",
    ]
    for task, programs in project.tasks:
        cyclic = task.kind == "cyclic"
        interval_us = task.interval_ns // 1000 if cyclic else 0
        lines += [
            "    {",
            f"        'name': {_text(task.name)}, 'cyclic': {cyclic},",
            f"        'interval_us': {interval_us}, 'priority': {task.priority},",
            f"        'watchdog_us': {task.watchdog_ns // 1000}, 'sensitivity': {task.watchdog_sensitivity},",
            f"        'programs': [{', '.join(_text(name) for name in programs)}],",
            "    },",
        ]
    lines += ["]", "OBJECTS = ["]
    for item in project.items:
        lines += _object(item)
    lines += ["]", "", "main()", ""]
    return "\n".join(lines)


def _object(item: Item) -> list[str]:
    # Variables whose start values the compiler would keep: arguments of FB_Init, and the safe messages.
    instances = isinstance(item, Gvl) and (
        item.name == SAFE_GVL or any(v.arguments for block in item.blocks for v in block.variables)
    )
    kind = item.kind if isinstance(item, Pou) else _KINDS[type(item)]
    lines = [
        "    {",
        f"        'kind': {_text(kind)}, 'name': {_text(item.name)}, 'folder': {_text(item.folder)},",
        f"        'instances': {instances},",
    ]
    if isinstance(item, Pou):
        lines.append(
            f"        'base': {_text(item.extends or '')}, 'returns': {_text(item.return_type or '')},"
        )
        lines += _long("        ", "implementation", item.implementation)
    else:
        lines.append("        'base': '', 'returns': '', 'implementation': None,")
    lines += _long("        ", "declaration", declaration(item))
    lines.append("        'methods': [")
    for method in item.methods if isinstance(item, Pou) else ():
        lines.append("            {")
        lines.append(
            f"                'name': {_text(method.name)}, 'returns': {_text(method.return_type or '')},"
        )
        lines += _long("                ", "declaration", method_declaration(method))
        lines += _long("                ", "implementation", method.implementation)
        lines.append("            },")
    lines += ["        ],", "    },"]
    return lines


def _long(indent: str, key: str, text: str) -> list[str]:
    """Return ``'key': (…),`` with one literal per line, so that a diff of two scripts is readable."""
    if not text:
        return [f"{indent}'{key}': '',"]
    parts = [f"{indent}    {_text(line)}" for line in text.splitlines(keepends=True)]
    return [f"{indent}'{key}': (", *parts, f"{indent}),"]


def _text(text: str) -> str:
    """Return a literal that is the same in Python 2.7 and 3; non-ASCII characters are escaped."""
    escaped = ascii(text)
    return f"u{escaped}" if "\\u" in escaped or "\\x" in escaped or "\\U" in escaped else escaped


MANIFEST = ".rosplc-manifest.json"
LARGEST_MANIFEST = 16 << 20  # bytes of the list of generated files; one of ten thousand files has two million
_LONGEST_STEM = 120  # with the folders still within the 260 characters of a path on Windows


@dataclass(frozen=True)
class Delivery:
    """The result of writing, as paths relative to the folder.

    Attributes:
        written: New or changed files.
        unchanged: Files that already had the right content.
        removed: Files of an earlier generation that are no longer generated.
        notes: The generator's notes on the project.
    """

    written: tuple[str, ...]
    unchanged: tuple[str, ...]
    removed: tuple[str, ...]
    notes: tuple[str, ...] = ()


def project_files(project: PlcProject, layouts: list[Layout], name: str) -> dict[str, bytes]:
    """Return path below the output folder → file; ``layouts`` are for the C header, ``name`` is the stem."""
    result = {
        f"st/{_folder(item.folder, project.name)}{_stem(item.name)}.st": object_text(item).encode("ascii")
        for item in project.items
    }
    result[f"{name}.xml"] = plcopen_xml(project)
    result[f"{name}_import.py"] = import_script(project).encode("ascii")
    result[f"{name}.h"] = c_header(layouts, f"{name.upper()}_H").encode()
    readme = _template("README.txt")
    if any(gvl.name in (SERVICE_GVL, ACTION_GVL) for gvl in project.gvls):
        readme += _template("README_calls.txt")
    if LIBRARY in project.libraries:
        readme += _template("README_classic.txt")
    result["README.txt"] = (
        readme.replace("{name}", name).replace("{programs}", project.programs).encode("ascii")
    )
    if project.notes:
        result["NOTES.txt"] = ("\n".join(project.notes) + "\n").encode()
    return result


def _template(name: str) -> str:
    return files("rosplc.plc").joinpath(f"templates/{name}").read_text(encoding="ascii")


def write_files(folder: Path, files: dict[str, bytes], *, force: bool = False) -> Delivery:
    """Write files, path below ``folder`` → content; ``force`` also overwrites and removes edited files.

    The folder is created if it is missing. Raises GenerationError PLC001 if a file was edited since it was
    generated, or was not generated; PLC002 if the folder cannot be written.
    """
    try:
        known = _manifest(folder, force=force)
        edited = [] if force else _edited(folder, files, known)
        if edited:
            what = f"these files have been edited since they were generated: {listed(edited, 5)}"
            raise GenerationError("PLC001", what, where=str(folder))
        return _write(folder, files, known)
    except OSError as error:
        raise GenerationError("PLC002", f"cannot write: {error}", where=str(folder)) from error


def _write(folder: Path, files: dict[str, bytes], known: dict[str, str]) -> Delivery:
    written, unchanged, removed = [], [], []
    for path, content in sorted(files.items()):
        target = folder / path
        for link in _links(folder, path):  # only with force: otherwise they count as edited
            link.unlink()
        if target.is_file() and target.read_bytes() == content:
            unchanged.append(path)
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
        written.append(path)
    for path in sorted(set(known) - set(files)):
        target = folder / path
        if target.is_file():
            target.unlink()
            removed.append(path)
            if not any(target.parent.iterdir()):
                target.parent.rmdir()
    hashes = {path: hashlib.sha256(content).hexdigest() for path, content in sorted(files.items())}
    text = json.dumps(
        {"comment": "Hashes of generated files; rosplc generate keeps edited files.", "files": hashes}
    )
    manifest = folder / MANIFEST
    if not manifest.is_file() or manifest.read_bytes() != text.encode():
        manifest.write_text(text, encoding="utf-8")
    return Delivery(tuple(written), tuple(unchanged), tuple(removed))


def _manifest(folder: Path, *, force: bool) -> dict[str, str]:
    try:
        with (folder / MANIFEST).open("rb") as file:
            data = json.loads(file.read(LARGEST_MANIFEST))  # what is longer is cut off, and so no JSON
        entries = data["files"].items()
    except FileNotFoundError:
        return {}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        if force:
            return {}
        what = f"{MANIFEST} cannot be read, so edited files cannot be identified"
        raise GenerationError("PLC001", what, where=str(folder)) from None
    return {path: str(digest) for path, digest in entries if _is_below(folder, path)}


def _is_below(folder: Path, path: str) -> bool:
    """Return whether a path refers to a file below the folder: the manifest may have been edited."""
    if "\0" in path or Path(path).is_absolute() or ".." in Path(path).parts:
        return False
    top = folder.resolve()
    return top in (folder / path).parent.resolve().joinpath("file").parents


def _links(folder: Path, path: str) -> list[Path]:
    """Return the symbolic links in the path from the folder to a file: writing would follow them."""
    steps = [folder / path, *(folder / parent for parent in Path(path).parents if parent.name)]
    return [step for step in steps if step.is_symlink()]


def _edited(folder: Path, files: dict[str, bytes], known: dict[str, str]) -> list[str]:
    """Return files with neither the old nor the new generated content, and links in place of files."""
    result = []
    for path in sorted({*files, *known}):
        target = folder / path
        if path in files and _links(folder, path):
            result.append(path)
            continue
        if not target.is_file():
            continue
        content = target.read_bytes()
        if content != files.get(path) and hashlib.sha256(content).hexdigest() != known.get(path):
            result.append(path)
    return result


def _stem(name: str) -> str:
    """Return a file name for an identifier, which may exceed the file system's limit (255 bytes)."""
    if len(name) <= _LONGEST_STEM:
        return name
    return f"{name[: _LONGEST_STEM - 9]}_{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def _folder(path: str, top: str) -> str:
    below = path.removeprefix(top).strip("/")
    return f"{below}/" if below else ""
