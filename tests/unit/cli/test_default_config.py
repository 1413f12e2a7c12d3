"""Verbs take the folder's rosplc.yaml where no configuration is named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from rosplc.shm import Direction, Namespace
from tests.channels import Side, layout_of
from tests.command import rosplc


class _Screen:
    """Stands for the terminal's screen: remembers what it was to show."""

    return_code = 0
    watched: list[Any]

    def __init__(self, watch: Any, interval: float) -> None:
        self.watched.append(watch)

    def run(self) -> None:
        """End at once."""


@pytest.mark.parametrize(("options", "expected"), [((), {"line7"}), (("--prefix", "line8"), {"line8"})])
@pytest.mark.parametrize("verb", ["top", "web"])
def test_the_folders_configuration_is_the_default(
    verb: str, options: tuple[str, ...], expected: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without --config and --prefix it is ./rosplc.yaml's bridge; a prefix takes its place."""
    pytest.importorskip("textual" if verb == "top" else "aiohttp")
    (tmp_path / "rosplc.yaml").write_text(
        "prefix: line7\ntopics:\n  /n: {type: std_msgs/msg/Int32, to: plc}\n"
    )
    monkeypatch.chdir(tmp_path)
    watched: list[Any] = []
    monkeypatch.setattr(_Screen, "watched", watched, raising=False)
    monkeypatch.setattr("rosplc.cli.top._check_terminal", lambda: None)
    monkeypatch.setattr("rosplc.monitor.terminal.TopApp", _Screen)
    monkeypatch.setattr("rosplc.web.serve", lambda settings, watch, **_: watched.append(watch))
    rosplc(verb, *options)
    assert set(watched[0].prefixes) == expected


def test_doctor_release_and_types_take_the_folders_configuration(
    tmp_path: Path, shm_namespace: Namespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its prefix, distribution and custom types; what is named on the command line comes first."""
    folder = tmp_path / "msg/cell_msgs/msg"
    folder.mkdir(parents=True)
    (folder / "Fan.msg").write_text("int32 speed\n")
    (tmp_path / "rosplc.yaml").write_text(
        f"prefix: {shm_namespace.prefix}\nros: {{distro: humble}}\ntypes: {{paths: [./msg]}}\ntopics: {{}}\n"
    )
    monkeypatch.chdir(tmp_path)
    report = json.loads(rosplc("doctor", "--no-ros", "--json").stdout)
    assert [each["seen"] for each in report["findings"] if each["code"] == "DOC501"] == [
        "rosplc.yaml is valid: 0 topics"
    ]
    assert "cell_msgs/msg/Fan (humble)" in rosplc("types", "cell_msgs/Fan").output
    assert "TYP001" in rosplc("types", "cell_msgs/Fan", "--distro", "jazzy", code=1).stderr
    side = Side(shm_namespace, "/n", layout_of("std_msgs/msg/Float64"), Direction.TO_ROS)
    try:
        assert "/n is free" in rosplc("release", "/n").output
        assert "SHM101" in rosplc("release", "/n", "--prefix", f"{shm_namespace.prefix}x", code=1).stderr
    finally:
        side.channel.retire()
