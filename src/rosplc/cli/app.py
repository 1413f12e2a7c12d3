"""The command's frame: its verbs, in the groups in which --help lists them."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from rosplc._version import FORMAT, __version__
from rosplc.cli import (
    bench,
    check,
    clean,
    demo,
    doctor,
    explain,
    generate,
    init,
    record,
    release,
    reload,
    replay,
    ros,
    run,
    service,
    show,
    status,
    top,
    types,
    web,
)

_EXAMPLES = """Examples:

rosplc demo  —  see it work, without a robot and without a PLC

rosplc init  —  write rosplc.yaml from a running robot

rosplc check  —  explain rosplc.yaml

rosplc generate --out plc  —  write the PLC code

rosplc run  —  run the bridge

rosplc status  —  every channel on this machine, and whether anything is wrong

rosplc doctor  —  problems of machine and configuration, with fixes

`rosplc VERB --help` explains a verb; `rosplc explain CODE` an error.
"""
_VERBS: dict[str, dict[str, Any]] = {
    "Set up": {"demo": demo, "init": init, "check": check, "generate": generate, "types": types},
    "Run": {"run": run, "reload": reload, "service": service, "release": release, "clean": clean},
    "Watch": {"status": status, "show": show, "top": top, "web": web, "record": record, "replay": replay},
    "ROS": {"list": ros.LIST, "echo": ros.ECHO, "hz": ros.HZ, "pub": ros.PUB},
    "Diagnose": {"doctor": doctor, "explain": explain, "bench": bench},
}

app = typer.Typer(
    help="Carry ROS topics to and from a soft-PLC (CODESYS) on this machine, through shared memory.",
    epilog=_EXAMPLES,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

for _group, _members in _VERBS.items():
    for _name, _verb in _members.items():
        app.command(
            _name,
            epilog="Examples:\n\n" + (_verb.__doc__ or "").partition("\n\n")[2],
            cls=run.RosCommand if _verb is run else None,
            rich_help_panel=_group,
            context_settings={"ignore_unknown_options": True} if _verb is bench else None,
        )(_verb.command)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"rosplc {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit."),
    ] = False,
) -> None:
    """Carry ROS topics to and from a soft-PLC (CODESYS) on this machine, through shared memory."""


@app.command("version", rich_help_panel="Diagnose")
def _version() -> None:
    """Print the version of rosplc and of the shared-memory format."""
    typer.echo(f"rosplc {__version__}, shared-memory format {FORMAT}")
