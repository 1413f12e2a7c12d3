"""The plan executor under sanitizers and on other processors; tests/fuzz has the fuzzers."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
INCLUDES = [f"-I{ROOT}/src/rosplc/_core", f"-I{ROOT}/tests/fuzz/native"]
FLAGS = ["-std=gnu11", "-Wall", "-Wextra", "-Werror", *INCLUDES]
SANITIZE = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
MACHINES = {
    "arm-linux-gnueabihf-gcc": ("gcc-arm-linux-gnueabihf", "qemu-arm"),
    "aarch64-linux-gnu-gcc": ("gcc-aarch64-linux-gnu", "qemu-aarch64"),
}


def need(program: str, package: str) -> None:
    if shutil.which(program) is None:
        pytest.skip(f"Debian package {package} is missing")


@pytest.fixture(scope="module")
def plans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plans") / "plans"
    command = [sys.executable, "-m", "tests.fuzz.export_plans", str(path)]
    subprocess.run(command, check=True, timeout=120, cwd=ROOT)
    return path


def drive(
    compiler: list[str], program: Path, plans: Path, rounds: int, emulator: tuple[str, ...] = ()
) -> str:
    """Build the driver, run it, and return what it prints."""
    subprocess.run(
        [*compiler, *FLAGS, str(ROOT / "tests/fuzz/native/plan_driver.c"), "-o", str(program)], check=True
    )
    command = [*emulator, str(program), str(plans), str(rounds)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("rounds", [300, pytest.param(30_000, marks=pytest.mark.verify(minutes=2))])
@pytest.mark.timeout(1200)
def test_sanitizers_find_nothing(tmp_path: Path, plans: Path, rounds: int) -> None:
    """Truncated, mutated and random input in exact-size memory gives no bad access and no undefined step."""
    need("gcc", "gcc")
    assert "digest" in drive(["gcc", *SANITIZE], tmp_path / "driver", plans, rounds)


@pytest.mark.parametrize("compiler", MACHINES)
def test_processors_agree(tmp_path: Path, plans: Path, compiler: str) -> None:
    """On 32-bit and 64-bit ARM every check holds, and all results are those of this machine."""
    package, emulator = MACHINES[compiler]
    need("gcc", "gcc")
    need(compiler, package)
    need(emulator, "qemu-user")
    here = drive(["gcc", "-O2"], tmp_path / "here", plans, 100)
    there = drive([compiler, "-O2", "-static"], tmp_path / "there", plans, 100, (emulator,))
    assert there == here
