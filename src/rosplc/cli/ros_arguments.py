"""A command whose line may hold ROS arguments among its own, as launch files write them."""

from __future__ import annotations

import typer
from typer.core import TyperCommand

__all__ = ["RosCommand", "given_to"]

_KEY = "rosplc.ros_arguments"


class RosCommand(TyperCommand):
    """Puts ROS arguments aside before the others are parsed; :func:`given_to` returns them."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Parse what is left without ROS's arguments."""
        from rosplc.ros.arguments import split_arguments

        ctx.meta[_KEY], own = split_arguments(args)
        return super().parse_args(ctx, own)


def given_to(context: typer.Context) -> list[str]:
    """Return the ROS arguments of a command line, in their order."""
    found: list[str] = context.meta.get(_KEY, [])
    return found
