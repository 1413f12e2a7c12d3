"""Names in the C header; what compilers make of it is tests/conformance/test_c_header.py."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from rosplc.layout import Limits, compute_layout
from rosplc.layout.c_header import C_RESERVED, c_header, member_identifiers
from rosplc.model import TypeStore

JAZZY = TypeStore.bundled("jazzy")


def test_a_small_header() -> None:
    """A sequence is a count and an array, padding is a member, sizes are asserted."""
    store = TypeStore.from_definition("t/T", "uint8 a\nstring<=4[] names\n")
    text = c_header([compute_layout(store, "t/T", Limits(sequence=2))], guard="T_H")
    assert (
        "/* t/msg/T */\ntypedef struct t__T {\n    uint8_t a;\n    uint8_t padding_1[3];\n"
        "    uint32_t names_count;\n    char names[2][5];\n    uint8_t padding_4[2];\n} t__T;\n"
        "ROSPLC_ASSERT(sizeof(t__T) == 20);\n"
    ) in text
    assert text.startswith("/* ")
    assert "#ifndef T_H\n#define T_H\n" in text


def test_identifiers_are_valid_and_unique() -> None:
    """Reserved words get an underscore, and invented names give way to the definition's."""
    fields = ["int", "int_", "linux", "names_count", "padding_1", "n"]
    text = "".join(f"uint8 {name}\n" for name in fields) + "string[] names\nfloat64 last\n"
    node = compute_layout(TypeStore.from_definition("t/T", text), "t/T").root
    identifiers = member_identifiers(node)
    assert len(set(identifiers)) == len(identifiers)
    assert not C_RESERVED & set(identifiers)
    by_name = dict(zip(((m.name, m.count_of) for m in node.members), identifiers, strict=True))
    assert by_name[("names_count", None)] == "names_count"
    assert by_name[("names", "names")] == "names_count_"
    assert by_name[("int_", None)] == "int_"
    assert by_name[("int", None)] == "int__"


def test_one_type_with_several_limits_gets_several_structs() -> None:
    """The first layout has the plain name, others a number, and equal ones appear once."""
    small = compute_layout(JAZZY, "std_msgs/String", Limits(string=5))
    large = compute_layout(JAZZY, "std_msgs/String")
    text = c_header([small, large, small])
    assert re.findall(r"^typedef struct (\w+)", text, re.M) == ["std_msgs__String", "std_msgs__String_2"]
    low, high = small.layout_id_words
    assert f"#define std_msgs__String_LAYOUT_ID_LO 0x{low:08X}u" in text
    assert f"#define std_msgs__String_LAYOUT_ID_HI 0x{high:08X}u" in text


def test_hostile_names_compile(tmp_path: Path) -> None:
    """A definition whose fields are named like C's keywords and macros gives a valid header."""
    if not shutil.which("gcc"):
        pytest.skip("Debian package gcc is missing")
    text = (
        "".join(f"uint8 {word}\n" for word in sorted(C_RESERVED))
        + "uint8 Padding_1\nfloat64[] x\nuint8 x_count\n"
    )
    layout = compute_layout(TypeStore.from_definition("t/T", text), "t/T")
    header = tmp_path / "records.h"
    header.write_text(c_header([layout]))
    source = tmp_path / "unit.c"
    source.write_text('#include <errno.h>\n#include <stdbool.h>\n#include <assert.h>\n#include "records.h"\n')
    done = subprocess.run(
        ["gcc", "-std=gnu11", "-Wall", "-Werror", "-fsyntax-only", source],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
