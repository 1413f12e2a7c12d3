"""The self-description inside an object: spec/shm-format.md, sections 6 and 11.1."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from rosplc.shm.constants import FORMAT, MAX_DESCRIPTION_SIZE, MIN_SLOTS, Direction
from rosplc.shm.header import Identity, channel_error, layout_id_words
from rosplc.shm.names import Part


@dataclass(frozen=True)
class Description:
    """What a tool needs to read a channel that it has never heard of."""

    topic: str  # as ROS writes it; a service's or action's name
    type: str  # ``"package/msg/Name"``
    distro: str  # the ROS distribution whose definitions were used
    direction: Direction  # which way the messages go
    limits: Mapping[str, Any]  # ``{"string": 80, "sequence": 16, "fields": {...}}``
    layout_id: str  # 16 hexadecimal digits
    bridge: str
    definition: str  # the ``.msg`` text with every type that it uses
    # what the object carries; this and the rest are written for services and actions only
    part: Part = Part.TOPIC
    client: str = ""  # the name of one of several uses in the PLC
    # the other objects' parts and layout ids: ``{"response": "0123456789abcdef"}``
    partners: Mapping[str, str] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """``"topic"``, ``"service"`` or ``"action"``."""
        return self.part.kind

    def plan(self, record_size: int, slots: int = MIN_SLOTS, **made_by: Any) -> Identity:
        """Return the identity of an object that describes itself so; ``made_by`` says who made it, and when.

        Raises ValueError as :meth:`Identity.plan`.
        """
        return Identity.plan(
            kind=self.part.value,
            direction=self.direction,
            slots=slots,
            record_size=record_size,
            description_size=len(self.to_json()),
            layout_id=self.layout_id,
            **{"generation": 1, "bridge_id": bytes(16)} | made_by,
        )

    def to_json(self) -> bytes:
        """Return the object's UTF-8 text. Raises ValueError: If it exceeds 2²⁰ bytes."""
        members: dict[str, Any] = {"format": FORMAT, **{name: getattr(self, name) for name in _MEMBERS}}
        members["direction"] = self.direction.word
        members["limits"] = dict(self.limits)
        if self.part is not Part.TOPIC:
            call = {"part": self.part.word, "client": self.client, "partners": dict(self.partners)}
            members |= {"kind": self.kind, **call}
        text = json.dumps(members, ensure_ascii=False, separators=(",", ":")).encode()
        if len(text) > MAX_DESCRIPTION_SIZE:
            raise ValueError(f"a self-description has at most {MAX_DESCRIPTION_SIZE} bytes, not {len(text)}")
        return text

    @classmethod
    def from_json(cls, text: bytes, where: str = "", part: Part = Part.TOPIC) -> Description:
        """Read the self-description of an object with this part, ignoring unknown members. Raises SHM113."""
        try:
            members = json.loads(text.decode("utf-8"))
        except (ValueError, RecursionError) as error:
            raise channel_error(113, f"self-description is not JSON: {error}", where) from error
        if not isinstance(members, dict):
            raise channel_error(113, "self-description is not a JSON object", where)
        values: dict[str, Any] = {}
        kinds: dict[str, type] = {"format": str, **dict.fromkeys(_MEMBERS, str), "limits": dict}
        if part is not Part.TOPIC:
            kinds |= {"kind": str, "part": str, "client": str, "partners": dict}
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
            for layout_id in (values["layout_id"], *values.get("partners", {}).values()):
                layout_id_words(layout_id)
        except (KeyError, TypeError, ValueError) as error:
            raise channel_error(113, f"self-description holds {error}", where) from error
        found = values.pop("kind", "topic"), values.pop("part", "topic")
        if found != (part.kind, part.word):
            what = f"self-description is a {found[0]}'s {found[1]}, the object a {part.kind}'s {part.word}"
            raise channel_error(113, what, where)
        return cls(**values, part=part)


def partnered(parts: Sequence[Description]) -> list[Description]:
    """Return the descriptions of all objects of one use, each with the layout ids of the others."""
    ids = {one.part.word: one.layout_id for one in parts}
    others = ({word: ids[word] for word in ids if word != one.part.word} for one in parts)
    return [replace(one, partners=ours) for one, ours in zip(parts, others, strict=True)]


_MEMBERS = [one.name for one in fields(Description) if one.name not in ("part", "client", "partners")]
