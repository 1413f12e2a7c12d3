"""The middleware's events of an endpoint: settings or types that do not fit, messages lost.

Which events there are depends on the version of rclpy and on the middleware, and one that is not
supported keeps an endpoint from being created. So the events are asked for from many to few.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from typing import Any

try:
    from rclpy.event_handler import (
        PublisherEventCallbacks,
        SubscriptionEventCallbacks,
        UnsupportedEventTypeError,
    )
except ImportError:  # ROS 2 Humble
    from rclpy.qos_event import (
        PublisherEventCallbacks,
        SubscriptionEventCallbacks,
        UnsupportedEventTypeError,
    )

from rosplc.ros.rclpy.endpoint import RclpyPublisher, RclpySubscription

__all__ = ["create"]

Endpoint = RclpySubscription | RclpyPublisher

_SETS = (
    ("incompatible_qos", "incompatible_type", "message_lost"),
    ("incompatible_qos", "incompatible_type"),
    (),
)


def create(make: Callable[..., Any], endpoint: Endpoint, look: Callable[[Endpoint], None]) -> Any:
    """Create an entity with as many events as the middleware supports.

    Args:
        make: ``create_subscription`` or ``create_publisher`` with all but ``event_callbacks``.
        endpoint: Whose entity it is.
        look: Called when a peer does not fit.

    Raises:
        Exception: Whatever rclpy raises.
    """
    for callbacks in _callbacks(endpoint, look):
        try:
            return make(event_callbacks=callbacks)
        except UnsupportedEventTypeError:
            continue
    raise AssertionError("an endpoint without events needs no support")


def _callbacks(endpoint: Endpoint, look: Callable[[Endpoint], None]) -> Iterator[Any]:
    def misfit(_event: Any) -> None:
        look(endpoint)

    def lost(event: Any) -> None:
        endpoint.lost = event.total_count

    incoming = endpoint.direction == "in"
    kind = SubscriptionEventCallbacks if incoming else PublisherEventCallbacks
    known = inspect.signature(kind.__init__).parameters
    handlers = {"incompatible_qos": misfit, "incompatible_type": misfit, "message_lost": lost}
    for names in _SETS:
        # Without the default callbacks: they log through rcl what is said better in the status.
        yield kind(use_default_callbacks=False, **{name: handlers[name] for name in names if name in known})
