"""Carry topics in a loop of your own: one towards the PLC, one back, without the bridge.

This is the shape of a ROS node that talks to the PLC by itself. Replace ``measure`` and
``act`` by what your node does; with rclpy or rospy, pass the message class instead of the
type's name and you get objects of that class.

    python examples/own_loop.py --seconds 10
"""

from __future__ import annotations

import argparse
import math
import time

import rosplc


def measure(seconds: float) -> dict[str, float]:
    """Return a made-up measurement."""
    return {"data": 20.0 + 5.0 * math.sin(seconds)}


def act(setpoint: float) -> None:
    """Do what the PLC asks for."""
    print(f"the PLC asks for {setpoint:.1f}", flush=True)


def main() -> None:
    """Run the loop for the time that the command line gives."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--prefix", default="rosplc")
    arguments = parser.parse_args()
    with (
        rosplc.bind("/temperature", "std_msgs/msg/Float64", prefix=arguments.prefix) as temperature,
        rosplc.bind("/setpoint", "std_msgs/msg/Float64", "to_ros", prefix=arguments.prefix) as setpoint,
    ):
        began = time.monotonic()
        while (seconds := time.monotonic() - began) < arguments.seconds:
            temperature.write(measure(seconds))
            asked = setpoint.read()
            if asked is not None:
                act(asked.data)
            time.sleep(0.01)


if __name__ == "__main__":
    main()
