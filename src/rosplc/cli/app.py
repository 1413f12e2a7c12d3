"""The command's frame: which verbs there are, and what stands around them."""

from __future__ import annotations

from typing import Annotated

import typer

from rosplc._version import __version__
from rosplc.cli import (
    bench,
    check,
    demo,
    doctor,
    generate,
    init,
    record,
    replay,
    run,
    service,
    show,
    status,
    top,
    types,
    web,
)
from rosplc.cli.ros_arguments import RosCommand

__all__ = ["app"]

_EXAMPLES = """Examples:

rosplc demo  —  see it work, without a robot and without a PLC

rosplc types geometry_msgs/Twist  —  how a ROS type looks in the PLC

rosplc init  —  from a robot that is there to a configuration

rosplc check rosplc.yaml  —  what a configuration means, in plain words

rosplc generate rosplc.yaml  —  the PLC half, for CODESYS

rosplc run rosplc.yaml  —  carry the topics of a configuration

rosplc show /cmd_vel  —  what stands in a topic's shared memory now

rosplc status  —  every channel on this machine, and whether anything is wrong

rosplc web  —  all channels in a browser, live

rosplc record -o shift.mcap  —  what all channels carry, for Foxglove, PlotJuggler and `ros2 bag`

rosplc top  —  the same live in the terminal, with the values of each message

rosplc replay shift.mcap --to plc  —  a PLC program, tested with yesterday's line

rosplc service install cell1  —  start /etc/rosplc/cell1.yaml with the machine

rosplc doctor rosplc.yaml  —  what is wrong on this machine, and what to do about it

rosplc bench  —  Modbus, OPC UA and shared memory compared on this machine
"""

app = typer.Typer(
    help="Carry ROS topics to and from a soft-PLC (CODESYS) on this machine, through shared memory.",
    epilog=_EXAMPLES,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

for _name, _verb in (
    ("init", init),
    ("run", run),
    ("record", record),
    ("replay", replay),
    ("service", service),
    ("check", check),
    ("show", show),
    ("status", status),
    ("top", top),
    ("web", web),
    ("types", types),
    ("generate", generate),
    ("demo", demo),
    ("bench", bench),
    ("doctor", doctor),
):
    app.command(_name, epilog=_verb.EPILOG, cls=RosCommand if _verb is run else None)(_verb.command)


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


@app.command("version")
def _version() -> None:
    """Print the version of rosplc and of the shared-memory format."""
    typer.echo(f"rosplc {__version__}, shared-memory format 1.0")
