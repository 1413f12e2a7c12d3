"""Objects of services and actions (section 11): what is in them, and which are refused."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import Any

from region_image import Image

__all__ = ["cases"]

KINDS = {"request": 0x0102, "response": 0x0202, "goal": 0x0103, "result": 0x0203, "feedback": 0x0303}
LETTERS = {"request": "sq", "response": "sr", "goal": "ag", "result": "ar", "feedback": "af"}
IDS = {
    "request": "0123456789abcdef",
    "response": "1123456789abcdef",
    "goal": "2123456789abcdef",
    "result": "3123456789abcdef",
    "feedback": "4123456789abcdef",
}
CLIENT = bytes(range(0xC0, 0xD0))


def _image(part: str, server: str, client: str = "", changed: dict[str, Any] | None = None) -> Image:
    family = ("request", "response") if KINDS[part] & 0xFF == 2 else ("goal", "result", "feedback")
    to_plc = (part in ("request", "goal")) == (server == "plc")
    members = {
        "kind": "service" if len(family) == 2 else "action",
        "part": part,
        "client": client,
        "partners": {other: IDS[other] for other in family if other != part},
        "layout_id": IDS[part],
        **(changed or {}),
    }
    notes = 2112 if to_plc and part == "goal" else 0
    members |= {"notes": notes} if notes else {}
    image = Image(direction=1 if to_plc else 2, description=members, behind=notes)
    image.data[64:72] = bytes.fromhex(IDS[part])
    return image.set(kind=KINDS[part])


def _message(image: Image, sequence: int, status: int, *, number: int, reason: int = 0) -> dict[str, Any]:
    """Publish a message of a call and return what a reader must find."""
    words = [int.from_bytes(CLIENT[at : at + 4], "little") for at in range(0, 16, 4)]
    image.publish(sequence).slot(
        sequence % 4, status=status, correlation_lo=number, correlation_hi=0xE0E0, reason=reason,
        **{f"client{at}": word for at, word in enumerate(words)},
    )  # fmt: skip
    more = {"status": status, "client": CLIENT.hex(), "reason": reason}
    return image.message(sequence) | {"correlation": 0xE0E0 << 32 | number} | more


def _note(image: Image, index: int, number: int, uuid: bytes, note: bytes, crc: int = 0) -> None:
    """Write an entry of the table behind the slots; ``crc`` is added to the right one."""
    head, name = struct.pack("<II", number, len(note)), bytes(4) + uuid + note
    entry = head + struct.pack("<I", (zlib.crc32(head + name) + crc) & 0xFFFFFFFF) + name
    at = len(image.data) - 2112 + index * 1056
    image.data[at : at + len(entry)] = entry


def _noted() -> Iterator[tuple[str, Image, dict[str, Any]]]:
    """Yield what a bridge has left about its goal (section 11.6)."""
    text = b"text of more than 16 bytes"
    for name, about, first, second, wanted in (
        ("newer", "the entry with the higher number counts", (2, b"old", 0), (3, b"new!!", 0), b"new!!"),
        ("first", "one entry is empty", (2, text, 0), (0, b"", 0), text),
        ("torn", "the newer entry was not completed", (4, b"whole", 0), (5, b"torn", 1), b"whole"),
        ("long", "the newer entry names more than there is", (6, bytes(1025), 0), (5, b"whole", 0), b"whole"),
    ):  # fmt: skip
        image = _image("goal", "plc")
        _message(image, 1, 1, number=7)
        for index, (number, note, crc) in enumerate((first, second)):
            if number:
                _note(image, index, number, CLIENT, note, crc)
        yield f"notes-{name}", image, _vector("goal", image, about, uuid=CLIENT.hex(), note=wanted.hex())


def _vector(part: str, image: Image, about: str, client: str = "", **members: Any) -> dict[str, Any]:
    suffix = f"-{client}" if client else ""
    return {
        "about": about,
        "object": f"rosplc.{LETTERS[part]}.v{suffix}",
        "open": {"topic": "/v", "part": part, "client": client},
        **members,
    }


def cases() -> Iterator[tuple[str, Image, dict[str, Any]]]:
    """Yield name, image and members."""
    statuses = {
        "request": [1, 9],
        "response": [1, 2],
        "goal": [1, 3],
        "result": [5, 1030],
        "feedback": [5, 5],
    }
    for server in ("plc", "ros"):
        for part, values in statuses.items():
            client = "left" if server == "ros" and part in ("request", "response") else ""
            image = _image(part, server, client)
            messages = [
                _message(image, at + 1, status, number=7, reason=3 if status == 2 else 0)
                for at, status in enumerate(values)
            ]
            yield (
                f"{part}-{server}",
                image,
                _vector(
                    part, image, f"the {part} of a server in {server.upper()}", client,
                    identity=image.identity() | {"kind": KINDS[part]},
                    description=image.description, head=2, messages=messages,
                ),
            )  # fmt: skip
    for part, other in (("request", "response"), ("goal", "request"), ("feedback", "result")):
        image = _image(other, "plc")
        yield (
            f"refused-{other}-as-{part}",
            image,
            _vector(part, image, f"a {other} at the name of a {part}", error=110),
        )
    image = Image()
    yield "refused-topic", image, _vector("request", image, "a topic's object at a request's name", error=110)
    for name, changed in {
        "kind": {"kind": "action"},
        "part": {"part": "response"},
        "client-a-number": {"client": 1},
        "partners-a-list": {"partners": []},
        "partners-without-digits": {"partners": {"response": "layout"}},
    }.items():
        image = _image("request", "plc", changed=changed)
        about = f"the self-description's {name.replace('-', ' ')} is wrong"
        yield f"refused-description-{name}", image, _vector("request", image, about, error=113)
    for name, partners in {"other": {"response": "ff" * 8}, "missing": {}, "more": {
        "response": IDS["response"], "result": IDS["result"],
    }}.items():  # fmt: skip
        image = _image("request", "plc", changed={"partners": partners})
        about = "it does not name its partner's layout id: tools refuse the two together"
        yield f"pair-{name}", image, _vector("request", image, about, partner="response-plc", error=112)
    yield from _noted()
    image = _image("request", "plc")
    yield "pair-right", image, _vector("request", image, "the two belong together", partner="response-plc")
