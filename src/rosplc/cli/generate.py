"""``rosplc generate``: the PLC half of a configuration, ready for CODESYS."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import typer

from rosplc.cli.guard import guarded, print_json
from rosplc.cli.options import AsJson, ConfigFile, config_file
from rosplc.cli.text import plural, say

__all__ = ["EPILOG", "command"]

EPILOG = """Examples:

rosplc generate rosplc.yaml --out plc  —  types, blocks, variable lists, programs, tasks of a configuration

rosplc generate --all-types jazzy --out plc  —  both blocks of every message type of a distribution

In CODESYS: Tools > Scripting > Execute Script File, and choose plc/rosplc_import.py.
"""


@guarded
def command(
    config: ConfigFile = None,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FOLDER", help="The folder to write.")] = Path(
        "plc"
    ),
    all_types: Annotated[
        str | None,
        typer.Option("--all-types", metavar="DISTRO", help="Every type of a ROS distribution, no topics."),
    ] = None,
    target: Annotated[
        Literal["x86", "arm"] | None,
        typer.Option(
            metavar="PROCESSOR",
            help="Processor of the PLC: x86, or arm; by default this machine's. On arm messages take a scan "
            "longer, because no memory fence is proven there; see --fences.",
        ),
    ] = None,
    fences: Annotated[
        bool,
        typer.Option(
            "--fences",
            help="With --target arm: the device enables the MemoryBarrier library; trust it where the "
            "project has it.",
        ),
    ] = False,
    programs: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="What the names of the generated programs begin with; by default the configuration's "
            "`programs`, which is SharedMemory.",
        ),
    ] = None,
    pins: Annotated[
        bool,
        typer.Option("--pins", help="Give blocks a pin per top-level field, for Ladder and Function Blocks."),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files that somebody edited.")] = False,
    as_json: AsJson = False,
) -> None:
    """Write the PLC half: Structured Text, PLCopenXML, an import script for CODESYS, a C header."""
    from rosplc.project import generate, generate_types

    if config is not None and all_types is not None:
        raise typer.BadParameter("name a configuration file or --all-types, not both", param_hint="CONFIG")
    if all_types is None:
        delivery = generate(
            config_file(config), out, target=target, fences=fences, programs=programs, pins=pins, force=force
        )
    else:
        delivery = generate_types(
            all_types,
            out,
            target=target,
            fences=fences,
            programs=programs or "SharedMemory",
            pins=pins,
            force=force,
        )
    if as_json:
        print_json({"folder": str(out), **dataclasses.asdict(delivery)})
        return
    say(
        f"{out}: {plural(len(delivery.written), 'file')} written, {len(delivery.unchanged)} unchanged, "
        f"{len(delivery.removed)} removed"
    )
    for note in delivery.notes:
        say(f"note: {note}")
    say(f"In CODESYS: Tools > Scripting > Execute Script File, and choose {out / 'rosplc_import.py'}")
