"""One shell for one documentation page: commands in order, and others in the background."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from tests.lib import isolated

COMMAND_SECONDS = 240.0  # a watchdog; a first translation of Structured Text takes a minute or two
END = re.compile(rb"\n--rosplc-docs-end (\d+)--\n")


class Shell:
    """A bash whose directory and variables last from one command to the next.

    It has shared memory and a network of its own, where this user may make such a world.
    """

    def __init__(self, folder: Path, env: dict[str, str]) -> None:
        self.folder = folder
        self.env = {**env, "PYTHONFAULTHANDLER": "1"}
        self.background: list[Background] = []
        self.terminals: dict[str, Background] = {}
        self.process = subprocess.Popen(
            [*(isolated.command() if isolated.possible() else ()), "bash", "--noprofile", "--norc"],
            cwd=folder,
            env=self.env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    def run(self, command: str) -> tuple[int, str]:
        """Run a command to its end; return its exit status and what it printed."""
        assert self.process.stdin is not None and self.process.stdout is not None
        script = f"{{ {command}\n}} </dev/null\nprintf '\\n--rosplc-docs-end %d--\\n' $?\n"
        self.process.stdin.write(script.encode())
        self.process.stdin.flush()
        # A watchdog, so that a command that waits for ever ends as a failure and not as a hang.
        watchdog = threading.Timer(COMMAND_SECONDS, self._abort)
        watchdog.start()
        output = b""
        try:
            while not (end := END.search(output)):
                chunk = os.read(self.process.stdout.fileno(), 65536)
                if not chunk:
                    text = output.decode(errors="replace")
                    raise AssertionError(f"`{command}` ended the shell or took too long; it printed:\n{text}")
                output += chunk
        finally:
            watchdog.cancel()
        return int(end[1]), output[: end.start()].decode(errors="replace")

    def start(self, command: str, name: str = "") -> Background:
        """Start a command in the shell's folder and leave it running; ``name`` is its terminal."""
        _, folder = self.run("pwd")
        world = isolated.command(join=self.process.pid) if isolated.possible() else []
        job = Background(command, Path(folder.strip()), self.env, world, self._diagnose)
        self.background.append(job)
        self.terminals[name] = job
        return job

    def _diagnose(self) -> None:
        """Print what a person would look at when a terminal does not show what it should; end the page."""
        looks = ["rosplc status --json", "rosplc list --json", "rosplc status --json", "ls -l /dev/shm"]
        for job in self.background:
            looks.append(f"ps -L -o pid,tid,stat,time,wchan:24,comm -p {job.process.pid}")
            looks.append(
                f"gdb -p {job.process.pid} -batch -ex 'thread apply all bt'"
            )  # where it is installed
        for look in looks:
            with contextlib.suppress(AssertionError, OSError):
                print(f"$ {look}\n{self.run(f'timeout 20 {look} 2>&1')[1]}")
        self._abort()

    def _abort(self) -> None:
        """End every program of the page; those in Python print where their threads are."""
        for number, seconds in ((signal.SIGABRT, 2), (signal.SIGKILL, 0)):
            for process in (self.process, *(job.process for job in self.background)):
                if process.poll() is None:
                    os.killpg(process.pid, number)
            time.sleep(seconds)

    def close(self) -> None:
        """End everything that the page started, and print what its terminals show, for a failure's report."""
        ended = [job.process.poll() for job in self.background]
        for job in reversed(self.background):
            job.stop()
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.communicate()
        for job, status in zip(self.background, ended, strict=True):
            job.thread.join(COMMAND_SECONDS)
            how = "" if status is None else f" (it had ended with {status})"
            print(f"--- terminal: {job.command}{how}\n{job.text()}")


class Background:
    """A command that runs beside the page's shell; its output is kept."""

    def __init__(
        self,
        command: str,
        folder: Path,
        env: dict[str, str],
        world: Sequence[str],
        on_timeout: Callable[[], None],
    ) -> None:
        self.command = command
        self.on_timeout = on_timeout
        self.output = b""
        self.seen = 0
        self.process = subprocess.Popen(
            [*world, "bash", "--noprofile", "--norc", "-c", command],
            cwd=folder,
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        self.thread = threading.Thread(target=self._collect, daemon=True)
        self.thread.start()

    def _collect(self) -> None:
        assert self.process.stdout is not None
        while chunk := os.read(self.process.stdout.fileno(), 65536):
            self.output += chunk

    def text(self) -> str:
        """Return what the command has printed so far."""
        return self.output.decode(errors="replace").replace("\r\n", "\n")

    def wait_for(self, found: re.Pattern[str]) -> None:
        """Wait until the output since the last look holds the pattern; fail if the command ends before."""
        watchdog = time.monotonic() + COMMAND_SECONDS
        while not (shown := found.search(self.text(), self.seen)):
            ended = self.process.poll() is not None and not self.thread.is_alive()
            if (ended and not found.search(self.text(), self.seen)) or time.monotonic() > watchdog:
                text = self.text()[self.seen :]
                if not ended:
                    self.on_timeout()
                raise AssertionError(f"`{self.command}` did not print what is shown, but:\n{text}")
            time.sleep(0.05)
        self.seen = shown.end()

    def interrupt(self) -> None:
        """Press Ctrl-C, and wait for the end of what runs there: without a traceback."""
        os.killpg(self.process.pid, signal.SIGINT)
        self.process.wait(COMMAND_SECONDS)
        self.thread.join(COMMAND_SECONDS)
        assert "Traceback" not in self.text(), f"Ctrl-C on `{self.command}` shows:\n{self.text()}"

    def kill(self) -> None:
        """End what runs there with SIGKILL."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait(COMMAND_SECONDS)

    def stop(self) -> None:
        """Interrupt the command as Ctrl-C would, and kill it if that does not help."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(20)
        # The number of a process that has been waited for may be another's by now.
        if self.process.poll() is None:
            self.kill()
