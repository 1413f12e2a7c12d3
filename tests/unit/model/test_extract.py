"""The program that writes the bundled services and actions, and what it wrote."""

from __future__ import annotations

import hashlib
import io
import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest
import yaml

import extract_interfaces

FILES = {
    "own_srvs/srv/Ask.srv": "# Asks.\nint32 x 7 # so\nint32 A=1\n---\nstd_msgs/Header[] h\n",
    "own_srvs/action/Go.action": "---\n---\n",
    "own_srvs/srv/Ask_Request.msg": "int32 x\n",
}
PLAN = {
    "archives": {"own_srvs-1.0.0": {"distros": ["kilted", "humble"], "licence": "Apache-2.0"}},
    "without": {"humble": ["own_srvs/action/Go"]},
    "own": [{"distros": ["noetic"], "definitions": {"own_srvs/srv/Old": "bool a\n---\n"}}],
}


def pack(archive: Path) -> None:
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive, "w") as wheel:
            for name, text in FILES.items():
                wheel.writestr(f"own_srvs-1.0.0.data/data/share/{name}", text)
        return
    with tarfile.open(archive, "w:gz") as tar:
        for name, text in FILES.items():
            member = tarfile.TarInfo(f"own_srvs-1.0.0/{name}")
            member.size = len(text)
            tar.addfile(member, io.BytesIO(text.encode()))


@pytest.mark.parametrize("archive", ["own_srvs-1.0.0-py3-none-any.whl", "own_srvs-1.0.0.tar.gz"])
def test_packages_become_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, archive: str) -> None:
    """Comments go, each definition names its distributions, and the head names the packages."""
    (tmp_path / "plan.yaml").write_text(yaml.safe_dump(PLAN))
    monkeypatch.setattr(extract_interfaces, "PLAN", tmp_path / "plan.yaml")
    with pytest.raises(SystemExit, match="has 0 files own_srvs"):
        extract_interfaces.extract(tmp_path)
    pack(tmp_path / archive)
    head, *sections = extract_interfaces.extract(tmp_path).split("\n==== ")
    assert (
        f"{archive}: Apache-2.0, SHA-256 {hashlib.sha256((tmp_path / archive).read_bytes()).hexdigest()}"
        in head
    )
    assert sections == [
        "own_srvs/action/Go kilted\n---\n---\n",
        "own_srvs/srv/Ask humble kilted\nint32 A=1\nint32 x 7\n---\nstd_msgs/Header[] h\n",
        "own_srvs/srv/Old noetic\nbool a\n---\n",
    ]


def test_a_clone_is_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What differs is listed, with the clone's commit; a folder in which nothing is tracked has none."""
    (tmp_path / "std_srvs/srv").mkdir(parents=True)
    for name, text in {"Empty": "---\n", "SetBool": "bool other\n---\n", "New": "---\n"}.items():
        (tmp_path / f"std_srvs/srv/{name}.srv").write_text(text)
    assert extract_interfaces.main(["--compare", "jazzy", str(tmp_path)]) == 1
    assert "its commit is not known" in capsys.readouterr().out

    def git(*arguments: str) -> str:
        own = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b", *arguments]
        return subprocess.run(own, capture_output=True, text=True, check=True).stdout.strip()

    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "a")
    git("tag", "1.2.3")
    extract_interfaces.compare("jazzy", [tmp_path])
    shown, *lines = capsys.readouterr().out.splitlines()
    assert shown == f"{tmp_path}: tags/1.2.3-0-g{git('rev-parse', 'HEAD')}"
    assert lines == [
        "std_srvs/srv/New: there only",
        "std_srvs/srv/SetBool: differs",
        "std_srvs/srv/Trigger: here only",
        "jazzy: 3 compared, 3 differ",
    ]


def test_the_file_is_that_of_the_plan() -> None:
    """The bundled file was read from the packages of the plan, and has what the plan defines by hand."""
    plan = yaml.safe_load(extract_interfaces.PLAN.read_text())
    head, *sections = extract_interfaces.TARGET.read_text().split("\n==== ")
    packages = [line.split()[1] for line in head.splitlines() if ", SHA-256 " in line]
    assert len(packages) == len(plan["archives"])
    assert all(name.startswith(key) for name, key in zip(packages, plan["archives"], strict=True))
    found = {text.split()[0]: text.partition("\n") for text in sections}
    for own in plan["own"]:
        for name, text in own["definitions"].items():
            assert found[name][2] == text
            assert set(own["distros"]) == set(found[name][0].split()[1:])
