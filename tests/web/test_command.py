"""The command: where it listens, what it says, how it ends."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request

import pytest
from typer.testing import CliRunner

from rosplc.cli.app import app


def start(*arguments: str) -> tuple[subprocess.Popen[str], dict[str, object]]:
    child = subprocess.Popen(
        [sys.executable, "-m", "rosplc", "web", "--port", "0", "--json", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    return child, json.loads(child.stdout.readline())


def get(url: object, token: str = "") -> int:
    request = urllib.request.Request(
        f"{url}api/status", headers={"Authorization": f"Bearer {token}"} if token else {}
    )
    try:
        with urllib.request.urlopen(request) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


def test_it_serves_until_it_is_told_to_end(shm_namespace) -> None:
    """On loopback everybody of this machine may look; SIGTERM ends it in order."""
    child, said = start("--prefix", shm_namespace.prefix)
    with child:
        assert str(said["url"]).startswith("http://localhost:")
        assert (said["token"], said["allow_write"], said["token_to_view"]) == ("", False, False)
        assert get(said["url"]) == 200
        child.terminate()
        _, errors = child.communicate()
    assert child.returncode == 0 and "Traceback" not in errors


def test_beyond_loopback_it_warns_and_asks_for_the_token(shm_namespace) -> None:
    """Who binds it elsewhere is told what that means, and looking needs the token then."""
    child, said = start("--prefix", shm_namespace.prefix, "--bind", "0.0.0.0")
    with child:
        assert said["token_to_view"] is True and len(str(said["token"])) == 24
        assert get(said["url"]) == 401
        assert get(said["url"], str(said["token"])) == 200
        child.terminate()
        _, errors = child.communicate()
    assert "warning: listening on 0.0.0.0, which other machines can reach" in errors


def test_a_token_of_ones_own_is_not_printed(shm_namespace, tmp_path) -> None:
    """It is in its file, and is the one that counts; Ctrl-C ends the server in order."""
    file = tmp_path / "token"
    file.write_text("0123456789abcdef")
    file.chmod(0o600)
    child, said = start("--prefix", shm_namespace.prefix, "--token-file", str(file), "--token-to-view")
    with child:
        assert said["token"] == ""
        assert get(said["url"]) == 401 and get(said["url"], "0123456789abcdef") == 200
        child.send_signal(signal.SIGINT)
        out, errors = child.communicate()
    assert child.returncode == 0
    assert "0123456789abcdef" not in out + errors


@pytest.mark.parametrize(
    ("arguments", "status", "code"),
    [
        (["--bind", "192.0.2.1"], 1, "WEB001"),
        (["--bind", "no such host"], 1, "WEB001"),
        (["--token-file", "/nonexistent", "--allow-write"], 1, "WEB002"),
        (["--prefix", "not valid"], 1, "SHM118"),
        (["--config", "/nonexistent.yaml"], 2, "CFG001"),
    ],
)
def test_what_cannot_be_done_is_said_at_once(arguments: list[str], status: int, code: str) -> None:
    """One error with its code and what helps, before anything listens."""
    done = CliRunner().invoke(app, ["web", "--port", "0", *arguments])
    assert (done.exit_code, f"error {code}" in done.stderr) == (status, True), done.output
    assert "remedy:" in done.stderr


def test_a_port_that_is_taken_is_said() -> None:
    """The address and the system's reason are named."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        done = CliRunner().invoke(app, ["web", "--port", str(taken.getsockname()[1])])
    assert done.exit_code == 1
    assert "WEB001" in done.stderr and "in use" in done.stderr


def test_without_aiohttp_the_command_names_what_to_install(monkeypatch) -> None:
    """A missing extra is an error with the pip command."""
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    done = CliRunner().invoke(app, ["web"])
    assert done.exit_code == 1
    assert "SYS001" in done.stderr and "[views]'" in done.stderr


def test_a_made_token_does_not_go_into_the_journal(shm_namespace, tmp_path) -> None:
    """Where systemd keeps the output, a token that would be printed ends the start."""
    log = tmp_path / "journal"
    with log.open("w") as journal:
        status = os.fstat(journal.fileno())
        environment = {**os.environ, "JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}
        command = [sys.executable, "-m", "rosplc", "web", "--prefix", shm_namespace.prefix, "--allow-write"]
        done = subprocess.run(
            command, env=environment, stdout=journal, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1 and "WEB002" in done.stderr and "--token-file" in done.stderr
    assert not log.read_text()
