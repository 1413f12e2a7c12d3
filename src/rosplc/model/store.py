"""The types that are known: a distribution's own, and custom ones added to it."""

from __future__ import annotations

import difflib
import hashlib
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from rosplc.errors import MessageTypeError
from rosplc.model._rosbags import DISTROS
from rosplc.model.bundled import bundled
from rosplc.model.folders import parse_paths
from rosplc.model.hashes import ROS1_TIMES, md5_text, rihs01
from rosplc.model.literals import format_value
from rosplc.model.parse import ParsedType, full_name, parse_definition
from rosplc.model.types import Constant, Field, MessageType, NamedType, PrimitiveType

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

__all__ = ["DISTROS", "MAX_DEPTH", "TypeStore"]

MAX_DEPTH = 32  # Deepest nesting of message types.

_TIME_FIELDS = (Field("sec", PrimitiveType("int32")), Field("nanosec", PrimitiveType("uint32")))
_BUILTIN = {name: MessageType(name, _TIME_FIELDS) for name in ROS1_TIMES}


class TypeStore:
    """Message types by name; never changes, adding types makes a new store.

    Attributes:
        distro: The ROS distribution whose definitions it starts from, or what a
            self-description says; empty if unknown.
        ros_version: 1 or 2.
    """

    def __init__(self, distro: str, types: Mapping[str, MessageType]) -> None:
        self.distro = distro
        self.ros_version = 1 if distro == "noetic" else 2
        self._types = dict(types)
        self._md5: dict[str, str] = {}
        self._heights: dict[str, int] = {}  # of the types whose needs have been found sound
        self._broken: dict[str, MessageTypeError] = {}
        self._parsed: dict[str, ParsedType] = {}  # where types that were added are defined
        self._nameless: list[MessageTypeError] = []

    @classmethod
    def bundled(cls, distro: str) -> TypeStore:
        """Return the types that come with a ROS distribution.

        Raises:
            MessageTypeError: TYP006, no such distribution is bundled.
        """
        if distro not in DISTROS:
            near = difflib.get_close_matches(distro, DISTROS, 1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise MessageTypeError("TYP006", f"{distro!r} is none of {', '.join(DISTROS)}{hint}")
        return _bundled(distro)

    @classmethod
    def from_definition(cls, type_name: str, text: str, *, distro: str = "") -> TypeStore:
        """Rebuild a type from a self-description's text, which is not trusted.

        Args:
            type_name: The type that the text defines first.
            text: The definition with every type it needs (spec/type-mapping.md, section 6).
            distro: What the self-description says; only ``noetic`` means ROS 1.

        Raises:
            MessageTypeError: TYP001 a needed type is missing, TYP002 syntax, TYP003, TYP004,
                TYP005, TYP007 limits.
        """
        return cls(distro, {}).with_definition(type_name, text)

    def with_definition(self, type_name: str, text: str) -> TypeStore:
        """Return a store that knows the types of a definition text as well.

        Raises:
            MessageTypeError: See :meth:`from_definition`.
        """
        return self._with(parse_definition(type_name, text, ros_version=self.ros_version))

    def with_paths(self, paths: Iterable[Path]) -> TypeStore:
        """Return a store that knows the custom types below these folders as well.

        The folders may need each other, in any order. A type with a mistake, or with another definition
        elsewhere, is an error when it is used: a folder of a whole workspace will do.

        Args:
            paths: Folders with ``package/msg/Name.msg`` or ``package/Name.msg``, folders of a
                package, or single ``.msg`` files.

        Raises:
            MessageTypeError: TYP008, a path cannot be read.
        """
        parsed, broken, nameless = parse_paths(map(Path, paths), self.ros_version)
        merged = self._copy()
        merged._nameless += nameless
        for one in parsed:
            try:
                merged._merge(one)
            except MessageTypeError as error:
                broken.setdefault(one.message.name, error)
        merged._broken.update(broken)
        return merged

    def __getitem__(self, name: str) -> MessageType:
        """Return a type by ``package/msg/Name`` or ``package/Name``.

        Raises:
            MessageTypeError: TYP001 if it is unknown; for a custom type also what is wrong with it or with
                a type that it needs (TYP001 … TYP007), with file and line.
        """
        if name not in self._heights:
            if not (isinstance(name, str) and name.isidentifier()):
                name = full_name(name)
            self._visit(name, self._heights, (), "")
        return self._types[name]

    def __contains__(self, name: object) -> bool:
        try:
            return isinstance(name, str) and full_name(name) in self._types
        except MessageTypeError:
            return False

    def __len__(self) -> int:
        return len(self._types)

    def names(self) -> tuple[str, ...]:
        """Return the full names of all types that can be used, sorted."""
        return tuple(sorted(name for name in self._types if self._error(name) is None))

    def problems(self) -> tuple[MessageTypeError, ...]:
        """Return what is wrong with custom types and their files; none of it matters until a type is used."""
        found = (self._error(name) for name in sorted({*self._parsed, *self._broken}))
        return (*self._nameless, *filter(None, found))

    def _error(self, name: str) -> MessageTypeError | None:
        try:
            self._visit(name, self._heights, (), "")
        except MessageTypeError as error:
            return error
        return None

    def dependencies(self, name: str) -> tuple[str, ...]:
        """Return every type that ``name`` needs, each after those it needs, itself last."""
        order: dict[str, int] = {}
        self._visit(self[name].name, order, (), "")
        return tuple(order)

    def definition_text(self, name: str) -> str:
        """Return the definition with every type it needs (spec/type-mapping.md, section 6)."""
        first = self[name]
        order: dict[str, None] = {}
        self._collect(first.name, order)
        parts = [self._text(first)]
        for other in list(order)[1:]:
            parts.append(f"{'=' * 80}\nMSG: {_short(other)}\n{self._text(self._types[other])}")
        return "".join(parts)

    def type_hash(self, name: str) -> str:
        """Return ROS 2's type hash, ``RIHS01_…``."""
        *others, own = self.dependencies(name)
        return rihs01(self._types[own], [self._types[other] for other in others])

    def md5(self, name: str) -> str:
        """Return ROS 1's MD5 sum of the type, as 32 hexadecimal digits."""
        for other in self.dependencies(name):
            if other not in self._md5:
                text = md5_text(self._types[other], self._md5.__getitem__)
                self._md5[other] = hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
        return self._md5[self[name].name]

    def _copy(self) -> TypeStore:
        copy = TypeStore(self.distro, self._types)
        copy._broken, copy._parsed = dict(self._broken), dict(self._parsed)
        copy._nameless = list(self._nameless)
        return copy

    def _with(self, found: list[ParsedType]) -> TypeStore:
        merged = self._copy()
        for parsed in found:
            merged._merge(parsed)
        for parsed in found:
            merged._visit(parsed.message.name, merged._heights, (), parsed.where)
        return merged

    def _merge(self, parsed: ParsedType) -> None:
        """Add a definition; TYP005 if it differs from the one known."""
        new = parsed.message
        old = self._types.get(new.name)
        if old is not None and not _same_shape(old, new):
            known = self._parsed.get(new.name)
            other = known.where if known else f"{self.distro}'s own" if self.distro else "the one known"
            raise MessageTypeError(
                "TYP005", f"this definition of {new.name} differs from {other}", where=parsed.where
            )
        # A text off the wire has lost its default values: keep those that are known.
        if old is None or any(f.default is not None for f in new.fields):
            self._types[new.name] = new
            self._parsed[new.name] = parsed
        # ROS 1 texts say `time` and give no definition of it.
        for needed in new.needs:
            if needed in _BUILTIN:
                self._types.setdefault(needed, _BUILTIN[needed])

    def _unknown(self, name: str) -> str:
        base = name.rsplit("/", 1)[-1].lower()
        same = [other for other in self._types if other.rsplit("/", 1)[1].lower() == base]
        near = difflib.get_close_matches(name, same, 1, 0) or difflib.get_close_matches(name, self._types, 1)
        hint = f"; did you mean {near[0]}?" if near else ""
        if self._nameless and not near:
            hint = f"; {self._nameless[0].where} was not read: {self._nameless[0].what}"
        return f"{name} is unknown{f' in {self.distro}' if self.distro else ''}{hint}"

    def _remedy(self, name: str) -> str:
        package = name.partition("/")[0]
        if any(other.startswith(f"{package}/") for other in self._types):
            return f"`rosplc types {package}` lists the package's types; add others' folder to types.paths."
        return (
            f"Check the spelling with `rosplc types`. Package {package} is not bundled: add its folder to "
            f"types.paths (`--path` of `rosplc types`); ROS installs it as /opt/ros/DISTRO/share/{package}."
        )

    def _visit(self, name: str, heights: dict[str, int], above: tuple[str, ...], where: str) -> int:
        """Return how deep a type is nested; ``heights`` fills in order of dependency."""
        if name in heights:
            return heights[name]
        if name in self._broken:
            raise self._broken[name]
        if name not in self._types:
            short = name[:80]
            raise MessageTypeError("TYP001", self._unknown(short), where=where, remedy=self._remedy(short))
        if name in above:
            cycle = " → ".join((*above[above.index(name) :], name))
            raise MessageTypeError("TYP003", cycle, where=where)
        message, parsed = self._types[name], self._parsed.get(name)
        places = parsed.field_lines if parsed else (where,) * len(message.fields)
        below = [0]
        # The check on the way down bounds the recursion, the one on the way up is exact.
        if len(above) <= MAX_DEPTH:
            needed: dict[str, str] = {}
            for field, place in zip(message.fields, places, strict=True):
                if isinstance(kind := field.type.inner, NamedType):
                    needed.setdefault(kind.name, place)
            below += [self._visit(other, heights, (*above, name), place) for other, place in needed.items()]
        heights[name] = 1 + max(below)
        if heights[name] > MAX_DEPTH or len(above) >= MAX_DEPTH:
            del heights[name]
            raise MessageTypeError("TYP007", f"types are nested deeper than {MAX_DEPTH}", where=where)
        return heights[name]

    def _collect(self, name: str, order: dict[str, None]) -> None:
        """Add ``name`` and what it needs in order of first use, depth first."""
        order[name] = None
        for other in self._types[name].needs:
            if other not in order and not (self.ros_version == 1 and other in ROS1_TIMES):
                self._collect(other, order)

    def _text(self, message: MessageType) -> str:
        lines = [f"{c.type} {c.name}={self._constant_text(c)}" for c in message.constants]
        for field in message.fields:
            kind, text = field.type.inner, str(field.type)
            if isinstance(kind, NamedType):
                short = ROS1_TIMES.get(kind.name) if self.ros_version == 1 else None
                text = text.replace(kind.name, short or _short(kind.name))
            default = "" if field.default is None else f" {format_value(field.default)}"
            lines.append(f"{text} {field.name}{default}")
        return "".join(f"{line}\n" for line in lines)

    def _constant_text(self, constant: Constant) -> str:
        if self.ros_version == 1:
            return constant.text
        return format_value(constant.value) if isinstance(constant.value, str) else constant.text


def _short(name: str) -> str:
    return name.replace("/msg/", "/")


def _same_shape(one: MessageType, other: MessageType) -> bool:
    fields = [[(f.name, f.type) for f in m.fields] for m in (one, other)]
    return fields[0] == fields[1] and set(one.constants) == set(other.constants)


@cache
def _bundled(distro: str) -> TypeStore:
    return TypeStore(distro, bundled(distro))
