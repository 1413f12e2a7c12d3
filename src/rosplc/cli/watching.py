"""What the verbs that watch channels have in common: their options, and the watch itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rosplc.monitor import Watch

__all__ = ["Configs", "Directory", "Prefix", "StaleAfter", "nothing_there", "open_watch"]

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
_NAMED = 4
Directory = Annotated[str, typer.Option(help="Where the objects stand.", hidden=True)]


def nothing_there(prefix: str | None, directory: str) -> str:
    """Return what to say where there are no channels, or none of the prefix that was asked for.

    Raises:
        ChannelError: SHM123 if the directory cannot be listed.
    """
    from rosplc.monitor import find_objects

    others = sorted({state.prefix for state in find_objects(directory, seconds=0.0)}) if prefix else []
    if not others:
        return "There are no channels on this machine. Start a bridge (rosplc run) or the demo (rosplc demo)."
    named = ", ".join(others[:_NAMED]) + (f" and {len(others) - _NAMED} more" if len(others) > _NAMED else "")
    return f"There is no channel of prefix {prefix} on this machine; there are channels of prefix {named}."


def open_watch(prefix: str | None, configs: list[Path] | None, stale_after: str, directory: str) -> Watch:
    """Return a watch over the channels that the options ask for.

    Raises:
        BadParameter: ``stale_after`` is no duration.
        ConfigErrors: A configuration is wrong.
        ChannelError: SHM118 if the prefix is not valid.
    """
    from dataclasses import replace

    from rosplc.config.quantities import parse_stale
    from rosplc.monitor import Watch
    from rosplc.monitor.expected import expected_by

    try:
        limit = parse_stale(stale_after)
    except ValueError as error:
        raise typer.BadParameter(f"{error}, or never", param_hint="--stale-after") from None
    expected = replace(expected_by(configs or ()), stale_after_ns=limit)
    return Watch(prefix, directory=directory, expected=expected)
