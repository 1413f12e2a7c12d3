"""``rosplc bench``: names the distribution that the comparison moved to."""

from __future__ import annotations

from typing import Annotated

import typer

from rosplc.cli.guard import EXIT_CONFIG, guarded
from rosplc.cli.text import warn

__all__ = ["EPILOG", "command"]

EPILOG = """Examples:

pip install 'rosplc[bench]'  —  install the comparison

rosplc-bench --quick  —  a first look in half a minute
"""


@guarded
def command(
    arguments: Annotated[
        list[str] | None, typer.Argument(hidden=True, help="What rosplc-bench takes.")
    ] = None,
) -> None:
    """The comparison with Modbus and OPC UA is now the command rosplc-bench."""
    warn(
        "The comparison is now a command of its own, with the same options: rosplc-bench\n"
        "  to install it: pip install 'rosplc[bench]'"
    )
    raise typer.Exit(EXIT_CONFIG)
