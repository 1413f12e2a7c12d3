"""``rosplc bench``: the comparison with Modbus, OPC UA and others, on this machine."""

from __future__ import annotations

import contextlib
import shutil
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rosplc.cli.guard import EXIT_FAILURE, EXIT_INTERRUPTED, guarded, print_json
from rosplc.cli.text import say, warn

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rosplc.bench.results import Report
    from rosplc.bench.section import Section

__all__ = ["EPILOG", "command"]

EPILOG = """Examples:

rosplc bench  —  about two minutes; the answer for this machine

rosplc bench --quick  —  a first look in half a minute

rosplc bench --full --out results  —  about twelve minutes; report.md, report.json and figures in results/

rosplc bench --section experiment --only libmodbus --only rosplc-c

rosplc bench --from results/report.json --out pages  —  write the pages again, without measuring

What is compared needs gcc and the Python packages of rosplc[bench]; what is missing is skipped, with
the reason. The exit status is 0 if every value came through whole; no time is ever too slow for it.
"""


@guarded
def command(
    quick: Annotated[bool, typer.Option("--quick", help="One round, for a first look.")] = False,
    full: Annotated[
        bool, typer.Option("--full", help="More rounds and more of each; about twelve minutes.")
    ] = False,
    section: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only this section; may be given again.")
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(metavar="CONTENDER", help="Only this contender; may be given again.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write report.md, report.json and the figures (PNG, SVG) here."),
    ] = None,
    earlier: Annotated[
        Path | None, typer.Option("--from", metavar="FILE", help="Show this report.json; measure nothing.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the whole report as JSON.")] = False,
) -> None:
    """Compare ways to exchange data with a PLC: Modbus, OPC UA, shared memory, rosplc."""
    from rosplc.bench import sections as registry

    if quick and full:
        raise typer.BadParameter("choose one of --quick and --full", param_hint="--quick")
    chosen = _chosen(section, registry.SECTIONS)
    known = sorted({name for each in chosen for name in each.contenders})
    for name in only or []:
        if name not in known:
            raise typer.BadParameter(f"{name!r} is none; there are: {', '.join(known)}", param_hint="--only")
    if earlier is not None:
        report = _read(earlier)
    else:
        if out is not None:
            from rosplc.bench.write import prepare

            prepare(out)
        effort = "quick" if quick else "full" if full else "default"
        report = _measure(chosen, effort, only or [], quiet=as_json)
    sections = {each.name: each for each in registry.SECTIONS}
    if out is not None:
        from rosplc.bench import draw
        from rosplc.bench.write import write

        files = write(report, sections, out)
        warn(f"{len(files)} files written to {out}")
        if not draw.available():
            warn("no figures: the Python package matplotlib is missing; pip install 'rosplc[bench]'")
    if as_json:
        print_json(report.to_dict())
    else:
        from rosplc.bench.verdict import verdict

        for line in verdict(report, sections, max(60, min(100, shutil.get_terminal_size().columns))):
            say(line)
    if not report.good:
        raise typer.Exit(EXIT_FAILURE)


def _chosen(names: list[str] | None, sections: Sequence[Section]) -> list[Section]:
    known = [each.name for each in sections]
    for name in names or []:
        if name not in known:
            raise typer.BadParameter(
                f"{name!r} is none; there are: {', '.join(known)}", param_hint="--section"
            )
    return [each for each in sections if not names or each.name in names]


def _read(path: Path) -> Report:
    from rosplc.bench.results import Report
    from rosplc.errors import SetupError

    try:
        return Report.from_json(path.read_text(encoding="utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise SetupError("SYS007", f"cannot read: {error}", where=str(path)) from error


def _measure(sections: Sequence[Section], effort: str, only: Sequence[str], *, quiet: bool) -> Report:
    from rosplc.bench.context import EFFORTS
    from rosplc.bench.runner import run

    with _ended_by_sigterm(), _progress(quiet=quiet) as notify:
        return run(sections, EFFORTS[effort], only=only, notify=notify)


_SHOWN = 46  # characters beside the bar, on a terminal of 80


@contextlib.contextmanager
def _progress(*, quiet: bool) -> Iterator[Callable[[Section, int, int, str], None] | None]:
    """Give what shows the progress: a bar with an estimate on a terminal, else a line per section."""
    if quiet:
        yield None
        return
    if not sys.stderr.isatty():
        yield _lines()
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
                for earlier in tasks.values():  # finished, whatever it was that it skipped at its end
                    progress.remove_task(earlier)
                tasks.clear()
                tasks[section.name] = progress.add_task(section.name, total=total)
            shown = f"{section.name}: {what}"[:_SHOWN]
            progress.update(tasks[section.name], completed=done, total=total, description=shown)
            progress.refresh()

        yield notify


def _lines() -> Callable[[Section, int, int, str], None]:
    begun: set[str] = set()

    def notify(section: Section, done: int, total: int, what: str) -> None:
        if section.name not in begun:
            begun.add(section.name)
            warn(f"measuring: {section.name}, {total} steps")

    return notify


@contextlib.contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the measurement as Ctrl-C does, so that nothing is left behind."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    except KeyboardInterrupt:
        raise typer.Exit(EXIT_INTERRUPTED) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
