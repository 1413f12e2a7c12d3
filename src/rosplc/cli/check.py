"""``rosplc check``: what a configuration means, in plain words, before anything runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rosplc.cli.guard import guarded, print_json

__all__ = ["EPILOG", "command"]

EPILOG = """Examples:

rosplc check rosplc.yaml  —  explain the file, or say with line and key what is wrong in it

rosplc check rosplc.yaml --json  —  the same for programs

rosplc check --schema > rosplc.schema.json  —  for an editor that completes keys
"""


@guarded
def command(
    config: Annotated[
        Path | None, typer.Argument(help="The configuration file, such as rosplc.yaml.")
    ] = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of configuration files.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Explain a configuration in plain words: what is carried, which way, how, and who may open it."""
    if schema:
        from rosplc.config.file import json_schema

        print_json(json_schema())
        return
    if config is None:
        raise typer.BadParameter("name a configuration file, or ask for --schema", param_hint="CONFIG")
    from rosplc.cli.check_facts import facts
    from rosplc.cli.check_words import explain
    from rosplc.config.resolve import load_project

    project = load_project(config)
    if as_json:
        print_json(facts(project))
    else:
        explain(project)
