"""rclpy/type_hash.py, since ROS 2 Iron."""

from __future__ import annotations

from rclpy._distro import HUMBLE

if HUMBLE:
    raise ModuleNotFoundError("No module named 'rclpy.type_hash'", name="rclpy.type_hash")


class TypeHash:
    __slots__ = ["_value", "_version"]

    def __init__(self, version: int = -1, value: bytes = bytes(32)) -> None:
        assert isinstance(version, int)
        assert isinstance(value, bytes)
        self._version, self._value = version, value

    def __str__(self) -> str:
        if self._version <= 0 or len(self._value) != 32:
            return "INVALID"
        return f"RIHS{self._version:02}_{self._value.hex()}"
