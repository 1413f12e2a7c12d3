"""The types that are known: a distribution's own, and custom ones added to it.

rosbags' stores leave default values out. These were collected from every ``.msg`` file of the bundled
packages on the distributions' branches (ros2/common_interfaces, rcl_interfaces, geometry2, rosbag2,
rmw_dds_common, unique_identifier_msgs: humble, jazzy, rolling); those of kilted were compared with the
descriptions that rosidl generates (the micro-ROS libraries of hpmicro/hpm_sdk). ROS 1 has no default
values: a Quaternion's ``w`` starts as 0 there.

The messages of a desktop installation that rosbags lacks are in ``interfaces.txt``, with all services and
actions; a test compares their ROS 1 checksums.
"""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import Path

from rosplc.errors import MessageTypeError
from rosplc.model import types as kinds
from rosplc.model._rosbags import DISTROS, bundled_types
from rosplc.model.fingerprints import ROS1_TIMES, md5_text, rihs01
from rosplc.model.folders import parse_paths, read
from rosplc.model.interfaces import EVENT_INFO, PARTS, derive, describe, kind_of, owners_of, parse_interface
from rosplc.model.parse import ParsedType, format_value, full_name, parse_definition
from rosplc.model.types import ActionType, MessageType, ServiceType

_EVERY_ROS2: dict[str, dict[str, kinds.Value]] = {
    "geometry_msgs/msg/Quaternion": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    "rcl_interfaces/msg/ParameterDescriptor": {"read_only": False, "dynamic_typing": False},
}
_SINCE_JAZZY: dict[str, dict[str, kinds.Value]] = {
    **_EVERY_ROS2,
    "sensor_msgs/msg/NavSatStatus": {"status": -2},
    "type_description_interfaces/msg/FieldType": {"type_id": 0},
}

__all__ = ["DISTROS", "MAX_DEPTH", "TypeStore"]

MAX_DEPTH = 32  # Deepest nesting of message types.

_TIME_FIELDS = (
    kinds.Field("sec", kinds.PrimitiveType("int32")),
    kinds.Field("nanosec", kinds.PrimitiveType("uint32")),
)
_BUILTIN = {name: MessageType(name, _TIME_FIELDS) for name in ROS1_TIMES}
_WORDS = {"msg": "a message", "srv": "a service", "action": "an action"}


class TypeStore:
    """Message types, services and actions by name. A store never changes: adding types returns a new one.

    The messages of services and actions (``package/srv/Name_Request``, ``package/action/Name_Goal``, …) are
    available like any other message; their definitions are parsed on first use.

    Attributes:
        distro: The ROS distribution of the definitions, from a bundle or a
            self-description; empty if unknown.
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
        # Services and actions: their definitions, as text or in a file; and the messages of those asked for.
        self._interfaces: dict[str, tuple[str | Path, ...]] = {}
        self._parts: dict[str, ParsedType] = {}
        if self.ros_version == 2:
            self._parts[EVENT_INFO.name] = ParsedType(EVENT_INFO, "", ("",) * len(EVENT_INFO.fields))
        self._nameless: list[MessageTypeError] = []

    @classmethod
    def bundled(cls, distro: str) -> TypeStore:
        """Return the types of a ROS distribution; TYP006 if the distribution is not bundled."""
        if distro not in DISTROS:
            near = difflib.get_close_matches(distro, DISTROS, 1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise MessageTypeError("TYP006", f"{distro!r} is not one of {', '.join(DISTROS)}{hint}")
        return _bundled(distro)

    @classmethod
    def from_definition(cls, type_name: str, text: str, *, distro: str = "") -> TypeStore:
        """Rebuild a type from a self-description's text, which is not trusted.

        The text defines the type first, then its dependencies (spec/type-mapping.md, section 6). ``distro``
        is the self-description's distribution; only ``noetic`` means ROS 1. Raises MessageTypeError TYP001
        (a dependency is missing), TYP002 (syntax), TYP003, TYP004, TYP005, TYP007 (limits).
        """
        return cls(distro, {}).with_definition(type_name, text)

    def with_definition(self, type_name: str, text: str) -> TypeStore:
        """Return a store that also contains the types of a definition text; see :meth:`from_definition`."""
        merged, found = self._copy(), parse_definition(type_name, text, ros_version=self.ros_version)
        for parsed in found:
            merged._merge(parsed)
        for parsed in found:
            merged._visit(parsed.message.name, merged._heights, (), parsed.where)
        return merged

    def with_events(self, name: str) -> TypeStore:
        """Return a store that also contains a service or action; TYP001 if one of its messages is missing."""
        merged, parts = self._copy(), PARTS.get(kind_of(name))
        if parts is None:
            raise MessageTypeError("TYP001", f"{name} is neither a service nor an action")
        text = "---\n".join(self._text(self[f"{name}_{part}"]) for part in parts)
        merged._interfaces.setdefault(name, (text,))
        merged._types |= {name: kind for name, kind in _BUILTIN.items() if name not in merged._types}
        return merged

    def with_types_of(self, source: TypeStore, *names: str) -> TypeStore:
        """Return a store that also contains types of another store and their dependencies, if missing."""
        merged = self._copy()
        merged._types = {
            each: source[each] for name in names for each in source.dependencies(name)
        } | self._types
        merged._interfaces = source._interfaces | self._interfaces
        return merged

    def with_paths(self, paths: Iterable[Path]) -> TypeStore:
        """Return a store that also contains the custom types in these paths.

        Types may depend on types in other paths. A type with an error, or with two different definitions,
        fails only when it is used, so a path may be a whole workspace. ``paths`` are folders with
        ``package/msg/Name.msg`` or ``package/Name.msg``, packages' folders, or single files; the same applies
        to ``.srv`` and ``.action``. Raises MessageTypeError TYP008 if a path cannot be read.
        """
        parsed, interfaces, broken, nameless = parse_paths(map(Path, paths), self.ros_version)
        merged = self._copy()
        for name, found in interfaces.items():
            merged._interfaces[name] = (*merged._interfaces.get(name, ()), *found)
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

        Raises MessageTypeError: TYP001 if it is unknown; for a custom type also what is wrong with it or
        with a type that it needs (TYP001 … TYP007), with file and line.
        """
        if name not in self._heights:
            if not (isinstance(name, str) and name.isidentifier()):
                name = full_name(name)
            self._visit(name, self._heights, (), "")
        return self._get(name)

    def __contains__(self, name: object) -> bool:
        try:
            return isinstance(name, str) and self._find(full_name(name)) is not None
        except MessageTypeError:
            return False

    def __len__(self) -> int:
        return len(self._types)

    def names(self) -> tuple[str, ...]:
        """Return the full names of all usable messages, sorted, without those of services and actions."""
        return tuple(sorted(name for name in self._types if self._error(name) is None))

    def services(self) -> tuple[str, ...]:
        """Return the full names of all usable services, sorted, without those of actions."""
        return self._usable("srv")

    def actions(self) -> tuple[str, ...]:
        """Return the full names of all usable actions, sorted."""
        return self._usable("action")

    def resolve(self, name: str) -> str:
        """Return the full name for ``package/Name``: of a message, else of a service, else of an action.

        An unknown name is treated as a message's name.
        """
        full = [full_name(name, kind) for kind in ("msg", *PARTS)]
        return next((each for each in full if each in self._interfaces or each in self), full[0])

    def service(self, name: str) -> ServiceType:
        """Return a service by ``package/srv/Name`` or ``package/Name``; errors as :meth:`__getitem__`.

        In ROS 2, an action also has services: ``package/action/Name_SendGoal`` and ``…_GetResult``.
        """
        own = self._interface(name, "srv")
        return ServiceType(own, *(self[f"{own}_{part}"] for part in PARTS["srv"]))

    def action(self, name: str) -> ActionType:
        """Return an action by ``package/action/Name`` or ``package/Name``; errors as :meth:`__getitem__`."""
        own = self._interface(name, "action")
        return ActionType(own, *(self[f"{own}_{part}"] for part in PARTS["action"]))

    def problems(self) -> tuple[MessageTypeError, ...]:
        """Return the errors in custom types and their files; they have no effect until a type is used."""
        custom = (name for name, sources in self._interfaces.items() if isinstance(sources[-1], Path))
        found = (self._error(name) for name in sorted({*self._parsed, *self._broken, *custom}))
        return (*self._nameless, *filter(None, found))

    def _usable(self, kind: str) -> tuple[str, ...]:
        names = (name for name in self._interfaces if kind_of(name) == kind)
        return tuple(sorted(name for name in names if self._error(name) is None))

    def _error(self, name: str) -> MessageTypeError | None:
        parts = [f"_{part}" for part in PARTS[kind_of(name)]] if name in self._interfaces else [""]
        try:
            for part in parts:
                self._visit(f"{name}{part}", self._heights, (), "")
        except MessageTypeError as error:
            return error
        return None

    def dependencies(self, name: str) -> tuple[str, ...]:
        """Return all types that ``name`` depends on, in order of dependency, and ``name`` itself last."""
        order: dict[str, int] = {}
        self._visit(self[name].name, order, (), "")
        return tuple(order)

    def definition_text(self, name: str) -> str:
        """Return the definition of a type and its dependencies (spec/type-mapping.md, section 6)."""
        first = self[name]
        order: dict[str, None] = {}
        self._collect(first.name, order)
        parts = [self._text(first)]
        for other in list(order)[1:]:
            parts.append(f"{'=' * 80}\nMSG: {_short(other)}\n{self._text(self._get(other))}")
        return "".join(parts)

    def type_hash(self, name: str) -> str:
        """Return ROS 2's type hash, ``RIHS01_…``."""
        *others, own = self.dependencies(name)
        return rihs01(self._get(own), [self._get(other) for other in others])

    def service_hash(self, name: str) -> str:
        """Return ROS 2's type hash of a service; its messages have separate hashes."""
        return self._hash_of(self._interface(name, "srv"))

    def action_hash(self, name: str) -> str:
        """Return ROS 2's type hash of an action."""
        return self._hash_of(self._interface(name, "action"))

    def _hash_of(self, name: str) -> str:
        own, *services = described = describe(name)
        names = {each.name for each in described}
        order: dict[str, int] = {}
        for needed in (needed for each in described for needed in each.needs if needed not in names):
            self._visit(needed, order, (), "")
        return rihs01(own, [*services, *map(self._get, order)])

    def md5(self, name: str) -> str:
        """Return ROS 1's MD5 sum of the type, as 32 hexadecimal digits."""
        for other in self.dependencies(name):
            if other not in self._md5:
                self._md5[other] = _md5(md5_text(self._get(other), self._md5.__getitem__))
        return self._md5[self[name].name]

    def service_md5(self, name: str) -> str:
        """Return ROS 1's MD5 sum of a service, as 32 hexadecimal digits."""
        service = self.service(name)
        for part in (service.request, service.response):
            self.md5(part.name)
        texts = (md5_text(part, self._md5.__getitem__) for part in (service.request, service.response))
        return _md5("".join(texts))

    def _copy(self) -> TypeStore:
        copy = TypeStore(self.distro, self._types)
        copy._broken, copy._parsed = dict(self._broken), dict(self._parsed)
        copy._nameless, copy._interfaces = list(self._nameless), dict(self._interfaces)
        return copy

    def _merge(self, parsed: ParsedType) -> None:
        """Add a definition; TYP005 if it differs from the one known."""
        new = parsed.message
        old = self._types.get(new.name)
        if old is not None and not _same_shape(old, new):
            known = self._parsed.get(new.name)
            other = known.where if known else f"that of {self.distro}" if self.distro else "another one"
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

    def _find(self, name: str) -> MessageType | None:
        """Return a message; those of a service or action are parsed here, when first asked for."""
        if (own := self._types.get(name)) is not None:
            return own
        if name not in self._parts:
            for owner in owners_of(name, self.ros_version):
                if owner in self._interfaces:
                    self._load(owner)
        return self._parts[name].message if name in self._parts else None

    def _get(self, name: str) -> MessageType:
        found = self._find(name)
        assert found is not None, name
        return found

    def _load(self, name: str) -> None:
        """Parse a service or an action, and add the messages that ROS makes of it."""
        parsed: list[ParsedType] = []
        other = ""
        for source in self._interfaces[name]:
            text, where = (read(source), str(source)) if isinstance(source, Path) else (source, name)
            before, parsed = (
                parsed,
                parse_interface(name, text, where=where, ros_version=self.ros_version, siblings=self._types),
            )
            if not all(_same_shape(a.message, b.message) for a, b in zip(before, parsed, strict=False)):
                what = f"this definition of {name} differs from {other}"
                raise MessageTypeError("TYP005", what, where=where)
            other = where if isinstance(source, Path) else f"that of {self.distro}"
        messages = derive(name, [each.message for each in parsed], self.ros_version)
        parsed += (ParsedType(each, where, (where,) * len(each.fields)) for each in messages)
        self._parts.update({each.message.name: each for each in parsed})

    def _interface(self, name: str, kind: str) -> str:
        """Return the full name of a service or action that is known, else raise TYP001."""
        full = full_name(name, kind)
        owner = full
        if kind == "srv" and kind_of(full) == "action" and self.ros_version == 2:
            owner = full.removesuffix("_SendGoal").removesuffix("_GetResult")
        if owner not in self._interfaces or (kind_of(full) != kind and owner == full):
            raise self._unknown(full, kind)
        return full

    def _unknown(self, name: str, kind: str = "msg", where: str = "") -> MessageTypeError:
        package, every, hint = name.partition("/")[0], [*self._types, *self._interfaces], ""
        if name in self._types:
            what = f"{name} is a message, not {_WORDS[kind]}"
        elif name in self._interfaces:
            own, known = _WORDS[kind_of(name)], PARTS[kind_of(name)]
            what = f"{name} is {own}, not {_WORDS[kind]}; its message names end with _{', _'.join(known)}"
        else:
            base = name.rsplit("/", 1)[-1].lower()
            same = [other for other in every if other.rsplit("/", 1)[1].lower() == base]
            near = difflib.get_close_matches(name, same, 1, 0) or difflib.get_close_matches(name, every, 1)
            if near:
                hint = f"; did you mean {near[0]}?"
            elif self._nameless:
                hint = f"; {self._nameless[0].where} was skipped: {self._nameless[0].what}"
            what = f"{name} is unknown{f' in {self.distro}' if self.distro else ''}{hint}"
        learnt = ""
        if kind == "msg" and self.ros_version == 2 and self.distro != "humble":
            learnt = " `rosplc run` and `rosplc init` can learn a type from a running node that uses it."
        remedy = f"`rosplc types {package}` lists its types; for others, add a folder to types.paths.{learnt}"
        if not any(other.startswith(f"{package}/") for other in every):
            remedy = (
                f"Check the spelling with `rosplc types`. Package {package} is not bundled: add its folder "
                "to types.paths (`--path` of `rosplc types`); ROS installs it in "
                f"/opt/ros/DISTRO/share/{package}.{learnt}"
            )
        return MessageTypeError("TYP001", what, where=where, remedy=remedy)

    def _visit(self, name: str, heights: dict[str, int], above: tuple[str, ...], where: str) -> int:
        """Return how deep a type is nested; ``heights`` fills in order of dependency."""
        if name in heights:
            return heights[name]
        if name in self._broken:
            raise self._broken[name]
        if (message := self._find(name)) is None:
            raise self._unknown(name[:80], where=where)
        if name in above:
            cycle = " → ".join((*above[above.index(name) :], name))
            raise MessageTypeError("TYP003", cycle, where=where)
        parsed = self._parsed.get(name) or self._parts.get(name)
        places = parsed.field_lines if parsed else (where,) * len(message.fields)
        below = [0]
        # The check on the way down bounds the recursion, the one on the way up is exact.
        if len(above) <= MAX_DEPTH:
            needed: dict[str, str] = {}
            for field, place in zip(message.fields, places, strict=True):
                if isinstance(kind := field.type.inner, kinds.NamedType):
                    needed.setdefault(kind.name, place)
            below += [self._visit(other, heights, (*above, name), place) for other, place in needed.items()]
        heights[name] = 1 + max(below)
        if heights[name] > MAX_DEPTH or len(above) >= MAX_DEPTH:
            del heights[name]
            raise MessageTypeError("TYP007", f"types are nested more than {MAX_DEPTH} deep", where=where)
        return heights[name]

    def _collect(self, name: str, order: dict[str, None]) -> None:
        """Add ``name`` and what it needs in order of first use, depth first."""
        order[name] = None
        for other in self._get(name).needs:
            if other not in order and not (self.ros_version == 1 and other in ROS1_TIMES):
                self._collect(other, order)

    def _text(self, message: MessageType) -> str:
        lines = []
        for each in message.constants:
            quoted = self.ros_version == 2 and isinstance(each.value, str)
            lines.append(f"{each.type} {each.name}={format_value(each.value) if quoted else each.text}")
        for field in message.fields:
            kind, text = field.type.inner, str(field.type)
            if isinstance(kind, kinds.NamedType):
                short = ROS1_TIMES.get(kind.name) if self.ros_version == 1 else None
                text = text.replace(kind.name, short or _short(kind.name))
            default = "" if field.default is None else f" {format_value(field.default)}"
            lines.append(f"{text} {field.name}{default}")
        return "".join(f"{line}\n" for line in lines)


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


def _short(name: str) -> str:
    return name.replace("/msg/", "/")


def _same_shape(one: MessageType, other: MessageType) -> bool:
    fields = [[(f.name, f.type) for f in m.fields] for m in (one, other)]
    return fields[0] == fields[1] and set(one.constants) == set(other.constants)


@cache
def _bundled(distro: str) -> TypeStore:
    types = bundled_types(distro)
    defaults = {"noetic": {}, "humble": _EVERY_ROS2}.get(distro, _SINCE_JAZZY)
    for name, values in defaults.items():
        known = (replace(field, default=values.get(field.name)) for field in types[name].fields)
        types[name] = replace(types[name], fields=tuple(known))
    own: dict[str, MessageType] = {}
    store = TypeStore(distro, {})
    for section in files("rosplc.model").joinpath("interfaces.txt").read_text().split("\n==== ")[1:]:
        head, _, text = section.partition("\n")
        name, *distros = head.split()
        if distro not in distros:
            continue
        if "/msg/" in name:
            own[name] = parse_definition(name, text, ros_version=store.ros_version)[0].message
        else:
            store._interfaces[name] = (text,)
    store._types |= own | types
    return store
