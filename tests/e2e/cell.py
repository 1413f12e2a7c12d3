"""A cell of the end-to-end tests: the bridge as a process, and the blocks of a PLC that the test scans."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from rosplc.layout.view import plain
from rosplc.virtual_plc import ReadBlock, WriteBlock

__all__ = ["Bridge", "Plc"]


class Bridge:
    """``rosplc run`` as a process of its own."""

    def __init__(self, path: Path, environment: Mapping[str, str]) -> None:
        self.log = path.with_suffix(".log")
        with self.log.open("a") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "rosplc", "run", str(path)],
                env=environment,
                stdout=log,
                stderr=log,
            )

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def wait(self) -> int:
        return self._process.wait()

    def stop(self) -> int:
        self._process.send_signal(signal.SIGTERM)
        return self._process.wait()


class Plc:
    """Read and Write blocks, scanned by the test itself.

    Args:
        prefix: The bridge's ``prefix:``.
        reads: Topics to read, every message of them.
        writes: Topics to write.
    """

    def __init__(self, prefix: str, reads: Iterable[str], writes: Iterable[str]) -> None:
        self.reads = {
            topic: ReadBlock(topic, prefix=prefix, mode="every", max_per_cycle=500, stale_after=None)
            for topic in reads
        }
        self.writes = {topic: WriteBlock(topic, prefix=prefix) for topic in writes}
        self.seen: dict[str, list[Any]] = {topic: [] for topic in self.reads}

    def scan(self) -> None:
        for topic, block in self.reads.items():
            self.seen[topic] += [plain(message) for message in block.each()]
        for block in self.writes.values():
            block.xEnable = False
            block()
        time.sleep(0.002)

    def until(self, condition: Callable[[], object]) -> None:
        """Scan until the condition is true; pytest's timeout is the watchdog."""
        while not condition():
            self.scan()

    def write(self, topic: str, fill: Callable[[Any], object]) -> None:
        """Publish one message, as soon as the block can."""
        block = self.writes[topic]
        self.until(lambda: block.xReady)
        fill(block.msg)
        block.xEnable = True
        block()
        block.xEnable = False
        assert block.xPublished

    @property
    def attached(self) -> bool:
        return all(b.xAttached for b in self.reads.values()) and all(b.xReady for b in self.writes.values())
