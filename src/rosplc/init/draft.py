"""From chosen topics to the file: definitions, listening, proposals, text, in this order."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rosplc.config import json_schema
from rosplc.errors import RosplcError
from rosplc.init.found import Seen, Source
from rosplc.init.propose import Entry, propose
from rosplc.init.select import Chosen
from rosplc.init.write import SCHEMA, check_text, configuration, write_file
from rosplc.model import save_definitions

__all__ = ["Draft", "draft", "save"]


@dataclass(frozen=True)
class Draft:
    """What a configuration will say.

    Attributes:
        entries: The topics in the file's order: towards the PLC first, then by name.
        seen: What the messages of each topic were like.
        left_out: Why a topic is not among them, by name.
        definitions: Definition text by type, of the types in use that must be saved.
        origins: Where each of them comes from.
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
    """Learn types, listen, and propose.

    Args:
        source: The robot or the recording.
        chosen: The topics by name.
        seconds: How long to listen; 0: not at all.
        progress: Called about once a second with how far it is, in words.

    Raises:
        RosplcError: A topic that the user named cannot be carried.
    """
    left_out: dict[str, str] = {}
    known: dict[str, Chosen] = {}
    for name, each in chosen.items():
        try:
            source.learn(name, each.type_name)
        except RosplcError as error:
            if each.named:
                raise
            left_out[name] = f"{error.what}. {error.remedy}"
        else:
            known[name] = each
    # What nobody publishes, and no bridge sent, has nothing to be heard.
    wanted = {
        name: each.type_name for name, each in known.items() if each.topic.publishers or each.topic.carried
    }
    seen: dict[str, Seen] = {}
    if seconds > 0 and wanted:
        seen = source.listen(wanted, seconds, progress)
    store = source.definitions.store
    entries = []
    for name, each in known.items():
        topic = source.found.topics.get(name, each.topic)
        try:
            entries.append(propose(topic, each.type_name, each.to, store, seen.get(name)))
        except RosplcError as error:
            if each.named:
                raise
            left_out[name] = f"{error.what}. {error.remedy}"
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
) -> tuple[str, tuple[Path, ...]]:
    """Write definitions, configuration and its JSON Schema; return the text and the definitions' files.

    Args:
        source: The robot or the recording.
        made: What the configuration says.
        path: The configuration; definitions go into the folder ``msg`` beside it.
        bridge: The bridge's name.
        folders: The user's own folders with ``.msg`` files.
        force: Replace a configuration that is there.

    Raises:
        ConfigError: CFG013, CFG014.
        MessageTypeError: TYP009, a definition cannot be saved.
    """
    beside = path.parent / "msg"
    files = save_definitions(made.definitions, beside) if made.definitions else ()
    names = [_relative(folder, path.parent) for folder in folders] + (["msg"] if files else [])
    text = configuration(
        source.found, made.entries, bridge=bridge, folders=names, date=time.strftime("%Y-%m-%d")
    )
    check_text(text, path.parent)
    write_file(path, text, force=force)
    with suppress(OSError):  # only the editor's help is missing then
        (path.parent / SCHEMA).write_text(json.dumps(json_schema(), indent=1) + "\n", encoding="utf-8")
    return text, files


def _relative(folder: Path, base: Path) -> str:
    full = folder.resolve()
    try:
        return str(full.relative_to(base.resolve()))
    except ValueError:
        return str(full)
