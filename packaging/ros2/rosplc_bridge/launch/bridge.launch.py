"""Starts the bridge, configures it and activates it.

``ros2 launch rosplc_bridge bridge.launch.py config:=/etc/rosplc/rosplc.yaml name:=cell1 autostart:=true``
"""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.conditions import IfCondition
from launch.events import matches_action
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare
from lifecycle_msgs.msg import Transition


def generate_launch_description() -> LaunchDescription:
    """Return what `ros2 launch` starts."""
    node = LifecycleNode(
        package="rosplc_bridge",
        executable="bridge",
        name=LaunchConfiguration("name"),
        namespace=LaunchConfiguration("namespace"),
        parameters=[{"config": ParameterValue(LaunchConfiguration("config"), value_type=str)}],
        output="screen",
    )
    wanted = IfCondition(LaunchConfiguration("autostart"))

    def change(transition: int, **options: object) -> EmitEvent:
        event = ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition)
        return EmitEvent(event=event, **options)

    configure = change(Transition.TRANSITION_CONFIGURE, condition=wanted)  # waits for the node's service
    activate = RegisterEventHandler(
        OnStateTransition(
            target_lifecycle_node=node,
            start_state="configuring",
            goal_state="inactive",
            entities=[change(Transition.TRANSITION_ACTIVATE)],
            handle_once=True,  # who configures the node again decides when it is activated
        ),
        condition=wanted,
    )
    default = PathJoinSubstitution([FindPackageShare("rosplc_bridge"), "config", "rosplc.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("config", default_value=default, description="the configuration file"),
            DeclareLaunchArgument("name", default_value="rosplc_bridge", description="the node's name"),
            DeclareLaunchArgument("namespace", default_value="", description="the node's namespace"),
            DeclareLaunchArgument(
                "autostart", default_value="true", description="whether to configure and activate it"
            ),
            node,
            configure,
            activate,
        ]
    )
