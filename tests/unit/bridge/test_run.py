"""A bridge as a process: signals, clean stop, kill -9, restart."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.bridge import Bridge
from rosplc.bridge.run import News, pause, run_bridge, run_until_signal, stop_on_signals
from rosplc.config import parse_config
from rosplc.errors import BackendError, ConfigError, SetupError
from rosplc.model import TypeStore
from rosplc.ros.memory import open_backend
from rosplc.shm import Namespace, attach
from tests.lib.waiting import wait_for

PROGRAM = """
import logging, sys
from rosplc.bridge import Bridge, run_until_signal
from rosplc.config import read_config
logging.basicConfig(level=logging.INFO, stream=sys.stderr)
run_until_signal(Bridge(read_config(sys.argv[1])))
print("left cleanly")
"""


@pytest.fixture
def config(tmp_path: Path, shm_namespace: Namespace) -> Path:
    """Give a configuration with a topic each way."""
    path = tmp_path / "rosplc.yaml"
    path.write_text(
        f"prefix: {shm_namespace.prefix}\nros: {{backend: memory}}\nbeat: 20ms\ntopics:\n"
        "  /in: {type: std_msgs/msg/Int32, to: plc}\n  /out: {type: std_msgs/msg/Int32, to: ros}\n"
    )
    return path


@pytest.fixture
def run(config: Path, shm_namespace: Namespace) -> Iterator[object]:
    """Give a function that starts the bridge's process and waits until it carries."""
    started: list[subprocess.Popen[str]] = []

    def start() -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(config)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        started.append(process)

        def carries() -> bool:
            if process.poll() is not None:
                pytest.fail(f"the bridge ended: {process.communicate()[1]}")
            if not shm_namespace.path("/in").exists():
                return False
            with attach(shm_namespace, "/in") as found:
                return found.snapshot().writer.pid == process.pid

        wait_for(carries)
        # The signal handlers stand before the objects do, but the threads start after them.
        with attach(shm_namespace, "/in") as found:
            before = found.snapshot().writer.beat
            wait_for(lambda: found.snapshot().writer.beat != before)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.foreign
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_cleanly(run: object, number: int, shm_namespace: Namespace) -> None:
    """SIGTERM and SIGINT give back the claims, leave the objects and end with 0."""
    process = run()  # type: ignore[operator]
    process.send_signal(number)
    out, err = process.communicate(timeout=100)
    assert (process.returncode, out) == (0, "left cleanly\n"), err
    with attach(shm_namespace, "/in") as found:
        assert found.snapshot().writer.epoch == 0


@pytest.mark.foreign
def test_a_repeated_signal_is_one(run: object) -> None:
    """What timeout(1) and launch tools do, signal to process and group at once, is still a clean stop."""
    process = run()  # type: ignore[operator]
    for _ in range(3):
        process.send_signal(signal.SIGINT)
        time.sleep(0.02)
    out, err = process.communicate(timeout=100)
    assert (process.returncode, out) == (0, "left cleanly\n"), err


@pytest.mark.foreign
def test_a_closing_terminal_stops_nothing(run: object, shm_namespace: Namespace) -> None:
    """SIGHUP reads the file again, and the beats go on."""
    process = run()  # type: ignore[operator]
    process.send_signal(signal.SIGHUP)
    with attach(shm_namespace, "/in") as found:
        before = found.snapshot().writer.beat
        wait_for(lambda: found.snapshot().writer.beat >= before + 5)
    process.terminate()
    assert "topics unchanged: 2" in process.communicate(timeout=100)[1]
    assert process.returncode == 0


def test_kill_and_restart(run: object, shm_namespace: Namespace) -> None:
    """After kill -9 the next bridge adopts the same objects at once."""
    process = run()  # type: ignore[operator]
    with attach(shm_namespace, "/in") as found:
        generation = found.identity.generation
        os.kill(process.pid, signal.SIGKILL)
        process.wait(timeout=100)
        run()  # type: ignore[operator]
        found.valid()
        assert found.still_there()
        assert found.identity.generation == generation


def test_a_signal_just_before_the_wait_is_not_lost() -> None:
    """Where the handler has not run yet when the wait begins, the signal ends the wait anyway."""
    with News() as news:
        before = signal.signal(signal.SIGHUP, lambda number, _: news.put(number))
        try:
            # What the interpreter's C handler does, without its Python half: that runs once the wait is over.
            os.write(news._write, b"\x01")
            kill = threading.Timer(0.2, news.put, [7])
            kill.start()
            assert news.wait(100.0) == [7]
            os.kill(os.getpid(), signal.SIGHUP)
            assert news.wait(100.0) == [signal.SIGHUP]
            assert news.wait(0.01) == []
        finally:
            signal.signal(signal.SIGHUP, before)


def test_a_pause_ends_with_a_signal_that_comes_while_the_events_lock_is_held() -> None:
    """The handler sets the event in the thread that waits: that wait takes no lock of the event's."""
    with stop_on_signals() as stop:
        assert not pause(stop, 0.0)
        with stop._cond:  # type: ignore[attr-defined]
            assert not pause(stop, 0.01), "it does not need the lock"
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGTERM)).start()
        assert pause(stop, 60.0)


@pytest.mark.parametrize(("number", "taken"), [(signal.SIGINT, True), (signal.SIGHUP, False)])
def test_signals_that_the_parent_ignores(number: signal.Signals, taken: bool) -> None:
    """A script's `&` leaves SIGINT ignored and it ends the program nevertheless; nohup's SIGHUP does not."""
    before = signal.signal(number, signal.SIG_IGN)
    try:
        with stop_on_signals() as stop:
            os.kill(os.getpid(), number)
            assert pause(stop, 60.0 if taken else 0.0) is taken
        assert signal.getsignal(number) is signal.SIG_IGN
    finally:
        signal.signal(number, before)


def test_many_hang_ups_reload_once_more(run: object, config: Path, shm_namespace: Namespace) -> None:
    """However many signals come while a file is read, what the file holds at last is what runs at last."""
    process = run()  # type: ignore[operator]
    for number in range(20):
        config.write_text(config.read_text() + f"  /more{number}: {{type: std_msgs/msg/Int32, to: plc}}\n")
        process.send_signal(signal.SIGHUP)
    wait_for(lambda: shm_namespace.path("/more19").exists())
    process.terminate()
    assert process.wait(timeout=100) == 0


def test_a_backend_that_ends_ends_the_program(tmp_path: Path, shm_namespace: Namespace) -> None:
    """A node that was told to leave is an error with its reason: a service manager may start it again."""
    backend = open_backend(TypeStore.bundled("jazzy"), "told", domain=40)
    bridge = Bridge(parse_config(f"prefix: {shm_namespace.prefix}\nros: {{backend: memory}}\n"), backend)
    threading.Timer(0.2, setattr, [backend, "ended", "somebody told it to leave"]).start()
    with pytest.raises(BackendError, match="somebody told it to leave") as found:
        run_until_signal(bridge)
    assert found.value.code == "ROS015"
    assert not bridge.status().running
    backend.close()


ABSENT = {
    "disk": "types: {paths: [not-mounted]}\n",
    "group": "shm: {group: not-there-yet}\nros: {backend: memory}\n",
    "file": None,
}


@pytest.mark.parametrize("kind", ABSENT)
def test_what_may_come_is_tried_again_by_the_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """Under a service manager it is no error of the configuration, unless more is wrong."""
    path = tmp_path / "rosplc.yaml"
    if (text := ABSENT[kind]) is not None:
        path.write_text(f"prefix: Tabsent\n{text}")
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    with pytest.raises(ConfigError):
        run_bridge(path, status_seconds=None)
    monkeypatch.setenv("NOTIFY_SOCKET", "/run/none")
    with pytest.raises(SetupError, match="SYS015"):
        run_bridge(path, status_seconds=None)
    path.write_text((text or "") + "nonsense: 1\n")
    with pytest.raises(ConfigError, match="nonsense"):
        run_bridge(path, status_seconds=None)
