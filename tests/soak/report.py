"""What a campaign found, for people and as JSON."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import statistics
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import rosplc
from tests.soak.campaign import Outcome
from tests.soak.results import percentile


def _by_fault(outcome: Outcome) -> dict[str, dict[str, Any]]:
    table = {}
    for name in sorted({one.fault for one in outcome.rounds}):
        rounds = [one for one in outcome.rounds if one.fault == name]
        times = [one.recovery_s for one in rounds if not one.violations]
        table[name] = {
            "rounds": len(rounds),
            "survived": sum(not one.violations for one in rounds),
            "recovery_p50_s": round(statistics.median(times), 3) if times else None,
            "recovery_p99_s": round(percentile(times, 0.99), 3) if times else None,
            "recovery_max_s": round(max(times), 3) if times else None,
        }
    return table


def machine() -> dict[str, Any]:
    """Return what a figure depends on beside the code: the machine and the versions in use."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return {
        "processor": models[0] if models else platform.machine(),
        "cores": os.cpu_count(),
        "nice": os.getpriority(os.PRIO_PROCESS, 0),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "rosplc": rosplc.__version__,
        "cyclonedds": _version("cyclonedds"),
        "eclipse-zenoh": _version("eclipse-zenoh"),
        "ended": time.strftime("%Y-%m-%d %H:%M", time.gmtime()),
    }


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


def to_json(outcome: Outcome) -> dict[str, Any]:
    """Return everything as plain data; times in seconds, memory in KiB."""
    return {
        "seed": outcome.seed,
        "backend": outcome.backend,
        "plc": outcome.plc,
        "spared": list(outcome.spared),
        "peers": "forked",
        "machine": machine(),
        "seconds": round(outcome.seconds, 1),
        "cpu_s": round(outcome.cpu_s, 1),
        "rounds": len(outcome.rounds),
        "messages": outcome.messages,
        "violations": outcome.violations,
        "faults": _by_fault(outcome),
        "skipped": outcome.skipped,
        "missing_per_round_with_a_death": outcome.unaccounted,
        "growth_kb": outcome.growth_kb,
        "log": [asdict(one) for one in outcome.rounds],
        "samples": outcome.samples,
    }


def summary(outcome: Outcome) -> str:
    """Return the table that is printed at the end."""
    lines = [
        "",
        "| fault | rounds | survived | recovery p50 | p99 | max |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for name, row in _by_fault(outcome).items():
        times = [row[f"recovery_{key}_s"] for key in ("p50", "p99", "max")]
        shown = " | ".join("–" if value is None else f"{value:.2f} s" for value in times)
        lines.append(f"| {name} | {row['rounds']} | {row['survived']} | {shown} |")
    lines.append("")
    lines += [f"not tried: {name}: {why}" for name, why in outcome.skipped.items()]
    if outcome.unaccounted:
        lines.append(
            f"messages missing where something died, those sent while it was away among them: "
            f"median {statistics.median(outcome.unaccounted):.0f}, most {max(outcome.unaccounted)}, "
            f"of {len(outcome.unaccounted)} rounds"
        )
    grown = ", ".join(f"{name} {kb} KiB" for name, kb in outcome.growth_kb.items())
    lines.append(f"the most that a settled process has grown: {grown or 'none lived long enough'}")
    lines.append(
        f"{len(outcome.rounds)} rounds in {outcome.seconds:.0f} s, {outcome.cpu_s:.0f} s of processor time, "
        f"over {outcome.backend}, "
        f"{outcome.messages} messages, {len(outcome.violations)} violations, seed {outcome.seed}"
    )
    lines += [f"violated: {text}" for text in outcome.violations]
    return "\n".join(lines)
