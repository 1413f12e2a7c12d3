"""Message types that are harder on a codec than the bundled ones, for the tests and the fuzzer."""

from __future__ import annotations

from rosplc.model import TypeStore

__all__ = ["HARD_TYPES", "hard_store"]

HARD_TYPES: dict[str, str] = {
    "hard_msgs/msg/Nothing": "",
    "hard_msgs/msg/Pair": "float64 a\nuint8 b\n",
    "hard_msgs/msg/Shifted": "uint32 a\nuint32 b\nfloat64 c\n",
    "hard_msgs/msg/Switch": "bool on\nbool off\nuint16 code\nbool last\n",
    "hard_msgs/msg/Leaf": "uint8 tag\nstring name\nfloat32[] values\n",
    "hard_msgs/msg/Branch": "Leaf[] leaves\nbool[] marks\nNothing nothing\n",
    "hard_msgs/msg/Tree": "uint16 id\nBranch[] branches\nBranch[2] pair\nstring[] words\nuint8 end\n",
    "hard_msgs/msg/Nothings": "Nothing[] many\nNothing[3] three\nuint32 end\n",
    "hard_msgs/msg/OnlyNothings": "Nothing[] many\n",
    "hard_msgs/msg/HeavyNothing": "uint8 x\nNothing[100] inner\n",
    "hard_msgs/msg/HeavyNothings": "HeavyNothing[] items\n",
    "hard_msgs/msg/Pairs": "Pair[] pairs\nPair[3] three\nuint8 end\n",
    "hard_msgs/msg/ShiftedMany": "uint8 start\nShifted[] sequence\nShifted[2] array\nShifted[2] second\n",
    "hard_msgs/msg/ShiftedFirst": "Shifted[] sequence\nShifted[2] array\n",
    "hard_msgs/msg/Switches": "Switch[] many\nSwitch one\nbool[5] five\nbool[] loose\nuint64 end\n",
    "hard_msgs/msg/Wide": "uint8 a\nuint64 b\nuint8 c\nuint32 d\nuint16 e\nfloat64 f\nint8 g\n",
    "hard_msgs/msg/Texts": "string[3] three\nstring[] many\nint64 end\n",
}
"""Definitions by name; all are valid in both ROS versions."""

BOUNDED = "string<=5 name\nuint16[<=4] numbers\nstring<=3[<=2] words\nPair[<=2] pairs\n"


def hard_store(distro: str) -> TypeStore:
    """Return a distribution's store with these types, and with bounds if it is a ROS 2 one."""
    store = TypeStore.bundled(distro)
    for name, text in HARD_TYPES.items():
        store = store.with_definition(name, text)
    if store.ros_version == 2:
        store = store.with_definition("hard_msgs/msg/Bounded", BOUNDED)
    return store
