"""A stand-in for launch_ros (0.26, Jazzy), after https://github.com/ros2/launch_ros, branch jazzy."""
