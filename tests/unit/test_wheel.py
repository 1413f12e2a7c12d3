"""What `pip install` gives: a wheel with everything in it, that works by itself."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import zipfile
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import pytest

import rosplc
from deploy.wheel import build_wheel

ROOT = Path(__file__).resolve().parents[2]
OURS = {"rosplc", "rosplc_st", "rosplc_bench"}
# For type checkers alone, installed with a ROS, or a requirement of rosbags whose errors it raises.
ELSEWHERE = {"_typeshed", "apsw", "rclpy", "rcl_interfaces", "rospy", "rosgraph", "builtin_interfaces"}


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def run(*command: str, cwd: Path) -> str:
    done = subprocess.run(
        command, cwd=cwd, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"
    return done.stdout


def build(folder: Path) -> Path:
    # `make setup` installs it; an environment of one's own may have an older one, or none.
    pytest.importorskip("setuptools", minversion="77")
    return build_wheel(folder)


def test_wheel_holds_package_types_and_core(tmp_path: Path) -> None:
    """Every module, stub and template is in the wheel, with one C core, and nothing else."""
    wheel = build(tmp_path)
    names = set(zipfile.ZipFile(wheel).namelist())
    package = ROOT / "src" / "rosplc"
    expected = {
        str(Path("rosplc") / path.relative_to(package))
        for path in package.rglob("*")
        if path.is_file()
        and path.suffix not in (".so", ".o", ".pyc")
        and "__pycache__" not in path.parts
        # editors and other tools may be at work in the tree
        and not path.name.startswith(".")
    }
    core = {name for name in names if name.endswith(".so")}
    information = {name for name in names if ".dist-info/" in name}
    assert expected - names == set()
    assert names - expected - core - information == set()
    assert len(core) == 1
    if sys.version_info >= (3, 11):
        assert core == {"rosplc/_core/_native.abi3.so"}
        assert "-cp311-abi3-" in wheel.name
    assert {Path(name).name for name in information} >= {"METADATA", "LICENSE", "entry_points.txt"}


def test_every_import_is_declared() -> None:
    """What the package imports is Python's own, its own, or a dependency that it names."""
    declared = {canonical(re.split(r"[^\w.-]", one)[0]) for one in requires("rosplc") or ()}
    provides = packages_distributions()
    for path in (ROOT / "src" / "rosplc").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            for name in (
                {name.partition(".")[0] for name in names} - sys.stdlib_module_names - OURS - ELSEWHERE
            ):
                found = {canonical(one) for one in provides.get(name, (name,))}
                assert found & declared, f"{path.name} imports {name}, which pyproject.toml does not name"


@pytest.mark.verify(minutes=1)
@pytest.mark.timeout(900)
def test_wheel_works_in_an_empty_environment(tmp_path: Path) -> None:
    """Installed with the dependencies that it names, the package imports and the command runs."""
    wheel = build(tmp_path)
    run(sys.executable, "-m", "venv", str(tmp_path / "env"), cwd=tmp_path)
    binaries = tmp_path / "env" / "bin"
    run(str(binaries / "pip"), "--disable-pip-version-check", "install", "-q", str(wheel), cwd=tmp_path)
    python = str(binaries / "python")
    program = "import rosplc, rosplc._core._native, rosplc.bridge; print(rosplc.__file__)"
    assert str(tmp_path) in run(python, "-c", program, cwd=tmp_path)
    version = run(str(binaries / "rosplc"), "--version", cwd=tmp_path)
    assert rosplc.__version__ in version
    assert "Twist" in run(str(binaries / "rosplc"), "types", "geometry_msgs/msg/Twist", cwd=tmp_path)
