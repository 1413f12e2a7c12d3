"""bind(): a user's own node writes to the PLC and reads from it, in its own loop."""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import signal
import subprocess
import sys
import weakref
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from rosplc.bridge import Binding, bind
from rosplc.codec import Codec, Wire
from rosplc.errors import ChannelError, CodecError, LayoutError, MessageTypeError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Namespace, attach
from tests.lib.channels import start_child
from tests.lib.waiting import wait_for
from tests.unit.bridge.conftest import PlcTopic, wire

STRING = "std_msgs/msg/String"
POSE = "geometry_msgs/msg/PoseStamped"


def plc_of(binding: Binding, namespace: Namespace, *, to_plc: bool) -> PlcTopic:
    """Return the PLC's side of a binding."""
    return PlcTopic(namespace, binding.topic, binding.layout, to_plc)


def test_messages_of_every_form_reach_the_plc(shm_namespace: Namespace) -> None:
    """A mapping, a message object and serialized bytes are the same message."""
    store = get_typestore(Stores.ROS2_JAZZY)
    message: Any = store.types[STRING](data="hello")
    with bind("/text", STRING, prefix=shm_namespace.prefix) as binding:
        plc = plc_of(binding, shm_namespace, to_plc=True)
        for number, form in enumerate([{"data": "hello"}, message, wire(STRING, {"data": "hello"})], 1):
            assert binding.write(form) == number
            assert plc.read() == {"data": "hello"}
        plc.attached.close()


def test_messages_from_the_plc_are_read(shm_namespace: Namespace) -> None:
    """read() gives the newest message as an object with fields, once."""
    with bind("/pose", POSE, "to_ros", prefix=shm_namespace.prefix) as binding:
        plc = plc_of(binding, shm_namespace, to_plc=False)
        assert binding.read() is None
        for x in (1.0, 2.0):
            plc.write({"pose": {"position": {"x": x}}})
        message = binding.read()
        assert (message.pose.position.x, message.pose.orientation.w) == (2.0, 1.0)
        assert binding.read() is None
        plc.write({"header": {"frame_id": "map"}})
        assert binding.read_bytes() == wire(POSE, {"header": {"frame_id": "map"}})
        assert binding.read_bytes() is None
        plc.attached.close()


def test_every_message_in_order(shm_namespace: Namespace) -> None:
    """With every=True nothing is skipped as long as the slots hold it; what they do not is counted."""
    with bind("/text", STRING, "to_ros", prefix=shm_namespace.prefix, every=True, slots=8) as binding:
        plc = plc_of(binding, shm_namespace, to_plc=False)
        for number in range(5):
            plc.write({"data": str(number)})
        assert [binding.read().data for _ in range(5)] == list("01234")
        for number in range(20):
            plc.write({"data": str(number)})
        rest = []
        while (message := binding.read()) is not None:
            rest.append(int(message.data))
        assert rest == list(range(20 - len(rest), 20))
        assert binding.lost == 20 - len(rest)
        plc.attached.close()


def test_what_does_not_fit_is_refused_by_name(shm_namespace: Namespace) -> None:
    """Bytes and values beyond the limits raise with field, size and limit; nothing is published."""
    with bind("/text", STRING, prefix=shm_namespace.prefix, limits={"data": 4}) as binding:
        with pytest.raises(CodecError, match="data: string has 5 bytes; the limit is 4"):
            binding.write(wire(STRING, {"data": "12345"}))
        with pytest.raises(LayoutError, match="data"):
            binding.write({"data": "12345"})
        assert binding.write({"data": "1234"}) == 1
    with bind("/text", STRING, prefix=shm_namespace.prefix, limits={"data": 4}, truncate=True) as binding:
        plc = plc_of(binding, shm_namespace, to_plc=True)
        binding.write(wire(STRING, {"data": "12345"}))
        assert plc.read() == {"data": "1234"}
        plc.attached.close()


def test_limits_of_all_forms_give_one_layout(shm_namespace: Namespace) -> None:
    """Limits, and a mapping with string and sequence in it, mean the same as in a configuration."""
    fields = {"header.frame_id": 12}
    expected = compute_layout(TypeStore.bundled("jazzy"), POSE, Limits(20, 4, fields)).layout_id
    for limits in (Limits(20, 4, fields), {"string": 20, "sequence": 4, **fields}):
        with bind("/pose", POSE, prefix=shm_namespace.prefix, limits=limits) as binding:
            assert binding.layout.layout_id == expected


def test_one_owner_per_name(shm_namespace: Namespace) -> None:
    """A second binding, or a bridge, is refused; after close the name is free and the object adopted."""
    binding = bind("/text", STRING, prefix=shm_namespace.prefix)
    binding.write({"data": "kept"})
    with pytest.raises(ChannelError, match="SHM116"):
        bind("/text", STRING, prefix=shm_namespace.prefix)
    plc = plc_of(binding, shm_namespace, to_plc=True)
    binding.close()
    binding.close()
    with bind("/text", STRING, prefix=shm_namespace.prefix) as again:
        assert again.write({"data": "next"}) == 2
        assert plc.read() == {"data": "next"}
        plc.attached.close()
    with pytest.raises(ValueError, match="closed"):
        binding.write({"data": "x"})


def test_it_beats_in_the_background(shm_namespace: Namespace) -> None:
    """The PLC sees that the process lives although its loop does nothing."""
    with bind("/text", STRING, prefix=shm_namespace.prefix), attach(shm_namespace, "/text") as found:
        before = found.snapshot().writer.beat
        wait_for(lambda: found.snapshot().writer.beat >= before + 3)


@pytest.mark.parametrize("way", ["removed", "retired"])
def test_a_vanished_object_is_created_again(shm_namespace: Namespace, way: str) -> None:
    """Whatever happens to the object, writing goes on in a new one."""
    with bind("/text", STRING, prefix=shm_namespace.prefix) as binding:
        path = shm_namespace.path("/text")
        if way == "removed":
            path.unlink()
        else:
            with attach(shm_namespace, "/text", write=True) as found:
                found.region.store(12, 2)

        def back() -> bool:
            binding.write({"data": "again"})
            return path.exists()

        wait_for(back)
        plc = plc_of(binding, shm_namespace, to_plc=True)
        binding.write({"data": "news"})
        assert plc.read() == {"data": "news"}
        plc.attached.close()


def test_print_logs_each_message(shm_namespace: Namespace, caplog: pytest.LogCaptureFixture) -> None:
    """print=True shows what was written and read."""
    caplog.set_level(logging.INFO, "rosplc.bind")
    with bind("/in", STRING, print=True, prefix=shm_namespace.prefix) as binding:
        binding.write({"data": "one"})
        binding.write(wire(STRING, {"data": "two"}))
    with bind("/out", STRING, "to_ros", print=True, prefix=shm_namespace.prefix) as binding:
        plc = plc_of(binding, shm_namespace, to_plc=False)
        plc.write({"data": "three"})
        binding.read()
        plc.attached.close()
    assert [record.message for record in caplog.records] == [
        "/in was written: {'data': 'one'}",
        "/in was written: {'data': 'two'}",
        "/out was read: {'data': 'three'}",
    ]


def test_print_is_seen_in_a_program_without_logging(shm_namespace: Namespace) -> None:
    """print=True reaches stderr where nobody has set up logging."""
    program = (
        "import rosplc\n"
        f"with rosplc.bind('/in', '{STRING}', print=True, prefix='{shm_namespace.prefix}') as binding:\n"
        "    binding.write({'data': 'one'})\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stderr == "/in was written: {'data': 'one'}\n"


def test_a_binding_says_what_it_is(shm_namespace: Namespace) -> None:
    """The representation names topic, type and direction."""
    with bind("/in", STRING, prefix=shm_namespace.prefix) as binding:
        assert repr(binding) == "Binding(/in, std_msgs/msg/String, to the PLC)"


def test_the_wrong_direction_is_an_error(shm_namespace: Namespace) -> None:
    """Reading from a writing binding says so, and the other way round."""
    with (
        bind("/a", STRING, prefix=shm_namespace.prefix) as binding,
        pytest.raises(ChannelError, match="SHM110"),
    ):
        binding.read()
    with (
        bind("/b", STRING, "to_ros", prefix=shm_namespace.prefix) as binding,
        pytest.raises(ChannelError, match="SHM110"),
    ):
        binding.write({})
    with pytest.raises(ValueError, match="to_plc"):
        bind("/c", STRING, "plc", prefix=shm_namespace.prefix)  # type: ignore[arg-type]


class RospyString:
    """What genpy generates, as far as a binding uses it."""

    _type = "my_msgs/Text"
    _full_text = "string data\nuint8 level\n"

    def __init__(self) -> None:
        self.data = ""
        self.level = 0

    def deserialize(self, data: bytes) -> RospyString:
        size = int.from_bytes(data[:4], "little")
        self.data, self.level = data[4 : 4 + size].decode(), data[4 + size]
        return self


def test_rospy_classes(shm_namespace: Namespace) -> None:
    """A class of rospy gives type, definition and ROS 1's serialization, and comes back as an object."""
    with bind("/out", RospyString, "to_ros", prefix=shm_namespace.prefix) as binding:
        plc = plc_of(binding, shm_namespace, to_plc=False)
        plc.write({"data": "hi", "level": 3})
        message = binding.read()
        assert isinstance(message, RospyString)
        assert (message.data, message.level) == ("hi", 3)
        plc.attached.close()
    with bind("/in", RospyString, prefix=shm_namespace.prefix) as binding:
        plc = plc_of(binding, shm_namespace, to_plc=True)
        binding.write(message)
        assert plc.read() == {"data": "hi", "level": 3}
        binding.write(Codec(binding.layout, Wire.ROS1).encode(binding.layout.pack({"data": "raw"})))
        assert plc.read() == {"data": "raw", "level": 0}
        plc.attached.close()


def test_rclpy_classes(shm_namespace: Namespace, monkeypatch: pytest.MonkeyPatch) -> None:
    """A class of rclpy names its type by its module, and rclpy itself makes the object."""
    text = type("String", (), {"__module__": "std_msgs.msg._string"})
    serialization = ModuleType("rclpy.serialization")
    serialization.deserialize_message = lambda data, kind: (kind, data)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "rclpy", ModuleType("rclpy"))
    monkeypatch.setitem(sys.modules, "rclpy.serialization", serialization)
    with bind("/out", text, "to_ros", prefix=shm_namespace.prefix) as binding:
        plc = plc_of(binding, shm_namespace, to_plc=False)
        plc.write({"data": "hi"})
        assert binding.read() == (text, wire(STRING, {"data": "hi"}))
        plc.attached.close()


@pytest.mark.parametrize("kind", [dict, Namespace, "std_msgs/msg/Strin"])
def test_what_is_no_message_type(shm_namespace: Namespace, kind: Any) -> None:
    """Other classes and unknown names are refused before anything is created."""
    with pytest.raises(MessageTypeError, match="TYP001"):
        bind("/a", kind, prefix=shm_namespace.prefix)
    assert shm_namespace.topics() == []


def test_the_environment_names_the_distribution(
    shm_namespace: Namespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ROS_DISTRO holds where nothing else is said."""
    for value, expected in [("humble", "humble"), ("unheard-of", "jazzy")]:
        monkeypatch.setenv("ROS_DISTRO", value)
        with bind("/a", STRING, prefix=shm_namespace.prefix), attach(shm_namespace, "/a") as found:
            assert found.description.distro == expected


def test_a_binding_that_nobody_holds_lets_go_of_its_name(shm_namespace: Namespace) -> None:
    """A forgotten close() costs no other program the name."""
    binding = bind("/text", STRING, prefix=shm_namespace.prefix)
    reference = weakref.ref(binding)
    with attach(shm_namespace, "/text") as found:
        beat = found.snapshot().writer.beat
        wait_for(lambda: found.snapshot().writer.beat >= beat + 2, "two beats")
    del binding
    wait_for(lambda: gc.collect() >= 0 and reference() is None)
    bind("/text", STRING, prefix=shm_namespace.prefix).close()


_FORKED = """
import os, sys, time
from rosplc.bridge import bind
from rosplc.shm import Namespace, attach
prefix = sys.argv[1]
binding = bind("/parent", "std_msgs/msg/String", prefix=prefix)
if os.fork():
    print("parent", flush=True)
    time.sleep(60)
own = bind("/child", "std_msgs/msg/String", prefix=prefix)
with attach(Namespace(prefix), "/child") as found:
    before = found.snapshot().writer.beat
    while found.snapshot().writer.beat < before + 3:
        time.sleep(0.01)
print("beats", flush=True)
time.sleep(60)
"""


def test_a_forked_child_holds_no_name_and_beats_for_its_own(shm_namespace: Namespace) -> None:
    """A worker that outlives its killed parent keeps nobody from the parent's topics."""
    process = start_child(_FORKED, shm_namespace.prefix)
    assert process.stdout is not None
    try:
        assert {process.stdout.readline(), process.stdout.readline()} == {"parent\n", "beats\n"}
        process.kill()
        process.wait()
        bind("/parent", STRING, prefix=shm_namespace.prefix).close()
    finally:
        process.kill()
        for pid in _children_of_prefix(shm_namespace.prefix):
            os.kill(pid, signal.SIGKILL)


def _children_of_prefix(prefix: str) -> list[int]:
    """The processes that were started with this test's prefix as their last argument."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError):
                if (entry / "cmdline").read_bytes().endswith(b"\0" + prefix.encode() + b"\0"):
                    found.append(int(entry.name))
    return found
