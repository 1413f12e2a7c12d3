"""Transforms: the buffer against matrices that numpy multiplies, and a bridge that fills a PLC's channel."""

from __future__ import annotations

import contextlib
import math
import random
import time
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import pytest

from rosplc.bridge import Bridge
from rosplc.bridge.transforms import Buffer, Found, Pose
from rosplc.codec import Codec, Wire
from rosplc.config import ConfigErrors, parse_config, resolve
from rosplc.config.transforms import TransformError
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import Qos
from rosplc.ros.memory import open_backend
from rosplc.shm import Namespace
from tests.lib.clock import SteppedClock
from tests.lib.waiting import wait_for
from tests.unit.bridge.conftest import INT, Cell, PlcTopic, wire

Matrix: TypeAlias = "np.ndarray[Any, Any]"
S = 1_000_000_000
AT_REST: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def moved(x: float, y: float = 0.0, z: float = 0.0) -> Pose:
    """Return a pose without a rotation."""
    return x, y, z, 0.0, 0.0, 0.0, 1.0


def turned(axis: Matrix, angle: float, position: Matrix) -> tuple[Pose, Matrix]:
    """Return a pose as the buffer takes it, and as a matrix by Rodrigues' formula."""
    axis = axis / np.linalg.norm(axis)
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    matrix[:3, 3] = position
    quaternion = (*(axis * math.sin(angle / 2)), math.cos(angle / 2))
    return tuple(map(float, (*position, *quaternion))), matrix  # type: ignore[return-value]


def as_matrix(pose: Pose) -> Matrix:
    """Return the matrix of a pose with a unit quaternion: the images of the three axes, and the origin."""
    x, y, z, w = pose[3:]
    matrix = np.eye(4)
    matrix[:3, 0] = 1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)
    matrix[:3, 1] = 2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)
    matrix[:3, 2] = 2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)
    matrix[:3, 3] = pose[:3]
    return matrix


def some_turn(rng: random.Random, axis: Matrix | None = None) -> tuple[Matrix, float, Matrix]:
    """Return an axis, an angle and a position."""
    found = np.array([rng.gauss(0, 1) for _ in range(3)]) if axis is None else axis
    return found, rng.uniform(-math.pi, math.pi), np.array([rng.uniform(-5, 5) for _ in range(3)])


@pytest.mark.parametrize("seed", range(100))
def test_a_random_tree_of_static_transforms(seed: int) -> None:
    """Each pair of frames has the pose that multiplied matrices have."""
    rng, buffer, world = random.Random(seed), Buffer(), {"f0": np.eye(4)}
    for number in range(1, rng.randint(2, 12)):
        parent = f"f{rng.randrange(number)}"
        pose, matrix = turned(*some_turn(rng))
        assert buffer.put(f"f{number}", parent, 0, pose, static=True) == ""
        world[f"f{number}"] = world[parent] @ matrix
    for target, to in world.items():
        for source, of in world.items():
            found = buffer.lookup(target, source)
            assert (found.error, found.stamp_ns, found.static) == (0, 0, True)
            np.testing.assert_allclose(as_matrix(found.pose), np.linalg.inv(to) @ of, atol=1e-12)


@pytest.mark.parametrize("seed", range(100))
def test_a_chain_in_motion_is_interpolated_at_the_newest_common_time(seed: int) -> None:
    """Each link turns steadily around its axis, published at a rate and with a delay of its own."""
    rng, buffer, links = random.Random(seed), Buffer(), []
    for number in range(rng.randint(1, 6)):
        axis, rate, speed = some_turn(rng)
        motion = axis, rate, speed
        links.append((f"f{number}", f"f{number + 1}", motion))

    def pose_of(motion: tuple[Matrix, float, Matrix], seconds: float) -> tuple[Pose, Matrix]:
        axis, rate, speed = motion
        return turned(axis, rate * seconds, speed * seconds)

    newest = {}
    for parent, child, motion in links:
        period = rng.randint(S // 200, S // 3)
        stamps = list(range(rng.randint(1, period), 4 * S, period))
        newest[child] = stamps[-1]
        rng.shuffle(stamps)  # messages of several publishers overtake each other
        for stamp in stamps:
            assert buffer.put(child, parent, stamp, pose_of(motion, stamp / S)[0]) == ""
    oldest = min(newest, key=lambda child: newest[child])
    expected = np.eye(4)
    for _, _, motion in links:
        expected = expected @ pose_of(motion, newest[oldest] / S)[1]
    for target, source, wanted in (
        ("f0", links[-1][1], expected),
        (links[-1][1], "f0", np.linalg.inv(expected)),
    ):
        found = buffer.lookup(target, source)
        assert (found.error, found.frame, found.stamp_ns, found.static) == (0, oldest, newest[oldest], False)
        np.testing.assert_allclose(as_matrix(found.pose), wanted, atol=1e-9)


def test_static_and_moving_transforms_in_one_chain() -> None:
    """A static one holds at every time, and does not make the chain static."""
    buffer = Buffer()
    buffer.put("arm", "base", 5 * S, moved(1))
    buffer.put("tool", "arm", 77 * S, moved(0, 2), static=True)
    assert buffer.lookup("base", "tool") == Found(TransformError.NONE, "arm", 5 * S, False, moved(1, 2))


@pytest.mark.parametrize(
    ("target", "source", "error", "frame"),
    [
        ("base", "nowhere", TransformError.UNKNOWN_FRAME, "nowhere"),
        ("nothing", "nowhere", TransformError.UNKNOWN_FRAME, "nothing"),
        ("base", "lamp", TransformError.NOT_CONNECTED, "room"),
        ("lamp", "tool", TransformError.NOT_CONNECTED, "base"),
        ("base", "egg", TransformError.LOOP, "hen"),
        ("base", "late", TransformError.NO_COMMON_TIME, "late"),
    ],
)
def test_why_there_is_no_pose(target: str, source: str, error: TransformError, frame: str) -> None:
    """The error, and the frame that it is about."""
    buffer = Buffer()
    buffer.put("arm", "base", 5 * S, moved(1))
    buffer.put("tool", "arm", 5 * S, moved(1))
    buffer.put("lamp", "room", 0, moved(1), static=True)
    buffer.put("egg", "hen", 5 * S, moved(1))
    buffer.put("hen", "egg", 5 * S, moved(1))
    buffer.put("late", "tool", 6 * S, moved(1))  # tool is known for second 5 only
    assert buffer.lookup(target, source)[:2] == (error, frame)
    assert buffer.lookup("base", "tool").error == 0


def test_nothing_is_extrapolated() -> None:
    """The pose is that of the slower link's last stamp, however far the other one has got."""
    buffer = Buffer()
    for second in range(1, 9):
        buffer.put("fast", "base", second * S, moved(second))
    buffer.put("slow", "fast", 2 * S + S // 2, moved(0))
    found = buffer.lookup("base", "slow")
    assert (found.frame, found.stamp_ns, found.pose) == ("slow", 2 * S + S // 2, moved(2.5))


def test_another_parent() -> None:
    """Between two transforms with different parents the older one holds, as in tf2."""
    buffer = Buffer()
    buffer.put("part", "belt", 1 * S, moved(1))
    buffer.put("part", "gripper", 3 * S, moved(9))
    for second in (1, 2):
        for frame, height in (("belt", 1), ("gripper", 2)):
            buffer.put(frame, "base", second * S, moved(0, height))
        found = buffer.lookup("base", "part")
        assert (found.stamp_ns, found.pose) == (second * S, moved(1, 1))
    buffer.put("gripper", "base", 3 * S, moved(0, 2))
    assert buffer.lookup("base", "part").pose == moved(9, 2)


@pytest.mark.parametrize(
    ("child", "parent", "pose", "words"),
    [
        ("", "base", AT_REST, "two different frames"),
        ("tool", "", AT_REST, "two different frames"),
        ("tool", "tool", AT_REST, "two different frames"),
        ("tool", "base", (math.nan, *AT_REST[1:]), "unit quaternion"),
        ("tool", "base", (math.inf, *AT_REST[1:]), "unit quaternion"),
        ("tool", "base", (0.0,) * 7, "unit quaternion"),
        ("tool", "base", (*AT_REST[:6], 1.1), "unit quaternion"),
    ],
)
def test_what_is_no_transform_is_ignored(child: str, parent: str, pose: Pose, words: str) -> None:
    """It is named, and makes no frame known."""
    buffer = Buffer()
    assert words in buffer.put(child, parent, S, pose)
    assert buffer.lookup("base", "tool").error is TransformError.UNKNOWN_FRAME


def test_a_rotation_that_is_nearly_a_unit_quaternion_is_made_one() -> None:
    """What tf2 accepts is accepted; rounded numbers do not stretch the rest of the chain."""
    buffer = Buffer()
    for child, parent in (("b", "a"), ("c", "b"), ("d", "c")):
        buffer.put(child, parent, 0, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.004), static=True)
    assert buffer.lookup("a", "d").pose == moved(3)


def test_what_is_older_than_the_buffer_is_ignored() -> None:
    """The buffer reaches back for ten seconds from each frame's newest stamp."""
    buffer = Buffer()
    buffer.put("tool", "base", 20 * S, moved(20))
    assert "11 s older" in buffer.put("tool", "base", 9 * S, moved(9))
    assert buffer.put("tool", "base", 10 * S, moved(10)) == ""
    buffer.put("base", "map", 10 * S, moved(0))
    assert buffer.lookup("map", "tool").pose == moved(10)
    buffer.put("tool", "base", 21 * S, moved(21))
    assert buffer.lookup("map", "tool")[:2] == (TransformError.NO_COMMON_TIME, "tool")


def test_the_buffer_has_bounds() -> None:
    """A node that invents frames, or stamps, fills no memory; frames that are known stay in use."""
    buffer = Buffer()
    for number in range(5000):
        buffer.put(f"f{number}", "base", S, moved(1), static=True)
    assert "the limit of 4096 frames has been reached" in buffer.put("another", "base", S, moved(1))
    assert "the limit of 4096 frames has been reached" in buffer.put("f1", "another", S, moved(1))
    assert buffer.lookup("base", "another").error == TransformError.UNKNOWN_FRAME
    for number in range(10_002):
        assert buffer.put("f1", "base", S + number, moved(number)) == ""
    buffer.put("f2", "base", S + 2, moved(0))
    assert buffer.lookup("f2", "f1").pose == moved(2)
    buffer.put("f3", "base", S + 1, moved(0))
    assert buffer.lookup("f3", "f1")[:2] == (TransformError.NO_COMMON_TIME, "f1")


def test_of_two_with_one_stamp_the_first_counts() -> None:
    """As in tf2; a static one is replaced by the next."""
    buffer = Buffer()
    for number in (1, 2):
        assert buffer.put("tool", "base", S, moved(number)) == ""
        assert buffer.put("base", "map", 0, moved(number), static=True) == ""
    assert buffer.lookup("base", "tool").pose == moved(1)
    assert buffer.lookup("map", "base").pose == moved(2)


TF = "tf2_msgs/msg/TFMessage"
STATIC = Qos(durability="transient_local", depth=1)
TOOL = "transforms: {tool: {target: base, source: tool, rate: 100Hz, max_age: 2s}}\n"


def tf(*links: tuple[str, str, int, Pose]) -> bytes:
    """Return a message with transforms: child, parent, stamp, pose."""
    axes = "xyzw"
    listed = [
        {
            "header": {"frame_id": parent, "stamp": {"sec": stamp // S, "nanosec": stamp % S}},
            "child_frame_id": child,
            "transform": {
                "translation": dict(zip(axes, pose[:3], strict=False)),
                "rotation": dict(zip(axes, pose[3:], strict=True)),
            },
        }
        for child, parent, stamp, pose in links
    ]
    return wire(TF, {"transforms": listed})


class Tool:
    """A bridge on a stepped clock with one entry, and the PLC's side of it."""

    def __init__(self, cell: Cell, more: str = TOOL) -> None:
        self.clock = SteppedClock()
        self.bridge = cell.start("", more=more, clock=self.clock)
        self.plc = cell.plc("/transforms/tool")
        self.moving = cell.publisher("/tf", TF)
        self.now = self.clock.time_ns()

    def next(self, **expected: Any) -> dict[str, Any]:
        """Let time pass until a record has these fields, and return it."""

        def found() -> dict[str, Any] | None:
            self.clock.advance(0.01)
            record = self.plc.read()
            if record is None or any(record[key] != value for key, value in expected.items()):
                return None
            return record

        return wait_for(found)


def test_the_plc_gets_a_pose_at_its_rate(cell: Cell) -> None:
    """It has the newest common time as its stamp, its age, and the oldest link."""
    tool = Tool(cell)
    cell.publisher("/tf_static", TF, STATIC).write(tf(("tool", "/arm", 0, moved(0, 2))))
    assert tool.next(frame="base")["error"] == TransformError.UNKNOWN_FRAME
    tool.moving.write(tf(("arm", "base", tool.now, moved(1)), ("other", "base", tool.now, moved(9))))
    record = tool.next(error=0)
    assert record["transform"]["translation"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    assert record["transform"]["rotation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    assert (record["frame"], record["is_static"]) == ("arm", False)
    assert record["age_ms"] == pytest.approx((tool.clock.time_ns() - tool.now) / 1e6, abs=20)
    assert tool.plc.reader is not None
    info = tool.plc.reader.peek(bytearray(tool.plc.layout.size))
    assert info is not None and info.stamp_ns == tool.now
    status = tool.bridge.status().topic("/transforms/tool")
    assert (status.received, status.matched) == (status.published, 2)
    assert tool.next(error=TransformError.TOO_OLD)["frame"] == "arm"
    assert tool.next(error=TransformError.TOO_OLD)["age_ms"] > 2000
    status = tool.bridge.status().topic("/transforms/tool")
    assert (status.code, status.reason) == ("ROS023", "tool in base: too old: arm")
    tool.moving.write(tf(("arm", "base", tool.clock.time_ns(), moved(3))))
    assert tool.next(error=0)["transform"]["translation"]["x"] == 3.0


def test_several_publishers_of_static_transforms_before_the_start(cell: Cell) -> None:
    """What each of them keeps is received; such a pose has no stamp and no age."""
    for child, parent in (("tool", "arm"), ("arm", "base")):
        cell.publisher("/tf_static", TF, STATIC).write(tf((child, parent, 5 * S, moved(1))))
    record = Tool(cell).next(error=0)
    assert (record["is_static"], record["age_ms"], record["frame"]) == (True, 0, "")
    assert record["transform"]["translation"]["x"] == 2.0


def test_messages_of_any_size(cell: Cell) -> None:
    """Three hundred transforms in one message are received as one is, with names of any length."""
    tool, long = Tool(cell), "long_" * 20
    frames = ["base", *(f"{long}{number}" for number in range(150)), "tool"]
    pairs = list(pairwise(frames))
    tool.moving.write(tf(*((child, parent, tool.now, moved(1)) for parent, child in pairs)))
    assert tool.next(error=0)["transform"]["translation"]["x"] == len(pairs)
    tool.moving.write(tf(("tool", frames[-2], tool.now + 1, moved(1))))
    assert tool.next(frame=(long + "0")[:80])["error"] == 0


def test_what_cannot_be_used_is_logged(cell: Cell, caplog: pytest.LogCaptureFixture) -> None:
    """The rest of the message counts, and the messages after one that cannot be read."""
    tool = Tool(cell)
    tool.moving.write(tf(("x" * 256, "base", tool.now, moved(1))))
    tool.moving.write(
        tf(("tool", "base", tool.now, (0.0,) * 7), ("tool", "base", tool.now, moved(1)))  # type: ignore[arg-type]
    )
    tool.next(error=0)
    assert "/tf: ignored 'tool' in 'base': (0.0" in caplog.text
    assert "/tf: message ignored: " in caplog.text and "string has 256 bytes; the limit is 255" in caplog.text


def test_reload_keeps_what_was_received(cell: Cell) -> None:
    """A new entry has a pose at once; after the last entry nothing is subscribed, or remembered."""
    tool = Tool(cell)
    tool.moving.write(tf(("tool", "base", tool.now, moved(1))))
    tool.next(error=0)
    both = TOOL.replace("tool:", "other: {target: tool, source: base}, tool:")
    tool.bridge.reload(parse_config(cell.config("", more=both)))
    tool.plc = cell.plc("/transforms/other")
    assert tool.next(error=0)["transform"]["translation"]["x"] == -1.0
    assert tool.moving.matched == 1
    tool.bridge.reload(parse_config(cell.config("")))
    assert tool.moving.matched == 0
    tool.bridge.reload(parse_config(cell.config("", more=TOOL)))
    assert tool.moving.matched == 1
    tool.plc = cell.plc("/transforms/tool")
    assert tool.next(frame="base")["error"] == TransformError.UNKNOWN_FRAME


def test_a_bridge_of_ros_1(shm_namespace: Namespace) -> None:
    """ROS 1's serialization, with its sequence numbers in the headers, is read as well."""
    store = TypeStore.bundled("noetic")
    peer = open_backend(store, "peer", domain=43)
    config = f"prefix: {shm_namespace.prefix}\nros: {{backend: memory, domain: 43, distro: noetic}}\n{TOOL}"
    layout = compute_layout(store, TF)
    stamp = time.time_ns()
    link = {
        "header": {"seq": 7, "frame_id": "base", "stamp": {"sec": stamp // S, "nanosec": stamp % S}},
        "child_frame_id": "tool",
        "transform": {"translation": {"z": 4.0}, "rotation": {"w": 1.0}},
    }
    with Bridge(parse_config(config)) as bridge, contextlib.closing(peer):
        peer.advertise("/tf", TF, Qos()).write(
            Codec(layout, Wire.ROS1).encode(layout.pack({"transforms": [link]}))
        )
        plc = PlcTopic(shm_namespace, "/transforms/tool", bridge.project.topics[0].layout, to_plc=True)

        def found() -> Any:
            record = plc.read()
            return record if record is not None and not record["error"] else None

        assert wait_for(found)["transform"]["translation"]["z"] == 4.0
        plc.attached.close()


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("{target: a, source: /b}", "without leading /"),
        ("{target: a}", "'source' is missing"),
        ("{target: a b, source: c}", "should be a frame"),
        ("{target: a, source: b, rate: 2kHz}", "not between 1ms and 1h"),
        ("{target: a, source: b, task: Slow}", "task 'Slow' is not defined"),
    ],
)
def test_what_an_entry_cannot_be(entry: str, words: str) -> None:
    """Each mistake is found at its line."""
    with pytest.raises(ConfigErrors, match=words) as caught:
        resolve(parse_config(f"transforms:\n  tool: {entry}\n"))
    assert "<text>:2" in str(caught.value)


def test_a_topic_of_the_entrys_name_is_refused() -> None:
    """Both would have the same object."""
    with pytest.raises(ConfigErrors, match="CFG007"):
        resolve(parse_config(f"topics:\n  /transforms/tool: {{type: {INT}, to: plc}}\n{TOOL}"))
