"""``rosplc run``: carry the topics of a configuration until told to stop.

rosplc run  —  carry the topics of rosplc.yaml until Ctrl-C or SIGTERM

rosplc run rosplc.yaml --status 2  —  with a status line every two seconds

rosplc run rosplc.yaml --ros-args -r __ns:=/robot1 -r /cmd_vel:=/base/cmd_vel  —  ROS arguments, as for any
ROS program; in ROS 1 `__ns:=/robot1 /cmd_vel:=/base/cmd_vel`

`rosplc reload` applies a changed file; a file with an error changes nothing. Closing the terminal stops
the bridge.

The objects in shared memory remain when the bridge stops: a running PLC keeps its last values, and the
next start reuses the objects. `rosplc clean` removes them.
"""

from __future__ import annotations

import logging
from typing import Annotated

import typer
from typer.core import TyperCommand

from rosplc.bridge.run import run_bridge
from rosplc.cli.options import ConfigFile, config_file
from rosplc.cli.verb import Between, verb
from rosplc.init.learn import load
from rosplc.ros import RosArguments
from rosplc.ros.arguments import split_arguments
from rosplc.service.supervisor import supervised

_KEY = "rosplc.ros_arguments"


class RosCommand(TyperCommand):
    """Puts ROS arguments aside before the others are parsed; :func:`given_to` returns them."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Parse what is left without ROS's arguments."""
        ctx.meta[_KEY], own = split_arguments(args)
        return super().parse_args(ctx, own)


def given_to(context: typer.Context) -> list[str]:
    """Return the ROS arguments of a command line, in their order."""
    found: list[str] = context.meta.get(_KEY, [])
    return found


@verb
def command(
    context: typer.Context,
    config: ConfigFile = None,
    *,
    status: Annotated[float, Between(0.0, 86400.0)] = 10.0,
    verbose: bool = False,
    quiet: bool = False,
) -> None:
    """Run the bridge in the foreground; logs go to stderr.

    Options:
        status SECONDS: Time between two status lines; 0 prints none.
        verbose: Also log debug messages.
        quiet: Log only warnings and errors.
    """
    arguments = RosArguments.parse(given_to(context))
    level = logging.DEBUG if verbose else logging.WARNING if quiet else logging.INFO
    if arguments.log_level is not None and not (verbose or quiet):
        level = getattr(logging, arguments.log_level.upper())  # of the same names, `warn` and `fatal` too
    run_bridge(
        config_file(config),
        status_seconds=status or None,
        level=level,
        arguments=arguments,
        supervised=supervised,
        load=load,
    )
