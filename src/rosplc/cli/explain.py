"""``rosplc explain``: what a code of an error or a finding means, and what to do.

rosplc explain SHM112  —  an error from a command or a log

rosplc explain 112  —  the same error, as a PLC block reports it in `udiError`

rosplc explain DOC603  —  a finding of `rosplc doctor`

rosplc explain  —  list every code, one per line
"""

from __future__ import annotations

import re

import typer

from rosplc.cli.text import print_json, say, table
from rosplc.cli.verb import verb
from rosplc.doctor import KINDS
from rosplc.errors import CODES
from rosplc.harmless import nearest


@verb
def command(code: str | None = None, /, *, as_json: bool = False) -> None:
    """Explain what an error code means and what to do about it.

    Options:
        code: A code such as SHM112 or DOC603, or an error number from a PLC block.
    """
    known = _known()
    if code is None:
        if as_json:
            print_json(list(known.values()))
        else:
            table((entry["code"], entry["title"]) for entry in known.values())
        return
    wanted = f"SHM{code}" if re.fullmatch(r"\d{3}", code) else code.upper()
    if wanted not in known:
        near = nearest(wanted, known)
        hint = f"; did you mean {near}?" if near else "; `rosplc explain` lists all codes"
        raise typer.BadParameter(f"unknown code {code!r}{hint}", param_hint="CODE")
    entry = known[wanted]
    if as_json:
        print_json(entry)
        return
    say(f"{entry['code']}: {entry['title']}")
    if entry["meaning"]:
        say(f"  meaning: {entry['meaning']}")
    say(f"  remedy:  {entry['remedy']}")


def _known() -> dict[str, dict[str, str]]:
    """Return code → what is known of it, of errors and findings."""
    keys = ("title", "meaning", "remedy")
    return {
        code: {"code": code, **{key: getattr(entry, key, "") for key in keys}}
        for code, entry in [*CODES.items(), *KINDS.items()]
    }
