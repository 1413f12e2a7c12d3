"""Generated pages and sources are what their generators write; if not, run `make reference`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from generate_verified import markers, parts
from generated_page import filled, write_or_verify

pytestmark = pytest.mark.verifies("generated", own="rosplc alone")

TOOLS = Path(__file__).resolve().parents[2] / "tools"
PROGRAMS = sorted(path.stem for path in TOOLS.glob("generate_*.py"))


@pytest.mark.parametrize("program", PROGRAMS)
def test_what_is_generated_is_up_to_date(program: str) -> None:
    """Generating again gives the same text."""
    command = [sys.executable, str(TOOLS / f"{program}.py"), "--verify"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_page_that_differs_is_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The comparison that all generators share can fail; what is not generated stays."""
    page = tmp_path / "page.md"
    page.write_text("Before.\n\n<!-- generated: table -->\n\nold\n\n<!-- end -->\n\nAfter.\n")
    assert write_or_verify(page, filled(page, {"table": "old"}), verify=True) == 0
    new = filled(page, {"table": "new"})
    assert new == page.read_text().replace("old", "new")
    assert write_or_verify(page, new, verify=True) == 1
    assert "make reference" in capsys.readouterr().out
    assert write_or_verify(page, new, verify=False) == 0 and page.read_text() == new


def test_a_statement_has_the_strongest_level_of_its_tests(tmp_path: Path) -> None:
    """One that is marked shows what was used; one that is not counts as not verified."""
    (tmp_path / "test_a.py").write_text(
        'pytestmark = [pytest.mark.verifies("one", own="a model")]\n'
        '@pytest.mark.verifies("one", real="gcc")\ndef test(): pass\n'
    )
    shown = parts("Title:\n  one | it works\n  two | it is fast | no test\n", markers(tmp_path))
    assert "| ● real | it works | gcc; own: a model | `test_a.py` |" in shown["verified"]
    assert "| it is fast | no test |" in shown["not verified"]


@pytest.mark.parametrize("table", ["T:\n  two | it | note\n", "T:\n  one | it | note\n", "T:\n  two | it\n"])
def test_a_marker_and_its_statement_belong_together(table: str) -> None:
    """A marker for nothing, a note beside a marker, and neither of both are refused."""
    with pytest.raises(ValueError, match="statement"):
        parts(table, {"one": [("own", "a model", "test_a.py")]})


def test_a_marker_without_evidence_is_refused(tmp_path: Path) -> None:
    """Who verified something with what is part of each marker."""
    (tmp_path / "test_a.py").write_text('pytestmark = pytest.mark.verifies("one")\n')
    with pytest.raises(ValueError, match="names the evidence"):
        markers(tmp_path)
