"""What a server of the page was told, and its token."""

from __future__ import annotations

import hmac
import os
import re
import secrets
import stat
from dataclasses import dataclass
from pathlib import Path

from rosplc.errors import WebError
from rosplc.shm.who import describe_status

__all__ = ["Settings", "new_token", "read_token", "same_token"]


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


_FEWEST = 16
_MOST = 256
_CHARACTERS = re.compile(rf"[!-~]{{{_FEWEST},{_MOST}}}")


def new_token() -> str:
    """Return a token that nobody can guess: 144 random bits, as text that fits into an address."""
    return secrets.token_urlsafe(18)


def read_token(path: Path) -> str:
    """Return the token that a file holds, blanks around it left out.

    Raises:
        WebError: WEB002, the file cannot be read, is open to other users, or holds something that
            is no token: 16 to 256 printable characters without a blank.
    """
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            text = file.read(_MOST + 64).decode("ascii", "replace").strip()
    except OSError as error:
        raise WebError("WEB002", f"cannot be read: {error.strerror}", where=str(path)) from error
    if status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        what = f"others than its owner may use it: {describe_status(status)}"
        raise WebError("WEB002", what, where=str(path), remedy=f"chmod 600 {path}.")
    if not _CHARACTERS.fullmatch(text):
        what = f"holds no token: {_FEWEST} to {_MOST} printable characters without a blank"
        raise WebError("WEB002", what, where=str(path))
    return text


def same_token(expected: str, given: str) -> bool:
    """Return whether two tokens are the same, in a time that does not tell how much of them is."""
    return bool(expected) and hmac.compare_digest(expected.encode(), given.encode("utf-8", "replace"))
