"""The C headers as their users get them: by themselves, in C and C++, and under the example that ships."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import rosplc
from rosplc.config.resolve import load_project
from rosplc.shm import Namespace
from tests.lib.waiting import repeat_until
from tests.verification.call_ends import CALLED, CallEnds

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "c"
HEADERS = sorted((rosplc.include_dir() / "rosplc").glob("*.h"))
COMPILERS = {"C11": ["gcc", "-std=c11"], "C++17": ["g++", "-std=c++17", "-x", "c++"]}
WARNINGS = ["-O2", "-Wall", "-Wextra", "-Wshadow", "-Wconversion", "-pedantic", "-Werror"]
TWIST = "geometry_msgs/msg/Twist"


SANITIZE = ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
BLOCKS = rosplc.include_dir() / "rosplc" / "plc.c"
# What plc.c may ask of the C library: to open and to close, and to copy.
NEEDED = {
    "open",
    "fstat",
    "pread",
    "mmap",
    "munmap",
    "close",
    "getrandom",
    "memcpy",
    "memset",
    "__errno_location",
}


def compile_with(language: str, source: Path, program: Path, *options: str) -> None:
    command = [*COMPILERS[language], *WARNINGS, f"-I{rosplc.include_dir()}", str(source), *options]
    done = subprocess.run([*command, "-o", str(program)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("language", COMPILERS)
def test_every_header_compiles_alone(language: str, tmp_path: Path) -> None:
    """Each header includes what it needs; C and C++ take all of them without a warning."""
    assert len(HEADERS) > 6
    for header in HEADERS:
        source = tmp_path / f"{header.stem}.c"
        source.write_text(f"#define _POSIX_C_SOURCE 200809L\n#include <rosplc/{header.name}>\n")
        compile_with(language, source, tmp_path / "object", "-c")


@contextmanager
def running(command: list[str]) -> Iterator[subprocess.Popen[str]]:
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield child
    finally:
        child.kill()
        child.communicate()


def compile_example(name: str, language: str, folder: Path, *options: str) -> None:
    rosplc.generate(EXAMPLE / "rosplc.yaml", folder / "plc")
    sources = [str(BLOCKS)] if name == "blocks.c" else []
    compile_with(language, EXAMPLE / name, folder / "echo", f"-I{folder / 'plc'}", *sources, *options)


@pytest.mark.parametrize("language", COMPILERS)
def test_the_blocks_allocate_nothing(language: str, tmp_path: Path) -> None:
    """What plc.c calls is what opens, closes and copies; no allocator, lock or clock is among it."""
    compile_with(language, BLOCKS, tmp_path / "plc.o", "-c", "-fno-stack-protector", "-U_FORTIFY_SOURCE")
    done = subprocess.run(["nm", "-u", tmp_path / "plc.o"], capture_output=True, text=True, check=True)
    called = {line.split()[-1].partition("@")[0] for line in done.stdout.splitlines()}
    assert called - {"_GLOBAL_OFFSET_TABLE_"} == NEEDED


def test_the_blocks_make_no_system_call_once_open(tmp_path: Path, shm_namespace: Namespace) -> None:
    """The kernel kills this program for any system call behind opening, and it reads and writes on."""
    rosplc.generate(EXAMPLE / "rosplc.yaml", tmp_path / "plc")
    source = Path(__file__).with_name("no_system_call.c")
    compile_with("C11", source, tmp_path / "silent", f"-I{tmp_path / 'plc'}", str(BLOCKS))
    prefix = shm_namespace.prefix
    with (
        rosplc.bind("/cmd_vel", TWIST, prefix=prefix) as to_plc,
        rosplc.bind("/cmd_vel_echo", TWIST, "to_ros", prefix=prefix) as to_ros,
        running([str(tmp_path / "silent"), prefix]) as child,
    ):
        answers: list[Any] = []
        repeat_until(
            lambda: to_plc.write({"linear": {"x": 3.0}}),
            lambda: answers.append(to_ros.read()) or child.poll() is not None,
            "the program's end",
            every=0.01,
        )
        assert child.returncode == 0
        assert any(answers)


def test_calls_make_no_system_call_once_open(tmp_path: Path, shm_namespace: Namespace) -> None:
    """Nor do clients and servers of services and actions, from the call to the answer."""
    config = tmp_path / "rosplc.yaml"
    config.write_text(f"prefix: {shm_namespace.prefix}\n{CALLED}")
    rosplc.generate(config, tmp_path / "plc")
    source = Path(__file__).with_name("no_system_call_calls.c")
    compile_with("C11", source, tmp_path / "silent", f"-I{tmp_path / 'plc'}", str(BLOCKS))
    with running([str(tmp_path / "silent"), shm_namespace.prefix]) as child:

        def alive() -> None:
            assert not child.poll(), f"ended with {child.returncode}"

        with CallEnds(load_project(config), shm_namespace, alive) as ends:
            ends.let_all_cross()
            assert child.wait(100) == 0


@pytest.mark.parametrize(
    ("name", "language", "options"),
    [
        *(("echo.c", language, []) for language in COMPILERS),
        *(("blocks.c", language, SANITIZE) for language in COMPILERS),
    ],
)
def test_the_example_answers_and_outlives_its_channels(
    name: str, language: str, options: list[str], tmp_path: Path, shm_namespace: Namespace
) -> None:
    """It starts before the bridge, answers each message, and follows both channels when they are replaced."""
    compile_example(name, language, tmp_path, *options)
    prefix = shm_namespace.prefix
    with running([str(tmp_path / "echo"), prefix]) as child:
        for slots in (4, 8):  # another geometry: the object is replaced
            with (
                rosplc.bind("/cmd_vel", TWIST, prefix=prefix, slots=slots) as to_plc,
                rosplc.bind("/cmd_vel_echo", TWIST, "to_ros", prefix=prefix, slots=slots) as to_ros,
            ):
                answers: list[Any] = []

                repeat_until(
                    lambda to=to_plc: to.write({"linear": {"x": 3.0}}),
                    lambda back=to_ros, answers=answers: answers.append(back.read()) or any(answers),
                    "an answer",
                )
                assert {message.linear.x for message in answers if message} == {1.5}
        child.terminate()
        assert child.wait(100) == 0
