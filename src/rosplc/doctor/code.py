"""Generated PLC code against the configuration and against the running bridge."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rosplc.config.resolve import TopicPlan
from rosplc.doctor.finding import Finding
from rosplc.doctor.generated import Block, Generated
from rosplc.doctor.kinds import kind
from rosplc.doctor.objects import Objects
from rosplc.doctor.words import listed
from rosplc.harmless import plural
from rosplc.shm import Direction, Namespace

__all__ = ["against_config", "against_live", "fences", "files"]

_ARM = ("aarch64", "armv8l", "armv7l", "armv6l")


def against_config(
    code: Generated,
    plans: Sequence[TopicPlan],
    prefix: str,
    command: str,
    *,
    differences: Mapping[str, str] | None = None,
) -> Iterator[Finding]:
    """Compare each block with what would be generated now.

    Args:
        code: What is in the folder.
        plans: The configuration's topics.
        prefix: The configuration's prefix.
        command: What generates the code again.
        differences: Type → what differs in its declaration.
    """
    if code.prefix != prefix:
        what = f"the code looks for {code.prefix}.t.…, the configuration's prefix is {prefix}"
        yield kind("DOC706").found(what, command=command)
    else:
        yield kind("DOC706").fine(f"the code looks for {prefix}.t.…")
    blocks = {_key(block): block for block in code.blocks}
    missing, stale = [], False
    for plan in plans:
        block = blocks.pop(_name(plan), None)
        if block is None or block.to_plc is not (plan.direction is Direction.TO_PLC):
            missing.append(plan.topic if block is None else f"{plan.topic} (other direction)")
        elif what := _difference(block, plan):
            stale = True
            more = (differences or {}).get(plan.type_name, "")
            yield kind("DOC702").found(f"{plan.topic}: {what}{f'; {more}' if more else ''}", command=command)
    if not stale:
        same = plural(len(plans) - len(missing), "topic")
        yield kind("DOC702").fine(f"the code's layouts of {same} are the configuration's")
    if missing:
        yield kind("DOC704").found(f"not in the code: {listed(missing)}", command=command)
    else:
        yield kind("DOC704").fine("the code has a block for every topic")
    if blocks:
        yield kind("DOC705").found(
            f"only in the code: {listed(b.topic for b in blocks.values())}", command=command
        )
    else:
        yield kind("DOC705").fine("the code has no other topics")


def _key(block: Block) -> tuple[str, bool]:
    return block.topic, block.classic


def _name(plan: TopicPlan) -> tuple[str, bool]:
    return (plan.topic if plan.classic is None else plan.classic.name), plan.port == "classic"


def _difference(block: Block, plan: TopicPlan) -> str:
    layout = plan.layout
    if block.classic:
        return (
            "" if block.record_size == layout.size else f"{block.record_size} bytes there, {layout.size} here"
        )
    if block.layout_id == layout.layout_id:
        return ""
    sizes = "" if block.record_size == layout.size else f" ({block.record_size} and {layout.size} bytes)"
    return f"layout {block.layout_id} in {block.name}, {layout.layout_id} by the configuration{sizes}"


def against_live(code: Generated, objects: Objects, directory: Path) -> Iterator[Finding]:
    """Compare each block with the object that it would open now."""
    namespace = Namespace(code.prefix, directory)
    seen, wrong = 0, False
    for block in code.blocks:
        if block.classic:
            continue
        found = objects.of(namespace, block.topic)
        if found is None or found.identity is None or not found.live:
            continue
        seen += 1
        identity = found.identity
        if block.to_plc is not (identity.direction is Direction.TO_PLC):
            wrong = True
            yield kind("DOC703").found(f"{block.topic}: the object goes {identity.direction.word} [SHM110]")
        elif identity.layout_id != block.layout_id:
            wrong = True
            sizes = f"{block.record_size} and {identity.record_size} bytes"
            what = f"layout {block.layout_id} in the code, {identity.layout_id} in the bridge ({sizes})"
            yield kind("DOC703").found(f"{block.topic}: {what} [SHM112]")
    if seen and not wrong:
        yield kind("DOC703").fine(f"the running bridge has the code's layouts in {plural(seen, 'object')}")


def fences(code: Generated, machine: str, command: str) -> Iterator[Finding]:
    """Judge whether the code's rule of ordering is right for this machine."""
    if not code.arm and code.fenced and machine in _ARM:
        what = f"the code relies on the memory fence of x86, and this is {machine}"
        yield kind("DOC707").found(what, command=f"{command} --target arm")
    else:
        yield kind("DOC707").fine("the code's rule of ordering fits this machine")


def files(folder: Path, expected: Mapping[str, bytes], command: str) -> tuple[list[Finding], dict[str, str]]:
    """Compare the files with what would be generated now.

    Args:
        folder: The output folder.
        expected: Path below it → content.
        command: What generates the code again.

    Returns:
        What is found where no layout differs, and type → the first line of its declaration that differs.
    """
    other, differences = [], {}
    for path, content in sorted(expected.items()):
        if not path.startswith("st/"):
            continue
        try:
            actual = (folder / path).read_bytes()
        except OSError:
            continue  # a missing topic is found by its own
        if actual != content:
            other.append(path)
            if path.startswith("st/Types/") and (line := _first_difference(actual, content)):
                head = (
                    content.decode("ascii", "replace").splitlines()[0].removeprefix("// ").partition(",")[0]
                )
                differences[head] = line
    if not other:
        return [kind("DOC708").fine("the files are what this release generates")], differences
    return [kind("DOC708").found(f"not as generated now: {listed(other)}", command=command)], differences


def _first_difference(actual: bytes, expected: bytes) -> str:
    old, new = (text.decode("ascii", "replace").splitlines()[1:] for text in (actual, expected))
    gone, come = "", ""
    for line in difflib.ndiff(old, new):
        if line.startswith("- ") and not gone:
            gone = line[2:].partition("//")[0].strip().rstrip(";")
        elif line.startswith("+ ") and not come:
            come = line[2:].partition("//")[0].strip().rstrip(";")
        if gone and come:
            return f"first: `{gone}` there, `{come}` here"
    return f"first: only {'there' if gone else 'here'}: `{gone or come}`" if gone or come else ""
