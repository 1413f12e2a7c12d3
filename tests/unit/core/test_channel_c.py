"""channel.h alone: built as C for several processors and with sanitizers, and run."""

from __future__ import annotations

import os
import platform
import subprocess
from pathlib import Path

import pytest

pytestmark = pytest.mark.verifies("core", own="randomly overwritten words, emulated ARM")

_SOURCE = Path(__file__).with_name("channel_test.c")
_INCLUDE = Path(__file__).resolve().parents[3] / "src/rosplc/include"
_WARNINGS = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror"]
_SANITIZE = ["-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


def _build(folder: Path, compiler: str, *options: str) -> str:
    target = folder / "channel_test"
    command = [compiler, *_WARNINGS, *options, f"-I{_INCLUDE}", str(_SOURCE), "-o", str(target)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return str(target)


def _kind(name: str, *marks: pytest.MarkDecorator) -> object:
    """Return a parameter whose tests run in one worker, which builds the program once."""
    return pytest.param(name, marks=[*marks, pytest.mark.xdist_group(f"channel-{name}")])


_ARMHF = pytest.mark.needs("gcc-arm-linux-gnueabihf", "libc6-dev-armhf-cross", "qemu-user")


@pytest.fixture(scope="module", params=[_kind("native"), _kind("sanitized"), _kind("armhf", _ARMHF)])
def program(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp(request.param)
    if request.param == "armhf":
        return ["qemu-arm", _build(folder, "arm-linux-gnueabihf-gcc", "-static")]
    return [_build(folder, "gcc", *(_SANITIZE if request.param == "sanitized" else ()))]


def _run(command: list[str], *arguments: object) -> dict[str, int]:
    done = subprocess.run([*command, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    words = done.stdout.split()
    return {name: int(value) for name, value in zip(words[::2], words[1::2], strict=True) if value.isdigit()}


def test_rules(program: list[str]) -> None:
    """Sequences, windows, losses, claims and identities follow the format, across the wrap too."""
    done = subprocess.run([*program, "logic"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_scribbled_words(program: list[str], seed: int) -> None:
    """Whatever is in the control words, no access leaves it, and nothing accepted is a mixture."""
    rounds = 5_000 if "qemu" in program[0] else 50_000
    assert _run(program, "scribble", rounds, seed)["taken"] > 0


def test_torn_messages_on_arm_and_sanitized(program: list[str]) -> None:
    """A reader beside a flat-out writer accepts whole messages only."""
    assert _run(program, "torn", 2, 1024, 4, "next", 20_000)["torn"] == 0


def test_withdrawn_calls(program: list[str]) -> None:
    """No call is executed and reported as not executed, while one side withdraws what the other takes."""
    calls = 2_000 if "qemu" in program[0] else 200_000
    result = _run(program, "withdrawn", calls)
    assert result["both"] == 0
    assert result["executed"] > calls // 4096


@pytest.mark.needs("gcc-aarch64-linux-gnu", "libc6-dev-arm64-cross")
def test_builds_for_arm64(tmp_path: Path) -> None:
    """The header compiles for arm64 without a warning."""
    _build(tmp_path, "aarch64-linux-gnu-gcc")


@pytest.fixture(scope="module")
def native(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return [_build(tmp_path_factory.mktemp("torn"), "gcc")]


@pytest.mark.parametrize("mode", ["checked", "next"])
@pytest.mark.parametrize(("size", "slots"), [(8, 4), (200, 4), (200, 8), (4096, 4), (65536, 4), (1048576, 4)])
def test_torn_messages(native: list[str], size: int, slots: int, mode: str) -> None:
    """On two cores no message is torn, in either way of reading, at any size."""
    result = _run(native, "torn", 1.5, size, slots, mode, 100_000)
    assert result["torn"] == 0
    assert result["accepted"] > 0


@pytest.mark.needs(when=(os.cpu_count() or 1) > 1, why="tearing needs two cores to be seen")
@pytest.mark.parametrize("size", [4096, 65536])
def test_tearing_can_be_seen(native: list[str], size: int) -> None:
    """The same reading without the re-check does accept torn messages, so the test can fail."""
    assert _run(native, "torn", 20, size, 4, "unchecked", 2_000_000 if size < 65536 else 200_000)["torn"] > 0


@pytest.mark.verify(minutes=0.5)
@pytest.mark.serial
@pytest.mark.parametrize("mode", ["checked", "next"])
@pytest.mark.parametrize(("size", "slots"), [(200, 4), (4096, 4), (4096, 16), (65536, 4), (1048576, 4)])
def test_torn_messages_for_long(native: list[str], size: int, slots: int, mode: str) -> None:
    """Millions of messages later, still none is torn."""
    assert _run(native, "torn", 20, size, slots, mode, 10_000_000)["torn"] == 0


@pytest.mark.verify(minutes=0.5)
def test_scribbled_words_for_long(native: list[str]) -> None:
    """Millions of rounds of scribbling later, every access was inside the object."""
    for seed in range(10, 20):
        assert _run(native, "scribble", 1_000_000, seed)["taken"] > 0


@pytest.mark.needs(when=platform.machine() == "x86_64", why="a compiler for x86")
@pytest.mark.parametrize(
    ("options", "instruction"),
    [(["-m64"], "sfence"), (["-m32", "-march=i686", "-msse"], "sfence"), (["-m32", "-march=i586"], "lock")],
    ids=["x86-64", "i386 with SSE", "i386 without SSE"],
)
def test_large_copies_are_ordered(tmp_path: Path, options: list[str], instruction: str) -> None:
    """The release fence orders the non-temporal stores that a C library may copy with, on every x86."""
    source, assembly = tmp_path / "fence.c", tmp_path / "fence.s"
    source.write_text("#include <rosplc/format.h>\nvoid f(uint32_t n) { rosplc_fence_release(n); }\n")
    (tmp_path / "gnu").mkdir()
    (tmp_path / "gnu" / "stubs-32.h").touch()  # the one header that only the 32-bit library has
    includes = [f"-I{_INCLUDE}", f"-I{tmp_path}", "-I/usr/include/x86_64-linux-gnu"]
    command = ["gcc", "-O2", "-S", *options, *includes, str(source), "-o", str(assembly)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert instruction in assembly.read_text()
