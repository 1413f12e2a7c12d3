"""The ROS side: one narrow interface, with one module per middleware."""

from __future__ import annotations

from collections.abc import Mapping

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.ros.actionlib import ActionlibClient, ActionlibServer
from rosplc.ros.actions import ActionClient, ActionServer, GoalEvent
from rosplc.ros.arguments import Remapping, RosArguments, split_arguments
from rosplc.ros.backend import (
    DEFAULT,
    LATCHED,
    PRESETS,
    SENSOR_DATA,
    SERVICES,
    Backend,
    Endpoint,
    EndpointInfo,
    EndpointStatus,
    GraphInfo,
    OnMessage,
    OnReply,
    OnRequest,
    Publisher,
    Qos,
    Reply,
    ServiceClient,
    ServiceServer,
    Subscription,
    TypeSource,
    ended_for_good,
    incompatibility,
    settled_graph,
)
from rosplc.ros.choice import BACKENDS, INSTALL, ROS1, Choice, choose, load
from rosplc.ros.goals import GoalStatus

__all__ = [
    "BACKENDS", "DEFAULT", "INSTALL", "LATCHED", "PRESETS", "ROS1", "SENSOR_DATA", "SERVICES",
    "ActionClient", "ActionServer", "Backend", "Choice", "Endpoint", "EndpointInfo", "EndpointStatus",
    "GoalEvent", "GoalStatus", "GraphInfo", "OnMessage", "OnReply", "OnRequest", "Publisher", "Qos",
    "Remapping", "Reply", "RosArguments", "ServiceClient", "ServiceServer", "Subscription", "TypeSource",
    "action_classes", "choose", "ended_for_good", "incompatibility", "open_backend", "settled_graph",
    "split_arguments",
]  # fmt: skip


def open_backend(
    name: str,
    store: TypeStore,
    node_name: str,
    namespace: str = "/",
    domain: int | None = None,
    *,
    remap: Mapping[str, str] | None = None,
    environment: Mapping[str, str] | None = None,
    options: Mapping[str, object] | None = None,
    clock: Clock = SYSTEM,
) -> Backend:
    """Connect to the ROS graph as one node.

    ``name`` is one of :data:`BACKENDS`, or ``auto`` (:func:`choose`; the result is the backend's ``name``);
    ``domain`` None means ``ROS_DOMAIN_ID`` from the environment, otherwise 0; ``remap`` maps topic → topic
    (:func:`rosplc.ros.names.resolve_topic`); ``environment`` replaces the process's own variables;
    ``options`` are the backend's own configuration keys, such as those of ``ros.zenoh``.

    Raises BackendError: ROS001 if the backend is unknown or its package is missing, ROS002 if the middleware
    refuses, ROS005 if a name breaks a rule.
    """
    if name != "auto" and name not in BACKENDS:
        raise BackendError("ROS001", f"unknown backend {name!r}; use one of auto, {', '.join(BACKENDS)}")
    if name == "auto":
        name = choose(store.distro, environment, zenoh_settings=bool(options)).name
    try:
        module = load(name)
    except ImportError as error:
        what = f"the package for the {name} backend cannot be imported: {error}"
        remedy = f"For {name}: {INSTALL.get(name, 'a complete rosplc')}."
        raise BackendError("ROS001", what, remedy=remedy) from error
    others = {"remap": remap, "environment": environment, "options": options, "clock": clock}
    backend: Backend = module.open_backend(store, node_name, namespace, domain, **others)
    return backend


def action_classes(store: TypeStore) -> tuple[type[ActionServer], type[ActionClient]]:
    """Return the classes of an action's server and client for the ROS version of the types."""
    return (ActionlibServer, ActionlibClient) if store.distro == ROS1 else (ActionServer, ActionClient)
