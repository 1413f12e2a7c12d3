"""The plan executor under sanitizers and on other processors; tests/fuzz has the fuzzers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
INCLUDES = [f"-I{ROOT}/src/rosplc/_core", f"-I{ROOT}/tests/fuzz/native"]
FLAGS = ["-std=gnu11", "-Wall", "-Wextra", "-Werror", *INCLUDES]
SANITIZE = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
MACHINES = [
    pytest.param("arm", "gnueabihf", marks=pytest.mark.needs("gcc-arm-linux-gnueabihf", "qemu-user")),
    pytest.param("aarch64", "gnu", marks=pytest.mark.needs("gcc-aarch64-linux-gnu", "qemu-user")),
]


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
    assert "digest" in drive(["gcc", *SANITIZE], tmp_path / "driver", plans, rounds)


@pytest.mark.parametrize(("processor", "system"), MACHINES)
def test_processors_agree(tmp_path: Path, plans: Path, processor: str, system: str) -> None:
    """On 32-bit and 64-bit ARM every check holds, and all results are those of this machine."""
    here = drive(["gcc", "-O2"], tmp_path / "here", plans, 100)
    compiler = [f"{processor}-linux-{system}-gcc", "-O2", "-static"]
    there = drive(compiler, tmp_path / "there", plans, 100, (f"qemu-{processor}",))
    assert there == here
