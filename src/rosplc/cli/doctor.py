"""``rosplc doctor``: what is wrong on this machine, and what to do about it."""

from __future__ import annotations

import os
import sys
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rosplc.cli.guard import EXIT_CONFIG, EXIT_FAILURE, guarded, print_json
from rosplc.cli.options import AsJson
from rosplc.cli.text import harmless

if TYPE_CHECKING:
    from rich.console import Console

    from rosplc.doctor import Finding, Report

__all__ = ["EPILOG", "command"]

EPILOG = """Examples:

rosplc doctor  —  this machine, and rosplc.yaml if this folder has one

rosplc doctor rosplc.yaml  —  and whether this configuration works here: objects, PLC, ROS graph

rosplc doctor rosplc.yaml --plc generated  —  and whether the PLC's code fits

rosplc doctor rosplc.yaml --json | jq '.findings[] | select(.level == "error")'

It needs no root, no ROS and no PLC, and changes nothing. The exit status is 1 if there is an error among
what it finds, 2 if the configuration itself is wrong. `rosplc explain CODE` explains a code.
"""

_STYLES = {"error": "bold red", "warning": "bold yellow", "note": "cyan", "ok": "green"}
_WIDTH = 80
_INDENT = 10


@guarded
def command(
    config: Annotated[
        Path | None,
        typer.Argument(
            help="The configuration; ./rosplc.yaml by default, else the machine alone is examined."
        ),
    ] = None,
    plc: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="What `rosplc generate` wrote: compare it with what is running."),
    ] = None,
    plc_user: Annotated[
        str | None, typer.Option(metavar="NAME", help="The PLC runtime's user, where it does not run now.")
    ] = None,
    ros: Annotated[
        bool, typer.Option("--ros/--no-ros", help="Look at the ROS graph, if there is a configuration.")
    ] = True,
    seconds: Annotated[
        float, typer.Option(metavar="SECONDS", help="How long to look at the ROS graph.", min=1.0, max=60.0)
    ] = 4.0,
    everything: Annotated[bool, typer.Option("--all", "-a", help="Show what is fine, line by line.")] = False,
    as_json: AsJson = False,
) -> None:
    """Examine this machine, a configuration and what runs; suggest fixes."""
    from rich.console import Console

    from rosplc.doctor import Question, examine

    question = Question(config, plc, plc_user or "", ros, seconds, variables=dict(os.environ))
    status = Console(stderr=True).status("looking") if sys.stderr.isatty() and not as_json else None
    if status is None:
        report = examine(question)
    else:
        with status:
            report = examine(question, lambda what: status.update(f"looking at {what}"))
    if as_json:
        print_json(report.to_dict())
    else:
        console = Console(highlight=False)
        if not console.is_terminal or console.width > _WIDTH:
            console = Console(highlight=False, width=_WIDTH)
        _show(report, console, everything=everything)
    if report.unusable:
        raise typer.Exit(EXIT_CONFIG)
    if report.worst.word == "error":
        raise typer.Exit(EXIT_FAILURE)


def _show(report: Report, console: Console, *, everything: bool) -> None:
    from rich.text import Text

    for area, findings in report.areas():
        console.print(Text(area.value, style="bold"))
        for finding in findings:
            if finding.level or everything:
                _show_finding(finding, console)
        if not everything:
            _show_fine(findings, console)
    counts = report.counts()
    words = [f"{counts['error']} errors", f"{counts['warning']} warnings", f"{counts['note']} notes"]
    words = [word[:-1] if word.startswith("1 ") else word for word in words]
    console.print(Text(f"\n{', '.join(words)}; {counts['ok']} fine", style=_STYLES[report.worst.word]))


def _show_finding(finding: Finding, console: Console) -> None:
    from rich.text import Text

    _say(console, finding.level.word, f"{finding.seen} [{finding.code}]")
    if finding.level and finding.remedy:
        _say(console, "", f"→ {finding.remedy}")
    if finding.level and finding.command:
        # In one piece, however long, so that it can be copied.
        console.print(Text(f"{' ' * _INDENT}$ {harmless(finding.command)}", style="bold"), soft_wrap=True)


def _show_fine(findings: list[Finding], console: Console) -> None:
    from rosplc.doctor import KINDS

    fine = [finding for finding in findings if not finding.level]
    if len(fine) == 1:
        _say(console, "ok", fine[0].seen)
    elif fine:
        _say(console, "ok", "; ".join(dict.fromkeys(KINDS[finding.code].title for finding in fine)))


def _say(console: Console, word: str, text: str) -> None:
    """Print a level's word and a text beside it, wrapped."""
    from rich.text import Text

    for line in textwrap.wrap(harmless(text), console.width - _INDENT, break_on_hyphens=False) or [""]:
        head = Text(f"  {word:<{_INDENT - 2}}", style=_STYLES.get(word, ""))
        console.print(head.append(line, style="none"), soft_wrap=True)
        word = ""
