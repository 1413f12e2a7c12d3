"""launch_ros/events."""
