"""A configuration file as plain data plus the line on which each key stands.

PyYAML's event stream is read, not its object constructors: lines are at hand, nothing can be
constructed but mappings, lists and scalars, and depth and size are bounded. Scalars follow
YAML 1.2's core schema: ``on``, ``yes``, ``10:30`` and ``0660`` are text, as people expect.

Everything that is wrong is reported together, so that it is corrected in one go.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import yaml

from rosplc.errors import ConfigError, RosplcError
from rosplc.harmless import nearest, one_line

MOST_ERRORS = 50  # more errors than this are one mistake, repeated


class Absent(ConfigError):
    """Something that a configuration refers to is not there; it may come, as a disk does that is mounted."""


class ConfigErrors(ConfigError):
    """One or more errors in a configuration, sorted by line.

    This is a :class:`~rosplc.errors.ConfigError`. ``code``, ``what``, ``where`` and ``remedy``
    are those of the first error; the text shows all errors, one per line. ``errors`` contains
    at least one error; some may belong to the families TYP, LAY or SHM.
    """

    family = ""

    def __init__(self, errors: Iterable[RosplcError]) -> None:
        self.errors = tuple(errors)
        first = self.errors[0]
        super().__init__(first.code, first.what, where=first.where, remedy=first.remedy)

    def __str__(self) -> str:
        return "\n".join(str(error) for error in self.errors)

    def __reduce__(self) -> tuple[object, ...]:
        return (ConfigErrors, (self.errors,))


def may_pass(error: ConfigError) -> bool:
    """Return whether all that is wrong may pass without the configuration being changed."""
    errors = error.errors if isinstance(error, ConfigErrors) else (error,)
    return all(isinstance(one, Absent) for one in errors)


class Problems:
    """Collects errors until :meth:`check` raises them."""

    def __init__(self) -> None:
        self._errors: list[tuple[int, RosplcError]] = []

    def __len__(self) -> int:
        return len(self._errors)

    def add(self, error: RosplcError, line: int = 0) -> None:
        """Take an error; ``line`` sorts it among the others."""
        if len(self._errors) < MOST_ERRORS:
            self._errors.append((line, error))

    def wrong(self, source: YamlSource, key: KeyPath, *what: str) -> None:
        """Take the error that :meth:`YamlSource.wrong` makes of these texts."""
        self.add(source.wrong(key, *what), source.line(key))

    def move(self, error: RosplcError, source: YamlSource, key: KeyPath) -> None:
        """Take an error as one at a key path; the place it had itself moves into its text."""
        inner = f"{error.where}: " if error.where else ""
        moved = type(error)(error.code, inner + error.what, where=source.place(key), remedy=error.remedy)
        self.add(moved, source.line(key))

    def check(self) -> None:
        """Raise what was collected. Raises ConfigErrors: Unless nothing was."""
        if self._errors:
            self.fail()

    def fail(self) -> NoReturn:
        """Raise what was collected, which is something."""
        self._errors.sort(key=lambda item: item[0])
        raise ConfigErrors(error for _, error in self._errors)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the nearest known word, or the known ones if few."""
    names = sorted(known)
    if near := nearest(word, names):
        return f"; did you mean {near!r}?"
    return f"; known: {', '.join(names)}" if 0 < len(names) <= 20 else ""


LARGEST_FILE = 1 << 20  # bytes that a configuration may have; one with 10,000 topics stays below

DEEPEST = 32  # levels of keys and lists within each other
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_PLAIN_TAGS = frozenset(
    {"!"} | {f"tag:yaml.org,2002:{name}" for name in ("map", "seq", "str", "int", "float", "bool", "null")}
)
_HALF = re.compile("[\ud800-\udfff]")
_INT = re.compile(r"[-+]?(0|[1-9][0-9]{0,17})\Z")
_FLOAT = re.compile(r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))([eE][-+]?[0-9]{1,3})?\Z")
_WORDS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}

KeyPath = tuple["str | int", ...]


@dataclass(frozen=True)
class YamlSource:
    """A parsed file."""

    name: str  # the file's name, as the user gave it
    data: Any = None  # mappings (keys are text), lists, and scalars
    lines: dict[KeyPath, int] = field(default_factory=dict)  # key path → line, counted from 1
    # key path → where the key begins, in characters of the text
    starts: dict[KeyPath, int] = field(default_factory=dict, repr=False)

    def line(self, path: Sequence[str | int]) -> int:
        """Return the line of a key path, or of the nearest one above it that is written."""
        for length in range(len(path), 0, -1):
            if (found := self.lines.get(tuple(path[:length]))) is not None:
                return found
        return 1

    def place(self, path: Sequence[str | int]) -> str:
        """Return ``file:line: key.path``."""
        text = ""
        for part in path:
            text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
        # A key is whatever the file holds; no escape sequence of it may reach a terminal.
        text = one_line(text)
        return f"{self.name}:{self.line(path)}" + (f": {text}" if text else "")

    def wrong(
        self, path: Sequence[str | int], what: str, remedy: str = "", code: str = "CFG004"
    ) -> ConfigError:
        """Return an error at a key path."""
        return ConfigError(code, what, where=self.place(path), remedy=remedy)


def read_yaml(path: Path, problems: Problems, *, text: str | None = None) -> YamlSource:
    """Read a file; aliases and tags (CFG009) and repeated keys (CFG006, CFG010) go into ``problems``.

    ``text`` is its content, if known. Raises ConfigError CFG001 if it cannot be read, CFG002 if it is not
    YAML.
    """
    name = str(path)
    if text is None:
        text = read_text(path)
    elif len(text) > LARGEST_FILE:
        raise _too_large(name)
    if half := _HALF.search(text):
        line = text.count("\n", 0, half.start()) + 1
        raise ConfigError("CFG002", f"{half[0]!r} is not a valid character", where=f"{name}:{line}")
    builder = _Builder(name, problems)
    try:
        for event in yaml.parse(text, Loader=_Loader):
            builder.feed(event)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        last = text.count("\n") + (not text.endswith("\n"))  # libyaml's end of text lies a line below
        place = f"{name}:{min(mark.line + 1, max(last, 1))}" if mark is not None else name
        what = (
            getattr(error, "problem", None) or getattr(error, "reason", None) or "the text cannot be parsed"
        )
        if mark is not None and "start any token" in what and text[mark.index : mark.index + 1] == "\t":
            what = "the line is indented with a tab; YAML allows only spaces"
            raise ConfigError("CFG002", what, where=place, remedy="Replace the tab with spaces.") from None
        context = getattr(error, "context", None)
        raise ConfigError("CFG002", f"{what} ({context})" if context else what, where=place) from None
    return YamlSource(name, builder.data, builder.lines, builder.starts)


def _too_large(name: str) -> ConfigError:
    what, remedy = f"the file has more than {LARGEST_FILE} bytes", "Check that it is a configuration file."
    return ConfigError("CFG001", what, where=name, remedy=remedy)


def read_text(path: Path) -> str:
    """Return a file's text. Raises ConfigError: CFG001 if it cannot be read, CFG002 if it is not UTF-8."""
    try:
        # Opening a pipe waits for its writer; what a shell passes as <(command) has one.
        if path.is_fifo() and not str(path).startswith(("/dev/", "/proc/")):
            raise ConfigError("CFG001", "this is a named pipe, not a file", where=str(path))
        with path.open("rb") as file:
            raw = file.read(LARGEST_FILE + 1)
    except FileNotFoundError as error:
        raise Absent("CFG001", str(error.strerror).lower(), where=str(path)) from None
    except OSError as error:
        raise ConfigError("CFG001", (error.strerror or str(error)).lower(), where=str(path)) from None
    if len(raw) > LARGEST_FILE:
        raise _too_large(str(path))
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        place = f"{path}:" + str(raw.count(b"\n", 0, error.start) + 1)
        raise ConfigError(
            "CFG002", "the text is not UTF-8", where=place, remedy="Save the file as UTF-8."
        ) from None


class _Builder:
    """Turns events into data; a stack of open containers instead of recursion."""

    def __init__(self, name: str, problems: Problems) -> None:
        self.name = name
        self.data: Any = None
        self.lines: dict[KeyPath, int] = {}
        self.starts: dict[KeyPath, int] = {}
        self._problems = problems
        self._open: list[_Container] = []
        self._documents = 0

    def feed(self, event: Any) -> None:
        line = event.start_mark.line + 1
        if isinstance(event, yaml.DocumentStartEvent):
            self._documents += 1
            if self._documents > 1:
                raise self._no_yaml("the file contains a second document", line, "Remove the `---`.")
        elif isinstance(event, yaml.AliasEvent):
            self._refuse(f"*{event.anchor} is a YAML alias", line)
            if self._expects_key():
                self._key(f"*{event.anchor}", line)
            else:
                self._value(None, line)
        elif isinstance(event, yaml.ScalarEvent):
            if "\0" in event.value:  # which no name, path or text of a message can hold
                raise self._no_yaml("a string contains a NUL character", line)
            self._tag(event.tag, line)
            if self._expects_key():
                self._key(event.value, line, event.start_mark.index if event.start_mark else 0)
            else:
                self._value(_scalar(event) if event.implicit[0] else event.value, line)
        elif isinstance(event, (yaml.MappingStartEvent, yaml.SequenceStartEvent)):
            self._tag(event.tag, line)
            if self._expects_key():
                raise self._no_yaml("a key must be plain text", line)
            if len(self._open) >= DEEPEST:
                raise self._no_yaml(f"the file has more than {DEEPEST} levels of nesting", line)
            container: Any = {} if isinstance(event, yaml.MappingStartEvent) else []
            path = self._value(container, line)
            self._open.append(_Container(container, path))
        elif isinstance(event, (yaml.MappingEndEvent, yaml.SequenceEndEvent)):
            self._open.pop()

    def _no_yaml(self, what: str, line: int, remedy: str = "") -> ConfigError:
        return ConfigError("CFG002", what, where=f"{self.name}:{line}", remedy=remedy)

    def _expects_key(self) -> bool:
        return bool(self._open) and isinstance(self._open[-1].data, dict) and self._open[-1].key is None

    def _key(self, key: str, line: int, start: int = 0) -> None:
        top = self._open[-1]
        top.key = key
        path = (*top.path, key)
        if key in top.data:
            top.skip = True
            code = "CFG006" if top.path == ("topics",) else "CFG010"
            where = f"{self.name}:{line}: {'.'.join(map(str, path))}"
            what = f"{key!r} is already defined on line {self.lines[path]}"
            self._problems.add(ConfigError(code, what, where=where), line)
        else:
            self.lines[path] = line
            self.starts[path] = start

    def _value(self, value: Any, line: int) -> KeyPath:
        """Put a value into the open container, and return its path."""
        if not self._open:
            self.data = value
            return ()
        top = self._open[-1]
        if isinstance(top.data, list):
            path: KeyPath = (*top.path, len(top.data))
            top.data.append(value)
            self.lines[path] = line
            return path
        assert top.key is not None
        path = (*top.path, top.key)
        if top.skip:  # a key's second value is parsed but has no place
            path = (*top.path, f"{top.key} (again)")
        else:
            top.data[top.key] = value
        top.key, top.skip = None, False
        return path

    def _tag(self, tag: str | None, line: int) -> None:
        if tag is not None and tag not in _PLAIN_TAGS:
            self._refuse(f"{tag} is a YAML tag", line)

    def _refuse(self, what: str, line: int) -> None:
        self._problems.add(ConfigError("CFG009", what, where=f"{self.name}:{line}"), line)


@dataclass
class _Container:
    data: Any
    path: KeyPath
    key: str | None = None
    skip: bool = False


def _scalar(event: yaml.ScalarEvent) -> Any:
    text: str = event.value
    if text in _WORDS:
        return _WORDS[text]
    if _INT.match(text):
        return int(text)
    return float(text) if _FLOAT.match(text) else text
