"""``python -m tests.fuzz.replay [TARGET …]``: the repository's inputs, without a fuzzing library.

Whatever an input does besides being refused or accepted ends the run: an exception that is none of
rosplc's, an assertion, too much memory, more than :data:`SECONDS` on one input.
"""

from __future__ import annotations

import faulthandler
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.fuzz.build import Unbuildable, build, plans_and_seeds, seeds
from tests.fuzz.corpus import inputs
from tests.fuzz.targets import TARGETS, load, missing
from tests.fuzz.worker import limit_memory

__all__ = ["SECONDS", "replay"]

SECONDS = 120
"""After so long an input counts as endless: generous, since the machine may have other work."""


def replay(name: str) -> tuple[int, int]:
    """Run a Python target's seeds and inputs; return how many there were, and their bytes.

    Raises:
        Exception: What the target raises, with the input's place in a note on stderr.
    """
    target, count, size = load(name), 0, 0
    pairs = [("seed", data) for data in target.seeds()]
    pairs += [(str(path), path.read_bytes()) for path in inputs(name)]
    for place, data in pairs:
        faulthandler.dump_traceback_later(SECONDS, exit=True)
        try:
            target.check(data)
        except BaseException:
            print(f"{name}: {place} ({len(data)} bytes):", file=sys.stderr)
            raise
        finally:
            faulthandler.cancel_dump_traceback_later()
        count += 1
        size += len(data)
    return count, size


def replay_native(name: str, folder: Path, core: Path | None = None) -> tuple[int, int]:
    """Build a C target with gcc and run its inputs; return how many there were, and their bytes.

    Raises:
        Unbuildable: A Debian package is missing.
        AssertionError: The program found something; the text is what it says.
    """
    program = build(name, folder, fuzzing=False, **({} if core is None else {"core": core}))
    plans = folder / "plans"
    plans_and_seeds(plans)
    paths = inputs(name)
    for number, data in enumerate(seeds(name, plans)):
        paths.append(folder / f"{name}-seed-{number}")
        paths[-1].write_bytes(data)
    done = subprocess.run(
        [str(program), *map(str, paths)],
        env={**os.environ, "ROSPLC_FUZZ_PLANS": str(plans)},
        capture_output=True,
        text=True,
        errors="replace",
        timeout=SECONDS * 10,
        check=False,
    )
    assert done.returncode == 0, f"{name}: {done.stderr[-3000:]}"
    return len(paths), sum(path.stat().st_size for path in paths)


def main() -> int:
    """Replay the targets that are named, or all; say what was done and what was not."""
    wanted = sys.argv[1:] or list(TARGETS)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        for name in wanted:
            if not TARGETS[name].module:
                try:
                    _say(name, replay_native(name, Path(folder)))
                except Unbuildable as error:
                    print(f"{name}: not run: {error}")
    limit_memory()  # only now: a sanitizer reserves terabytes of addresses
    for name in wanted:
        if TARGETS[name].module:
            if why := missing(name):
                print(f"{name}: not run: {why}")
            else:
                _say(name, replay(name))
    return 0


def _say(name: str, done: tuple[int, int]) -> None:
    print(f"{name}: {done[0]} inputs, {done[1]} bytes", flush=True)


if __name__ == "__main__":
    sys.exit(main())
