"""The extension itself, not only the headers below it, under sanitizers: as Python programs use it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

pytestmark = pytest.mark.verifies("core", own="sanitizers")

ROOT = Path(__file__).resolve().parents[3]
FLAGS = [
    "-std=gnu11",
    "-g",
    "-O1",
    "-fPIC",
    "-shared",
    "-fno-sanitize-recover=all",
    "-Wno-tsan",
]
TESTS = (
    "tests/unit/core/test_native_channel.py",
    "tests/unit/core/test_group.py",
    "tests/unit/core/test_sink.py",
    "tests/unit/core/test_record.py",
    "tests/unit/layout/test_pack.py",
    "tests/unit/layout/test_view.py",
    "tests/unit/bridge/test_batches.py",
    "tests/unit/ros/test_tcp.py",
    "tests/crash/test_scribbled_object.py",
    "tests/unit/codec/test_codec.py",
)


# A thread of the extension passes on what comes all the time, while this one opens and closes the sink.
THREADS = """
import socket, threading, time, uuid
from rosplc.codec import Codec
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros.rospy._tcp import Loop
from rosplc.shm import Direction, Namespace, Sink
from tests.lib.channels import open_channel

codec = Codec(compute_layout(TypeStore.bundled("noetic"), "geometry_msgs/msg/Twist"))
owned = open_channel(Namespace(f"t{uuid.uuid4().hex[:8]}"), Direction.TO_PLC, record_size=48, slots=8)
loop, sink, writer, ending = Loop(1000), Sink(), owned.writer(1000), threading.Event()
ours, theirs = socket.socketpair()
loop.receive(ours.fileno(), None, sink.capsule)

def receive():
    while not ending.is_set():
        loop.wait()

def send():
    try:
        while True:
            theirs.sendall(50 * ((48).to_bytes(4, "little") + bytes(48)))
    except OSError:
        pass

threads = [threading.Thread(target=each) for each in (receive, send)]
for thread in threads:
    thread.start()
while sink.messages < 5000:
    sink.open(writer, codec.plan, False, 0)
    time.sleep(0.001)
    sink.close()
ending.set()
ours.shutdown(socket.SHUT_RDWR)
loop.wake()
for thread in threads:
    thread.join()
owned.close()
print("passed")
"""


def built(package: Path, sanitizers: str) -> dict[str, str]:
    """Build the extension under sanitizers in a copy of the package; return the environment to run it in."""
    shutil.copytree(ROOT / "src/rosplc", package, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    include = sysconfig.get_paths()["include"]
    limited = ["-DPy_LIMITED_API=0x030B0000"] if sys.version_info >= (3, 11) else []
    includes = [f"-I{path}" for path in (include, package / "_core", package / "include")]
    for made, sources in (
        ("_core/_native", "_core/*.c"),
        ("ros/dds/_batch", "ros/dds/batch.c"),
        ("ros/rospy/_tcp", "ros/rospy/tcp.c"),
    ):
        command = ["gcc", *FLAGS, f"-fsanitize={sanitizers}", *limited, *includes]
        paths = [*package.glob(sources), "-o", package / f"{made}.abi3.so"]
        subprocess.run([*command, *paths], check=True)
    runtime = f"lib{'tsan' if sanitizers == 'thread' else 'asan'}.so"
    command = ["gcc", f"-print-file-name={runtime}"]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    environment = {
        **os.environ,
        "LD_PRELOAD": str(Path(found).resolve()),
        "ASAN_OPTIONS": "detect_leaks=0",  # the interpreter frees little at its end
        "PYTHONMALLOC": "malloc",  # or the sanitizer would see one arena instead of objects
        "PYTHONPATH": f"{package.parent}:{ROOT}",
        "ROSPLC_REPORT": "",
    }
    program = "import rosplc._core._native as n; print(n.__file__)"
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, cwd=package)
    assert done.stdout.strip() == str(package / "_core/_native.abi3.so")
    return environment


@pytest.mark.verify(minutes=0.5)
def test_threads_share_a_sink_under_the_thread_sanitizer(tmp_path: Path) -> None:
    """A sink is opened and closed while another thread puts messages into it, and no access races."""
    environment = built(tmp_path / "rosplc", "thread")
    command = [sys.executable, "-c", THREADS]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, timeout=300, cwd=tmp_path
    )
    assert (done.returncode, done.stdout) == (0, "passed\n"), done.stderr[-6000:]


@pytest.mark.verify(minutes=1.5)
@pytest.mark.timeout(1500)
def test_the_extension_under_sanitizers(tmp_path: Path) -> None:
    """Tests that call every function of the extension, hostile objects among them, find no bad access."""
    environment = built(tmp_path / "rosplc", "address,undefined")
    # A sanitizer takes all addresses for itself: no test can limit them.
    deselected = (
        "--deselect=tests/unit/ros/test_tcp.py::test_a_message_beyond_the_memory_ends_its_connection_alone"
    )
    options = [
        deselected,
        "-q",
        "-x",
        "-m",
        "not verify and not serial",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, *TESTS],
        env=environment,
        capture_output=True,
        text=True,
        errors="replace",
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-6000:]
    assert " passed" in done.stdout
