"""What the layout says is what C compilers make of it, on every processor that rosplc names."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rosplc.layout import Layout, Limits, compute_layout
from rosplc.layout.c_header import c_header
from rosplc.layout.nodes import ArrayNode, PaddingNode, ScalarNode, SequenceNode, StringNode, StructNode
from rosplc.model import DISTROS, TypeStore

pytestmark = pytest.mark.verifies("c-layout", real="gcc for x86-64 and for 32-bit and 64-bit ARM")

COMPILERS = [
    pytest.param("gcc", id="x86-64"),
    pytest.param("arm-linux-gnueabihf-gcc", id="armhf", marks=pytest.mark.needs("gcc-arm-linux-gnueabihf")),
    pytest.param("aarch64-linux-gnu-gcc", id="arm64", marks=pytest.mark.needs("gcc-aarch64-linux-gnu")),
]
STRICT = ("-std=c11", "-Wall", "-Wextra", "-Wpadded", "-Werror")
# The proof by plain structs is the other way round: there the compiler shall add the padding.
PLAIN = ("-std=c11", "-Wall", "-Wextra", "-Werror")
C_TYPES = {
    "bool": "_Bool", "byte": "uint8_t", "char": "unsigned char", "uint8": "uint8_t", "int8": "int8_t",
    "uint16": "uint16_t", "int16": "int16_t", "uint32": "uint32_t", "int32": "int32_t",
    "uint64": "uint64_t", "int64": "int64_t", "float32": "float", "float64": "double",
}  # fmt: skip


def compile_c(program: str, source: str, folder: Path, *options: str) -> None:
    file = folder / "unit.c"
    file.write_text(source)
    done = subprocess.run(
        [program, *options, str(file)], cwd=folder, capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, done.stderr[:4000]


def bundled_layouts() -> list[Layout]:
    """Every bundled type, each distinct layout once."""
    found: dict[Layout, None] = {}
    for distro in DISTROS:
        store = TypeStore.bundled(distro)
        for name in store.names():
            found[compute_layout(store, name)] = None
    return list(found)


@pytest.fixture(scope="module")
def layouts() -> list[Layout]:
    found = bundled_layouts()
    assert len(found) > 200
    return found


class PlainStructs:
    """The same types as a C programmer would write them: no padding, other identifiers."""

    def __init__(self) -> None:
        self.names: dict[int, str] = {}
        self.source: list[str] = ["#include <stddef.h>", "#include <stdint.h>"]
        self.keep: list[StructNode] = []

    def add(self, node: StructNode) -> str:
        if id(node) in self.names:
            return self.names[id(node)]
        lines = []
        for member in node.members:
            if isinstance(member.node, PaddingNode):
                continue
            name = f"n_{member.name}" if member.count_of else f"f_{member.name}"
            lines.append(f"  {self.declare(member.node, name)};")
        own = self.names[id(node)] = f"t{len(self.names)}"
        self.keep.append(node)  # an id is unique only while its object lives
        body = "\n".join(lines) or "  uint8_t nothing;"
        self.source.append(f"struct {own} {{\n{body}\n}};")
        return own

    def declare(self, node: object, name: str) -> str:
        if isinstance(node, StructNode):
            return f"struct {self.add(node)} {name}"
        if isinstance(node, StringNode):
            return f"char {name}[{node.capacity} + 1]"
        if isinstance(node, ArrayNode):
            return self.declare(node.element, f"{name}[{node.capacity}]")
        if isinstance(node, SequenceNode):
            return self.declare(node.element, f"{name}[{node.capacity}]")
        assert isinstance(node, ScalarNode)
        return f"{C_TYPES[node.kind]} {name}"

    def facts(self, layouts: list[Layout]) -> list[tuple[str, int]]:
        """C expressions and what the layouts say about them: sizes, alignments, every offset."""
        facts = []
        for layout in layouts:
            own = f"struct {self.add(layout.root)}"
            facts += [(f"sizeof({own})", layout.size), (f"_Alignof({own})", layout.align)]
            for path, offset, _ in layout.fields():
                designator = ".".join(f"f_{part}" for part in path.replace("[]", "[0]").split("."))
                facts.append((f"offsetof({own}, {designator})", offset))
            facts += [
                (f"offsetof({own}, n_{member.name})", member.offset)
                for member in layout.root.members
                if member.count_of
            ]
        return facts


@pytest.mark.parametrize("compiler", COMPILERS)
def test_every_bundled_header_compiles(compiler: str, layouts: list[Layout], tmp_path: Path) -> None:
    """Every size, offset and alignment of the header holds, and the compiler adds no padding."""
    exact = "".join(
        f'_Static_assert(_Alignof({layout.type_name.replace("/msg/", "__")}) == {layout.align}, "");\n'
        for layout in {layout.type_name: layout for layout in reversed(layouts)}.values()
    )
    source = c_header(layouts) + exact
    compile_c(compiler, source, tmp_path, *STRICT, "-fsyntax-only")
    compile_c(compiler, source, tmp_path, *STRICT, "-c", "-o", "unit.o")


@pytest.mark.parametrize("compiler", COMPILERS)
def test_every_bundled_layout_is_the_natural_one(
    compiler: str, layouts: list[Layout], tmp_path: Path
) -> None:
    """Plain structs without a padding member get the same sizes, alignments and offsets."""
    plain = PlainStructs()
    facts = plain.facts(layouts)
    assert len(facts) > 4000
    asserts = [f'_Static_assert({expression} == {value}, "");' for expression, value in facts]
    source = "\n".join([*plain.source, *asserts])
    compile_c(compiler, source, tmp_path, *PLAIN, "-c", "-o", "unit.o")


def test_a_running_program_finds_the_same_numbers(layouts: list[Layout], tmp_path: Path) -> None:
    """A compiled program prints the numbers of every bundled type, and they are the layout's."""
    plain = PlainStructs()
    facts = plain.facts(layouts)
    table = ",\n".join(expression for expression, _ in facts)
    program = "\n".join(
        [
            *plain.source,
            "#include <stdio.h>",
            f"static const unsigned long table[] = {{\n{table}\n}};",
            "int main(void) {",
            "  for (size_t i = 0; i < sizeof table / sizeof *table; i++)",
            '    printf("%lu\\n", table[i]);',
            "  return 0;",
            "}",
        ]
    )
    compile_c("gcc", program, tmp_path, *PLAIN, "-o", "program")
    printed = subprocess.run([tmp_path / "program"], capture_output=True, text=True, timeout=60, check=True)
    assert [int(line) for line in printed.stdout.split()] == [value for _, value in facts]


def test_32_bit_x86_agrees_with_the_header(layouts: list[Layout], tmp_path: Path) -> None:
    """Where 8-byte numbers are aligned to 4, the explicit padding keeps every offset."""
    source = c_header(layouts)
    compile_c("gcc", source, tmp_path, *STRICT, "-m32", "-ffreestanding", "-fsyntax-only")


def test_a_wrong_number_does_not_compile(layouts: list[Layout], tmp_path: Path) -> None:
    """The assertions of the header can fail: one changed offset is refused."""
    source = c_header(layouts[:3])
    assert source.count(" == 0);") > 0
    wrong = source.replace(" == 0);", " == 1);", 1)
    with pytest.raises(AssertionError, match="static assertion failed"):
        compile_c("gcc", wrong, tmp_path, *STRICT, "-fsyntax-only")


def test_the_header_is_valid_cpp(layouts: list[Layout], tmp_path: Path) -> None:
    """C++ reads the same header and agrees with its assertions."""
    program = shutil.which("g++")
    if not program:
        pytest.skip("Debian package g++ is missing")
    compile_c(program, c_header(layouts), tmp_path, "-x", "c++", "-std=c++11", "-Wall", "-fsyntax-only")


_STORE = TypeStore.bundled("jazzy")


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    names=st.lists(st.sampled_from(_STORE.names()), min_size=12, max_size=12, unique=True),
    string=st.integers(1, 300),
    sequence=st.integers(1, 40),
    data=st.data(),
)
def test_odd_limits_keep_layout_and_compiler_in_agreement(
    names: list[str],
    string: int,
    sequence: int,
    data: st.DataObject,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Any limits, also different ones for one nested type, give the compiler's own offsets."""
    layouts = []
    for name in names:
        plain_layout = compute_layout(_STORE, name, Limits(string, sequence))
        paths = [
            (path, node)
            for path, _, node in plain_layout.fields()
            if isinstance(node, SequenceNode) or (isinstance(node, StringNode) and node.bound is None)
        ]
        chosen = data.draw(st.lists(st.sampled_from(paths), max_size=4)) if paths else []
        fields = {path: data.draw(st.integers(1, min(node.bound or 50, 50))) for path, node in chosen}
        layouts.append(compute_layout(_STORE, name, Limits(string, sequence, fields)))
    program = "gcc"
    folder = tmp_path_factory.mktemp("limits")
    plain = PlainStructs()
    facts = plain.facts(layouts)
    asserts = [f'_Static_assert({expression} == {value}, "");' for expression, value in facts]
    compile_c(program, "\n".join([*plain.source, *asserts]), folder, *PLAIN, "-fsyntax-only")
    compile_c(program, c_header(layouts), folder, *STRICT, "-fsyntax-only")
