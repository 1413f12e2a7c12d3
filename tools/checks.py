"""Run the project's checks in order and close with what passed, failed and was not run.

``python tools/checks.py lint types tests`` is what ``make test`` runs, ``foreign`` and ``long`` are the
other tiers (tests/README.md), and ``--minutes`` bounds a run. The exit status is 1 if any check failed.
The last lines are pytest's own summaries, or go to the file named by ``ROSPLC_SUMMARY`` (so that ``.ci/run``
can close with them).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BIN = Path(sys.executable).parent
SUMMARY = re.compile(r"^=* ?\d+ \w+.* in \d[\d.]*s.*$|^=* ?no tests ran in .*$")
COLOUR = re.compile(r"\x1b\[[0-9;]*m")
MISSING_PACKAGE = re.compile(r"Debian package (\S+) is missing")
NO_TESTS = 5  # pytest's exit status when a selection is empty
WORKERS = 4  # two cores are enough: most tests wait for another process most of the time
# Compiled modules are kept even where the environment forbids it: hundreds of programs start in a run.
ENVIRONMENT = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}


@dataclass
class Outcome:
    """What a run of checks found."""

    steps: list[tuple[str, bool, float]] = field(default_factory=list)
    absent: dict[str, str] = field(default_factory=dict)
    skipped: dict[str, str] = field(default_factory=dict)
    unreached: list[str] = field(default_factory=list)
    repeated: list[str] = field(default_factory=list)
    summaries: list[str] = field(default_factory=list)
    ends: float | None = None

    @property
    def failed(self) -> bool:
        """Whether any step failed."""
        return not all(good for _, good, _ in self.steps)


def stream(command: list[str], env: dict[str, str] | None = None) -> tuple[int, str]:
    """Run a command, pass its output on as it comes, and return exit status and output."""
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        env=ENVIRONMENT if env is None else env,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    assert process.stdout is not None
    chunks = []
    while chunk := os.read(process.stdout.fileno(), 65536):
        chunks.append(chunk)
        sys.stdout.buffer.write(chunk)
        sys.stdout.flush()
    return process.wait(), b"".join(chunks).decode(errors="replace")


def step(outcome: Outcome, name: str, command: list[str]) -> None:
    """Run one tool and note how it ended."""
    print(f"── {name}", flush=True)
    began = time.monotonic()
    status, _ = stream(command)
    outcome.steps.append((name, status == 0, time.monotonic() - began))


def run_pytest(
    outcome: Outcome,
    name: str,
    marks: str,
    *,
    workers: int = 0,
    deadline: float | None = None,
    may_be_empty: bool = False,
    python: Path | None = None,
    places: Sequence[str] = (),
) -> None:
    """Run the tests that ``marks`` selects, and keep their summary line and their skips."""
    # loadgroup: tests that share something outside the process can ask for one worker.
    options = ["-n", str(workers), "--dist", "loadgroup"] if workers else []
    print(f"── {name}", flush=True)
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        env = {**ENVIRONMENT, "ROSPLC_REPORT": str(report)}
        env.pop("ROSPLC_DEADLINE", None)
        if deadline is not None:
            env["ROSPLC_DEADLINE"] = str(deadline)
        colour = "yes" if sys.stdout.isatty() else "no"
        command = [str(python or sys.executable), "-m", "pytest", *places, "-m", marks, *options]
        command += ["--durations=5", f"--color={colour}"]
        if reruns := os.environ.get("ROSPLC_RERUNS"):
            command += ["--reruns", reruns, "--max-suite-reruns=5", "--rerun-show-tracebacks", "-rfE"]
        status, text = stream(command, env)
        if report.exists():
            found = json.loads(report.read_text())
            outcome.absent.update(found["absent"])
            outcome.skipped.update(found["skipped"])
            outcome.unreached += found["unreached"]
            outcome.repeated += found["repeated"]
    good = status == 0 or (may_be_empty and status == NO_TESTS)
    lines = [line for line in text.splitlines() if SUMMARY.match(COLOUR.sub("", line))]
    if status != NO_TESTS:
        outcome.summaries.append(lines[-1] if lines else f"{name}: pytest ended with status {status}")
    outcome.steps.append((name, good, time.monotonic() - began))


def lint(outcome: Outcome) -> None:
    """Check style, format and the dependency rule."""
    step(outcome, "ruff", [str(BIN / "ruff"), "check", "."])
    step(outcome, "ruff format", [str(BIN / "ruff"), "format", "--check", "."])
    step(outcome, "import-linter", [str(BIN / "lint-imports"), "--no-logo"])
    own = ["--no-logo", "--config", "benchmarks/pyproject.toml"]
    step(outcome, "import-linter, rosplc-bench", [str(BIN / "lint-imports"), *own])
    step(outcome, "words", [sys.executable, "tools/check_words.py"])


def types(outcome: Outcome) -> None:
    """Check the types of the package and of the project's own tools."""
    step(outcome, "mypy --strict", [str(BIN / "mypy")])
    own = ["conftest.py", "tools", "tests/soak", "tests/fuzz", "packaging/deploy"]
    step(outcome, "mypy --strict tools", [str(BIN / "mypy"), *own])


def tests(outcome: Outcome) -> None:
    """Run the first tier."""
    run_pytest(outcome, "tests", "not verify and not foreign", workers=WORKERS)


def foreign(outcome: Outcome) -> None:
    """Run the tests that need software which is not of this project, tests marked serial alone."""
    ends = outcome.ends
    marks = "foreign and not verify"
    run_pytest(outcome, "foreign", f"{marks} and not serial", workers=WORKERS, deadline=ends)
    run_pytest(outcome, "foreign, one at a time", f"{marks} and serial", deadline=ends, may_be_empty=True)
    places = [
        "tests/interop/ros2",
        "tests/conformance/test_backends.py",
        "tests/conformance/test_services.py",
    ]
    places += ["tests/unit/ros/test_rclpy_signatures.py"]
    if found := sorted((ROOT / ".cache").glob("ros2-*/.ready")):
        python = found[0].parent / "bin" / "python"
        run_pytest(outcome, "real ROS 2", "ros2", python=python, places=places, deadline=ends)
    else:
        version = ".".join(map(str, sys.version_info[:2]))
        why = (
            f"no wheels of ROS 2 for Python {version} on {platform.machine()} (`make ros2-env` installs them)"
        )
        outcome.absent.update({"tests/interop/ros2": why, "tests/conformance/test_backends.py[rclpy]": why})


def long(outcome: Outcome) -> None:
    """Run the tests marked verify: serial ones in at most half of the time, then the others."""
    ends, now = outcome.ends, time.time()
    half = None if ends is None else now + (ends - now) / 2
    name = "long checks"
    run_pytest(outcome, f"{name}, one at a time", "verify and serial", deadline=half, may_be_empty=True)
    run_pytest(outcome, name, "verify and not serial", workers=2, deadline=ends, may_be_empty=True)


def bench(outcome: Outcome) -> None:
    """Run every measurement in benchmarks/."""
    ros2 = [str(each) for each in sorted((ROOT / ".cache").glob("ros2-*/bin/python"))]
    for path in sorted((ROOT / "benchmarks").glob("bench_*.py")):
        python = (ros2 or [sys.executable])[0] if path.stem == "bench_rclpy" else sys.executable
        step(outcome, path.name, [python, "-m", f"benchmarks.{path.stem}"])


STEPS: dict[str, Callable[[Outcome], None]] = {
    f.__name__: f for f in (lint, types, tests, foreign, long, bench)
}


def print_places(nodeids: Iterable[str]) -> None:
    """Print tests by name, with the number of their cases."""
    for place, count in sorted(Counter(nodeid.partition("[")[0] for nodeid in nodeids).items()):
        print(f"      {place}" + (f" ({count} cases)" if count > 1 else ""))


@contextlib.contextmanager
def beside(outcome: Outcome, name: str) -> Iterator[None]:
    """Run a step in a process of its own while the others run, and print at the end what it printed."""
    began = time.monotonic()
    with tempfile.TemporaryFile() as output:
        command = [sys.executable, __file__, name]
        process = subprocess.Popen(command, env=ENVIRONMENT, stdout=output, stderr=subprocess.STDOUT)
        try:
            yield
            good = process.wait() == 0
        finally:
            process.kill()
            process.wait()
        output.seek(0)
        print(output.read().decode(errors="replace"), end="", flush=True)
    outcome.steps.append((name, good, time.monotonic() - began))


def report(outcome: Outcome) -> None:
    """Print what passed, what failed, and what was not run and why."""
    print("── summary")
    for name, good, seconds in outcome.steps:
        print(f"   {'passed' if good else 'FAILED':7} {name} ({seconds:.0f} s)")
    if outcome.unreached:
        print(f"\nNot run for lack of time: {len(outcome.unreached)} checks")
        print_places(outcome.unreached)
    if outcome.absent:
        print("\nNot run because this machine lacks something:")
        for reason in sorted(set(outcome.absent.values())):
            print(f"   {reason}")
            print_places(place for place, why in outcome.absent.items() if why == reason)
    packages = {match[1] for reason in outcome.absent.values() if (match := MISSING_PACKAGE.search(reason))}
    if packages:
        print(f"   run them after: sudo apt-get install {' '.join(sorted(packages))}")
    if outcome.skipped:
        print("\nSkipped:")
        for place, reason in sorted(outcome.skipped.items()):
            print(f"   {place}: {reason}")
    if outcome.repeated:
        print("\nUNRELIABLE, failed and was repeated:")
        print_places(outcome.repeated)
    if path := os.environ.get("ROSPLC_SUMMARY"):
        with Path(path).open("a") as file:
            file.writelines(f"{line}\n" for line in outcome.summaries)
    elif outcome.summaries:
        print()
        print("\n".join(outcome.summaries))


def main() -> int:
    """Parse the command line and run the steps it names."""
    parser = argparse.ArgumentParser(description="Run the project's checks.")
    parser.add_argument("steps", nargs="+", choices=STEPS)
    parser.add_argument(
        "--minutes", default="", help="time for the whole run; foreign and long checks beyond it are skipped"
    )
    arguments = parser.parse_args()
    outcome = Outcome()
    if arguments.minutes:
        outcome.ends = time.time() + 60 * float(arguments.minutes)
    steps = list(arguments.steps)
    with contextlib.ExitStack() as stack:
        if {"types", "tests"} <= set(steps):
            # mypy uses one core while most tests wait for another process.
            steps.remove("types")
            stack.enter_context(beside(outcome, "types"))
        for name in steps:
            STEPS[name](outcome)
    if arguments.steps not in (["lint"], ["types"]) or outcome.failed:
        report(outcome)
    return 1 if outcome.failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
