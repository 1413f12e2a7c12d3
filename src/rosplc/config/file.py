"""From a configuration file to settings: every error with its line, all of them at once."""

from __future__ import annotations

import logging
import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union, get_args, get_origin

from rosplc.config.yaml_source import KeyPath, Problems, YamlSource, did_you_mean, read_yaml
from rosplc.errors import ConfigError

if TYPE_CHECKING:
    from rosplc.config.settings import Settings

RENAMED = {"rate": "expected_rate", "depth": "slots"}
"""Keys of a topic that 0.1.0 called otherwise; they work, with a warning, until 0.3.0."""

log = logging.getLogger("rosplc.config")
_MOST_WARNINGS = 5
_MAY_CHANGE = {"topics", "services", "actions", "transforms", "limits", "types", "tasks", "programs"}


LEARNT = "learned_types"
"""The folder beside a configuration with the definitions that a bridge has learnt from other nodes."""


@dataclass(frozen=True)
class Config:
    """Settings together with the file that they come from."""

    settings: Settings  # what the file says, defaults filled in
    # the file's keys and lines, to name a place in later errors
    source: YamlSource = field(default_factory=lambda: YamlSource("<settings>"), repr=False)
    base: Path = field(default_factory=Path)  # the folder that relative paths refer to
    fixed: Mapping[str, Any] = field(default_factory=dict)  # what cannot change in a running bridge, by key

    @property
    def path(self) -> Path | None:
        """The file, or None where the settings come from elsewhere."""
        return None if self.source.name.startswith("<") else Path(self.source.name)

    @property
    def type_folders(self) -> tuple[Path, ...]:
        """The folders of ``types.paths``, and :data:`LEARNT` beside the file if it has definitions."""
        learnt = self.base / LEARNT
        found = [learnt] if any(learnt.glob("*/msg/*.msg")) else []
        return (*(self.base / folder for folder in self.settings.types.paths), *found)

    def task(self, asked: str | None, key: KeyPath, problems: Problems) -> str:
        """Return a task's name, without one the first; note at a key path that there is none of this name."""
        tasks = self.settings.tasks
        if asked is not None and asked not in tasks:
            problems.wrong(self.source, key, f"task {asked!r} is not defined; tasks: {', '.join(tasks)}")
        return asked or next(iter(tasks))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], *, base: Path | None = None) -> Config:
        """Return what a file with this content gives; ConfigErrors as :func:`read_config`, at key paths."""
        return _validate(YamlSource("<settings>", dict(data)), base or Path(), Problems())


def read_config(path: Path | str) -> Config:
    """Read and validate a file, except its types. Raises ConfigErrors CFG001 … CFG006, CFG009, CFG010."""
    return _parse(Path(path), None, Path(path).parent)


def parse_config(text: str, *, name: str = "<text>", base: Path | None = None) -> Config:
    """Validate YAML text as :func:`read_config` does; ``base`` is the folder that relative paths refer to."""
    return _parse(Path(name), text, base or Path())


_BY_NAME = ("tasks", "topics", "services", "actions", "transforms")


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a configuration file, for editors."""
    from rosplc.config.settings import Settings

    schema = Settings.model_json_schema(by_alias=True)
    _allow_short_forms(schema)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "rosplc configuration",
        "description": "The configuration of a bridge between ROS topics and a soft-PLC.",
    }


def _allow_short_forms(schema: dict[str, Any]) -> None:
    from rosplc.config.settings import MOST_CLIENTS

    # Validators accept these before pydantic looks, so its schema does not show them.
    qos = schema["$defs"]["TopicSettings"]["properties"]["qos"]
    reference = {"$ref": qos.pop("$ref")} if "$ref" in qos else {"allOf": qos.pop("allOf")}
    qos["anyOf"] = [reference, {"enum": ["default", "sensor_data", "latched"], "type": "string"}]
    classic = schema["$defs"]["TopicSettings"]["properties"]["classic"]
    classic["anyOf"] = [{"type": "boolean"}, *classic["anyOf"]]
    for kind in ("ServiceSettings", "ActionSettings"):
        clients = schema["$defs"][kind]["properties"]["clients"]
        told = {key: clients.pop(key) for key in ("default", "description", "title") if key in clients}
        group, names = dict(clients), {"type": "string", "pattern": next(iter(clients["patternProperties"]))}
        listed = {"type": "array", "items": names, "uniqueItems": True, "maxItems": MOST_CLIENTS}
        clients.clear()
        clients |= {**told, "anyOf": [{**group, "additionalProperties": False}, listed]}
    for name in _BY_NAME:
        schema["properties"][name]["additionalProperties"] = False  # names that miss the pattern
    for name, value in schema["properties"].items():
        if "$ref" in value or name in _BY_NAME:
            lifted = {key: value.pop(key) for key in ("default", "description", "title") if key in value}
            schema["properties"][name] = {"anyOf": [value, {"type": "null"}], **lifted}


def _parse(path: Path, text: str | None, base: Path) -> Config:
    problems = Problems()
    try:
        source = read_yaml(path, problems, text=text)
    except ConfigError as error:
        problems.add(error)
        problems.fail()
    return _validate(source, base, problems)


def _validate(source: YamlSource, base: Path, problems: Problems) -> Config:
    # A bridge reads its file in another process, and does without pydantic.
    from pydantic import ValidationError

    from rosplc.config.settings import Settings

    data = {} if source.data is None else source.data
    if not isinstance(data, dict):
        what = "the file must contain keys such as topics:, not a list or a string"
        problems.add(ConfigError("CFG004", what, where=source.name))
        problems.check()
    data = _with_new_names(data, source, problems)
    try:
        settings = Settings.model_validate(data)
    except ValidationError as error:
        for item in error.errors(include_url=False):
            path = _real_path(item["loc"], source)
            problems.add(_explain(dict(item), path, source), source.line(path))
        problems.fail()
    problems.check()
    fixed = settings.model_dump(mode="json", by_alias=True, exclude=_MAY_CHANGE)
    return Config(settings, source, base, fixed)


def _old_keys(data: Any) -> list[tuple[str, str]]:
    """Return the topics and keys with a name from before."""
    topics = data.get("topics") if isinstance(data, dict) else None
    entries = topics.items() if isinstance(topics, dict) else ()
    return [
        (topic, key) for topic, entry in entries if isinstance(entry, dict) for key in entry if key in RENAMED
    ]


def _with_new_names(data: dict[str, Any], source: YamlSource, problems: Problems) -> dict[str, Any]:
    """Return the data with today's keys; warn of each that has another name by now."""
    found = _old_keys(data)
    if not found:
        return data
    topics = dict(data["topics"])
    for number, (topic, old) in enumerate(found):
        new, path = RENAMED[old], ("topics", topic, old)
        if new in topics[topic]:
            what = f"{old!r} is the former name of {new!r}, which is also set; remove {old!r}"
            problems.add(source.wrong(path, what, code="CFG010"), source.line(path))
        topics[topic] = {(new if key == old else key): value for key, value in topics[topic].items()}
        source.lines[("topics", topic, new)] = source.line(path)
        if number < _MOST_WARNINGS:
            log.warning(
                "%s is now called %s; `rosplc check --fix` rewrites the file", source.place(path), new
            )
    if len(found) > _MOST_WARNINGS:
        log.warning("%s: %d more keys have been renamed", source.name, len(found) - _MOST_WARNINGS)
    return {**data, "topics": topics}


def rename_keys(text: str, *, name: str = "<text>") -> tuple[str, list[str]]:
    """Return the text with keys' present names, and changes with their lines; ConfigErrors: it is no YAML."""
    problems = Problems()
    source = read_yaml(Path(name), problems, text=text)
    done = []
    starts = {("topics", topic, old): old for topic, old in _old_keys(source.data)}
    for path in sorted(starts, key=lambda path: source.starts[path], reverse=True):
        old, at = starts[path], source.starts[path]
        at += text[at] in "'\""
        if text[at : at + len(old)] != old or RENAMED[old] in source.data["topics"][path[1]]:
            continue  # written with an escape sequence, or twice: left to its author
        text = text[:at] + RENAMED[old] + text[at + len(old) :]
        done.append(f"{source.place(path)}: renamed to {RENAMED[old]}")
    return text, done[::-1]


def _real_path(loc: tuple[str | int, ...], source: YamlSource) -> KeyPath:
    """Drop the parts of pydantic's location that are no keys: branches of unions, ``[key]``."""
    path: KeyPath = ()
    data = source.data
    for index, part in enumerate(loc):
        inside = (isinstance(data, dict) and part in data) or (
            isinstance(data, list) and isinstance(part, int) and part < len(data)
        )
        if inside:
            data = data[part]
        elif index != len(loc) - 1 or not isinstance(data, dict) or part == "[key]":
            continue
        path = (*path, part)
    return path


def _explain(item: dict[str, Any], path: KeyPath, source: YamlSource) -> ConfigError:
    kind, value, context = item["type"], item.get("input"), item.get("ctx", {})
    if kind == "extra_forbidden":
        hint = did_you_mean(str(path[-1]), _keys_at(path[:-1]))
        return source.wrong(path, f"{path[-1]!r} is not a valid key here{hint}", code="CFG003")
    if kind == "missing":
        remedy = _MISSING.get(str(path[-1]), "")
        remedy = remedy.replace("/msg/", _FOLDERS.get(str(path[0]), "/msg/"))
        return source.wrong(path, f"{path[-1]!r} is missing", remedy, "CFG005")
    if kind == "literal_error":
        known = [word.strip(" '") for word in context["expected"].replace(" or ", ", ").split(", ")]
        hint = did_you_mean(str(value), known)
        listed = "" if hint.startswith("; known") else f" Known: {', '.join(known)}"
        return source.wrong(path, f"{value!r} is not valid{hint}{listed}")
    if kind == "value_error":
        return source.wrong(path, str(context["error"]))
    if kind in _SHAPES:
        return source.wrong(path, f"{_show(value)} should be {_SHAPES[kind]}")
    text = item["msg"].replace("Input should be", f"{_show(value)} should be")
    return source.wrong(path, text[0].lower() + text[1:])


_FOLDERS = {"services": "/srv/", "actions": "/action/"}
_MISSING = {
    "to": "Add `to: plc` for messages from ROS to the PLC, or `to: ros` for the other direction.",
    "type": "Add `type: package/msg/Name`; `rosplc types` lists the types.",
    "server": "Add `server: ros` if the PLC is the client, or `server: plc` if the PLC is the server.",
}
_SHAPES = {
    "model_type": "a group of keys",
    "dict_type": "a group of keys",
    "int_type": "a whole number",
    "string_type": "text; put it in quotes",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "tuple_type": "a list, such as [./msg]",
}


def _show(value: Any) -> str:
    if isinstance(value, (dict, list, tuple)):
        return "a group of keys" if isinstance(value, dict) else "a list"
    return "an empty value" if value is None else repr(value)


def _keys_at(path: KeyPath) -> Iterator[str]:
    """Yield the keys that the settings have at a path."""
    from pydantic import BaseModel

    from rosplc.config.settings import Settings

    current: Any = Settings
    for part in path:
        if isinstance(current, type) and issubclass(current, BaseModel):
            field_ = next((f for name, f in current.model_fields.items() if (f.alias or name) == part), None)
            current = _inner(field_.annotation) if field_ else None
        elif get_origin(current) is dict:
            current = _inner(get_args(current)[1])
    if isinstance(current, type) and issubclass(current, BaseModel):
        for name, f in current.model_fields.items():
            yield f.alias or name


def _inner(annotation: Any) -> Any:
    """Return what stands inside ``X | None`` and ``Annotated[X, …]``."""
    while get_origin(annotation) is not None and get_origin(annotation) is not dict:
        if get_origin(annotation) in (Union, types.UnionType):
            annotation = next(arg for arg in get_args(annotation) if arg is not type(None))
        else:
            annotation = get_args(annotation)[0]
    return annotation
