"""What the commands say of classic topics, which cannot describe themselves."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from pathlib import Path

import posix_ipc
import pytest
from typer.testing import CliRunner

from rosplc.cli.app import app
from tests.classic_cell import remove, unique_name

RECORD = struct.pack("<6d", 1.5, 0, 0, 0, 0, 0.25)


@pytest.fixture
def name() -> Iterator[str]:
    """Give a topic's name of the test's own."""
    made = unique_name()
    yield made
    remove(made)


@pytest.fixture
def config(tmp_path: Path, name: str) -> Path:
    """Give a configuration with one classic topic."""
    path = tmp_path / "rosplc.yaml"
    path.write_text(
        f"topics:\n  /{name}: {{type: geometry_msgs/msg/Twist, to: plc, classic: true}}\n"
        f"  /{name}/free: {{type: std_msgs/msg/Int32, to: ros, classic: {{semaphore: none}}}}\n"
    )
    return path


def run(*arguments: object) -> tuple[int, str, str]:
    """Run the command; return exit code, output and errors."""
    done = CliRunner().invoke(app, [str(word) for word in arguments])
    return done.exit_code, done.stdout, done.stderr


def test_check_explains_memory_and_lock(config: Path, name: str) -> None:
    """Names, waits and what a message is are in the explanation, and in JSON."""
    code, out, _ = run("check", "-v", config)
    assert code == 0
    assert f"shared memory {name} with the bare record" in out
    assert f"semaphore {name}, wait limit 5ms, freed after 1s" in out
    assert "each changed record is a message" in out
    assert "slots" not in out
    assert f"no lock guards the classic memory {name}.free" in out
    facts = json.loads(run("check", config, "--json")[1])["topics"]
    assert facts[f"/{name}"]["object"] == name
    assert facts[f"/{name}"]["classic"]["recover_after_ms"] == 1000.0
    assert facts[f"/{name}/free"]["classic"]["semaphore"] is None


def test_show_lists_classic_topics_of_a_configuration(config: Path, name: str) -> None:
    """Sizes, owner and the lock's state are in one line per topic; what is missing is said."""
    Path(f"/dev/shm/{name}").write_bytes(RECORD)
    posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, initial_value=0).close()
    code, out, errors = run("show", "--config", config)
    assert code == 0
    line = next(line for line in out.splitlines() if line.startswith(f"/{name} "))
    assert "48 of 48" in line and line.endswith("taken")
    assert f"/{name}/free: {name}.free: this memory does not exist [SHM101]" in errors
    listed = {entry["topic"]: entry for entry in json.loads(run("show", "--config", config, "--json")[1])}
    assert listed[f"/{name}"]["message"]["linear"]["x"] == 1.5
    assert listed[f"/{name}/free"]["code"] == "SHM101"


def test_show_prints_a_classic_topic(config: Path, name: str) -> None:
    """What is in the memory is decoded by the configuration's type, without taking the lock."""
    Path(f"/dev/shm/{name}").write_bytes(RECORD)
    posix_ipc.Semaphore(f"/{name}", posix_ipc.O_CREX, initial_value=0).close()
    code, out, _ = run("show", f"/{name}", "--config", config)
    assert code == 0 and "lock: taken" in out and "x: 1.5" in out
    document = json.loads(run("show", f"/{name}", "--config", config, "--json")[1])
    assert document["message"]["angular"]["z"] == 0.25


def test_show_says_what_keeps_a_memory_from_being_read(config: Path, name: str) -> None:
    """Sizes that differ are an error with both sizes."""
    Path(f"/dev/shm/{name}").write_bytes(b"short")
    code, _, errors = run("show", f"/{name}", "--config", config)
    assert code != 0 and "5 bytes, but the record needs 48" in errors and "SHM129" in errors


def test_show_counts_changes(config: Path, name: str) -> None:
    """--count ends with an error if no change comes within the time."""
    Path(f"/dev/shm/{name}").write_bytes(RECORD)
    code, _, errors = run("show", f"/{name}", "--config", config, "--count", 1, "--timeout", 0.05)
    assert code == 1 and "0 of 1 changes" in errors


def test_show_without_a_configuration_says_what_is_missing(name: str) -> None:
    """A memory with the topic's name is no channel; the error says how to see it."""
    Path(f"/dev/shm/{name}").write_bytes(RECORD)
    code, _, errors = run("show", f"/{name}")
    assert code != 0 and f"but /dev/shm/{name} exists" in errors and "--config" in errors
