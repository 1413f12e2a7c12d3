"""Write the test vectors of channels: regions/, hostile/, calls/, names.json and sequences.json.

    python spec/vectors/generate_regions.py            write
    python spec/vectors/generate_regions.py --verify   compare with the existing files; 1 if they differ

The generator implements only the specification and does not use the product. Its output is reproducible.
A ``.bin`` ends with the last nonzero byte of the object; ``size`` is the object's full size.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import call_cases
import hostile_cases
import name_cases
import region_cases
from region_image import Image

__all__ = ["generate", "main"]

HERE = Path(__file__).parent


def _json(value: dict[str, Any]) -> bytes:
    return (json.dumps(value, ensure_ascii=False, indent=1) + "\n").encode()


def _pair(folder: str, name: str, image: Image, members: dict[str, Any]) -> Iterator[tuple[str, bytes]]:
    size = members.get("size", len(image.data))
    yield f"{folder}/{name}.bin", bytes(image.data[:size]).rstrip(b"\0")
    yield f"{folder}/{name}.json", _json({"image": f"{name}.bin", "size": size, **members})


def _all() -> Iterator[tuple[str, bytes]]:
    for name, about, image, readings, more in region_cases.cases():
        members = {
            "about": about,
            **more,
            "identity": image.identity(),
            "description": image.description,
            "head": int.from_bytes(image.data[128:132], "little"),
            "readings": readings,
        }
        yield from _pair("regions", name, image, members)
    for name, about, image, members in hostile_cases.images():
        yield from _pair("hostile", name, image, {"about": about, **members})
    for name, about, image, readings in hostile_cases.scribbled():
        yield from _pair("hostile", f"scribbled-{name}", image, {"about": about, "readings": readings})
    for name, error in (("missing", 101), ("link", 121), ("directory", 121), ("pipe", 121)):
        members = {
            "about": "what stands at the name is no plain file",
            "file": name,
            "error": error,
            "expect": {},
        }
        yield f"hostile/file-{name}.json", _json(members)
    for name, image, members in call_cases.cases():
        yield from _pair("calls", name, image, members)
    yield "names.json", _json(name_cases.names())
    yield "sequences.json", _json(name_cases.sequences())


def generate() -> dict[str, bytes]:
    """Return every file's name and content."""
    files: dict[str, bytes] = {}
    for name, content in _all():
        if name in files:
            raise ValueError(f"two vectors are called {name}")
        files[name] = content
    return files


def _present() -> dict[str, bytes]:
    folders = ("regions", "hostile", "calls")
    paths = [path for folder in folders for path in HERE.glob(f"{folder}/*")]
    paths += [HERE / "names.json", HERE / "sequences.json"]
    return {path.relative_to(HERE).as_posix(): path.read_bytes() for path in paths if path.is_file()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Write or verify; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--verify", action="store_true", help="compare, write nothing")
    verify = parser.parse_args(arguments).verify
    wanted, present = generate(), _present()
    different = sorted(name for name in {*wanted, *present} if wanted.get(name) != present.get(name))
    if verify:
        for name in different:
            print(f"{name}: differs from what is generated", file=sys.stderr)
        return 1 if different else 0
    for name in different:
        if name in wanted:
            (HERE / name).parent.mkdir(exist_ok=True)
            (HERE / name).write_bytes(wanted[name])
        else:
            (HERE / name).unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
