"""What every generator of a reference page does in the end: write the generated parts, or compare them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = ROOT / "docs" / "reference"
END = "<!-- end -->"


def filled(path: Path, parts: Mapping[str, str]) -> str:
    """Return a page with each part between its ``<!-- generated: NAME -->`` and the next ``<!-- end -->``."""
    text = path.read_text(encoding="utf-8")
    for name, body in parts.items():
        begin = f"<!-- generated: {name} -->"
        before, _, rest = text.partition(begin)
        _, end, after = rest.partition(END)
        assert end, f"{path.name} does not contain {begin}"
        text = f"{before}{begin}\n\n{body.strip()}\n\n{END}{after}"
    return text


def write_or_verify(path: Path, text: str, *, verify: bool) -> int:
    """Write a file, or print that it is not up to date; return the exit status: 1 for the latter."""
    if not verify:
        path.write_text(text, encoding="utf-8")
    elif not path.exists() or path.read_text(encoding="utf-8") != text:
        print(f"{path.name} is out of date; run `make reference`")
        return 1
    return 0


def run(description: str | None, texts: Mapping[Path, str]) -> int:
    """Write files, or with ``--verify`` on the command line compare them; return the exit status."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--verify", action="store_true", help="only report whether the page is up to date")
    verify = parser.parse_args().verify
    return max(write_or_verify(path, text, verify=verify) for path, text in texts.items())
