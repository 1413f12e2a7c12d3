"""DDS domains of this process: each is configured once, and shared by the backends in it."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain

from rosplc.ros.dds import native

__all__ = ["enter", "leave"]

_logger = logging.getLogger("rosplc.ros.dds")


@dataclass
class _Entry:
    domain: Any
    config: str
    users: int = 1


_domains: dict[int, _Entry] = {}
_lock = threading.Lock()


def enter(number: int, config: str) -> None:
    """Make sure that a domain exists, with this configuration if it is new.

    Raises:
        BackendError: ROS002 if the library refuses the configuration.
    """
    with _lock:
        if (entry := _domains.get(number)) is not None:
            entry.users += 1
            if entry.config != config:
                _logger.warning(
                    "domain %d is in use with another configuration, which stays in force", number
                )
            return
        try:
            _domains[number] = _Entry(Domain(number, config), config)
        except DDSException as error:
            if error.code == DDSException.DDS_RETCODE_PRECONDITION_NOT_MET:
                _logger.warning(
                    "domain %d was opened by other code in this process; its configuration stays", number
                )
                return
            remedy = "Check CYCLONEDDS_URI and the network interfaces; the library's own words are on stderr."
            raise native.refusal(f"cannot join domain {number}", error, remedy=remedy) from error


def leave(number: int) -> None:
    """Give a domain up; the last one deletes it."""
    with _lock:
        entry = _domains.get(number)
        if entry is None:
            return
        entry.users -= 1
        if entry.users == 0:
            del _domains[number]
            native.delete(entry.domain)
