"""What the verbs that watch channels have in common: their options, and the watch itself."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rosplc.cli.options import observed_config
from rosplc.clock import SYSTEM, Clock

if TYPE_CHECKING:
    from rosplc.monitor import Picture, Watch

__all__ = ["Configs", "Directory", "Prefix", "StaleAfter", "nothing_there", "open_watch", "settled"]

Prefix = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Only the bridge with this `prefix:`; rosplc.yaml is not read then.",
    ),
]
Configs = Annotated[
    list[Path] | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="A configuration: its bridge only, judged by its `stale_after:`, with its classic topics and "
        "those that have no channel. May be repeated. By default rosplc.yaml in this folder, else every "
        "bridge of the machine.",
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
_LOOK_NS = 100_000_000
Directory = Annotated[str, typer.Option(help="Where the objects stand.", hidden=True)]


def nothing_there(prefixes: Collection[str], directory: str) -> str:
    """Return what to say where there are no channels, or none of the prefixes that were asked for.

    Raises:
        ChannelError: SHM123 if the directory cannot be listed.
    """
    from rosplc.monitor import find_objects

    others = sorted({state.prefix for state in find_objects(directory, seconds=0.0)}) if prefixes else []
    if not others:
        return "There are no channels on this machine. Start a bridge (rosplc run) or the demo (rosplc demo)."
    named = ", ".join(others[:_NAMED]) + (f" and {len(others) - _NAMED} more" if len(others) > _NAMED else "")
    asked = ", ".join(sorted(prefixes))
    return f"There is no channel of prefix {asked} on this machine; there are channels of prefix {named}."


def open_watch(prefix: str | None, configs: list[Path] | None, stale_after: str, directory: str) -> Watch:
    """Return a watch over the channels that the options, or else ./rosplc.yaml, ask for.

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
    default = observed_config(None, prefix)
    files = configs or ([] if default is None else [default])
    expected = replace(expected_by(files), stale_after_ns=limit)
    return Watch(prefix or expected.prefixes or None, directory=directory, expected=expected)


def settled(watch: Watch, least: float, most: float, clock: Clock = SYSTEM) -> Picture:
    """Look until it is known of every side whether it is alive.

    Args:
        watch: What to look with.
        least: How long to look at least, in seconds: for rates.
        most: How long to look at most, in seconds.
        clock: By which it is waited.

    Raises:
        ChannelError: SHM123 if the directory cannot be listed.
    """
    from rosplc.monitor import State

    began = clock.monotonic_ns()
    while True:
        picture = watch.look()
        passed = (clock.monotonic_ns() - began) / 1e9
        looking = any(
            view.state is State.UNKNOWN or None in [each.alive for each in view.readers]
            for view in picture.channels
        )
        if not picture.channels or passed > most or (passed > least and not looking):
            return picture
        clock.sleep(_LOOK_NS)
