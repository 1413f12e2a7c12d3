"""The documentation as a whole: links that lead somewhere, pages that can be found."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

from links import anchors, relative_links
from tests.docs.pages import blocks, normal, pattern

pytestmark = pytest.mark.verifies("generated", own="rosplc alone")

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
TEXTS = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
    + [path for folder in ("docs", "spec", "examples") for path in (ROOT / folder).rglob("*.md")]
)


def links(path: Path) -> list[str]:
    return relative_links(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("page", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    """Every relative link names a file that exists, and a heading in it."""
    for link in links(page):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert target.is_relative_to(ROOT), f"{link} leads out of the repository"
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target), link


@pytest.mark.parametrize(
    "page", [*TEXTS, ROOT / "README.de.md"], ids=lambda path: str(path.relative_to(ROOT))
)
def test_a_file_is_named_above_its_text(page: Path) -> None:
    """A reader who does not see the comment knows where to write it, on GitHub too."""
    lines = page.read_text(encoding="utf-8").splitlines()
    for block in blocks(page):
        if name := block.directives.get("file"):
            above = "\n".join(line for line in lines[: block.line - 1] if not line.strip().startswith("<!--"))
            paragraph = above.strip().rpartition("\n\n")[2]
            assert re.search(rf"[`/ ]{re.escape(Path(name).name)}`", paragraph), (block.line, name)


def test_every_page_can_be_reached_from_the_index() -> None:
    """No page is left where a reader who starts at docs/index.md cannot find it."""
    reached: set[Path] = set()
    waiting = [DOCS / "index.md"]
    while waiting:
        page = waiting.pop()
        if page in reached or page.suffix != ".md" or not page.exists():
            continue
        reached.add(page)
        waiting += [(page.parent / link.partition("#")[0]).resolve() for link in links(page)]
    assert sorted(str(page.relative_to(DOCS)) for page in set(DOCS.rglob("*.md")) - reached) == []


def test_debian_packages_in_the_docs_are_those_that_ci_installs() -> None:
    """The how-to's package list and .ci/debian-packages.txt are one list."""
    lines = (ROOT / ".ci" / "debian-packages.txt").read_text(encoding="utf-8").splitlines()
    packages = {line.strip() for line in lines if line.strip() and not line.startswith("#")}
    page = (DOCS / "howto" / "install-the-check-tools.md").read_text(encoding="utf-8")
    listed = [name for row in re.findall(r"^\| (`.*?) \|", page, re.MULTILINE) for name in row.split(", ")]
    assert sorted(listed) == sorted(f"`{name}`" for name in packages)


# The runner itself must be able to fail.


def write(tmp_path: Path, text: str) -> Path:
    page = tmp_path / "page.md"
    page.write_text(text, encoding="utf-8")
    return page


def test_runner_reads_commands_output_and_comments(tmp_path: Path) -> None:
    """Commands, continuation lines, expected output and directives are told apart."""
    page = write(
        tmp_path, "<!-- exit: 2 -->\n```console\n$ a \\\n> b\nout\n\nmore\n$ c\n```\n```yaml\nx: 1\n```\n"
    )
    console, yaml = blocks(page)
    assert console.directives == {"exit": "2"}
    assert [(step.command, step.expected) for step in console.steps()] == [
        ("a \\\nb", "out\n\nmore"),
        ("c", None),
    ]
    assert (yaml.language, yaml.text, yaml.directives) == ("yaml", "x: 1\n", {})


def test_runner_refuses_a_block_that_is_not_closed(tmp_path: Path) -> None:
    """A missing fence is an error and does not silently end the page."""
    with pytest.raises(ValueError, match="not closed"):
        list(blocks(write(tmp_path, "```console\n$ a\n")))


def test_runner_refuses_output_without_a_command(tmp_path: Path) -> None:
    """A console block without a command would otherwise pass unnoticed."""
    (block,) = blocks(write(tmp_path, "```console\nmake test\n```\n"))
    with pytest.raises(ValueError, match="begins with"):
        block.steps()


@pytest.mark.parametrize(
    ("expected", "output", "fits"),
    [
        ("a b", "a b\n", True),
        ("a ... c", "a b b c", True),
        ("a\n...\nz", "a\nm\nn\nz", True),
        ("a\n...\nz", "a\nz", True),
        ("...\na\n...", "a", True),
        ("a ...\nb", "a\nb", False),
        ("a", "a\nb", False),
        ("a.c", "abc", False),
        ("a\n...", "b\na\nc", False),
    ],
)
def test_ellipsis_stands_for_any_text(expected: str, output: str, fits: bool) -> None:
    """Only `...` is a placeholder, and everything else must be there."""
    assert bool(pattern(expected).fullmatch(normal(output))) is fits


@pytest.mark.parametrize("program", ["draw_path.py", "draw_format.py", "draw_assembly_cell.py"])
def test_pictures_are_what_their_programs_draw(program: str) -> None:
    """No picture was changed by hand, and none shows what the C core no longer does."""
    drawings = runpy.run_path(str(ROOT / "tools" / program))["DRAWINGS"]
    for name, draw in drawings.items():
        assert (DOCS / "images" / name).read_text(encoding="utf-8") == draw(), name
