"""ROS 1 without a ROS installation: TCPROS and XML-RPC, compatible with rospy."""

from rosplc.ros.rospy.backend import RospyBackend, open_backend
from rosplc.ros.rospy.wire import WireDefinition, definition_on_wire, save_definition

__all__ = ["RospyBackend", "WireDefinition", "definition_on_wire", "open_backend", "save_definition"]
