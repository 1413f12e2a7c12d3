"""The example cell: whatever dies amid a hand-over, nothing is done twice and nothing is lost."""

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
from examples.assembly_cell.handshake import Handshake, HandshakeReply
from examples.assembly_cell.plc_python import Press
from examples.assembly_cell.view import picture
from examples.assembly_cell.world import World
from rosplc.demo.st.checkout import find_translator

pytestmark = pytest.mark.timeout(900)
ROOT = Path(__file__).resolve().parents[2]
STEP_S = 0.01


class Simulated:
    """World and PLC program in one thread, with messages that are late, and parts that die, by a seed."""

    def __init__(self, seed: int, handles: int) -> None:
        self.chance = random.Random(seed)
        self.world = World(tray=handles)
        self.press = Press()
        self.up: deque[tuple[int, SimpleNamespace]] = deque()
        self.down: deque[tuple[int, tuple[int, int, int]]] = deque()
        self.robot: SimpleNamespace | None = None
        self.heard_at = self.bridge_back = self.plc_back = self.stopped_until = 0
        self.now = 0

    def step(self) -> None:
        self.now += 1
        world, chance = self.world, self.chance
        if chance.random() < 0.004:
            self.bridge_back = self.now + chance.randint(5, 200)
        if chance.random() < 0.004:
            self.plc_back, self.press, self.robot = self.now + chance.randint(1, 100), Press(), None
        if chance.random() < 0.002:
            self.stopped_until = self.now + chance.randint(1, 200)
        bridge, plc = self.now >= self.bridge_back, self.now >= self.plc_back
        world.stopped = self.now < self.stopped_until
        if self.now % 5 == 0 and bridge:  # what is sent into a dead bridge is lost; the rest comes late
            state = SimpleNamespace(
                phase=world.phase, stopped=world.stopped, done=world.reply.udiDone,
                placed=world.placed, delivered=len(world.box), tray=world.tray,
            )  # fmt: skip
            self.up.append((self.now + chance.randint(0, 30), state))
        fresh = False
        while self.up and self.up[0][0] <= self.now:
            self.robot, self.heard_at, fresh = self.up.popleft()[1], self.now, True
        if plc:
            nest = world.nest
            io = {
                "xOccupied": nest is not None,
                "xPinIn": nest is not None and nest.pins > 0,
                "xZoneFree": world.zone_free,
                "xPressUp": world.cylinder == 0.0,
            }
            alive = bridge and self.now - self.heard_at < 50
            self.press(io, self.robot, xNew=fresh, xAlive=alive)
            if bridge:
                wish = (self.press.fbRobot.udiJob, self.press.usiWhat, self.press.udiSerial)
                self.down.append((self.now + chance.randint(0, 30), wish))
        while self.down and self.down[0][0] <= self.now:
            world.wish(*self.down.popleft()[1])
        world.step(STEP_S, press_down=plc and self.press.xPressDown)


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
    world.wish(1, 1, 1)
    for _ in range(100):
        world.step(STEP_S, press_down=False)
    for down in (True, False, True, False):
        world.step(1.0, press_down=down)
    world.wish(2, 2, 1)
    for _ in range(25):
        world.step(STEP_S, press_down=True)
    text = "; ".join(world.mishaps)
    for words in ("on an empty nest", "pressed 2 times", "on the robot", "taken with"):
        assert words in text, text


def test_a_wish_that_comes_twice_is_done_once() -> None:
    """A PLC that has forgotten its wish may wish again, under another number; nothing is placed twice."""
    world = World(tray=3)
    world.wish(7, 1, 1)
    for _ in range(30):
        world.step(STEP_S, press_down=False)
    world.wish(1234, 1, 1)  # amid the job
    for _ in range(300):
        world.step(STEP_S, press_down=False)
    assert (world.placed, world.reply.udiDone, world.mishaps) == (1, 1234, [])


def test_the_handshake_asks_once() -> None:
    """The Python twins agree: one rising edge, one job, begun once, also when numbers begin anew."""
    reply, begun, done = HandshakeReply(), 0, 0
    for _ in range(5):  # the asking side starts anew
        ask = Handshake()
        for _ in range(3):
            for execute in (True, True, True, False):
                ask(xExecute=execute, udiDone=reply.udiDone, xPeerAlive=True)
                reply.wish(ask.udiJob)
                begun += reply.start()
                done += ask.xDone and execute
                if reply.xBusy:
                    reply.finish()
    assert begun == 15
    assert done >= 15


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


def test_the_cell_runs_and_outlives_its_faults() -> None:
    """Bridge, robot and PLC fail in the middle of hand-overs, in processes of their own, over DDS."""
    result = run("--handles", "3")
    assert result["delivered"] == [1, 2, 3]
    assert {str(fault).partition(":")[0] for fault in result["faults"]} >= {"bridge", "estop"}  # type: ignore[attr-defined]


@pytest.mark.verify(minutes=2)
def test_the_cell_outlives_a_storm_of_faults() -> None:
    """Faults at random moments, the whole time."""
    assert len(run("--handles", "5", "--seed", "4")["faults"]) >= 3  # type: ignore[arg-type]


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
    robot = SimpleNamespace(phase=0, stopped=False, done=0, placed=0, delivered=0, tray=5)
    read = "ROS_Read.robot_state"
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
        job = machine.get("PLC_PRG.fbRobot.udiJob")
        finish = bool(job) and chance.random() < 0.3
        for name in ("phase", "stopped", "placed", "tray"):
            machine.set(f"{read}.msg.{name}", getattr(robot, name))
        machine.set(f"{read}.msg.done", job if finish else 0)
        for name, value in (("xNew", fresh), ("xPeerAlive", alive), ("xStale", False)):
            machine.set(f"{read}.{name}", value)
        machine.scan("PLC_PRG", step=0)
        robot.done = press.fbRobot.udiJob if finish else 0
        press(io, robot, xNew=fresh, xAlive=alive)
        ours = (press.uiStage, press.xPressDown, press.fbRobot.udiJob != 0, press.udiPressed)
        get = machine.get
        theirs = (
            get("PLC_PRG.uiStage"), bool(get("IO.xPressDown")), get("PLC_PRG.fbRobot.udiJob") != 0,
            get("PLC_PRG.udiPressed"),
        )  # fmt: skip
        assert ours == theirs
        if press.fbRobot.udiJob:
            assert (press.usiWhat, press.udiSerial) == (get("PLC_PRG.usiWhat"), get("PLC_PRG.udiSerial"))
        stages.add(press.uiStage)
    assert stages == {0, 10, 20, 30}


@needs_translator
@pytest.mark.xdist_group("structured-text")
@pytest.mark.verify(minutes=2)
def test_the_structured_text_runs_the_cell_through_its_faults() -> None:
    """The generated blocks and PLC_PRG.st, translated to C, against a real bridge that is killed."""
    if shutil.which("gcc") is None:
        pytest.skip("Debian package gcc is missing")
    assert len(run("--plc", "st", "--handles", "5")["faults"]) == 4  # type: ignore[arg-type]
