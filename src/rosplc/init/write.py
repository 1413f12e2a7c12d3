"""From selected topics to the file: definitions, measurements, proposals, and a text with their reasons."""

from __future__ import annotations

import json
import os
import re
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from rosplc._version import __version__
from rosplc.config import json_schema, parse_config, resolve
from rosplc.errors import ConfigError, RosplcError
from rosplc.harmless import one_line
from rosplc.init.found import Found, Seen
from rosplc.init.live import LiveRobot
from rosplc.init.propose import RULES, Chosen, Entry, propose
from rosplc.init.recorded import RecordedRobot
from rosplc.model.folders import save_definitions

Source: TypeAlias = LiveRobot | RecordedRobot
_WIDTH = 108
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")

SCHEMA = ".rosplc.schema.json"
"""The JSON Schema beside the configuration, with which editors complete and explain keys."""


def configuration(
    found: Found,
    entries: Sequence[Entry],
    *,
    bridge: str,
    folders: Sequence[str] = (),
    date: str = "",
    calls: bool = False,
) -> str:
    """Return the text of a configuration for what was found.

    ``entries`` are in the order of the file; ``folders`` become ``types.paths``; ``date`` is part of the
    first comment. ``calls``: propose services and actions, too, as comments.
    """
    written = f"Created by `rosplc init` {__version__}{f' on {date}' if date else ''} from {found.where}."
    lines = [f"# yaml-language-server: $schema={SCHEMA}", *_comment(written)]
    lines += _comment("`rosplc check --schema` lists every key; `rosplc check` explains this file.")
    lines += ["", f"bridge: {_value(bridge)}", "", *_ros(found), ""]
    if folders:
        paths = ", ".join(json.dumps(folder, ensure_ascii=False) for folder in folders)
        lines += _comment("Folders with type definitions that the ROS distribution lacks.")
        lines += [f"types: {{paths: [{paths}]}}", ""]
    lines += _comment("Default limits of strings (bytes) and sequences (elements).")
    lines += ["limits: {string: 80, sequence: 16}", ""]
    lines += _comment("The PLC task that calls the blocks; set the interval of your task.")
    lines += ["tasks:", "  RosTask: {interval: 10ms, priority: 4}", ""]
    if any(entry.limits for entry in entries):
        lines += _comment(f"The limits below are based on the data seen. {RULES}")
    lines.append("topics:" if entries else "topics: {}")
    for number, entry in enumerate(entries):
        lines += [*([""] if number else []), *_topic(entry)]
    if calls:
        lines += ["", *_calls(found)]
    return "\n".join(lines) + "\n"


def _calls(found: Found) -> Iterator[str]:
    """Yield the services and actions that were found, as comments: the user decides which ones to carry."""
    more = "Uncomment those that the PLC should call (`server: ros`) or provide (`server: plc`)."
    yield from _comment(
        f"Services and actions in the graph. {more}" if found.calls else "No services or actions were found."
    )
    for kind in ("service", "action"):
        rows = [
            (f"#  {call.name}: {{type: {call.type_name}, server: {call.server}}}", call.why)
            for call in found.calls
            if call.kind == kind
        ]
        if rows:
            yield f"#{kind}s:"
            yield from _with_reasons(rows)


def refuse_to_overwrite(path: Path, *, force: bool) -> None:
    """Raise CFG013 if ``path`` already exists, and CFG014 if no file can be created there."""
    if os.path.lexists(path) and not force:
        raise ConfigError("CFG013", "this path already exists", where=str(path))
    if path.is_dir():
        raise ConfigError("CFG014", "this is a folder", where=str(path))
    if not path.parent.is_dir():
        raise ConfigError("CFG014", f"the folder {path.parent} does not exist", where=str(path))


def write_file(path: Path, text: str, *, force: bool) -> None:
    """Write the file completely or not at all.

    Raises ConfigError: CFG013, the file exists and ``force`` is not given; CFG014, it cannot be written.
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
        raise ConfigError("CFG013", "this path already exists", where=str(path)) from None
    except OSError as error:
        raise ConfigError("CFG014", f"{error.strerror or error}", where=str(path)) from None
    finally:
        part.unlink(missing_ok=True)


def _ros(found: Found) -> Iterator[str]:
    yield "ros:"
    rows = [(f"  {key}: {_value(value)}", found.why.get(key, "")) for key, value in found.ros.items()]
    yield from _with_reasons(rows)
    if "domain" not in found.ros and found.ros.get("distro") != "noetic":
        yield "  # domain: without this key, ROS_DOMAIN_ID applies; if it is not set, 0"


def _value(value: object) -> str:
    return _key(value) if isinstance(value, str) and _PLAIN.fullmatch(value) else json.dumps(value)


def _topic(entry: Entry) -> Iterator[str]:
    yield from _comment(" ".join(entry.about), indent=2)
    yield f"  {entry.topic}:"
    yield f"    type: {entry.type_name}"
    yield f"    to: {entry.to}"
    yield from _with_reasons([(f"    {key}: {value}", why) for key, (value, why) in entry.settings.items()])
    if entry.limits:
        yield "    limits:"
        limits = entry.limits.items()
        yield from _with_reasons([(f"      {_key(path)}: {most}", why) for path, (most, why) in limits])


def _key(path: str) -> str:
    # The field `true` of a message is a name, and no truth.
    return json.dumps(path) if path.lower() in ("null", "true", "false") else path


def _with_reasons(rows: Sequence[tuple[str, str]]) -> Iterator[str]:
    width = max((len(text) for text, why in rows if why), default=0)
    for text, why in rows:
        yield f"{text.ljust(width)}  # {one_line(why)}" if why else text


def _comment(text: str, indent: int = 0) -> list[str]:
    start = " " * indent + "# "
    # Names come from the network: none may end the comment and begin a line.
    return textwrap.wrap(
        one_line(text), _WIDTH, initial_indent=start, subsequent_indent=start, break_on_hyphens=False
    )


@dataclass(frozen=True)
class Draft:
    """The content of a new configuration.

    ``entries`` are in the file's order: topics to the PLC first, then by name. By topic: ``seen``, the
    measurements of its messages, and ``left_out``, the reason for leaving it out. By type: ``definitions``,
    the texts that must be saved, and ``origins``, their sources.
    """

    entries: tuple[Entry, ...]
    seen: Mapping[str, Seen]
    left_out: Mapping[str, str]
    definitions: Mapping[str, str]
    origins: Mapping[str, str]


def draft(
    source: Source,
    chosen: Mapping[str, Chosen],
    *,
    seconds: float,
    progress: Callable[[str], None] = lambda words: None,
) -> Draft:
    """Learn types, listen for ``seconds`` (0: not at all), and propose entries.

    ``progress`` is called about once per second with a text that shows the progress. Raises RosplcError if a
    topic that the user named cannot be carried.
    """
    left_out: dict[str, str] = {}

    @contextmanager
    def or_left_out(name: str, each: Chosen) -> Iterator[None]:
        try:
            yield
        except RosplcError as error:
            if each.named:
                raise
            left_out[name] = f"{error.what}. {error.remedy}"

    for name, each in chosen.items():
        with or_left_out(name, each):
            source.learn(name, each.type_name)
    known = {name: each for name, each in chosen.items() if name not in left_out}
    # What nobody publishes, and no bridge sent, has nothing to be heard.
    heard = {name: each for name, each in known.items() if each.topic.publishers or each.topic.carried}
    wanted = {name: each.type_name for name, each in heard.items()}
    seen = source.listen(wanted, seconds, progress) if seconds > 0 and wanted else {}
    store = source.definitions.store
    entries = []
    for name, each in known.items():
        topic = source.found.topics.get(name, each.topic)
        with or_left_out(name, each):
            entries.append(propose(topic, each.type_name, each.to, store, seen.get(name)))
    entries.sort(key=lambda entry: (entry.to != "plc", entry.topic))
    used = {part for entry in entries for part in store.dependencies(entry.type_name)}
    definitions = {name: text for name, text in source.definitions.texts.items() if name in used}
    origins = {name: source.definitions.origins[name] for name in definitions}
    return Draft(tuple(entries), seen, left_out, definitions, origins)


def save(
    source: Source,
    made: Draft,
    path: Path,
    *,
    bridge: str,
    folders: Sequence[Path] = (),
    force: bool = False,
    calls: bool = False,
) -> tuple[str, tuple[Path, ...]]:
    """Write definitions, the configuration and its JSON Schema; return its text and the definitions' files.

    ``path`` is that of the configuration; definitions go into the folder ``msg`` beside it. ``calls`` as for
    :func:`configuration`. Raises ConfigError CFG013, CFG014; MessageTypeError TYP009, a definition cannot be
    saved.
    """
    beside = path.parent / "msg"
    files = save_definitions(made.definitions, beside) if made.definitions else ()
    base, names = path.parent.resolve(), ["msg"] if files else []
    full = [folder.resolve() for folder in folders]
    names = [str(each.relative_to(base) if each.is_relative_to(base) else each) for each in full] + names
    date = time.strftime("%Y-%m-%d")
    text = configuration(source.found, made.entries, bridge=bridge, folders=names, date=date, calls=calls)
    # What is wrong is a defect of the proposal, or of the user's own folders.
    resolve(parse_config(text, name="<proposal>", base=path.parent))
    write_file(path, text, force=force)
    with suppress(OSError):  # only the editor's help is missing then
        (path.parent / SCHEMA).write_text(json.dumps(json_schema(), indent=1) + "\n", encoding="utf-8")
    return text, files
