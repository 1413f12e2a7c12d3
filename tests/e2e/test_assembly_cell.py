"""The example cell: whatever dies during a hand-over, nothing is done twice and nothing is lost."""

from __future__ import annotations

import importlib.util
import json
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import deque
from pathlib import Path
from types import SimpleNamespace

import pytest

from examples.assembly_cell.cell import HERE, generate
from examples.assembly_cell.plc_python import Press
from examples.assembly_cell.view import picture
from examples.assembly_cell.world import World
from rosplc.demo.st.process import find_translator

pytestmark = [
    pytest.mark.timeout(900),
    pytest.mark.verifies("example-cell", own="a simulated machine, killed processes, both PLC programs"),
]
ROOT = Path(__file__).resolve().parents[2]
STEP_S = 0.01


class HandOver:
    """The pins of the action's block."""

    def __init__(self) -> None:
        self.xServer = True
        self.xBusy = self.xDone = self.xError = self.xAborted = self.xNewFeedback = self.xExecute = False
        self.goal = SimpleNamespace(what=0, serial=0)
        self.feedback = SimpleNamespace(phase=0)
        self.result = SimpleNamespace(moved=False)
        self.number = 0
        self.ended: tuple[str, bool] | None = None  # for the next scan
        self.unsent: tuple[int, int] | None = None
        self._before = False

    def __call__(self) -> None:
        rose, self._before = self.xExecute and not self._before, self.xExecute
        if self.ended is not None:
            pin, self.result.moved = self.ended
            setattr(self, pin, True)
            self.xBusy, self.ended = False, None
        elif rose or not self.xExecute:
            self.xDone = self.xError = self.xAborted = False
        if rose and not self.xBusy:
            self.xBusy, self.unsent = True, (self.goal.what, self.goal.serial)
            self.number += 1

    def end(self, number: int, pin: str, moved: bool) -> None:
        """Take an answer of ROS, unless it is to another goal, or the second one."""
        if number == self.number and self.xBusy and self.ended is None:
            self.ended = pin, moved


class Simulated:
    """World and PLC program in one thread, with messages that are late, and parts that die, by a seed."""

    def __init__(self, seed: int, handles: int) -> None:
        self.chance = random.Random(seed)
        self.world = World(tray=handles)
        self.up: deque[tuple[int, SimpleNamespace]] = deque()
        # On their way to the robot, and back: each with the block and the number of its goal.
        self.goals: list[tuple[int, HandOver, int, tuple[int, int]]] = []
        self.ends: list[tuple[int, HandOver, int, str, bool]] = []
        self.doing: tuple[HandOver, int] | None = None  # what the robot has in hand
        self.heard_at = self.bridge_back = self.plc_back = self.stopped_until = 0
        self.now = self.ended = self.cancel_at = 0
        self.restart_plc()

    def restart_plc(self) -> None:
        self.press, self.hand_over = Press(), HandOver()
        self.robot: SimpleNamespace | None = None

    def later(self) -> int:
        return self.now + self.chance.randint(0, 30)

    def step(self) -> None:
        self.now += 1
        world, chance = self.world, self.chance
        if chance.random() < 0.004:
            self.bridge_back = self.now + chance.randint(5, 200)
        if chance.random() < 0.004:
            self.plc_back = self.now + chance.randint(1, 100)
            self.cancel_at = self.later() if chance.random() < 0.7 else 0  # it does not always get there
            self.restart_plc()
        if chance.random() < 0.002:
            self.stopped_until = self.now + chance.randint(1, 200)
        bridge, plc = self.now >= self.bridge_back, self.now >= self.plc_back
        world.stopped = self.now < self.stopped_until
        if self.now % 5 == 0 and bridge:  # what is sent into a dead bridge is lost; the rest comes late
            state = SimpleNamespace(
                phase=world.phase, stopped=world.stopped, placed=world.placed, delivered=len(world.box),
                tray=world.tray,
            )  # fmt: skip
            self.up.append((self.later(), state))
        fresh = False
        while self.up and self.up[0][0] <= self.now:
            self.robot, self.heard_at, fresh = self.up.popleft()[1], self.now, True
        if plc:
            self.scan(bridge, fresh)
        self.carry(bridge)
        world.step(STEP_S, press_down=plc and self.press.xPressDown)
        if world.ended != self.ended:
            self.ended = world.ended
            if self.doing is not None:
                self.ends.append((self.later(), *self.doing, "xDone", world.moved))
            self.doing = None

    def scan(self, bridge: bool, fresh: bool) -> None:
        nest = self.world.nest
        io = {
            "xOccupied": nest is not None,
            "xPinIn": nest is not None and nest.pins > 0,
            "xZoneFree": self.world.zone_free,
            "xPressUp": self.world.cylinder == 0.0,
        }
        block = self.hand_over
        block()
        alive = bridge and self.now - self.heard_at < 50
        self.press(io, self.robot, block, xNew=fresh, xAlive=alive)
        if bridge and block.unsent is not None:
            self.goals.append((self.later(), block, block.number, block.unsent))
            block.unsent = None
            if self.chance.random() < 0.1:  # its fate is unknown, and it arrives nevertheless
                self.ends.append((self.later(), block, block.number, "xError", False))

    def carry(self, bridge: bool) -> None:
        """Goals, requests to cancel and ends arrive, in any order."""
        for one in [one for one in self.goals if one[0] <= self.now]:
            self.goals.remove(one)
            _, block, number, goal = one
            if self.world.take(*goal):
                self.doing = block, number
            else:
                self.ends.append((self.later(), block, number, "xError", False))
        forgotten = self.doing is not None and self.doing[0] is not self.hand_over
        if forgotten and self.now == self.cancel_at and self.world.drop():
            self.doing = None
        for end in [end for end in self.ends if end[0] <= self.now and bridge]:
            self.ends.remove(end)
            end[1].end(*end[2:])


@pytest.mark.parametrize("seed", range(40))
def test_late_messages_and_sudden_deaths_do_no_harm(seed: int) -> None:
    """Bridge, PLC and robot fail at random, messages come late: every handle is made once, in order."""
    cell = Simulated(seed, 6)
    while len(cell.world.box) < 6:
        cell.step()
        assert cell.now < 500_000, "nothing goes on any more"
        assert cell.world.mishaps == []
    assert cell.world.box == [1, 2, 3, 4, 5, 6]


def test_the_world_notices_what_must_not_happen() -> None:
    """Pressing twice, on an empty nest or on the robot, and taking what is unfinished, are written down."""
    world = World(tray=2)
    world.step(1.0, press_down=True)
    world.step(1.0, press_down=False)
    assert world.take(1, 1)
    for _ in range(100):
        world.step(STEP_S, press_down=False)
    for down in (True, False, True, False):
        world.step(1.0, press_down=down)
    assert world.take(2, 1)
    for _ in range(25):
        world.step(STEP_S, press_down=True)
    text = "; ".join(world.mishaps)
    for words in ("on an empty nest", "pressed 2 times", "on the robot", "taken with"):
        assert words in text, text


def test_a_goal_that_comes_twice_is_reached_once() -> None:
    """A PLC that has forgotten its goal may send it again: nothing is placed twice, and it is told so."""
    world = World(tray=3)
    assert world.take(1, 1)
    assert not world.take(1, 1)  # amid the job
    for ended in (1, 2):
        while world.ended < ended:
            world.step(STEP_S, press_down=False)
        assert (world.placed, world.moved, world.mishaps) == (1, ended == 1, [])
        assert world.take(1, 1)
    assert not world.take(2, 2) or world.mishaps


def test_a_job_is_given_back_before_the_arm_is_in_the_machine() -> None:
    """A canceled goal leaves no trace; once the arm is in the machine, it finishes its way."""
    world = World(tray=1)
    for phase, dropped in ((0, True), (1, True), (2, False)):
        assert world.take(1, 1)
        while world.phase != phase:
            world.step(STEP_S, press_down=False)
        assert world.drop() is dropped
    assert (world.tray, world.phase, world.mishaps) == (0, 2, [])
    for what, serial in ((1, 2), (2, 1)):
        assert not World(tray=0).take(what, serial)


def test_the_picture_is_as_wide_as_a_small_terminal() -> None:
    """The live view fits into 80 columns."""
    world = {
        "tray": 12, "phase": 3, "gripper": 12, "stopped": True, "cylinder": 1.0, "box": list(range(99)),
        "nest": {"serial": 123, "pins": 1}, "mishaps": [],
    }  # fmt: skip
    cell = SimpleNamespace(
        world=world, program={"stage": 10, "alive": True}, plc="python", bridge_pid=1, broken=[]
    )
    assert max(len(line) for line in picture(cell)) <= 80  # type: ignore[arg-type]


def run(*arguments: str) -> dict[str, object]:
    command = [sys.executable, "-m", "examples.assembly_cell", "--json", *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=800, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    result: dict[str, object] = json.loads(done.stdout)
    assert result["good"] and result["mishaps"] == []
    return result


pytest.importorskip("cyclonedds", reason="no cyclonedds wheel for this machine")


@pytest.mark.foreign
def test_the_cell_runs_and_outlives_its_faults() -> None:
    """Bridge, robot and PLC fail in the middle of hand-overs, in processes of their own, over DDS."""
    result = run("--handles", "3")
    assert result["delivered"] == [1, 2, 3]
    assert {str(fault).partition(":")[0] for fault in result["faults"]} >= {"bridge", "estop"}  # type: ignore[attr-defined]


@pytest.mark.verify(minutes=2)
def test_the_cell_outlives_a_storm_of_faults() -> None:
    """Faults at random moments, the whole time."""
    assert len(run("--handles", "5", "--seed", "4")["faults"]) >= 3  # type: ignore[arg-type]


@pytest.mark.foreign
def test_ending_it_leaves_nothing_behind() -> None:
    """SIGTERM ends every process and removes every object."""
    command = [sys.executable, "-m", "examples.assembly_cell", "--no-faults", "--handles", "1000"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None and child.stdout.readline()
        children = Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split()
        assert len(children) == 3
        prefixes = {
            word
            for pid in children
            for word in Path(f"/proc/{pid}/cmdline").read_text().split("\0")
            if word.startswith("assembly-")
        }
        child.send_signal(signal.SIGTERM)
        child.stdout.read()
        assert child.wait(60) == 130
    assert len(prefixes) == 1
    until = time.monotonic() + 60
    while any(Path(f"/proc/{pid}").exists() for pid in children):
        assert time.monotonic() < until
        time.sleep(0.05)
    assert not list(Path("/dev/shm").glob(f"{prefixes.pop()}.*"))


needs_translator = pytest.mark.skipif(
    importlib.util.find_spec("blark") is None, reason="blark is not installed"
)


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory):
    """The generated project with the cell's program, translated and loaded; it finds no bridge."""
    if shutil.which("gcc") is None:
        pytest.skip("Debian package gcc is missing")
    folder = tmp_path_factory.mktemp("assembly")
    text = (HERE / "rosplc.yaml").read_text().replace("prefix: assembly", "prefix: assembly-nobody")
    (folder / "rosplc.yaml").write_text(text)
    shutil.copytree(HERE / "msg", folder / "msg")
    generate(folder / "rosplc.yaml", folder / "plc")
    from rosplc_st.run_project import load_texts

    translator = find_translator()
    loaded = translator.machine(translator.build(load_texts(folder / "plc")))
    loaded.start()
    return loaded


@needs_translator
@pytest.mark.xdist_group("structured-text")
@pytest.mark.verify(minutes=1)
def test_both_programs_decide_alike(machine) -> None:
    """Structured Text and Python: from the same inputs and messages the same stage, job and output."""
    chance, press = random.Random(3), Press()
    robot = SimpleNamespace(phase=0, stopped=False, placed=0, delivered=0, tray=5)
    read, action, block = "ROS_Read.robot_state", "ROS_Actions.robot_hand_over", HandOver()
    io = dict.fromkeys(("xOccupied", "xPinIn", "xZoneFree", "xPressUp"), False)
    stages = set()
    for _ in range(3000):
        for name in io:
            if chance.random() < 0.15:
                io[name] = not io[name]
            machine.set(f"IO.{name}", io[name])
        if chance.random() < 0.2:
            robot.phase, robot.stopped = chance.choice((0, 0, 0, 1, 2, 3)), chance.random() < 0.1
            robot.placed, robot.tray = chance.randrange(5), chance.randrange(3)
        fresh, alive = chance.random() < 0.5, chance.random() < 0.97
        block()
        if block.xBusy and chance.random() < 0.3:
            end = chance.choice(("xDone", "xDone", "xError", "xAborted"))
            block.end(block.number, end, chance.random() < 0.5)
        block.xServer, block.xNewFeedback = chance.random() < 0.9, block.xBusy and chance.random() < 0.5
        block.feedback.phase = chance.randrange(4)
        for name in ("phase", "stopped", "placed", "tray"):
            machine.set(f"{read}.msg.{name}", getattr(robot, name))
        for name, value in (("xNew", fresh), ("xPeerAlive", alive), ("xStale", False)):
            machine.set(f"{read}.{name}", value)
        for name in ("xServer", "xBusy", "xDone", "xError", "xAborted", "xNewFeedback"):
            machine.set(f"{action}.{name}", getattr(block, name))
        machine.set(f"{action}.feedback.phase", block.feedback.phase)
        machine.set(f"{action}.result.moved", block.result.moved)
        machine.scan("PLC_PRG", step=0)
        press(io, robot, block, xNew=fresh, xAlive=alive)
        get = machine.get
        ours = [press.uiStage, press.usiRobot, press.udiPressed, press.udiHandedOver, press.xPressDown]
        ours += [block.xExecute, block.goal.what, block.goal.serial]
        names = ("uiStage", "usiRobot", "udiPressed", "udiHandedOver")
        pins = ("IO.xPressDown", *(f"{action}.{pin}" for pin in ("xExecute", "goal.what", "goal.serial")))
        assert ours == [get(path) for path in (*(f"PLC_PRG.{name}" for name in names), *pins)]
        stages.add(press.uiStage)
    assert stages == {0, 10, 20, 30}
    assert press.udiHandedOver


@needs_translator
@pytest.mark.xdist_group("structured-text")
@pytest.mark.verify(minutes=2)
def test_the_structured_text_runs_the_cell_through_its_faults() -> None:
    """The generated blocks and PLC_PRG.st, translated to C, against a real bridge that is killed."""
    if shutil.which("gcc") is None:
        pytest.skip("Debian package gcc is missing")
    assert len(run("--plc", "st", "--handles", "5")["faults"]) == 4  # type: ignore[arg-type]
