"""What a documentation page asks to be run: its console and Python blocks, and the files it shows.

The conventions, all of them a line of HTML comment directly above a fenced block:

* ````` ```console ````` with ``$ command`` lines: run in order, one shell per page; lines below a
  command are its expected output, where ``...`` stands for any text. Without such lines only the
  exit status counts. ``> `` continues a command.
* ``<!-- exit: 2 -->``: the block's last command ends with this status.
* ``<!-- background -->``: the block's commands are started and left running (another terminal in
  the reader's eyes); each must print its expected lines before the page goes on.
* ``<!-- background: NAME -->``: the same in a terminal that the page refers to later.
* ``<!-- shows: NAME -->``: a block of any language that this terminal prints, after what it showed last.
* ``<!-- stop: NAME -->``, ``<!-- kill: NAME -->``: before the block runs, Ctrl-C is pressed in that
  terminal, or its programs end by SIGKILL.
* ``<!-- retry -->``: the block's commands are repeated until they end and print as shown.
* ``<!-- file: NAME -->``: a block of any language whose text is written to NAME first.
* ````` ```python ````` : run as a program of its own, in the page's folder.
* ``<!-- needs: PACKAGE -->``: the page is skipped where this Debian package is missing.
* ``<!-- not executed: reason -->``: shown to the reader only, and listed by the test run.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

FENCE = re.compile(r"^(?P<indent> *)(?P<ticks>`{3,})(?P<language>[a-z0-9+-]*)\s*$")
COMMENT = re.compile(
    r"^ *<!-- (?P<key>not executed|exit|background|shows|stop|kill|retry|file|needs)"
    r"(?:: *(?P<value>.*?))? *-->$"
)
LANGUAGES_THAT_RUN = ("console", "python")


@dataclass(frozen=True)
class Step:
    """One command of a console block, with the output that the page shows."""

    command: str
    expected: str | None


@dataclass(frozen=True)
class Block:
    """A fenced block: where it stands, what it holds and what its comments say."""

    line: int
    language: str
    text: str
    directives: dict[str, str]

    def steps(self) -> tuple[Step, ...]:
        """Return the commands of a console block.

        Raises:
            ValueError: The block has output before its first command.
        """
        steps: list[tuple[list[str], list[str]]] = []
        for line in self.text.splitlines():
            if line.startswith("$ "):
                steps.append(([line[2:]], []))
            elif not steps:
                raise ValueError(f"line {self.line}: a console block begins with a `$ command` line")
            elif line.startswith("> ") and not steps[-1][1]:
                steps[-1][0].append(line[2:])
            else:
                steps[-1][1].append(line)
        return tuple(
            Step("\n".join(command), "\n".join(output) if output else None) for command, output in steps
        )


def blocks(path: Path) -> Iterator[Block]:
    """Yield every fenced block of a page, in order.

    Raises:
        ValueError: A block is not closed.
    """
    lines = path.read_text(encoding="utf-8").splitlines()
    directives: dict[str, str] = {}
    number = 0
    while number < len(lines):
        line = lines[number]
        number += 1
        if match := COMMENT.match(line):
            directives[match["key"]] = match["value"] or ""
            continue
        opening = FENCE.match(line)
        if not opening:
            directives = {}
            continue
        first, body = number, []
        closing = opening["indent"] + opening["ticks"]
        while number < len(lines) and lines[number].rstrip() != closing:
            body.append(lines[number].removeprefix(opening["indent"]))
            number += 1
        if number == len(lines):
            raise ValueError(f"{path.name}:{first}: this block is not closed")
        number += 1
        yield Block(first, opening["language"], "".join(f"{text}\n" for text in body), directives)
        directives = {}


def pattern(expected: str) -> re.Pattern[str]:
    """Return what output must match: the text itself, with ``...`` for anything.

    A line of its own that says ``...`` stands for any number of lines, none included: what other
    programs of the machine add to a list must not decide. The shortest match counts, so that what a
    terminal prints afterwards is left for the next block.
    """
    lines = [line.rstrip() for line in expected.strip().splitlines()]
    body = "".join(
        "(?:.*?\n)??" if line == "..." else ".*?".join(re.escape(part) for part in line.split("...")) + "\n"
        for line in lines
    )
    return re.compile(body, re.DOTALL)


def normal(output: str) -> str:
    """Return output as it is compared: without colours, trailing blanks and carriage returns."""
    output = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", output).replace("\r\n", "\n")
    return "".join(f"{line.rstrip()}\n" for line in output.strip().splitlines())
