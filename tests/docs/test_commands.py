"""Every command, program and file that the documentation shows is run as the reader would."""

from __future__ import annotations

import fcntl
import os
import re
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.pages import LANGUAGES_THAT_RUN, Block, blocks, normal, pattern
from tests.docs.shell import COMMAND_SECONDS, Shell
from tests.interop.graphs import free_domain
from tests.lib import isolated

ROOT = Path(__file__).resolve().parents[2]
FIRST = ROOT / "README.md"  # the one page that the first tier runs
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
SHARED_MEMORY = Path("/dev/shm")

pytestmark = [pytest.mark.timeout(600), pytest.mark.verifies("documentation", own="executed commands")]
if (
    not isolated.possible()
):  # pages use the default prefix and fixed ports, as their reader does: one at a time
    pytestmark = [*pytestmark, pytest.mark.xdist_group("docs")]


def runs(block: Block) -> bool:
    return block.language in LANGUAGES_THAT_RUN and "not executed" not in block.directives


def place(page: Path) -> str:
    return str(page.relative_to(ROOT))


def page_parameters() -> list[object]:
    return [
        pytest.param(
            page,
            id=place(page),
            marks=[pytest.mark.needs(*needed(page)), *([] if page == FIRST else [pytest.mark.foreign])],
        )
        for page in PAGES
        if any(runs(block) or "file" in block.directives for block in blocks(page))
    ]


def needed(page: Path) -> list[str]:
    """Return the Debian packages that a page's commands need."""
    return [block.directives["needs"] for block in blocks(page) if "needs" in block.directives]


def prefixes() -> set[str]:
    """Return the prefixes of objects that the pages' configurations name, and the default one."""
    found = re.findall(r"^ *prefix: *(\w+)", "\n".join(p.read_text(encoding="utf-8") for p in PAGES), re.M)
    return {"rosplc", *found}


def objects() -> set[Path]:
    """Return what pages leave in shared memory: under their prefixes, and classic topics that they name."""
    starts = [*(f"{prefix}." for prefix in prefixes()), "migrated_", "sem.migrated_"]
    return {path for start in starts for path in SHARED_MEMORY.glob(f"{start}*")}


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    """A shell in an empty folder; shared memory that the page left behind is removed."""
    # Another clone's tests may run on this machine, with the same default prefix.
    turn = os.open(Path(tempfile.gettempdir()) / "rosplc-docs.lock", os.O_CREAT | os.O_RDWR, 0o666)
    fcntl.flock(turn, fcntl.LOCK_SH if isolated.possible() else fcntl.LOCK_EX)
    before = objects()
    env = {
        "PATH": f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin",
        "HOME": str(tmp_path),
        "LANG": "C.UTF-8",
        "COLUMNS": "100",
        "NO_COLOR": "1",
    }
    # Neither a robot on this network nor another test is part of the page.
    with free_domain() as domain:
        shell = Shell(tmp_path, {**env, "ROS_DOMAIN_ID": str(domain)})
        yield shell
        shell.close()
    if not isolated.possible():
        for path in objects() - before:
            path.unlink(missing_ok=True)
    os.close(turn)


def run_console(shell: Shell, block: Block, at: str) -> None:
    steps = block.steps()
    for step in steps:
        if "background" in block.directives:
            job = shell.start(step.command, block.directives["background"])
            if step.expected is not None:
                job.wait_for(pattern(step.expected))
            continue
        status, output = shell.run(step.command)
        wanted = int(block.directives.get("exit", 0)) if step is steps[-1] else 0
        assert status == wanted, f"{at}: `{step.command}` ended with {status}:\n{output}"
        if step.expected is not None:
            shown = pattern(step.expected)
            assert shown.fullmatch(normal(output)), (
                f"{at}: `{step.command}`\n--- the page shows\n{step.expected}\n--- it printed\n{output}"
            )


def repeat(shell: Shell, block: Block, at: str) -> None:
    """Run a block until it prints what the page shows; a reader looks again, too."""
    watchdog = time.monotonic() + COMMAND_SECONDS
    while True:
        try:
            run_console(shell, block, at)
        except AssertionError:
            if time.monotonic() > watchdog:
                raise
            time.sleep(0.2)
        else:
            return


def run_block(shell: Shell, block: Block, at: str) -> None:
    if name := block.directives.get("stop"):
        shell.terminals[name].interrupt()
    if name := block.directives.get("kill"):
        shell.terminals[name].kill()
    if name := block.directives.get("shows"):
        shell.terminals[name].wait_for(pattern(block.text))
    elif name := block.directives.get("file"):
        path = shell.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(block.text, encoding="utf-8")
    elif not runs(block):
        return
    elif block.language == "console":
        repeat(shell, block, at) if "retry" in block.directives else run_console(shell, block, at)
    else:
        path = shell.folder / f"block_at_line_{block.line}.py"
        path.write_text(block.text, encoding="utf-8")
        status, output = shell.run(f"python {path}")
        assert status == int(block.directives.get("exit", 0)), f"{at}: the program failed:\n{output}"


@pytest.mark.parametrize("page", page_parameters())
def test_page_does_what_it_shows(page: Path, shell: Shell) -> None:
    """Run in order in an empty folder, a page's commands print what the page shows."""
    for block in blocks(page):
        run_block(shell, block, f"{place(page)}:{block.line}")


def test_commands_that_are_shown_only_have_a_reason() -> None:
    """A command that is not run has its reason beside it: <!-- not executed: reason -->."""
    shown = [
        (f"{place(page)}:{block.line}", block.directives["not executed"])
        for page in PAGES
        for block in blocks(page)
        if "not executed" in block.directives
    ]
    assert shown
    assert [where for where, reason in shown if not reason] == []


def test_no_page_ends_programs_by_their_name() -> None:
    """Pages are tested at the same time, with the same names: each must leave the others' alone."""
    steps = [
        (f"{place(page)}:{block.line}", step.command)
        for page in PAGES
        for block in blocks(page)
        if runs(block) and block.language == "console"
        for step in block.steps()
    ]
    assert steps
    assert [at for at, command in steps if re.search(r"\b(pkill|killall|skill)\b", command)] == []


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("```console\n$ false\n```\n", "ended with 1"),
        ("<!-- exit: 3 -->\n```console\n$ true\n```\n", "ended with 0"),
        ("```console\n$ echo one\ntwo\n```\n", "the page shows"),
        ("```console\n$ exit\n```\n", "ended the shell"),
        ("```python\nraise SystemExit(4)\n```\n", "the program failed"),
        ("<!-- background -->\n```console\n$ echo one\ntwo\n```\n", "did not print"),
    ],
)
def test_page_that_shows_something_else_fails(shell: Shell, text: str, problem: str) -> None:
    """The runner notices a wrong status, other output, a dead shell and a failing program."""
    page = shell.folder / "page.md"
    page.write_text(text, encoding="utf-8")
    with pytest.raises(AssertionError, match=problem):
        for block in blocks(page):
            run_block(shell, block, "page.md")


def test_page_may_use_files_folders_and_other_terminals(shell: Shell) -> None:
    """Files come from the page, the folder lasts, and a background command is waited for."""
    page = shell.folder / "page.md"
    page.write_text(
        "<!-- file: sub/data.txt -->\n```text\nhello\n```\n"
        "```console\n$ cd sub\n$ cat <<END\n> a b\n> END\na b\n```\n"
        "<!-- background -->\n```console\n$ sleep 0.3; cat data.txt; sleep 600\nhello\n```\n"
        "<!-- exit: 1 -->\n```console\n$ ls ..\n...\nsub\n$ cat missing\n...No such file...\n```\n",
        encoding="utf-8",
    )
    for block in blocks(page):
        run_block(shell, block, "page.md")


def test_page_may_refer_to_its_terminals(shell: Shell) -> None:
    """A named terminal shows its lines in order, is stopped or killed, and a look may be repeated."""
    page = shell.folder / "page.md"
    page.write_text(
        "<!-- background: one -->\n```console\n$ echo first; sleep 0.2; echo second; sleep 600\nfirst\n```\n"
        "<!-- shows: one -->\n```text\nsecond\n```\n"
        "<!-- background: two -->\n```console\n"
        "$ trap 'touch ended; exit' INT; echo up; while :; do sleep 0.1; done\n"
        "up\n```\n"
        "<!-- kill: one -->\n<!-- stop: two -->\n<!-- retry -->\n```console\n$ ls ended\nended\n```\n",
        encoding="utf-8",
    )
    for block in blocks(page):
        run_block(shell, block, "page.md")
    assert shell.terminals["one"].process.poll() is not None
