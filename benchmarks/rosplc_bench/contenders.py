"""What is compared: real implementations, used as their users would, that carry 100 numbers of 16 bits."""

from __future__ import annotations

import hashlib
import secrets
from functools import cache
from pathlib import Path

from rosplc.demo.st.checkout import Translator, find_translator
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
    Contender,
    Pair,
    Place,
    Way,
    python_side,
    start_pair,
)
from rosplc_bench.run import NAMES_FILE, Missing, need

QUESTION, ANSWER = "/question", "/answer"
"""The topics: what A sends to B, the PLC, and what B sends back."""

_CYCLES = {each.name: CYCLE for each in CYCLIC}
_TYPE, _DEFINITION = "bench_msgs/msg/Registers", "uint16[100] values\n"


@cache
def layout() -> Layout:
    """Return the record's layout: 200 bytes, the numbers and nothing else."""
    store = TypeStore.bundled("jazzy").with_definition(_TYPE, _DEFINITION)
    return compute_layout(store, _TYPE, Limits())


def describe(topic: str, direction: Direction) -> Description:
    """Return the self-description of one of the two objects."""
    return description_of(layout(), topic, direction, bridge="bench")


_BUSY = {
    ONE_CORE_BUSY.name: SPINS,
    ONE_CORE_YIELD.name: Way("yield", "polls when it gets the core back (sched_yield)"),
    ONE_CORE_CYCLE.name: CYCLE,
}


def objects(place: Place) -> tuple[str, str]:
    """Make an object for each direction; return the paths of the one towards B and the one towards A."""
    namespace = Namespace("rosplc", place.folder)
    paths = []
    for topic, direction in ((QUESTION, Direction.TO_PLC), (ANSWER, Direction.TO_ROS)):
        with OwnedChannel.open(namespace, describe(topic, direction), record_size=layout().size) as channel:
            paths.append(str(channel.path))
    return paths[0], paths[1]


def _same_program(name: str, place: Place, source: str, *tail: str) -> Pair:
    """Start both sides of a program in C."""
    program = str(compile_program(source, place.cache))
    return start_pair(name, place, a=[program, "A", *tail], b=[program, "B", *tail])


def _start_semaphore(place: Place, *more: str) -> Pair:
    tail = (str(place.folder / "areas"), *place.names, *more)
    return _same_program("shared memory and semaphore", place, "semaphore", *tail)


def _start_libmodbus(place: Place, requests: str) -> Pair:
    options = find_library("libmodbus", "libmodbus-dev")
    client = compile_program("modbus_client", place.cache, options=options)
    server = compile_program("modbus_server", place.cache, options=options)
    a, b = [str(client), "A", requests], [str(server), "B"]
    return start_pair("libmodbus", place, a=a, b=b, order="BA", pass_on=True)


def _start_python(place: Place, module: str, *tail: object, package: str = "", server: bool = False) -> Pair:
    """Start both sides of a peer in Python; with ``server`` B first, which names its place."""
    if package:
        need(package)
    a, b = (python_side(module, side, *tail) for side in "AB")
    return start_pair(module, place, a=a, b=b, order="BA" if server else "AB", pass_on=server)


def _start_iceoryx(place: Place, kind: str) -> Pair:
    # Its objects in /dev/shm are in no folder: they begin with this unique name instead. It is short, because
    # its listeners are sockets in the file system, whose paths have 107 characters at most.
    prefix = f"rb{secrets.token_hex(4)}_"
    need("iceoryx2")
    (place.folder / NAMES_FILE).write_text(prefix)
    try:
        pair = _start_python(place, "iceoryx", place.folder, prefix, kind)
    except BaseException:
        _remove_files(prefix)
        raise
    pair.on_release(lambda: _remove_files(prefix))
    return pair


def _remove_files(prefix: str) -> None:
    for path in Path("/dev/shm").glob(f"{prefix}*"):
        path.unlink(missing_ok=True)


BARE = Contender(
    "bare",
    "bare flag and copy, C",
    "a flag in its own cache line and a copy of the same 200 bytes: the physical limit, without any "
    "protection",
    {TWO_CORES.name: SPINS},
    lambda place: _same_program("bare exchange", place, "bare", str(place.folder / "boxes")),
)
ROSPLC_C = Contender(
    "rosplc-c",
    "rosplc channel, C",
    "the C core's own headers: claims, fences, sequence checks and both liveness words as in every program "
    "that uses them; to block, its two sides "
    "wake each other with a POSIX semaphore beside the channel",
    {
        TWO_CORES.name: SPINS,
        ONE_CORE.name: RINGS,
        TWO_CORES_BLOCKING.name: RINGS,
        **_BUSY,
        **_CYCLES,
    },
    lambda place: _same_program("rosplc in C", place, "rosplc_peer", *objects(place), *place.names),
)
SEMAPHORE_C = Contender(
    "semaphore-c",
    "shared memory and semaphore, C",
    "shared memory with a named semaphore as its lock; the reader takes the lock, copies, and polls until "
    "the numbers differ",
    {
        TWO_CORES.name: Way("spin", "spins (lock, copy, compare)"),
        **_BUSY,
        **_CYCLES,
    },
    _start_semaphore,
)
SIGNAL_C = Contender(
    "signal-c",
    "semaphores as signals, C",
    "the same memory and semaphores, but the writer posts the semaphore and the reader waits for it",
    dict.fromkeys((ONE_CORE.name, TWO_CORES_BLOCKING.name), Way("block", "sleeps on the semaphore")),
    lambda place: _start_semaphore(place, "signal"),
)


_BLOCKING = {TWO_CORES.name: BLOCKS, ONE_CORE.name: BLOCKS}


LIBMODBUS = Contender(
    "libmodbus",
    "Modbus TCP, libmodbus (FC16, FC03)",
    "libmodbus client and server in C over the loopback interface, with the library's own settings (it sends "
    "at once, TCP_NODELAY); one request writes 100 registers, one reads 100",
    {**_BLOCKING, **_CYCLES, ONE_CORE_CYCLE.name: CYCLE},
    lambda place: _start_libmodbus(place, "separate"),
)
LIBMODBUS_FC23 = Contender(
    "libmodbus-fc23",
    "Modbus TCP, libmodbus (FC23)",
    "the same with the one request that writes 100 registers and reads 100 others",
    _BLOCKING,
    lambda place: _start_libmodbus(place, "combined"),
)
PYMODBUS = Contender(
    "pymodbus",
    "Modbus TCP, pymodbus",
    "pymodbus' synchronous client, which takes less time than its asynchronous one, and its server, with "
    "their own settings and no log; FC16 and FC03",
    {**_BLOCKING, **_CYCLES},
    lambda place: _start_python(place, "modbus", package="pymodbus", server=True),
)


ROSPLC_PYTHON = Contender(
    "rosplc-python",
    "rosplc channel, Python",
    "rosplc.shm: Writer.publish and Reader.update with records of bytes, in the C extension; to "
    "block, its two sides wake each other with a POSIX semaphore (posix_ipc) beside the channel",
    {TWO_CORES.name: SPINS, ONE_CORE.name: RINGS, **_CYCLES},
    lambda place: _start_python(place, "channel", place.folder, *place.names),
    {ONE_CORE.name: "posix_ipc"},
)
ROSPLC_TYPED = Contender(
    "rosplc-python-typed",
    "rosplc channel, Python, typed messages",
    "the same, but B attaches with rosplc.attach and reads and writes messages with fields, lists of Python "
    "integers, as scripts do",
    {TWO_CORES.name: SPINS, **_CYCLES},
    lambda place: _start_python(place, "typed_channel", place.folder, *place.names),
)
SEMAPHORE_PYTHON = Contender(
    "semaphore-python",
    "shared memory and semaphore, Python",
    "the same as in C, with posix_ipc: lock, copy, compare, poll",
    {TWO_CORES.name: Way("spin", "spins (lock, copy, compare)"), **_CYCLES},
    lambda place: _start_python(
        place, "semaphore", place.folder / "areas", *place.names, package="posix_ipc"
    ),
)
ASYNCUA = Contender(
    "asyncua",
    "OPC UA, asyncua",
    "asyncua's client writes one node and reads another, each an array and one request of a session that "
    "stays; its server adds one in the callback behind a write, which spares a subscription; without "
    "security and without a log",
    {TWO_CORES.name: BLOCKS, ONE_CORE.name: BLOCKS, **_CYCLES},
    lambda place: _start_python(place, "opcua", package="asyncua", server=True),
)
ICEORYX = Contender(
    "iceoryx2",
    "iceoryx2, Python, publish and subscribe",
    "iceoryx2's Python package: a loaned sample, filled in place; to sleep, its events; its own settings but "
    "for the names of its files",
    {TWO_CORES.name: SPINS, ONE_CORE.name: Way("block", "sleeps on an iceoryx2 event"), **_CYCLES},
    lambda place: _start_iceoryx(place, "bytes"),
)
ICEORYX_BLACKBOARD = Contender(
    "iceoryx2-blackboard",
    "iceoryx2, Python, blackboard",
    "iceoryx2's Python package: an entry of its blackboard for each direction; to sleep, its events; its own "
    "settings but for the names of its files",
    {TWO_CORES.name: SPINS, ONE_CORE.name: Way("block", "sleeps on an iceoryx2 event"), **_CYCLES},
    lambda place: _start_iceoryx(place, "blackboard"),
)


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


def _start_structured_text(place: Place) -> Pair:
    try:
        translator = find_translator()
    except SetupError as error:
        remedy = "run rosplc-bench from a checkout of the sources, after `make setup` there"
        raise Missing(error.what, remedy) from error
    plc = str(_compile(translator, place.cache))
    peer = str(compile_program("rosplc_peer", place.cache))
    return start_pair(
        "rosplc and Structured Text",
        place,
        a=[peer, "A", *objects(place), *place.names],
        b=[plc, "B", str(place.folder)],
    )


ROSPLC_ST = Contender(
    "rosplc-st",
    "rosplc channel, C ↔ Structured Text",
    "A is the C core, B the generated Read and Write blocks and a program in Structured Text, translated to "
    "C by the sources' translator and scanned without a pause or in its cycle; CODESYS' compiler makes other "
    "code of it",
    {TWO_CORES.name: SPINS, **_CYCLES},
    _start_structured_text,
)


CONTENDERS: tuple[Contender, ...] = (
    BARE,
    ROSPLC_C,
    ROSPLC_ST,
    ROSPLC_PYTHON,
    ROSPLC_TYPED,
    SEMAPHORE_C,
    SIGNAL_C,
    SEMAPHORE_PYTHON,
    ICEORYX,
    ICEORYX_BLACKBOARD,
    LIBMODBUS,
    LIBMODBUS_FC23,
    PYMODBUS,
    ASYNCUA,
)
