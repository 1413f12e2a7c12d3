"""Write the drawings of docs/explanation/shared-memory-format.md, with what the C core says and does.

Each has a narrow form for telephones.
"""

from __future__ import annotations

from functools import partial
from textwrap import wrap

from drawing import box, picture, stroke, text, write
from format_scenes import TOPIC, channel, folder, restart, rounds, torn
from rosplc.shm.constants import (
    IDENTITY,
    LINE_SIZE,
    MAX_RETRIES,
    READER_LINES,
    READER_LINES_OFFSET,
    SLOT_HEADER,
    SLOT_HEADER_SIZE,
    STATE_RETIRED,
    WRITER_LINE,
)

WIDTH, NARROW = 960, 360


Lane = tuple[float, float, float]
Row = tuple[int, float, str, str, str]
"""A part of an object: its offset, how high it is drawn, its kind, its name, what it holds."""


def _stacked(y: float, rows: list[Row], sign: str = "") -> tuple[list[str], float]:
    """Return rows of the narrow form, what a part holds below its name, and where they end."""
    parts = []
    for offset, height, kind, name, what in rows:
        high = max(height, 42) if what else height
        middle = y + high / 2 + 5
        parts += [box(52, y, 304, high, kind, 2), text(44, middle, f"{sign}{offset}", "mono right")]
        parts.append(text(62, middle - (9 if what else 0), name, "bold left on"))
        if what:
            parts.append(text(62, middle + 9, what, "small left on"))
        y += high
    return parts, y


def region_map(*, narrow: bool = False) -> str:
    """Draw an object from its first byte to its last, and one slot of it."""
    with folder() as place, channel(place) as opened:
        made = opened.identity
    reserved = READER_LINES_OFFSET + READER_LINES * LINE_SIZE
    rows: list[Row] = [
        (0, 44, "box", "identity", "magic, version, state, sizes, offsets"),
        (IDENTITY["layout_id_lo"], 44, "box", "identity", "layout id, generation, bridge id, CRC"),
        (WRITER_LINE["head"], 44, "busy", "writer's line", "head, epoch, beat, refused, truncated"),
        *(
            (
                READER_LINES_OFFSET + k * LINE_SIZE,
                26,
                "good",
                f"reader line {k}",
                "claim, beat, taken, lost" if not k else "",
            )
            for k in range(READER_LINES)
        ),
        (reserved, 22, "box", "reserved", ""),
        (made.description_offset, 44, "box", "self-description", "JSON: topic, type, limits, .msg text"),
        *(
            (made.slots_offset + k * made.slot_stride, 38, "shm", f"slot {k}", "slot header | record")
            for k in range(made.slot_count)
        ),
    ]
    fields: list[Row] = [
        (0, 34, "full", "sequence", "0 while it is being filled"),
        (4, 28, "slot", "length, flags", "first, truncated, substituted"),
        (SLOT_HEADER["stamp_lo"], 28, "slot", "stamp, its clock", "the source's time, ns"),
        (SLOT_HEADER["correlation_lo"], 28, "slot", "correlation, client", "for services and actions"),
        (SLOT_HEADER_SIZE, 64, "shm", "record", f"{made.record_size} bytes, as a C struct"),
    ]
    notes = (
        (0, 2, "constant once the object is visible", "but state: LIVE may become RETIRED, once"),
        (2, 3, "stored by the writer only", "head is the newest message"),
        (3, 3 + READER_LINES, "each stored by its claimant only", "a writer never waits for a line"),
    )
    title = (
        f"An object of {made.object_size} bytes: two lines of identity, the writer's line, "
        f"{READER_LINES} reader lines, a self-description and {made.slot_count} slots; each slot is a header "
        "and a record."
    )
    name, slot = f"rosplc.t{TOPIC.replace('/', '.')}", f"one slot, {made.slot_stride} bytes"
    if narrow:
        parts, y = _stacked(28, rows)
        parts += [text(204, 20, name, "mono"), text(44, y + 14, str(made.object_size), "mono right")]
        for number, (first, _, what, why) in enumerate(notes):
            top = y + 32 + 44 * number
            parts += [box(52, top, 14, 34, rows[first][2], 2), text(76, top + 14, what, "left")]
            parts.append(text(76, top + 31, why, "small left"))
        parts.append(text(52, y + 186, slot, "bold left"))
        more, y = _stacked(y + 196, fields, "+")
        parts += more
        return picture(title, 0, NARROW, y + 8, parts)
    parts, y, tops = (
        [text(86, 30, "offset", "small right"), text(290, 30, name, "mono")],
        42.0,
        [],
    )
    for offset, height, kind, name, what in rows:
        tops.append(y)
        middle = y + height / 2 + 5
        parts += [box(100, y, 380, height, kind, 2), text(86, middle, str(offset), "mono right")]
        parts.append(text(114, middle, name, "bold left") + text(248, middle, what, "small left"))
        y += height
    parts.append(text(86, y + 12, str(made.object_size), "mono right"))
    for first, last, what, why in notes:
        top, bottom = tops[first] + 4, tops[last] - 4
        parts.append(stroke(f"M490 {top:g}h8V{bottom:g}h-8", "line"))
        middle = (top + bottom) / 2
        parts += [text(510, middle - 2, what, "left"), text(510, middle + 16, why, "small left")]
    # one slot, larger
    left, top, width = 560.0, tops[3 + READER_LINES] + 26, 380.0
    parts.append(text(left + 60, top - 10, slot, "bold left"))
    y = top
    for offset, height, kind, name, what in fields:
        middle = y + height / 2 + 5
        parts += [
            box(left + 60, y, width - 60, height, kind, 2),
            text(left + 48, middle, f"+{offset}", "mono right"),
        ]
        parts.append(text(left + 72, middle, name, "left") + text(left + 216, middle, what, "small left on"))
        y += height
    slot_top = tops[3 + READER_LINES + 2]
    parts.append(stroke(f"M484 {slot_top + 6:g}L{left + 10:g} {top + 20:g}", "line"))
    parts.append(stroke(f"M484 {slot_top + 32:g}L{left + 10:g} {y - 8:g}", "line"))
    bottom = tops[-1] + 38 + 24
    return picture(title, 8, WIDTH, bottom, parts)


def slot_life(*, narrow: bool = False) -> str:
    """Draw what a slot goes through, and the slots of one object through a few messages."""
    history = rounds(7)
    slots = len(history[0])
    states = (
        ("busy", "being filled", "sequence 0: sealed", "no reader passes"),
        ("slot", "whole", "sequence s", "head is still s − 1"),
        ("full", "newest", "head = s", "what readers take"),
        ("good", "older", f"up to {slots - 2} behind head", "still taken, in order"),
        ("bad", "next to be filled", f"{slots - 1} behind head", "no longer accepted"),
    )
    title = (
        "A slot is sealed while it is filled, then whole, then the newest, then older, then the next to be "
        f"filled again; of {slots} slots, {slots - 1} hold messages that readers may take."
    )
    side, step, top, pitch = (352.0, 44.0, 382.0, 40.0) if narrow else (160.0, 188.0, 222.0, 92.0)
    parts = []
    for k, (kind, name, what, why) in enumerate(states):
        if narrow:
            y = 8 + 66.0 * k
            parts += [box(4, y, side, 48, kind), text(180, y + 20, name, "bold on")]
            parts.append(text(180, y + 38, f"{what}, {why}", "small on"))
            if k:
                parts.append(stroke(f"M180 {y - 18:g}V{y - 2:g}"))
            continue
        x = 20 + k * step
        parts += [
            box(x, 60, side, 84, kind),
            text(x + 80, 86, name, "bold"),
            text(x + 80, 108, what, "small on"),
        ]
        parts.append(text(x + 80, 126, why, "small on"))
        if k:
            parts.append(stroke(f"M{x - 28:g} 102H{x - 2:g}"))
    if not narrow:
        parts.append(stroke("M852 60C852 24 780 28 480 28S100 24 100 57"))
        parts.append(text(480, 22, "the writer reuses the slot", "small"))
    heading = f"An object with {slots} slots, as the C core fills it:"
    if narrow:
        heading = f"How the C core fills {slots} slots, by head:"
    parts.append(text(4 if narrow else 20, top - 36, heading, "left bold"))
    for number, held in enumerate(history):
        x = 4 + number * step if narrow else 20 + number * 118.0
        label = f"{'' if narrow else 'head '}{number}" if number else "new"
        parts.append(text(x + pitch / 2, top - 10, label, "small"))
        for slot, sequence in enumerate(held):
            behind = number - sequence
            kind = "slot" if not sequence else ("full", "good", "good", "bad")[min(behind, 3)]
            if sequence and 0 < behind <= slots - 2:
                kind = "good"
            y = top + slot * 30.0
            parts.append(box(x, y, pitch, 26, kind, 3))
            parts.append(text(x + pitch / 2, y + 18, str(sequence or "–"), "mono on"))
        if number and not narrow:
            parts.append(stroke(f"M{x - 24:g} 280H{x - 4:g}"))
    if narrow:
        return picture(title, 0, NARROW, top + 30 * slots + 4, parts)
    return picture(title, 4, WIDTH, 356, parts)


def torn_read(*, narrow: bool = False) -> str:
    """Draw a reader that is interrupted in the middle of its copy, and what it makes of that."""
    scene = torn()
    slot = scene.head % scene.slots
    writer, memory, reader = (134.0, 176.0, 226.0) if narrow else (150.0, 480.0, 810.0)
    parts: list[str] = []
    bottom = 4.0  # of what the narrow form has so far
    if not narrow:
        for x, name in ((writer, "writer"), (reader, "reader")):
            parts += [box(x - 110, 20, 220, 30), text(x, 40, name, "bold"), stroke(f"M{x:g} 50V560", "area")]
        parts.append(text(memory, 40, "slots and head", "bold"))

    def shown(y: float, held: list[int], head: int, marked: str) -> None:
        nonlocal bottom
        y, bottom = (bottom + 6, bottom + 46) if narrow else (y, bottom)
        for k, sequence in enumerate(held):
            kind = marked if k == slot else "slot"
            x = memory - 124 + k * 48
            parts.append(box(x, y, 46, 28, kind, 3) + text(x + 23, y + 19, str(sequence), "mono on"))
        parts.append(box(memory + 76, y, 66, 28, "full", 3))
        parts.append(text(memory + 109, y + 19, f"head {head}", "mono on"))

    def note(x: float, y: float, *lines: str, kind: str = "box") -> None:
        nonlocal bottom
        if narrow:  # whose it is stands above it
            lines, y = ("writer:" if x == writer else "reader:", *lines), bottom + 4
            bottom = y + 18 + 18 * len(lines)
        parts.append(box(x - 130, y, 260, 12 + 18 * len(lines), kind))
        for k, line in enumerate(lines):
            parts.append(text(x, y + 20 + 18 * k, line, "bold on" if narrow and not k else "small on"))

    shown(78, scene.before, scene.head, "full")
    note(reader, 70, f"loads head: {scene.head}", f"slot {slot} has sequence {scene.head}: starts to copy")
    note(reader, 150, "…is preempted, half a record copied…", kind="busy")
    first, last = scene.published[0], scene.published[-1]
    note(writer, 180, f"publishes {first} … {last}", "and waits for no reader")
    shown(188, [*scene.published, scene.head], scene.head_after, "good")
    zero = scene.after[slot]
    note(
        writer, 260, f"starts {last + 1}, which belongs in slot {slot}", f"sets its sequence to {zero} first"
    )
    shown(268, scene.after, scene.head_after, "busy")
    note(reader, 330, "…continues, copies the rest: torn", kind="busy")
    behind = scene.head_after - scene.head
    note(
        reader,
        386,
        f"checks again: head {scene.head_after}, sequence {zero}",
        f"{behind} behind head, and {scene.window} is the most;",
        f"sequence {zero} is not {scene.head}: discarded",
        kind="bad",
    )
    retry = f"retries with head {scene.retry}:"
    note(reader, 478, retry, "the writer is not near that slot; accepted", kind="good")
    if not narrow:
        parts.append(stroke(f"M{memory + 150:g} 92H{reader - 132:g}"))
        parts.append(stroke(f"M{writer + 132:g} 202H{memory - 128:g}"))
        parts.append(stroke(f"M{writer + 132:g} 282H{memory - 128:g}"))
        parts.append(stroke(f"M{reader - 132:g} 404H{memory + 4:g}V300"))
    for k, line in enumerate(
        (
            "The copy goes into a shadow. The PLC's",
            "program sees it only after the second",
            f"check; after {MAX_RETRIES} failed retries, the last",
            "message stays until the next scan.",
        )
    ):
        parts.append(text(memory - 124, (bottom + 20 if narrow else 470) + 18 * k, line, "left small"))
    title = (
        f"A reader copies message {scene.head} and is interrupted; the writer reuses its slot; the reader "
        "checks head and sequence again, discards the copy and takes the newest message."
    )
    if narrow:
        return picture(title, 0, NARROW, bottom + 86, parts)
    return picture(title, 8, WIDTH, 570, parts)


def generations(*, narrow: bool = False) -> str:
    """Draw an object through a killed bridge, the next one, and one with another layout.

    Time goes to the right, in the narrow form downwards.
    """
    scene = restart()
    assert scene.adopted and scene.adopted_head == scene.head and scene.replaced
    assert scene.old_state == STATE_RETIRED
    # The middle of each lane, and its left and right in the narrow form.
    bridge, memory, plc = (84.0, 1.0, 97.0), (196.0, 105.0, 267.0), (344.0, 272.0, 359.0)
    retired, successor = (196.0, 105.0, 179.0), (268.0, 183.0, 267.0)
    parts = []
    for name, (y, left, right) in (("bridge", bridge), ("/dev/shm", memory), ("PLC", plc)):
        if narrow:
            parts.append(text((left + right) / 2, 20, name, "bold"))
        else:
            parts.append(text(24, y + 5, name, "bold left"))

    def down(x: float) -> float:
        return 0.8 * (x - 110) + 32

    def span(x: float, end: float, lane: Lane, kind: str, *lines: str) -> None:
        y, left, right = lane
        shown = [(line, "on small" if number else "on") for number, line in enumerate(lines)]
        if narrow:
            wide = right - left - 4
            shown = [
                (part, style)
                for line, style in shown
                for part in wrap(line, int(wide / (6.6 if "small" in style else 7.9)), break_long_words=False)
            ]
            parts.append(box(left, down(x), right - left, down(end) - down(x), kind))
            x, y = (left + right) / 2, down((x + end) / 2)
        else:
            parts.append(box(x, y - 30, end - x, 60, kind))
            x = (x + end) / 2
        top = y + 5 - 9 * (len(shown) - 1)
        parts.extend(text(x, top + 18 * k, line, style) for k, (line, style) in enumerate(shown))

    def arrow(x: float, lane: Lane) -> None:
        if narrow:
            parts.append(stroke(f"M{bridge[2] - 12:g} {down(x):g}H{lane[1] - 1:g}"))
        else:
            parts.append(stroke(f"M{x:g} {bridge[0] + 30:g}V{lane[0] - 32:g}"))

    def between(x: float, what: str) -> None:
        at = (sum(bridge[1:]) / 2, down(x) + 5) if narrow else (x, bridge[0] + 5)
        parts.append(text(*at, what, "small"))

    span(110, 290, bridge, "box", "first bridge", "creates the object")
    span(370, 590, bridge, "box", "next bridge", "same configuration: adopts")
    span(670, 940, bridge, "box", "bridge with another layout", "retires, then replaces")
    between(330, "kill -9")
    between(630, "stopped")
    live = f"generation A, LIVE: head {scene.head} stays {scene.adopted_head}"
    span(150, 690, memory, "shm", live, "the next bridge continues where the first one stopped")
    span(690, 796, retired, "bad", "RETIRED", f"state {scene.old_state}, in place")
    span(716, 940, successor, "shm", f"generation B: head {scene.new_head}", "renamed to the same name")
    for x, lane in ((180, memory), (400, memory), (720, memory), (870, successor)):
        arrow(x, lane)
    span(190, 300, plc, "good", "attached", "takes messages")
    span(300, 410, plc, "busy", "stale", "no beat")
    span(410, 600, plc, "good", "recovered", "same mapping, continues")
    span(600, 700, plc, "busy", "stale", "no beat")
    span(700, 800, plc, "busy", "lets go", "sees RETIRED")
    span(800, 940, plc, "good", "opens again", "if the layout matches")
    title = (
        "A killed bridge leaves its object; the next one adopts it and the PLC notices only silence. A "
        "bridge with another layout retires the object in place and gives its name to a new generation."
    )
    if narrow:
        return picture(title, 0, NARROW, down(940) + 8, parts)
    return picture(title, 36, WIDTH, 392, parts)


DRAWINGS = {
    "shm-region.svg": region_map,
    "shm-slot-life.svg": slot_life,
    "shm-torn-read.svg": torn_read,
    "shm-generations.svg": generations,
}
DRAWINGS |= {
    name.replace(".svg", "-narrow.svg"): partial(draw, narrow=True) for name, draw in DRAWINGS.items()
}

if __name__ == "__main__":
    write(DRAWINGS)
