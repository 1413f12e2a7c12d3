"""What the package index gets: a source distribution, and a wheel made from it that works by itself."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tarfile
import zipfile
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import pytest
from packaging.metadata import Metadata

import rosplc
from deploy.wheel import PIP, copy_source
from rosplc.demo.plan import FreeDomain
from rosplc.shm import Namespace
from tests.lib.archives import unpack

pytestmark = pytest.mark.verifies("pip", real="pip")

ROOT = Path(__file__).resolve().parents[2]
OURS = {"rosplc", "rosplc_st", "rosplc_bench"}
# For type checkers alone, installed with a ROS, or a requirement of rosbags whose errors it raises.
ELSEWHERE = {"_typeshed", "apsw", "rclpy", "rcl_interfaces", "rospy", "rosgraph", "builtin_interfaces"}


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def run(*command: str, cwd: Path, status: int = 0) -> str:
    done = subprocess.run(
        command, cwd=cwd, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert done.returncode == status, f"{' '.join(command)}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def build(folder: Path) -> tuple[Path, Path]:
    """Return a source distribution, and the wheel that was made from it alone."""
    # `make setup` installs it; an environment of one's own may have an older one, or none.
    pytest.importorskip("setuptools", minversion="77")
    made = folder / "made"
    program = f"import setuptools.build_meta as backend; backend.build_sdist({str(made)!r})"
    run(sys.executable, "-c", program, cwd=copy_source(folder / "source"))
    (sources,) = made.iterdir()
    unpack(sources, folder)
    options = ("--no-deps", "--no-build-isolation", "--wheel-dir", str(made))
    run(*PIP, "wheel", *options, ".", cwd=folder / f"rosplc-{rosplc.__version__}")
    (wheel,) = made.glob("*.whl")
    return sources, wheel


@pytest.mark.foreign
def test_both_distributions_are_complete(tmp_path: Path) -> None:
    """Every module, stub and template is in both, with one C core in the wheel, and nothing else."""
    sources, wheel = build(tmp_path)
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
    assert len(core) == 3
    if sys.version_info >= (3, 11):
        assert core == {
            f"rosplc/{name}.abi3.so" for name in ("_core/_native", "ros/dds/_batch", "ros/rospy/_tcp")
        }
        assert "-cp311-abi3-" in wheel.name
    assert {Path(name).name for name in information} >= {"METADATA", "LICENSE", "entry_points.txt"}
    with tarfile.open(sources) as archive:
        held = {member.name.partition("/")[2] for member in archive if member.isfile()}
    beside = {"pyproject.toml", "setup.py", "setup.cfg", "README.md", "LICENSE", "PKG-INFO"}
    assert {name for name in held if ".egg-info/" not in name} == beside | {
        f"src/{name}" for name in expected
    }

    described = zipfile.ZipFile(wheel).read(next(name for name in information if name.endswith("/METADATA")))
    metadata = Metadata.from_email(described)  # raises for a field that the index would refuse
    assert (metadata.name, str(metadata.version)) == ("rosplc", rosplc.__version__)
    assert (metadata.license_expression, metadata.license_files) == ("Apache-2.0", ["LICENSE"])
    assert str(metadata.requires_python) == ">=3.10"
    assert metadata.summary and metadata.keywords and metadata.classifiers
    assert metadata.description_content_type == "text/markdown"
    assert metadata.description and metadata.description.startswith("# rosplc\n")
    # The index shows no file of the repository.
    assert re.findall(r"\]\((?!https://)|<!--", metadata.description) == []


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


@pytest.mark.verify(minutes=2)
@pytest.mark.timeout(900)
def test_wheel_works_in_an_empty_environment(tmp_path: Path, shm_namespace: Namespace) -> None:
    """Without an extra it checks, generates, runs and shows; a verb that needs an extra names the command."""
    _, wheel = build(tmp_path)
    run(sys.executable, "-m", "venv", "env", cwd=tmp_path)
    binaries = tmp_path / "env" / "bin"
    run(f"{binaries}/pip", "--disable-pip-version-check", "install", "-q", str(wheel), cwd=tmp_path)
    command = f"{binaries}/rosplc"
    assert rosplc.__version__ in run(command, "--version", cwd=tmp_path)
    assert "Twist" in run(command, "types", "geometry_msgs/msg/Twist", cwd=tmp_path)

    domain = FreeDomain()
    settings = f"prefix: {shm_namespace.prefix}\nros: {{domain: {domain.number}}}\n"
    topics = (ROOT / "examples/c/rosplc.yaml").read_text("utf-8")
    (tmp_path / "rosplc.yaml").write_text(settings + topics, "utf-8")
    assert "is valid" in run(command, "check", cwd=tmp_path)
    run(command, "generate", "--out", "plc", cwd=tmp_path)
    assert (tmp_path / "plc" / "rosplc.h").exists()
    with subprocess.Popen([command, "run"], cwd=tmp_path, stderr=subprocess.PIPE, text=True) as bridge:
        try:
            assert bridge.stderr
            log = next((line for line in bridge.stderr if "carries 2 topics" in line), "")
            assert log, f"the bridge ended with {bridge.wait()}"
            assert "/cmd_vel_echo" in run(command, "show", cwd=tmp_path)
            assert "process " in run(command, "status", cwd=tmp_path, status=1)  # there is no PLC
        finally:
            bridge.terminate()
            domain.close()
    assert bridge.returncode == 0

    remedy = f"{binaries}/pip install 'rosplc[views]'"
    assert remedy in run(command, "web", cwd=tmp_path, status=1)


@pytest.mark.foreign
@pytest.mark.timeout(900)
def test_the_index_takes_both_and_ci_builds_the_wheels(tmp_path: Path) -> None:
    """The index's own check passes, and cibuildwheel would build for the three architectures."""
    distributions = [str(path) for path in build(tmp_path)]
    run(sys.executable, "-m", "venv", "env", cwd=tmp_path)
    binaries = tmp_path / "env" / "bin"
    run(f"{binaries}/pip", "install", "-q", "twine", "cibuildwheel>=3,<4", cwd=tmp_path)
    run(f"{binaries}/twine", "check", "--strict", *distributions, cwd=tmp_path)
    wheels = run(
        f"{binaries}/cibuildwheel", "--platform", "linux", "--print-build-identifiers", cwd=ROOT
    ).split()
    assert sorted(wheels) == [
        f"cp3{minor}-manylinux_{machine}" for minor in (10, 11) for machine in ("aarch64", "armv7l", "x86_64")
    ]
