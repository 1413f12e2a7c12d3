"""Write docs/reference/errors.md from the codes in rosplc.errors; ``--verify`` only compares."""

from __future__ import annotations

from generated_page import REFERENCE, filled, run
from rosplc.errors import (
    CODES,
    BackendError,
    ChannelError,
    CodecError,
    ConfigError,
    GenerationError,
    LayoutError,
    MessageTypeError,
    RecordingError,
    RosplcError,
    SetupError,
    WebError,
)

PAGE = REFERENCE / "errors.md"
FAMILIES: tuple[tuple[str, type[RosplcError]], ...] = (
    ("Message types", MessageTypeError),
    ("Layouts", LayoutError),
    ("Conversion", CodecError),
    ("Channels in shared memory", ChannelError),
    ("Configuration", ConfigError),
    ("The ROS side", BackendError),
    ("The PLC's code", GenerationError),
    ("Recordings", RecordingError),
    ("The page in a browser", WebError),
    ("The machine", SetupError),
)


def parts() -> dict[str, str]:
    """Return the page's generated part."""
    found = []
    for title, cls in FAMILIES:
        description = (cls.__doc__ or "").strip().splitlines()[0]
        found.append(f"## {title}\n\n`{cls.__name__}`: {description}\n")
        for code, info in sorted(CODES.items()):
            if code.startswith(cls.family):
                found.append(f"### {code}\n\n**{info.title[0].upper()}{info.title[1:]}.** {info.remedy}\n")
    return {"codes": "\n".join(found)}


if __name__ == "__main__":
    raise SystemExit(run(__doc__, {PAGE: filled(PAGE, parts())}))
