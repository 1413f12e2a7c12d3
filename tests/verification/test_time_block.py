"""``RosPlc_Time``, executed: ROS time between the bridge's messages, its uncertainty, jumps and pauses."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from rosplc.ros import Publisher, Qos
from tests.lib.clock import SteppedClock
from tests.lib.waiting import wait_for
from tests.verification.joint import RULES, Joint, encode, made_joint

pytestmark = pytest.mark.verifies("ros-blocks", own="translated Structured Text")

DOMAIN = 59
CLOCK = "rosgraph_msgs/msg/Clock"
CONFIG = f"""bridge: cell
ros: {{backend: memory, domain: {DOMAIN}}}
shm: {{directory: FOLDER}}
diagnostics: {{enabled: false}}
rosout: {{bridge: false}}
time: {{plc: true}}
"""
SIM = CONFIG.replace("plc: true", "plc: true, use_sim_time: true")
MS = 1_000_000
S = 1000 * MS


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


@pytest.fixture(params=RULES)
def joint(clock: SteppedClock, request: pytest.FixtureRequest) -> Iterator[Joint]:
    """Give a PLC whose bridge takes the time from the system."""
    with made_joint(CONFIG, "ROS_Read", DOMAIN, clock=clock, rule=request.param) as made:
        yield made


@pytest.fixture
def sim(clock: SteppedClock) -> Iterator[Joint]:
    """Give a PLC whose bridge takes the time from /clock."""
    with made_joint(SIM, "ROS_Read", DOMAIN, clock=clock) as made:
        yield made


def run(joint: Joint, clock: SteppedClock, ms: int, factor: float = 1.0) -> None:
    """Let scans of 10 ms pass; ``factor``: how fast the bridge's clock runs. The time is right at each."""
    for _ in range(ms // 10):
        clock.step(0.01 * factor)
        joint.scan(step=10)
        check(joint, clock)


def check(joint: Joint, clock: SteppedClock) -> None:
    known, now, uncertainty = joint.get("ros_time", "xKnown", "uliNow", "uliUncertainty")
    if known:
        assert abs(now - clock.time_ns()) <= uncertainty


def most(joint: Joint) -> int:
    """Return the largest uncertainty: half of one scan, or of three, and what TIME() does not show."""
    return 18 * MS if joint.get("ros_time", "xDelayed") else 8 * MS


def start(joint: Joint, clock: SteppedClock) -> None:
    while not joint.get("ros_time", "xKnown"):
        run(joint, clock, 10)


@pytest.mark.parametrize("factor", [1.0, 0.99995, 1.00005])
def test_ros_time_between_messages(joint: Joint, clock: SteppedClock, factor: float) -> None:
    """It runs at each scan, is never wrong by more than the uncertainty, and never goes back."""
    start(joint, clock)
    before = joint.get("ros_time", "uliNow")
    for _ in range(300):
        run(joint, clock, 10, factor)
        now = joint.get("ros_time", "uliNow")
        # A message corrects by half a scan at most, and by what the clocks may have drifted apart.
        assert abs(now - before - 10 * MS) <= 5 * MS + MS // 10
        before = now
    uncertainty, jumps, sim, paused = joint.get("ros_time", "uliUncertainty", "udiJumps", "xSim", "xPaused")
    assert 0 < uncertainty <= most(joint)
    assert (jumps, sim, paused) == (0, False, False)
    offset, plc = joint.get("ros_time", "liOffset", "udiNow")
    assert offset == before - plc * MS


def test_the_uncertainty_grows_without_a_bridge(joint: Joint, clock: SteppedClock) -> None:
    """By 100 ppm; the time goes on, and a bridge that returns narrows it again without a jump."""
    start(joint, clock)
    run(joint, clock, 1000)
    threads = clock.waiting
    joint.stop_bridge()
    before = joint.get("ros_time", "uliUncertainty")
    for _ in range(1000):
        clock.advance(0.1 * 1.00008)
        joint.scan(step=100)
        check(joint, clock)
    assert joint.get("ros_time", "uliUncertainty") == pytest.approx(before + 10 * MS, abs=MS)
    assert joint.get("ros_time", "xStale") is True
    joint.start_bridge()
    joint.until(lambda: joint.get("ros_time", "xAttached"), "the new bridge", step=0)
    clock.until_waiting(threads)  # a step that falls into a write of its looks like one that took so long
    run(joint, clock, 500)
    assert joint.get("ros_time", "uliUncertainty") <= most(joint)
    assert joint.get("ros_time", "udiJumps") == 0


@pytest.mark.parametrize("back", [3600.0, -3600.0, 0.5, -0.5])
def test_a_stepped_system_clock_is_a_jump(joint: Joint, clock: SteppedClock, back: float) -> None:
    """XJumped shows for one call, liJump how far; a step of 20 ms is none, and is followed."""
    start(joint, clock)
    run(joint, clock, 500)
    clock.set_back(back)
    seen = []
    for _ in range(30):
        clock.step(0.01)
        joint.scan(step=10)
        if joint.get("ros_time", "xJumped"):
            seen.append(joint.get("ros_time", "liJump"))
        if seen:
            check(joint, clock)
    assert seen == [pytest.approx(-back * S, abs=15 * MS)]
    clock.set_back(back / abs(back) * 0.02)
    for _ in range(11):
        clock.step(0.01)
        joint.scan(step=10)
    assert joint.get("ros_time", "udiJumps") == 1
    now = joint.get("ros_time", "uliNow")
    assert abs(now - clock.time_ns()) <= 33 * MS


def tell(sim: Joint, clock: SteppedClock, publisher: Publisher, ns: int) -> None:
    """Publish a time on /clock; return when the PLC has it."""
    publisher.write(encode(CLOCK, clock={"sec": ns // S, "nanosec": ns % S}))
    wait_for(lambda: step(sim, clock) == ns, "this time")


def step(sim: Joint, clock: SteppedClock) -> int:
    """Let one scan pass; return the time that the PLC has."""
    clock.step(0.01)
    sim.scan(step=10)
    found: int = sim.get("ros_time", "msg.now")
    return found


def test_simulated_time(sim: Joint, clock: SteppedClock) -> None:
    """It is what /clock said last; a pause and jumps are shown, and the pause's end is no jump."""
    sim.scan(count=20, step=10)
    assert sim.get("ros_time", "xKnown") is False
    publisher = sim.peer.advertise("/clock", CLOCK, Qos(depth=10))
    sim.until(lambda: sim.get("ros_time", "xAttached"), "the bridge", step=10)
    tell(sim, clock, publisher, 5 * S)
    while not sim.get("ros_time", "xKnown"):  # the first may be a state found at the start
        tell(sim, clock, publisher, 5 * S)
    for number in range(1, 21):
        tell(sim, clock, publisher, 5 * S + number * 20 * MS)
        assert sim.get("ros_time", "uliNow", "xSim", "xPaused") == (5 * S + number * 20 * MS, True, False)
    for _ in range(60):
        clock.step(0.01)
        sim.scan(step=10)
        assert sim.get("ros_time", "uliNow") == 5_400 * MS
    assert sim.get("ros_time", "xPaused", "uliUncertainty", "xStale") == (True, 0, False)
    tell(sim, clock, publisher, 5_420 * MS)
    assert sim.get("ros_time", "xPaused", "udiJumps") == (False, 0)
    tell(sim, clock, publisher, 5_410 * MS)
    assert sim.get("ros_time", "uliNow", "udiJumps", "liJump") == (5_410 * MS, 1, -10 * MS)
    tell(sim, clock, publisher, 100 * S)
    assert sim.get("ros_time", "uliNow", "udiJumps", "liJump") == (100 * S, 2, 94_590 * MS)
    clock.step(0.2)
    sim.scan(step=200)
    assert sim.get("ros_time", "xJumped") is False
