"""Write docs/reference/cli.md from the command's own help; ``--verify`` only compares."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from typer.main import get_command

from generated_page import REFERENCE, filled, run
from rosplc.cli.app import app

PAGE = REFERENCE / "cli.md"


def parts() -> dict[str, str]:
    """Return the page's generated part."""
    group: Any = get_command(app)
    verbs = [(name, opened(name, listed)) for name, listed in group.commands.items()]
    return {"verbs": "\n".join("\n".join(section(name, command)) for name, command in verbs)}


def opened(name: str, listed: Any) -> Any:
    """Return a verb's command with everything that belongs to it; its module is imported now."""
    return listed.make_context(name, [], resilient_parsing=True).command


def section(name: str, command: Any) -> Iterator[str]:
    """Yield the lines about one verb."""
    arguments = [each for each in command.params if each.param_type_name == "argument"]
    options = [each for each in command.params if each.param_type_name == "option" and not each.hidden]
    usage = " ".join(written(each) for each in arguments) if arguments else ""
    yield f"## rosplc {name}\n"
    yield f"`{' '.join(f'rosplc {name} {usage}'.split())}`\n"
    yield command.help.strip() + "\n"
    rows = [(f"`{written(each)}`", each.help or "", "") for each in arguments]
    rows += [(spelling(each), each.help or "", default(each)) for each in options]
    if rows:
        yield "| | | default |\n| --- | --- | --- |"
        for row in rows:
            yield "| " + " | ".join(row) + " |"
        yield ""
    for paragraph in (command.epilog or "").strip().split("\n\n"):
        example, dash, meaning = paragraph.partition("  —  ")
        if example.startswith("rosplc "):
            yield f"* `{example}`{': ' + meaning if dash else ''}"
        elif paragraph and paragraph != "Examples:":
            yield "\n" + paragraph
    if command.epilog:
        yield ""


def written(argument: Any) -> str:
    """Return an argument as the usage line has it; an optional one in brackets."""
    name = (argument.metavar or argument.name.upper()).strip("[]")
    return name if argument.required else f"[{name}]"


def spelling(option: Any) -> str:
    """Return an option as it is written."""
    names = ", ".join(f"`{each}`" for each in sorted(option.opts, key=len, reverse=True))
    if option.is_flag:
        return names
    return f"{names} `{option.metavar or 'VALUE'}`"


def default(option: Any) -> str:
    """Return an option's default as text."""
    if option.is_flag or option.default in (None, (), []) or callable(option.default):
        return ""
    return f"`{option.default}`"


if __name__ == "__main__":
    raise SystemExit(run(__doc__, {PAGE: filled(PAGE, parts())}))
