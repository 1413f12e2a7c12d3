#!/usr/bin/env python3
"""Writes spec/vectors/layouts/*.json, or compares them with what it would write (--verify).

This is a second implementation of spec/type-mapping.md, written from the text of the
specification and sharing no code with the package: a reader of .msg text, the layout
algorithm, the layout text with its id, and a writer of records. It favours being short over
being fast or friendly: it trusts the cases in layout_cases.py.

Each vector holds

* ``type``, ``definition``, ``ros_version``, ``limits``: the input;
* ``text``, ``layout_id``, ``layout_id_words``, ``size``, ``align``: the layout;
* ``initial``: the record of a message with default values, in hexadecimal digits;
* ``values``: value ↔ record pairs; packing gives the record, reading it gives ``reads``, or
  the value itself where ``reads`` is missing;
* ``readings``: records that a faulty writer may leave, and the values that a reader reads from them.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import struct
import sys
from pathlib import Path

from layout_cases import CASES, SIZES, TIME

FOLDER = Path(__file__).parent / "layouts"
CODES = dict(zip(SIZES, "?BBbBhHiIqQfd", strict=True))


# --- definitions -------------------------------------------------------------------------


def read_definition(type_name, text):
    """Return {full name: [(field name, element, kind, number, default text)]}."""
    types = {}
    sections = ("MSG: " + type_name + "\n" + text).split("=" * 80 + "\n")
    for section in sections:
        head, _, body = section.partition("\n")
        name = head.removeprefix("MSG: ").replace("/msg/", "/")
        package = name.split("/")[0]
        types[name] = fields = []
        for line in body.splitlines():
            line = line.strip()
            if not line or line.startswith("#") or re.match(r"\S+\s+\w+\s*=", line):
                continue
            type_text, field, *default = line.split(None, 2)
            element, kind, number = re.fullmatch(r"(.*?)(?:(\[(?:<=)?)(\d*)\])?", type_text).groups()
            if element in ("time", "duration"):
                element = "builtin_interfaces/" + element.capitalize()
            elif element == "Header":
                element = "std_msgs/Header"
            elif element not in SIZES and not element.startswith("string") and "/" not in element:
                element = package + "/" + element
            element = element.replace("/msg/", "/")
            kind = {None: "one", "[<=": "sequence", "[": "array" if number else "sequence"}[kind]
            fields.append((field, element, kind, int(number) if number else None, *default))
    for builtin in ("builtin_interfaces/Time", "builtin_interfaces/Duration"):
        if builtin not in types and any(f[1] == builtin for fs in types.values() for f in fs):
            types |= read_definition(builtin, TIME)
    return types


# --- layout ------------------------------------------------------------------------------


class Layout:
    """One pass over the definition: sizes by recursion, then lines with absolute offsets."""

    def __init__(self, type_name, text, limits):
        self.types = read_definition(type_name, text)
        self.limits = limits
        self.name = type_name.replace("/msg/", "/")
        self.size, self.align = self.measure(self.name, "")
        package, short = self.name.split("/")
        lines = ["rosplc-layout 1", f"{package}/msg/{short} size {self.size} align {self.align}"]
        lines += [f"{offset} {path} {what}" for offset, path, what in self.lines(self.name, 0, "")]
        self.text = "\n".join(lines) + "\n"
        digest = hashlib.sha256(self.text.encode()).digest()
        self.layout_id = digest[:8].hex()
        self.words = list(struct.unpack("<II", digest[:8]))

    def capacity(self, path, bound, default):
        if path in self.limits.get("fields", {}):
            return self.limits["fields"][path]
        return min(default, bound) if bound else default

    def string_capacity(self, path, element):
        bound = int(element[len("string<=") :]) if "<=" in element else None
        return self.capacity(path, bound, self.limits.get("string", 80))

    def element_size(self, element, path):
        """Return size and alignment of one element at a path."""
        if element in SIZES:
            return SIZES[element], SIZES[element]
        if element.startswith("string"):
            return self.string_capacity(path, element) + 1, 1
        return self.measure(element, path + ".")

    def parts(self, type_name, prefix):
        """Yield (what, field, path, size, align, count) of everything a struct places."""
        for field in self.types[type_name]:
            name, element, kind, number = field[:4]
            path = prefix + name
            if kind == "one":
                yield ("one", field, path, *self.element_size(element, path), 1)
                continue
            size, align = self.element_size(element, path + "[]")
            count = number
            if kind == "sequence":
                count = self.capacity(path, number, self.limits.get("sequence", 16))
                yield "count", field, path, 4, 4, count
            yield kind, field, path, size * count, align, count

    def measure(self, type_name, prefix):
        end, largest = 0, 1
        for *_, size, align, _ in self.parts(type_name, prefix):
            end = (end + align - 1) // align * align + size
            largest = max(largest, align)
        return max(1, (end + largest - 1) // largest * largest), largest

    def lines(self, type_name, base, prefix):
        end = base
        for what, field, path, size, align, count in self.parts(type_name, prefix):
            # `base` is aligned for the struct, so absolute offsets can be rounded as well.
            start = (end + align - 1) // align * align
            if start > end:
                yield end, "-", f"padding({start - end})"
            end = start + size
            element = field[1]
            if what == "count":
                yield start, path, f"count({count})"
                continue
            if what != "one":
                yield start, path, f"{what}({count},{size // count})"
                path += "[]"
            if element in SIZES:
                yield start, path, element
            elif element.startswith("string"):
                yield start, path, f"string({self.string_capacity(path, element)})"
            else:
                yield from self.lines(element, start, path + ".")
        total = self.measure(type_name, prefix)[0]
        if base + total > end:
            yield end, "-", f"padding({base + total - end})"

    # --- records ---------------------------------------------------------------------------

    def record(self, value, type_name=None, prefix=""):
        """Return a struct's bytes; fields that ``value`` lacks take their default."""
        type_name = type_name or self.name
        data = bytearray(self.measure(type_name, prefix)[0])
        end = 0
        for what, field, path, size, align, count in self.parts(type_name, prefix):
            start = end = (end + align - 1) // align * align
            end += size
            name, element = field[:2]
            # The cases write their default values as JSON does.
            default = json.loads(field[4]) if len(field) > 4 else None
            given = value.get(name, default)
            if what == "count":
                data[start:end] = struct.pack("<I", len(given or []))
            elif what == "one":
                data[start:end] = self.element(given, element, path)
            else:
                each = size // count
                if given is None:
                    given = [None] * count if what == "array" else []
                for index, item in enumerate(given):
                    data[start + index * each : start + (index + 1) * each] = self.element(
                        item, element, path + "[]"
                    )
        return bytes(data)

    def element(self, value, element, path):
        if element in SIZES:
            return struct.pack("<" + CODES[element], 0 if value is None else value)
        if element.startswith("string"):
            return (value or "").encode().ljust(self.string_capacity(path, element) + 1, b"\0")
        return self.record(value or {}, element, path + ".")

    def offset_of(self, path, what=""):
        """Return the offset of the line with this path whose description starts with ``what``."""
        for offset, found, description in self.lines(self.name, 0, ""):
            if found == path and description.startswith(what):
                return offset
        raise KeyError(path)


# --- vectors ----------------------------------------------------------------------------


def readings(name, layout):
    """Yield (what, record, value fields) of records that break the writer's rules."""
    if name == "strings":
        data = bytearray(layout.record({"plain": "x" * 20}))
        data[layout.offset_of("plain") + 20] = ord("y")
        yield "a string without a NUL has its full capacity", data, {"plain": "x" * 20}
        data = bytearray(layout.record({"plain": "one"}))
        data[layout.offset_of("plain") + 4] = ord("z")
        yield "bytes after the NUL are ignored", data, {"plain": "one"}
    if name == "sequences":
        data = bytearray(layout.record({"c": [1.0, 2.0]}))
        struct.pack_into("<I", data, layout.offset_of("c", "count"), 0xFFFFFFFF)
        yield "a count above the capacity reads as the capacity", data, {"c": [1.0, 2.0]}
        data = bytearray(layout.record({"a": [1, 2, 3]}))
        struct.pack_into("<I", data, layout.offset_of("a", "count"), 1)
        yield "elements after the count are ignored", data, {"a": [1]}
    if name == "primitives":
        data = bytearray(layout.record({}))
        data[layout.offset_of("bool_value")] = 0xFE
        yield "every bool but 0 counts as 1", data, {"bool_value": True}
    if name == "padding_everywhere":
        data = bytearray(layout.record({}))
        for offset, path, what in layout.lines(layout.name, 0, ""):
            if path == "-":
                for index in range(int(what[8:-1])):
                    data[offset + index] = 0xA5
        yield "padding is ignored", data, {"a": False, "b": 0.0, "i": 0}


def vector(name, case):
    """Return one vector as the text of its file."""
    layout = Layout(case["type"], case["definition"], case.get("limits", {}))
    assert layout.size == len(layout.record({}))
    full = {"string": 80, "sequence": 16, "fields": {}} | case.get("limits", {})
    content = {
        "vector": name,
        "type": case["type"].replace("/", "/msg/"),
        "ros_version": case.get("ros_version", 2),
        "definition": case["definition"],
        "limits": full,
        "text": layout.text,
        "layout_id": layout.layout_id,
        "layout_id_words": layout.words,
        "size": layout.size,
        "align": layout.align,
        "initial": layout.record({}).hex(),
        "values": [{"value": value, "record": layout.record(value).hex()} for value in case["values"]],
        "readings": [
            {"what": what, "record": data.hex(), "reads": value}
            for what, data, value in readings(name, layout)
        ],
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--verify", action="store_true", help="compare, do not write; exit code 1 if they differ"
    )
    verify = parser.parse_args().verify
    FOLDER.mkdir(exist_ok=True)
    wrong = {file.stem for file in FOLDER.glob("*.json")} - CASES.keys()
    for name, case in CASES.items():
        file, content = FOLDER / f"{name}.json", vector(name, case)
        if verify:
            wrong |= {name} if not file.is_file() or file.read_text(encoding="utf-8") != content else set()
        else:
            file.write_text(content, encoding="utf-8")
    if wrong:
        print(f"these vectors are not what the generator writes: {', '.join(sorted(wrong))}", file=sys.stderr)
        return 1
    print(f"{len(CASES)} layout vectors {'verified' if verify else 'written'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
