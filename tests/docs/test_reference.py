"""Generated pages and sources are what their generators write; if not, run `make reference`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from generated_page import filled, write_or_verify

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
