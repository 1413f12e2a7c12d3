"""What the verbs that watch channels have in common: their options, and the watch itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rosplc.monitor import Watch

__all__ = ["Configs", "Directory", "Prefix", "StaleAfter", "open_watch"]

Prefix = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Only the bridge with this `prefix:`; every bridge without."),
]
Configs = Annotated[
    list[Path] | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="A configuration, several times if need be: its `stale_after:` and classic topics count, and "
        "a topic that has no channel is missing.",
    ),
]
StaleAfter = Annotated[
    str,
    typer.Option(
        metavar="DURATION",
        help="What is stale towards the PLC where no configuration says it, such as 500ms, or `never`.",
    ),
]
Directory = Annotated[str, typer.Option(help="Where the objects stand.", hidden=True)]


def open_watch(prefix: str | None, configs: list[Path] | None, stale_after: str, directory: str) -> Watch:
    """Return a watch over the channels that the options ask for.

    Raises:
        BadParameter: ``stale_after`` is no duration.
        ConfigErrors: A configuration is wrong.
        ChannelError: SHM118 if the prefix is not valid.
    """
    from dataclasses import replace

    from rosplc.bridge.quantities import parse_stale
    from rosplc.expected import expected_by
    from rosplc.monitor import Watch

    try:
        limit = parse_stale(stale_after)
    except ValueError as error:
        raise typer.BadParameter(f"{error}, or never", param_hint="--stale-after") from None
    expected = replace(expected_by(configs or ()), stale_after_ns=limit)
    return Watch(prefix, directory=directory, expected=expected)
