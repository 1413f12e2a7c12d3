"""``rosplc service``: what it writes, what systemd says of it, and how it is taken away again."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rosplc.errors import SetupError
from rosplc.service.install import MARK, Plan, Run, Step, Write, execute

EXPOSURE = 2.0
"""The highest exposure that docs/howto/run-as-a-service.md promises; systemd's scale goes from 0 to 10."""


def _right_to_read() -> str:
    """Return a capability that lets nobody's process read a checkout where nobody else may look."""
    bounding = int(
        re.findall(r"^CapBnd:\s*(\w+)", Path("/proc/self/status").read_text(), re.MULTILINE)[0], 16
    )
    return "-all,+dac_read_search" if bounding & 1 << 2 else "-all,+dac_override"


_READ = _right_to_read()
_AS_NOBODY = ["setpriv", "--reuid", "65534", "--regid", "65534", "--clear-groups"]
_AS_NOBODY += ["--inh-caps", _READ, "--ambient-caps", _READ, "--bounding-set", _READ]
AS_NOBODY = tuple(_AS_NOBODY) if os.geteuid() == 0 else ()

needs_systemd = pytest.mark.needs("systemd")


def rosplc(
    *arguments: object, before: tuple[str, ...] = (), **settings: object
) -> subprocess.CompletedProcess[str]:
    """Run the command."""
    return subprocess.run(
        [*before, sys.executable, "-m", "rosplc", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        **settings,  # type: ignore[call-overload]
    )


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Give a machine's folder with a configuration, systemd's own units and a rosplc command."""
    (tmp_path / "etc/rosplc").mkdir(parents=True)
    configure(tmp_path, "cell1")
    for units in (Path("/usr/lib/systemd/system"), Path("/lib/systemd/system")):
        if units.is_dir():
            target = tmp_path / "usr/lib/systemd/system"
            target.mkdir(parents=True, exist_ok=True)
            for unit in (*units.glob("*.target"), *units.glob("*.slice")):
                if unit.is_file() and not (target / unit.name).exists():
                    shutil.copy(unit, target / unit.name)
    return tmp_path


def configure(root: Path, name: str, text: str = "") -> Path:
    """Write a configuration into a machine's folder."""
    path = root / f"etc/rosplc/{name}.yaml"
    path.write_text(f"{text}\ntopics: {{/cmd_vel: {{type: geometry_msgs/msg/Twist, to: plc}}}}\n")
    return path


def installed(root: Path) -> dict[str, str]:
    """Return the files of services below a root, by path."""
    found = [*root.glob("etc/systemd/**/*"), *root.glob("etc/sysusers.d/*")]
    return {str(path.relative_to(root)): path.read_text() for path in found if path.is_file()}


def offer_program(root: Path) -> None:
    """Put a program where the unit looks for it; systemd checks that it can be executed."""
    for text in installed(root).values():
        for line in re.findall(r"^Exec\w+=(/\S+)", text, re.MULTILINE):
            program = root / line.lstrip("/")
            program.parent.mkdir(parents=True, exist_ok=True)
            program.write_text("#!/bin/sh\n")
            program.chmod(0o755)


def test_dry_run_shows_everything_and_does_nothing(root: Path) -> None:
    """Every file with its text and every command is shown; nothing is written."""
    shown = rosplc("service", "install", "cell1", "--root", root, "--dry-run")
    assert shown.returncode == 0, shown.stderr
    assert installed(root) == {}
    told = rosplc("service", "install", "cell1", "--root", root, "--dry-run", "--json")
    document = json.loads(told.stdout)
    assert document["done"] is False
    for step in document["steps"]:
        if "write" in step:
            assert step["write"] in shown.stdout
            assert all(line in shown.stdout for line in step["text"].splitlines())
        else:
            assert " ".join(step["run"]) in shown.stdout
    assert [step["run"][0] for step in document["steps"] if "run" in step] == [
        "systemd-sysusers",
        "systemctl",
    ]


def test_dry_run_needs_no_rights() -> None:
    """For this machine itself, too, anybody may look at what would be done."""
    example = Path(__file__).parents[3] / "examples"
    config = next(example.rglob("rosplc.yaml"))
    shown = rosplc("service", "install", "cell1", "--config", config, "--dry-run", before=AS_NOBODY)
    assert shown.returncode == 0, shown.stderr
    assert "run systemctl daemon-reload" in shown.stdout
    assert "ExecStart=" in shown.stdout


@pytest.mark.parametrize("verb", ["install", "uninstall"])
def test_without_root_it_says_so(verb: str) -> None:
    """Who may not change the machine is told what would help, before anything is looked for."""
    done = rosplc("service", verb, "cell1", before=AS_NOBODY)
    assert done.returncode == 1
    assert "SYS011" in done.stderr and "sudo" in done.stderr and "--dry-run" in done.stderr


@needs_systemd
def test_install_is_repeated_without_a_change(root: Path) -> None:
    """A second run changes no byte, enables nothing twice, and creates no second user."""
    first = rosplc("service", "install", "cell1", "--root", root)
    assert first.returncode == 0, first.stderr
    files, passwords = installed(root), (root / "etc/passwd").read_text()
    assert len(files) >= 3 and passwords.count("rosplc:") == 1
    times = {path: (root / path).stat().st_mtime_ns for path in files}
    again = rosplc("service", "install", "cell1", "--root", root)
    assert again.returncode == 0, again.stderr
    assert "write" not in again.stdout
    assert installed(root) == files and (root / "etc/passwd").read_text() == passwords
    assert {path: (root / path).stat().st_mtime_ns for path in files if not (root / path).is_symlink()} == {
        path: time for path, time in times.items() if not (root / path).is_symlink()
    }
    assert not list(root.rglob("*.new"))


@needs_systemd
def test_systemd_accepts_the_unit_and_calls_it_safe(root: Path) -> None:
    """The unit passes systemd's own check, and its exposure is below what the documentation says."""
    configure(root, "cell2", "shm: {group: plc}\nrealtime: {policy: fifo, priority: 30, lock_memory: true}")
    for name in ("cell1", "cell2"):
        assert rosplc("service", "install", name, "--root", root).returncode == 0
    offer_program(root)
    for name in ("cell1", "cell2"):
        unit = f"rosplc@{name}.service"
        verified = subprocess.run(
            ["systemd-analyze", "verify", "--man=no", f"--root={root}", unit], capture_output=True, text=True
        )
        assert verified.returncode == 0, verified.stderr
        assert "rosplc" not in verified.stderr, "a warning about the unit"
        rated = subprocess.run(
            ["systemd-analyze", "security", "--offline=true", f"--root={root}", unit],
            capture_output=True,
            text=True,
        )
        found = re.search(r"exposure level for \S+: ([0-9.]+)", rated.stdout)
        assert found, rated.stdout + rated.stderr
        assert float(found[1]) <= EXPOSURE


@needs_systemd
def test_real_time_is_given_to_who_asks_for_it(root: Path) -> None:
    """Only a configuration with realtime: raises limits, by what it asks for, and never a capability."""
    cases = {
        "plain": ("", set()),
        "fifo": ("realtime: {policy: fifo, priority: 33}", {"RestrictRealtime=no", "LimitRTPRIO=33"}),
        "locked": ("realtime: {lock_memory: true}", {"LimitMEMLOCK=infinity"}),
        "pinned": ("realtime: {affinity: [0]}", set()),
    }
    for name, (text, lines) in cases.items():
        configure(root, name, text)
        assert rosplc("service", "install", name, "--root", root).returncode == 0
        own = (root / f"etc/systemd/system/rosplc@{name}.service.d/10-rosplc.conf").read_text()
        assert {line for line in own.splitlines() if re.match("Limit|Restrict", line)} == lines
        assert ("@resources" in own) is bool(text)
        assert "Capabilit" not in own
    shared = (root / "etc/systemd/system/rosplc@.service").read_text()
    assert "\nCapabilityBoundingSet=\nAmbientCapabilities=\n" in shared


@needs_systemd
def test_uninstall_takes_away_what_was_installed(root: Path) -> None:
    """The first service takes its own files along, the last what they share too; users and settings stay."""
    configure(root, "cell2")
    for name in ("cell1", "cell2"):
        assert rosplc("service", "install", name, "--root", root).returncode == 0
    assert rosplc("service", "uninstall", "cell1", "--root", root).returncode == 0
    left = installed(root)
    assert "etc/systemd/system/rosplc@.service" in left and not [path for path in left if "cell1" in path]
    states = json.loads(rosplc("service", "status", "--root", root, "--json").stdout)["services"]
    assert [(state["name"], state["enabled"]) for state in states] == [("cell2", "enabled")]
    again = rosplc("service", "uninstall", "cell1", "--root", root)
    assert again.returncode == 1 and "installed: cell2" in again.stderr
    assert rosplc("service", "uninstall", "cell2", "--root", root).returncode == 0
    assert installed(root) == {}
    assert (root / "etc/rosplc/cell1.yaml").exists() and "rosplc:" in (root / "etc/passwd").read_text()
    assert "No bridge" in rosplc("service", "status", "--root", root).stdout


def test_a_file_of_somebody_else_is_left_alone(root: Path) -> None:
    """A unit that an administrator wrote is neither replaced nor removed."""
    unit = root / "etc/systemd/system/rosplc@.service"
    unit.parent.mkdir(parents=True)
    unit.write_text("[Service]\nExecStart=/bin/true\n")
    done = rosplc("service", "install", "cell1", "--root", root)
    assert done.returncode == 1 and "SYS011" in done.stderr and str(unit) in done.stderr
    assert list(installed(root)) == ["etc/systemd/system/rosplc@.service"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"name": "a\nExecStartPre=/bin/x"},
        {"name": "../x"},
        {"user": "root;x"},
        {"config": Path("/etc/a b.yaml")},
        {"config": Path("/etc/%h")},
    ],
)
def test_nothing_is_smuggled_into_a_unit(wrong: dict[str, object]) -> None:
    """Names and paths with a meaning to systemd are refused."""
    right: dict[str, object] = {
        "name": "cell1",
        "user": "rosplc",
        "config": Path("/etc/rosplc/cell1.yaml"),
        "program": Path("/opt/rosplc/bin/rosplc"),
    }
    with pytest.raises(SetupError, match="SYS011"):
        Plan(**(right | wrong))  # type: ignore[arg-type]


def test_what_the_service_could_not_see_is_said(root: Path, tmp_path: Path) -> None:
    """A configuration in a home folder, or objects without a group, are noted before anybody wonders."""
    (root / "home/me").mkdir(parents=True)
    shutil.copy(root / "etc/rosplc/cell1.yaml", root / "home/me/cell9.yaml")
    done = rosplc("service", "install", "--config", "/home/me/cell9.yaml", "--root", root, "--dry-run")
    assert done.returncode == 0, done.stderr
    assert "the service cannot access the configuration /home/me/cell9.yaml" in done.stderr
    assert "shm.group is not set" in done.stderr


def test_a_wrong_configuration_is_no_service(root: Path) -> None:
    """A configuration that would not start is refused with its line, before anything is written."""
    (root / "etc/rosplc/bad.yaml").write_text("topics:\n  /x: {type: 1}\n")
    done = rosplc("service", "install", "bad", "--root", root)
    assert done.returncode == 2 and "bad.yaml:2" in done.stderr
    assert installed(root) == {}


def test_files_of_ours_are_marked(root: Path) -> None:
    """Each file says who wrote it, which is how it is known again."""
    told = rosplc("service", "install", "cell1", "--root", root, "--dry-run", "--json")
    for step in json.loads(told.stdout)["steps"]:
        assert "write" not in step or step["text"].startswith(MARK)


@pytest.mark.needs(
    when=not Path("/run/systemd/system").exists(), why="systemd runs this machine: it would be done"
)
def test_without_systemd_it_says_so(root: Path) -> None:
    """Where systemd does not run, root is told so before anything is written."""
    config = root / "etc/rosplc/cell1.yaml"
    done = rosplc("service", "install", "cell1", "--config", config)
    assert done.returncode == 1
    assert "SYS011" in done.stderr
    assert "systemd is not running" in done.stderr or "only root" in done.stderr
    assert not Path("/etc/systemd/system/rosplc@cell1.service.d").exists()


def test_the_first_file_that_cannot_be_written_ends_it(tmp_path: Path) -> None:
    """A step that fails is named, and what comes after it is not done."""
    (tmp_path / "etc").write_text("a file, no folder")
    steps: list[Step] = [
        Write(tmp_path / "etc/sysusers.d/x.conf", "text"),
        Write(tmp_path / "second", "text"),
    ]
    told: list[str] = []
    with pytest.raises(SetupError, match=r"cannot write .*x\.conf.*SYS011"):
        execute(steps, told.append)
    assert len(told) == 1 and not (tmp_path / "second").exists()


def test_a_command_that_fails_is_named_with_what_it_said(tmp_path: Path) -> None:
    """Exit status and message of a command reach the reader; a missing program is one too."""
    with pytest.raises(SetupError, match=r"sh -c .*failed: no such unit"):
        execute([Run(("sh", "-c", "echo no such unit >&2; exit 3"))], lambda _: None)
    with pytest.raises(SetupError, match="rosplc-no-such-program is not installed"):
        execute([Run(("rosplc-no-such-program",))], lambda _: None)
