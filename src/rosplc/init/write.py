"""The configuration as text: every entry with the reason for it, for people who will change it by hand."""

from __future__ import annotations

import json
import os
import re
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path

from rosplc._version import __version__
from rosplc.config import Project, parse_config, resolve
from rosplc.errors import ConfigError
from rosplc.harmless import one_line
from rosplc.init.found import Found
from rosplc.init.propose import RULES, Entry

__all__ = ["SCHEMA", "check_text", "configuration", "refuse_to_overwrite", "write_file"]

_WIDTH = 108
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


SCHEMA = ".rosplc.schema.json"
"""The JSON Schema beside the configuration, by which editors complete and explain keys."""


def configuration(
    found: Found, entries: Sequence[Entry], *, bridge: str, folders: Sequence[str] = (), date: str = ""
) -> str:
    """Return the text of a configuration.

    Args:
        found: Where it comes from.
        entries: The topics, in the order in which they shall stand.
        bridge: The bridge's name.
        folders: What ``types.paths`` names.
        date: When; the first line says it.
    """
    lines = [
        f"# yaml-language-server: $schema={SCHEMA}",
        *_comment(f"Written by rosplc {__version__} init{f', {date}' if date else ''}, from {found.where}."),
        *_comment("`rosplc check --schema` lists every key; `rosplc check` explains this file."),
        "",
        f"bridge: {_value(bridge)}",
        "",
        *_ros(found),
        "",
    ]
    if folders:
        paths = ", ".join(json.dumps(folder, ensure_ascii=False) for folder in folders)
        lines += [
            *_comment("Definitions that the distribution does not have."),
            f"types: {{paths: [{paths}]}}",
            "",
        ]
    lines += [
        *_comment("Room for strings (bytes) and sequences (elements) where a topic says nothing else."),
        "limits: {string: 80, sequence: 16}",
        "",
        *_comment("The PLC's task that calls the blocks; the interval is that of your task."),
        "tasks:",
        "  RosTask: {interval: 10ms, priority: 4}",
        "",
    ]
    if any(entry.limits for entry in entries):
        lines += _comment(f"Limits below come from data that was seen. {RULES}")
    lines.append("topics:" if entries else "topics: {}")
    for number, entry in enumerate(entries):
        lines += [""] * bool(number)
        lines += _topic(entry)
    return "\n".join(lines) + "\n"


def check_text(text: str, base: Path) -> Project:
    """Return the project that a text leads to; ``base`` is the folder of its relative paths.

    Raises:
        ConfigErrors: It is not valid: a defect of the proposal, or of the user's own folders.
    """
    return resolve(parse_config(text, name="<proposal>", base=base))


def refuse_to_overwrite(path: Path, *, force: bool) -> None:
    """Raise CFG013 if there is something at ``path`` already, and CFG014 if nothing can be put there."""
    if os.path.lexists(path) and not force:
        raise ConfigError("CFG013", f"{path} is there already", where=str(path))
    if path.is_dir():
        raise ConfigError("CFG014", "is a folder", where=str(path))
    if not path.parent.is_dir():
        raise ConfigError("CFG014", f"there is no folder {path.parent}", where=str(path))


def write_file(path: Path, text: str, *, force: bool) -> None:
    """Write the file, complete or not at all.

    Raises:
        ConfigError: CFG013, there is one already and ``force`` is not given; CFG014, it cannot be written.
    """
    refuse_to_overwrite(path, force=force)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8")
        if force:
            part.replace(path)
        else:
            os.link(part, path)  # unlike a rename, this fails where somebody was faster
    except FileExistsError:
        raise ConfigError("CFG013", f"{path} is there already", where=str(path)) from None
    except OSError as error:
        raise ConfigError("CFG014", f"{error.strerror or error}", where=str(path)) from None
    finally:
        part.unlink(missing_ok=True)


def _ros(found: Found) -> Iterator[str]:
    yield "ros:"
    rows = [(f"  {key}: {_value(value)}", found.why.get(key, "")) for key, value in found.ros.items()]
    yield from _with_reasons(rows)
    if "domain" not in found.ros and found.ros.get("distro") != "noetic":
        yield "  # domain: without this key ROS_DOMAIN_ID decides, else it is 0"


def _value(value: object) -> str:
    return _key(value) if isinstance(value, str) and _PLAIN.fullmatch(value) else json.dumps(value)


def _topic(entry: Entry) -> Iterator[str]:
    yield from _comment(" ".join(entry.about), indent=2)
    yield f"  {entry.topic}:"
    yield f"    type: {entry.type_name}"
    yield f"    to: {entry.to}"
    yield from _with_reasons([(f"    {each.key}: {each.value}", each.why) for each in entry.settings])
    if entry.limits:
        yield "    limits:"
        yield from _with_reasons(
            [(f"      {_key(each.path)}: {each.capacity}", each.why) for each in entry.limits]
        )


def _key(path: str) -> str:
    # The field `true` of a message is a name, and no truth.
    return json.dumps(path) if path.lower() in ("null", "true", "false") else path


def _with_reasons(rows: Sequence[tuple[str, str]]) -> Iterator[str]:
    width = max((len(text) for text, why in rows if why), default=0)
    for text, why in rows:
        yield f"{text.ljust(width)}  # {one_line(why)}" if why else text


def _comment(text: str, indent: int = 0) -> list[str]:
    prefix = " " * indent + "# "
    return textwrap.wrap(
        one_line(text),  # names come from the network: none may end the comment and begin a line
        _WIDTH,
        initial_indent=prefix,
        subsequent_indent=prefix,
        break_on_hyphens=False,
    )
