"""Find turns of phrase that this project's English avoids, in pages, sources and the tests' docstrings.

Each has a plainer word: "created again" for "made" with an archaic adverb, "failed" for a wait without
success, "is in" for a thing that stands somewhere. Files of README, docs, spec, src and examples are read
whole, of tests, tools and benchmarks the docstrings.

    python tools/check_words.py
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
AVOIDED = re.compile(
    r"\b(?:whoso?ever|whoever|amid|in vain|anew|of (?:its|their|one's) own accord|answers? for the line"
    r"|comes? along|has a say|lies there|all the same|nobody but who"
    r"|(?:stands?|stood) (?:in|at|on|there|ready|still|behind|beside))\b",
    re.IGNORECASE,
)
PAGES = ("README.md", "docs/*.md", "spec/*.md", "examples/*.md", "examples/*.py", "examples/*.st")
SOURCES = ("py", "c", "h", "st", "txt", "js", "html")
WHOLE = (*PAGES, *(f"src/*.{suffix}" for suffix in SOURCES))
DOCSTRINGS = ("tests/*.py", "tools/*.py", "benchmarks/*.py")


def tracked(*patterns: str) -> list[Path]:
    """Return the files that git knows under these patterns."""
    command = ["git", "ls-files", "-z", *patterns]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).is_file()]


def docstrings(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines of all docstrings, with their numbers."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            found = ast.get_docstring(node, clean=False)
            if found is not None:
                yield from enumerate(found.splitlines(), node.body[0].lineno)


def findings() -> Iterator[str]:
    """Yield file, line and words of each place."""
    for path in tracked(*WHOLE):
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
            yield from (f"{path.relative_to(ROOT)}:{number}: {match[0]}" for match in AVOIDED.finditer(line))
    for path in tracked(*DOCSTRINGS):
        if path == Path(__file__):
            continue
        for number, line in docstrings(path.read_text("utf-8")):
            yield from (f"{path.relative_to(ROOT)}:{number}: {match[0]}" for match in AVOIDED.finditer(line))


def main() -> int:
    """Print what was found; return the exit status."""
    found = list(findings())
    print("\n".join(found) if found else "no avoided words")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
