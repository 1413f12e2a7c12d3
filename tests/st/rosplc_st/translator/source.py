"""From text to blark's syntax tree: conditional pragmas, splitting, and the cache of parses.

blark takes about 67 ms per dense statement, so each POU and each method is parsed on its own
and kept under ``.cache/blark`` by a hash of its text.
"""

from __future__ import annotations

import fcntl
import gc
import hashlib
import os
import pickle
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

__all__ = ["TranslationError", "Unit", "parse_texts", "parse_units", "split"]

_CACHE = Path(__file__).resolve().parents[4] / ".cache" / "blark"
_VERSION = "0.8.3-2"
_END = re.compile(r"^\s*END_(?:FUNCTION_BLOCK|FUNCTION|PROGRAM|METHOD|TYPE)\b", re.IGNORECASE)
_IF = re.compile(
    r"^\s*\{\s*IF\s+(?P<not>NOT\s+)?defined\s*\(\s*(?P<what>[^)]*?)\s*\)\s*\}\s*$", re.IGNORECASE
)
_ELSE = re.compile(r"^\s*\{\s*ELSE\s*\}\s*$", re.IGNORECASE)
_END_IF = re.compile(r"^\s*\{\s*END_IF\s*\}\s*$", re.IGNORECASE)
_PRAGMA = re.compile(r"^\s*\{(?P<text>.*)\}\s*$")
_ATTRIBUTE = re.compile(r"attribute\s+'(?P<name>[^']*)'(?:\s*:=\s*'(?P<value>[^']*)')?\s*\Z")
_memory: dict[str, Any] = {}


class TranslationError(Exception):
    """Text that cannot be translated: what, in which file, at which line."""

    def __init__(self, what: str, file: str = "?", line: int = 0) -> None:
        super().__init__(f"{file}:{line}: {what}")
        self.what, self.file, self.line = what, file, line


@dataclass(frozen=True)
class Unit:
    """One top-level block of a file: its text, where it begins, and its attributes."""

    file: str
    line: int
    text: str
    attributes: tuple[tuple[str, str], ...]


def split(name: str, text: str, defined: Iterable[str]) -> list[Unit]:
    """Choose the branches of conditional pragmas and cut a file into its top-level blocks."""
    known = {item.replace(" ", "").lower() for item in defined}
    units: list[Unit] = []
    lines: list[str] = []
    attributes: list[tuple[str, str]] = []
    stack: list[bool] = []
    start = 1
    for number, line in enumerate(text.splitlines(), 1):
        keep = all(stack)
        if match := _IF.match(line):
            stack.append((match["what"].replace(" ", "").lower() in known) != bool(match["not"]))
            keep = False
        elif _ELSE.match(line) or _END_IF.match(line):
            if not stack:
                raise TranslationError("pragma without {IF}", name, number)
            last = stack.pop()
            if _ELSE.match(line):
                stack.append(not last)
            keep = False
        elif match := _PRAGMA.match(line):
            found = _ATTRIBUTE.match(match["text"].strip())
            if not found:
                raise TranslationError(f"pragma {line.strip()}", name, number)
            attributes.append((found["name"], found["value"] or ""))
            keep = False
        lines.append(line if keep else "")
        if keep and _END.match(line):
            units.append(Unit(name, start, "\n".join(lines) + "\n", tuple(attributes)))
            lines, attributes, start = [], [], number + 1
    if stack:
        raise TranslationError("{IF} without {END_IF}", name, len(text.splitlines()))
    if any(line.strip() for line in lines):
        units.append(Unit(name, start, "\n".join(lines) + "\n", tuple(attributes)))
    return units


def _path(text: str) -> Path:
    digest = hashlib.sha256(f"{_VERSION}\n{text}".encode()).hexdigest()
    return _CACHE / digest[:2] / f"{digest[2:]}.pickle"


def _take_lark_beside_blark() -> None:
    """Import blark's own lark: the one that comes with ROS 2 is older, and parses SUPER^ as a name."""
    found = find_spec("blark")
    place = Path(str(found and found.origin)).parents[1]
    if place in Path(str(getattr(sys.modules.get("lark"), "__file__", ""))).parents:
        return
    for name in [each for each in sys.modules if each.partition(".")[0] == "lark"]:
        del sys.modules[name]
    sys.path.insert(0, str(place))
    import lark  # noqa: F401

    del sys.path[0]


_take_lark_beside_blark()  # before anything of blark is imported, or unpickled


@cache
def _quicken() -> None:
    """Let lark's parser see at once that an object equals itself: a third of its time."""
    from lark.grammar import Rule, Symbol

    def quick(equal: Callable[[Any, object], bool]) -> Callable[[Any, object], bool]:
        return lambda one, other: one is other or equal(one, other)

    for kind in (Rule, Symbol):
        kind.__eq__ = quick(kind.__eq__)  # type: ignore[method-assign]


def _parse(text: str) -> None:
    """Parse one text and leave the tree in the cache; a syntax error is kept as (message, line)."""
    _quicken()
    from blark.parse import parse_source_code  # type: ignore[import-untyped]

    result = parse_source_code(text)
    if result.exception is not None:
        line = getattr(result.exception, "line", 0)
        kept: Any = (str(result.exception).strip().splitlines()[0], line if isinstance(line, int) else 0)
    else:
        kept = list(result.transform().items)
    path = _path(text)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(f".{os.getpid()}")
    temporary.write_bytes(pickle.dumps(kept, protocol=5))
    temporary.replace(path)


def parse_units(
    units: Iterable[Unit], workers: int | None = None, progress: Callable[[int, int], None] | None = None
) -> list[tuple[Unit, list[Any]]]:
    """Return each unit with its syntax trees, parsing what the cache does not know.

    ``progress`` is called with how many of the unknown texts are parsed, and of how many.
    """
    units = list(units)
    if _missing(units):
        with _one_at_a_time():
            _fill(_missing(units), workers or min(len(os.sched_getaffinity(0)), 4), progress)
    result = []
    for unit in units:
        if unit.text not in _memory:
            _memory[unit.text] = pickle.loads(_path(unit.text).read_bytes())
        kept = _memory[unit.text]
        if isinstance(kept, tuple):
            raise TranslationError(f"syntax: {kept[0]}", unit.file, unit.line + max(kept[1], 1) - 1)
        result.append((unit, kept))
    return result


def _missing(units: Iterable[Unit]) -> list[str]:
    texts = dict.fromkeys(unit.text for unit in units)
    return [text for text in texts if text not in _memory and not _path(text).exists()]


@contextmanager
def _one_at_a_time() -> Iterator[None]:
    """Wait for other processes that parse: they are likely to parse the same."""
    _CACHE.mkdir(parents=True, exist_ok=True)
    with (_CACHE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _collect_seldom() -> None:
    """A parse makes millions of objects that live until its end: looking for garbage costs a third of it."""
    gc.freeze()
    gc.set_threshold(200_000, 50, 50)


def _fill(missing: list[str], workers: int, progress: Callable[[int, int], None] | None) -> None:
    """Parse texts, the longest first where several processes share the work."""
    tell = progress or (lambda done, of: None)
    if sum(map(len, missing)) < 2000 or workers == 1:
        for number, text in enumerate(missing, 1):
            _parse(text)
            tell(number, len(missing))
    else:
        missing.sort(key=len, reverse=True)
        with ProcessPoolExecutor(workers, initializer=_collect_seldom) as pool:
            tell(0, len(missing))
            for number, _ in enumerate(pool.map(_parse, missing), 1):
                tell(number, len(missing))


def parse_texts(
    texts: Mapping[str, str],
    defined: Iterable[str] = (),
    progress: Callable[[int, int], None] | None = None,
) -> list[tuple[Unit, list[Any]]]:
    """Return the syntax trees of texts by object name, in their order; ``progress`` as above."""
    defined = tuple(defined)
    units = [unit for name, text in texts.items() for unit in split(name, text, defined)]
    return parse_units(units, progress=progress)
