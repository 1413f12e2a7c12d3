"""What rosbag2 writes beside the messages, so that `ros2 bag` takes a recording as one of its own.

rosbag2's storage plugin for MCAP puts a topic's QoS into the channel's metadata, and everything that
``metadata.yaml`` says into a metadata record named ``rosbag2`` as well. Version 8 of that format is written,
the last one with numbers for QoS policies: Humble and Iron read no other, and later releases read it too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from rosplc.ros import DEFAULT, Qos

__all__ = ["RECORD_NAME", "BagFile", "BagTopic", "bag_information", "qos_of_text", "qos_text", "to_yaml"]

RECORD_NAME = "rosbag2"
_VERSION = 8
# rmw/types.h: rmw_qos_*_policy_e; 0 stands for the middleware's own default.
_KEEP_LAST = 1
_RELIABILITY = {"reliable": 1, "best_effort": 2}
_DURABILITY = {"transient_local": 1, "volatile": 2}
_AUTOMATIC = 1
_UNSET = {"sec": 0, "nsec": 0}


@dataclass(frozen=True)
class BagFile:
    """A file of a bag: its name in the folder, its earliest and latest log time, its messages."""

    name: str
    start_ns: int
    end_ns: int
    messages: int


@dataclass(frozen=True)
class BagTopic:
    """A topic of a bag."""

    name: str
    type_name: str
    qos: str
    type_hash: str
    messages: int


def qos_text(qos: Qos) -> str:
    """Return ``offered_qos_profiles`` for what a topic's publisher offers."""
    profile = {
        "history": _KEEP_LAST,
        "depth": qos.depth,
        "reliability": _RELIABILITY[qos.reliability],
        "durability": _DURABILITY[qos.durability],
        "deadline": _time(qos.deadline_ns),
        "lifespan": _UNSET,
        "liveliness": _AUTOMATIC if qos.lease_ns else 0,
        "liveliness_lease_duration": _time(qos.lease_ns),
        "avoid_ros_namespace_conventions": False,
    }
    return to_yaml([profile]).rstrip("\n")


def qos_of_text(text: str) -> Qos:
    """Return what ``offered_qos_profiles`` says of the first publisher, else the default.

    Only what decides who receives what is taken over: promises about time are not, as a replay may
    be slower than they allow.
    """
    try:
        profile = yaml.safe_load(text)[0]
        reliability, durability = str(profile["reliability"]), str(profile["durability"])
        depth = int(profile["depth"])
    except (yaml.YAMLError, RecursionError, LookupError, TypeError, ValueError):
        return DEFAULT
    return Qos(
        reliability="best_effort" if reliability in ("2", "best_effort") else "reliable",
        durability="transient_local" if durability in ("1", "transient_local") else "volatile",
        depth=min(max(depth, DEFAULT.depth), 10_000),
    )


def bag_information(files: Iterable[BagFile], topics: Iterable[BagTopic], distro: str) -> dict[str, Any]:
    """Return what ``metadata.yaml`` holds."""
    files = list(files)
    filled = [file for file in files if file.messages]
    start = min((file.start_ns for file in filled), default=0)
    end = max((file.end_ns for file in filled), default=0)
    return {
        "rosbag2_bagfile_information": {
            "version": _VERSION,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": end - start},
            "starting_time": {"nanoseconds_since_epoch": start},
            "message_count": sum(file.messages for file in files),
            "topics_with_message_count": [_topic(topic) for topic in topics],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file.name for file in files],
            "files": [_file(file) for file in files],
            "custom_data": {},
            "ros_distro": distro,
        }
    }


def to_yaml(value: Any) -> str:
    """Return YAML, without references between equal parts, which rosbag2 would not expect."""
    return yaml.dump(value, Dumper=_Plain, sort_keys=False, allow_unicode=True)


class _Plain(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def _time(ns: int) -> Mapping[str, int]:
    return {"sec": ns // 10**9, "nsec": ns % 10**9}


def _topic(topic: BagTopic) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": topic.qos,
            "type_description_hash": topic.type_hash,
        },
        "message_count": topic.messages,
    }


def _file(file: BagFile) -> dict[str, Any]:
    return {
        "path": file.name,
        "starting_time": {"nanoseconds_since_epoch": file.start_ns},
        "duration": {"nanoseconds": file.end_ns - file.start_ns},
        "message_count": file.messages,
    }
