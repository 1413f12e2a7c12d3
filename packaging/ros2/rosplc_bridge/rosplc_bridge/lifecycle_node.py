"""A lifecycle node around rosplc's bridge; what the states mean stands in ``rosplc.bridge.managed``."""

from __future__ import annotations

from collections.abc import Callable

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from rosplc.bridge.managed import ManagedBridge
from rosplc.errors import RosplcError
from rosplc.ros.rclpy import from_node
from rosplc.ros.rclpy.parameters import Shown

__all__ = ["BridgeNode"]


class BridgeNode(LifecycleNode):
    """The bridge.

    Parameters: ``config``, the configuration file, is given at the start; ``version``, ``bridge``,
    ``topics`` and ``types`` are shown, and cannot be set.

    Args:
        name: The node's name; launch files and ``-r __node:=`` give another.
        kwargs: As for rclpy's node.
    """

    def __init__(self, name: str = "rosplc_bridge", **kwargs: object) -> None:
        super().__init__(name, **kwargs)
        config = ParameterDescriptor(
            read_only=True, description="the bridge's configuration file, an absolute path"
        )
        self.declare_parameter("config", "", config)
        self._shown = Shown(self)
        self._bridge = ManagedBridge(
            lambda store: from_node(self, store), lambda backend, type_name: backend.check(type_name)
        )

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the configuration and open the objects in shared memory."""
        return self._try(self._configure, "configured") or super().on_configure(state)

    def _configure(self) -> None:
        path = self.get_parameter("config").value
        if not path:
            raise RosplcError("CFG005", "the parameter config is not set", where="config")
        project = self._bridge.configure(path)
        self._shown.update(
            {
                "bridge": project.config.settings.bridge,
                "topics": [plan.topic for plan in project.topics],
                "types": [plan.type_name for plan in project.topics],
            }
        )

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to carry."""
        return self._try(self._bridge.activate, "activated") or super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop carrying."""
        return self._try(self._bridge.deactivate, "deactivated") or super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of the objects."""
        return self._try(self._bridge.cleanup, "cleaned up") or super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of everything, from whatever state."""
        return self._try(self._bridge.cleanup, "shut down") or super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go back to the beginning after a defect."""
        return self._try(self._bridge.cleanup, "cleaned up") or super().on_error(state)

    def destroy_node(self) -> None:
        """Let go of everything with the node."""
        self._bridge.cleanup()
        super().destroy_node()

    def _try(self, work: Callable[[], object], what: str) -> TransitionCallbackReturn | None:
        """Return None if it went well; rclpy itself would swallow an exception without a word."""
        try:
            work()
        except RosplcError as error:
            for line in str(error).splitlines():
                self.get_logger().error(line)
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # a defect: rclpy's own handler of it is on_error
            self.get_logger().error(f"the bridge cannot be {what}: {type(error).__name__}: {error}")
            return TransitionCallbackReturn.ERROR
        return None
