"""The command ``rosplc`` in the test's own process."""

from __future__ import annotations

from typing import Any

from typer.testing import CliRunner

from rosplc.cli.app import app

__all__ = ["rosplc"]


def rosplc(*arguments: object, code: int = 0, **settings: Any) -> Any:
    """Run the command and return its result, which has the expected exit status and no traceback."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], **settings)
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    return result
