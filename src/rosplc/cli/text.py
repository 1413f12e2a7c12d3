"""Plain-text output that reads well in a terminal, a pipe and a log: aligned columns, no colours."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import typer

from rosplc.harmless import harmless

__all__ = ["columns", "harmless", "in_bytes", "say", "warn"]


def say(text: str = "") -> None:
    """Print text on stdout, made harmless."""
    typer.echo(harmless(text))


def warn(text: str) -> None:
    """Print text on stderr, made harmless."""
    typer.echo(harmless(text), err=True)


def columns(rows: Iterable[Sequence[object]], *, header: Sequence[str] = (), indent: int = 0) -> list[str]:
    """Return rows as aligned lines; numbers stand to the right, the last column is not padded."""
    table = [[str(cell) for cell in row] for row in rows]
    if not table:
        return []
    numeric = [all(_is_number(row[column]) for row in table) for column in range(len(table[0]))]
    if header:
        table.insert(0, list(header))
    widths = [max(len(row[column]) for row in table) for column in range(len(table[0]))]
    lines = []
    for row in table:
        cells = [
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(row, widths, numeric, strict=True)
        ]
        lines.append((" " * indent + "  ".join(cells)).rstrip())
    return lines


def _is_number(text: str) -> bool:
    return text.replace(".", "", 1).isdigit()


def in_bytes(count: int) -> str:
    """Return a number of bytes with a fitting unit, as people read it."""
    size = float(count)
    for unit in ("bytes", "KiB", "MiB"):
        if size < 1024 or unit == "MiB":
            return f"{count} bytes" if unit == "bytes" else f"{size:.1f} {unit}"
        size /= 1024
    raise AssertionError  # the loop returns
