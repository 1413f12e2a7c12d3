"""From a robot, or a recording of one, to a configuration: what is there, what to carry, how much room."""

from rosplc.init.definitions import Definitions
from rosplc.init.found import Found, Source, Topic
from rosplc.init.live import LiveRobot
from rosplc.init.meter import Length, Meter, Seen
from rosplc.init.propose import Entry, Limit, Setting, direction, is_of_ros_itself, propose
from rosplc.init.recorded import RecordedRobot
from rosplc.init.select import Chosen, Wish, parse_wish, select
from rosplc.init.write import Draft, check_text, configuration, draft, refuse_to_overwrite, save, write_file

__all__ = [
    "Chosen",
    "Definitions",
    "Draft",
    "Entry",
    "Found",
    "Length",
    "Limit",
    "LiveRobot",
    "Meter",
    "RecordedRobot",
    "Seen",
    "Setting",
    "Source",
    "Topic",
    "Wish",
    "check_text",
    "configuration",
    "direction",
    "draft",
    "is_of_ros_itself",
    "parse_wish",
    "propose",
    "refuse_to_overwrite",
    "save",
    "select",
    "write_file",
]
