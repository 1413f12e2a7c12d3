"""The demonstration: a simulated robot, a bridge and a virtual PLC, each a process of its own.

The robot speaks real DDS and knows nothing of PLCs; the virtual PLC knows nothing of ROS.
Every message carries a number and a checksum of its contents, so that what is lost or
torn on the way is counted from the messages themselves.
"""

__all__: list[str] = []
