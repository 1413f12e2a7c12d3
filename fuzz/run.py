"""Build the codec's libFuzzer target with clang and run it for a while.

usage: python fuzz/run.py [--seconds N] [--corpus FOLDER]

The corpus folder keeps what was found between runs. Exit status 0: nothing was found.
Needs the Debian packages clang and libclang-rt-14-dev.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from export_plans import export  # this folder's, since the file is run as a script

FUZZ = Path(__file__).resolve().parent
CORE = FUZZ.parent / "src/rosplc/_core"


def build(folder: Path) -> Path:
    """Compile the target into ``folder``."""
    program = folder / "codec_fuzz"
    flags = ["-std=gnu11", "-g", "-O1", "-Wall", "-Wextra", "-Werror"]
    checks = ["-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=all"]
    command = [
        "clang",
        *flags,
        *checks,
        f"-I{CORE}",
        f"-I{FUZZ}",
        str(FUZZ / "codec_fuzz.c"),
        "-o",
        str(program),
    ]
    subprocess.run(command, check=True)
    return program


def fuzz(folder: Path, seconds: int, corpus: Path) -> int:
    """Run the target; what it finds is left in ``corpus``. Returns its exit status."""
    program, plans = build(folder), folder / "plans"
    export(plans)
    corpus.mkdir(parents=True, exist_ok=True)
    options = [f"-max_total_time={seconds}", "-max_len=2048", "-timeout=10", "-print_final_stats=1"]
    command = [str(program), *options, f"-artifact_prefix={corpus}/", str(corpus)]
    return subprocess.run(
        command, env={**os.environ, "ROSPLC_FUZZ_PLANS": str(plans)}, check=False
    ).returncode


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--corpus", type=Path, help="default: a folder that is removed again")
    arguments = parser.parse_args()
    if shutil.which("clang") is None:
        print("Debian package clang is missing", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as name:
        corpus = arguments.corpus or Path(name, "corpus")
        return fuzz(Path(name), arguments.seconds, corpus)


if __name__ == "__main__":
    sys.exit(main())
