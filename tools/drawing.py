"""What the drawings of the documentation are made of: SVG that is readable on light and dark pages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
STYLE = """\
text { font: 14px system-ui, -apple-system, "Segoe UI", sans-serif; fill: #1f2328; text-anchor: middle }
.small { font-size: 12px; fill: #59636e }
.mono { font: 12px ui-monospace, "DejaVu Sans Mono", monospace; fill: #59636e }
.bold { font-weight: 600 }
.pin { font: 11px ui-monospace, "DejaVu Sans Mono", monospace }
.pin.bold { font-weight: 600; font-size: 12px }
.dim { fill: #59636e }
.on { fill: #1f2328 }
.left { text-anchor: start }
.right { text-anchor: end }
.page { fill: #ffffff }
.area { fill: none; stroke: #8c959f; stroke-dasharray: 5 4 }
.box { fill: #f6f8fa; stroke: #59636e }
.shm { fill: #ddf4ff; stroke: #0969da }
.slot { fill: #ffffff; stroke: #0969da }
.full { fill: #54aeff; stroke: #0969da }
.good { fill: #dafbe1; stroke: #1a7f37 }
.busy { fill: #fff1c2; stroke: #9a6700 }
.bad { fill: #ffebe9; stroke: #cf222e }
.line { stroke: #8c959f; fill: none }
.arrow { stroke: #1f2328; stroke-width: 1.6; fill: none; marker-end: url(#head) }
#head path { fill: #1f2328 }
@media (prefers-color-scheme: dark) {
  text { fill: #f0f6fc }
  .small, .mono, .dim { fill: #9198a1 }
  .on { fill: #f0f6fc }
  .page { fill: #0d1117 }
  .area, .line { stroke: #656c76 }
  .box { fill: #151b23; stroke: #9198a1 }
  .shm { fill: #0c2d6b; stroke: #4493f8 }
  .slot { fill: #0d1117; stroke: #4493f8 }
  .full { fill: #1f6feb; stroke: #4493f8 }
  .good { fill: #0f2d1a; stroke: #3fb950 }
  .busy { fill: #332600; stroke: #d29922 }
  .bad { fill: #3c1618; stroke: #f85149 }
  .arrow { stroke: #f0f6fc }
  #head path { fill: #f0f6fc }
}
"""


def text(x: float, y: float, content: str, kind: str = "") -> str:
    """Return a line of text, centred on x unless its kind says ``left`` or ``right``."""
    content = content.replace("&", "&amp;").replace("<", "&lt;")
    return f'<text x="{x:g}" y="{y:g}" class="{kind}">{content}</text>'


def box(x: float, y: float, width: float, height: float, kind: str = "box", radius: float = 6) -> str:
    """Return a rectangle with round corners."""
    return f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="{radius:g}" class="{kind}"/>'


def stroke(commands: str, kind: str = "arrow") -> str:
    """Return a line along SVG's path commands, with an arrow's head at its end."""
    return f'<path d="{commands}" class="{kind}"/>'


def picture(
    title: str, top: float, width: float, bottom: float, parts: list[str], scale: float | None = None
) -> str:
    """Return a whole picture from ``top`` to ``bottom``; the title is what a screen reader says.

    ``scale`` gives it a size; without, it is as wide as the page.
    """
    size = f'width="{scale * width:.0f}" height="{scale * (bottom - top):.0f}" ' if scale else ""
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}'
        f'viewBox="0 {top:g} {width:g} {bottom - top:g}" role="img" '
        'aria-labelledby="t">',
        f'<title id="t">{title}</title>',
        f"<style>\n{STYLE}</style>",
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="11" markerHeight="11" '
        'markerUnits="userSpaceOnUse" orient="auto"><path d="M0 0 8 4 0 8z"/></marker></defs>',
        # a ground of its own: a page may be dark where the reader's system is light
        f'<rect y="{top:g}" width="{width:g}" height="{bottom - top:g}" rx="6" class="page"/>',
        *parts,
        "</svg>\n",
    ]
    return "\n".join(lines)


def write(drawings: Mapping[str, Callable[[], str]]) -> None:
    """Write pictures under their names into docs/images."""
    for name, draw in drawings.items():
        (IMAGES / name).write_text(draw(), encoding="utf-8")
