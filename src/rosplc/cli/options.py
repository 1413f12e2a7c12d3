"""Options that several verbs have, declared once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rosplc.errors import ConfigError

__all__ = ["AsJson", "ConfigFile", "Directory", "config_file", "default_config", "observed_config"]

_DEFAULT = Path("rosplc.yaml")

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
ConfigFile = Annotated[
    Path | None, typer.Argument(help="The configuration file; rosplc.yaml in this folder by default.")
]
Directory = Annotated[str, typer.Option(help="Where the objects are.", hidden=True)]


def default_config() -> Path | None:
    """Return ./rosplc.yaml if there is one."""
    return _DEFAULT if _DEFAULT.is_file() else None


def observed_config(given: Path | None, prefix: str | None) -> Path | None:
    """Return the configuration of a verb that only looks: ./rosplc.yaml unless one or a prefix is given."""
    return given or (default_config() if prefix is None else None)


def config_file(given: Path | None) -> Path:
    """Return the configuration to use: what was given, else ./rosplc.yaml.

    Raises:
        ConfigError: CFG001, none was given and there is no rosplc.yaml here.
    """
    if given is None and default_config() is None:
        raise ConfigError(
            "CFG001",
            "no configuration was named, and this folder has no rosplc.yaml",
            where=str(Path.cwd()),
            remedy="Name the file, or write one with `rosplc init`.",
        )
    return given or _DEFAULT
