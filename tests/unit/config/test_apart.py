"""A configuration that another process reads: nothing of it is lost, and no error."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace

import pytest

from rosplc.config import ConfigErrors, load_project
from rosplc.config.apart import apart
from rosplc.config.yaml_source import may_pass

EVERYTHING = """
bridge: cell
ros: {distro: jazzy, backend: zenoh, zenoh: {connect: [tcp/127.0.0.1:7447]}}
rosout: {plc: true}
tasks: {Slow: {interval: 20ms}}
topics:
  /cmd_vel: {to: plc, type: geometry_msgs/Twist, on_stale: {value: {linear: {x: 0.5}}}}
  /joints: {to: ros, type: sensor_msgs/JointState, limits: {name: 6}}
services:
  /set: {server: plc, type: std_srvs/SetBool}
transforms:
  tool: {target: base, source: tool0}
"""


@pytest.fixture(params=["a fork", "a new process"])
def way(request, monkeypatch):
    """Both ways of another process: of one that has no threads, and of one that has."""
    count = 1 if request.param == "a fork" else 2
    monkeypatch.setattr(threading, "active_count", lambda: count)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "rosplc.yaml"
    path.write_text(EVERYTHING)
    return path


@pytest.mark.usefixtures("way")
def test_a_project_comes_back_whole(file):
    """Plans, places of keys and settings are those of a file read in this process, and the same each time."""
    here, there = load_project(file), apart(load_project, file)
    assert there.plans == apart(load_project, file).plans
    assert [replace(plan, transform=None) for plan in there.topics] == [
        replace(plan, transform=None) for plan in here.topics
    ]
    assert there.services == here.services
    assert vars(there.topics[-1].transform).items() >= vars(here.topics[-1].transform).items()
    assert [each.layouts for each in there.plans] == [each.layouts for each in here.plans]
    assert there.config.fixed == here.config.fixed
    assert there.config.source == here.config.source
    own, settings = here.config.settings, there.config.settings
    assert settings.tasks["Slow"].interval_ns == own.tasks["Slow"].interval_ns
    assert settings.ros.model_fields_set == {"distro", "backend", "zenoh"}
    assert settings.ros.zenoh.connect == ("tcp/127.0.0.1:7447",)
    assert set(there.store.names()) == set(here.store.names())


@pytest.mark.usefixtures("way")
def test_errors_come_back_with_their_places(file, tmp_path):
    """All mistakes of a file, and whether they may pass."""
    file.write_text("topics:\n  /a: {to: plc, type: std_msgs/Nothing}\n  /b: {to: nowhere}\n")
    with pytest.raises(ConfigErrors) as caught:
        apart(load_project, file)
    assert [error.where.partition(": ")[0] for error in caught.value.errors] == [f"{file}:3"] * 2
    with pytest.raises(ConfigErrors) as caught:
        apart(load_project, tmp_path / "none.yaml")
    assert may_pass(caught.value)


@pytest.mark.usefixtures("way")
def test_a_process_that_is_killed_is_an_error():
    """No result is no result, and the status says why."""
    with pytest.raises(RuntimeError, match=rf"_die ended with status -{signal.SIGKILL:d}"):
        apart(_die)


def _die():
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_bridge_carries_without_what_reads_its_file(tmp_path, shm_namespace):
    """pydantic, the other verbs and the types of every distribution would take a third of its memory."""
    path = tmp_path / "rosplc.yaml"
    path.write_text(
        f"prefix: {shm_namespace.prefix}\nros: {{backend: memory}}\n"
        "topics: {/cmd_vel: {to: plc, type: geometry_msgs/Twist}}\n"
    )
    code = (
        "import contextlib, os, signal, sys\nfrom pathlib import Path\n"
        "from rosplc.bridge.run import run_bridge\n"
        "@contextlib.contextmanager\n"
        "def supervised(bridge):\n"
        "    yield\n"
        "    print(*sorted(sys.modules))\n"
        "from rosplc.bridge import engine\n"
        "before = engine.Bridge.start\n"
        "def start(self):\n    before(self)\n    self.reload()\n    os.kill(os.getpid(), signal.SIGTERM)\n"
        "engine.Bridge.start = start\n"
        f"run_bridge(Path({str(path)!r}), status_seconds=None, supervised=supervised)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert "has reloaded its configuration" in done.stderr
    imported = done.stdout.split()
    assert "rosplc.bridge.engine" in imported
    assert not {"pydantic", "rosplc.config.settings", "rosbags.typesys.stores.ros2_jazzy"} & set(imported)
