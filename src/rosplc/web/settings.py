"""What a server of the page was told."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Settings"]


@dataclass(frozen=True)
class Settings:
    """The settings of one server.

    Attributes:
        prefix: Only channels of this prefix; None for all.
        directory: Where the objects stand.
        names: Host names under which the server may be asked, besides ``localhost`` and addresses.
        allow_write: Whether test messages may be written.
        token: What who writes, or looks, has to know; empty if nobody has to.
        token_to_view: Whether looking needs the token too.
        viewers: How many pages may be connected at once.
    """

    prefix: str | None = None
    directory: str = "/dev/shm"
    names: tuple[str, ...] = ()
    allow_write: bool = False
    token: str = ""
    token_to_view: bool = False
    viewers: int = 32

    def __post_init__(self) -> None:
        if (self.allow_write or self.token_to_view) and not self.token:
            raise ValueError("a token is needed to write, or to ask viewers for it")
