"""The command's frame: its verbs, in the groups in which --help lists them."""

from __future__ import annotations

import importlib
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from rosplc._version import FORMAT, __version__

_EXAMPLES = """Examples:

rosplc demo  —  see it work without a robot or a PLC

rosplc init  —  write rosplc.yaml from a running robot

rosplc check  —  explain rosplc.yaml

rosplc generate --out plc  —  write the PLC code

rosplc run  —  run the bridge

rosplc status  —  print all channels on this machine and any problems

rosplc doctor  —  find problems with the machine and the configuration, and suggest fixes

`rosplc VERB --help` explains a verb, and `rosplc explain CODE` explains an error.
"""
# What --help says of each is here once more: the list imports no verb, and a verb no other.
_VERBS = """\
Set up
  demo: Demonstrate how ROS topics reach a virtual PLC and its commands come back.
  init: Examine a robot or a recording, and write a commented configuration.
  check: Check and explain a configuration: entries, directions, settings, and access to shared memory.
  generate: Write the PLC code: Structured Text, PLCopenXML, an import script for CODESYS, and a C header.
  types: List the known message, service and action types, or show the fields and sizes of one type.

Run
  run: Run the bridge in the foreground; logs go to stderr.
  reload: Apply a changed configuration to a running bridge, without stopping it.
  service: Run a bridge as a systemd service: install it, remove it, or show its status.
  release: Free the claim of a dead writer, so that another program can write to the channel.
  clean: Remove a prefix's unused objects: channels, locks and temporary files that no bridge uses.

Watch
  status: Print a table of all channels on this machine, and any problems.
  show: Show the message in a topic's shared memory, or list all channels on this machine.
  top: Watch all channels on this machine in the terminal: rates, ages, losses, values, connected programs.
  web: Show this machine's channels in a browser, live, until Ctrl-C.
  record: Record channels to MCAP files, which Foxglove, PlotJuggler and `ros2 bag` can read.
  replay: Replay a recording into channels or onto ROS topics, with the recorded order and timing.

ROS
  list: List the topics, services or actions in the ROS graph.
  echo: Print the messages of a ROS topic.
  hz: Print the message rate of a ROS topic every second.
  pub: Publish messages on a ROS topic.

Diagnose
  doctor: Examine this machine, a configuration and running bridges, and suggest fixes.
  explain: Explain what an error code means and what to do about it.
  bench: The comparison with Modbus and OPC UA is now the command rosplc-bench.
"""

app = typer.Typer(
    help="Carry ROS topics to and from a soft-PLC (CODESYS) on this machine, through shared memory.",
    epilog=_EXAMPLES,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


class _Listed(TyperCommand):
    """A verb as --help lists it; its module is imported when it is used."""

    def make_context(self, info_name: str | None, args: list[str], *more: Any, **extra: Any) -> Any:
        """Return the context of the verb itself."""
        verb: Any = self.name
        if verb in ("list", "echo", "hz", "pub"):
            module: Any = getattr(importlib.import_module("rosplc.cli.ros"), verb.upper())
        else:
            module = importlib.import_module(f"rosplc.cli.{verb}")
        alone = typer.Typer(add_completion=False, rich_markup_mode="markdown")
        alone.command(
            verb,
            epilog="Examples:\n\n" + (module.__doc__ or "").partition("\n\n")[2],
            cls=module.RosCommand if verb == "run" else None,
            context_settings={"ignore_unknown_options": True} if verb == "bench" else None,
        )(module.command)
        return typer.main.get_command(alone).make_context(info_name, args, *more, **extra)


for _block in _VERBS.split("\n\n"):
    _group, *_lines = _block.splitlines()
    for _name, _summary in (line.strip().split(": ", 1) for line in _lines):
        app.command(_name, help=_summary, rich_help_panel=_group, cls=_Listed)(lambda: None)


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
