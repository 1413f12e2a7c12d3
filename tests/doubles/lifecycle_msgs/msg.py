"""lifecycle_msgs/msg/Transition.msg (https://github.com/ros2/rcl_interfaces)."""

from __future__ import annotations


class Transition:
    TRANSITION_CONFIGURE = 1
    TRANSITION_CLEANUP = 2
    TRANSITION_ACTIVATE = 3
    TRANSITION_DEACTIVATE = 4
