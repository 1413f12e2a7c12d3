"""A PLC whose program is C: blocks of rosplc/plc.h, with the interface of :mod:`rosplc_st.machine`."""

from __future__ import annotations

import ctypes
import os
import struct
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import rosplc
from rosplc.layout import Layout
from rosplc_st.machine import Counters
from tests.verification.plc_cell import READ, TOPICS, TWIST, WRITE, layout_of

LANGUAGES = {"C11": ["gcc", "-std=c11"], "C++17": ["g++", "-std=c++17", "-x", "c++"]}
_ON_STALE = {"hold": 0, "zero": 1, "value": 2}
_FENCE = '({extern void at_fence(void) __asm__("c_fence"); at_fence();})'
_WRAPPED = ("open", "mmap", "munmap")


@lru_cache
def library(language: str) -> bytes:
    """Return a shared library of plc.c and c_plc.c."""
    include = rosplc.include_dir()
    sources = [str(include / "rosplc" / "plc.c"), str(Path(__file__).with_name("c_plc.c"))]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plc.so"
        options = [
            "-O1",
            "-g",
            "-Wall",
            "-Wextra",
            "-Werror",
            "-shared",
            "-fPIC",
            f"-I{include}",
            "-o",
            str(path),
        ]
        command = [*LANGUAGES[language], *options, *sources]
        command += [f"-Wl,--wrap={name}" for name in _WRAPPED]
        command += [f"-DROSPLC_F{n}({'size' * (n in (5, 6))})={_FENCE}" for n in range(1, 9)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return path.read_bytes()


def loaded(language: str) -> ctypes.CDLL:
    """Return the library with a state of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plc.so"
        path.write_bytes(library(language))
        found = ctypes.CDLL(str(path), mode=os.RTLD_LOCAL | os.RTLD_NOW)
    for name in ("block", "variable", "record", "use", "use_variable", "use_record"):
        getattr(found, f"c_{name}").restype = ctypes.c_void_p
    return found


class CMachine:
    """Blocks of plc.h for the topics of the cell; see :class:`rosplc_st.machine.Machine`."""

    def __init__(self, language: str, directory: str) -> None:
        self._library = loaded(language)
        self._library.c_start(directory.encode(), b"rosplc")
        self._blocks: dict[str, ctypes.c_void_p] = {}
        self._topics = {
            f"ROS_{given['direction'].capitalize()}.{topic.strip('/')}": (topic, given, layout_of(TWIST))
            for topic, given in TOPICS.items()
        }
        self._time = 0
        self._consumed: list[float] = []

    def add(self, path: str, topic: str, words: tuple[int, int], size: int) -> None:
        """Make a reading block of any layout."""
        self._blocks[path] = ctypes.c_void_p(
            self._library.c_block(topic.encode(), 1, *map(ctypes.c_uint32, (*words, size)))
        )

    def start(self) -> None:
        """Start the program with initial values; one that was not stopped is forgotten, as after a crash."""
        self._blocks = {path: self._made(*about) for path, about in self._topics.items()}
        for path, (_, given, layout) in self._topics.items():
            self.set(f"{path}.udiBeatMs", 250)
            if given["direction"] == "read":
                self.set(f"{path}.tStaleAfter", given.get("stale_after_ns", 0) // 1_000_000)
                self.set(f"{path}.uiOnStale", _ON_STALE[given.get("on_stale", "hold")])
                self.set(f"{path}.xInOrder", given.get("in_order", False))
                self.set(f"{path}.xLatched", given.get("latched", False))
                self.write(f"{path}.stSafe", bytes(layout.pack(given.get("safe", {}))))

    def _made(self, topic: str, given: dict[str, Any], layout: Layout) -> ctypes.c_void_p:
        words = map(ctypes.c_uint32, (*layout.layout_id_words, layout.size))
        reads = int(given["direction"] == "read")
        return ctypes.c_void_p(self._library.c_block(topic.encode(), reads, *words))

    def stop(self) -> None:
        """End the program: every block gives back what it holds."""
        for block in self._blocks.values():
            self._library.c_end(block)
        self._blocks = {}

    def set_time(self, milliseconds: int) -> None:
        """Set the clock that the blocks are given."""
        self._time = milliseconds & 0xFFFFFFFF

    def counters(self) -> Counters:
        """Return what was opened and closed."""
        found = {
            name: ctypes.c_uint32.in_dll(self._library, name).value for name in ("opens", "opened", "closes")
        }
        return Counters(found, open_handles=found["opened"] - found["closes"])

    def scan(self, *programs: str, count: int = 1, step: int = 10) -> None:
        """Call the blocks of programs ``count`` times, the clock advancing by ``step`` ms before each."""
        for _ in range(count):
            self.set_time(self._time + step)
            for program in programs:
                if program == "Consume":
                    self._consume()
                    continue
                if program != WRITE:
                    self._library.c_new_scan()
                start = {READ: "ROS_Read", WRITE: "ROS_Write"}.get(program, program)
                for path, block in self._blocks.items():
                    if path.startswith(start):
                        self._library.c_call(block, ctypes.c_uint32(self._time))

    def _consume(self) -> None:
        path = "ROS_Read.in_order"
        self._consumed = []
        more = self.get(f"{path}.xNew")
        while more:
            self._consumed.append(struct.unpack_from("<d", self.read(f"{path}.msg"))[0])
            more = self._library.c_next(self._blocks[path], ctypes.c_uint32(self._time))

    def _place(self, path: str) -> Any:
        block, _, name = path.rpartition(".")
        address = self._library.c_variable(self._blocks[block], name.encode())
        assert address, f"a block of plc.h has no {name}"
        return ctypes.c_uint32.from_address(address)

    def get(self, path: str) -> Any:
        """Return a variable, by the name that the generated blocks have for it."""
        if path == "Consume.uiCount":
            return len(self._consumed)
        if path.startswith("Consume.adValues["):
            return self._consumed[int(path[17:-1])]
        value = self._place(path).value
        return bool(value) if path.rpartition(".")[2].startswith("x") else value

    def set(self, path: str, value: Any) -> None:
        """Change a variable; a reader that begins with nothing is one whose ``udiLast`` is 0."""
        if path.endswith(".udiLast"):
            self.set(f"{path.removesuffix('udiLast')}xFreshReader", value == 0)
        if not path.endswith(".xPending"):  # the delayed rule is not for processors with fences
            self._place(path).value = int(value)

    def _record(self, path: str) -> tuple[int, int]:
        block, _, name = path.rpartition(".")
        return (
            self._library.c_record(self._blocks[block], name.encode()),
            self._place(f"{block}.udiWantSize").value,
        )

    def read(self, path: str) -> bytes:
        """Return a record: ``msg`` or ``stSafe``."""
        return ctypes.string_at(*self._record(path))

    def write(self, path: str, data: bytes) -> None:
        """Change a record."""
        ctypes.memmove(self._record(path)[0], data, len(data))

    def name_of(self, prefix: str, topic: str) -> str | None:
        """Return the name that a block derives; None: it is refused with 118."""
        name = ctypes.create_string_buffer(81)
        error = self._library.c_name(name, prefix.encode(), topic.encode())
        assert error in (0, 118)
        return None if error else name.value.decode()
