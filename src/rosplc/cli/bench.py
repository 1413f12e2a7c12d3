"""``rosplc bench``: names the distribution that the comparison moved to.

pip install 'rosplc[bench]'  —  install the comparison

rosplc-bench --quick  —  run a short comparison in half a minute
"""

from __future__ import annotations

from typing import Annotated

import typer

from rosplc.cli.text import warn
from rosplc.cli.verb import EXIT_CONFIG, verb


@verb
def command(
    *,
    arguments: Annotated[
        list[str] | None, typer.Argument(hidden=True, help="The options of rosplc-bench.")
    ] = None,
) -> None:
    """The comparison with Modbus and OPC UA is now the command rosplc-bench."""
    from rosplc.doctor.machine import pip_here

    warn(
        "The comparison is now a separate command, rosplc-bench, with the same options.\n"
        + pip_here("  To install it: pip install 'rosplc[bench]'")
    )
    raise typer.Exit(EXIT_CONFIG)
