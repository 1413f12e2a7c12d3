"""Write the numbers of spec/format.toml for C and Python; ``--verify`` only compares.

The C header ``rosplc/numbers.h`` gets constants, error numbers and the lines' structs; the Python module
``rosplc.shm.constants`` constants, error numbers and the words' offsets, and ``rosplc.reasons``, which
packages without a channel use, why a call ended.
"""

from __future__ import annotations

import re
import sys
import textwrap
from typing import Any, NamedTuple

from generated_page import ROOT, run
from rosplc.errors import CODES

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pytest's

HEADER = ROOT / "src/rosplc/include/rosplc/numbers.h"
MODULE = ROOT / "src/rosplc/shm/constants.py"
REASONS = ROOT / "src/rosplc/reasons.py"
TABLE: dict[str, Any] = tomllib.loads((ROOT / "spec/format.toml").read_text(encoding="utf-8"))
SIZES = {"identity": 128, "writer_line": 64, "reader_line": 64, "slot_header": 64, "goal_note": 32}


class Word(NamedTuple):
    """One member of a line: ``count`` elements of ``width`` bytes, ``offset`` bytes from the line's start."""

    name: str
    offset: int
    count: int  # type: ignore[assignment]
    width: int


def words(line: str) -> list[Word]:
    """Return the words of a line, which fill it."""
    found: list[Word] = []
    at = 0
    for text in TABLE["words"][line]:
        match = re.fullmatch(r"(\w+)(?:\[(\d+)\]|:(\d+))?", text)
        assert match, text
        count = int(match[2] or match[3] or 1)
        found.append(Word(match[1], at, count, 1 if match[3] else 4))
        at += count * found[-1].width
    assert at == SIZES[line], f"{line} ends at {at}"
    return found


def header() -> str:
    """Return the C header's text."""
    lines = [
        "/* Numbers of spec/shm-format.md, generated from spec/format.toml by tools/generate_format.py. */",
        "#ifndef ROSPLC_NUMBERS_H",
        "#define ROSPLC_NUMBERS_H",
        "",
        "#include <stddef.h>",
        "#include <stdint.h>",
        "",
    ]
    lines += [
        f"#define ROSPLC_{name} {value}u /* {meaning} */"
        for name, (value, meaning) in TABLE["constants"].items()
    ]
    lines += [
        "",
        "/* Section 9: the return values of functions that can fail. */",
        "typedef enum {",
        "    ROSPLC_OK = 0,",
    ]
    lines += [
        f"    ROSPLC_ERROR_{name} = {number}, /* {CODES[f'SHM{number}'].title} */"
        for name, number in TABLE["errors"].items()
    ]
    lines += ["} rosplc_error;", "", "/* Section 11.2: why a call ended. */", "typedef enum {"]
    lines += [f"    ROSPLC_REASON_{name} = {number}," for name, number in TABLE["reasons"].items()]
    lines += ["} rosplc_reason;", ""]
    for line in TABLE["words"]:
        lines.append("typedef struct {")
        for word in words(line):
            kind = "uint8_t" if word.width == 1 else "uint32_t"
            lines.append(f"    {kind} {word.name}{f'[{word.count}]' if word.count > 1 else ''};")
        lines += [f"}} rosplc_{line};", ""]
    lines += [
        "typedef struct {",
        "    rosplc_identity identity;",
        "    rosplc_writer_line writer;",
        "    rosplc_reader_line reader[ROSPLC_READER_LINES];",
        "    uint32_t reserved[16];",
        "} rosplc_header;",
        "",
        "#ifdef __cplusplus",
        "#define ROSPLC_STATIC_ASSERT static_assert",
        "#else",
        "#define ROSPLC_STATIC_ASSERT _Static_assert",
        "#endif",
        "#define ROSPLC_AT(type, member, offset) \\",
        '    ROSPLC_STATIC_ASSERT(offsetof(type, member) == (offset), #type "." #member " has moved")',
    ]
    for line, size in SIZES.items():
        lines += [f"ROSPLC_AT(rosplc_{line}, {word.name}, {word.offset});" for word in words(line)]
        lines.append(
            f'ROSPLC_STATIC_ASSERT(sizeof(rosplc_{line}) == {size}, "rosplc_{line} has {size} bytes");'
        )
    lines += [
        "ROSPLC_AT(rosplc_header, writer, 128);",
        "ROSPLC_AT(rosplc_header, reader, 192);",
        "ROSPLC_AT(rosplc_header, reserved, 448);",
        'ROSPLC_STATIC_ASSERT(sizeof(rosplc_header) == ROSPLC_HEADER_SIZE, "the header has eight lines");',
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def module() -> str:
    """Return the Python module's text."""
    constants = TABLE["constants"]
    names = [name for name in constants if name not in ("TO_PLC", "TO_ROS")]
    lines = [
        '"""The numbers of spec/shm-format.md; generated from spec/format.toml by tools/generate_format.py.',
        "",
        "Offsets are in bytes: of IDENTITY and WRITER_LINE from the object's start, else from the line's.",
        '"""',
        "",
        "from __future__ import annotations",
        "",
        "import enum",
        "from typing import Final",
        "",
        "from rosplc.reasons import Reason as Reason",
        "",
        'FORMAT: Final = "rosplc 1.0"',
    ]
    lines += [f"{name}: Final = {constants[name][0]}  # {constants[name][1]}" for name in names]
    lines += [
        "IDENTITY_SIZE: Final = 2 * LINE_SIZE",
        "READER_LINES_OFFSET: Final = IDENTITY_SIZE + LINE_SIZE",
        "CHANGING_WORDS: Final = (HEADER_SIZE - IDENTITY_SIZE) // 4",
        '"""Control words from the writer\'s line to the end of the header."""',
        "",
        "",
        "def _offsets(start: int, names: str) -> dict[str, int]:",
        '    """Return where each word begins; NAME*N has N words of 4 bytes."""',
        "    found = {}",
        "    for name in names.split():",
        '        name, _, count = name.partition("*")',
        "        found[name] = start",
        '        start += 4 * int(count or "1")',
        "    return found",
        "",
        "",
    ]
    for line in TABLE["words"]:
        start = SIZES["identity"] if line == "writer_line" else 0
        listed = [
            f"{word.name}*{word.count * word.width // 4}" if word.count > 1 else word.name
            for word in words(line)
        ]
        rows = textwrap.wrap(" ".join(listed), 96)
        lines += [f"{line.upper()}: Final = _offsets(", f"    {start},"]
        lines += [f'    "{row}{" " * (row is not rows[-1])}"' for row in rows[:-1]] + [
            f'    "{rows[-1]}",',
            ")",
        ]
    lines += [
        "",
        "",
        "class Direction(enum.IntEnum):",
        '    """Which way a channel carries messages."""',
        "",
        f"    TO_PLC = {constants['TO_PLC'][0]}",
        f"    TO_ROS = {constants['TO_ROS'][0]}",
        "",
        "    @property",
        "    def word(self) -> str:",
        '        """The word that self-descriptions use: ``"to_plc"`` or ``"to_ros"``."""',
        "        return self.name.lower()",
        "",
        "",
        "class ErrorNumber(enum.IntEnum):",
        '    """The numbers of section 9; number 101 is the error code SHM101."""',
        "",
        *(f"    {name} = {number}" for name, number in TABLE["errors"].items()),
        "",
        "",
        "def reader_line(index: int) -> int:",
        '    """Return the offset of reader line ``index``, 0 to 3."""',
        "    if not 0 <= index < READER_LINES:",
        '        raise IndexError(f"there is no reader line {index}")',
        "    return READER_LINES_OFFSET + index * LINE_SIZE",
    ]
    return "\n".join(lines) + "\n"


def reasons() -> str:
    """Return the text of the Python module of reasons."""
    lines = [
        '"""Why a call ended; generated from spec/format.toml by tools/generate_format.py."""',
        "",
        "from __future__ import annotations",
        "",
        "import enum",
        "",
        "",
        "class Reason(enum.IntEnum):",
        '    """Why a call ended; spec/shm-format.md, section 11.2."""',
        "",
        *(f"    {name} = {number}" for name, number in TABLE["reasons"].items()),
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    raise SystemExit(run(__doc__, {HEADER: header(), MODULE: module(), REASONS: reasons()}))
