"""Print how large the repository is: statement lines of Python, C and template code, per package.

A statement line is one that is neither blank nor a comment nor part of a docstring. Physical lines of
Python under ``src`` come beside them. ``--json`` prints the same for programs.

    python tools/count_lines.py [FOLDER]
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import re
import subprocess
import tokenize
from collections import Counter
from pathlib import Path

C_SUFFIXES = {".c", ".h", ".cpp", ".hpp"}
TEMPLATE_SUFFIXES = {".st", ".jinja", ".j2", ".in", ".html", ".css", ".js"}
NOT_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
    tokenize.ENCODING,
}  # fmt: skip
DISTRIBUTIONS = ("src/", "benchmarks", "tests/st", "verification", "setup.py")
C_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
ST_COMMENT = re.compile(r"\(\*.*?\*\)|//[^\n]*", re.DOTALL)
JINJA_COMMENT = re.compile(r"\{#.*?#\}|<!--.*?-->", re.DOTALL)


def python_lines(text: str) -> int:
    """Return the lines that hold code, docstrings left out."""
    documented: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                documented |= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NOT_CODE:
            lines |= set(range(token.start[0], token.end[0] + 1))
    return len(lines - documented)


def other_lines(text: str, comments: tuple[re.Pattern[str], ...]) -> int:
    """Return the lines that hold something besides comments."""
    for comment in comments:
        text = comment.sub(lambda match: "\n" * match[0].count("\n"), text)
    return sum(1 for line in text.splitlines() if line.strip())


def package(path: Path) -> str:
    """Return what a file is counted under: its package, or the folder of the repository's top."""
    parts = path.parts
    if parts[:2] == ("src", "rosplc"):
        return "/".join(parts[:3]) if len(parts) > 3 else "src/rosplc"
    return "/".join(parts[:2]) if parts[0] in ("tests", "packaging") and len(parts) > 2 else parts[0]


def count(root: Path) -> dict[str, Counter[str]]:
    """Return the counts of each package: python, c, template, and physical lines of Python."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True)
    counts: dict[str, Counter[str]] = {}
    for name in filter(None, listed.stdout.split("\0")):
        path = Path(name)
        if path.suffix not in {".py"} | C_SUFFIXES | TEMPLATE_SUFFIXES or not (root / path).is_file():
            continue
        if path.suffix == ".in" and "templates" not in path.parts:
            continue
        if path.parts[:2] in (("tests", "peers"), ("tests", "contract")) and path.suffix != ".py":
            continue
        text = (root / path).read_text("utf-8", errors="replace")
        row = counts.setdefault(package(path), Counter())
        if path.suffix == ".py":
            row["python"] += python_lines(text)
            row["physical"] += len(text.splitlines())
        elif path.suffix in C_SUFFIXES:
            row["c"] += other_lines(text, (C_COMMENT,))
        else:
            row["template"] += other_lines(
                text, (JINJA_COMMENT, ST_COMMENT if path.suffix == ".st" else C_COMMENT)
            )
    return counts


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).resolve().parents[1])
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    counts = count(options.folder)
    total = sum(counts.values(), Counter[str]())
    source = sum((row for name, row in counts.items() if name.startswith("src/")), Counter[str]())
    installed = sum((row for name, row in counts.items() if name.startswith(DISTRIBUTIONS)), Counter[str]())
    rows = [*sorted(counts.items()), ("src", source), ("all distributions", installed), ("all", total)]
    if options.json:
        print(json.dumps({name: dict(row) for name, row in rows}, indent=1))
        return
    kinds = ("python", "c", "template")
    print(f"{'statement lines of':28}{'Python':>9}{'C':>9}{'template':>10}{'sum':>9}{'physical Python':>18}")
    for name, row in rows:
        shown = "".join(f"{row[kind]:>{width}}" for kind, width in zip(kinds, (9, 9, 10), strict=True))
        print(f"{name:28}{shown}{sum(row[kind] for kind in kinds):>9}{row['physical']:>18}")


if __name__ == "__main__":
    main()
