"""Write docs/images/path.svg and, for telephones, path-narrow.svg: the path of a message."""

from __future__ import annotations

from drawing import box, picture, stroke, text, write

WIDTH, BOTTOM = 960, 336


def part(x: float, y: float, width: float, title: str, subtitle: str) -> str:
    """Return a box that names one part and what it does."""
    middle = x + width / 2
    return (
        box(x, y, width, 56) + text(middle, y + 24, title, "bold") + text(middle, y + 43, subtitle, "small")
    )


def channel(x: float, y: float, name: str, newest: int, width: float = 188) -> str:
    """Return an object in shared memory: its name, its slots, the newest one filled."""
    step = (width - 36) / 4
    slots = "".join(
        f'<rect x="{x + 20 + step * i:g}" y="{y + 27:g}" width="{step - 4:g}" height="18" '
        f'class="{"full" if i == newest else "slot"}"/>'
        for i in range(4)
    )
    return box(x, y, width, 56, "shm") + text(x + width / 2, y + 18, name, "mono") + slots


def arrow(x1: float, x2: float, y: float) -> str:
    """Return a horizontal arrow."""
    return stroke(f"M{x1:g} {y:g}H{x2:g}")


TITLE = (
    "A message goes from ROS through the bridge and a channel in shared memory into the PLC's scan "
    "cycle, and back the same way."
)


def image() -> str:
    """Return the whole picture."""
    down, up = 96, 212
    parts = [
        # who owns what
        box(196, 40, 320, 252, "area") + text(356, 64, "bridge: one process, one YAML file", "bold"),
        box(754, 40, 196, 252, "area") + text(852, 64, "PLC: its own scan cycle", "bold"),
        box(10, 40, 140, 252) + text(80, 128, "ROS 2 graph", "bold"),
        text(80, 150, "any node,", "small") + text(80, 167, "any message type,", "small"),
        text(80, 184, "over DDS", "small"),
        text(635, 64, "/dev/shm", "bold"),
        # towards the PLC
        part(212, down, 128, "backend", "raw CDR bytes"),
        part(372, down, 128, "codec", "one pass, checked"),
        channel(541, down, "rosplc.t.cmd_vel", 2),
        part(770, down, 164, "Read block", "newest whole message"),
        arrow(150, 210, down + 28) + arrow(340, 370, down + 28),
        arrow(500, 539, down + 28) + arrow(729, 768, down + 28),
        # towards ROS
        part(212, up, 128, "backend", "raw CDR bytes"),
        part(372, up, 128, "codec", "one pass, checked"),
        channel(541, up, "rosplc.t.joint_states", 1),
        part(770, up, 164, "Write block", "publishes, never waits"),
        arrow(212, 152, up + 28) + arrow(372, 342, up + 28),
        arrow(541, 502, up + 28) + arrow(770, 731, up + 28),
        text(635, 182, "4 or more slots: the newest", "small"),
        text(635, 198, "whole message always stays", "small"),
        text(480, 318, "no lock, no wait and no system call on the PLC's side", "small"),
    ]
    return picture(TITLE, 24, WIDTH, BOTTOM, parts)


def narrow() -> str:
    """Return the same from top to bottom: towards the PLC on the left, towards ROS on the right."""
    down, up, width = 14, 194, 152
    parts = [
        box(4, 8, 352, 48) + text(180, 28, "ROS 2 graph", "bold"),
        text(180, 46, "any node, any message type, over DDS", "small"),
        box(4, 76, 352, 202, "area") + text(180, 95, "bridge", "bold"),
        text(180, 111, "one YAML file", "small"),
        text(180, 298, "/dev/shm", "bold"),
        box(4, 388, 352, 112, "area") + text(180, 407, "PLC", "bold"),
        text(180, 423, "its scan cycle", "small"),
        text(180, 518, "no lock, no wait and no system call on the PLC's side", "small"),
    ]
    for x, name, newest, block, what in (
        (down, "cmd_vel", 2, "Read block", "newest whole message"),
        (up, "joint_states", 1, "Write block", "publishes, never waits"),
    ):
        parts += [
            part(x, 120, width, "backend", "raw CDR bytes"),
            part(x, 208, width, "codec", "one pass, checked"),
        ]
        parts += [channel(x, 308, name, newest, width), part(x, 432, width, block, what)]
        for above, below in ((56, 120), (176, 208), (264, 308), (364, 432)):
            ends = (above, below - 2) if x == down else (below, above + 2)
            parts.append(stroke(f"M{x + width / 2:g} {ends[0]:g}V{ends[1]:g}"))
    return picture(TITLE, 0, 360, 528, parts)


DRAWINGS = {"path.svg": image, "path-narrow.svg": narrow}

if __name__ == "__main__":
    write(DRAWINGS)
