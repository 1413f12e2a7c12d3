"""rclpy/node.py."""

from __future__ import annotations

import re
import weakref
from collections.abc import Callable, Iterator
from typing import Any

from rclpy import _graph
from rclpy._distro import HUMBLE
from rclpy._handles import Destroyable, RCLError
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.client import Client
from rclpy.client import Handle as _ClientHandle
from rclpy.exceptions import (
    InvalidNamespaceException,
    InvalidNodeNameException,
    InvalidTopicNameException,
    NotInitializedException,
    ParameterAlreadyDeclaredException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
)
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, discovered
from rclpy.service import Service
from rclpy.service import _Handle as _ServiceHandle
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo, TopicEndpointTypeEnum

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")


class _Handle(Destroyable):
    """A publisher's or subscription's handle (src/rclpy/publisher.cpp, src/rclpy/subscription.cpp)."""

    def __init__(self, endpoint: _graph.Endpoint) -> None:
        super().__init__(endpoint.leave)
        self.endpoint = endpoint

    def _ready(self) -> bool:
        return bool(self.endpoint.waiting)

    def publish_raw(self, msg: bytes) -> None:
        if _graph.unsupported & {"publish"}:  # a test lets publishing fail
            raise RCLError("Failed to publish: test")
        self.endpoint.send(msg)

    def take_message(self, pymsg_type: Any, raw: bool) -> Any:
        assert raw, "the double hands over raw bytes only"
        with _graph.changed:
            taken = self.endpoint.waiting.popleft() if self.endpoint.waiting else None
        if taken is not None and not taken[0]:  # as rmw_cyclonedds, which makes no room for nothing
            raise RCLError("failed to take raw message from subscription")
        return taken


class Node:
    if HUMBLE:

        def __init__(
            self,
            node_name: str,
            *,
            context: Any = None,
            cli_args: list[str] | None = None,
            namespace: str | None = None,
            use_global_arguments: bool = True,
            enable_rosout: bool = True,
            start_parameter_services: bool = True,
            parameter_overrides: Any = None,
            allow_undeclared_parameters: bool = False,
            automatically_declare_parameters_from_overrides: bool = False,
        ) -> None:
            self._start(node_name, context, namespace, parameter_overrides)

    else:

        def __init__(
            self,
            node_name: str,
            *,
            context: Any = None,
            cli_args: list[str] | None = None,
            namespace: str | None = None,
            use_global_arguments: bool = True,
            enable_rosout: bool = True,
            start_parameter_services: bool = True,
            parameter_overrides: Any = None,
            allow_undeclared_parameters: bool = False,
            automatically_declare_parameters_from_overrides: bool = False,
            enable_logger_service: bool = False,
        ) -> None:
            self._start(node_name, context, namespace, parameter_overrides)

    def _start(self, node_name: str, context: Any, namespace: str | None, overrides: Any) -> None:
        if context is None:
            from rclpy.utilities import get_default_context

            context = get_default_context()
        if not context.ok():
            raise NotInitializedException("cannot create node")
        self._context = context
        self._rules = _rules(context._arguments)
        name, namespace = self._rules.get("__node", node_name), self._rules.get("__ns", namespace or "/")
        if not _NAME.match(name):
            raise InvalidNodeNameException(name)
        namespace = namespace if namespace.startswith("/") else f"/{namespace}"
        if namespace != "/" and not all(map(_NAME.match, namespace[1:].split("/"))):
            raise InvalidNamespaceException(namespace)
        self._name, self._namespace = name, namespace
        self._publishers: list[Publisher] = []
        self._subscriptions: list[Subscription] = []
        self._services: list[Service] = []
        self._clients: list[Client] = []
        self.__waitables: list[Any] = []
        self._default_callback_group = MutuallyExclusiveCallbackGroup()
        self._parameters: dict[str, Parameter] = {}
        self._descriptors: dict[str, Any] = {}
        self._overrides = {one.name: one for one in overrides or ()} | _overrides(context._arguments)
        self._on_set: list[Callable[[list[Parameter]], Any]] = []
        self._executor: Any = lambda: None
        with _graph.changed:
            _graph.nodes.setdefault(context.get_domain_id(), []).append((name, namespace))
        self._alive = True

    # -- names

    def get_name(self) -> str:
        return str(self._name)

    def get_namespace(self) -> str:
        return str(self._namespace)

    def get_fully_qualified_name(self) -> str:
        return f"{self._namespace.rstrip('/')}/{self._name}"

    def get_logger(self) -> Any:
        from rclpy.logging import get_logger

        return get_logger(self._name)

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        if topic.startswith("~"):
            topic = self.get_fully_qualified_name() + topic[1:]
        elif not topic.startswith("/"):
            topic = f"{self._namespace.rstrip('/')}/{topic}"
        if not all(map(_NAME.match, topic[1:].split("/"))):
            raise InvalidTopicNameException(topic)
        rules = {} if only_expand else {s: t for s, t in self._rules.items() if not s.startswith("__")}
        for source, target in rules.items():
            if self.resolve_topic_name(source, only_expand=True) == topic:
                return self.resolve_topic_name(target, only_expand=True)
        return topic

    def resolve_service_name(self, service: str, *, only_expand: bool = False) -> str:
        return self.resolve_topic_name(service, only_expand=only_expand)

    # -- entities

    @property
    def context(self) -> Any:
        return self._context

    @property
    def default_callback_group(self) -> Any:
        return self._default_callback_group

    @property
    def executor(self) -> Any:
        return self._executor()

    @executor.setter
    def executor(self, new_executor: Any) -> None:
        if self.executor is new_executor:
            return
        if self.executor is not None:
            self.executor.remove_node(self)
        self._executor = (lambda: None) if new_executor is None else weakref.ref(new_executor)
        if new_executor is not None:
            new_executor.add_node(self)

    @property
    def publishers(self) -> Iterator[Publisher]:
        yield from self._publishers

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        yield from self._subscriptions

    @property
    def services(self) -> Iterator[Service]:
        yield from self._services

    @property
    def clients(self) -> Iterator[Client]:
        yield from self._clients

    @property
    def guards(self) -> Iterator[Any]:
        yield from ()

    @property
    def timers(self) -> Iterator[Any]:
        yield from ()

    @property
    def waitables(self) -> Iterator[Any]:
        yield from self.__waitables

    def _handle(self, msg_type: Any, topic: str, profile: Any, publishes: bool) -> _Handle:
        if not self._alive:
            raise RuntimeError("cannot use Destroyable because destruction was requested")
        if msg_type.__class__._TYPE_SUPPORT is None:
            msg_type.__class__.__import_type_support__()
        return _Handle(self._endpoint(msg_type, self.resolve_topic_name(topic), profile, publishes))

    def _endpoint(self, msg_type: Any, topic: str, profile: Any, publishes: bool) -> _graph.Endpoint:
        package, kind, name = (type_name := msg_type._double_name).split("/")
        return _graph.Endpoint(
            self._context.get_domain_id(),
            topic,
            publishes,
            type_name if topic.startswith("/") else f"{package}::{kind}::dds_::{name}_",
            msg_type._double_hash,
            profile,
            self._name,
            self._namespace,
        )

    def _service_endpoints(self, srv_type: Any, name: str, profile: Any, serves: bool) -> list[Any]:
        """Return the reader and the writer of a service's two topics."""
        if not self._alive:
            raise RuntimeError("cannot use Destroyable because destruction was requested")
        full = self.resolve_service_name(name)
        request = self._endpoint(srv_type.Request, f"rq{full}Request", profile, not serves)
        response = self._endpoint(srv_type.Response, f"rr{full}Reply", profile, serves)
        return [request, response] if serves else [response, request]

    def create_service(
        self,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        *,
        qos_profile: Any = QoSProfile(depth=10),  # noqa: B008
        callback_group: Any = None,
    ) -> Any:
        group = callback_group or self.default_callback_group
        handle = _ServiceHandle(*self._service_endpoints(srv_type, srv_name, qos_profile, True))
        service = Service(handle, srv_type, srv_name, callback, group, qos_profile)
        return self._adopt_service(self._services, service)

    def create_client(
        self,
        srv_type: Any,
        srv_name: str,
        *,
        qos_profile: Any = QoSProfile(depth=10),  # noqa: B008
        callback_group: Any = None,
    ) -> Any:
        group = callback_group or self.default_callback_group
        handle = _ClientHandle(*self._service_endpoints(srv_type, srv_name, qos_profile, False))
        client = Client(self.context, handle, srv_type, srv_name, qos_profile, group)
        return self._adopt_service(self._clients, client)

    def _adopt_service(self, where: list[Any], entity: Any) -> Any:
        entity.callback_group.add_entity(entity)
        with _graph.changed:
            where.append(entity)
            entity.handle.join()
        self._wake_executor()
        return entity

    def _wake_executor(self) -> None:
        if self.executor is not None:
            self.executor.wake()

    def _destroy_service(self, where: list[Any], entity: Any) -> bool:
        with _graph.changed:
            if entity not in where:
                return False
            where.remove(entity)
            entity.destroy()
            self._wake_executor()
            return True

    def destroy_service(self, service: Any) -> bool:
        return self._destroy_service(self._services, service)

    def destroy_client(self, client: Any) -> bool:
        return self._destroy_service(self._clients, client)

    def create_publisher(
        self,
        msg_type: Any,
        topic: str,
        qos_profile: Any,
        *,
        callback_group: Any = None,
        event_callbacks: Any = None,
        qos_overriding_options: Any = None,
        publisher_class: Any = Publisher,
    ) -> Any:
        callback_group = callback_group or self.default_callback_group
        handle = self._handle(msg_type, topic, _profile(qos_profile), True)
        publisher = publisher_class(
            handle,
            msg_type,
            topic,
            qos_profile,
            event_callbacks=event_callbacks or _publisher_events(),
            callback_group=callback_group,
        )
        self._adopt(self._publishers, publisher)
        return publisher

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        qos_profile: Any,
        *,
        callback_group: Any = None,
        event_callbacks: Any = None,
        qos_overriding_options: Any = None,
        raw: bool = False,
    ) -> Any:
        callback_group = callback_group or self.default_callback_group
        handle = self._handle(msg_type, topic, _profile(qos_profile), False)
        subscription = Subscription(
            handle,
            msg_type,
            topic,
            callback,
            callback_group,
            qos_profile,
            raw,
            event_callbacks=event_callbacks or _subscription_events(),
        )
        callback_group.add_entity(subscription)
        self._adopt(self._subscriptions, subscription)
        return subscription

    def _adopt(self, where: list[Any], entity: Any) -> None:
        with _graph.changed:
            where.append(entity)
            self.__waitables.extend(entity.event_handlers)
            entity.handle.endpoint.join()
        self._wake_executor()

    def _destroy(self, where: list[Any], entity: Any) -> bool:
        with _graph.changed:
            if entity not in where:
                return False
            where.remove(entity)
            for handler in entity.event_handlers:
                self.__waitables.remove(handler)
            entity.destroy()
            self._wake_executor()
            return True

    def destroy_publisher(self, publisher: Any) -> bool:
        return self._destroy(self._publishers, publisher)

    def destroy_subscription(self, subscription: Any) -> bool:
        return self._destroy(self._subscriptions, subscription)

    def destroy_node(self) -> None:
        while self._publishers:
            self.destroy_publisher(self._publishers[0])
        while self._subscriptions:
            self.destroy_subscription(self._subscriptions[0])
        while self._services:
            self.destroy_service(self._services[0])
        while self._clients:
            self.destroy_client(self._clients[0])
        with _graph.changed:
            if self._alive:
                _graph.nodes[self._context.get_domain_id()].remove((self._name, self._namespace))
            self._alive = False

    # -- the graph

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        with _graph.changed:
            return list(_graph.nodes.get(self._context.get_domain_id(), ()))

    def get_topic_names_and_types(self, no_demangle: bool = False) -> list[tuple[str, list[str]]]:
        found: dict[str, set[str]] = {}
        with _graph.changed:
            for (domain, topic), here in _graph.endpoints.items():
                if domain == self._context.get_domain_id() and (no_demangle or topic.startswith("/")):
                    found.setdefault(topic, set()).update(endpoint.type_name for endpoint in here)
        return [(topic, sorted(kinds)) for topic, kinds in sorted(found.items())]

    def get_publishers_info_by_topic(self, topic_name: str, no_mangle: bool = False) -> list[Any]:
        return self._infos(topic_name, True, no_mangle)

    def get_subscriptions_info_by_topic(self, topic_name: str, no_mangle: bool = False) -> list[Any]:
        return self._infos(topic_name, False, no_mangle)

    def _infos(self, topic: str, publishers: bool, no_mangle: bool) -> list[Any]:
        key = (self._context.get_domain_id(), topic if no_mangle else self.resolve_topic_name(topic))
        with _graph.changed:
            here = [e for e in _graph.endpoints.get(key, ()) if e.publishes == publishers]
        return [_info(endpoint) for endpoint in here]

    # -- parameters

    def declare_parameter(
        self, name: str, value: Any = None, descriptor: Any = None, ignore_override: bool = False
    ) -> Parameter:
        if name in self._parameters:
            raise ParameterAlreadyDeclaredException(name)
        if not ignore_override and name in self._overrides:
            value = self._overrides[name].value
        self._descriptors[name] = descriptor
        parameter = Parameter(name, value=value)
        self._check([parameter])
        self._parameters[name] = parameter
        return parameter

    def undeclare_parameter(self, name: str) -> None:
        if name not in self._parameters:
            raise ParameterNotDeclaredException(name)
        if getattr(self._descriptors[name], "read_only", False):
            raise ParameterImmutableException(name)
        del self._parameters[name], self._descriptors[name]

    def has_parameter(self, name: str) -> bool:
        return name in self._parameters

    def get_parameter(self, name: str) -> Parameter:
        if name not in self._parameters:
            raise ParameterNotDeclaredException(name)
        return self._parameters[name]

    def set_parameters(self, parameter_list: list[Parameter]) -> list[Any]:
        from rcl_interfaces.msg import SetParametersResult

        results = []
        for parameter in parameter_list:
            if parameter.name not in self._parameters:
                raise ParameterNotDeclaredException(parameter.name)
            if getattr(self._descriptors[parameter.name], "read_only", False):
                results.append(SetParametersResult(successful=False, reason="cannot be set: read-only"))
                continue
            result = self._check([parameter])
            if result.successful:
                self._parameters[parameter.name] = parameter
            results.append(result)
        return results

    def _check(self, parameters: list[Parameter]) -> Any:
        from rcl_interfaces.msg import SetParametersResult

        for callback in self._on_set:
            if not (result := callback(parameters)).successful:
                return result
        return SetParametersResult(successful=True)

    def add_on_set_parameters_callback(self, callback: Callable[[list[Parameter]], Any]) -> None:
        self._on_set.insert(0, callback)


def _profile(qos: Any) -> Any:
    from rclpy.qos import QoSProfile

    assert isinstance(qos, QoSProfile), "the backend gives whole profiles"
    return qos


def _publisher_events() -> Any:
    from rclpy._events import PublisherEventCallbacks

    return PublisherEventCallbacks()


def _subscription_events() -> Any:
    from rclpy._events import SubscriptionEventCallbacks

    return SubscriptionEventCallbacks()


def _info(endpoint: _graph.Endpoint) -> TopicEndpointInfo:
    values = {
        "node_name": endpoint.node_name,
        "node_namespace": endpoint.node_namespace,
        "topic_type": endpoint.type_name,
        "endpoint_type": (
            TopicEndpointTypeEnum.PUBLISHER if endpoint.publishes else TopicEndpointTypeEnum.SUBSCRIPTION
        ),
        "endpoint_gid": list(endpoint.number.to_bytes(16, "little")),
        "qos_profile": discovered(endpoint.profile),
    }
    if not HUMBLE:
        from rclpy.type_hash import TypeHash

        known = endpoint.type_hash.startswith("RIHS01_")
        values["topic_type_hash"] = (
            TypeHash(1, bytes.fromhex(endpoint.type_hash[7:])) if known else TypeHash()
        )
    return TopicEndpointInfo(**values)


def _rules(arguments: list[str]) -> dict[str, str]:
    pairs = zip(arguments[::2], arguments[1::2], strict=True)
    rules = [value.split(":=") for word, value in pairs if word in ("-r", "--remap")]
    return dict(rules)


def _overrides(arguments: list[str]) -> dict[str, Parameter]:
    pairs = zip(arguments[::2], arguments[1::2], strict=True)
    given = [value.split(":=") for word, value in pairs if word in ("-p", "--param")]
    return {name: Parameter(name, value=value) for name, value in given}
