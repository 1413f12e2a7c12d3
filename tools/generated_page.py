"""What every generator of a reference page does in the end: write the page, or compare it."""

from __future__ import annotations

import argparse
from pathlib import Path

REFERENCE = Path(__file__).resolve().parent.parent / "docs" / "reference"


def write_or_verify(path: Path, text: str, description: str | None) -> int:
    """Write the page, or with ``--verify`` on the command line say whether it is up to date.

    Returns:
        The exit status: 1 if the page is not what was generated.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--verify", action="store_true", help="only say whether the page is up to date")
    if not parser.parse_args().verify:
        path.write_text(text, encoding="utf-8")
        return 0
    if path.exists() and path.read_text(encoding="utf-8") == text:
        return 0
    print(f"{path.name} is not what its source says now; run `make reference`")
    return 1
