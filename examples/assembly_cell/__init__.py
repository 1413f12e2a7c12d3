"""An assembly cell: a robot on ROS 2 does one half of the work on a door handle, a PLC's press the other."""
