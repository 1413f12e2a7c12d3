"""The ROS side: one narrow interface, one module per middleware behind it."""

from __future__ import annotations

from collections.abc import Mapping

from rosplc.clock import SYSTEM, Clock
from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.ros.actionlib import ActionlibClient, ActionlibServer
from rosplc.ros.actions import ActionClient as ActionClient
from rosplc.ros.actions import ActionServer as ActionServer
from rosplc.ros.actions import GoalEvent as GoalEvent
from rosplc.ros.actions import GoalStatus as GoalStatus
from rosplc.ros.arguments import Remapping as Remapping
from rosplc.ros.arguments import RosArguments as RosArguments
from rosplc.ros.arguments import split_arguments as split_arguments
from rosplc.ros.backend import DEFAULT as DEFAULT
from rosplc.ros.backend import LATCHED as LATCHED
from rosplc.ros.backend import PRESETS as PRESETS
from rosplc.ros.backend import SENSOR_DATA as SENSOR_DATA
from rosplc.ros.backend import SERVICES as SERVICES
from rosplc.ros.backend import Backend as Backend
from rosplc.ros.backend import Endpoint as Endpoint
from rosplc.ros.backend import EndpointInfo as EndpointInfo
from rosplc.ros.backend import EndpointStatus as EndpointStatus
from rosplc.ros.backend import GraphInfo as GraphInfo
from rosplc.ros.backend import OnMessage as OnMessage
from rosplc.ros.backend import OnReply as OnReply
from rosplc.ros.backend import OnRequest as OnRequest
from rosplc.ros.backend import Publisher as Publisher
from rosplc.ros.backend import Qos as Qos
from rosplc.ros.backend import Reply as Reply
from rosplc.ros.backend import ServiceClient as ServiceClient
from rosplc.ros.backend import ServiceServer as ServiceServer
from rosplc.ros.backend import Subscription as Subscription
from rosplc.ros.backend import TypeSource as TypeSource
from rosplc.ros.backend import ended_for_good as ended_for_good
from rosplc.ros.backend import incompatibility as incompatibility
from rosplc.ros.backend import settled_graph as settled_graph
from rosplc.ros.choice import BACKENDS as BACKENDS
from rosplc.ros.choice import INSTALL as INSTALL
from rosplc.ros.choice import ROS1 as ROS1
from rosplc.ros.choice import Choice as Choice
from rosplc.ros.choice import choose as choose
from rosplc.ros.choice import load


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

    ``name`` is one of :data:`BACKENDS`, or ``auto`` (:func:`choose`; the backend's ``name`` is the outcome);
    ``domain`` None is ``ROS_DOMAIN_ID`` of the environment, else 0; ``remap`` maps topic → topic
    (:func:`rosplc.ros.names.resolve_topic`); ``environment`` has variables in place of the process's own;
    ``options`` are the backend's own keys of the configuration, such as ``ros.zenoh``.

    Raises BackendError: ROS001 if the backend is unknown or its package is missing, ROS002 if the middleware
    refuses, ROS005 if a name breaks a rule.
    """
    if name != "auto" and name not in BACKENDS:
        raise BackendError("ROS001", f"there is no backend {name!r}; there are: auto, {', '.join(BACKENDS)}")
    if name == "auto":
        name = choose(store.distro, environment, zenoh_settings=bool(options)).name
    try:
        module = load(name)
    except ImportError as error:
        what = f"the package of backend {name} is not installed: {error}"
        remedy = f"For {name}: {INSTALL.get(name, 'a complete rosplc')}."
        raise BackendError("ROS001", what, remedy=remedy) from error
    others = {"remap": remap, "environment": environment, "options": options, "clock": clock}
    backend: Backend = module.open_backend(store, node_name, namespace, domain, **others)
    return backend


def action_classes(store: TypeStore) -> tuple[type[ActionServer], type[ActionClient]]:
    """Return the classes of an action's server and client, for the ROS that the types are of."""
    return (ActionlibServer, ActionlibClient) if store.distro == ROS1 else (ActionServer, ActionClient)
