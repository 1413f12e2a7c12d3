"""How often the bridge copies a large message, counted in the process."""

from __future__ import annotations

import platform
import shutil
import subprocess
from pathlib import Path

import pytest

LIBRARY = Path(__file__).resolve().parent.parent / "lib" / "copies.c"
SIZE, IMAGES = 1 << 20, 20


@pytest.mark.foreign
@pytest.mark.skipif(platform.machine() != "x86_64", reason="the counter is for x86-64")
@pytest.mark.parametrize("way", ["in", "out"])
def test_an_image_is_copied_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str) -> None:
    """Over dds rosplc copies an image once, and the first one, which Python handles, at most three times."""
    pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    if (compiler := shutil.which("gcc")) is None:
        pytest.skip("Debian package gcc is missing")
    from benchmarks import bench_image
    from benchmarks.bench_dds import OverDds

    counter = tmp_path / "copies.so"
    options = ["-O2", "-shared", "-fPIC", "-fno-builtin", "-Wall", "-Wextra"]
    subprocess.run([compiler, *options, "-o", counter, LIBRARY], check=True)
    (found := tmp_path / "found").mkdir()
    variables = {"LD_PRELOAD": counter, "COPIES_FROM": SIZE, "COPIES_IN": found}
    for name, value in {**variables, "CYCLONEDDS_URI": bench_image.TUNED}.items():
        monkeypatch.setenv(name, str(value))
    _, lost = bench_image.carried("bridge", OverDds(), way, SIZE, (10, IMAGES / 10))
    monkeypatch.delenv("LD_PRELOAD")
    assert lost == 0
    (bridge,) = (text for each in found.iterdir() if " rosplc run " in (text := each.read_text()))
    counts = [line.split(maxsplit=1) for line in bridge.splitlines()[1:]]
    # The DDS library and its wheel copy, too: what remains is rosplc's, and Python's.
    copies = sum(int(count) for count, module in counts if "cyclonedds" not in module)
    assert IMAGES <= copies <= IMAGES + 2, bridge
