"""Write the drawings of docs/explanation/shared-memory-format.md, with what the C core says and does."""

from __future__ import annotations

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

WIDTH = 960


def region_map() -> str:
    """Draw an object from its first byte to its last, and one slot of it."""
    with folder() as place, channel(place) as opened:
        made = opened.identity
    reserved = READER_LINES_OFFSET + READER_LINES * LINE_SIZE
    rows: list[tuple[int, float, str, str, str]] = [
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
    parts, y, tops = (
        [text(86, 30, "offset", "small right"), text(290, 30, f"rosplc.t{TOPIC.replace('/', '.')}", "mono")],
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
    for first, last, what, why in (
        (0, 2, "constant once the object is visible", "but state: LIVE may become RETIRED, once"),
        (2, 3, "stored by the writer only", "head names the newest message"),
        (3, 3 + READER_LINES, "each stored by the reader who claimed it", "a writer never waits for a line"),
    ):
        top, bottom = tops[first] + 4, tops[last] - 4
        parts.append(stroke(f"M490 {top:g}h8V{bottom:g}h-8", "line"))
        middle = (top + bottom) / 2
        parts += [text(510, middle - 2, what, "left"), text(510, middle + 16, why, "small left")]
    # one slot, larger
    left, top, width = 560.0, tops[3 + READER_LINES] + 26, 380.0
    fields = [
        (0, 34, "full", "sequence", "0 while it is being filled"),
        (4, 28, "slot", "length, flags", "first, truncated, substituted"),
        (SLOT_HEADER["stamp_lo"], 28, "slot", "stamp, its clock", "the source's time, ns"),
        (SLOT_HEADER["correlation_lo"], 28, "slot", "correlation, client", "for services and actions"),
        (SLOT_HEADER_SIZE, 64, "shm", "record", f"{made.record_size} bytes, as a C struct"),
    ]
    parts.append(text(left + 60, top - 10, f"one slot, {made.slot_stride} bytes", "bold left"))
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
    title = (
        f"An object of {made.object_size} bytes: two lines of identity, the writer's line, "
        f"{READER_LINES} reader lines, a self-description and {made.slot_count} slots; each slot is a header "
        "and a record."
    )
    return picture(title, 8, WIDTH, bottom, parts)


def slot_life() -> str:
    """Draw what a slot goes through, and the slots of one object through a few messages."""
    history = rounds(7)
    slots = len(history[0])
    states = (
        ("busy", "being filled", "sequence 0: sealed", "no reader passes"),
        ("slot", "whole", "sequence s", "head still says s − 1"),
        ("full", "newest", "head = s", "what readers take"),
        ("good", "older", f"up to {slots - 2} behind head", "still taken, in order"),
        ("bad", "next to be filled", f"{slots - 1} behind head", "no longer accepted"),
    )
    parts = []
    for k, (kind, name, what, why) in enumerate(states):
        x = 20 + k * 188.0
        parts += [
            box(x, 60, 160, 84, kind),
            text(x + 80, 86, name, "bold"),
            text(x + 80, 108, what, "small on"),
        ]
        parts.append(text(x + 80, 126, why, "small on"))
        if k:
            parts.append(stroke(f"M{x - 28:g} 102H{x - 2:g}"))
    parts += [
        stroke("M852 60C852 24 780 28 480 28S100 24 100 57"),
        text(480, 22, "the writer comes round again", "small"),
    ]
    parts.append(text(20, 186, f"An object with {slots} slots, as the C core fills it:", "left bold"))
    for number, held in enumerate(history):
        x = 20 + number * 118.0
        parts.append(text(x + 46, 212, f"head {number}" if number else "new", "small"))
        for slot, sequence in enumerate(held):
            behind = number - sequence
            kind = "slot" if not sequence else ("full", "good", "good", "bad")[min(behind, 3)]
            if sequence and 0 < behind <= slots - 2:
                kind = "good"
            y = 222 + slot * 30.0
            parts.append(box(x, y, 92, 26, kind, 3) + text(x + 46, y + 18, str(sequence or "–"), "mono on"))
        if number:
            parts.append(stroke(f"M{x - 24:g} 280H{x - 4:g}"))
    title = (
        "A slot is sealed while it is filled, then whole, then the newest, then older, then the next to be "
        f"filled again; of {slots} slots, {slots - 1} hold messages that readers may take."
    )
    return picture(title, 4, WIDTH, 356, parts)


def torn_read() -> str:
    """Draw a reader that is interrupted in the middle of its copy, and what it makes of that."""
    scene = torn()
    slot = scene.head % scene.slots
    writer, memory, reader = 150.0, 480.0, 810.0
    parts = [
        *(
            box(x - 110, 20, 220, 30) + text(x, 40, name, "bold")
            for x, name in ((writer, "writer"), (reader, "reader"))
        ),
        text(memory, 40, "slots and head", "bold"),
        *(stroke(f"M{x:g} 50V560", "area") for x in (writer, reader)),
    ]

    def shown(y: float, held: list[int], head: int, marked: str) -> None:
        for k, sequence in enumerate(held):
            kind = marked if k == slot else "slot"
            x = memory - 124 + k * 48
            parts.append(box(x, y, 46, 28, kind, 3) + text(x + 23, y + 19, str(sequence), "mono on"))
        parts.append(
            box(memory + 76, y, 58, 28, "full", 3) + text(memory + 107, y + 19, f"head {head}", "mono on")
        )

    def note(x: float, y: float, *lines: str, kind: str = "box") -> None:
        parts.append(box(x - 130, y, 260, 12 + 18 * len(lines), kind))
        parts.extend(text(x, y + 20 + 18 * k, line, "small") for k, line in enumerate(lines))

    shown(78, scene.before, scene.head, "full")
    note(reader, 70, f"loads head: {scene.head}", f"slot {slot} says sequence {scene.head}: begins to copy")
    parts.append(stroke(f"M{memory + 142:g} 92H{reader - 132:g}"))
    note(reader, 150, "…is preempted, half a record copied…", kind="busy")
    first, last = scene.published[0], scene.published[-1]
    note(writer, 180, f"publishes {first} … {last}", "and waits for nobody")
    shown(188, [*scene.published, scene.head], scene.head_after, "good")
    parts.append(stroke(f"M{writer + 132:g} 202H{memory - 128:g}"))
    note(
        writer,
        260,
        f"begins {last + 1}: it lives in slot {slot}",
        f"sets its sequence to {scene.after[slot]} first",
    )
    shown(268, scene.after, scene.head_after, "busy")
    parts.append(stroke(f"M{writer + 132:g} 282H{memory - 128:g}"))
    note(reader, 330, "…goes on, copies the rest: a mixture", kind="busy")
    behind = scene.head_after - scene.head
    note(
        reader,
        386,
        f"looks again: head {scene.head_after}, sequence {scene.after[slot]}",
        f"{behind} behind head, and {scene.window} is the most;",
        f"sequence {scene.after[slot]} is not {scene.head}: thrown away",
        kind="bad",
    )
    parts.append(stroke(f"M{reader - 132:g} 404H{memory + 4:g}V300"))
    note(
        reader,
        478,
        f"tries once more with head {scene.retry}:",
        "nobody is near that slot; accepted",
        kind="good",
    )
    parts += [
        text(memory - 124, 470, "The copy goes into a shadow. What the PLC's", "left small"),
        text(memory - 124, 488, "program sees changes only after the second", "left small"),
        text(memory - 124, 506, f"look; after {MAX_RETRIES} failed repetitions the last", "left small"),
        text(memory - 124, 524, "message stays until the next scan.", "left small"),
    ]
    title = (
        f"A reader copies message {scene.head} and is interrupted; the writer fills its slot again; the "
        "reader looks at head and sequence a second time, throws the copy away and takes the newest message."
    )
    return picture(title, 8, WIDTH, 570, parts)


def generations() -> str:
    """Draw an object through a killed bridge, the next one, and one with another layout."""
    scene = restart()
    assert scene.adopted and scene.adopted_head == scene.head and scene.replaced
    assert scene.old_state == STATE_RETIRED
    lanes = {"bridge": 84.0, "/dev/shm": 196.0, "PLC": 344.0}
    parts = [text(24, y + 5, name, "bold left") for name, y in lanes.items()]
    bridge, memory, plc = lanes.values()

    def span(x: float, end: float, y: float, kind: str, *lines: str) -> None:
        parts.append(box(x, y - 30, end - x, 60, kind))
        top = y + 5 - 9 * (len(lines) - 1)
        parts.extend(
            text((x + end) / 2, top + 18 * k, line, "small" if k else "") for k, line in enumerate(lines)
        )

    span(110, 290, bridge, "box", "first bridge", "makes the object")
    span(370, 590, bridge, "box", "next bridge", "same configuration: adopts")
    span(670, 940, bridge, "box", "bridge with another layout", "retires, then replaces")
    parts.append(text(330, bridge - 4, "kill -9", "small") + text(330, bridge + 14, "†", "bold"))
    parts.append(text(630, bridge + 5, "stopped", "small"))
    span(
        150,
        690,
        memory,
        "shm",
        f"generation A, LIVE: head {scene.head} stays {scene.adopted_head}",
        "the next bridge goes on where the first one ended",
    )
    span(690, 796, memory, "bad", "RETIRED", f"state {scene.old_state}, in place")
    parts.append(box(716, memory + 42, 224, 60, "shm"))
    parts.append(text(828, memory + 67, f"generation B: head {scene.new_head}", ""))
    parts.append(text(828, memory + 86, "renamed to the same name", "small"))
    parts.append(
        stroke(f"M180 {bridge + 30:g}V{memory - 32:g}") + stroke(f"M400 {bridge + 30:g}V{memory - 32:g}")
    )
    parts.append(
        stroke(f"M720 {bridge + 30:g}V{memory - 32:g}") + stroke(f"M870 {bridge + 30:g}V{memory + 40:g}")
    )
    span(190, 300, plc, "good", "attached", "takes messages")
    span(300, 410, plc, "busy", "stale", "no beat")
    span(410, 600, plc, "good", "recovered", "same mapping, goes on")
    span(600, 700, plc, "busy", "stale", "no beat")
    span(700, 800, plc, "busy", "lets go", "sees RETIRED")
    span(800, 940, plc, "good", "opens again", "if the layout is its own")
    title = (
        "A killed bridge leaves its object; the next one adopts it and the PLC notices silence only. A "
        "bridge with another layout retires the object in place and gives its name to a new generation."
    )
    return picture(title, 36, WIDTH, 392, parts)


DRAWINGS = {
    "shm-region.svg": region_map,
    "shm-slot-life.svg": slot_life,
    "shm-torn-read.svg": torn_read,
    "shm-generations.svg": generations,
}

if __name__ == "__main__":
    write(DRAWINGS)
