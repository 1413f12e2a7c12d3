"""A context, a node and a thread of our own, and what the configuration says of them under ``ros.rclpy``.

Nothing of rclpy's process-wide state is touched: its default context and its signal handlers belong to the
program that the bridge may be part of.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from rosplc.clock import Clock
from rosplc.errors import BackendError


def read_options(options: Mapping[str, object]) -> tuple[list[str], Mapping[str, str | list[str]]]:
    """Return ROS arguments for the bridge's node, and name → value of read-only parameters that it shows.

    The arguments are as after ``--ros-args`` on a command line: ``["-r", "cmd_vel:=base/cmd_vel",
    "--enclave", "/cell1"]``. Raises BackendError ROS013 if a key is unknown or its value is not of its kind.
    """
    for key in options:
        if key not in ("ros_args", "parameters"):
            raise BackendError("ROS013", f"ros.rclpy has no key {key!r}; there are: ros_args, parameters")
    arguments = options.get("ros_args", ())
    if not isinstance(arguments, list | tuple) or not all(isinstance(one, str) for one in arguments):
        raise BackendError("ROS013", f"ros.rclpy.ros_args is {arguments!r}; it is a list of strings")
    parameters = options.get("parameters", {})
    if not isinstance(parameters, Mapping) or not all(map(_is_shown, parameters.values())):
        what = f"ros.rclpy.parameters is {parameters!r}; it maps names to strings or lists of strings"
        raise BackendError("ROS013", what)
    return [one for one in arguments if one != "--ros-args"], parameters


def _is_shown(value: object) -> bool:
    return isinstance(value, str) or (isinstance(value, list) and all(isinstance(one, str) for one in value))


_logger = logging.getLogger("rosplc.ros.rclpy")


def guard_takes(executor: Any, refused: Callable[[Any, Exception], None]) -> None:
    """Keep a message that cannot be taken from ending all deliveries."""
    # An empty serialized message makes the middleware's take raise (rmw_cyclonedds). rclpy's executors then
    # never release the entity and its callback group, which is that of all our endpoints.
    known = getattr(executor._take_subscription, "refused", None)
    if known is not None:
        known.append(refused)
        return
    all_refused = [refused]
    for what in ("subscription", "service", "client"):
        take = getattr(executor, f"_take_{what}")
        # Humble's executor takes a response apart without a look.
        nothing = (None, None) if what == "client" and hasattr(executor, "_execute_client") else None
        setattr(executor, f"_take_{what}", _guarded(take, nothing, all_refused))


def _guarded(take: Callable[[Any], Any], nothing: Any, refused: list[Any]) -> Callable[[Any], Any]:
    def guarded(entity: Any) -> Any:
        try:
            return take(entity)
        except Exception as error:
            for each in refused:
                each(entity, error)
            return nothing

    guarded.refused = refused  # type: ignore[attr-defined]
    return guarded


class OwnNode:
    """One node that a thread of its own serves until :meth:`close`; raises what rclpy raises."""

    def __init__(
        self, name: str, namespace: str, domain: int | None, ros_args: Sequence[str], clock: Clock
    ) -> None:
        self.context = Context()
        self._clock = clock
        # Never None: rclpy would take the whole program's arguments. Without a domain it is ROS_DOMAIN_ID's.
        self.context.init(args=["--ros-args", *ros_args] if ros_args else [], domain_id=domain)
        try:
            self.node: Any = Node(name, context=self.context, namespace=namespace)
            self._executor = SingleThreadedExecutor(context=self.context)
            self._executor.add_node(self.node)
        except BaseException:
            self.context.try_shutdown()
            raise
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name=f"rosplc-rclpy-{name}", daemon=True)

    def start(self, on_lost: Callable[[], None]) -> None:
        """Begin to serve; ``on_lost`` is called if somebody else shuts the context down."""
        self._on_lost = on_lost
        self._thread.start()

    def close(self) -> None:
        """Stop serving and leave the graph; waits for that, unless called from a callback."""
        self._stopping = True
        with suppress(Exception):  # the executor is gone already, if the context was shut down
            self._executor.create_task(_nothing)  # spin_once returns after it
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        try:
            while not self._stopping and self._spin():
                pass
        finally:
            self.leave()

    def _spin(self) -> bool:
        try:
            self._executor.spin_once()
        except InvalidHandle:  # an entity was destroyed while the executor looked at it
            _logger.debug("the executor met a destroyed entity", exc_info=True)
        except ExternalShutdownException:
            pass
        except Exception:  # a defect; but the other topics have to go on
            _logger.exception("serving the node %s failed", self.node.get_name())
            self._clock.sleep(100_000_000)
        if self.context.ok() or self._stopping:
            return True
        _logger.error("the ROS context was shut down by somebody else; nothing is carried any more")
        self._on_lost()
        return False

    def leave(self) -> None:
        """Give everything back; the thread's last work."""
        for step in (self.node.destroy_node, self._executor.shutdown, self.context.try_shutdown):
            try:
                step()
            except Exception:  # the rest must still be given back
                _logger.debug("leaving the graph: %s failed", step, exc_info=True)


def _nothing() -> None:
    """Wake the executor."""
