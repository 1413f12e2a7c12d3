"""What is compared: real implementations, used as their users would, that carry 100 numbers of 16 bits."""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import TypeAlias

from rosplc.demo.st.process import Translator, find_translator
from rosplc.described import description_of
from rosplc.errors import SetupError
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.plc.build import build_project
from rosplc.plc.plan import PlcTask, PlcTopic
from rosplc.plc.project import project_texts
from rosplc.shm import Description, Direction, Namespace, OwnedChannel
from rosplc_bench.compiling import compile_program, find_library
from rosplc_bench.pairs import (
    BLOCKS,
    CYCLE,
    CYCLIC,
    ONE_CORE,
    ONE_CORE_BUSY,
    ONE_CORE_CYCLE,
    ONE_CORE_YIELD,
    RINGS,
    SPINS,
    TWO_CORES,
    TWO_CORES_BLOCKING,
    Arrangement,
    Contender,
    Pair,
    Place,
    Way,
    python_side,
    start_pair,
)
from rosplc_bench.report import text
from rosplc_bench.run import NAMES_FILE, Missing, need

Start: TypeAlias = Callable[[Place], Pair]

QUESTION, ANSWER = "/question", "/answer"
"""The topics: what A sends to B, the PLC, and what B sends back."""

_TYPE, _DEFINITION = "bench_msgs/msg/Registers", "uint16[100] values\n"


@cache
def layout() -> Layout:
    """Return the record's layout: 200 bytes, the numbers and nothing else."""
    store = TypeStore.bundled("jazzy").with_definition(_TYPE, _DEFINITION)
    return compute_layout(store, _TYPE, Limits())


def describe(topic: str, direction: Direction) -> Description:
    """Return the self-description of one of the two objects."""
    return description_of(layout(), topic, direction, bridge="bench")


def objects(place: Place) -> tuple[str, str]:
    """Make an object for each direction; return the paths of the one towards B and the one towards A."""
    namespace = Namespace("rosplc", place.folder)
    paths = []
    for topic, direction in ((QUESTION, Direction.TO_PLC), (ANSWER, Direction.TO_ROS)):
        with OwnedChannel.open(namespace, describe(topic, direction), record_size=layout().size) as channel:
            paths.append(str(channel.path))
    return paths[0], paths[1]


def channels(
    folder: Path, count: int, size: int, stack: ExitStack, direction: Direction = Direction.TO_ROS
) -> list[OwnedChannel]:
    """Make channels for records of ``size`` bytes; they are gone with ``stack``."""
    namespace = Namespace(f"sweep-{secrets.token_hex(4)}", str(folder))
    made = []
    for index in range(count):
        topic = (f"/topic{index}", "std_msgs/msg/Empty", "jazzy")
        about = Description(*topic, direction, {}, "0" * 16, "bench", "uint8 x")
        made.append(OwnedChannel.open(namespace, about, record_size=size))
        stack.callback(made[-1].retire)  # the memory is wanted for the next size
    return made


def _c(source: str, *tail: str) -> Start:
    """Return what starts both sides of a program in C."""

    def start(place: Place) -> Pair:
        program = str(compile_program(source, place.cache))
        given = (*_places(source, place), *tail)
        return start_pair(f"{source} in C", place, [program, "A", *given], [program, "B", *given])

    return start


def _places(source: str, place: Place) -> tuple[str, ...]:
    if source == "channel":
        return *objects(place), *place.names
    areas = str(place.folder / "areas")
    return (areas,) if source == "bare" else (areas, *place.names)


def _libmodbus(requests: str) -> Start:
    def start(place: Place) -> Pair:
        program = str(
            compile_program("modbus", place.cache, options=find_library("libmodbus", "libmodbus-dev"))
        )
        return start_pair("libmodbus", place, [program, "A", requests], [program, "B"], server=True)

    return start


def _python(module: str, package: str = "", *, server: bool = False) -> Start:
    """Return what starts both sides of a peer in Python; with ``server`` B first, which names its place."""

    def start(place: Place) -> Pair:
        if package:
            need(package)
        file = place.folder / "areas" if module == "semaphore" else place.folder
        tail = () if server else (file, *place.names)
        a, b = (python_side(module, side, *tail) for side in "AB")
        return start_pair(module, place, a, b, server=server)

    return start


def _iceoryx(kind: str) -> Start:
    def start(place: Place) -> Pair:
        # Its objects in /dev/shm are in no folder: they begin with this unique name instead. It is short,
        # because its listeners are sockets in the file system, whose paths have 107 characters at most.
        prefix = f"rb{secrets.token_hex(4)}_"
        need("iceoryx2")
        (place.folder / NAMES_FILE).write_text(prefix)

        def remove() -> None:
            for path in Path("/dev/shm").glob(f"{prefix}*"):
                path.unlink(missing_ok=True)

        a, b = (python_side("iceoryx", side, place.folder, prefix, kind) for side in "AB")
        return start_pair("iceoryx", place, a, b, release=remove)

    return start


_PROGRAM = """\
// B of the experiment: adds one to each number and sends them back.
PROGRAM PLC_PRG
VAR
    uiIndex : UINT;
    udiAnswered : UDINT;
    xReady : BOOL;
END_VAR
xReady := ROS_Write.answer.xReady;
ROS_Write.answer.xEnable := ROS_Read.question.xNew;
IF ROS_Read.question.xNew THEN
    FOR uiIndex := 0 TO 99 DO
        ROS_Write.answer.msg.values[uiIndex] := ROS_Read.question.msg.values[uiIndex] + UINT#1;
    END_FOR;
    udiAnswered := udiAnswered + 1;
END_IF;
END_PROGRAM
"""
_FLAGS = ("-w", "-fwrapv", "-fno-strict-aliasing")


def _texts() -> dict[str, str]:
    """Return the generated project with the program above, as text by object name."""
    record = layout()
    topics = [
        PlcTopic(QUESTION, record, direction="read", task="Bench", in_order=True),
        PlcTopic(ANSWER, record, direction="write", task="Bench"),
    ]
    project = build_project(record.store, topics, [PlcTask("Bench")])
    return {**project_texts(project), "PLC_PRG": _PROGRAM}


def _compile(translator: Translator, cache: Path) -> Path:
    """Return the PLC as a program; what the text becomes in C is kept beside it."""
    texts = _texts()
    runtime = translator.root / "tests" / "st" / "rosplc_st" / "runtime"
    package = translator.root / "tests" / "st" / "rosplc_st" / "translator"
    digest = hashlib.sha256(repr(sorted(texts.items())).encode())
    for path in sorted(package.glob("*.py")):
        digest.update(path.read_bytes())
    source = cache / f"plc-{digest.hexdigest()[:16]}.c"
    if not source.is_file():
        from rosplc_st.translator import translate

        cache.mkdir(parents=True, exist_ok=True)
        made = source.with_suffix(".new")
        made.write_text(translate(texts).code, encoding="utf-8")
        made.rename(source)
    extra = (source, *sorted(path for path in runtime.glob("*.c") if path.name != "st_main.c"))
    return compile_program("st_host", cache, extra=extra, options=(*_FLAGS, f"-I{runtime}", "-lm"))


def _structured_text(place: Place) -> Pair:
    try:
        translator = find_translator()
    except SetupError as error:
        remedy = "run `make setup` in a checkout of the sources, and rosplc-bench from there"
        raise Missing(error.what, remedy) from error
    plc = str(_compile(translator, place.cache))
    peer = str(compile_program("channel", place.cache))
    a = [peer, "A", *objects(place), *place.names]
    return start_pair("rosplc and Structured Text", place, a, [plc, "B", str(place.folder)])


_SPIN, _SOCKET, _CYCLES = (
    {TWO_CORES: SPINS},
    {TWO_CORES: BLOCKS, ONE_CORE: BLOCKS},
    dict.fromkeys(CYCLIC, CYCLE),
)
_LOCKED = {TWO_CORES: Way("spin", "spins (lock, copy, compare)")}
_YIELD = Way("yield", "yields the core between two polls (sched_yield)")
_BUSY = {ONE_CORE_BUSY: SPINS, ONE_CORE_YIELD: _YIELD, ONE_CORE_CYCLE: CYCLE}
_SIGNALS = dict.fromkeys((ONE_CORE, TWO_CORES_BLOCKING), Way("block", "sleeps on the semaphore"))
_RINGS = dict.fromkeys((ONE_CORE, TWO_CORES_BLOCKING), RINGS)
_EVENTS = {TWO_CORES: SPINS, ONE_CORE: Way("block", "sleeps on an iceoryx2 event"), **_CYCLES}
_SHM, _TCP = "shared memory and semaphore", "Modbus TCP"
_TABLE: tuple[tuple[str, str, Mapping[Arrangement, Way], Start], ...] = (
    ("bare", "bare flag and copy, C", _SPIN, _c("bare")),
    ("rosplc-c", "rosplc channel, C", {**_SPIN, **_RINGS, **_BUSY, **_CYCLES}, _c("channel")),
    ("rosplc-st", "rosplc channel, C ↔ Structured Text", {**_SPIN, **_CYCLES}, _structured_text),
    ("rosplc-python", "rosplc channel, Python", {**_SPIN, ONE_CORE: RINGS, **_CYCLES}, _python("channel")),
    (
        "rosplc-python-typed",
        "rosplc channel, Python, typed messages",
        {**_SPIN, **_CYCLES},
        _python("typed_channel"),
    ),
    ("semaphore-c", f"{_SHM}, C", {**_LOCKED, **_BUSY, **_CYCLES}, _c("semaphore")),
    ("signal-c", "semaphores as signals, C", _SIGNALS, _c("semaphore", "signal")),
    ("semaphore-python", f"{_SHM}, Python", {**_LOCKED, **_CYCLES}, _python("semaphore", "posix_ipc")),
    ("iceoryx2", "iceoryx2, Python, publish and subscribe", _EVENTS, _iceoryx("bytes")),
    ("iceoryx2-blackboard", "iceoryx2, Python, blackboard", _EVENTS, _iceoryx("blackboard")),
    (
        "libmodbus",
        f"{_TCP}, libmodbus (FC16, FC03)",
        {**_SOCKET, **_CYCLES, ONE_CORE_CYCLE: CYCLE},
        _libmodbus("separate"),
    ),
    ("libmodbus-fc23", f"{_TCP}, libmodbus (FC23)", _SOCKET, _libmodbus("combined")),
    ("pymodbus", f"{_TCP}, pymodbus", {**_SOCKET, **_CYCLES}, _python("modbus", "pymodbus", server=True)),
    ("asyncua", "OPC UA, asyncua", {**_SOCKET, **_CYCLES}, _python("opcua", "asyncua", server=True)),
)
"""Name, title, ways to wait, and what starts it. What exactly is measured is in ``texts.md``."""

CONTENDERS = tuple(
    Contender(
        name,
        title,
        text(f"about {name}"),
        {here.name: way for here, way in ways.items()},
        start,
        {ONE_CORE.name: "posix_ipc"} if name == "rosplc-python" else {},
    )
    for name, title, ways, start in _TABLE
)
