"""Which ROS distribution the double imitates."""

from __future__ import annotations

import os

HUMBLE = os.environ.get("ROS_DISTRO") == "humble"
