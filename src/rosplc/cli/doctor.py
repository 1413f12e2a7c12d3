"""``rosplc doctor``: what is wrong on this machine, and what to do about it.

rosplc doctor  —  examine this machine, and rosplc.yaml if this folder contains one

rosplc doctor rosplc.yaml  —  also compare the configuration with the objects, the PLC and the ROS graph

rosplc doctor rosplc.yaml --plc generated  —  also check the generated PLC code

rosplc doctor rosplc.yaml --json | jq '.findings[] | select(.level == "error")'

Without a configuration, only the machine is examined. The doctor needs no root access, ROS or PLC, and
changes nothing. The exit status is 1 if a finding is an error, and 2 if the configuration is invalid.
`rosplc explain CODE` explains a code.
"""

from __future__ import annotations

import os
import sys
import textwrap
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.text import Text

from rosplc.cli.options import ConfigFile, default_config
from rosplc.cli.text import print_json
from rosplc.cli.verb import EXIT_CONFIG, EXIT_FAILURE, Between, verb
from rosplc.doctor import KINDS, Question, Report, examine
from rosplc.harmless import harmless, plural

_STYLES = {"error": "bold red", "warning": "bold yellow", "note": "cyan", "ok": "green"}
_WIDTH = 80
_INDENT = 10


@verb
def command(
    config: ConfigFile = None,
    *,
    plc: Path | None = None,
    plc_user: str | None = None,
    ros: bool = True,
    seconds: Annotated[float, Between(1.0, 60.0)] = 4.0,
    everything: bool = False,
    as_json: bool = False,
) -> None:
    """Examine this machine, a configuration and running bridges, and suggest fixes.

    Options:
        plc FOLDER: The output of `rosplc generate`, to compare with the configuration and the running bridge.
        plc_user NAME: The user of the PLC runtime, if the runtime is not running now.
        ros: Examine the ROS graph, which requires a configuration.
        seconds SECONDS: How long to examine the ROS graph.
        everything: Also show passed checks.
    """
    config = config or default_config()
    question = Question(config, plc, plc_user or "", ros, seconds, variables=dict(os.environ))
    status = Console(stderr=True).status("examining") if sys.stderr.isatty() and not as_json else None
    if status is None:
        report = examine(question)
    else:
        with status:
            report = examine(question, lambda what: status.update(f"examining {what}"))
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
    for area, findings in report.areas():
        console.print(Text(area.value, style="bold"))
        for finding in findings:
            if finding.level or everything:
                _line(console, finding.level.word, f"{finding.seen} [{finding.code}]")
            if finding.level and finding.remedy:
                _line(console, "", f"→ {finding.remedy}")
            if finding.level and finding.command:
                # In one piece, however long, so that it can be copied.
                command = f"{' ' * _INDENT}$ {harmless(finding.command)}"
                console.print(Text(command, style="bold"), soft_wrap=True)
        fine = [] if everything else [finding for finding in findings if not finding.level]
        if len(fine) == 1:
            _line(console, "ok", fine[0].seen)
        elif fine:
            _line(console, "ok", "; ".join(dict.fromkeys(KINDS[finding.code].title for finding in fine)))
    counts = report.counts()
    words = ", ".join(plural(counts[word], word) for word in ("error", "warning", "note"))
    console.print(Text(f"\n{words}; {counts['ok']} passed", style=_STYLES[report.worst.word]))


def _line(console: Console, word: str, text: str) -> None:
    for line in textwrap.wrap(harmless(text), console.width - _INDENT, break_on_hyphens=False) or [""]:
        head = Text(f"  {word:<{_INDENT - 2}}", style=_STYLES.get(word, ""))
        console.print(head.append(line, style="none"), soft_wrap=True)
        word = ""
