"""Hostile input for everything that reads what others write; docs/explanation/hostile-input.md."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz.build import CORE, Unbuildable
from tests.fuzz.corpus import CORPUS, MOST_BYTES
from tests.fuzz.replay import replay_native
from tests.fuzz.targets import TARGETS

pytestmark = pytest.mark.verifies("hostile", real="libFuzzer, atheris")

ROOT = Path(__file__).resolve().parents[2]
NATIVE = [name for name, entry in TARGETS.items() if not entry.module]
PYTHON = [name for name, entry in TARGETS.items() if entry.module]

NEEDS_CLANG = pytest.mark.needs("clang", "libclang-rt-14-dev")
MISSING = re.compile(r"Debian package \S+ is missing")


def run(*arguments: str) -> str:
    """Run a module; return what it printed. A target that cannot run here is a skip."""
    done = subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        check=False,
    )
    assert done.returncode == 0, done.stdout[-6000:]
    for line in done.stdout.splitlines():
        if found := MISSING.search(line):  # in CI this is a failure
            pytest.skip(found[0])
    return done.stdout


@pytest.mark.parametrize(
    "names", [pytest.param(NATIVE, id="native", marks=NEEDS_CLANG), pytest.param(PYTHON, id="python")]
)
@pytest.mark.timeout(1800)
def test_known_inputs_are_refused_or_accepted(names: list[str]) -> None:
    """Seeds, corpus and everything that once was a defect end in a result or in an error of rosplc's."""
    said = run("tests.fuzz.replay", *names)
    assert len(re.findall(r"^\w+: \d+ inputs, ", said, re.MULTILINE)) == len(names)


def test_the_corpus_is_small() -> None:
    """What is in the repository stays small, and every target has something of its own there."""
    sizes = [path.stat().st_size for path in CORPUS.rglob("*") if path.is_file()]
    assert sum(sizes) < MOST_BYTES
    assert {path.name for path in CORPUS.iterdir() if path.is_dir()} == set(TARGETS)


@pytest.mark.verify(minutes=3)
@pytest.mark.timeout(3600)
def test_the_fuzzers_find_nothing(tmp_path: Path) -> None:
    """Each fuzzer runs for some seconds from the corpus on, reaches every type, and finds nothing."""
    report = tmp_path / "report.json"
    seconds = str(max(5, 120 // len(TARGETS)))
    cache = str(tmp_path / "cache")
    run("tests.fuzz", "--seconds", seconds, "--jobs", "2", "--cache", cache, "--json", str(report))
    facts = json.loads(report.read_text())
    assert facts["findings"] == 0
    for one in facts["targets"]:
        if "skipped" in one:
            continue
        assert one["executions"] > 0, one["name"]
    codec = next(one for one in facts["targets"] if one["name"] == "codec")
    assert "skipped" in codec or codec["types_reached"] == codec["types"] > 800


DEFECTS = {
    "a count that is not clamped": (
        "_core/plan_encode.h",
        "            if (count > op->n)\n                count = op->n;\n",
        "",
        "codec",
    ),
    "a length that is not compared": (
        "_core/plan_decode.h",
        "if (at > d->size || bytes > d->size - at) {",
        "if (at > d->size) {",
        "codec",
    ),
    "a slot count that is believed anew": (
        "include/rosplc/region.h",
        "size_t index = sequence & (r->geometry.slot_count - 1u);",
        "size_t index = sequence & (rosplc_load(&r->header->identity.slot_count) * 2 - 1u);",
        "channel",
    ),
    "a take without its second look": (
        "include/rosplc/reader.h",
        "while (t->attempts <= ROSPLC_MAX_RETRIES) {",
        "while (t->attempts <= ROSPLC_MAX_RETRIES + 9) {",
        "channel",
    ),
}


@pytest.mark.verify(minutes=1)
@NEEDS_CLANG
@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_would_be_found(tmp_path: Path, defect: str) -> None:
    """The corpus alone finds a defect that is put into the C core on purpose."""
    file, sound, broken, target = DEFECTS[defect]
    core = tmp_path / "core"
    for part in ("_core", "include"):
        shutil.copytree(CORE / part, core / part, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    text = (core / file).read_text()
    assert text.count(sound) == 1
    (core / file).write_text(text.replace(sound, broken))
    try:
        with pytest.raises(AssertionError, match=r"AddressSanitizer|FAILED"):
            replay_native(target, tmp_path, core)
    except Unbuildable as error:
        pytest.skip(str(error))
