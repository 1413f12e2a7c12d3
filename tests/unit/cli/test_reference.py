"""The page about the command is what the command says about itself."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

TOOL = Path(__file__).parents[3] / "tools" / "generate_cli_reference.py"


def test_reference_is_up_to_date():
    """docs/reference/cli.md agrees with the help texts; if not, run `make reference`."""
    done = subprocess.run([sys.executable, str(TOOL), "--verify"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
