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
    "-fsanitize=address,undefined",
    "-fno-sanitize-recover=all",
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


@pytest.mark.verify(minutes=1.5)
@pytest.mark.timeout(1500)
def test_the_extension_under_sanitizers(tmp_path: Path) -> None:
    """Tests that call every function of the extension, hostile objects among them, find no bad access."""
    package = tmp_path / "rosplc"
    shutil.copytree(ROOT / "src/rosplc", package, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    include = sysconfig.get_paths()["include"]
    limited = ["-DPy_LIMITED_API=0x030B0000"] if sys.version_info >= (3, 11) else []
    library = package / "_core/_native.abi3.so"
    sources = sorted(str(path) for path in (package / "_core").glob("*.c"))
    subprocess.run(
        ["gcc", *FLAGS, *limited, f"-I{include}", f"-I{package / 'include'}", *sources, "-o", str(library)],
        check=True,
    )
    includes = [f"-I{path}" for path in (include, package / "_core")]
    for name, made in (("dds/batch.c", "dds/_batch.abi3.so"), ("rospy/tcp.c", "rospy/_tcp.abi3.so")):
        paths = [package / "ros" / name, "-o", package / "ros" / made]
        subprocess.run(["gcc", *FLAGS, *limited, *includes, *paths], check=True)
    runtime = subprocess.run(
        ["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True
    ).stdout.strip()
    environment = {
        **os.environ,
        "LD_PRELOAD": str(Path(runtime).resolve()),
        "ASAN_OPTIONS": "detect_leaks=0",  # the interpreter frees little at its end
        "PYTHONMALLOC": "malloc",  # or the sanitizer would see one arena instead of objects
        "PYTHONPATH": str(tmp_path),
        "ROSPLC_REPORT": "",
    }
    program = "import rosplc._core._native as n; print(n.__file__)"
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout.strip() == str(library)
    options = ["-q", "-x", "-m", "not verify and not serial", "-p", "no:cacheprovider", "-p", "no:xdist"]
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
