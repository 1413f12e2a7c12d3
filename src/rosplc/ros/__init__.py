"""The ROS side: one narrow interface, one module per middleware behind it."""

from __future__ import annotations

import importlib
from collections.abc import Mapping

from rosplc.errors import BackendError
from rosplc.ros.backend import (
    DEFAULT,
    LATCHED,
    PRESETS,
    SENSOR_DATA,
    Backend,
    EndpointInfo,
    EndpointStatus,
    GraphInfo,
    OnMessage,
    Publisher,
    Qos,
    Subscription,
    TypeSource,
    incompatibility,
)
from rosplc.ros.names import Remapping

__all__ = [
    "BACKENDS",
    "DEFAULT",
    "INSTALL",
    "LATCHED",
    "PRESETS",
    "SENSOR_DATA",
    "Backend",
    "EndpointInfo",
    "EndpointStatus",
    "GraphInfo",
    "OnMessage",
    "Publisher",
    "Qos",
    "Remapping",
    "Subscription",
    "TypeSource",
    "incompatibility",
    "open_backend",
]

BACKENDS: dict[str, str] = {
    "dds": "rosplc.ros.dds",
    "rclpy": "rosplc.ros.rclpy",
    "zenoh": "rosplc.ros.zenoh",
    "rospy": "rosplc.ros.rospy",
    "memory": "rosplc.ros.memory",
}
"""Backend name → the module whose ``open_backend`` makes one; imported when it is asked for."""

INSTALL: dict[str, str] = {
    "dds": "pip install cyclonedds (x86-64, Python before 3.14)",
    "rclpy": "install ROS 2 and source its setup.bash, with a Python that its packages are built for",
    "zenoh": "pip install 'rosplc[zenoh]'",
    "rospy": "apt-get install python3-rospy",
}
"""Backend name → how its package comes onto a machine."""

_AUTOMATIC = ("dds",)  # in this order; `memory` leads nowhere and is never chosen by itself


def open_backend(
    name: str,
    store: TypeSource,
    node_name: str,
    namespace: str = "/",
    domain: int | None = None,
    *,
    remap: Mapping[str, str] | None = None,
    environment: Mapping[str, str] | None = None,
    options: Mapping[str, object] | None = None,
) -> Backend:
    """Join the ROS graph as one node.

    Args:
        name: One of :data:`BACKENDS`, or ``auto`` for the first that is installed; the
            backend's ``name`` tells which one it became.
        store: Where message types come from.
        node_name: The node's base name.
        namespace: The node's namespace.
        domain: The ROS domain; None: ``ROS_DOMAIN_ID`` of the environment, else 0.
        remap: Topic → topic (:func:`rosplc.ros.names.resolve_topic`).
        environment: Variables to use in place of the process's own.
        options: The backend's own keys of the configuration (``ros.zenoh``); others have none.

    Raises:
        BackendError: ROS001 if the backend is unknown or its package is missing, ROS002 if
            the middleware refuses, ROS005 if a name breaks a rule.
    """
    if name != "auto" and name not in BACKENDS:
        raise BackendError("ROS001", f"there is no backend {name!r}; there are: auto, {', '.join(BACKENDS)}")
    missing: list[tuple[str, ImportError]] = []
    for candidate in _AUTOMATIC if name == "auto" else (name,):
        try:
            module = importlib.import_module(BACKENDS[candidate])
        except ImportError as error:
            missing.append((candidate, error))
            continue
        backend: Backend = module.open_backend(
            store, node_name, namespace, domain, remap=remap, environment=environment, options=options
        )
        return backend
    raise BackendError(
        "ROS001",
        f"the packages of these backends are not installed: {', '.join(f'{n} ({e})' for n, e in missing)}",
        remedy="; ".join(f"for {n}: {INSTALL[n]}" for n, _ in missing if n in INSTALL) + ".",
    )
