"""A stand-in for lifecycle_msgs: the constants that the launch file uses."""
