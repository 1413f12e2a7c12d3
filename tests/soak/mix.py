"""Several cells at once: every backend, both kinds of PLC, and one whose bridge is never killed.

Each is a campaign in a process of its own, with its own shared memory, prefix, domain or port; most of a
round's time is waiting, so that two cores carry five of them.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

from tests.soak.results import compact, recovery_table, run_table, trend_table

_SAY_EVERY_S = 30.0


MIX = {
    "dds": "--backend dds",
    "dds-bridge-spared": "--backend dds --spare bridge",
    "zenoh": "--backend zenoh",
    "rospy": "--backend rospy",
    "structured-text": "--plc st",
}
"""Name of a cell, and of its files: the options that make it."""


class _Campaign:
    """A member that runs."""

    def __init__(self, name: str, folder: Path, arguments: list[str]) -> None:
        self.name = name
        self.json = folder / f"{name}.json"
        self.log = folder / f"{name}.log"
        self.json.unlink(missing_ok=True)
        self._output: IO[bytes] = self.log.open("wb")
        files = ["--json", str(self.json), "--logs", str(folder / f"{name}-failed")]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.soak", *MIX[name].split(), *arguments, *files],
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=self._output,
        )

    def last(self) -> str:
        """Return the last line that it said."""
        lines = self.log.read_text(errors="replace").splitlines()
        return lines[-1].strip() if lines else ""

    def end(self) -> int:
        """Wait for its end; return its status."""
        status = self.process.wait()
        self._output.close()
        return status


def run_mix(folder: Path, seed: int, limits: list[str], say: Callable[[str], None]) -> int:
    """Run all cells at once and say what came of them.

    Args:
        folder: For a JSON, a log and the bundles of failed rounds of each.
        seed: Each cell's own is this one and its place.
        limits: Arguments that bound each campaign.
        say: Takes lines for people.

    Returns:
        0 if everything held in every cell that can be had here, 1 if not.
    """
    folder.mkdir(parents=True, exist_ok=True)
    running = [
        _Campaign(name, folder, ["--seed", str(seed + place), *limits]) for place, name in enumerate(MIX)
    ]
    say(f"{len(running)} cells, seeds from {seed} on; each one's lines stand in {folder}/NAME.log")
    try:
        while any(one.process.poll() is None for one in running):
            time.sleep(0.2)
            if int(time.monotonic() / _SAY_EVERY_S) != int((time.monotonic() - 0.2) / _SAY_EVERY_S):
                for one in running:
                    say(f"{one.name:20s} {one.last()}")
    except KeyboardInterrupt:
        for one in running:
            one.process.terminate()
    statuses = {one.name: one.end() for one in running}
    found = [json.loads(one.json.read_text()) for one in running if one.json.exists()]
    runs = [compact(run) for run in found if run["log"]]
    for table in (run_table(runs), recovery_table(runs), trend_table(runs)):
        say("\n".join(["", *table]))
    for one in running:
        if statuses[one.name] == 2:
            say(f"not tried: {one.name}: {one.last()}")
        elif statuses[one.name]:
            say(f"violated: {one.name}: see {one.log}")
    return 1 if set(statuses.values()) - {0, 2} else 0
