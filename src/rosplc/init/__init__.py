"""From a robot, or a recording of one, to a configuration: what is there, what to carry, how much room."""

from rosplc.init.found import Source, Topic
from rosplc.init.live import LiveRobot
from rosplc.init.propose import Wish, direction, is_of_ros_itself, parse_wish, select
from rosplc.init.recorded import RecordedRobot
from rosplc.init.write import Draft, draft, refuse_to_overwrite, save

__all__ = [
    "Draft",
    "LiveRobot",
    "RecordedRobot",
    "Source",
    "Topic",
    "Wish",
    "direction",
    "draft",
    "is_of_ros_itself",
    "parse_wish",
    "refuse_to_overwrite",
    "save",
    "select",
]
