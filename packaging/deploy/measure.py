"""Memory and start of a bridge on an emulated board: ``python -m deploy.measure BOARD``.

BOARD is a folder that becomes a 32-bit ARM Debian with rosplc in it, unless it is one already. Memory is
that of the program in the emulator, so it is the board's: the emulator lays the program's address space of
4 GiB at one place of its own, and what is resident there would be on the board. The emulator's own memory,
above all the code that it translated, lies elsewhere and is not counted. Start is processor time
in the emulator, so it only says what takes long; a board's own time has to be measured there.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from deploy.board import ARCHITECTURES, Board
from deploy.wheel import DeployError, run

__all__ = ["ENVIRONMENT", "GuestMemory", "Result", "guest_memory", "main", "measure", "table"]

_SETTLE_S = 5.0
_LONGEST_S = 300.0
_TICKS = os.sysconf("SC_CLK_TCK")
_BASE = 0x2_0000_0000
_SIZE = 1 << 32
ENVIRONMENT = {"QEMU_GUEST_BASE": hex(_BASE)}
"""Makes the emulator use the place that :func:`guest_memory` looks at."""


@dataclass(frozen=True)
class GuestMemory:
    """Resident memory in KiB.

    Attributes:
        own: Pages that only this process has: heap, stacks, changed data.
        files: Pages of programs and libraries, which processes with the same ones share.
        shared: Pages of shared memory, such as channels.
    """

    own: int
    files: int
    shared: int

    @property
    def total(self) -> int:
        """All of it."""
        return self.own + self.files + self.shared


def guest_memory(pid: int) -> GuestMemory:
    """Return what the program in an emulator holds.

    Args:
        pid: The emulator's process, started with :data:`ENVIRONMENT`.

    Raises:
        OSError: The process has ended.
    """
    sizes = {"own": 0, "files": 0, "shared": 0}
    inside, kind = False, ""
    for line in Path(f"/proc/{pid}/smaps").read_text(encoding="utf-8", errors="replace").splitlines():
        words = line.split()
        if not words[0].endswith(":"):
            start = int(words[0].partition("-")[0], 16)
            inside = _BASE <= start < _BASE + _SIZE
            kind = "shared" if " /dev/shm" in line else "files"
        elif inside and words[0] == "Rss:":
            sizes[kind] += int(words[1])
        elif inside and words[0] == "Anonymous:":
            sizes[kind] -= int(words[1])
            sizes["own"] += int(words[1])
    return GuestMemory(**sizes)


@dataclass(frozen=True)
class Result:
    """What one bridge took.

    Attributes:
        backend: The way into ROS.
        topics: How many it carried, half of them each way.
        memory: After the start.
        start_s: Processor seconds in the emulator until it carried.
        here_s: The same for this machine's own Python.
    """

    backend: str
    topics: int
    memory: GuestMemory
    start_s: float
    here_s: float


def configuration(backend: str, topics: int, prefix: str) -> str:
    """Return a configuration with so many topics of Twist, half of them each way."""
    lines = [f"prefix: {prefix}", f"ros: {{distro: jazzy, backend: {backend}}}", "topics:"]
    for number in range(topics):
        way = "ros" if number % 2 else "plc"
        lines.append(f"  /topic_{number:02}: {{type: geometry_msgs/msg/Twist, to: {way}}}")
    return "\n".join(lines) + "\n"


def _started(command: Sequence[str], environment: dict[str, str]) -> tuple[subprocess.Popen[str], float]:
    process = subprocess.Popen(
        command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    said = []
    for line in process.stderr:
        said.append(line)
        if " carries " in line:
            fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
            return process, (int(fields[11]) + int(fields[12])) / _TICKS
    process.wait()
    raise DeployError(f"{' '.join(command)}\nended with {process.returncode}:\n{''.join(said)}")


def _end(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGTERM)
    try:
        process.communicate(timeout=_LONGEST_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()


def measure(board: Board, backend: str, topics: int) -> Result:
    """Start a bridge on the board, and one of this machine, and look what they take."""
    prefix = f"board{secrets.token_hex(4)}"
    inside = f"tmp/{prefix}.yaml"
    path = board.root / inside
    path.write_text(configuration(backend, topics, prefix), encoding="utf-8")
    arguments = ("-m", "rosplc", "run", "--status", "0")
    try:
        here, here_s = _started([sys.executable, *arguments, str(path)], dict(os.environ))
        _end(here)
        command = board.python(*arguments, f"/{inside}")
        environment = {**board.environment, **ENVIRONMENT}
        # The first start compiles what it imports, as Debian's installation would have done.
        process, _ = _started(command, environment)
        _end(process)
        process, start_s = _started(command, environment)
        time.sleep(_SETTLE_S)
        memory = guest_memory(process.pid)
        _end(process)
    finally:
        path.unlink()
        for file in Path("/dev/shm").glob(f"{prefix}.*"):
            file.unlink()
    return Result(backend, topics, memory, start_s, here_s)


def table(results: Sequence[Result]) -> str:
    """Return the results as a Markdown table."""
    lines = [
        "| way into ROS | topics | its own memory | code, libraries | together | start there | start here |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for one in results:
        sizes = (one.memory.own, one.memory.files + one.memory.shared, one.memory.total)
        mib = " | ".join(f"{size / 1024:.1f} MiB" for size in sizes)
        lines.append(f"| `{one.backend}` | {one.topics} | {mib} | {one.start_s:.1f} s | {one.here_s:.1f} s |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(prog="python -m deploy.measure", description=__doc__)
    parser.add_argument("board", type=Path, help="the folder of the board's Debian")
    parser.add_argument("--backend", default="zenoh", help="the way into ROS (default: zenoh)")
    parser.add_argument("--topics", type=int, nargs="+", default=[2, 20], help="default: 2 20")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results there, too")
    options = parser.parse_args(arguments)
    try:
        board = Board(options.board, ARCHITECTURES["armhf"])
        if not board.root.exists():
            print("fetching the board's Debian, and installing rosplc there (minutes)", flush=True)
            board.make()
            board.install(board.root / "tmp/built")
        results = [measure(board, options.backend, count) for count in options.topics]
    except DeployError as error:
        print(f"deploy: {error}", file=sys.stderr)
        return 1
    print(table(results))
    if options.json:
        emulator = run([board.architecture.emulator, "--version"]).splitlines()[0]
        document = {"emulator": emulator, "results": [asdict(one) for one in results]}
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
