"""An older release, built from its sources: what ``PYTHONPATH`` has to name to run it."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.lib.archives import unpack

__all__ = ["OLD", "old_release"]

OLD = "0.1.0"
_HERE = Path(__file__).resolve().parent
_CACHE = _HERE.parents[1] / ".cache" / "peers"


def old_release() -> Path:
    """Return the ``src`` folder of 0.1.0 with its C core built; made once for each Python."""
    archive = _HERE / f"rosplc-{OLD}.tar.xz"
    key = hashlib.sha256(archive.read_bytes() + sys.version.encode()).hexdigest()[:16]
    place = _CACHE / key
    if not place.exists():
        _CACHE.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=_CACHE) as folder:
            unpack(archive, Path(folder))
            root = Path(folder) / f"rosplc-{OLD}"
            build = [sys.executable, "setup.py", "-q", "build_ext", "--inplace"]
            subprocess.run(build, cwd=root, check=True, capture_output=True)
            # Two workers may build at once; the first to finish is kept.
            try:
                root.rename(place)
            except OSError:
                assert place.exists()
    return place / "src"


def environment() -> dict[str, str]:
    """Return an environment in which ``python -m rosplc`` is the older release."""
    return {**os.environ, "PYTHONPATH": str(old_release())}
