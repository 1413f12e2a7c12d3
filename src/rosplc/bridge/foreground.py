"""A bridge in the foreground: until a signal comes, with a status line in the log now and then."""

from __future__ import annotations

import contextlib
import logging
import resource
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from rosplc.bridge.engine import Bridge
from rosplc.bridge.run import run_until_signal
from rosplc.bridge.status import BridgeStatus, Level
from rosplc.config.resolve import load_project
from rosplc.harmless import log_to_stderr
from rosplc.ros import RosArguments

__all__ = ["run_bridge"]

log = logging.getLogger("rosplc.run")
_FILES = 65536


def run_bridge(
    config: Path,
    *,
    status_seconds: float | None,
    level: int = logging.INFO,
    arguments: RosArguments | None = None,
    supervised: Callable[[Bridge], AbstractContextManager[object]] = nullcontext,
) -> None:
    """Run a bridge until SIGINT or SIGTERM; a second one ends the process at once, SIGUSR1 reloads the file.

    Args:
        config: The configuration file.
        status_seconds: Time between two status lines in the log; None for none.
        level: The lowest level that is logged.
        arguments: ROS arguments of the command line.
        supervised: What stands around the bridge while it runs, such as a service manager's watchdog.

    Raises:
        RosplcError: The configuration is wrong, the bridge cannot start, or the ROS side has ended for
            good (ROS015).
    """
    log_to_stderr(level)
    _allow_many_files()
    project = load_project(config)
    bridge = Bridge(project, arguments=arguments)
    with supervised(bridge):
        run_until_signal(bridge, None if status_seconds is None else _Reporter().report, status_seconds)


def _allow_many_files() -> None:
    """Ask for as many open files as this user may have: each topic holds one, and 1024 are usual."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _FILES if most == resource.RLIM_INFINITY else min(most, _FILES)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))


class _Reporter:
    """Writes the status line, and each topic whose judgement changed."""

    def __init__(self) -> None:
        self._before: dict[str, str] = {}

    def report(self, status: BridgeStatus) -> None:
        topics = status.topics
        fine = sum(topic.judgement[0] == 0 for topic in topics)
        log.info(
            "status: %d of %d topics fine; in %d, out %d, lost %d, refused %d",
            fine,
            len(topics),
            sum(topic.received for topic in topics),
            sum(topic.published for topic in topics),
            sum(topic.lost for topic in topics),
            sum(topic.refused for topic in topics),
        )
        for topic in topics:
            level, message = topic.judgement
            # Rates and ages differ each time and are no news; a change of level is, and so is its reason.
            same = level.name if level in (Level.OK, Level.STALE) else f"{level.name}: {message}"
            if self._before.get(topic.topic, "OK") != same:
                text = level.name if level == Level.OK else f"{level.name}: {message}"
                log.log(logging.INFO if level == Level.OK else logging.WARNING, "%s: %s", topic.topic, text)
            self._before[topic.topic] = same
