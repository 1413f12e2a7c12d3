"""Fuzzers side by side, each for a while, with what they did and what they found."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tests.fuzz import build
from tests.fuzz.corpus import CACHE, CORPUS, REGRESSIONS, work_folder
from tests.fuzz.counts import Counts, new_counts, read_counts
from tests.fuzz.targets import TARGETS, load, missing

__all__ = ["Outcome", "run_all"]

_TIMEOUT_S = 60
"""After so long libFuzzer takes an input for endless; generous, since the machine may have other work."""
_MEMORY_MB = 2500
_GRACE_S = 900
"""For loading and for the inputs to begin with, which come before the time counts."""
_SAY_S = 10


@dataclass(frozen=True)
class Outcome:
    """What one target's fuzzer did.

    Attributes:
        name: The target.
        counts: Executions and bytes.
        seconds: How long it took, the loading included.
        inputs: Inputs that it keeps now.
        findings: Files with inputs that did what must not happen.
        skipped: Why it did not run; empty if it did.
        words: The fuzzer's last words, if it found something.
    """

    name: str
    counts: Counts = field(default_factory=Counts)
    seconds: float = 0.0
    inputs: int = 0
    findings: tuple[str, ...] = ()
    skipped: str = ""
    words: str = ""


class _Run:
    """One fuzzer, running."""

    def __init__(self, name: str, seconds: int, shared: Path, cache: Path) -> None:
        self.name = name
        self._began = time.monotonic()
        self._limit = seconds + _GRACE_S
        self._folder = cache / name
        self._work = work_folder(name, cache)
        self._findings = self._folder / "findings"
        self._findings.mkdir(exist_ok=True)
        self._before = set(self._findings.iterdir())
        self._counts = self._folder / "counts"
        self._log = self._folder / "log"
        seeds = self._folder / "seeds"
        seeds.mkdir(exist_ok=True)
        self._temporary = Path(tempfile.mkdtemp(prefix="fuzz-"))
        environment = {**os.environ, "TMPDIR": str(self._temporary)}
        if TARGETS[name].module:
            found = list(load(name).seeds())
            new_counts(self._counts)
            command = [sys.executable, "-m", "tests.fuzz.worker", name, str(self._counts)]
        else:
            plans = shared / "plans"
            types = len(build.plans_and_seeds(plans))
            found = list(build.seeds(name, plans))
            new_counts(self._counts, types if name == "codec" else 0)
            command = [str(build.build(name, shared, fuzzing=True))]
            environment |= {"ROSPLC_FUZZ_PLANS": str(plans), "ROSPLC_FUZZ_COUNTS": str(self._counts)}
        for number, data in enumerate(found):
            (seeds / str(number)).write_bytes(data)
        options = [
            f"-max_total_time={seconds}",
            f"-max_len={TARGETS[name].longest}",
            f"-timeout={_TIMEOUT_S}",
            f"-rss_limit_mb={_MEMORY_MB}",
            f"-artifact_prefix={self._findings}/",
            "-report_slow_units=3600",
            "-print_final_stats=1",
        ]
        folders = [self._work, CORPUS / name, REGRESSIONS / name, seeds]
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [*command, *options, *(str(folder) for folder in folders if folder.is_dir())],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=Path(__file__).resolve().parents[2],
                env=environment,
            )

    def state(self) -> str:
        """Return in words how far it is."""
        counts = read_counts(self._counts)
        return f"{self.name}: {counts.executions:,} inputs, {counts.bytes:,} bytes"

    def ended(self) -> bool:
        """Return whether it has ended; one that outlives its time by far is ended."""
        if self._process.poll() is None and time.monotonic() - self._began > self._limit:
            self._process.kill()
            self._process.wait()
        return self._process.poll() is not None

    def stop(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.wait()
        self._clean()

    def outcome(self) -> Outcome:
        """Return what it did."""
        self._clean()
        new = sorted(str(path) for path in set(self._findings.iterdir()) - self._before)
        failed = self._process.returncode != 0
        if failed and not new:
            new = [f"ended with status {self._process.returncode}"]
        text = self._log.read_text(errors="replace") if failed else ""
        return Outcome(
            self.name,
            read_counts(self._counts),
            time.monotonic() - self._began,
            sum(1 for _ in self._work.iterdir()),
            tuple(new) if failed else (),
            words=text[-6000:],
        )

    def _clean(self) -> None:
        """Remove what a fuzzer leaves behind: libFuzzer ends its process at once."""
        Path(f"/dev/shm/sem.rosplc-fuzz-{self._process.pid}").unlink(missing_ok=True)
        shutil.rmtree(self._temporary, ignore_errors=True)


def run_all(
    names: Sequence[str],
    seconds: int,
    shared: Path,
    say: Callable[[str], None],
    *,
    jobs: int = 1,
    cache: Path = CACHE,
) -> list[Outcome]:
    """Run fuzzers, ``jobs`` at a time, each for ``seconds``; return what they did, in the order of ``names``.

    Args:
        names: The targets.
        seconds: Time for each.
        shared: A folder for what is built.
        say: Takes lines about the progress.
        jobs: How many at once.
        cache: Where inputs grow from one campaign to the next.
    """
    waiting, running = list(names), list[_Run]()
    done: dict[str, Outcome] = {}
    said = time.monotonic()
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                name = waiting.pop(0)
                why = missing(name)
                if TARGETS[name].module and importlib.util.find_spec("atheris") is None:
                    why = "atheris is missing: pip install 'atheris>=3,<4'"
                if not why:
                    try:
                        running.append(_Run(name, seconds, shared, cache))
                    except build.Unbuildable as error:
                        why = str(error)
                if why:
                    done[name] = Outcome(name, skipped=why)
                    say(f"{name}: not run: {why}")
            time.sleep(0.2)
            for run in [each for each in running if each.ended()]:
                running.remove(run)
                outcome = done[run.name] = run.outcome()
                say(f"{run.state()} in {outcome.seconds:.0f} s, {len(outcome.findings)} findings")
            if time.monotonic() - said > _SAY_S:
                said = time.monotonic()
                for run in running:
                    say(f"  {run.state()}")
    finally:
        for run in running:
            run.stop()
    return [done[name] for name in names]
