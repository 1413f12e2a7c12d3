"""Write the manual pages and the shells' completions below FOLDER/usr/share, from the command's own help."""

from __future__ import annotations

import gzip
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer.main import get_command

from generate_cli_reference import default, opened, written
from rosplc.cli.app import app

# Zsh reads its file when it first completes, so the file has to complete as well as define.
COMPLETIONS = {
    "bash": ("bash-completion/completions/rosplc", ""),
    "zsh": ("zsh/vendor-completions/_rosplc", '_rosplc_completion "$@"\n'),
}


def troff(text: str) -> str:
    """Return Markdown of one paragraph as troff: `code` bold, and nothing taken for a request."""
    text = re.sub(r"\s+", " ", text).strip().replace("\\", r"\e").replace("-", r"\-")
    text = re.sub(r"`([^`]+)`", r"\\fB\1\\fR", text)
    return r"\&" + text if text.startswith((".", "'")) else text


def page(name: str, command: Any, version: str) -> Iterator[str]:
    """Yield the lines of the manual page of `rosplc`, or of one verb."""
    summary, _, more = (command.help or "").strip().partition("\n\n")
    verbs = getattr(command, "commands", {})
    arguments = [each for each in command.params if each.param_type_name == "argument"]
    options = [each for each in command.params if each.param_type_name == "option" and not each.hidden]
    usage = "VERB" if verbs else " ".join(written(each) for each in arguments)
    yield f'.TH {name.replace(" ", "-").upper()} 1 "" "rosplc {version}"'
    yield f".SH NAME\n{troff(name.replace(' ', '-'))} \\- {troff(summary.rstrip('.'))}"
    yield f".SH SYNOPSIS\n{troff(f'`{name}` [OPTIONS] {usage}')}"
    if more:
        yield ".SH DESCRIPTION"
        yield from (f".PP\n{troff(each)}" for each in more.split("\n\n"))
    rows = [(written(each), each) for each in arguments]
    rows += [(", ".join(each.opts) + ("" if each.is_flag else f" {each.metavar or 'VALUE'}"), each)
             for each in options]  # fmt: skip
    if rows:
        yield ".SH OPTIONS"
    for spelled, each in rows:
        preset = default(each) if each in options else ""
        meaning = (each.help or "") + (f" Default: {preset}." if preset else "")
        yield f".TP\n{troff(f'`{spelled}`')}\n{troff(meaning)}"
    if verbs:
        yield ".SH VERBS"
        yield from (
            f".TP\n{troff(f'`rosplc-{verb}`(1)')}\n{troff(each.help.partition(chr(10) * 2)[0])}"
            for verb, each in verbs.items()
        )
    if command.epilog:
        yield ".SH EXAMPLES"
    for paragraph in (command.epilog or "").strip().split("\n\n"):
        example, dash, meaning = paragraph.partition("  —  ")
        if dash:
            yield f".TP\n{troff(f'`{example}`')}\n{troff(meaning)}"
        elif paragraph and paragraph != "Examples:":
            yield f".PP\n{troff(paragraph)}"
    yield ".SH SEE ALSO\nThe pages in \\fI/usr/share/doc/rosplc\\fR." + (
        "" if verbs else " \\fBrosplc\\fR(1)"
    )


def main(folder: Path, version: str) -> None:
    """Write every file."""
    share, group = folder / "usr/share", get_command(app)
    texts = {"man/man1/rosplc.1": page("rosplc", group, version)}
    for verb, command in getattr(group, "commands", {}).items():
        texts[f"man/man1/rosplc-{verb}.1"] = page(f"rosplc {verb}", opened(verb, command), version)
    files = {
        f"{path}.gz": gzip.compress(("\n".join(text) + "\n").encode(), mtime=0)
        for path, text in texts.items()
    }
    for shell, (path, last) in COMPLETIONS.items():
        environment = {**os.environ, "_ROSPLC_COMPLETE": f"source_{shell}"}
        script = subprocess.check_output([sys.executable, "-m", "rosplc"], env=environment, text=True)
        files[path] = f"{script.strip()}\n{last}".encode()
    for path, content in files.items():
        (share / path).parent.mkdir(parents=True, exist_ok=True)
        (share / path).write_bytes(content)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
