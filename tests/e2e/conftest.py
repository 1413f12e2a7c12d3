"""Fixtures of the end-to-end tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from rosplc.demo.plan import FreeDomain
from rosplc.shm import Namespace


@pytest.fixture
def shm_prefix(shm_namespace: Namespace) -> str:
    """Give a prefix of the test's own in /dev/shm."""
    return shm_namespace.prefix


@pytest.fixture
def dds_domain() -> Iterator[int]:
    """Give a ROS domain that nobody on this machine uses, and keep it from others meanwhile."""
    domain = FreeDomain()
    yield domain.number
    domain.close()
