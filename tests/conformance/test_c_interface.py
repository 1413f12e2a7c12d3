"""The C headers as their users get them: by themselves, in C and C++, and under the example that ships."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import rosplc
from rosplc.shm import Namespace
from tests.lib.waiting import repeat_until

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "c"
HEADERS = sorted((rosplc.include_dir() / "rosplc").glob("*.h"))
COMPILERS = {"C11": ["gcc", "-std=c11"], "C++17": ["g++", "-std=c++17", "-x", "c++"]}
WARNINGS = ["-O2", "-Wall", "-Wextra", "-Wshadow", "-Wconversion", "-pedantic", "-Werror"]
TWIST = "geometry_msgs/msg/Twist"


def compile_with(language: str, source: Path, program: Path, *options: str) -> None:
    command = [*COMPILERS[language], *WARNINGS, f"-I{rosplc.include_dir()}", *options, str(source)]
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
def running(program: Path, prefix: str) -> Iterator[subprocess.Popen[str]]:
    child = subprocess.Popen([str(program), prefix], stdout=subprocess.PIPE, text=True)
    try:
        yield child
    finally:
        child.kill()
        child.communicate()


@pytest.mark.parametrize("language", COMPILERS)
def test_the_example_answers_and_outlives_its_channels(
    language: str, tmp_path: Path, shm_namespace: Namespace
) -> None:
    """It starts before the bridge, answers each message, and follows both channels when they are replaced."""
    rosplc.generate(EXAMPLE / "rosplc.yaml", tmp_path / "plc")
    compile_with(language, EXAMPLE / "echo.c", tmp_path / "echo", f"-I{tmp_path / 'plc'}")
    prefix = shm_namespace.prefix
    with running(tmp_path / "echo", prefix) as child:
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
