"""``python -m tests.soak``: run a fault campaign."""

from __future__ import annotations

import argparse
import ctypes
import importlib.util
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.soak.campaign import Campaign, Outcome
from tests.soak.cell import Cell, WatchdogError
from tests.soak.draw import draw_series
from tests.soak.faults import Fault, faults_for
from tests.soak.mix import run_mix
from tests.soak.report import summary, to_json
from tests.soak.results import compact

_CLONE_NEWNS = 0x00020000


def own_shared_memory() -> bool:
    """Give this process a ``/dev/shm`` of its own, small enough to be filled; return whether that worked.

    Nothing of the host changes: the mount is seen by this process and its children alone.
    """
    if os.geteuid() != 0 or ctypes.CDLL(None, use_errno=True).unshare(_CLONE_NEWNS) != 0:
        return False
    for command in (
        ["mount", "--make-rprivate", "/"],
        ["mount", "-t", "tmpfs", "-o", "size=8m,mode=1777", "soak", "/dev/shm"],
    ):
        if subprocess.run(command, check=False, capture_output=True).returncode:
            return False
    return True


def why_not(backend: str, plc: str) -> str:
    """Return what is missing for a backend and a PLC; empty if nothing is."""
    if backend == "rospy" and shutil.which("rosmaster") is None:
        return "Debian package python3-rosmaster is missing"
    if plc == "st" and shutil.which("gcc") is None:
        return "Debian package gcc is missing"
    if plc == "st" and importlib.util.find_spec("blark") is None:
        return "Python package blark is missing"
    return ""


def _note(outcome: Outcome, path: Path | None) -> None:
    if path is not None:
        # Whoever looks meanwhile, or ends the campaign, finds the old or the new.
        fresh = path.with_suffix(".new")
        fresh.write_text(json.dumps(to_json(outcome), indent=1) + "\n")
        fresh.rename(path)


def _say(line: str) -> None:
    print(line, flush=True)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="soak", description="Kill, stop, starve and reload a bridge under load."
    )
    parser.add_argument("--seed", type=int, help="repeat the order of an earlier campaign")
    parser.add_argument("--rounds", type=int, default=0, help="most rounds")
    parser.add_argument("--minutes", type=float, default=0.0, help="most minutes")
    parser.add_argument(
        "--mix", type=Path, metavar="FOLDER", help="several cells at once, of all kinds; the files go there"
    )
    cell = parser.add_argument_group("one cell")
    cell.add_argument("--backend", choices=("dds", "zenoh", "rospy"), default="dds", help="the ROS side")
    cell.add_argument(
        "--plc",
        choices=("python", "st"),
        default="python",
        help="the PLC: virtual, or generated Structured Text that is executed, with classic topics",
    )
    cell.add_argument("--spare", action="append", default=[], metavar="PART", help="no fault that ends PART")
    cell.add_argument("--fault", action="append", default=[], help="only faults whose name has this in it")
    cell.add_argument(
        "--from-round", type=int, default=1, metavar="N", help="go on from there as the seed has it"
    )
    cell.add_argument("--json", type=Path, metavar="FILE", help="write everything there")
    cell.add_argument("--figure", type=Path, metavar="FILE", help="draw memory and descriptors over rounds")
    cell.add_argument("--logs", type=Path, metavar="FOLDER", help="keep a bundle of each round that failed")
    cell.add_argument("--list", action="store_true", help="only list the faults")
    return parser.parse_args()


def main() -> int:
    """Run the campaign; 0 if everything held, 1 if not, 2 if it cannot run."""
    options = _arguments()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    seed = random.SystemRandom().randrange(2**31) if options.seed is None else options.seed
    if options.mix is not None:
        limits = [f"--rounds={options.rounds}", f"--minutes={options.minutes}"]
        return run_mix(options.mix, seed, limits, _say)
    if reason := why_not(options.backend, options.plc):
        print(reason, file=sys.stderr)
        return 2
    private = own_shared_memory()
    with tempfile.TemporaryDirectory(prefix="soak-") as folder:
        cell = Cell(Path(folder), options.backend, private=private, plc=options.plc)
        try:
            faults = [
                fault
                for fault in faults_for(cell)
                if (not options.fault or any(word in fault.name for word in options.fault))
                and not fault.ends & set(options.spare)
            ]
            if options.list:
                print("\n".join(f"{fault.name:36s} {fault.missing(cell)}".rstrip() for fault in faults))
                return 0
            outcome = _campaign(cell, faults, seed, options)
        finally:
            cell.close()
    if outcome is None:
        return 1
    print(summary(outcome))
    _note(outcome, options.json)
    if options.figure is not None and outcome.samples:
        draw_series(compact(to_json(outcome)), options.figure)
    return 1 if outcome.violations else 0


def _campaign(cell: Cell, faults: Sequence[Fault], seed: int, options: argparse.Namespace) -> Outcome | None:
    _say(f"seed {seed}, backend {options.backend}, PLC {options.plc}, {len(faults)} kinds of fault")
    campaign = Campaign(
        cell, faults, seed, _say, note=lambda found: _note(found, options.json), spared=options.spare
    )
    rounds = options.rounds if options.rounds or options.minutes else 50
    try:
        return campaign.run(rounds, options.minutes * 60, options.logs, options.from_round)
    except KeyboardInterrupt:
        return campaign.outcome
    except WatchdogError as error:
        print(f"the cell did not start: {error}", file=sys.stderr)
        if options.logs is not None:
            cell.keep_logs(options.logs)
        return None


if __name__ == "__main__":
    sys.exit(main())
