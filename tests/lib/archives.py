"""Unpack an archive of this project's own."""

from __future__ import annotations

import tarfile
from pathlib import Path
from typing import Any

__all__ = ["unpack"]


def unpack(archive: Path, folder: Path) -> None:
    """Unpack a tar archive into a folder."""
    # Python 3.11 before 3.11.4, as in Debian 12, knows no filter; later ones warn without one.
    safely: Any = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
    with tarfile.open(archive) as opened:
        opened.extractall(folder, **safely)
