"""The kinds, names and self-descriptions of objects: spec/shm-format.md, 6, 8.1, 11.1."""

from __future__ import annotations

import enum
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

from rosplc.shm import constants as spec
from rosplc.shm.constants import Direction
from rosplc.shm.header import Identity, channel_error, layout_id_words

_PREFIX = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,31}")
_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_CLIENT = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")


class Part(enum.Enum):
    """The kind of messages in an object; the value is the word ``kind`` in its identity."""

    TOPIC = spec.KIND_TOPIC
    REQUEST = spec.KIND_REQUEST
    RESPONSE = spec.KIND_RESPONSE
    GOAL = spec.KIND_GOAL
    RESULT = spec.KIND_RESULT
    FEEDBACK = spec.KIND_FEEDBACK

    def __init__(self, number: int) -> None:
        self.word = self.name.lower()  # ``"topic"``, ``"request"`` ...: as self-descriptions have it
        # ``"topic"``, ``"service"`` or ``"action"``
        self.kind = {1: "topic", 2: "service", 3: "action"}[number & 0xFF]
        letter = {"request": "q", "response": "r", "goal": "g", "result": "r", "feedback": "f"}
        self.letters = self.kind[0] + letter.get(self.word, "")  # in the object's name
        # whether the caller writes it: the request of a service, the goal of an action
        self.asks = number in (spec.KIND_REQUEST, spec.KIND_GOAL)

    def direction(self, server: Literal["plc", "ros"]) -> Direction:
        """Return the direction of a service's or action's object, depending on where its server is."""
        return Direction.TO_PLC if self.asks == (server == "plc") else Direction.TO_ROS


SERVICE = (Part.REQUEST, Part.RESPONSE)
ACTION = (Part.GOAL, Part.RESULT, Part.FEEDBACK)


class Call:
    """A use of a service or action; the attribute named like its kind has its ROS name."""

    kind: ClassVar[Literal["service", "action"]]
    client: str

    @property
    def called(self) -> str:
        """The ROS name of the service or action."""
        return str(getattr(self, self.kind))

    @property
    def name(self) -> str:
        """The unique display name: the kind, the ROS name and the client."""
        return f"{self.kind} {self.called} {self.client}".rstrip()


def fnv1a(text: str) -> int:
    """Return the 32-bit FNV-1a hash of an ASCII text."""
    value = spec.FNV_OFFSET
    for byte in text.encode("ascii"):
        value = (value ^ byte) * spec.FNV_PRIME & 0xFFFFFFFF
    return value


@dataclass(frozen=True)
class Namespace:
    """The names of one bridge: a prefix in a directory. Raises SHM118 if the prefix is not valid."""

    prefix: str = "rosplc"  # keeps several bridges of one machine apart
    directory: Path | str = "/dev/shm"  # where the objects lie; anything but ``/dev/shm`` is for tests

    def __post_init__(self) -> None:
        if not _PREFIX.fullmatch(self.prefix):
            raise channel_error(118, f"prefix {self.prefix!r} does not match {_PREFIX.pattern}")

    def object_name(self, topic: str, part: Part = Part.TOPIC, client: str = "") -> str:
        """Return the name of an object. Raises SHM118 if a name is not valid.

        ``client`` is the name of one of several uses of a service or action in the PLC, or empty.
        """
        if not _TOPIC.fullmatch(topic):
            raise channel_error(118, f"{part.kind} {topic!r} does not match {_TOPIC.pattern}")
        if client and (part is Part.TOPIC or not _CLIENT.fullmatch(client)):
            raise channel_error(118, f"client {client!r} of {topic} does not match {_CLIENT.pattern}")
        name = f"{self.prefix}.{part.letters}.{topic[1:].replace('/', '.')}{'-' * bool(client)}{client}"
        if len(name) > spec.MAX_NAME:
            name = f"{name[: spec.NAME_KEPT]}~{fnv1a(name):08x}"
        return name

    def path(self, topic: str, part: Part = Part.TOPIC, client: str = "") -> Path:
        """Return the path of an object."""
        return Path(self.directory) / self.object_name(topic, part, client)

    def lock_path(self, topic: str, part: Part = Part.TOPIC, client: str = "") -> Path:
        """Return the path of the lock file beside an object."""
        return Path(self.directory) / self._beside("l", topic, part, client)

    def temporary_prefix(self, topic: str, part: Part = Part.TOPIC, client: str = "") -> str:
        """Return the name of an object's temporary files up to the 8 random digits."""
        return self._beside("n", topic, part, client) + "."

    def topics(self) -> list[str]:
        """Return the sorted names of the topics' objects. Raises SHM123 if the directory cannot be listed."""
        return [name for name, part in self.objects() if part is Part.TOPIC]

    def objects(self) -> list[tuple[str, Part]]:
        """Return the names of all objects that are present, sorted, each with its part. Raises SHM123."""
        try:
            names = sorted(entry.name for entry in Path(self.directory).iterdir())
        except OSError as error:
            raise channel_error(123, f"cannot list files: {error.strerror}", self.directory) from error
        return [(name, part) for name in names if (part := self.part_of(name)) is not None]

    def part_of(self, object_name: str) -> Part | None:
        """Return the part of an object with this name; None if it is not an object of this prefix."""
        prefix, _, rest = object_name.partition(".")
        letters, dot, _ = rest.partition(".")
        return _LETTERS.get(letters) if dot and prefix == self.prefix else None

    def name_of(self, object_name: str) -> tuple[str, str] | None:
        """Return the topic, service or action of an object name, and the client; None if not possible."""
        part = self.part_of(object_name)
        if part is None:
            return None
        rest, hyphen, client = object_name[len(self.prefix) + len(part.letters) + 2 :].partition("-")
        name = "/" + rest.replace(".", "/")
        sound = not hyphen or (part is not Part.TOPIC and _CLIENT.fullmatch(client))
        return (name, client) if sound and _TOPIC.fullmatch(name) else None

    def _beside(self, letter: str, topic: str, part: Part, client: str) -> str:
        at = len(self.prefix) + 1
        name = self.object_name(topic, part, client)
        return name[:at] + letter + name[at + (part is Part.TOPIC) :]


class FileName(NamedTuple):
    """A parsed file name; ``role`` is ``t`` for an object, ``l`` for its lock, ``n`` for a temporary file.

    ``item`` and ``lock`` are the names of the object and its lock.
    """

    prefix: str
    role: str
    item: str
    lock: str


def file_name(name: str) -> FileName | None:
    """Parse the name of an object, lock or temporary file; None if it is none of these."""
    found = _FILE.fullmatch(name)
    if found is None:
        return None
    prefix, topic, role, letters, rest = found.groups()
    role = topic or role or "t"
    if role == "n":  # only a temporary has a suffix of its own
        rest = re.sub(r"\.[0-9a-f]{8}$", "", rest)
    return FileName(prefix, role, f"{prefix}.{letters or 't'}.{rest}", f"{prefix}.l{letters or ''}.{rest}")


_LETTERS = {part.letters: part for part in Part}
# A topic's lock and temporaries replace its letter, those of services and actions put one before theirs.
_FILE = re.compile(
    rf"({_PREFIX.pattern})\.(?:([tln])|([ln]?)({'|'.join(list(_LETTERS)[1:])}))\.(.+)", re.DOTALL
)


@dataclass(frozen=True)
class Description:
    """The data that a tool needs to read an unknown channel."""

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

    @property
    def notes(self) -> int:
        """Size in bytes of the table after the slots (section 11.6)."""
        return spec.GOAL_NOTES_SIZE if (self.part, self.direction) == (Part.GOAL, Direction.TO_PLC) else 0

    def plan(self, record_size: int, slots: int = spec.MIN_SLOTS, **made_by: Any) -> Identity:
        """Return the identity of an object with this description; ``made_by``: its creator and creation time.

        Raises ValueError as :meth:`Identity.plan`.
        """
        return Identity.plan(
            kind=self.part.value,
            direction=self.direction,
            slots=slots,
            record_size=record_size,
            description_size=len(self.to_json()),
            behind=self.notes,
            layout_id=self.layout_id,
            **{"generation": 1, "bridge_id": bytes(16)} | made_by,
        )

    def to_json(self) -> bytes:
        """Return the object's UTF-8 text. Raises ValueError if it exceeds 2²⁰ bytes."""
        members: dict[str, Any] = {"format": spec.FORMAT, **{name: getattr(self, name) for name in _MEMBERS}}
        members["direction"] = self.direction.word
        members["limits"] = dict(self.limits)
        if self.part is not Part.TOPIC:
            call = {"part": self.part.word, "client": self.client, "partners": dict(self.partners)}
            members |= {"kind": self.kind, **call, **({"notes": self.notes} if self.notes else {})}
        text = json.dumps(members, ensure_ascii=False, separators=(",", ":")).encode()
        if len(text) > spec.MAX_DESCRIPTION_SIZE:
            raise ValueError(
                f"the self-description has {len(text)} bytes; the limit is {spec.MAX_DESCRIPTION_SIZE}"
            )
        return text

    @classmethod
    def from_json(cls, text: bytes, where: str = "", part: Part = Part.TOPIC) -> Description:
        """Read the self-description of an object with this part, ignoring unknown members. Raises SHM113."""
        try:
            members = json.loads(text.decode("utf-8"))
        except (ValueError, RecursionError) as error:
            raise channel_error(113, f"the self-description is not JSON: {error}", where) from error
        if not isinstance(members, dict):
            raise channel_error(113, "the self-description is not a JSON object", where)
        values: dict[str, Any] = {}
        kinds: dict[str, type] = {"format": str, **dict.fromkeys(_MEMBERS, str), "limits": dict}
        if part is not Part.TOPIC:
            kinds |= {"kind": str, "part": str, "client": str, "partners": dict}
        for name, kind in kinds.items():
            value = members.get(name)
            if not isinstance(value, kind):
                what = f"the self-description's {name!r} is missing or not a {kind.__name__}"
                raise channel_error(113, what, where)
            values[name] = value
        if not values.pop("format").startswith("rosplc 1."):
            raise channel_error(113, "the self-description's format is not rosplc 1.x", where)
        try:
            values["direction"] = {way.word: way for way in Direction}[values["direction"]]
            for layout_id in (values["layout_id"], *values.get("partners", {}).values()):
                layout_id_words(layout_id)
        except (KeyError, TypeError, ValueError) as error:
            raise channel_error(113, f"the self-description has an invalid value: {error}", where) from error
        found = values.pop("kind", "topic"), values.pop("part", "topic")
        if found != (part.kind, part.word):
            what = f"the self-description is of a {found[0]}'s {found[1]}, not a {part.kind}'s {part.word}"
            raise channel_error(113, what, where)
        return cls(**values, part=part)


def partnered(parts: Sequence[Description]) -> list[Description]:
    """Return the descriptions of all objects of one use, each with the others' layout ids."""
    ids = {one.part.word: one.layout_id for one in parts}
    others = ({word: ids[word] for word in ids if word != one.part.word} for one in parts)
    return [replace(one, partners=ours) for one, ours in zip(parts, others, strict=True)]


_MEMBERS = [one.name for one in fields(Description) if one.name not in ("part", "client", "partners")]
