"""The settings that a peer announces for an endpoint, read from the library's own structure.

The wheel has a function for this, but it keeps what it reads in variables of its class: two
threads that use it at once mix up two peers' settings.
"""

from __future__ import annotations

import ctypes as ct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from cyclonedds.internal import DDS

from rosplc.ros.qos import Qos

__all__ = ["Announced", "read_announced"]

_INFINITE = 2**63 - 1
_XCDR1 = 0
_VOLATILE, _TRANSIENT_LOCAL = 0, 1
_RELIABLE = 1
_EXCLUSIVE = 1
_AUTOMATIC = 0

_library = ct.CDLL(DDS._dll_handle._name)


def _getter(name: str, *results: Any) -> Any:
    function = getattr(_library, f"dds_qget_{name}")
    function.restype = ct.c_bool
    function.argtypes = [ct.c_void_p, *(ct.POINTER(result) for result in results)]

    def get(qos: int) -> tuple[Any, ...] | None:
        values = tuple(result() for result in results)
        return values if function(qos, *(ct.byref(value) for value in values)) else None

    return get


_free = _library.dds_free
_free.restype = None
_free.argtypes = [ct.c_void_p]

_reliability = _getter("reliability", ct.c_int, ct.c_int64)
_durability = _getter("durability", ct.c_int)
_deadline = _getter("deadline", ct.c_int64)
_liveliness = _getter("liveliness", ct.c_int, ct.c_int64)
_ownership = _getter("ownership", ct.c_int)
_partition = _getter("partition", ct.c_uint32, ct.POINTER(ct.c_void_p))
_representation = _getter("data_representation", ct.c_uint32, ct.POINTER(ct.c_int16))
_userdata = _getter("userdata", ct.c_void_p, ct.c_size_t)


@dataclass(frozen=True, slots=True)
class Announced:
    """What a peer says about an endpoint.

    Attributes:
        qos: Its settings, as far as the bridge has such; the depth is not announced and is 1.
        obstacles: Other settings that keep a plain ROS endpoint from matching, in words.
        user_data: Where ROS puts the type hash.
    """

    qos: Qos
    obstacles: tuple[str, ...]
    user_data: bytes


def read_announced(pointer: int, *, writer: bool) -> Announced:
    """Read a ``dds_qos_t`` that the library owns; ``writer`` if the endpoint publishes."""
    reliability = _reliability(pointer)
    # Best effort is DDS's default of readers, reliable that of writers.
    reliable = writer if reliability is None else reliability[0].value == _RELIABLE
    volatile = _number(_durability(pointer)) == _VOLATILE
    liveliness = _liveliness(pointer)
    qos = Qos(
        "reliable" if reliable else "best_effort",
        "volatile" if volatile else "transient_local",
        1,
        deadline_ns=_time(_number(_deadline(pointer), _INFINITE)),
        lease_ns=_time(_INFINITE if liveliness is None else liveliness[1].value),
    )
    return Announced(qos, tuple(_obstacles(pointer, writer)), _user_data(pointer))


def _number(values: tuple[Any, ...] | None, default: int = 0) -> int:
    return default if values is None else int(values[0].value)


def _time(ns: int) -> int:
    """Return a time as :class:`Qos` has it: 0 is none."""
    return 0 if ns >= _INFINITE else max(1, ns)


def _user_data(pointer: int) -> bytes:
    values = _userdata(pointer)
    if values is None or not values[0].value:
        return b""
    try:
        return ct.string_at(values[0].value, values[1].value)
    finally:
        _free(values[0])


def _partitions(pointer: int) -> list[str]:
    values = _partition(pointer)
    if values is None or not values[0].value:
        return []
    count, names = values[0].value, values[1]
    found = [ct.string_at(names[i]).decode(errors="replace") for i in range(count)]
    for i in range(count):
        _free(names[i])
    _free(names)
    return found


def _representations(pointer: int) -> list[int]:
    values = _representation(pointer)
    if values is None or not values[0].value:
        return []
    found = [int(values[1][i]) for i in range(values[0].value)]
    _free(values[1])
    return found


def _obstacles(pointer: int, writer: bool) -> Iterator[str]:
    representations = _representations(pointer)
    # A writer uses the first that it names; a reader takes any that it names.
    if representations and _XCDR1 not in (representations[:1] if writer else representations):
        yield "it uses another data representation than XCDR version 1, which ROS uses"
    partitions = _partitions(pointer)
    if partitions and "" not in partitions and "*" not in partitions:
        yield f"it is in the DDS partition {', '.join(partitions)}"
    if _number(_ownership(pointer)) == _EXCLUSIVE:
        yield "it has exclusive ownership"
    if writer:
        return
    if _number(_durability(pointer)) > _TRANSIENT_LOCAL:
        yield "it wants transient or persistent durability, which ROS does not have"
    liveliness = _liveliness(pointer)
    if liveliness is not None and liveliness[0].value != _AUTOMATIC:
        yield "it wants manual liveliness"
