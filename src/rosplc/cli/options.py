"""What several verbs are given: a configuration, quantities, what to watch; and what they need installed."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rosplc.errors import ConfigError, SetupError
from rosplc.harmless import listed
from rosplc.shm import Namespace

if TYPE_CHECKING:
    from rosplc.monitor import Picture, Watch

_DEFAULT = Path("rosplc.yaml")
_LOOK_S = 0.1

ConfigFile = Annotated[
    Path | None, typer.Argument(help="The configuration file; by default `./rosplc.yaml`.")
]
Directory = Annotated[str, typer.Option(help="The folder that contains the objects.", hidden=True)]
Prefix = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Show only the bridge with this `prefix:`; do not read rosplc.yaml."),
]
Configs = Annotated[
    list[Path] | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="Show only the bridge of this configuration, apply its `stale_after:`, and include its classic "
        "topics and topics without a channel. May be repeated. By default `./rosplc.yaml`, else every "
        "bridge on this machine.",
    ),
]
StaleAfter = Annotated[
    str,
    typer.Option(
        metavar="DURATION",
        help="Without a configuration: age at which messages to the PLC become stale, or `never`.",
    ),
]


def default_config() -> Path | None:
    """Return ./rosplc.yaml if there is one."""
    return _DEFAULT if _DEFAULT.is_file() else None


def observed_config(given: Path | None, prefix: str | None) -> Path | None:
    """Return the configuration of a verb that only looks: ./rosplc.yaml unless one or a prefix is given."""
    return given or (default_config() if prefix is None else None)


def bridge_namespace(prefix: str | None, directory: str, config: Path | None = None) -> Namespace:
    """Return the names of a bridge's objects: of ``prefix``, else of the configuration, else of `rosplc`."""
    if prefix is None and (file := config or default_config()) is not None:
        from rosplc.config.file import read_config

        settings = read_config(file).settings
        return Namespace(settings.prefix, settings.shm.directory)
    return Namespace(prefix or "rosplc", directory)


def config_file(given: Path | None) -> Path:
    """Return the configuration to use: what was given, else ./rosplc.yaml; CFG001 if there is neither."""
    if given is None and default_config() is None:
        raise ConfigError(
            "CFG001",
            "no configuration file was given, and this folder contains no rosplc.yaml",
            where=str(Path.cwd()),
            remedy="Specify the file, or create one with `rosplc init`.",
        )
    return given or _DEFAULT


def parsed(parse: Callable[[str], Any], text: str, option: str, more: str = "") -> Any:
    """Return an option's value; a ValueError of ``parse`` is a wrong command line."""
    try:
        return parse(text)
    except ValueError as error:
        raise typer.BadParameter(f"{error}{more}", param_hint=option) from None


def duration(text: str | None, option: str) -> int:
    """Return an option's duration in ns; 0 if it was not given."""
    from rosplc.config.quantities import parse_duration

    return 0 if text is None else int(parsed(parse_duration, text, option))


def size(text: str | None, option: str) -> int:
    """Return an option's bytes; 0 if it was not given."""
    from rosplc.config.quantities import parse_size

    return 0 if text is None else int(parsed(parse_size, text, option))


def need_extra(package: str, extra: str, verb: str) -> None:
    """Raise SYS001 with the pip command unless a package, which an extra of rosplc brings, is installed."""
    if importlib.util.find_spec(package) is None:
        what = f"rosplc {verb} needs the Python package {package}, which is not installed"
        raise SetupError("SYS001", what, remedy=f"pip install 'rosplc[{extra}]'")


def nothing_there(prefixes: Collection[str], directory: str) -> str:
    """Return what to print where there are no channels, or none of the prefixes that were asked for.

    Raises ChannelError SHM123 if the directory cannot be listed.
    """
    from rosplc.monitor import find_objects

    others = sorted({state.prefix for state in find_objects(directory, seconds=0.0)}) if prefixes else []
    if not others:
        return "There are no channels on this machine. Start a bridge (rosplc run) or the demo (rosplc demo)."
    asked = ", ".join(sorted(prefixes))
    there = f"existing prefixes: {listed(others)}"
    return f"There is no channel with the prefix {asked} on this machine; {there}."


def open_watch(prefix: str | None, configs: list[Path] | None, stale_after: str, directory: str) -> Watch:
    """Return a watch over the channels that the options, or else ./rosplc.yaml, ask for.

    Raises BadParameter, ``stale_after`` is no duration; ConfigErrors; ChannelError SHM118, the prefix is not
    valid.
    """
    from rosplc.config.quantities import parse_stale
    from rosplc.monitor import Watch
    from rosplc.monitor.classic import expected_by

    limit = parsed(parse_stale, stale_after, "--stale-after", ", or never")
    default = observed_config(None, prefix)
    expected = replace(expected_by(configs or ([default] if default else [])), stale_after_ns=limit)
    return Watch(prefix or expected.prefixes or None, directory=directory, expected=expected, calls=True)


def settled(watch: Watch, least: float, most: float) -> Picture:
    """Look until it is known of every side whether it is alive: at least and at most so many seconds.

    Raises ChannelError SHM123 if the directory cannot be listed.
    """
    from rosplc.monitor import State

    began = time.monotonic()
    while True:
        picture = watch.look()
        passed = time.monotonic() - began
        looking = any(
            view.state is State.UNKNOWN
            or (view.state is State.NO_PLC and view.bridge_alive is None)  # the missing PLC is known first
            or None in [each.alive for each in view.readers]
            for view in picture.channels
        )
        if not picture.channels or passed > most or (passed > least and not looking):
            return picture
        time.sleep(_LOOK_S)
