"""``rosplc-bench``: the comparison with Modbus, OPC UA and others, on this machine."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from rosplc.errors import RosplcError, SetupError
from rosplc.harmless import harmless
from rosplc_bench import draw
from rosplc_bench.end_to_end import SECTION as END_TO_END
from rosplc_bench.experiment import EXPERIMENT, WAITING_SECTION
from rosplc_bench.report import Report, Section, prepare, summary, write
from rosplc_bench.run import EFFORTS, REMEDY, run
from rosplc_bench.scan_cycle import SECTION as SCAN_CYCLE
from rosplc_bench.sweeps import SECTION as SWEEPS

SECTIONS = {
    section.name: section for section in (EXPERIMENT, WAITING_SECTION, END_TO_END, SCAN_CYCLE, SWEEPS)
}
"""By name, in the order of the report."""

EPILOG = """examples:
  rosplc-bench                       about two minutes; measures this machine
  rosplc-bench --quick               a first look in half a minute
  rosplc-bench --full --out results  about twelve minutes; report.md, report.json and figures in results/
  rosplc-bench --section experiment --only libmodbus --only rosplc-c
  rosplc-bench --from results/report.json --out pages
                                     write the report again, without measuring

Contenders in C need gcc. Contenders that lack a program or package are skipped, and the
reason is printed. The exit status is 0 if every value arrived intact, however slowly.
"""
EXIT_FAILURE, EXIT_INTERRUPTED = 1, 130
_SHOWN = 46  # characters beside the progress bar, on a terminal of 80


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0, 1 for a failure, 2 for wrong options, 130 for Ctrl-C."""
    parser = argparse.ArgumentParser(
        "rosplc-bench",
        description="Compare ways to exchange data with a PLC: Modbus, OPC UA, shared memory, rosplc.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    effort = parser.add_mutually_exclusive_group()
    effort.add_argument("--quick", action="store_true", help="one round, for a first look")
    effort.add_argument(
        "--full", action="store_true", help="more rounds, and longer ones; about twelve minutes"
    )
    parser.add_argument(
        "--section", metavar="NAME", action="append", choices=SECTIONS, help="run only this one; repeatable"
    )
    parser.add_argument(
        "--only", metavar="CONTENDER", action="append", default=[], help="run only this one; repeatable"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="write report.md, report.json and figures (PNG, SVG) here"
    )
    parser.add_argument(
        "--from", dest="earlier", type=Path, metavar="FILE", help="show this report.json without measuring"
    )
    parser.add_argument("--json", action="store_true", help="print the whole report as JSON")
    given = parser.parse_args(arguments)
    chosen = [each for name, each in SECTIONS.items() if not given.section or name in given.section]
    known = sorted({name for each in chosen for name in each.contenders})
    for name in given.only:
        if name not in known:
            parser.error(f"argument --only: invalid choice: {name!r} (choose from {', '.join(known)})")
    try:
        return _command(given, chosen)
    except RosplcError as error:
        if given.json:
            sys.stderr.write(json.dumps({"error": error.to_dict()}) + "\n")
        else:
            where = f"\n  where:  {error.where}" if error.where else ""
            _warn(f"rosplc-bench: error {error.code}: {error.what}{where}\n  remedy: {error.remedy}")
        return EXIT_FAILURE
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # The interpreter flushes stdout once more at exit; give it somewhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE


def _command(given: argparse.Namespace, chosen: Sequence[Section]) -> int:
    if given.earlier is not None:
        report = _read(given.earlier)
    else:
        if given.out is not None:
            prepare(given.out)
        effort = EFFORTS["quick" if given.quick else "full" if given.full else "default"]
        with _ended_by_signals(), _progress(quiet=given.json) as notify:
            report = run(chosen, effort, only=given.only, notify=notify)
    if given.out is not None:
        files = write(report, SECTIONS, given.out)
        _warn(f"{len(files)} files written to {given.out}")
        if not draw.available():
            _warn(f"no figures: the Python package matplotlib is missing; {REMEDY}")
    if given.json:
        print(json.dumps(report.to_dict(), indent=2))
    else:
        for line in summary(report, SECTIONS, max(60, min(100, shutil.get_terminal_size().columns))):
            print(harmless(line))
    sys.stdout.flush()
    return 0 if report.good else EXIT_FAILURE


def _warn(text: str) -> None:
    sys.stderr.write(harmless(text) + "\n")


def _read(path: Path) -> Report:
    try:
        return Report.from_json(path.read_text(encoding="utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise SetupError("SYS007", f"cannot read: {error}", where=str(path)) from error


@contextlib.contextmanager
def _progress(*, quiet: bool) -> Iterator[Callable[[Section, int, int, str], None] | None]:
    """Give what shows the progress: a bar with an estimate on a terminal, else a line per section."""
    if quiet:
        yield None
        return
    if not sys.stderr.isatty():
        announced: set[str] = set()

        def announce(section: Section, _done: int, total: int, _what: str) -> None:
            if section.name not in announced:
                announced.add(section.name)
                _warn(f"measuring: {section.name}, {total} steps")

        yield announce
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    # Drawn between two turns only: a thread that draws would compete with what is measured.
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=True),
        console=Console(stderr=True),
        auto_refresh=False,
        transient=True,
    ) as progress:
        tasks: dict[str, TaskID] = {}

        def notify(section: Section, done: int, total: int, what: str) -> None:
            if section.name not in tasks:
                for earlier in tasks.values():  # finished, even if it skipped its last steps
                    progress.remove_task(earlier)
                tasks.clear()
                tasks[section.name] = progress.add_task(section.name, total=total)
            shown = f"{section.name}: {what}"[:_SHOWN]
            progress.update(tasks[section.name], completed=done, total=total, description=shown)
            progress.refresh()

        yield notify


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the measurement as Ctrl-C does, so that nothing is left behind."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
