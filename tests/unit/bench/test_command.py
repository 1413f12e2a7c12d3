"""`rosplc-bench` as people call it: options, files, an old report again, and being interrupted."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rosplc_bench.cli import SECTIONS
from rosplc_bench.report import SCHEMA

QUICK = ("--quick", "--section", "experiment", "--only")


def bench(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "rosplc_bench", *arguments], capture_output=True, text=True, check=False
    )


def test_a_quick_run_is_measured_checked_and_shown_again(tmp_path: Path) -> None:
    """One contender is measured and its values checked; the report alone is enough for the verdict."""
    done = bench(*QUICK, "rosplc-python", "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["schema"] == SCHEMA and report["machine"]["load_before"]
    (section,) = report["sections"]
    measured = [each for one in section["data"]["arrangements"] for each in one["contenders"]]
    assert measured and {each["name"] for each in measured} == {"rosplc-python"}
    assert all(each["wrong"] == 0 < each["runs"] for each in measured)

    (tmp_path / "report.json").write_text(done.stdout)
    again = bench("--from", str(tmp_path / "report.json"))
    assert again.returncode == 0, again.stderr
    assert again.stdout.startswith("On this machine (")
    assert "rosplc takes" in again.stdout


def test_the_files_of_a_run(tmp_path: Path) -> None:
    """A folder gets the report, a page whose tables all say how one waited, and the figures it shows."""
    if shutil.which("gcc") is None:
        pytest.skip("Debian package gcc is missing")
    folder = tmp_path / "out"
    done = bench(*QUICK, "signal-c", "--out", str(folder))
    assert done.returncode == 0, done.stderr
    text = (folder / "report.md").read_text()
    assert text.count("*Waiting: ") == text.count("\n| --- |") == 3
    figures = re.findall(r"\]\((\S+\.svg)\)", text)
    assert figures and all((folder / name).is_file() for name in figures)
    assert all((folder / name).with_suffix(".png").is_file() for name in figures)
    assert json.loads((folder / "report.json").read_text())["schema"] == SCHEMA


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--section", "nothing"), "experiment"),
        (("--only", "nobody"), "rosplc-python"),
        (("--quick", "--full"), "not allowed with"),
    ],
)
def test_wrong_names_are_refused_with_the_right_ones(arguments: tuple[str, ...], words: str) -> None:
    """A section or contender that does not exist ends with status 2 and says which there are."""
    done = bench(*arguments)
    assert done.returncode == 2 and words in done.stderr


def test_a_report_that_is_none(tmp_path: Path) -> None:
    """A file that is missing or no report is SYS007."""
    (tmp_path / "x.json").write_text("[]")
    for path in ("x.json", "missing.json"):
        done = bench("--from", str(tmp_path / path))
        assert done.returncode == 1 and "SYS007" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "SIGTERM"])
def test_an_interrupted_run_leaves_nothing(number: int) -> None:
    """Ended in the middle, the command ends its processes and removes what they shared."""
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "rosplc_bench",
            "--full",
            "--section",
            "experiment",
            "--only",
            "rosplc-python",
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        children = _children(process.pid, 2)
        words = " ".join(Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ") for pid in children)
        names = re.findall(r"rosplc-bench-\w+", words)
        assert names
        process.send_signal(number)
        assert process.wait(60) == 130
    finally:
        process.kill()
        _, errors = process.communicate()
    assert b"Traceback" not in errors
    deadline = time.monotonic() + 60
    while alive := [pid for pid in children if _lives(pid)]:
        assert time.monotonic() < deadline, alive
        time.sleep(0.02)
    assert not [path for path in Path("/dev/shm").iterdir() if names[0] in path.name]


def _children(pid: int, count: int) -> list[int]:
    """Wait until a process has so many children that run Python, and return them."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        found = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        ready = [int(each) for each in found if "rosplc_bench.peers" in _command(int(each))]
        if len(ready) >= count:
            return ready
        time.sleep(0.02)
    raise AssertionError("the processes did not start")


def _lives(pid: int) -> bool:
    """Return whether a process runs; one that only waits for its end to be noticed does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return ""


def test_sections_have_names_of_their_own() -> None:
    """Each section can be chosen by its name, and has a question that it answers."""
    assert all(section.name == name for name, section in SECTIONS.items())
    assert all(section.title and section.question for section in SECTIONS.values())


def test_the_old_verb_names_the_new_command() -> None:
    """`rosplc bench` with any of its options ends with status 2 and tells how to get the comparison."""
    command = [sys.executable, "-m", "rosplc", "bench", "--quick", "--only", "bare", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and not done.stdout
    assert "rosplc-bench" in done.stderr and re.search(r"pip install .*\[bench\]", done.stderr)
