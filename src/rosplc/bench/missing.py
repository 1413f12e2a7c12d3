"""What a contender raises when the machine lacks something: it is skipped, with the reason."""

from __future__ import annotations

__all__ = ["Missing"]


class Missing(Exception):
    """Something optional is not there.

    Args:
        reason: What, in a few words.
        remedy: The command that would install it, or what else would help.
    """

    def __init__(self, reason: str, remedy: str = "") -> None:
        super().__init__(reason)
        self.reason = reason
        self.remedy = remedy
