"""Write docs/images/path.svg: the path of a message, readable on light and dark pages."""

from __future__ import annotations

from pathlib import Path

IMAGE = Path(__file__).resolve().parent.parent / "docs" / "images" / "path.svg"
WIDTH, HEIGHT = 960, 336
STYLE = """\
text { font: 14px system-ui, -apple-system, "Segoe UI", sans-serif; fill: #1f2328; text-anchor: middle }
.small { font-size: 12px; fill: #59636e }
.mono { font: 12px ui-monospace, "DejaVu Sans Mono", monospace; fill: #59636e }
.bold { font-weight: 600 }
.page { fill: #ffffff }
.area { fill: none; stroke: #8c959f; stroke-dasharray: 5 4 }
.box { fill: #f6f8fa; stroke: #59636e }
.shm { fill: #ddf4ff; stroke: #0969da }
.slot { fill: #ffffff; stroke: #0969da }
.full { fill: #54aeff; stroke: #0969da }
.arrow { stroke: #1f2328; stroke-width: 1.6; fill: none; marker-end: url(#head) }
#head path { fill: #1f2328 }
@media (prefers-color-scheme: dark) {
  text { fill: #f0f6fc }
  .small, .mono { fill: #9198a1 }
  .page { fill: #0d1117 }
  .area { stroke: #656c76 }
  .box { fill: #151b23; stroke: #9198a1 }
  .shm { fill: #0c2d6b; stroke: #4493f8 }
  .slot { fill: #0d1117; stroke: #4493f8 }
  .full { fill: #1f6feb; stroke: #4493f8 }
  .arrow { stroke: #f0f6fc }
  #head path { fill: #f0f6fc }
}
"""


def text(x: float, y: float, content: str, kind: str = "") -> str:
    """Return a line of text centred on x."""
    return f'<text x="{x:g}" y="{y:g}" class="{kind}">{content}</text>'


def box(x: float, y: float, width: float, height: float, kind: str = "box") -> str:
    """Return a rectangle with round corners."""
    return f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="6" class="{kind}"/>'


def part(x: float, y: float, width: float, title: str, subtitle: str) -> str:
    """Return a box that names one part and what it does."""
    middle = x + width / 2
    return (
        box(x, y, width, 56) + text(middle, y + 24, title, "bold") + text(middle, y + 43, subtitle, "small")
    )


def channel(x: float, y: float, name: str, newest: int) -> str:
    """Return an object in shared memory: its name, its slots, the newest one filled."""
    slots = "".join(
        f'<rect x="{x + 20 + 38 * i:g}" y="{y + 27:g}" width="34" height="18" '
        f'class="{"full" if i == newest else "slot"}"/>'
        for i in range(4)
    )
    return box(x, y, 188, 56, "shm") + text(x + 94, y + 18, name, "mono") + slots


def arrow(x1: float, x2: float, y: float) -> str:
    """Return a horizontal arrow."""
    return f'<path d="M{x1:g} {y:g}H{x2:g}" class="arrow"/>'


def image() -> str:
    """Return the whole picture."""
    down, up = 96, 212
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 24 {WIDTH} {HEIGHT - 24}" role="img" '
        'aria-labelledby="t">',
        '<title id="t">A message goes from ROS through the bridge and a channel in shared memory into the '
        "PLC's scan cycle, and back the same way.</title>",
        f"<style>\n{STYLE}</style>",
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" '
        'orient="auto"><path d="M0 0 8 4 0 8z"/></marker></defs>',
        # a ground of its own: a page may be dark where the reader's system is light
        f'<rect y="24" width="{WIDTH}" height="{HEIGHT - 24}" rx="6" class="page"/>',
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
        "</svg>\n",
    ]
    return "\n".join(parts)


if __name__ == "__main__":
    IMAGE.write_text(image(), encoding="utf-8")
