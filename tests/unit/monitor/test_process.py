"""What is said of a process that should be a bridge's."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from rosplc.monitor.tracked import is_starting, process_words

pytestmark = pytest.mark.verifies("views", own="simulation of every state")


def test_a_bridge_is_there_stopped_ended_or_gone():
    """A real process in each state, under its own name."""
    program = "import time; print(flush=True); time.sleep(600)  # rosplc"
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    try:
        assert child.stdout is not None
        child.stdout.readline()  # while a process becomes another program, it has no command line
        assert process_words(child.pid) == "the process is running but does not respond"
        child.send_signal(signal.SIGSTOP)
        _wait_for(child.pid, "the process is stopped (SIGSTOP)")
    finally:
        child.kill()
    _wait_for(child.pid, "the process has ended")
    child.wait()
    assert process_words(child.pid) == "no process with this ID is visible"


def _wait_for(pid, words):
    end = time.monotonic() + 60
    while process_words(pid) != words:
        assert time.monotonic() < end, process_words(pid)
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("stat", "command", "words"),
    [
        ("7 (a) b) S 1", b"/usr/bin/rosplc\0run\0", "the process is running but does not respond"),
        ("7 (vim) S 1", b"vim\0", "the process ID belongs to another program"),
        ("", b"", ""),
    ],
)
def test_names_and_numbers_may_be_anything(tmp_path, stat, command, words):
    """A name with parentheses, a number that went to another program, a file without content."""
    (tmp_path / "7").mkdir()
    (tmp_path / "7" / "stat").write_text(stat)
    (tmp_path / "7" / "cmdline").write_bytes(command)
    assert process_words(7, tmp_path) == words
    assert process_words(8, tmp_path) == "no process with this ID is visible"


@pytest.mark.parametrize(
    ("state", "age_s", "starting"),
    [("S", 2.0, True), ("S", 60.0, False), ("T", 2.0, False), ("Z", 2.0, False)],
)
def test_only_a_young_process_that_runs_is_starting(tmp_path, state, age_s, starting):
    """Its start counts from the machine's start, in the kernel's ticks."""
    ticks = int(1000.0 * os.sysconf("SC_CLK_TCK"))
    (tmp_path / "7").mkdir()
    (tmp_path / "7" / "stat").write_text(f"7 (rosplc) {state} {'0 ' * 18}{ticks} 0")
    (tmp_path / "7" / "cmdline").write_bytes(b"/usr/bin/rosplc\0run\0")
    assert is_starting(7, tmp_path, now_s=1000.0 + age_s) is starting
    assert not is_starting(8, tmp_path, now_s=1000.0)
    assert not is_starting(0, tmp_path, now_s=1000.0)


def test_a_real_process_that_was_just_started_is_starting():
    """The fields are those of this kernel."""
    program = "import time; print(flush=True); time.sleep(600)  # rosplc"
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    try:
        assert child.stdout is not None
        child.stdout.readline()  # while a process becomes another program, it has no command line
        now_s = time.clock_gettime(time.CLOCK_BOOTTIME)
        assert is_starting(child.pid, now_s=now_s)
        assert not is_starting(child.pid, now_s=now_s + 60.0)
    finally:
        child.kill()
        child.communicate()
