"""The rosplc bridge as a ROS 2 package."""
