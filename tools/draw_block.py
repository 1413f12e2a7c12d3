"""The picture of a function block as a graphical editor shows it: inputs left, outputs right."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest

from drawing import box, picture, stroke, text

ROW, TOP = 17, 8
CHARACTER = 6.7  # the width of one in 11 px of a monospaced font
STUB, GAP = 12, 16
SCALE = 1.2  # of the picture where there is room
LONGEST = 12  # characters of a type's name, without its beginning if it is longer

Pin = tuple[str, str]
"""A pin's name and type."""


def shown_type(name: str) -> str:
    """Return a type as the picture shows it, ``…Transform`` for ``geometry_msgs_Transform``."""
    return name if len(name) <= LONGEST or "_" not in name else f"…{name.rpartition('_')[2]}"


def block_picture(name: str, below: str, inputs: Sequence[Pin], outputs: Sequence[Pin]) -> str:
    """Return the box of a block: its name, a smaller line, its pins, and their types outside."""
    given, taken = (
        CHARACTER * max((len(shown_type(kind)) for _, kind in pins), default=0) for pins in (inputs, outputs)
    )
    rows = [
        (CHARACTER * len(a), CHARACTER * len(b))
        for (a, _), (b, _) in zip_longest(inputs, outputs, fillvalue=("", ""))
    ]
    inner = max((a + b + (GAP if a and b else 0) + 10 for a, b in rows), default=0)
    left = given + STUB + 6
    inside = max(inner, CHARACTER * 1.1 * len(name) + 12, CHARACTER * len(below) + 12)
    right = left + inside
    width = right + STUB + 6 + taken
    head = TOP + (40 if below else 26)
    bottom = head + ROW * max(len(inputs), len(outputs), 1) + 8
    drawn = [
        box(left, TOP, inside, bottom - TOP, "box", 2),
        text(left + inside / 2, TOP + 18, name, "pin bold"),
        *([text(left + inside / 2, TOP + 33, below, "pin dim")] if below else []),
    ]
    for number, (pin, kind) in enumerate(inputs):
        y = head + ROW * number + 10
        drawn += [stroke(f"M{left - STUB:g} {y - 4:g}H{left:g}", "line"), text(left + 5, y, pin, "pin left")]
        drawn.append(text(left - STUB - 4, y, shown_type(kind), "pin dim right"))
    for number, (pin, kind) in enumerate(outputs):
        y = head + ROW * number + 10
        drawn += [stroke(f"M{right:g} {y - 4:g}H{right + STUB:g}", "line")]
        drawn += [
            text(right - 5, y, pin, "pin right"),
            text(right + STUB + 4, y, shown_type(kind), "pin dim left"),
        ]
    title = f"The block {name}: {len(inputs)} inputs on the left, {len(outputs)} outputs on the right."
    return picture(title, 0, width, bottom + 8, drawn, SCALE)
