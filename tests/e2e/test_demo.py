"""The demonstration as a user runs it: three processes over real DDS, and nothing left behind."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.lib.waiting import wait_for

pytest.importorskip("cyclonedds", reason="no cyclonedds wheel for this machine")

SHM = Path("/dev/shm")


@contextlib.contextmanager
def demo(*arguments):
    child = subprocess.Popen(
        [sys.executable, "-m", "rosplc", "demo", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield child
    finally:
        child.kill()
        child.communicate()


def processes(parent):
    """Return module → process id of the demo's processes."""
    found = {}
    with contextlib.suppress(OSError):
        for pid in Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split():
            words = Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
            # A child that was forked a moment ago still has its parent's command line.
            if "-m" in words and (module := words[words.index("-m") + 1]).startswith("rosplc.demo."):
                found[module.removeprefix("rosplc.demo.")] = int(pid)
    return found if len(found) == 3 else None


def prefix_of(pids):
    """Return the run's prefix, from the bridge's command line."""
    return Path(f"/proc/{pids['bridge']}/cmdline").read_bytes().decode().split("\0")[4]


def objects(prefix):
    return sorted(path.name for path in SHM.glob(f"{prefix}.*"))


def alive(pid):
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


def everything_arrived(result):
    """Check that what one side counts as sent the other counts as received, whole and once."""
    assert result["complete"] and result["drained"] and result["good"]
    names = {topic["topic"] for topic in result["topics"]}
    assert names == {"/turtle/pose", "/turtle/joint_states", "/turtle/scan", "/turtle/cmd_vel"}
    for topic in result["topics"]:
        assert topic["sent"] == topic["received"] > 0, topic
        assert topic["lost"] == topic["torn"] == topic["repeated"] == 0
        assert not topic["counted_lost"]
    for way in ("to_plc", "to_ros"):
        counted = [topic["sent"] for topic in result["topics"] if "to_" + topic["to"] == way]
        assert result[way]["sent"] == result[way]["received"] == sum(counted)
    ages = result["age_at_plc"]["all"]
    assert 0 < ages["median_ms"] <= ages["p99_ms"]
    assert result["metres"] > 0, "the robot did not obey"


def one_piece_is_missing(result):
    """Check that a bridge that was killed lost one piece and no more."""
    assert result["good"] and not result["complete"]
    for topic in result["topics"]:
        assert topic["torn"] == topic["repeated"] == 0
        assert topic["gaps"] <= 1 and topic["last_arrived"], topic
        if topic["to"] == "plc":
            assert topic["lost"] > 0, "what nobody carried cannot have arrived"


def test_everything_arrives_in_both_directions():
    """What one side counts as sent the other counts as received, whole and once, and the status is 0."""
    with demo("--duration", "3s", "--json") as child:
        pids = wait_for(lambda: processes(child), "three processes")
        prefix = prefix_of(pids)
        out, err = child.communicate(timeout=240)
    assert child.returncode == 0, out + err
    everything_arrived(json.loads(out))
    assert objects(prefix) == []
    assert not any(alive(pid) for pid in pids.values())


@pytest.mark.foreign
def test_the_summary_line_says_it_in_words():
    """Without --json a table and one summary line are printed."""
    with demo("--duration", "1s", "--rate", "50", "--topics", "1") as child:
        out, err = child.communicate(timeout=240)
    assert child.returncode == 0, out + err
    last = out.splitlines()[-1]
    numbers = re.fullmatch(
        r"OK: ROS → PLC (\d+) of (\d+) messages, PLC → ROS (\d+) of (\d+), lost 0, torn 0, repeated 0, "
        r"age at the PLC median [\d.]+ ms, p99 [\d.]+ ms",
        last,
    )
    assert numbers, last
    assert numbers[1] == numbers[2] != "0"
    assert numbers[3] == numbers[4] != "0"


@pytest.mark.foreign
@pytest.mark.parametrize("victim", ["robot", "bridge", "plc"])
def test_a_killed_process_ends_it_with_a_clear_message(victim):
    """A process that dies is named, the status is not 0, and nothing is left behind."""
    with demo("--duration", "600s") as child:
        pids = wait_for(lambda: processes(child), "three processes")
        prefix = prefix_of(pids)
        wait_for(lambda: objects(prefix), "objects in shared memory")
        os.kill(pids[victim], signal.SIGKILL)
        out, err = child.communicate(timeout=120)
    assert child.returncode == 1, out + err
    assert "SYS002" in err
    assert f"the {'PLC' if victim == 'plc' else victim} process failed" in err
    assert "SIGKILL" in err
    assert "Traceback" not in err
    assert objects(prefix) == []
    assert not any(alive(pid) for pid in pids.values())


@pytest.mark.foreign
def test_a_killed_bridge_is_survived():
    """With --kill the bridge dies and comes back: one piece is missing, nothing is torn, both ways go on."""
    with demo("--duration", "3s", "--kill", "--json") as child:
        pids = wait_for(lambda: processes(child), "three processes")
        prefix = prefix_of(pids)
        out, err = child.communicate(timeout=240)
    assert child.returncode == 0, out + err
    result = json.loads(out)
    one_piece_is_missing(result)
    assert result["outage"]["to_plc_at"] > result["outage"]["restarted_at"]
    assert objects(prefix) == []


@pytest.mark.foreign
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_all_processes(number):
    """Ctrl-C and SIGTERM end the three processes and remove the objects."""
    with demo("--duration", "600s") as child:
        pids = wait_for(lambda: processes(child), "three processes")
        prefix = prefix_of(pids)
        wait_for(lambda: objects(prefix), "objects in shared memory")
        child.send_signal(number)
        _, err = child.communicate(timeout=120)
    assert child.returncode == 130, err
    assert "Traceback" not in err
    assert objects(prefix) == []
    assert not any(alive(pid) for pid in pids.values())


@pytest.mark.foreign
def test_nothing_outlives_a_killed_demo():
    """Even after SIGKILL the processes notice that their parent is gone, and clean up."""
    with demo("--duration", "600s") as child:
        pids = wait_for(lambda: processes(child), "three processes")
        prefix = prefix_of(pids)
        wait_for(lambda: objects(prefix), "objects in shared memory")
        child.kill()
        child.wait()
        wait_for(lambda: not any(alive(pid) for pid in pids.values()), "the end of the processes")
    assert objects(prefix) == []
