"""The image of packaging/container, built by a Docker daemon and started as the compose file describes."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from deploy.board import fetch_debian
from deploy.wheel import ROOT, project_version, run
from tests.deploy.containers import WATCHDOG_S, Enclosed
from tests.deploy.machine import need_namespaces
from tests.lib import isolated
from tests.lib.waiting import wait_for

pytestmark = pytest.mark.verifies("containers", real="Docker")

CONTAINER = ROOT / "packaging/container"
SITE_AUTHORITIES = Path("/usr/local/share/ca-certificates")
MOST_BYTES = 200e6
"""What the image may add to its base: the Debian package's 82 MB, NumPy's 40, and Python."""
# A daemon that runs already on this machine is not used, nor the containerd of one.
DAEMON = '[ ! -d /run/containerd ] || mount -t tmpfs run /run/containerd; exec dockerd --config-file "$0"'
WHERE = {"host": "--network=host", "here": f"--volume={CONTAINER}:/etc/rosplc:ro"}


class Docker(Enclosed):
    """A Docker daemon of the test's own; its containers end with it.

    Args:
        folder: For all its files.
        world: What to put before its command line.
    """

    def __init__(self, folder: Path, world: Sequence[str] = ()) -> None:
        self._socket = f"unix://{folder}/socket"
        settings = {
            "data-root": f"{folder}/data", "exec-root": f"{folder}/run", "pidfile": f"{folder}/pid",
            "hosts": [self._socket], "bridge": "none", "iptables": False, "ip6tables": False,
        }  # fmt: skip
        (folder / "daemon.json").write_text(json.dumps(settings))
        spaces = ("unshare", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc")
        command = [*world, *spaces, "sh", "-c", DAEMON, f"{folder}/daemon.json"]
        super().__init__("dockerd", lambda: list(command), os.environ, folder / "log")
        client = {"DOCKER_HOST": self._socket, "DOCKER_CONFIG": str(folder), "DOCKER_BUILDKIT": "0"}
        self._client = {**os.environ, **client}

    def __enter__(self) -> Docker:
        self.start()
        wait_for(lambda: not self.alive or self._answers(), "the Docker daemon", every=0.5)
        if not self.alive:
            pytest.skip(f"this machine permits no Docker daemon: {self.log.read_text()[-500:]}")
        return self

    def __exit__(self, *_: object) -> None:
        self.terminate(WATCHDOG_S)

    def _answers(self) -> bool:
        command = ["/usr/bin/docker", "version"]
        return not subprocess.run(command, env=self._client, capture_output=True, check=False).returncode

    def __call__(self, *words: object, seconds: float = WATCHDOG_S) -> str:
        """Run `docker`, and return what it printed."""
        return run(["/usr/bin/docker", *map(str, words)], environment=self._client, seconds=seconds).strip()

    def compose(self, *words: str) -> str:
        """Run `docker-compose` with the project's file, and return what it printed."""
        command = ["docker-compose", "--file", str(CONTAINER / "compose.yaml"), *words]
        return run(command, environment=self._client, seconds=WATCHDOG_S).strip()

    def inspect(self, name: str, what: str) -> str:
        """Return one of the facts that the daemon knows of a container or an image."""
        return self("inspect", "--format", f"{{{{{what}}}}}", name)

    def crash(self, container: str) -> None:
        """Kill a container's process from outside, as the system would, and wait for its next life."""
        lives = int(self.inspect(container, ".RestartCount"))
        enter = ["nsenter", f"--target={self.inner}", "--mount", "--pid"]
        run([*enter, "kill", "-9", self.inspect(container, ".State.Pid")])
        restarted = f"{lives + 1} true"
        wait_for(lambda: self.inspect(container, ".RestartCount}} {{.State.Running") == restarted, every=0.2)


@pytest.fixture
def folder() -> Iterator[Path]:
    """Give a folder with a short name, as a socket needs, and leave no images behind."""
    path = Path(tempfile.mkdtemp(prefix="rosplc-docker-"))
    yield path
    shutil.rmtree(path)


def debian(folder: Path) -> Path:
    """Make an image like debian:bookworm-slim, which trusts the authorities that this machine trusts."""
    settings, base = folder / "pip.conf", folder / "base.tar"
    settings.write_text("[global]\ncert = /etc/ssl/certs/ca-certificates.crt\n")
    hooks = [f"--customize-hook=copy-in {settings} /etc"]
    if SITE_AUTHORITIES.is_dir():
        hooks.append(f"--customize-hook=copy-in {SITE_AUTHORITIES} {SITE_AUTHORITIES.parent}")
    slim = [f"--dpkgopt=path-exclude=/usr/share/{name}/*" for name in ("doc", "locale", "man")]
    fetch_debian(base, "bookworm", "--variant=minbase", "--dpkgopt=force-unsafe-io", *slim, *hooks)
    return base


def carry(docker: Docker, robot: str) -> None:
    """Wait for a wheel speed that the PLC made of the robot's command: from ROS to the PLC and back."""
    assert docker("exec", robot, "rosplc", "echo", "--once", "--field", "data", "/wheel_speed").startswith(
        "5.0"
    )


@pytest.mark.needs("docker.io", "docker-compose", "mmdebstrap")
@pytest.mark.verify(minutes=5)
@pytest.mark.timeout(1800)
def test_the_image_and_what_its_compose_file_starts(folder: Path) -> None:
    """Messages flow, without root and capabilities; whatever is killed comes again, and stops in order."""
    need_namespaces()
    base = "debian:bookworm-slim"
    with Docker(folder) as docker:
        docker("import", debian(folder), base)
        build = ("build", "--network=host", "--file", CONTAINER / "Dockerfile", "--tag=rosplc")
        docker(*build, ROOT, seconds=1200)
    # In a world without other tests; its /dev/shm and network are what the containers take for the machine's.
    with Docker(folder, isolated.command()) as docker:
        image, without = (int(docker.inspect(name, ".Size")) for name in ("rosplc", base))
        assert 0 < image - without < MOST_BYTES
        tools = docker(
            "run", "--rm", "--entrypoint=sh", "rosplc", "-c", "command -v gcc cc make pip dockerd; :"
        )
        assert tools == ""
        assert project_version() in docker("run", "--rm", "rosplc", "--version")

        docker.compose("up", "--detach", "--no-build")
        names = {name: docker.compose("ps", "-q", name) for name in ("bridge", "plc", "robot")}
        carry(docker, names["robot"])
        for name, user in (("bridge", "10990"), ("plc", "1000"), ("robot", "10990")):
            status = docker("exec", names[name], "cat", "/proc/1/status")
            facts = dict(line.split(":\t") for line in status.splitlines())
            assert (facts["Uid"].split(), int(facts["CapBnd"], 16)) == ([user] * 4, 0)
        for name in ("bridge", "plc"):
            docker.crash(names[name])
            carry(docker, names["robot"])
        bridge = names["bridge"]
        wait_for(lambda: docker.inspect(bridge, ".State.Health.Status") == "healthy", every=1)
        docker.compose("stop")
        codes = {name: int(docker.inspect(container, ".State.ExitCode")) for name, container in names.items()}
        assert codes == {"bridge": 0, "plc": 0, "robot": 130}  # as after Ctrl-C; 137 would be a kill
        assert "bridge cell1 stopped" in docker("logs", bridge)
        (_, look) = json.loads(docker.inspect("rosplc", "json .Config.Healthcheck.Test"))
        look = f"{look} && echo healthy || echo ill"
        share = ("run", "--rm", "--volume=/dev/shm:/dev/shm", WHERE["here"], "--entrypoint=sh")
        assert docker(*share, "rosplc", "-c", look) == "ill"
        docker.compose("down")

        # The same without a mount: the PLC's container owns the memory, and the bridge's joins it.
        start = ("run", "--detach", *WHERE.values())
        python = "--entrypoint=/opt/rosplc/bin/python"
        docker(*start, "--name=plc", "--ipc=shareable", "--group-add=10990", python, "rosplc", "plc.py")
        docker(*start, "--name=bridge", "--ipc=container:plc", "rosplc")
        twist = ("/cmd_vel", "geometry_msgs/msg/Twist", "{linear: {x: 0.5}}")
        docker(*start, "--name=robot", "rosplc", "pub", *twist)
        carry(docker, "robot")
