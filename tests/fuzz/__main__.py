"""``python -m tests.fuzz``: run the fuzzers."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.fuzz import build
from tests.fuzz.campaign import run_all
from tests.fuzz.corpus import CACHE, CORPUS, replace, work_folder
from tests.fuzz.counts import new_counts
from tests.fuzz.report import PAGE, summary, to_json, write_page
from tests.fuzz.targets import TARGETS


def minimize(names: list[str], cache: Path, shared: Path) -> int:
    """Write the repository's corpora again from what the fuzzers have found."""
    for name in names:
        if name not in [path.name for path in cache.glob("*")]:
            continue
        environment = dict(os.environ)
        if TARGETS[name].module:
            new_counts(shared / "counts")
            command = [sys.executable, "-m", "tests.fuzz.worker", name, str(shared / "counts")]
        else:
            plans = shared / "plans"
            build.plans_and_seeds(plans)
            environment["ROSPLC_FUZZ_PLANS"] = str(plans)
            command = [str(build.build(name, shared, fuzzing=True))]
        merged = shared / f"{name}-merged"
        merged.mkdir()
        folders = [str(merged), str(work_folder(name, cache))]
        if (CORPUS / name).is_dir():
            folders.append(str(CORPUS / name))
        done = subprocess.run(
            [*command, "-merge=1", f"-max_len={TARGETS[name].longest}", *folders],
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
        if done.returncode:
            print(done.stderr[-3000:], file=sys.stderr)
            return 1
        print(f"{name}: {replace(name, merged)} inputs", flush=True)
    return 0


def main() -> int:
    """Run the campaign; 0 if nothing was found, 1 if something was, 2 if nothing could run."""
    parser = argparse.ArgumentParser(
        prog="fuzz", description="Feed hostile input to everything that reads what others write."
    )
    parser.add_argument("--seconds", type=int, default=60, help="for each target (default 60)")
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        choices=TARGETS,
        metavar="TARGET",
        help="one of them; repeatable",
    )
    parser.add_argument("--jobs", type=int, default=1, help="how many at once (default 1)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what was done there")
    parser.add_argument("--page", action="store_true", help=f"write the table in {PAGE.name}")
    parser.add_argument("--cache", type=Path, default=CACHE, help="where inputs grow from run to run")
    parser.add_argument("--minimize", action="store_true", help="only rewrite the corpus from the cache")
    parser.add_argument("--list", action="store_true", help="only list the targets")
    options = parser.parse_args()
    names = options.only or list(TARGETS)
    if options.list:
        print("\n".join(f"{name:14s} {TARGETS[name].what}" for name in names))
        return 0
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    shared = Path(tempfile.mkdtemp(prefix="fuzz-"))
    try:
        if options.minimize:
            return minimize(names, options.cache, shared)
        with contextlib.suppress(KeyboardInterrupt):
            outcomes = run_all(
                names,
                options.seconds,
                shared,
                lambda line: print(line, flush=True),
                jobs=options.jobs,
                cache=options.cache,
            )
            return conclude(options, to_json(outcomes, options.seconds), [one.words for one in outcomes])
        return 130
    finally:
        shutil.rmtree(shared, ignore_errors=True)


def conclude(options: argparse.Namespace, facts: dict, words: list[str]) -> int:  # type: ignore[type-arg]
    """Print and write what a campaign did; return the exit status."""
    for text in filter(None, words):
        print(text, file=sys.stderr)
    print(summary(facts))
    for one in facts["targets"]:
        for finding in one.get("findings", ()):
            print(f"{one['name']}: {finding}")
    if options.json is not None:
        options.json.write_text(json.dumps(facts, indent=1) + "\n")
    if options.page:
        write_page(facts)
    if facts["findings"]:
        return 1
    return 0 if facts["executions"] else 2


if __name__ == "__main__":
    sys.exit(main())
