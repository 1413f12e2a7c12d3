"""``rosplc generate``: the PLC half of a configuration, ready for CODESYS.

rosplc generate rosplc.yaml --out plc  —  the PLC code for this configuration

rosplc generate --all-types jazzy --out plc  —  the read and write blocks for all message types of jazzy

In CODESYS, run plc/rosplc_import.py with Tools > Scripting > Execute Script File.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Literal

import typer

from rosplc.cli.options import ConfigFile, config_file
from rosplc.cli.text import print_json, say
from rosplc.cli.verb import verb
from rosplc.harmless import plural
from rosplc.project import generate, generate_types


@verb
def command(
    config: ConfigFile = None,
    *,
    out: Path = Path("plc"),
    all_types: str | None = None,
    plc: Literal["codesys", "openplc", "matiec"] = "codesys",
    target: Literal["x86", "arm"] | None = None,
    fences: bool = False,
    programs: str | None = None,
    pins: bool = False,
    force: bool = False,
    as_json: bool = False,
) -> None:
    """Write the PLC code: Structured Text, PLCopenXML, an import script for CODESYS, and a C header.

    Options:
        out FOLDER: The output folder.
        all_types DISTRO: Write blocks for every message type of a ROS distribution, without topics.
        plc PLC: codesys; openplc (OpenPLC Runtime 4.1 with STruC++); or matiec (OpenPLC v3 and Beremiz).
            --target, --fences, --programs and --pins affect only codesys.
        target PROCESSOR: The PLC's processor: x86 or arm; by default this machine's. On arm, messages
            arrive one scan later, unless --fences provides a memory fence.
        fences: With --target arm: confirm that the device enables the MemoryBarrier library. The blocks
            use the library if the project contains it.
        programs NAME: Prefix of the generated programs' names; by default the
            configuration's `programs`, else SharedMemory.
        pins: Give blocks a pin for each top-level field, for Ladder and Function Block Diagram.
        force: Overwrite files that were edited.
    """
    if config is not None and all_types is not None:
        raise typer.BadParameter("use a configuration file or --all-types, not both", param_hint="CONFIG")
    options: dict[str, Any] = {"plc": plc, "target": target, "fences": fences, "pins": pins, "force": force}
    if all_types is None:
        delivery = generate(config_file(config), out, programs=programs, **options)
    else:
        delivery = generate_types(all_types, out, programs=programs or "SharedMemory", **options)
    if as_json:
        print_json({"folder": str(out), **dataclasses.asdict(delivery)})
        return
    say(
        f"{out}: {plural(len(delivery.written), 'file')} written, {len(delivery.unchanged)} unchanged, "
        f"{len(delivery.removed)} removed"
    )
    for note in delivery.notes:
        say(f"note: {note}")
    if plc != "codesys":
        say(f"For the next steps, read {out / 'README.txt'}")
        return
    say(f"In CODESYS, run {out / 'rosplc_import.py'} with Tools > Scripting > Execute Script File")
