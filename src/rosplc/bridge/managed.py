"""A bridge in the states of a ROS 2 managed node: unconfigured, inactive, active.

* Configuring reads the file and opens the objects: a PLC can attach and detects the bridge's heartbeat.
* Activating opens the topics: messages are carried in both directions.
* Deactivating closes the topics: nothing is carried, and the objects keep their last state.
* Cleaning up closes the objects; they stay in shared memory for the next bridge.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from rosplc.bridge.engine import Bridge
from rosplc.bridge.status import BridgeStatus
from rosplc.config.plans import flag_topic
from rosplc.config.resolve import Project, load_project
from rosplc.model import TypeStore
from rosplc.ros.backend import Backend
from rosplc.ros.lifecycle import LifecycleBackend

_logger = logging.getLogger("rosplc.bridge")


class ManagedBridge:
    """Carries the topics of a configuration over a node that other code manages.

    The methods are called one at a time, in the order that the states allow. ``connect`` creates the backend
    on the node at each :meth:`configure`, with the configuration's types; ``check`` gets the backend and a
    type name, and raises if the type cannot be carried.
    """

    def __init__(
        self,
        connect: Callable[[TypeStore], Backend],
        check: Callable[[Backend, str], None] = lambda _backend, _type: None,
    ) -> None:
        self._connect = connect
        self._check = check
        self._lifecycle: LifecycleBackend | None = None
        self._bridge: Bridge | None = None
        self.project: Project | None = None
        self._open = ExitStack()

    @property
    def active(self) -> bool:
        """Whether messages are carried."""
        return self._lifecycle is not None and self._lifecycle.active

    def configure(self, path: Path | str) -> Project:
        """Read a configuration and open its objects; after a RosplcError, nothing stays open."""
        self.cleanup()
        project = load_project(path)
        backend = self._connect(project.store)
        latched = {plan.topic for plan in project.topics if plan.latched}
        latched |= {f"{plan.action}/_action/status" for plan in project.actions}
        flags = {flag_topic(plan.topic) for plan in project.topics}
        lifecycle = LifecycleBackend(
            backend, lambda type_name: self._check(backend, type_name), latched=latched | flags
        )
        with ExitStack() as stack:
            stack.callback(lifecycle.close)
            bridge = stack.enter_context(Bridge(project, lifecycle))
            stack.callback(lifecycle.deactivate)
            self._open = stack.pop_all()
        self.project, self._lifecycle, self._bridge = project, lifecycle, bridge
        return project

    def activate(self) -> None:
        """Start to carry messages. Raises RosplcError if a topic cannot be opened; then no topic is open."""
        if self._lifecycle is None:
            raise RuntimeError("the bridge must be configured before it is activated")
        self._lifecycle.activate()
        _logger.info("the bridge is active")

    def deactivate(self) -> None:
        """Stop carrying messages; the objects stay open."""
        if self._lifecycle is not None:
            self._lifecycle.deactivate()
            _logger.info("the bridge is inactive")

    def cleanup(self) -> None:
        """Close everything; callable in every state."""
        self.project = self._lifecycle = self._bridge = None
        self._open.close()

    def status(self) -> BridgeStatus | None:
        """Return the state of the bridge and its topics; None while it is not configured."""
        return None if self._bridge is None else self._bridge.status()
