"""A PLC whose program is the virtual PLC's blocks, with the interface of :mod:`rosplc_st.machine`."""

from __future__ import annotations

from typing import Any
from unittest import mock

from rosplc import shm
from rosplc.layout.view import plain
from rosplc.shm import attach
from rosplc.shm.constants import UNKNOWN
from rosplc.virtual_plc import ReadBlock, WriteBlock
from rosplc.virtual_plc.task import Scan, enter_scan
from rosplc_st.machine import Counters
from tests.verification.plc_cell import READ, TOPICS, TWIST, WRITE, layout_of

LACKS = {
    "udiDiscontinuities": "its blocks do not count them",
    "udiFoundLayoutLo": "`reason` says what differs",
    "udiFoundLayoutHi": "`reason` says what differs",
}
"""Outputs that the virtual PLC has not: no value of them is compared."""
CANNOT = {
    "test_writer_stamp": "it stamps each message by its own clock",
    "test_back_off": "it looks every second, a PLC every two",
}
"""Tests that it cannot pass; one that it passes must leave this list."""


class _Anything:
    """Equals whatever it is compared with."""

    def __eq__(self, other: object) -> bool:
        return True

    __hash__ = None  # type: ignore[assignment]


class VirtualMachine:
    """Blocks of the virtual PLC for the topics of the cell; see :class:`rosplc_st.machine.Machine`."""

    def __init__(self, directory: str) -> None:
        self._directory = directory
        self._blocks: dict[str, Any] = {}
        self._ms = 1_000_000
        self._opens = 0
        self._consumed: list[float] = []

    def start(self) -> None:
        """Make the instances."""
        for topic, given in TOPICS.items():
            self._make(topic, given)

    def _make(self, topic: str, given: dict[str, Any]) -> None:
        about: dict[str, Any] = {"layout": layout_of(TWIST), "directory": self._directory, "beat_ms": 250}
        if given["direction"] == "read":
            after, on_stale = given.get("stale_after_ns"), given.get("on_stale", "hold")
            about |= {
                "stale_after": after and after / 1e9,
                "on_stale": on_stale,
                "stale_value": given.get("safe", {}) if on_stale == "value" else None,
                "mode": "every" if given.get("in_order") else "latest",
                "latched": given.get("latched", False),
            }
            self._blocks[f"ROS_Read.{topic.strip('/')}"] = ReadBlock(topic, **about)
        else:
            self._blocks[f"ROS_Write.{topic.strip('/')}"] = WriteBlock(topic, **about)

    def stop(self) -> None:
        """End as a program that is stopped."""
        for instance in self._blocks.values():
            instance.close()
        self._blocks = {}

    def scan(self, *programs: str, count: int = 1, step: int = 10) -> None:
        """Call the blocks of programs ``count`` times, the clock advancing by ``step`` ms before each."""
        for _ in range(count):
            self._ms += step
            enter_scan(Scan("RosTask", 1, self._ms * 1_000_000))
            try:
                with mock.patch.object(shm, "attach", self._attach):
                    for program in programs:
                        if program == "Consume":
                            self._consume()
                        start = {READ: "ROS_Read", WRITE: "ROS_Write"}.get(program, program)
                        for path, instance in self._blocks.items():
                            if path.startswith(start):
                                instance()
            finally:
                enter_scan(None)

    def set_time(self, milliseconds: int) -> None:
        """Set the clock that the scans begin at."""
        self._ms = milliseconds

    def _attach(self, *arguments: Any, **options: Any) -> Any:
        self._opens += 1
        return attach(*arguments, **options)

    def _consume(self) -> None:
        instance = self._blocks["ROS_Read.in_order"]
        self._consumed = []
        more = instance.xNew
        while more:
            self._consumed.append(instance.msg.linear.x)
            more = instance.next()

    def get(self, path: str) -> Any:
        """Return a variable as the PLC has it."""
        if path == "Consume.uiCount":
            return len(self._consumed)
        if path.startswith("Consume.adValues["):
            return self._consumed[int(path[17:-1])]
        place, _, name = path.rpartition(".")
        instance = self._blocks[place]
        if name in LACKS:
            assert not hasattr(instance, name), f"{name} is no longer to be in LACKS"
            return _Anything()
        if name == "tAge":
            return round(instance.age * 1000)
        if name in ("udiStampLo", "udiStampHi"):
            return instance.info.stamp_ns >> 32 * (name == "udiStampHi") & 0xFFFFFFFF
        value = getattr(instance, name)
        return UNKNOWN if value is None else value

    def set(self, path: str, value: Any) -> None:
        """Change an input."""
        place, _, name = path.rpartition(".")
        instance = self._blocks[place]
        if name == "xInside":
            (instance._busy.acquire if value else instance._busy.release)()
            return
        assert hasattr(instance, name), f"{path} is no input of the virtual PLC"
        setattr(instance, name, value)

    def read(self, path: str) -> bytes:
        """Return ``msg`` as a record."""
        instance = self._blocks[path.removesuffix(".msg")]
        return bytes(instance.layout.pack(plain(instance.msg)))

    def write(self, path: str, data: bytes) -> None:
        """Change ``msg`` of a writer, or the safe value of a reader before its first scan."""
        place, _, name = path.rpartition(".")
        values = plain(layout_of(TWIST).view(bytearray(data)))
        if name == "msg":
            self._blocks[place].msg.update(values)
        else:
            topic = f"/{place.partition('.')[2]}"
            self._make(topic, {**TOPICS[topic], "safe": values})

    def counters(self) -> Counters:
        """Return how many attempts were made to open an object, and how many are open."""
        handles = sum(instance.xAttached for instance in self._blocks.values())
        return Counters({"opens": self._opens}, open_handles=handles)
