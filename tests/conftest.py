"""Fixtures that several folders of tests share."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from pathlib import Path

import pytest

from rosplc.shm import Namespace


@pytest.fixture
def shm_namespace() -> Iterator[Namespace]:
    """Give a namespace in /dev/shm of the test's own, and remove whatever it leaves there."""
    namespace = Namespace(f"T{secrets.token_hex(6)}")
    yield namespace
    for path in Path(namespace.directory).glob(f"{namespace.prefix}.*"):
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        else:
            path.unlink()
