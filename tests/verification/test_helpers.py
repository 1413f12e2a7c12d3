"""The helpers of the generated project, executed, against values computed here."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
import pytest

from rosplc.plc.base import HELPER_NAMES
from rosplc.plc.build import build_type_library
from rosplc_st.build import Build, build
from rosplc_st.machine import LibraryMachine
from rosplc_st.translator import Options
from tests.verification.plc_cell import project_texts, store

TIMES = """PROGRAM Times
VAR
    stTime : builtin_interfaces_Time;
    stDuration : builtin_interfaces_Duration;
    ltTime : LTIME;
    ldtTime : LDT;
    tTime : TIME;
    ltOfTime : LTIME;
    ldtOfTime : LDT;
    tOfDuration : TIME;
    stOfLtime : builtin_interfaces_Time;
    stOfLdt : builtin_interfaces_Time;
    stOfTime : builtin_interfaces_Duration;
END_VAR
ltOfTime := RosPlc_TimeToLtime(stTime := stTime);
ldtOfTime := RosPlc_TimeToLdt(stTime := stTime);
stOfLtime := RosPlc_LtimeToTime(ltTime := ltTime);
stOfLdt := RosPlc_LdtToTime(ldtTime := ldtTime);
tOfDuration := RosPlc_DurationToTime(stDuration := stDuration);
stOfTime := RosPlc_TimeToDuration(tTime := tTime);
END_PROGRAM
"""
ANGLES = """PROGRAM Angles
VAR
    lrY : LREAL;
    lrX : LREAL;
    lrAngle : LREAL;
    stQuaternion : geometry_msgs_Quaternion;
    stAngles : RosPlc_YawPitchRoll;
    stOfQuaternion : RosPlc_YawPitchRoll;
    stOfAngles : geometry_msgs_Quaternion;
END_VAR
lrAngle := RosPlc_Atan2(lrY := lrY, lrX := lrX);
stOfQuaternion := RosPlc_QuaternionToYpr(stQuaternion := stQuaternion);
stOfAngles := RosPlc_YprToQuaternion(stAngles := stAngles);
END_PROGRAM
"""
ASK = """PROGRAM Ask
VAR
    fb : RosPlc_Handshake;
END_VAR
fb();
END_PROGRAM
"""
REPLY = """PROGRAM Reply
VAR
    fb : RosPlc_HandshakeReply;
END_VAR
fb();
END_PROGRAM
"""
NS = 1_000_000_000
Matrix: TypeAlias = "np.ndarray[Any, Any]"


@lru_cache
def built(cpu_bits: int = 64) -> Build:
    """Return the helpers and the programs that call them."""
    texts = project_texts(build_type_library(store(), []))
    return build(
        {**texts, "Times": TIMES, "Angles": ANGLES, "Ask": ASK, "Reply": REPLY}, Options(cpu_bits=cpu_bits)
    )


def started(cpu_bits: int = 64) -> LibraryMachine:
    machine = LibraryMachine(built(cpu_bits))
    machine.start()
    return machine


@pytest.fixture(params=[64, 32])
def plc(request: pytest.FixtureRequest) -> LibraryMachine:
    return started(request.param)


def call(machine: LibraryMachine, program: str, **inputs: Any) -> None:
    """Set a program's variables (``stTime__sec`` is ``stTime.sec``) and run it."""
    for name, value in inputs.items():
        machine.set(f"{program}.{name.replace('__', '.')}", value)
    machine.scan(program)


def test_every_helper_is_executed() -> None:
    """No helper stays outside this module, and its text is in the project."""
    used = TIMES + ANGLES + ASK + REPLY
    texts = project_texts(build_type_library(store(), []))
    for name in HELPER_NAMES:
        assert name in texts and name in used


# ---- times


@pytest.mark.parametrize("sec", [0, 1, 1_700_000_000, 2**31 - 1])
@pytest.mark.parametrize("nanosec", [0, 1, 999_999_999])
def test_a_time_there_and_back(plc: LibraryMachine, sec: int, nanosec: int) -> None:
    """A ROS time is its nanoseconds as LTIME and LDT, and the same time again."""
    total = sec * NS + nanosec
    call(plc, "Times", stTime__sec=sec, stTime__nanosec=nanosec, ltTime=total, ldtTime=total)
    assert plc.get("Times.ltOfTime") == plc.get("Times.ldtOfTime") == total
    for name in ("stOfLtime", "stOfLdt"):
        assert (plc.get(f"Times.{name}.sec"), plc.get(f"Times.{name}.nanosec")) == (sec, nanosec)


@pytest.mark.parametrize("sec", [-1, -(2**31)])
def test_a_time_before_1970(plc: LibraryMachine, sec: int) -> None:
    """Negative seconds give 0, whatever the nanoseconds."""
    call(plc, "Times", stTime__sec=sec, stTime__nanosec=999_999_999)
    assert plc.get("Times.ltOfTime") == plc.get("Times.ldtOfTime") == 0


@pytest.mark.parametrize("total", [2**31 * NS, 2**31 * NS + 5, 2**32 * NS + 5, 2**63, 2**64 - 1])
def test_a_time_beyond_2038(plc: LibraryMachine, total: int) -> None:
    """Later times stay at the last one that ROS 2 can tell."""
    call(plc, "Times", ltTime=total, ldtTime=total)
    for name in ("stOfLtime", "stOfLdt"):
        assert plc.get(f"Times.{name}.sec") == 2**31 - 1
        assert plc.get(f"Times.{name}.nanosec") == 999_999_999


@pytest.mark.parametrize(
    ("sec", "nanosec", "ms"),
    [
        (0, 0, 0),
        (0, 999_999, 0),  # parts of a millisecond are cut off
        (0, 1_000_000, 1),
        (1, 999_999_999, 1999),
        (4_294_967, 295_000_000, 2**32 - 1),
        (4_294_967, 296_000_000, 2**32 - 1),
        (2**31 - 1, 999_999_999, 2**32 - 1),
        (-1, 999_999_999, 0),
        (-(2**31), 0, 0),
    ],
)
def test_a_duration_as_time(plc: LibraryMachine, sec: int, nanosec: int, ms: int) -> None:
    """A duration is its whole milliseconds, within what TIME can tell."""
    call(plc, "Times", stDuration__sec=sec, stDuration__nanosec=nanosec)
    assert plc.get("Times.tOfDuration") == ms


@pytest.mark.parametrize("ms", [0, 1, 999, 1000, 1001, 123_456_789, 2**32 - 1])
def test_a_time_as_duration(plc: LibraryMachine, ms: int) -> None:
    """TIME is a duration in seconds and nanoseconds."""
    call(plc, "Times", tTime=ms)
    sec, rest = divmod(ms, 1000)
    assert plc.get("Times.stOfTime.sec") == sec
    assert plc.get("Times.stOfTime.nanosec") == rest * 1_000_000


# ---- angles


@pytest.mark.parametrize("x", [0.0, 1e-300, 1.0, 3.7, 1e300, -1e-300, -1.0, -3.7])
@pytest.mark.parametrize("y", [0.0, 1e-300, 1.0, 2.9, 1e300, -1e-300, -1.0, -2.9])
def test_atan2(x: float, y: float) -> None:
    """Every quadrant, axis and the origin give what the C library gives."""
    machine = started()
    call(machine, "Angles", lrY=y, lrX=x)
    assert machine.get("Angles.lrAngle") == pytest.approx(math.atan2(y, x), abs=1e-15)


def turn(axis: int, angle: float) -> Matrix:
    """Return the matrix of a rotation about a coordinate axis."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[a, a] = matrix[b, b] = math.cos(angle)
    matrix[b, a] = math.sin(angle)
    matrix[a, b] = -math.sin(angle)
    return matrix


def matrix_of_angles(yaw: float, pitch: float, roll: float) -> Matrix:
    matrix: Matrix = turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)
    return matrix


def matrix_of_quaternion(x: float, y: float, z: float, w: float) -> Matrix:
    """Return the matrix by Rodrigues' formula from axis and angle."""
    length = math.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return np.eye(3)
    angle = 2.0 * math.atan2(length, w)
    x, y, z = x / length, y / length, z / length
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: Matrix = np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)
    return matrix


def angles_of(machine: LibraryMachine, quaternion: tuple[float, ...]) -> tuple[float, float, float]:
    call(machine, "Angles", **dict(zip(("stQuaternion__x", "stQuaternion__y", "stQuaternion__z",
                                        "stQuaternion__w"), quaternion, strict=True)))  # fmt: skip
    yaw, pitch, roll = (machine.get(f"Angles.stOfQuaternion.{n}") for n in ("lrYaw", "lrPitch", "lrRoll"))
    return yaw, pitch, roll


def quaternion_of(machine: LibraryMachine, yaw: float, pitch: float, roll: float) -> tuple[float, ...]:
    call(machine, "Angles", stAngles__lrYaw=yaw, stAngles__lrPitch=pitch, stAngles__lrRoll=roll)
    return tuple(machine.get(f"Angles.stOfAngles.{n}") for n in "xyzw")


def test_random_orientations() -> None:
    """Angles and quaternion describe the rotation that matrices compute; the length does not matter."""
    machine, draw = started(), random.Random(7)
    for _ in range(500):
        quaternion = tuple(draw.gauss(0, 1) * 10.0 ** draw.randint(-3, 3) for _ in "xyzw")
        yaw, pitch, roll = angles_of(machine, quaternion)
        assert abs(pitch) <= math.pi / 2 and abs(yaw) <= math.pi and abs(roll) <= math.pi
        np.testing.assert_allclose(
            matrix_of_angles(yaw, pitch, roll), matrix_of_quaternion(*quaternion), atol=1e-9
        )
        back = quaternion_of(machine, yaw, pitch, roll)
        assert math.hypot(*back) == pytest.approx(1.0, abs=1e-14)
        np.testing.assert_allclose(matrix_of_quaternion(*back), matrix_of_quaternion(*quaternion), atol=1e-9)


def test_known_orientation() -> None:
    """A quarter turn about z is a yaw of 90 degrees."""
    machine, half = started(), math.sqrt(0.5)
    assert angles_of(machine, (0.0, 0.0, half, half)) == pytest.approx((math.pi / 2, 0.0, 0.0), abs=1e-15)
    assert quaternion_of(machine, math.pi / 2, 0.0, 0.0) == pytest.approx((0.0, 0.0, half, half), abs=1e-15)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-9, 1e-7, 1e-4])
def test_gimbal_lock(sign: int, off: float) -> None:
    """Straight up and down, and close to it, the angles still describe the rotation."""
    machine, draw = started(), random.Random(11)
    for _ in range(50):
        yaw, roll = draw.uniform(-math.pi, math.pi), draw.uniform(-math.pi, math.pi)
        wanted = matrix_of_angles(yaw, sign * (math.pi / 2 - off), roll)
        quaternion = quaternion_of(machine, yaw, sign * (math.pi / 2 - off), roll)
        np.testing.assert_allclose(matrix_of_quaternion(*quaternion), wanted, atol=1e-12)
        found = angles_of(machine, quaternion)
        np.testing.assert_allclose(matrix_of_angles(*found), wanted, atol=1e-7)
        assert found[1] == pytest.approx(sign * (math.pi / 2 - off), abs=1e-7)
        if off == 0.0:
            assert found[2] == 0.0


def test_a_zero_quaternion() -> None:
    """A quaternion of zeros, as an unfilled message has it, gives zero angles."""
    assert angles_of(started(), (0.0, 0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)


# ---- handshake


class Pair:
    """Both sides, each in its PLC; a message takes from one scan to the next."""

    def __init__(self, clock: int = 0) -> None:
        self.ask, self.reply = self._machine(clock), self._machine(clock + 77)
        self.heard = {"udiDone": 0, "udiJob": 0}
        self.news = False
        self.started: list[int] = []
        self.jobs: list[int] = []

    @staticmethod
    def _machine(clock: int) -> LibraryMachine:
        machine = started()
        machine.set_time(clock)
        return machine

    def restart_ask(self, clock: int) -> None:
        """Start the asking side again; it hears the other's last message at once, which is retained."""
        self.ask = self._machine(clock)

    def restart_reply(self) -> None:
        """Start the doing side again; what it then finds is a retained message, not a new one."""
        self.reply = self._machine(5)

    def scan(self, count: int = 1, *, news: bool = True, linked: bool = True, **inputs: Any) -> None:
        """Run both sides; ``news``: the asking side's message arrives as a new one; ``linked``: at all."""
        finished = inputs.pop("xFinished", None)
        for name, value in inputs.items():
            self.ask.set(f"Ask.fb.{name}", value)
        for _ in range(count):
            self.ask.set("Ask.fb.udiDone", self.heard["udiDone"])
            self.ask.scan("Ask")
            self.reply.set("Reply.fb.udiJob", self.heard["udiJob"])
            self.reply.set("Reply.fb.xNewJob", news and linked)
            if finished is not None:
                self.reply.set("Reply.fb.xFinished", finished)
            self.reply.scan("Reply")
            if self.reply.get("Reply.fb.xStart"):
                self.started.append(self.heard["udiJob"])
            if linked:
                self.heard = {
                    "udiDone": self.reply.get("Reply.fb.udiDone"), "udiJob": self.ask.get("Ask.fb.udiJob")
                }  # fmt: skip

    def state(self) -> tuple[bool, bool, bool, int]:
        """Return xBusy, xDone, xError, udiError."""
        return tuple(self.ask.get(f"Ask.fb.{n}") for n in ("xBusy", "xDone", "xError", "udiError"))


BUSY, DONE, IDLE = (True, False, False, 0), (False, True, False, 0), (False, False, False, 0)


@pytest.fixture(params=[0, 1, 4_294_967_290])
def pair(request: pytest.FixtureRequest) -> Iterator[Pair]:
    """Both sides, at clocks that start, or are about to wrap around."""
    yield Pair(request.param)


def test_a_job_is_done(pair: Pair) -> None:
    """Job after job: asked, begun once, reported until xExecute falls."""
    for number in range(1, 4):
        pair.scan(5, xExecute=True, xFinished=False)
        assert pair.state() == BUSY
        assert len(pair.started) == number
        assert pair.reply.get("Reply.fb.xBusy")
        pair.scan(3, xFinished=True)
        assert pair.state() == DONE
        pair.scan(5)
        assert pair.state() == DONE
        pair.scan(1, xExecute=False, xFinished=False)
        assert pair.state() == IDLE
        pair.scan(3)
    assert len(set(pair.started)) == 3 and 0 not in pair.started


def test_the_time_is_over(pair: Pair) -> None:
    """Error 126 after the time, not before it; T#0ms waits for ever; the job given up is not begun later."""
    pair.scan(100, linked=False, xExecute=True, tTimeout=0)
    assert pair.state() == BUSY
    pair.scan(1, linked=False, tTimeout=1000)
    assert pair.state() == BUSY
    pair.scan(1, linked=False)
    assert pair.state() == (False, False, True, 126)
    pair.scan(10)
    assert pair.state() == (False, False, True, 126)
    assert pair.started == []
    pair.scan(1, xExecute=False)
    assert pair.state() == IDLE


def test_the_peer_falls_silent(pair: Pair) -> None:
    """Error 125 as soon as the peer shows no life."""
    pair.scan(5, xExecute=True)
    assert pair.state() == BUSY
    pair.scan(1, xPeerAlive=False)
    assert pair.state() == (False, False, True, 125)
    pair.scan(1, xExecute=False)
    assert pair.state() == IDLE


def test_a_silent_peer_is_not_asked(pair: Pair) -> None:
    """While the peer is silent no job goes out, so that it finds none when it comes back."""
    pair.scan(1, xExecute=True, xPeerAlive=False)
    assert pair.state() == (False, False, True, 125)
    pair.scan(5, xPeerAlive=True)
    assert pair.started == []
    assert pair.state() == (False, False, True, 125)


def test_the_job_after_one_given_up(pair: Pair) -> None:
    """The answer to a job given up does not answer the next one, which is begun after it."""
    pair.scan(3, xExecute=True, xFinished=False)
    pair.scan(1, xPeerAlive=False)
    pair.scan(1, xExecute=False, xPeerAlive=True)
    pair.scan(3, xExecute=True)
    pair.scan(1, xFinished=True)
    pair.scan(1, xFinished=False)
    pair.scan(5)
    assert pair.state() == BUSY and len(pair.started) == 2
    pair.scan(3, xFinished=True)
    assert pair.state() == DONE


def test_a_second_edge_while_busy(pair: Pair) -> None:
    """A request made again while the first is under way is a job of its own."""
    pair.scan(3, xExecute=True, xFinished=False)
    pair.scan(1, xExecute=False)
    pair.scan(1, xExecute=True)
    pair.scan(1, xFinished=True)
    pair.scan(1, xFinished=False)
    for _ in range(6):
        pair.scan(1)
        assert pair.state() == BUSY or pair.state() == IDLE
    assert pair.state() == BUSY and len(set(pair.started)) == 2
    pair.scan(3, xFinished=True)
    assert pair.state() == DONE


@pytest.mark.parametrize("before", [0, 1, 3])
def test_the_asking_side_restarts_with_a_job_in_hand(before: int) -> None:
    """The answer to the job asked for before the restart does not answer the one asked for after it."""
    pair = Pair(1000)
    for _ in range(before):
        pair.scan(5, xExecute=True, xFinished=True)
        pair.scan(5, xExecute=False, xFinished=False)
    pair.scan(5, xExecute=True, xFinished=False)
    pair.restart_ask(3456)
    pair.scan(5, xExecute=True)
    pair.scan(1, xFinished=True)
    pair.scan(1, xFinished=False)
    pair.scan(5)
    assert pair.state() == BUSY
    assert len(pair.started) == len(set(pair.started)) == before + 2
    pair.scan(3, xFinished=True)
    assert pair.state() == DONE


def test_the_asking_side_restarts_before_it_hears() -> None:
    """A job asked for before the first answer is heard is not taken for done when that arrives."""
    pair = Pair(1000)
    pair.scan(5, xExecute=True, xFinished=True)
    assert pair.state() == DONE
    old = dict(pair.heard)
    pair.restart_ask(3456)
    pair.heard = {"udiDone": 0, "udiJob": 0}
    pair.scan(1, xExecute=True, xFinished=False)
    pair.heard["udiDone"] = old["udiDone"]
    pair.scan(4)
    assert pair.state() == BUSY and len(pair.started) == 2


def test_the_doing_side_restarts_after_a_job() -> None:
    """A job done is not begun again by a doing side that starts again, new messages or not."""
    pair = Pair()
    pair.scan(5, xExecute=True, xFinished=True)
    assert pair.state() == DONE and len(pair.started) == 1
    pair.restart_reply()
    pair.scan(5, news=False)
    pair.scan(5, news=True)
    assert len(pair.started) == 1
    pair.scan(1, xExecute=False)
    pair.scan(5, xExecute=True, xFinished=True)
    assert pair.state() == DONE and len(set(pair.started)) == 2


def test_a_retained_job() -> None:
    """A job in a retained message is not begun by a doing side that starts again; the asking one gives up."""
    pair = Pair()
    pair.scan(3, xExecute=True, xFinished=False, tTimeout=500)
    assert len(pair.started) == 1
    pair.restart_reply()
    pair.scan(60, news=False)
    assert len(pair.started) == 1
    assert pair.state() == (False, False, True, 126)


def test_a_job_that_comes_once_while_another_is_in_hand() -> None:
    """A new job whose only message comes while the one given up is still in hand is begun after it."""
    pair = Pair()
    pair.scan(3, xExecute=True, xFinished=False)
    pair.scan(1, xPeerAlive=False)
    pair.scan(1, xExecute=False, xPeerAlive=True)
    pair.scan(2, xExecute=True)
    pair.scan(3, news=False)
    pair.scan(1, news=False, xFinished=True)
    pair.scan(1, news=False, xFinished=False)
    assert len(set(pair.started)) == 2
    pair.scan(3, news=False, xFinished=True)
    assert pair.state() == DONE


def test_numbers_wrap_around() -> None:
    """Behind the largest number comes 1, and the jobs there are done as any other."""
    pair = Pair(2**32 - 10)  # the first scan is at 0: the first number leaps by nothing
    pair.heard["udiDone"] = 2**32 - 2
    pair.reply.set("Reply.fb.udiDone", 2**32 - 2)
    for _ in range(4):
        pair.scan(6, xExecute=True, xFinished=True)
        assert pair.state() == DONE
        pair.scan(2, xExecute=False, xFinished=False)
    assert pair.started == [2**32 - 1, 1, 2, 3]
