"""The parts of the demonstration: whether it would notice what it claims to notice."""

from __future__ import annotations

import json
import math
import signal
from dataclasses import asdict, replace

import pytest

from rosplc.codec import Codec, Wire
from rosplc.demo.plan import (
    COMMAND,
    FreeDomain,
    Plan,
    Tally,
    Turtle,
    command,
    open_command,
    robot_topics,
    steer,
)
from rosplc.demo.processes import Child, remove_objects
from rosplc.demo.supervisor import Outage, collect
from rosplc.errors import SetupError
from rosplc.layout import Limits, compute_layout
from rosplc.model import TypeStore

STORE = TypeStore.bundled("jazzy")
KINDS = {kind.name: kind for kind in robot_topics(3).values()}


@pytest.mark.parametrize("name", KINDS)
def test_a_message_opens_as_it_was_sealed(name):
    """Number and stamp survive wire and record, and the seal agrees."""
    kind = KINDS[name]
    codec = Codec(compute_layout(STORE, kind.type_name, Limits(sequence=64)), Wire.CDR)
    turtle = Turtle(x=1.25, heading=0.5, forward=0.3, wheel=7.7)
    record = codec.layout.pack(kind.seal(turtle.contents(name), 17, 1_700_000_000_123_456_789))
    opened = kind.open(codec.layout.view(codec.decode(codec.encode(record))))
    assert (opened.number, opened.whole, opened.stamp_ns) == (17, True, 1_700_000_000_123_456_789)


@pytest.mark.parametrize("name", KINDS)
def test_any_changed_number_breaks_the_seal(name):
    """A message of which one number belongs to another message is torn."""
    kind = KINDS[name]
    layout = compute_layout(STORE, kind.type_name, Limits(sequence=64))
    one = kind.seal(Turtle(x=1.0, y=2.0, heading=0.1, forward=0.2, wheel=3.0).contents(name), 1, 5)
    two = kind.seal(Turtle(x=4.0, y=5.0, heading=0.7, forward=0.4, wheel=6.0).contents(name), 2, 9)
    mixed = {**one, "header": two["header"]}
    assert kind.open(layout.view(layout.pack(one))).whole
    assert not kind.open(layout.view(layout.pack(mixed))).whole
    half = bytearray(layout.pack(one))
    half[layout.size // 2 :] = layout.pack(two)[layout.size // 2 :]
    assert not kind.open(layout.view(half)).whole
    assert not kind.open(layout.view(bytes(layout.size))).whole


def test_a_command_opens_as_it_was_sealed():
    """Number and seal of a command survive, and any change breaks it."""
    layout = compute_layout(STORE, COMMAND[1])
    value = command(42, 0.5, -1.25)
    assert open_command(layout.view(layout.pack(value))).number == 42
    for part, axis in (("linear", "x"), ("linear", "y"), ("linear", "z"), ("angular", "x"), ("angular", "z")):
        changed = json.loads(json.dumps(value))
        changed[part][axis] += 1.0
        assert not open_command(layout.view(layout.pack(changed))).whole, (part, axis)
    changed = command(1, 0.0, 0.0)
    changed["linear"]["z"] = math.nan
    assert not open_command(layout.view(layout.pack(changed))).whole


def test_a_tally_counts_each_fault_apart():
    """Gaps, repeats and torn messages are counted for what they are."""
    tally = Tally()
    for number, whole in ((1, True), (2, True), (5, True), (5, True), (0, False), (6, True)):
        tally.add(number, whole=whole)
    assert asdict(tally) == {"received": 4, "missing": 2, "gaps": 1, "torn": 1, "repeated": 1, "newest": 6}


def run_of(
    sent=10,
    received=10,
    torn=0,
    repeated=0,
    commands=5,
    arrived=5,
    counted=0,
    gaps=0,
    newest=None,
    outage=None,
):
    tally = {"received": received, "missing": 0, "gaps": gaps, "torn": torn, "repeated": repeated}
    newest = sent if newest is None else newest
    robot = {
        "sent": {"/turtle/pose": sent},
        "received": {COMMAND[0]: {**tally, "received": arrived, "torn": 0, "repeated": 0, "newest": arrived}},
        "metres": 1.0,
    }
    plc = {
        "sent": {COMMAND[0]: commands},
        "received": {"/turtle/pose": {**tally, "newest": newest}},
        "counters": {"/turtle/pose": {"lost": counted}},
    }
    return collect(robot, plc, 1.0, drained=True, outage=outage)


BACK = Outage(killed_at=1.0, restarted_at=2.0, to_plc_at=3.0, to_ros_at=3.0)


def test_after_a_kill_one_piece_may_be_missing():
    """With --kill a run is good if what is missing is one piece and both directions came back."""
    assert run_of(received=7, gaps=1, outage=BACK).good
    assert not run_of(received=7, gaps=1, outage=BACK).complete
    assert not run_of(received=7, gaps=1).good, "without --kill nothing may be missing"


@pytest.mark.parametrize(
    "fault",
    [
        {"gaps": 2, "received": 7},
        {"torn": 1},
        {"repeated": 1},
        {"newest": 9, "received": 9},
        {"outage": replace(BACK, to_ros_at=None)},
        {"outage": replace(BACK, to_plc_at=None)},
    ],
)
def test_after_a_kill_anything_else_is_a_fault(fault):
    """Two gaps, torn or repeated messages, a lost tail or a direction that stays silent are not recovery."""
    assert not run_of(**{"outage": BACK, **fault}).good


def test_a_run_without_a_fault_is_complete():
    """Everything sent, everything received."""
    assert run_of().complete
    assert "lost 0, torn 0, repeated 0" in run_of().summary()


@pytest.mark.parametrize(
    "fault",
    [
        {"received": 9},
        {"torn": 1},
        {"repeated": 1},
        {"arrived": 4},
        {"counted": 1},
        {"sent": 0, "received": 0},
        {"commands": 0, "arrived": 0},
    ],
)
def test_a_run_with_any_fault_is_not_complete(fault):
    """One lost, torn or repeated message, a counter that disagrees, or silence spoil a run."""
    assert not run_of(**fault).complete


def test_the_robot_goes_round_its_square():
    """The control law leads the robot to every corner."""
    turtle, corner, seen = Turtle(), 0, set()
    for _ in range(4000):
        forward, turn, corner = steer(turtle.x, turtle.y, turtle.heading, corner)
        turtle.obey(forward, turn)
        turtle.move(0.02)
        seen.add(corner)
    assert seen == {0, 1, 2, 3}
    assert -0.5 < turtle.x < 2.5 and -0.5 < turtle.y < 2.5


def test_a_plan_survives_its_json():
    """What the processes get is what was planned."""
    plan = Plan(prefix="demo-1", domain=5, rate=250.0, topics=4)
    assert Plan.from_json(plan.to_json()) == plan
    assert plan.slots >= 500
    assert len(robot_topics(7)) == 7


def test_the_plan_is_a_valid_configuration():
    """The bridge accepts what the plan writes, at both ends of its range."""
    from rosplc.config.file import Config
    from rosplc.config.resolve import resolve

    for rate, topics in ((1.0, 1), (1000.0, 32)):
        project = resolve(
            Config.from_dict(Plan(prefix="demo-1", domain=5, rate=rate, topics=topics).configuration())
        )
        assert len(project.topics) == topics + 1


def test_a_domain_is_within_the_safe_range():
    """Ports lie below those that Linux gives to clients, and no two runs get the same domain."""
    domains = [FreeDomain() for _ in range(5)]
    numbers = {domain.number for domain in domains}
    assert len(numbers) == 5, "two demonstrations would meet"
    assert all(1 <= number <= 101 for number in numbers)
    for domain in domains:
        domain.close()


def test_cleanup_touches_its_own_prefix_only(tmp_path):
    """Objects, locks and temporaries of the prefix go; everything else stays."""
    for name in (
        "demo-1.t.a",
        "demo-1.l.a",
        "demo-1.n.a.00000000",
        "demo-1.ag.a",
        "demo-1.lag.a",
        "demo-12.t.a",
        "rosplc.t.a",
        "demo-1.x.a",
    ):
        (tmp_path / name).write_bytes(b"")
    assert remove_objects("demo-1", str(tmp_path)) == 5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["demo-1.x.a", "demo-12.t.a", "rosplc.t.a"]


@pytest.fixture
def child(monkeypatch, tmp_path):
    made = []

    def make(code):
        (tmp_path / "part.py").write_text(code)
        made.append(Child("bridge", "part", [], {"PYTHONPATH": str(tmp_path), "PATH": "/usr/bin"}))
        return made[-1]

    yield make
    for each in made:
        each.finish(seconds=5.0)
        each.close()


def wait_for_end(child):
    child._process.wait(60)
    return child


def test_a_childs_own_error_is_what_is_shown(child):
    """A process that reports an error passes on its code and remedy."""
    one = wait_for_end(
        child(
            "import json\n"
            'facts = {"code": "SHM117", "what": "no room", "where": "", "remedy": "Free it."}\n'
            'print(json.dumps({"is": "error", **facts}))\n'
            "raise SystemExit(1)\n"
        )
    )
    with pytest.raises(SetupError, match=r"the bridge process failed: no room \[SHM117\] Free it"):
        one.check()


def test_a_childs_last_words_are_shown(child):
    """A process that dies without a report is shown with the end of its stderr."""
    one = wait_for_end(child("raise ZeroDivisionError('speed')"))
    with pytest.raises(SetupError, match="exited with status 1") as caught:
        one.check()
    assert "ZeroDivisionError: speed" in caught.value.what


def test_a_child_that_does_not_stop_is_killed(child):
    """A process that ignores everything is gone after finish()."""
    one = child("import signal, sys, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\ntime.sleep(600)")
    one.finish(seconds=0.2)
    assert one._process.returncode == -signal.SIGKILL


def test_a_childs_status_is_kept(child):
    """Reports come in as JSON lines; what is no JSON is left out."""
    one = wait_for_end(child('print("noise")\nprint(\'{"is": "status", "sent": 3}\')'))
    one._reader.join(60)
    assert one.status == {"sent": 3}
