"""The self-description inside an object: spec/shm-format.md, section 6."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from rosplc.shm.constants import FORMAT, MAX_DESCRIPTION_SIZE, Direction
from rosplc.shm.header import channel_error, layout_id_words


@dataclass(frozen=True)
class Description:
    """What a tool needs to read a channel that it has never heard of.

    Attributes:
        topic: As ROS writes it.
        type: ``"package/msg/Name"``.
        distro: The ROS distribution whose definitions were used.
        direction: Which way the messages go.
        limits: ``{"string": 80, "sequence": 16, "fields": {...}}``.
        layout_id: 16 hexadecimal digits.
        definition: The ``.msg`` text with every type that it uses.
    """

    topic: str
    type: str
    distro: str
    direction: Direction
    limits: Mapping[str, Any]
    layout_id: str
    bridge: str
    definition: str

    def to_json(self) -> bytes:
        """Return the object's UTF-8 text. Raises ValueError: If it exceeds 2²⁰ bytes."""
        members = {"format": FORMAT, **{field.name: getattr(self, field.name) for field in fields(self)}}
        members["direction"] = self.direction.word
        members["limits"] = dict(self.limits)
        text = json.dumps(members, ensure_ascii=False, separators=(",", ":")).encode()
        if len(text) > MAX_DESCRIPTION_SIZE:
            raise ValueError(f"a self-description has at most {MAX_DESCRIPTION_SIZE} bytes, not {len(text)}")
        return text

    @classmethod
    def from_json(cls, text: bytes, where: str = "") -> Description:
        """Read a self-description; members beyond the known ones are ignored. SHM113 if it cannot be read."""
        try:
            members = json.loads(text.decode("utf-8"))
        except (ValueError, RecursionError) as error:
            raise channel_error(113, f"self-description is not JSON: {error}", where) from error
        if not isinstance(members, dict):
            raise channel_error(113, "self-description is not a JSON object", where)
        values: dict[str, Any] = {}
        kinds = {"format": str, **{field.name: str for field in fields(cls)}, "limits": dict}
        for name, kind in kinds.items():
            value = members.get(name)
            if not isinstance(value, kind):
                what = f"self-description's {name!r} is missing or not a {kind.__name__}"
                raise channel_error(113, what, where)
            values[name] = value
        if not values.pop("format").startswith("rosplc 1."):
            raise channel_error(113, "self-description's format is not rosplc 1.x", where)
        try:
            values["direction"] = {way.word: way for way in Direction}[values["direction"]]
            layout_id_words(values["layout_id"])
        except (KeyError, ValueError) as error:
            raise channel_error(113, f"self-description holds {error}", where) from error
        return cls(**values)
