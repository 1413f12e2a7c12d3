"""A report's files: report.json, report.md and the figures."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path

from rosplc.bench import draw, markdown
from rosplc.bench.results import Report
from rosplc.bench.section import Section, render
from rosplc.errors import SetupError

__all__ = ["prepare", "write"]


def prepare(folder: Path) -> None:
    """Make a report's folder, before anything is measured in vain.

    Raises:
        SetupError: SYS005, it cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # What a file system really allows shows only when something is written.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise SetupError("SYS005", f"cannot write: {error.strerror}", where=str(folder)) from error


def write(report: Report, sections: Mapping[str, Section], folder: Path) -> list[Path]:
    """Write the report into a folder, which is made if it is not there; return the files.

    Figures are left out where matplotlib is missing, and the page then shows none.

    Raises:
        SetupError: SYS005, the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        written = [folder / "report.json", folder / "report.md"]
        written[0].write_text(json.dumps(report.to_dict(), indent=1) + "\n", encoding="utf-8")
        written[1].write_text(markdown.text(report, sections, figures=draw.available()), encoding="utf-8")
        if draw.available():
            for page in render(report, sections).values():
                for figure in page.figures:
                    written += draw.draw(figure, folder)
    except OSError as error:
        raise SetupError("SYS005", f"cannot write: {error.strerror}", where=str(folder)) from error
    return written
