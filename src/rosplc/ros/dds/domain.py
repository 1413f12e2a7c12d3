"""DDS domains of this process: each is configured once, and shared by the backends in it."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain
from cyclonedds.topic import Topic

from rosplc.ros.dds import native

_logger = logging.getLogger("rosplc.ros.dds")


# Held while types come and go.
#
# Creating a topic, the wheel walks the type library without the library's lock (cyclonedds 11.0.1; the report
# is tests/interop/upstream/cyclonedds_types.md): whatever removes a type at that moment ends the process.
TYPES = threading.RLock()


class Topics:
    """A participant's topics: opened once and kept, so that no type is removed while the participant lives.

    Args:
        participant: The wheel's participant.
    """

    def __init__(self, participant: Any) -> None:
        self._participant = participant
        self._open: dict[tuple[str, Any], Any] = {}

    def __call__(self, name: str, data_type: Any) -> Any:
        """Return the topic of this name and type; DDSException if the library refuses it."""
        with TYPES:
            if (name, data_type) not in self._open:
                self._open[name, data_type] = Topic(self._participant, name, data_type)
            return self._open[name, data_type]

    def close(self) -> None:
        """Delete the topics."""
        with TYPES:
            while self._open:
                native.delete(self._open.popitem()[1])


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
    with _lock, TYPES:
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
    with _lock, TYPES:
        entry = _domains.get(number)
        if entry is None:
            return
        entry.users -= 1
        if entry.users == 0:
            del _domains[number]
            native.delete(entry.domain)
