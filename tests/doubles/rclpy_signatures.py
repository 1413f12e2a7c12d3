"""rclpy's signatures, written down from its sources; the double and an installed rclpy are held to them.

Read with ``ast`` from https://github.com/ros2/rclpy, ``rclpy/rclpy/*.py``: branch humble at 3.3.15
(b488272b), jazzy at 7.1.3 (85415f71), rolling at 8.0.0 (ba72a017, December 2024, on the way to
Kilted). Annotations are left out, defaults that are no plain values are ``...``. What is written in
C++ there (handles) is at the end, from ``rclpy/src/rclpy/*.cpp``.
"""

from __future__ import annotations

# ruff: noqa: E501 - one signature per line reads as a table

EVERY: dict[str, str] = {
    "rclpy.callback_groups:MutuallyExclusiveCallbackGroup.__init__": "(self)",
    "rclpy.context:Context.__init__": "(self)",
    "rclpy.context:Context.get_domain_id": "(self)",
    "rclpy.context:Context.init": "(self, args=None, *, initialize_logging=True, domain_id=None)",
    "rclpy.context:Context.ok": "(self)",
    "rclpy.context:Context.on_shutdown": "(self, callback)",
    "rclpy.context:Context.shutdown": "(self)",
    "rclpy.context:Context.try_shutdown": "(self)",
    "rclpy.executors:Executor.__init__": "(self, *, context=None)",
    "rclpy.executors:Executor.add_node": "(self, node)",
    "rclpy.executors:Executor.can_execute": "(self, entity)",
    "rclpy.executors:Executor.context": "property",
    "rclpy.executors:Executor.create_task": "(self, callback, *args, **kwargs)",
    "rclpy.executors:Executor.get_nodes": "(self)",
    "rclpy.executors:Executor.remove_node": "(self, node)",
    "rclpy.executors:Executor.shutdown": "(self, timeout_sec=None)",
    "rclpy.executors:Executor.spin": "(self)",
    "rclpy.executors:Executor.spin_once": "(self, timeout_sec=None)",
    "rclpy.executors:Executor.wait_for_ready_callbacks": "(self, *args, **kwargs)",
    "rclpy.executors:Executor.wake": "(self)",
    "rclpy.executors:SingleThreadedExecutor.__init__": "(self, *, context=None)",
    "rclpy.executors:SingleThreadedExecutor.spin_once": "(self, timeout_sec=None)",
    "rclpy.lifecycle.node:LifecycleNode.__init__": "(self, node_name, *, enable_communication_interface=True, **kwargs)",
    "rclpy.lifecycle.node:LifecycleNodeMixin.on_activate": "(self, state)",
    "rclpy.lifecycle.node:LifecycleNodeMixin.on_cleanup": "(self, state)",
    "rclpy.lifecycle.node:LifecycleNodeMixin.on_configure": "(self, state)",
    "rclpy.lifecycle.node:LifecycleNodeMixin.on_deactivate": "(self, state)",
    "rclpy.lifecycle.node:LifecycleNodeMixin.on_error": "(self, state)",
    "rclpy.lifecycle.node:LifecycleNodeMixin.on_shutdown": "(self, state)",
    "rclpy.lifecycle.node:LifecycleNodeMixin.trigger_activate": "(self)",
    "rclpy.lifecycle.node:LifecycleNodeMixin.trigger_cleanup": "(self)",
    "rclpy.lifecycle.node:LifecycleNodeMixin.trigger_configure": "(self)",
    "rclpy.lifecycle.node:LifecycleNodeMixin.trigger_deactivate": "(self)",
    "rclpy.lifecycle.node:LifecycleNodeMixin.trigger_shutdown": "(self)",
    "rclpy.node:Node.add_on_set_parameters_callback": "(self, callback)",
    "rclpy.node:Node.context": "property",
    "rclpy.client:Client.call_async": "(self, request)",
    "rclpy.client:Client.get_pending_request": "(self, sequence_number)",
    "rclpy.client:Client.handle": "property",
    "rclpy.client:Client.remove_pending_request": "(self, future)",
    "rclpy.client:Client.service_is_ready": "(self)",
    "rclpy.node:Node.create_client": "(self, srv_type, srv_name, *, qos_profile=..., callback_group=None)",
    "rclpy.node:Node.create_publisher": "(self, msg_type, topic, qos_profile, *, callback_group=None, event_callbacks=None, qos_overriding_options=None, publisher_class=...)",
    "rclpy.node:Node.create_service": "(self, srv_type, srv_name, callback, *, qos_profile=..., callback_group=None)",
    "rclpy.node:Node.create_subscription": "(self, msg_type, topic, callback, qos_profile, *, callback_group=None, event_callbacks=None, qos_overriding_options=None, raw=False)",
    "rclpy.node:Node.default_callback_group": "property",
    "rclpy.node:Node.destroy_client": "(self, client)",
    "rclpy.node:Node.destroy_node": "(self)",
    "rclpy.node:Node.destroy_publisher": "(self, publisher)",
    "rclpy.node:Node.destroy_service": "(self, service)",
    "rclpy.node:Node.destroy_subscription": "(self, subscription)",
    "rclpy.node:Node.executor": "property",
    "rclpy.node:Node.get_fully_qualified_name": "(self)",
    "rclpy.node:Node.get_logger": "(self)",
    "rclpy.node:Node.get_name": "(self)",
    "rclpy.node:Node.get_namespace": "(self)",
    "rclpy.node:Node.get_parameter": "(self, name)",
    "rclpy.node:Node.get_publishers_info_by_topic": "(self, topic_name, no_mangle=False)",
    "rclpy.node:Node.get_subscriptions_info_by_topic": "(self, topic_name, no_mangle=False)",
    "rclpy.node:Node.get_topic_names_and_types": "(self, no_demangle=False)",
    "rclpy.node:Node.has_parameter": "(self, name)",
    "rclpy.node:Node.resolve_service_name": "(self, service, *, only_expand=False)",
    "rclpy.node:Node.resolve_topic_name": "(self, topic, *, only_expand=False)",
    "rclpy.node:Node.set_parameters": "(self, parameter_list)",
    "rclpy.node:Node.undeclare_parameter": "(self, name)",
    "rclpy.publisher:Publisher.get_subscription_count": "(self)",
    "rclpy.publisher:Publisher.handle": "property",
    "rclpy.publisher:Publisher.publish": "(self, msg)",
    "rclpy.publisher:Publisher.topic_name": "property",
    "rclpy.qos:qos_check_compatible": "(publisher_qos, subscription_qos)",
    "rclpy.qos:qos_policy_name_from_kind": "(policy_kind)",
    "rclpy.serialization:deserialize_message": "(serialized_message, message_type)",
    "rclpy.serialization:serialize_message": "(message)",
    "rclpy.service:Service.handle": "property",
    "rclpy.service:Service.send_response": "(self, response, header)",
    "rclpy.subscription:Subscription.handle": "property",
    "rclpy.subscription:Subscription.topic_name": "property",
    "rclpy.task:Future.add_done_callback": "(self, callback)",
    "rclpy.task:Future.done": "(self)",
    "rclpy.task:Future.result": "(self)",
    "rclpy.task:Future.set_result": "(self, result)",
    "rclpy.topic_endpoint_info:TopicEndpointInfo.endpoint_gid": "property",
    "rclpy.topic_endpoint_info:TopicEndpointInfo.endpoint_type": "property",
    "rclpy.topic_endpoint_info:TopicEndpointInfo.node_name": "property",
    "rclpy.topic_endpoint_info:TopicEndpointInfo.node_namespace": "property",
    "rclpy.topic_endpoint_info:TopicEndpointInfo.qos_profile": "property",
    "rclpy.topic_endpoint_info:TopicEndpointInfo.topic_type": "property",
    "rclpy.utilities:get_default_context": "(*, shutting_down=False)",
    "rclpy:init": "(*, args=None, context=None, domain_id=None, signal_handler_options=None)",
    "rclpy:shutdown": "(*, context=None, uninstall_handlers=None)",
    "rclpy:spin": "(node, executor=None)",
}
"""``module:qualified name`` → signature, or ``property``; alike in all three."""

DIFFERENT: dict[str, dict[str, str]] = {
    "rclpy:try_shutdown": {
        "humble": "(*, context=None)",
        "jazzy": "(*, context=None)",
        "rolling": "(*, context=None, uninstall_handlers=None)",
    },
    "rclpy.event_handler:PublisherEventCallbacks.__init__": {
        "jazzy": "(self, *, deadline=None, liveliness=None, incompatible_qos=None, incompatible_type=None, matched=None, use_default_callbacks=True)",
        "rolling": "(self, *, deadline=None, liveliness=None, incompatible_qos=None, incompatible_type=None, matched=None, use_default_callbacks=True)",
    },
    "rclpy.event_handler:SubscriptionEventCallbacks.__init__": {
        "jazzy": "(self, *, deadline=None, incompatible_qos=None, liveliness=None, message_lost=None, incompatible_type=None, matched=None, use_default_callbacks=True)",
        "rolling": "(self, *, deadline=None, incompatible_qos=None, liveliness=None, message_lost=None, incompatible_type=None, matched=None, use_default_callbacks=True)",
    },
    "rclpy.node:Node.__init__": {
        "humble": "(self, node_name, *, context=None, cli_args=None, namespace=None, use_global_arguments=True, enable_rosout=True, start_parameter_services=True, parameter_overrides=None, allow_undeclared_parameters=False, automatically_declare_parameters_from_overrides=False)",
        "jazzy": "(self, node_name, *, context=None, cli_args=None, namespace=None, use_global_arguments=True, enable_rosout=True, start_parameter_services=True, parameter_overrides=None, allow_undeclared_parameters=False, automatically_declare_parameters_from_overrides=False, enable_logger_service=False)",
        "rolling": "(self, node_name, *, context=None, cli_args=None, namespace=None, use_global_arguments=True, enable_rosout=True, start_parameter_services=True, parameter_overrides=None, allow_undeclared_parameters=False, automatically_declare_parameters_from_overrides=False, enable_logger_service=False)",
    },
    "rclpy.node:Node.declare_parameter": {
        "humble": "(self, name, value=None, descriptor=None, ignore_override=False)",
        "jazzy": "(self, name, value=None, descriptor=None, ignore_override=False)",
        "rolling": "(self, name, value, descriptor=None, ignore_override=False)",
    },
    "rclpy.parameter:Parameter.__init__": {
        "humble": "(self, name, type_=None, value=None)",
        "jazzy": "(self, name, type_=None, value=None)",
    },
    "rclpy.qos:QoSProfile.__init__": {
        "humble": "(self, **kwargs)",
        "jazzy": "(self, **kwargs)",
        "rolling": "(self, history=None, depth=None, reliability=None, durability=None, lifespan=None, deadline=None, liveliness=None, liveliness_lease_duration=None, avoid_ros_namespace_conventions=None)",
    },
    "rclpy.qos_event:PublisherEventCallbacks.__init__": {
        "humble": "(self, *, deadline=None, liveliness=None, incompatible_qos=None, use_default_callbacks=True)",
    },
    "rclpy.qos_event:SubscriptionEventCallbacks.__init__": {
        "humble": "(self, *, deadline=None, incompatible_qos=None, liveliness=None, message_lost=None, use_default_callbacks=True)",
    },
    "rclpy.subscription:Subscription.get_publisher_count": {
        "jazzy": "(self)",
        "rolling": "(self)",
    },
    "rclpy.topic_endpoint_info:TopicEndpointInfo.__init__": {
        "humble": "(self, **kwargs)",
        "jazzy": "(self, **kwargs)",
        "rolling": "(self, node_name='', node_namespace='', topic_type='', topic_type_hash=..., endpoint_type=..., endpoint_gid=[], qos_profile=...)",
    },
    "rclpy.topic_endpoint_info:TopicEndpointInfo.topic_type_hash": {
        "jazzy": "property",
        "rolling": "property",
    },
    "rclpy.type_hash:TypeHash.__init__": {
        "jazzy": "(self, version=-1, value=...)",
        "rolling": "(self, version=-1, value=...)",
    },
    "rclpy.type_hash:TypeHash.__str__": {
        "jazzy": "(self)",
        "rolling": "(self)",
    },
}
"""The same where they differ; a distribution that is not named has no such thing."""

ALSO: dict[str, frozenset[str]] = {
    "rclpy.context:Context": frozenset({"handle", "destroy"}),
    "rclpy.node:Node": frozenset(
        {
            "publishers",
            "subscriptions",
            "services",
            "clients",
            "waitables",
            "guards",
            "timers",
            "handle",
            "get_node_names_and_namespaces",
        }
    ),
    "rclpy.callback_groups:MutuallyExclusiveCallbackGroup": frozenset(
        {"entities", "add_entity", "can_execute", "beginning_execution", "ending_execution"}
    ),
    "rclpy.event_handler:PublisherEventCallbacks": frozenset({"create_event_handlers"}),
    "rclpy.event_handler:SubscriptionEventCallbacks": frozenset({"create_event_handlers"}),
    "rclpy.qos_event:PublisherEventCallbacks": frozenset({"create_event_handlers"}),
    "rclpy.qos_event:SubscriptionEventCallbacks": frozenset({"create_event_handlers"}),
    "rclpy.publisher:Publisher": frozenset({"destroy"}),
    "rclpy.client:Client": frozenset({"destroy"}),
    "rclpy.service:Service": frozenset({"destroy"}),
    "rclpy.subscription:Subscription": frozenset({"destroy", "callback", "CallbackType"}),
    "rclpy.parameter:Parameter": frozenset({"Type", "name", "type_", "value"}),
}
"""Other public names of these classes in all three, that the double has too."""

BASES: dict[str, tuple[str, ...]] = {
    "rclpy.executors:SingleThreadedExecutor": ("rclpy.executors:Executor",),
    "rclpy.lifecycle.node:LifecycleNode": ("rclpy.lifecycle.node:LifecycleNodeMixin", "rclpy.node:Node"),
}
"""Class → the classes that it inherits from."""

HANDLES: dict[str, frozenset[str]] = {
    "subscription": frozenset({"take_message", "destroy_when_not_in_use", "pointer"}),
    "publisher": frozenset({"publish_raw", "destroy_when_not_in_use"}),
    "wait set": frozenset(
        {
            *("clear_entities", "add_subscription", "add_guard_condition", "add_timer", "add_client"),
            *("add_service", "add_event", "wait", "is_ready", "get_ready_entities"),
        }
    ),
}
"""Methods of the C++ handles: ``take_message(pymsg_type, raw)`` gives None or (message, info), where
info has ``source_timestamp`` and ``received_timestamp`` in ns (subscription.cpp); ``publish_raw(msg)``
takes bytes (publisher.cpp); both are context managers that raise InvalidHandle (destroyable.cpp). A wait
set is made for numbers of subscriptions, guard conditions, timers, clients, services and events, and a context's
handle; ``add_…`` takes a handle, ``wait`` a time in ns, ``get_ready_entities`` a kind (wait_set.cpp)."""
