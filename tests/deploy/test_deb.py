"""The Debian package: installed, upgraded under a running bridge, removed and purged by dpkg itself."""

from __future__ import annotations

import gzip
import shutil
import signal
import subprocess
import time
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from typer.main import get_command

from deploy.deb import EXTRAS, Target, debian_version, install_into, make_environment, pack
from deploy.wheel import PIP, build_wheel, project_version, run
from rosplc.cli.app import app
from rosplc.shm import Namespace
from tests.deploy.machine import Machine, need_namespaces

pytestmark = pytest.mark.verifies("deb", real="dpkg, man, bash")

NEWER = "99.0"
WATCHDOG_S = 90.0
MOST_PACKED, MOST_INSTALLED = 58e6 / 2, 227e6 / 2
"""Half of what the package took before it was slimmed."""
# Stands where systemd's would, and notes what it was asked.
SYSTEMCTL = """#!/bin/sh
echo "$@" >> /var/log/systemctl
[ "$1" != --version ] || echo "systemd 252 (252)"
"""


def need_debian() -> None:
    if shutil.which("dpkg-deb") is None:
        pytest.skip("Debian package dpkg is missing")
    done = subprocess.run(["/usr/bin/python3", "-c", "import ensurepip, venv"], check=False)
    if done.returncode:
        pytest.skip("Debian package python3-venv is missing")


@pytest.mark.parametrize(
    ("earlier", "later"), [("0.1.0", "0.1.1"), ("0.2.0rc1", "0.2.0"), ("1.0.dev3", "1.0")]
)
def test_versions_are_ordered_as_python_orders_them(earlier: str, later: str) -> None:
    """A release is newer than its own candidates, to dpkg too."""
    if shutil.which("dpkg") is None:
        pytest.skip("Debian package dpkg is missing")
    command = ["dpkg", "--compare-versions", debian_version(earlier), "lt", debian_version(later)]
    assert subprocess.run(command, check=False).returncode == 0


@dataclass(frozen=True)
class Packages:
    """The checkout's package, one of a later version, and the wheels that both were made of."""

    now: Path
    newer: Path
    wheels: Path


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Packages:
    need_debian()
    need_namespaces()
    folder = tmp_path_factory.mktemp("deb")
    target, stage = Target.here(), folder / "stage"
    make_environment(stage)
    # Without the index, from a folder of wheels, as on a machine without a network.
    wheel, wheels = build_wheel(folder / "now"), folder / "wheels"
    python, all_of_it = stage / "opt/rosplc/bin/python", f"{wheel}[{','.join(EXTRAS)}]"
    run([*PIP, "--python", python, "download", "--quiet", "--only-binary=:all:", "--dest", wheels, all_of_it])
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PIP_NO_INDEX", "1")
        patch.setenv("PIP_FIND_LINKS", str(wheels))
        install_into(stage, wheel)
    now = pack(stage, folder, project_version(), target)
    install_into(stage, build_wheel(folder / "newer", version=NEWER), (), alone=True)
    return Packages(now, pack(stage, folder, NEWER, target), wheels)


@pytest.fixture
def machine(tmp_path: Path, packages: Packages) -> Iterator[Machine]:
    folder = tmp_path / "machine"
    folder.mkdir()
    with Machine(folder) as machine:
        yield machine


class Bridge:
    """`rosplc run` on the machine, as the package's user."""

    def __init__(self, machine: Machine, log: Path) -> None:
        user = ("setpriv", "--reuid=rosplc", "--regid=rosplc", "--init-groups")
        self._log = log
        with log.open("wb") as file:
            self._process = subprocess.Popen(
                machine.command(*user, "rosplc", "run", "/etc/rosplc/cell1.yaml"),
                stdin=subprocess.DEVNULL, stdout=file, stderr=file,
            )  # fmt: skip

    def say(self, words: str) -> str:
        """Wait until the log has these words, and return it."""
        deadline = time.monotonic() + WATCHDOG_S
        while words not in (text := self._log.read_text()):
            assert self._process.poll() is None, text
            assert time.monotonic() < deadline, text
            time.sleep(0.05)
        return text

    def stop(self) -> str:
        """End it as systemd would, and return its log."""
        self._process.send_signal(signal.SIGTERM)
        assert self._process.wait(WATCHDOG_S) == 0
        return self._log.read_text()

    def kill(self) -> None:
        """End it in any case."""
        self._process.kill()
        self._process.wait()


@pytest.mark.verify(minutes=2)
@pytest.mark.timeout(1800)
def test_what_a_package_holds(packages: Packages, tmp_path: Path) -> None:
    """Manual pages, completion, documentation, examples, every licence; and half of what it once took."""
    run(["dpkg-deb", "--extract", packages.now, tmp_path])
    share = tmp_path / "usr/share"
    verbs = [f"rosplc-{verb}" for verb in getattr(get_command(app), "commands", ())]
    for name in ("rosplc", *verbs):
        page = share / f"man/man1/{name}.1.gz"
        assert gzip.decompress(page.read_bytes()).decode().startswith(f".TH {name.upper()} 1 ")
        if shutil.which("man"):
            command = ["man", "--warnings", "--local-file", "-Tutf8", page]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            assert done.stdout and not done.stderr, name
    assert (share / "zsh/vendor-completions/_rosplc").read_text().startswith("#compdef rosplc\n")
    for name in ("docs/howto/upgrade.md", "spec/shm-format.md", "examples/c/echo.c", "changelog.gz"):
        assert (share / "doc/rosplc" / name).is_file()
    (place,) = tmp_path.glob("opt/rosplc/lib/python3*/site-packages")
    wheels = [each for each in packages.wheels.glob("*.whl") if not each.name.startswith("numpy-")]
    licences = [
        name for wheel in wheels for name in zipfile.ZipFile(wheel).namelist() if "licen" in name.lower()
    ]
    licences = [name for name in licences if not name.endswith("/")]
    assert licences and not [name for name in licences if not (place / name).is_file()]
    assert packages.now.stat().st_size < MOST_PACKED
    files = {path.stat().st_ino: path.stat().st_size for path in tmp_path.rglob("*") if not path.is_symlink()}
    stated = int(run(["dpkg-deb", "--field", packages.now, "Installed-Size"])) * 1024
    assert sum(files.values()) == pytest.approx(stated, rel=0.1) and stated < MOST_INSTALLED


@pytest.mark.needs("python3-numpy")
@pytest.mark.verify(minutes=2)
@pytest.mark.timeout(1800)
def test_life_of_a_package(
    packages: Packages, machine: Machine, tmp_path: Path, shm_namespace: Namespace
) -> None:
    """Installed it works, upgraded it goes on, removed and purged it leaves what is the user's."""
    configuration = (
        f"bridge: cell1\nprefix: {shm_namespace.prefix}\nshm: {{group: rosplc}}\nros: {{backend: memory}}\n"
        "topics:\n  /in: {type: std_msgs/msg/Int32, to: plc}\n  /out: {type: std_msgs/msg/Int32, to: ros}\n"
    )
    assert "rosplc" in machine.run("dpkg", "-i", packages.now)
    assert project_version() in machine.run("rosplc", "--version")
    assert machine.run("getent", "passwd", "rosplc").split(":")[5:] == [
        "/var/lib/rosplc",
        "/usr/sbin/nologin\n",
    ]
    place = machine.run("/opt/rosplc/bin/python", "-c", "import rosplc; print(rosplc.__file__)")
    assert place.startswith("/opt/rosplc/lib/")
    libraries = machine.run("sh", "-c", "find /opt/rosplc -name '*.so*' -exec ldd {} + 2>&1")
    assert "not found" not in libraries and "error while loading" not in libraries
    complete = "COMP_WORDS=(rosplc rel); COMP_CWORD=1; _rosplc_completion rosplc; echo ${COMPREPLY[@]}"
    complete = f". /usr/share/bash-completion/completions/rosplc; {complete}"
    assert machine.run("bash", "-c", complete).split() == ["reload", "release"]
    headers = ("/usr/include/rosplc/channel.h", "/usr/share/pkgconfig/rosplc.pc")
    machine.run("ls", *headers)

    # A service, on a machine where systemd's place is taken by what notes its orders.
    machine.write("/etc/rosplc/cell1.yaml", configuration)
    machine.write("/usr/local/bin/systemctl", SYSTEMCTL, "755")
    machine.run("mkdir", "-p", "/run/systemd/system")
    machine.run("rosplc", "service", "install", "cell1")
    unit = machine.run("cat", "/etc/systemd/system/rosplc@cell1.service.d/10-rosplc.conf")
    assert "ExecStart=/usr/bin/rosplc run --status 0 /etc/rosplc/cell1.yaml" in unit

    first, second = Bridge(machine, tmp_path / "first.log"), None
    try:
        first.say("0 objects adopted")
        # The files change under the bridge; it goes on, and ends in order when systemd restarts it.
        machine.run("dpkg", "-i", packages.newer)
        assert NEWER in machine.run("rosplc", "--version")
        assert "try-restart rosplc@*.service" in machine.run("cat", "/var/log/systemctl")
        assert "Traceback" not in first.stop()
        second = Bridge(machine, tmp_path / "second.log")
        second.say("2 objects adopted")
        assert "Traceback" not in second.stop()
        # And back.
        machine.run("dpkg", "-i", packages.now)
        assert project_version() in machine.run("rosplc", "--version")
    finally:
        for bridge in (first, second):
            if bridge is not None:
                bridge.kill()

    machine.run("dpkg", "-r", "rosplc")
    assert "disable --now rosplc@cell1.service" in machine.run("cat", "/var/log/systemctl")
    gone = (
        *headers,
        "/opt/rosplc",
        "/usr/bin/rosplc",
        "/etc/systemd/system/rosplc@.service",
        "/etc/sysusers.d/rosplc-cell1.conf",
    )
    for path in gone:
        machine.run("test", "-e", path, status=1)
    machine.run("mkdir", "-p", "/var/lib/rosplc")
    machine.run("dpkg", "-P", "rosplc")
    machine.run("test", "-e", "/var/lib/rosplc", status=1)
    # What is the user's: the configuration, and the objects that the PLC still reads.
    assert machine.run("cat", "/etc/rosplc/cell1.yaml") == configuration
    assert len(shm_namespace.topics()) == 2


@pytest.mark.needs("python3-numpy")
@pytest.mark.verify(minutes=1)
@pytest.mark.timeout(1800)
def test_a_purge_takes_services_that_were_left(packages: Packages, machine: Machine) -> None:
    """Where no systemd runs, as in an image, a purge removes the services that are left, and nothing else."""
    machine.run("dpkg", "-i", packages.now)
    machine.run("rm", "-rf", "/run/systemd/system")
    mark = "# Written by rosplc service install; `systemctl edit` puts changes beside it.\n"
    machine.write("/etc/systemd/system/rosplc@.service", mark)
    machine.write("/etc/systemd/system/rosplc@a.service.d/10-rosplc.conf", mark)
    machine.write("/etc/systemd/system/rosplc@a.service.d/override.conf", "[Service]\n")
    machine.write("/etc/sysusers.d/rosplc-a.conf", "u somebody\n")
    machine.run("dpkg", "-P", "rosplc")
    machine.run("test", "-e", "/etc/systemd/system/rosplc@.service", status=1)
    machine.run("test", "-e", "/etc/systemd/system/rosplc@a.service.d/10-rosplc.conf", status=1)
    assert machine.run("cat", "/etc/systemd/system/rosplc@a.service.d/override.conf") == "[Service]\n"
    assert machine.run("cat", "/etc/sysusers.d/rosplc-a.conf") == "u somebody\n"
