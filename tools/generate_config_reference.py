"""Write docs/reference/configuration.md from the models of the settings; ``--verify`` only compares."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from generated_page import REFERENCE, filled, run
from rosplc.config.file import json_schema

PAGE = REFERENCE / "configuration.md"
PLAIN = ("types", "limits", "shm", "diagnostics", "rosout", "time", "realtime")
SECTIONS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("ros", "", ("zenoh", "rclpy")),
    *((name, "", ()) for name in PLAIN),
    ("tasks", " (each)", ()),
    ("topics", " (each)", ("qos", "on_stale", "classic")),
    ("services", " (each)", ("clients",)),
    ("actions", " (each)", ()),
    ("parameters", "", ("declare",)),
    ("transforms", " (each)", ()),
)
MODELS = {
    "declare": "ParameterSettings",
    "clients": "ClientSettings",
    "qos": "QosSettings",
    "on_stale": "OnStaleSettings",
    "classic": "ClassicSettings",
}


def _type(schema: dict[str, Any], definitions: dict[str, Any]) -> str:
    if "$ref" in schema:
        return "keys below"
    if "anyOf" in schema or "oneOf" in schema:
        parts = schema.get("anyOf") or schema["oneOf"]
        kinds = [_type(part, definitions) for part in parts if part.get("type") != "null"]
        return " or ".join(dict.fromkeys(kinds))
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        return ", ".join(f"`{word}`" for word in schema["enum"])
    kind = schema.get("type", "")
    if kind == "array":
        return "list of numbers" if "number" in str(schema.get("items")) else "list of text"
    if kind == "object":
        if "$ref" in str(schema):
            return "keys below"
        if schema.get("additionalProperties") is True:
            return "field: value"
        return "field path: number" if "integer" in str(schema.get("additionalProperties")) else "name: text"
    if kind == "integer":
        low, high = schema.get("minimum"), schema.get("maximum")
        return "whole number" if low is None else f"{low} … {high}" if high is not None else f"from {low}"
    if kind == "boolean":
        return "`true`, `false`"
    if not kind:
        return "value"
    pattern = schema.get("pattern", "")
    if "Hz" in pattern:
        return "rate or duration" if "ms" in pattern else "rate"
    return "duration" if "|ms|" in pattern else "text"


def _default(value: Any) -> str:
    if value is None or value in ({}, [], ""):
        return ""
    return f"`{str(value).lower()}`" if isinstance(value, bool) else f"`{value}`"


def _rows(model: dict[str, Any], definitions: dict[str, Any]) -> Iterator[str]:
    yield "| key | value | default | meaning |"
    yield "| --- | --- | --- | --- |"
    for key, value in model["properties"].items():
        default = "**required**" if key in model.get("required", ()) else _default(value.get("default"))
        if key == "tasks":
            default = "`RosTask`"
        yield f"| `{key}` | {_type(value, definitions)} | {default} | {value.get('description', '')} |"


def _model_of(value: dict[str, Any]) -> str:
    text = str(value)
    return text.split("#/$defs/")[1].split("'")[0]


def parts() -> dict[str, str]:
    """Return the page's generated part."""
    schema = json_schema()
    definitions = schema["$defs"]
    lines: list[str] = []

    def section(heading: str, model: dict[str, Any]) -> None:
        about = [f"{model['description']}\n"] if model is not schema else []
        lines.extend([f"\n{heading}\n", *about, *_rows(model, definitions)])

    section("## The file", schema)
    for name, each, own in SECTIONS:
        model = definitions[_model_of(schema["properties"][name])]
        section(f"## `{name}`{each}", model)
        for key in own:
            section(f"### `{key}`", definitions[MODELS.get(key) or _model_of(model["properties"][key])])
    return {"keys": "\n".join(lines)}


if __name__ == "__main__":
    raise SystemExit(run(__doc__, {PAGE: filled(PAGE, parts())}))
