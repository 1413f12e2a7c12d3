"""Priority, processors, memory and garbage collection of a bridge's threads."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rosplc.bridge.engine import Bridge
from rosplc.bridge.realtime import Realtime, contention
from rosplc.config.file import Config
from rosplc.config.resolve import open_doors, resolve
from rosplc.errors import RosplcError, SetupError
from rosplc.project import warnings
from rosplc.shm import Namespace

pytestmark = pytest.mark.verifies("real-time-settings", own="rosplc alone")

FIFO = {"policy": "fifo", "priority": 3}


def config(
    namespace: Namespace | None = None, *, shm: dict[str, Any] | None = None, **realtime: Any
) -> Config:
    """Return a configuration with real-time settings."""
    data: dict[str, Any] = {
        "ros": {"backend": "memory"},
        "realtime": realtime,
        "shm": shm or {},
        "topics": {
            "/in": {"type": "std_msgs/msg/Int32", "to": "plc"},
            "/out": {"type": "std_msgs/msg/Int32", "to": "ros"},
        },
    }
    if namespace is not None:
        data["prefix"] = namespace.prefix
    return Config.from_dict(data)


def may_use_fifo() -> bool:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(3))
    except PermissionError:
        return False
    os.sched_setscheduler(0, *before)
    return True


needs_fifo = pytest.mark.needs(when=may_use_fifo(), why="this user may not use SCHED_FIFO")


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    """Whatever a test does to this process is undone."""
    yield
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    gc.unfreeze()
    gc.enable()


def policies() -> dict[str, tuple[int, int]]:
    """Return policy and priority of this process's threads by name."""
    found = {}
    for thread in threading.enumerate():
        with contextlib.suppress(ProcessLookupError):  # one of another test's that has just ended
            found[thread.name] = (
                os.sched_getscheduler(thread.native_id or 0),
                os.sched_getparam(thread.native_id or 0).sched_priority,
            )
    return found


@needs_fifo
def test_what_carries_and_beats_has_the_priority(shm_namespace: Namespace) -> None:
    """Carrier and heartbeat have it, reporter and main thread do not; after the end none has."""
    with Bridge(config(shm_namespace, **FIFO)):
        found = policies()
        for name in ("rosplc-to-ros", "rosplc-heartbeat"):
            assert found[name] == (os.SCHED_FIFO, 3)
        for name in ("rosplc-reporter", "MainThread"):
            assert found[name][0] == os.SCHED_OTHER
    assert policies()["MainThread"][0] == os.SCHED_OTHER


@needs_fifo
def test_threads_of_the_middleware_have_the_priority(tmp_path: Path, shm_namespace: Namespace) -> None:
    """DDS' own threads, which receive, inherit it; they are C threads that Python does not list."""
    pytest.importorskip("cyclonedds")
    from tests.interop.graphs import LOCAL, free_domain

    file = tmp_path / "cell.yaml"
    with free_domain() as domain:
        file.write_text(
            f"prefix: {shm_namespace.prefix}\nros: {{backend: dds, domain: {domain}}}\n"
            "realtime: {policy: fifo, priority: 3}\n"
            "topics: {/in: {type: std_msgs/msg/Int32, to: plc}}\n"
        )
        child = subprocess.Popen(
            [sys.executable, "-m", "rosplc", "run", str(file)],
            env={**os.environ, **LOCAL},
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert child.stderr is not None
            assert any("carries" in line for line in child.stderr)
            by_name: dict[str, set[int]] = {}
            for task in Path(f"/proc/{child.pid}/task").iterdir():
                name = (task / "comm").read_text().strip()
                by_name.setdefault(name, set()).add(os.sched_getscheduler(int(task.name)))
            assert by_name["recv"] == {os.SCHED_FIFO}
            assert by_name["dq.user"] == {os.SCHED_FIFO}
        finally:
            child.send_signal(signal.SIGTERM)
            child.communicate()


def test_processors(shm_namespace: Namespace) -> None:
    """Threads stay on the processors that are named, and the program's own thread goes back to all."""
    before = os.sched_getaffinity(0)
    one = min(before)
    with Bridge(config(shm_namespace, affinity=[one])):
        threads = {thread.name: thread.native_id for thread in threading.enumerate()}
        assert os.sched_getaffinity(threads["rosplc-heartbeat"] or 0) == {one}
        assert os.sched_getaffinity(threads["rosplc-reporter"] or 0) == before
        assert os.sched_getaffinity(0) == before


@pytest.mark.parametrize("missing", [4095, 4000])
def test_a_processor_that_is_not_there(shm_namespace: Namespace, missing: int) -> None:
    """A processor that this machine lacks is named with its key, and nothing has been opened."""
    here = min(os.sched_getaffinity(0))
    with (
        pytest.raises(SetupError, match=f"SYS010.*Allowed processors: .*{here}") as caught,
        Bridge(config(shm_namespace, affinity=[here, missing])),
    ):
        pass
    assert str(missing) in caught.value.what and "affinity" in caught.value.where
    assert not shm_namespace.topics()


def _without_rights(code: str) -> subprocess.CompletedProcess[str]:
    """Run Python as a process that may neither raise priorities nor lock memory."""
    before = ()
    if os.geteuid() == 0:
        drop = "-sys_nice,-ipc_lock"
        before = ("setpriv", "--inh-caps", drop, "--bounding-set", drop)
    limits = (
        "import resource\n"
        "resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))\n"
        "resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))\n"
    )
    return subprocess.run(
        [*before, sys.executable, "-c", limits + code], capture_output=True, text=True, check=False
    )


@pytest.mark.foreign
@pytest.mark.parametrize(
    ("section", "key", "help_"),
    [
        ("policy: fifo", "priority", "LimitRTPRIO=20"),
        ("lock_memory: true", "lock_memory", "LimitMEMLOCK=infinity"),
    ],
)
def test_a_right_that_is_missing_is_named(
    tmp_path: Path, shm_namespace: Namespace, section: str, key: str, help_: str
) -> None:
    """Without the right the bridge does not start, and says which line asks for it and what would give it."""
    file = tmp_path / "cell.yaml"
    file.write_text(
        f"prefix: {shm_namespace.prefix}\nros: {{backend: memory}}\nrealtime:\n  {section}\n"
        "topics: {/in: {type: std_msgs/msg/Int32, to: plc}}\n"
    )
    done = _without_rights(
        f"import sys; sys.argv = ['rosplc', 'run', {str(file)!r}]\nfrom rosplc.cli import main; main()"
    )
    assert done.returncode == 1, done.stderr
    assert "SYS010" in done.stderr and help_ in done.stderr and key in done.stderr
    assert not shm_namespace.topics()


def test_memory_is_locked_for_as_long_as_it_runs(shm_namespace: Namespace) -> None:
    """With the right to it, pages are locked while the bridge runs, and no longer."""

    def locked() -> int:
        text = Path("/proc/self/status").read_text()
        return int(next(line for line in text.splitlines() if line.startswith("VmLck")).split()[1])

    bridge = Bridge(config(shm_namespace, lock_memory=True))
    try:
        bridge.start()
    except SetupError as error:
        pytest.skip(f"this user may not lock memory: {error.what}")
    assert locked() > 0
    bridge.stop()
    assert locked() == 0


class Loop:
    """Garbage that only the collector can find."""

    def __init__(self) -> None:
        self.me = self


@pytest.mark.parametrize("setting", ["auto", "freeze", "off"])
def test_garbage(shm_namespace: Namespace, setting: str) -> None:
    """The collector does what is set while the bridge runs, garbage goes, and the end undoes it."""
    import weakref

    frozen = gc.get_freeze_count()
    with Bridge(config(shm_namespace, gc=setting)) as bridge:
        assert gc.isenabled() is (setting != "off")
        assert (gc.get_freeze_count() > frozen) is (setting != "auto")
        if setting == "off":
            gone = weakref.ref(Loop())
            for _ in range(70):
                bridge._realtime.tidy()
            assert gone() is None
    assert gc.isenabled()
    assert gc.get_freeze_count() <= frozen


def test_off_in_yaml_is_a_word() -> None:
    """``gc: off`` is no boolean, as it would be to many readers of YAML."""
    from rosplc.config.file import parse_config

    assert parse_config("realtime: {gc: off}").settings.realtime.gc == "off"


@pytest.mark.parametrize(
    "wrong",
    [
        {"policy": "rr"},
        {"policy": "fifo", "priority": 0},
        {"policy": "fifo", "priority": 100},
        {"priority": 20},
        {"affinity": [-1]},
        {"affinity": ["0"]},
        {"gc": "never"},
        {"lock_memory": "perhaps"},
    ],
)
def test_values_that_mean_nothing(wrong: dict[str, Any]) -> None:
    """A value that the kernel would not take, or that does nothing, is refused with the configuration."""
    with pytest.raises(RosplcError, match="CFG00"):
        config(**wrong)


@pytest.mark.parametrize(
    ("priority", "words"), [(51, None), (52, "within the"), (67, "within the"), (68, "above the")]
)
def test_a_priority_among_the_plcs_is_warned_of(priority: int, words: str | None) -> None:
    """From 52 on the bridge competes with CODESYS' tasks, which `rosplc check` says."""
    made = config(policy="fifo", priority=priority)
    found = contention(made)
    assert [words in text for text in found] == ([] if words is None else [True])  # type: ignore[operator]
    assert set(found) <= set(warnings(resolve(made)))


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("0660", None),
        ("0600", None),
        ("0664", " read the"),
        ("0666", "read and write"),
        ("0662", " write the"),
    ],
)
def test_a_mode_for_everybody_is_warned_of(
    shm_namespace: Namespace, caplog: pytest.LogCaptureFixture, mode: str, words: str | None
) -> None:
    """What every user may do is said by `rosplc check`, in the bridge's log and in its status."""
    made = config(shm_namespace, shm={"mode": mode})
    said = [text for text in open_doors(made) if "every user" in text]
    assert [words in text for text in said] == ([] if words is None else [True])  # type: ignore[operator]
    assert set(said) <= set(warnings(resolve(made)))
    with Bridge(made) as bridge:
        assert set(said) <= set(bridge.status().notes)
    assert all(text in caplog.text for text in said)


def test_a_directory_for_everybody_is_warned_of(tmp_path: Path) -> None:
    """In a directory without the sticky bit any user may replace objects, and that is said."""
    tmp_path.chmod(0o777)
    made = config(shm={"directory": str(tmp_path)})
    assert any("replace" in text for text in open_doors(made))
    tmp_path.chmod(0o1777)
    assert not open_doors(made)


def test_a_failed_start_leaves_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    """If a later setting is refused, the earlier ones are taken back."""
    realtime = Realtime(config(affinity=[min(os.sched_getaffinity(0))], **FIFO))
    before = os.sched_getaffinity(0)

    def refuse(*_: Any) -> None:
        raise PermissionError(1, "Operation not permitted")

    with monkeypatch.context() as patch:
        patch.setattr(os, "sched_setscheduler", refuse)
        with pytest.raises(SetupError, match="SYS010"):
            realtime.__enter__()
    assert os.sched_getaffinity(0) == before
