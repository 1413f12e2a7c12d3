"""Write docs/reference/doctor.md from the table in rosplc.doctor.kinds; ``--verify`` only compares."""

from __future__ import annotations

from generated_page import REFERENCE, filled, run
from rosplc.doctor import KINDS, Area

PAGE = REFERENCE / "doctor.md"


def parts() -> dict[str, str]:
    """Return the page's generated part."""
    found = []
    for area in Area:
        found.append(f"## {area.value[0].upper()}{area.value[1:]}\n")
        for code, kind in sorted(KINDS.items()):
            if kind.area is area:
                title = f"{kind.title[0].upper()}{kind.title[1:]}"
                found.append(f"### {code}\n\n**{title}** ({kind.level.word}). {kind.meaning}\n")
                found.append(f"What to do: {kind.remedy}\n")
    return {"findings": "\n".join(found)}


if __name__ == "__main__":
    raise SystemExit(run(__doc__, {PAGE: filled(PAGE, parts())}))
