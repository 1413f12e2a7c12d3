"""Write docs/reference/errors.md from the codes in rosplc.errors; ``--verify`` only compares."""

from __future__ import annotations

from generated_page import REFERENCE, filled, run
from rosplc.errors import CODES, RosplcError

PAGE = REFERENCE / "errors.md"
TITLES = {
    "TYP": "Message types",
    "LAY": "Layouts",
    "COD": "Conversion",
    "SHM": "Channels in shared memory",
    "CFG": "Configuration",
    "ROS": "The ROS side",
    "PLC": "The PLC's code",
    "REC": "Recordings",
    "WEB": "The page in a browser",
    "SYS": "The machine",
}


def parts() -> dict[str, str]:
    """Return the page's generated part."""
    found = []
    classes = {cls.family: cls for cls in RosplcError.__subclasses__()}
    for family, title in TITLES.items():
        cls = classes[family]
        description = (cls.__doc__ or "").strip().splitlines()[0]
        found.append(f"## {title}\n\n`{cls.__name__}`: {description}\n")
        for code, info in sorted(CODES.items()):
            if code.startswith(family):
                found.append(f"### {code}\n\n**{info.title[0].upper()}{info.title[1:]}.** {info.remedy}\n")
    return {"codes": "\n".join(found)}


if __name__ == "__main__":
    raise SystemExit(run(__doc__, {PAGE: filled(PAGE, parts())}))
