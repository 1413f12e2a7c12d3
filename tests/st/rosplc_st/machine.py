"""A PLC that runs translated Structured Text: scans, variables, clock, online change.

Two kinds with one interface: :class:`LibraryMachine` inside this process (ctypes), and
:class:`ProcessMachine`, a program of its own that can be killed, or run under qemu-user.
Used by the tests, and by :mod:`rosplc_st.run_project`.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import shutil
import signal
import struct
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

from rosplc_st.build import Build
from rosplc_st.translator.types import Array, Block, Elementary, List, Pointer, String, Struct, Type

__all__ = ["Counters", "LibraryMachine", "Machine", "ProcessMachine"]

_OPTIONS = (
    "round_pages", "check_size", "return_size", "cache_names", "real_clock",
    "sem_born_locked", "sem_failed", "sem_recursive", "sem_cache", "no_duplicate", "stop_inside",
)  # fmt: skip
_COUNTERS = (
    "opens", "opened", "closes", "creates", "deletes", "faults", "open_handles", "bad_handles", "barriers",
    "sem_creates", "sem_made", "sem_enters", "sem_timeouts", "sem_leaves", "sem_waited", "sem_endless",
)  # fmt: skip
_CALLS = {
    "start": ("st_start",), "stop": ("st_stop",), "change": ("st_online_change",),
    "power": ("st_forget", "st_warm_start"), "time": ("st_set_time",), "prefix": ("st_set_prefix",),
}  # fmt: skip
_STEP = re.compile(r"\.?(\w+)|\[(-?\d+)\]")
_CODES = {(8, True): "b", (8, False): "B", (16, True): "h", (16, False): "H", (32, True): "i",
          (32, False): "I", (64, True): "q", (64, False): "Q"}  # fmt: skip


class Counters(dict[str, int]):
    """What the stand-ins counted: calls, faults, open handles."""

    def __getattr__(self, name: str) -> int:
        return self[name]


class Machine:
    """What both kinds share: access to variables by their paths, as ``ROS_Read.cmd_vel.xNew``.

    Attributes:
        may_create: Whether the program may create memories, as classic blocks do.
    """

    def __init__(self, built: Build) -> None:
        self.program = built.translation.program
        self._globals: dict[str, tuple[int, int]] = {}
        self._members: dict[tuple[str, str], tuple[int, int]] = {}
        self._pointer = 8
        self._time = 0
        self.may_create = False

    # ---- what a kind provides

    def peek(self, address: int, size: int) -> bytes:
        """Return memory."""
        raise NotImplementedError

    def poke(self, address: int, data: bytes) -> None:
        """Change memory."""
        raise NotImplementedError

    def counters(self) -> Counters:
        """Return what the stand-ins counted."""
        raise NotImplementedError

    def last_fault(self) -> str:
        """Return where an index or divisor was wrong last."""
        raise NotImplementedError

    def _call(self, command: str, *arguments: int | str) -> None:
        """Have the runtime do one of :data:`_CALLS`, or ``scan``."""
        raise NotImplementedError

    # ---- what both do

    def start(self) -> None:
        """Start the program: initial values, then FB_Init(TRUE, FALSE)."""
        self._call("start")

    def stop(self) -> None:
        """End the program as a download does: FB_Exit(FALSE)."""
        self._call("stop")

    def online_change(self) -> None:
        """Move every instance: FB_Exit(TRUE), FB_Init(FALSE, TRUE), copy, FB_Reinit."""
        self._call("change")

    def power_cycle(self) -> None:
        """End the runtime and start it again: retained lists keep their values, FB_Init(FALSE, FALSE)."""
        self._call("power")

    def set_time(self, milliseconds: int) -> None:
        """Set what TIME() returns."""
        self._time = milliseconds & 0xFFFFFFFF
        self._call("time", self._time)

    def option(self, name: str, value: int = 1) -> None:
        """Switch one of the runtime's variations, a member of ``st_options``."""
        assert name in _OPTIONS
        self._call("option", name, value)

    def set_prefix(self, prefix: str) -> None:
        """Have a text put before every name of a memory or semaphore."""
        self._call("prefix", prefix)

    # ---- scans

    def scan(self, *programs: str, count: int = 1, step: int = 10) -> None:
        """Run programs ``count`` times, the clock advancing by ``step`` ms before each round.

        Raises:
            AssertionError: An index or divisor was wrong, or an object was created or deleted.
        """
        for _ in range(count if len(programs) > 1 else 1):
            self.set_time(self._time + step if len(programs) > 1 else self._time)
            for program in programs:
                one = len(programs) == 1
                self._call("scan", program.upper(), count if one else 1, step if one else 0)
        if len(programs) == 1:
            self._time = (self._time + step * count) & 0xFFFFFFFF
        self.check()

    def check(self) -> None:
        """Assert what holds for every program at all times."""
        counters = self.counters()
        assert counters.faults == 0, self.last_fault()
        assert counters.creates == 0 or self.may_create, "the program created an object"
        assert counters.sem_endless == 0, "the program waited without a limit"
        assert counters.deletes == 0, "the program deleted an object"
        assert counters.bad_handles == 0, "the program used an invalid handle"

    def advance(self, milliseconds: int) -> None:
        """Let time pass without a scan."""
        self.set_time(self._time + milliseconds)

    # ---- variables

    def find(self, path: str) -> tuple[int, Type]:
        """Return the address and type of a variable."""
        steps = list(_STEP.finditer(path))
        name = steps[0][1].upper()
        where, _size = self._globals[name]
        address = int.from_bytes(self.peek(where, self._pointer), "little")
        type_: Type = List(name) if name in self.program.lists else Block(name)
        for step in steps[1:]:
            address, type_ = self._step(address, type_, step)
        return address, type_

    def _step(self, address: int, type_: Type, step: re.Match[str]) -> tuple[int, Type]:
        if step[2] is not None:
            assert isinstance(type_, Array), step[0]
            return address + (int(step[2]) - type_.low) * self.size(type_.element), type_.element
        name = step[1].upper()
        if isinstance(type_, Struct):
            members = self.program.duts[type_.name].members
        elif isinstance(type_, Block):
            members = self.program.members(type_.name)
        else:
            assert isinstance(type_, List), step[0]
            members = self.program.lists[type_.name].variables
        declared = next(m for m in members if m.name == name)
        return address + self._members[type_.name, name][0], declared.type

    def size(self, type_: Type) -> int:
        """Return the bytes that a variable of a type takes."""
        if isinstance(type_, Elementary):
            return type_.bits // 8
        if isinstance(type_, String):
            return type_.length + 1
        if isinstance(type_, Pointer):
            return self._pointer
        if isinstance(type_, Array):
            return (type_.high - type_.low + 1) * self.size(type_.element)
        return self._members[type_.name, ""][1]

    def offset(self, owner: str, member: str) -> tuple[int, int]:
        """Return gcc's offset and size of a member of a structure; member "": the whole's."""
        return self._members[owner.upper(), member.upper()]

    def read(self, path: str) -> bytes:
        """Return a variable's bytes."""
        address, type_ = self.find(path)
        return self.peek(address, self.size(type_))

    def write(self, path: str, data: bytes) -> None:
        """Change a variable's bytes."""
        address, type_ = self.find(path)
        assert len(data) == self.size(type_), f"{path} has {self.size(type_)} bytes, not {len(data)}"
        self.poke(address, data)

    def get(self, path: str) -> Any:
        """Return an elementary variable or string."""
        address, type_ = self.find(path)
        data = self.peek(address, self.size(type_))
        if isinstance(type_, String):
            return data.split(b"\0")[0].decode("latin-1")
        if isinstance(type_, Pointer):
            return int.from_bytes(data, "little")
        assert isinstance(type_, Elementary), f"{path} is no elementary variable"
        value = struct.unpack("<" + self._code(type_), data)[0]
        return bool(value) if type_.kind == "bool" else value

    def set(self, path: str, value: Any) -> None:
        """Change an elementary variable or string."""
        address, type_ = self.find(path)
        if isinstance(type_, String):
            data = value.encode("latin-1")[: type_.length] + b"\0"
        else:
            assert isinstance(type_, Elementary), f"{path} is no elementary variable"
            data = struct.pack("<" + self._code(type_), value)
        self.poke(address, data)

    @staticmethod
    def _code(type_: Elementary) -> str:
        if type_.kind == "real":
            return "f" if type_.bits == 32 else "d"
        return _CODES[type_.bits, type_.signed]


class _Global(ctypes.Structure):
    _fields_ = (("name", ctypes.c_char_p), ("pointer", ctypes.c_void_p), ("size", ctypes.c_size_t))


class _Member(ctypes.Structure):
    _fields_ = (
        ("owner", ctypes.c_char_p), ("name", ctypes.c_char_p),
        ("offset", ctypes.c_size_t), ("size", ctypes.c_size_t),
    )  # fmt: skip


class LibraryMachine(Machine):
    """A PLC inside this process; each has its own copy of the library, so its own state."""

    def __init__(self, built: Build, directory: str = "/dev/shm") -> None:
        super().__init__(built)
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / "plc.so"
            shutil.copyfile(built.path, copy)
            self.library = ctypes.CDLL(str(copy), mode=os.RTLD_LOCAL | os.RTLD_NOW)
        self._broken: BaseException | None = None
        self.library.st_last_fault.restype = ctypes.c_char_p
        self.library.st_set_directory(directory.encode())
        table: Any = (_Global * 100_000).in_dll(self.library, "st_globals")
        for row in table:
            if not row.name:
                break
            self._globals[row.name.decode()] = (row.pointer, row.size)
        members: Any = (_Member * 10_000_000).in_dll(self.library, "st_members")
        for entry in members:
            if not entry.owner:
                break
            self._members[entry.owner.decode(), entry.name.decode()] = (entry.offset, entry.size)

    def peek(self, address: int, size: int) -> bytes:
        """Return memory."""
        return ctypes.string_at(address, size)

    def poke(self, address: int, data: bytes) -> None:
        """Change memory."""
        ctypes.memmove(address, data, len(data))

    def counters(self) -> Counters:
        """Return what the stand-ins counted."""
        values: Any = (ctypes.c_uint32 * len(_COUNTERS)).in_dll(self.library, "st_counters")
        return Counters(zip(_COUNTERS, values, strict=True))

    def last_fault(self) -> str:
        """Return where an index or divisor was wrong last."""
        return str(self.library.st_last_fault().decode())

    def on_barrier(self, hook: Callable[[], None] | None) -> None:
        """Call a function at each MemoryBarrier, inside the scan; what it raises, `check` raises."""
        self._on("st_barrier_hook", hook)

    def on_inside(self, hook: Callable[[], None] | None) -> None:
        """Call a function inside the lock, after each SysSemProcessEnter that succeeds."""
        self._on("st_inside_hook", hook)

    def _on(self, place_name: str, hook: Callable[[], None] | None) -> None:
        kind = ctypes.CFUNCTYPE(None)
        self._broken = None

        def call() -> None:
            try:
                if hook is not None:
                    hook()
            except BaseException as error:
                self._broken = error

        self._hook = kind(call)  # kept alive for as long as C may call it
        place = ctypes.c_void_p.in_dll(self.library, place_name)
        place.value = ctypes.cast(self._hook, ctypes.c_void_p).value if hook is not None else None

    def check(self) -> None:
        """Assert what holds for every program at all times."""
        super().check()
        if self._broken is not None:
            raise self._broken

    def _call(self, command: str, *arguments: int | str) -> None:
        if command == "scan":
            self._scan(*arguments)
        elif command == "option":
            options: Any = (ctypes.c_uint32 * len(_OPTIONS)).in_dll(self.library, "st_options")
            options[_OPTIONS.index(str(arguments[0]))] = arguments[1]
        else:
            given = [one.encode() if isinstance(one, str) else ctypes.c_uint32(one) for one in arguments]
            for name in _CALLS[command]:
                getattr(self.library, name)(*given)

    def _scan(self, program: Any, count: Any, step: Any) -> None:
        name, now = program.encode(), self._time
        for _ in range(count):
            now = (now + step) & 0xFFFFFFFF
            self.library.st_set_time(ctypes.c_uint32(now))
            if self.library.st_scan(name):
                raise KeyError(program)


class ProcessMachine(Machine):
    """A PLC as a process of its own; a context manager that ends it."""

    def __init__(self, built: Build, directory: str = "/dev/shm") -> None:
        super().__init__(built)
        self.process = subprocess.Popen(
            [*built.toolchain.runner, str(built.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._say("tables")
        while True:
            words = self._line().split()
            if words[0] == "end":
                self._pointer = int(words[1])
                break
            if words[0] == "global":
                self._globals[words[1]] = (int(words[2]), int(words[3]))
            else:
                self._members[words[1], words[2].strip("-")] = (int(words[3]), int(words[4]))
        self._ask(f"directory {directory}")

    def __enter__(self) -> ProcessMachine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()

    def kill(self) -> None:
        """Kill the process where it stands (SIGKILL)."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()

    def _say(self, text: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()

    def _line(self) -> str:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"the PLC process ended with {self.process.wait()}")
        return line.rstrip("\n")

    def _ask(self, text: str) -> str:
        self._say(text)
        answer = self._line()
        assert answer != "?", text
        return answer

    def send(self, text: str) -> None:
        """Send a command without waiting for its answer (the process may be killed inside it)."""
        self._say(text)

    def peek(self, address: int, size: int) -> bytes:
        """Return memory."""
        return bytes.fromhex(self._ask(f"peek {address} {size}"))

    def poke(self, address: int, data: bytes) -> None:
        """Change memory."""
        for start in range(0, len(data), 1 << 18):
            self._ask(f"poke {address + start} {data[start : start + (1 << 18)].hex()}")

    def counters(self) -> Counters:
        """Return what the stand-ins counted."""
        return Counters(zip(_COUNTERS, map(int, self._ask("counters").split()), strict=True))

    def last_fault(self) -> str:
        """Return where an index or divisor was wrong last."""
        return self._ask("fault")

    def _call(self, command: str, *arguments: int | str) -> None:
        self._ask(" ".join(map(str, (command, *arguments))))

    def become(self, user: int) -> None:
        """Go on as a user without rights; only root can."""
        self._ask(f"user {user}")
