"""``rosplc generate``: the PLC half of a configuration, ready for CODESYS."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rosplc.cli.guard import guarded, print_json
from rosplc.cli.text import say

if TYPE_CHECKING:
    from rosplc.layout import Layout
    from rosplc.plc.build import ProjectOptions
    from rosplc.plc.project import PlcProject

__all__ = ["EPILOG", "command"]

EPILOG = """Examples:

rosplc generate rosplc.yaml --out plc  —  types, blocks, variable lists, programs, tasks of a configuration

rosplc generate --all-types jazzy --out plc  —  both blocks of every message type of a distribution

In CODESYS: Tools > Scripting > Execute Script File, and choose plc/rosplc_import.py.
"""

_TARGETS = ("x86", "arm")


@guarded
def command(
    config: Annotated[
        Path | None, typer.Argument(help="The configuration file, such as rosplc.yaml.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FOLDER", help="The folder to write.")] = Path(
        "plc"
    ),
    all_types: Annotated[
        str | None,
        typer.Option("--all-types", metavar="DISTRO", help="Every type of a ROS distribution, no topics."),
    ] = None,
    target: Annotated[
        str,
        typer.Option(
            metavar="PROCESSOR",
            help="Processor of the PLC: x86, or arm. On arm messages take longer, because no memory "
            "fence is proven there; see --fences.",
        ),
    ] = "x86",
    fences: Annotated[
        bool,
        typer.Option(
            "--fences", help="With --target arm: the device enables the MemoryBarrier library; trust it."
        ),
    ] = False,
    pins: Annotated[
        bool,
        typer.Option("--pins", help="Give blocks a pin per top-level field, for Ladder and Function Blocks."),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files that somebody edited.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Write the PLC half: Structured Text, PLCopenXML, an import script for CODESYS, a C header."""
    from rosplc.plc.build import ProjectOptions
    from rosplc.plc.delivery import project_files, write_files

    if (config is None) == (all_types is None):
        raise typer.BadParameter("name a configuration file, or ask for --all-types", param_hint="CONFIG")
    if target not in _TARGETS:
        raise typer.BadParameter(f"there are: {', '.join(_TARGETS)}", param_hint="--target")
    options = ProjectOptions(fenced=target == "x86" or fences, pins=pins)
    if config is not None:
        project, layouts = _from_config(config, options)
    else:
        project, layouts = _from_distro(str(all_types), options)
    delivery = write_files(out, project_files(project, layouts, "rosplc"), force=force)
    facts: dict[str, Any] = {
        "folder": str(out),
        "written": list(delivery.written),
        "unchanged": list(delivery.unchanged),
        "removed": list(delivery.removed),
        "notes": list(project.notes),
    }
    if as_json:
        print_json(facts)
        return
    say(
        f"{out}: {len(delivery.written)} files written, {len(delivery.unchanged)} unchanged, "
        f"{len(delivery.removed)} removed"
    )
    for note in project.notes:
        say(f"note: {note}")
    say(f"In CODESYS: Tools > Scripting > Execute Script File, and choose {out / 'rosplc_import.py'}")


def _from_config(config: Path, options: ProjectOptions) -> tuple[PlcProject, list[Layout]]:
    from rosplc.config.resolve import load_project
    from rosplc.plc.from_config import plc_project

    project = load_project(config)
    topics = sorted(project.topics, key=lambda plan: plan.topic)  # as the PLC's objects are ordered
    return plc_project(project, options), [plan.layout for plan in topics]


def _from_distro(distro: str, options: ProjectOptions) -> tuple[PlcProject, list[Layout]]:
    from rosplc.layout import compute_layout
    from rosplc.model import TypeStore
    from rosplc.plc.build import build_type_library

    store = TypeStore.bundled(distro)
    layouts = [compute_layout(store, name) for name in store.names()]
    return build_type_library(store, layouts, options), layouts
