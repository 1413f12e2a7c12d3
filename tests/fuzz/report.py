"""What a campaign did: for people, as JSON, and as the table of docs/explanation/hostile-input.md."""

from __future__ import annotations

import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.fuzz.campaign import Outcome
from tests.fuzz.targets import TARGETS

__all__ = ["PAGE", "summary", "table", "to_json", "write_page"]

PAGE = Path(__file__).resolve().parents[2] / "docs/explanation/hostile-input.md"
_BEGIN, _END = "<!-- written by: python -m tests.fuzz --page -->", "<!-- end -->"


def to_json(outcomes: Sequence[Outcome], seconds: int) -> dict[str, Any]:
    """Return everything as plain data."""
    ran = [one for one in outcomes if not one.skipped]
    return {
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "machine": platform.machine(),
        "python": platform.python_version(),
        "seconds": seconds,
        "executions": sum(one.counts.executions for one in ran),
        "bytes": sum(one.counts.bytes for one in ran),
        "findings": sum(len(one.findings) for one in ran),
        "targets": [_target(one) for one in outcomes],
    }


def _target(one: Outcome) -> dict[str, Any]:
    facts: dict[str, Any] = {"name": one.name, "what": TARGETS[one.name].what}
    if one.skipped:
        return facts | {"skipped": one.skipped}
    facts |= {
        "engine": "atheris" if TARGETS[one.name].module else "libFuzzer, ASan, UBSan",
        "seconds": round(one.seconds, 1),
        "executions": one.counts.executions,
        "bytes": one.counts.bytes,
        "inputs": one.inputs,
        "findings": list(one.findings),
    }
    if one.counts.kinds:
        facts["types"] = len(one.counts.kinds)
        facts["types_reached"] = sum(1 for kind in one.counts.kinds if kind)
        facts["least_of_a_type"] = min(one.counts.kinds)
    return facts


def summary(facts: dict[str, Any]) -> str:
    """Return a few lines about what :func:`to_json` gave."""
    lines = []
    for one in facts["targets"]:
        if "skipped" in one:
            lines.append(f"{one['name']:14s} not run: {one['skipped']}")
            continue
        text = f"{one['name']:14s} {one['executions']:>12,} inputs {one['bytes']:>15,} bytes"
        if "types" in one:
            least = one["least_of_a_type"]
            text += f"   {one['types_reached']} of {one['types']} types, each {least} times or more"
        lines.append(text + (f"   {len(one['findings'])} FINDINGS" if one["findings"] else ""))
    lines.append(f"{'all':14s} {facts['executions']:>12,} inputs {facts['bytes']:>15,} bytes")
    return "\n".join(lines)


def table(facts: dict[str, Any]) -> str:
    """Return the documentation's table."""
    lines = [
        f"{facts['date']}, {facts['machine']}, Python {facts['python']}, {facts['seconds']} s per target:",
        "",
        "| target | content of the inputs | inputs | bytes | findings |",
        "| --- | --- | ---: | ---: | ---: |",
    ]
    for one in facts["targets"]:
        if "skipped" in one:
            lines.append(f"| `{one['name']}` | {one['what']} | not run: {one['skipped']} | | |")
            continue
        reached = f" ({one['types_reached']} of {one['types']} types)" if "types" in one else ""
        lines.append(
            f"| `{one['name']}` | {one['what']}{reached} | {one['executions']:,} | {one['bytes']:,} | "
            f"{len(one['findings'])} |"
        )
    lines.append(f"| all | | {facts['executions']:,} | {facts['bytes']:,} | {facts['findings']} |")
    return "\n".join(lines)


def write_page(facts: dict[str, Any], page: Path = PAGE) -> None:
    """Put the table into the documentation."""
    text = page.read_text(encoding="utf-8")
    head, rest = text.split(_BEGIN)
    page.write_text(f"{head}{_BEGIN}\n\n{table(facts)}\n\n{_END}{rest.split(_END)[1]}", encoding="utf-8")
