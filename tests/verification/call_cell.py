"""What the tests of services and actions share: a generated project, and the bridge's side of its objects."""

from __future__ import annotations

import ctypes
import shutil
import struct
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar

from rosplc import virtual_plc
from rosplc.config.plans import ActionPlan, CallPlan, ServicePlan
from rosplc.described import description_of
from rosplc.plc.build import build_project
from rosplc.plc.plan import PlcTask, ProjectOptions
from rosplc.plc.project import project_texts
from rosplc.shm import Namespace, OwnedChannel, Part
from rosplc.shm import constants as spec
from rosplc.virtual_plc.task import Scan, enter_scan
from rosplc_st.build import Build, build
from rosplc_st.machine import LibraryMachine, ProcessMachine
from rosplc_st.translator import Options
from tests.verification.c_plc import LANGUAGES, loaded
from tests.verification.plc_cell import READ, TARGETS, layout_of, store

__all__ = [
    "ActionCaller",
    "ActionServer",
    "CallCell",
    "Caller",
    "Server",
    "Use",
    "VirtualMachine",
    "call_build",
    "call_texts",
    "machine_of",
    "made_cell",
]

SERVICE = {"request": "std_msgs/msg/Int64", "response": "std_msgs/msg/Int32"}
ACTION = {"goal": "std_msgs/msg/Int64", "result": "std_msgs/msg/Int32", "feedback": "std_msgs/msg/Int16"}
LONG = "/" + "/".join(["a_rather_long_part_of_a_name"] * 4)
USES = {
    "close": ("/close", "", "Client"),
    "close_left": ("/close", "left", "Client"),
    "start": ("/start", "", "Server"),
    "long": (LONG, "with_a_client", "Client"),
    "drive": ("/drive", "", "ActionClient"),
    "cycle": ("/cycle", "", "ActionServer"),
}
"""Instance, or what stands for it → service, client, and what the PLC is."""


def _instance(use: str) -> str:
    return "_".join(["a_rather_long_part_of_a_name"] * 4) + "_with_a_client" if use == "long" else use


def calls() -> list[CallPlan]:
    """Return the uses of the cell."""

    def plan(name: str, client: str, role: str) -> CallPlan:
        action = role.startswith("Action")
        about: Any = {word: layout_of(kind) for word, kind in (ACTION if action else SERVICE).items()}
        about |= {"server": "plc" if role.endswith("Server") else "ros", "client": client}
        about |= {"type_name": "test_msgs/srv/Add", "task": "Fast" if client else "RosTask"}
        return ActionPlan(action=name, **about) if action else ServicePlan(service=name, **about)

    return [plan(*use) for use in USES.values()]


@lru_cache
def call_texts(**target: Any) -> dict[str, str]:
    """Return the cell's objects; ``target``: further options of the generation."""
    tasks = [PlcTask("Fast"), PlcTask("RosTask")]
    return project_texts(build_project(store(), (), tasks, ProjectOptions(**target), calls=calls()))


@contextmanager
def made_cell(
    kind: str, sabotage: Callable[[dict[str, str]], dict[str, str]] | None = None
) -> Iterator[CallCell]:
    """Give a cell; ``kind`` is as in :func:`machine_of`."""
    folder = Path(tempfile.mkdtemp(prefix="T", dir="/dev/shm"))
    made = CallCell(folder, machine_of(kind, sabotage))
    try:
        yield made
    finally:
        made.close()
        shutil.rmtree(folder)


def machine_of(
    kind: str, sabotage: Callable[[dict[str, str]], dict[str, str]] | None = None
) -> Callable[[str], Any]:
    """Return what runs the PLC's program in a folder of shared memory.

    ``kind`` is ``virtual``, a language of plc.h, or as in :func:`call_build`.
    """
    if kind == "virtual":
        return VirtualMachine
    if kind in LANGUAGES:
        return partial(CUses, kind)
    built = call_build(kind, sabotage)
    return partial(ProcessMachine if built.toolchain.runner else LibraryMachine, built)


def call_build(
    name: str = "fences", sabotage: Callable[[dict[str, str]], dict[str, str]] | None = None
) -> Build:
    """Return the cell, built: with fences, by the ``delayed`` rule, or for a target of ``plc_cell``."""
    options, toolchain, processor = TARGETS.get(name, (Options(), None, "x86"))
    texts = dict(call_texts(fenced=name != "delayed", target=processor))
    return build(sabotage(texts) if sabotage else texts, options, toolchain, program=toolchain is not None)


class Use:
    """The bridge's side of one use of a service: its objects, and both ends."""

    def __init__(self, cell: CallCell, use: str) -> None:
        service, client, role = USES[use]
        server = "plc" if role.endswith("Server") else "ros"
        action = role.startswith("Action")
        self.path = f"ROS_{'Actions' if action else 'Services'}.{_instance(use)}"
        self.cell = cell
        parts = []
        for word, type_name in (ACTION if action else SERVICE).items():
            part, layout = Part[word.upper()], layout_of(type_name)
            about = description_of(
                layout, service, part.direction(server), bridge="test", part=part, client=client
            )
            parts.append((about, layout.size))
        self.channels: Sequence[OwnedChannel] = OwnedChannel.open_together(cell.namespace, parts)
        cell.uses.append(self)

    def beat(self) -> None:
        """Show that the bridge lives."""
        raise NotImplementedError

    def close(self) -> None:
        """End as a bridge that is killed: claims stay, the objects too."""
        self.cell.uses.remove(self)
        for channel in self.channels:
            channel.close()

    def retire(self) -> None:
        """End as a bridge whose service has left the configuration."""
        self.cell.uses.remove(self)
        for channel in self.channels:
            channel.retire()

    def get(self, *names: str) -> Any:
        """Return pins of the PLC's block: one value, or a tuple."""
        values = tuple(self.cell.machine.get(f"{self.path}.{name}") for name in names)
        return values[0] if len(values) == 1 else values

    def set(self, **pins: Any) -> None:
        """Set inputs of the PLC's block."""
        for name, value in pins.items():
            self.cell.machine.set(f"{self.path}.{name}", value)


class Server(Use):
    """The bridge as answerer: the PLC calls."""

    def __init__(self, cell: CallCell, use: str = "close", servers: int = 1) -> None:
        super().__init__(cell, use)
        self.requests = self.channels[0].reader(beat_ms=100)
        self.responses = self.channels[1].writer(beat_ms=100)
        self.requests.set_sinks(servers)
        self.responses.set_sources(servers)

    def beat(self) -> None:
        self.requests.beat()
        self.responses.beat()

    def take(self) -> tuple[int, int, int] | None:
        """Return the newest message if it is new: status, correlation and value."""
        record = bytearray(8)
        info = self.requests.latest(record)
        self.client = info.client if info else b""
        return info and (info.status, info.correlation, struct.unpack("<q", record)[0])

    def answer(
        self, correlation: int, status: int = spec.ANSWER_DONE, value: int = 0, reason: int = 0
    ) -> None:
        """Publish an answer."""
        self.responses.publish(
            struct.pack("<i", value), correlation=correlation, status=status, reason=reason
        )


class Caller(Use):
    """The bridge as caller: the PLC is the server."""

    def __init__(self, cell: CallCell, use: str = "start") -> None:
        super().__init__(cell, use)
        self.requests = self.channels[0].writer(beat_ms=100)
        self.responses = self.channels[1].reader(beat_ms=100)
        self.number = 0
        self.first = 0

    def beat(self) -> None:
        self.requests.beat()
        self.responses.beat()

    @property
    def correlation(self) -> int:
        """Of the newest call."""
        return self.requests.epoch << 32 | self.number

    def call(self, value: int, client: bytes = bytes(range(16))) -> int:
        """Publish a call; return its correlation."""
        self.number += 1
        self.value = value
        self.first = self._publish(spec.ASK_CALL, client)
        return self.correlation

    def withdraw(self, client: bytes = bytes(range(16))) -> bool:
        """Withdraw the newest call; return whether it may have begun (M26)."""
        self._publish(spec.ASK_CALL + spec.ASK_WITHDRAWN, client)
        return self.requests.begun(self.first)

    def _publish(self, status: int, client: bytes) -> int:
        record = struct.pack("<q", self.value)
        return self.requests.publish(record, correlation=self.correlation, status=status, client=client)

    def answer(self) -> tuple[int, int, int, int] | None:
        """Return the newest answer if it is new: status, correlation, value and reason."""
        record = bytearray(4)
        info = self.responses.latest(record)
        if info is None:
            return None
        assert info.client == bytes(range(16)), "the answer repeats the client's bytes"
        return info.status, info.correlation, struct.unpack("<i", record)[0], info.reason


class ActionServer(Server):
    """The bridge as answerer of goals."""

    def __init__(self, cell: CallCell, use: str = "drive") -> None:
        super().__init__(cell, use)
        self.feedback = self.channels[2].writer(beat_ms=100)

    def beat(self) -> None:
        super().beat()
        self.feedback.beat()

    def report(self, correlation: int, value: int) -> None:
        """Publish feedback."""
        record = struct.pack("<h", value)
        self.feedback.publish(record, correlation=correlation, status=spec.ANSWER_ACCEPTED)


class ActionCaller(Caller):
    """The bridge as caller of an action in the PLC."""

    def __init__(self, cell: CallCell, use: str = "cycle") -> None:
        super().__init__(cell, use)
        self.feedback = self.channels[2].reader(beat_ms=100)

    def beat(self) -> None:
        super().beat()
        self.feedback.beat()

    def ask(self, status: int) -> None:
        """Publish the goal again, with what is asked of it now."""
        self._publish(status, bytes(range(16)))

    def reported(self) -> tuple[int, int, int] | None:
        """Return the newest feedback if it is new: status, correlation and value."""
        record = bytearray(2)
        info = self.feedback.latest(record)
        return info and (info.status, info.correlation, struct.unpack("<h", record)[0])


class VirtualMachine:
    """The virtual PLC's blocks, with the paths and units of a PLC's variables."""

    def __init__(self, directory: str) -> None:
        self._directory = directory
        self._now_ms = 1_000_000
        self._blocks: dict[str, tuple[str, Any]] = {}

    def start(self) -> None:
        """Make the instances."""
        for use, (name, client, role) in USES.items():
            kind = getattr(virtual_plc, role if role.startswith("Action") else f"Service{role}")
            types = ACTION if role.startswith("Action") else SERVICE
            about: dict[str, Any] = {"directory": self._directory, "beat_ms": 250}
            about |= {word: layout_of(type_name) for word, type_name in types.items()}
            block = kind(name, client, **about) if role.endswith("Client") else kind(name, **about)
            self._blocks[_instance(use)] = "Fast" if client else "RosTask", block

    def stop(self) -> None:
        """End as a program that is stopped."""
        for _, block in self._blocks.values():
            block.close()

    def scan(self, *_: str, step: int) -> None:
        """Call each instance in its task."""
        self._now_ms += step
        for task in ("Fast", "RosTask"):
            enter_scan(Scan(task, 1, self._now_ms * 1_000_000))
            for its_task, block in self._blocks.values():
                if its_task == task:
                    block()
        enter_scan(None)

    def get(self, path: str) -> Any:
        """Return a pin as the PLC has it."""
        _, instance, name, *field = path.split(".")
        block = self._blocks[instance][1]
        if name == "tAge":
            return round(block.age * 1000)
        value = getattr(block, {"sState": "reason"}.get(name, name))
        if name == "sState":
            return f"{block.udiError} {value}"
        if name == "udiCallers":
            return spec.UNKNOWN if value is None else value
        return (getattr(value, field[0]) if value is not None else 0) if field else value or 0

    def set(self, path: str, value: Any) -> None:
        """Set a pin."""
        _, instance, name, *field = path.split(".")
        block = self._blocks[instance][1]
        if field:
            block, name = getattr(block, name), field[0]
        assert hasattr(block, name), path
        setattr(block, name, value / 1000 if name in ("tTimeout", "tBridgeGrace") else value)


class CUses:
    """Clients and servers of plc.h; see :class:`VirtualMachine`."""

    STEPS: ClassVar[dict[str, int]] = {
        "xReply": 1,
        "xAccept": 1,
        "xReject": 2,
        "xAcceptCancel": 4,
        "xRejectCancel": 8,
        "xSucceed": 16,
        "xAbort": 32,
        "xCanceled": 64,
    }

    def __init__(self, language: str, directory: str) -> None:
        self._library = loaded(language)
        self._library.c_start(directory.encode(), b"rosplc")
        self._now_ms = 1_000_000
        self._blocks: dict[str, tuple[str, str, ctypes.c_void_p]] = {}
        self._broken: BaseException | None = None

    def on_barrier(self, inside: Callable[[], None] | None) -> None:
        """Have a function called at each fence of the blocks; what it raises, the scan raises."""

        def call() -> None:
            try:
                if inside is not None:
                    inside()
            except BaseException as error:
                self._broken = error

        self._inside = ctypes.CFUNCTYPE(None)(call)  # kept alive for as long as C may call it
        hook = ctypes.c_void_p.in_dll(self._library, "c_inside")
        hook.value = ctypes.cast(self._inside, ctypes.c_void_p).value

    def start(self) -> None:
        """Make the instances."""
        for use, (name, client, role) in USES.items():
            layouts = [layout_of(one) for one in (ACTION if role.startswith("Action") else SERVICE).values()]
            words = [word for one in layouts for word in (*one.layout_id_words, one.size)]
            of_parts = (ctypes.c_uint32 * 9)(*words)
            kinds = role.endswith("Server"), len(layouts) == 3
            block = self._library.c_use(name.encode(), client.encode(), *kinds, of_parts)
            instance = _instance(use)
            self._blocks[instance] = "Fast" if client else "RosTask", role, ctypes.c_void_p(block)
            self.set(f"ROS.{instance}.udiBeatMs", 250)

    def stop(self) -> None:
        """End as a program that is stopped."""
        for *_, block in self._blocks.values():
            self._library.c_use_end(block)

    def scan(self, *_: str, step: int) -> None:
        """Call each instance in its task."""
        self._now_ms += step
        for task in ("Fast", "RosTask"):
            self._library.c_new_scan()
            for its_task, _, block in self._blocks.values():
                if its_task == task:
                    self._library.c_use_scan(block, ctypes.c_uint32(self._now_ms))
        if self._broken is not None:
            raise self._broken

    def _place(self, path: str) -> tuple[Any, int]:
        """Return a pin, and which of its bits; 0: it is a number or has one bit alone."""
        _, instance, name, *field = path.split(".")
        _, role, block = self._blocks[instance]
        if field:
            part = (
                ("request", "response") if not role.startswith("Action") else ("goal", "result", "feedback")
            )
            kind = (ctypes.c_int64, ctypes.c_int32, ctypes.c_int16)[part.index(name)]
            return kind.from_address(self._library.c_use_record(block, part.index(name))), 0
        bit = self.STEPS.get(name, 0) if role.endswith("Server") else 0
        address = self._library.c_use_variable(block, b"steps" if bit else name.encode())
        assert address, f"a {role} of plc.h has no {name}"
        return ctypes.c_uint32.from_address(address), bit

    def get(self, path: str) -> Any:
        """Return a pin as the PLC has it."""
        if path.endswith(".sState"):
            return str(self.get(f"{path.removesuffix('sState')}udiError"))
        place, bit = self._place(path)
        value = place.value & bit if bit else place.value
        return bool(value) if path.rpartition(".")[2].startswith("x") else value

    def set(self, path: str, value: Any) -> None:
        """Set a pin."""
        place, bit = self._place(path)
        place.value = (place.value & ~bit | bit * bool(value)) if bit else int(value)


class CallCell:
    """A folder of shared memory, the bridge's objects in it, and a PLC.

    Args:
        folder: Where the objects are.
        machine: Makes what runs the PLC's program.
    """

    def __init__(self, folder: Path, machine: Callable[[str], Any]) -> None:
        self.namespace = Namespace("rosplc", str(folder))
        self.uses: list[Use] = []
        self.make = machine
        self.machine = machine(str(folder))
        self.machine.start()

    def close(self) -> None:
        """Let go of the objects."""
        for use in list(self.uses):
            use.close()
        if isinstance(self.machine, ProcessMachine):
            self.machine.kill()

    def scan(self, count: int = 1, step: int = 10, *, beats: bool = True) -> None:
        """Run both tasks' programs; ``beats``: the bridge beats before each scan."""
        for _ in range(count):
            for use in self.uses if beats else ():
                use.beat()
            self.machine.scan(f"{READ}_Fast", f"{READ}_RosTask", step=step)

    def until(self, condition: Callable[[], Any], scans: int = 1000, *, beats: bool = True) -> Any:
        """Scan until a condition holds; return its value."""
        for _ in range(scans):
            if value := condition():
                return value
            self.scan(beats=beats)
        raise AssertionError(f"not within {scans} scans")
