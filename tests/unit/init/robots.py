"""A small robot in this process, and recordings of one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rosplc.model import TypeStore
from rosplc.model.fingerprints import _describe
from rosplc.ros import LATCHED, SENSOR_DATA, SERVICES, Backend, Qos, open_backend
from tests.codec_oracle import Oracle

PART = "cell_msgs/msg/Part"
PART_TEXT = "uint16 kind\nstring label\nfloat32[] sizes\nSide side\n"
SIDE_TEXT = "bool left # or right\n"
PART_TEXTS = f"{PART_TEXT}{'=' * 80}\nMSG: cell_msgs/Side\n{SIDE_TEXT}"
SOURCES = {PART: PART_TEXT, "cell_msgs/msg/Side": SIDE_TEXT}
STORE = TypeStore.bundled("jazzy").with_definition(PART, PART_TEXTS)
ORACLE = Oracle(STORE)
JOINTS = "sensor_msgs/msg/JointState"


def joints(count: int, *, frame: str = "base_link") -> dict[str, Any]:
    """Return a JointState of so many joints."""
    return {
        "header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": frame},
        "name": [f"a_joint_with_a_long_name_{number}" for number in range(count)],
        "position": [0.5] * count,
        "velocity": [0.25] * count,
        "effort": [],
    }


class Robot:
    """Publishes joints, a retained mode and parts, and waits for commands; a context manager."""

    def __init__(
        self,
        backend: str,
        domain: int | None = None,
        period_s: float = 0.02,
        *,
        describes: bool = False,
        **options: object,
    ) -> None:
        self._node = open_backend(backend, STORE, "robot", domain=domain, options=options)
        if describes:
            describe_types(self._node, answer_about(STORE, PART, SOURCES))
        self._period_s = period_s
        joint_states = self._node.advertise("/joint_states", JOINTS, SENSOR_DATA)
        parts = self._node.advertise("/parts", PART, Qos())
        mode = self._node.advertise("/mode", "std_msgs/msg/String", LATCHED)
        self._node.subscribe("/cmd_vel", "geometry_msgs/msg/Twist", Qos(), lambda *_: None)
        mode.write(ORACLE.cdr("std_msgs/msg/String", {"data": "automatic"}))
        part = {"kind": 1, "label": "handle", "sizes": [1.0], "side": {"left": True}}
        self._sends: list[Callable[[], object]] = [
            lambda: joint_states.write(ORACLE.cdr(JOINTS, joints(6))),
            lambda: parts.write(ORACLE.cdr(PART, part)),
        ]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._stop.wait(self._period_s):
            for send in self._sends:
                send()

    def __enter__(self) -> Robot:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._node.close()


def record(folder: Path, storage: str = "mcap", *, count: int = 20) -> Path:
    """Write a ROS 2 recording with a custom type; return its folder."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(
        {**get_types_from_msg(PART_TEXT, PART), **get_types_from_msg(SIDE_TEXT, "cell_msgs/msg/Side")}
    )
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        topics = {"/joint_states": JOINTS, "/parts": PART, "/rosout": "rcl_interfaces/msg/Log"}
        made = {name: writer.add_connection(name, kind, typestore=store) for name, kind in topics.items()}
        for number in range(count):
            time_ns = 1_700_000_000_000_000_000 + number * 500_000_000
            writer.write(made["/joint_states"], time_ns, ORACLE.cdr(JOINTS, joints(6)))
            part = {"kind": 1, "label": "x" * number, "sizes": [1.0] * (number % 3), "side": {"left": True}}
            writer.write(made["/parts"], time_ns, ORACLE.cdr(PART, part))
    return folder


def answer_about(store: TypeStore, name: str, sources: Mapping[str, str]) -> dict[str, Any]:
    """Return what a node answers to GetTypeDescription: a type of a store, and its ``.msg`` files."""
    own, *others = (_describe(store[each]) for each in reversed(store.dependencies(name)))
    for field in (field for each in (own, *others) for field in each["fields"]):
        field["default_value"] = ""
    return {
        "successful": True,
        "failure_reason": "",
        "type_description": {"type_description": own, "referenced_type_descriptions": others},
        "type_sources": [
            {"type_name": each, "encoding": "msg", "raw_file_contents": text}
            for each, text in sources.items()
        ],
        "extra_information": [],
    }


def describe_types(node: Backend, answer: Mapping[str, Any]) -> None:
    """Answer what other nodes ask about types."""
    service = "type_description_interfaces/srv/GetTypeDescription"
    payload = ORACLE.cdr(f"{service}_Response", answer)
    server = node.serve(
        "/robot/get_type_description", service, SERVICES, lambda _, caller, __: server.reply(caller, payload)
    )
