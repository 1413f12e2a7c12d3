"""The configuration against the objects that a running bridge and a running PLC share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from rosplc.doctor.finding import Finding, Level, listed
from rosplc.doctor.kinds import fine, found, judged
from rosplc.doctor.objects import Objects, Seen
from rosplc.harmless import plural
from rosplc.layout import Layout
from rosplc.monitor.tracked import is_starting, process_words
from rosplc.shm import Direction

_NO_LAYOUT = "0" * 16
_RESTART = "Look at its log, and restart it."


@dataclass(frozen=True)
class Carried:
    """An object that the configuration leads to, and what has its name.

    ``use`` is the topic, or the service or action with its client; ``name`` tells its objects apart.
    """

    use: str
    name: str
    direction: Direction
    layout: Layout
    seen: Seen | None

    @property
    def live(self) -> bool:
        """Whether a bridge has the object now."""
        return self.seen is not None and self.seen.live


def holders(topics: Sequence[Carried], classic: Mapping[str, bool], config: str) -> Iterator[Finding]:
    """Report whether a bridge holds the topics.

    ``classic`` is classic topic → whether a bridge holds the lock file of its memory.
    """
    held = {each.use: each.live for each in topics} | dict(classic)
    calls = any(each.use != each.name for each in topics)
    start, count = f"rosplc run {config}", plural(len(held), "use" if calls else "topic")
    if not held:
        return
    if not any(held.values()):
        yield found("DOC601", f"no bridge holds any of {count}", command=start)
        return
    missing = [topic for topic, is_held in held.items() if not is_held]
    what = f"a bridge runs, and does not hold {listed(missing)}" if missing else ""
    remedy = "Restart the bridge with this configuration."
    yield judged("DOC601", what, f"a bridge holds {count}", remedy, start if missing else "", Level.WARNING)
    silent = [
        each.use
        for each in topics
        if each.live and each.seen and not each.seen.bridge_beats and not is_starting(each.seen.bridge_pid)
    ]
    if silent:
        what = f"a bridge holds {listed(dict.fromkeys(silent))}, and does not beat: it hangs, or was stopped"
        yield found("DOC601", what, _RESTART, level=Level.ERROR)


def bridges(objects: Objects) -> Iterator[Finding]:
    """Report whether each bridge that holds objects of this machine beats, whatever its prefix."""
    groups: dict[tuple[str, str], list[Seen]] = {}
    for seen in objects.objects:
        if seen.live and seen.description is not None:
            groups.setdefault((seen.prefix, seen.description.bridge), []).append(seen)
    for (prefix, name), held in sorted(groups.items()):
        bridge, count = f"bridge {name} (prefix {prefix})", plural(len(held), "object")
        silent = [seen for seen in held if not seen.bridge_beats]
        pid = max((seen.bridge_pid for seen in silent), default=0)
        if not silent:
            yield fine("DOC601", f"{bridge} beats in {count}")
        elif is_starting(pid):
            yield fine("DOC601", f"{bridge} holds {count}, and is starting")
        else:
            words = process_words(pid) if pid else ""
            why = f"process {pid}, {words}" if words else "it hangs, or was stopped"
            what = f"{bridge} holds {listed(seen.label for seen in silent)}, and does not beat: {why}"
            yield found("DOC601", what, _RESTART, level=Level.ERROR)


def layouts(topics: Sequence[Carried]) -> Iterator[Finding]:
    """Compare live objects with what the configuration gives."""
    wrong = [
        found("DOC602", f"{each.name}: {difference}")
        for each in topics
        if each.seen is not None and each.seen.identity is not None and each.live
        if (difference := _difference(each, each.seen))
    ]
    yield from wrong
    if not wrong and any(each.live for each in topics):
        yield fine("DOC602", "the running bridge's layouts are those of the configuration")


def _difference(plan: Carried, seen: Seen) -> str:
    identity, description = seen.identity, seen.description
    assert identity is not None
    if identity.direction is not plan.direction:
        return f"the object goes {identity.direction.word}, the configuration says {plan.direction.word}"
    if identity.layout_id == plan.layout.layout_id:
        return ""
    what = f"layout {identity.layout_id} there, {plan.layout.layout_id} here"
    if description is None:
        return what
    if description.type != plan.layout.type_name:
        return f"{what}: {description.type} there, {plan.layout.type_name} here"
    limits = plan.layout.limits.to_dict()
    there = {key: value for key, value in description.limits.items() if limits.get(key) != value}
    here = {key: limits.get(key) for key in there}
    return f"{what}: limits {there} there, {here} here" if there else f"{what}: the definition differs"


def beating(topics: Sequence[Carried]) -> Iterator[Finding]:
    """Report which topics no task of a PLC uses, and which layouts running tasks expect."""
    live = [(each, each.seen) for each in topics if each.live and each.seen is not None]
    if not live:
        return
    idle = dict.fromkeys(plan.use for plan, seen in live if not seen.plc_beats)
    what = f"no PLC task beats in {listed(idle)}" if idle else ""
    yield judged("DOC603", what, f"PLC tasks beat in {plural(len(live), 'object')}")
    refused = []
    for plan, seen in live:
        if plan.direction is not Direction.TO_PLC or seen.identity is None:
            continue  # a PLC that writes leaves no layout: with another one it does not claim
        actual = seen.identity.layout_id
        for line in seen.plc_lines:
            if line.layout_id not in (actual, _NO_LAYOUT):
                task = line.task or f"process {line.pid}"
                what = f"task {task} expects layout {line.layout_id}, the object has {actual}"
                refused.append(found("DOC604", f"{plan.name}: {what}"))
            elif line.error:
                code = f"SHM{line.error:03d}"
                what = f"{plan.name}: task {line.task or line.pid} reports error {code}"
                refused.append(found("DOC604", what, f"`rosplc explain {code}` explains it."))
    yield from refused or [fine("DOC604", "no PLC task expects another layout")]


def refusals(topics: Sequence[Carried]) -> Iterator[Finding]:
    """Report where messages were refused or cut."""
    refused = []
    for each in topics:
        if each.live and each.seen is not None and each.seen.snapshot is not None:
            writer = each.seen.snapshot.writer
            if writer.refused or writer.truncated:
                refused.append(f"{each.name}: {writer.refused} refused, {writer.truncated} shortened")
    if refused or any(each.live for each in topics):
        yield judged("DOC605", "; ".join(refused), "no message was refused or shortened")
