"""rclpy/logging.py: a node's logger, whose lines a test may read."""

from __future__ import annotations

LINES: list[tuple[str, str, str]] = []
"""Severity, logger, text."""


class RcutilsLogger:
    def __init__(self, name: str) -> None:
        self.name = name

    def info(self, message: str) -> bool:
        return self._log("info", message)

    def warning(self, message: str) -> bool:
        return self._log("warning", message)

    def error(self, message: str) -> bool:
        return self._log("error", message)

    def _log(self, severity: str, message: str) -> bool:
        assert isinstance(message, str)  # rclpy's logger formats nothing
        LINES.append((severity, self.name, message))
        return True


def get_logger(name: str) -> RcutilsLogger:
    return RcutilsLogger(name)
