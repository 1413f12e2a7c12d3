"""The blocks for OpenPLC, compiled and run behind stand-ins for its compilers, and behind these themselves.

``ROSPLC_STRUCPP`` names a checkout of STruC++ that was built, ``ROSPLC_BEREMIZ`` a folder with
``matiec/iec2c`` and ``matiec/lib``; no registry has them.
"""

from __future__ import annotations

import _ctypes
import ctypes
import os
import random
import re
import subprocess
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest

import rosplc
from rosplc.codec import Codec, Wire
from rosplc.config.resolve import Project, load_project
from rosplc.described import description_of
from rosplc.project import generate_types
from rosplc.shm import Namespace, OwnedChannel
from tests.lib.waiting import wait_for
from tests.verification.call_ends import CALLED, CallEnds
from tests.verification.crossing import random_record

pytestmark = pytest.mark.verifies("blocks-conform", own="a stand-in for each compiler")

By = Callable[[Project, Path, str], Path]
HERE = Path(__file__).parent
FLAGS = ["-std=c++17", "-O1", "-Wall", "-Werror", "-DSTRUCPP_THREADED"]
C_FLAGS = ["-O1", "-Wall", "-Wextra", "-Werror"]
PART = "float32 x\nstring<=7 name\nuint16[] few\n"
KINDS = """bool b
byte by
char c
int8 i8
uint8 u8
int16 i16
uint16 u16
int32 i32
uint32 u32
int64 i64
uint64 u64
float32 f32
float64 f64
string s
string<=5 bounded
float64[3] fixed
bool[2] flags
string[2] texts
uint8[] bytes
string[] words
Part part
Part[2] pair
Part[] parts
string<=200 long
string<=150[2] longs
"""
PROGRAM = """PROGRAM Pass
VAR
    there : kinds_All_Read;
    back : kinds_All_Write;
    more : BOOL;
END_VAR
there(sTopic := '/there', xInOrder := TRUE);
more := there.xNew;
WHILE more DO
    back.msg := there.msg;
    back(sTopic := '/back', xEnable := TRUE, uliStamp := there.uliStamp);
    more := there.Next();
END_WHILE;
back(sTopic := '/back', xEnable := FALSE);
END_PROGRAM
CONFIGURATION Config0
  RESOURCE Res0 ON PLC
    TASK main(INTERVAL := T#10ms, PRIORITY := 0);
    PROGRAM instance0 WITH main : Pass;
  END_RESOURCE
END_CONFIGURATION
"""
RUN_BY_STRUCPP = """#include "generated.hpp"
static strucpp::Configuration_CONFIG0 config;
extern "C" void scan() { config.get_resources()[0].tasks[0].programs[0]->run(); }
"""
RUN_BY_MATIEC = """#include "POUS.h"
TIME __CURRENT_TIME;
BOOL __DEBUG;
void config_init__(void);
void config_run__(unsigned long tick);
__attribute__((constructor)) static void start(void) { config_init__(); }
void scan(void);
void scan(void) { static unsigned long tick; config_run__(tick++); }
"""
CALLS = """PROGRAM Pass
VAR
    pick : std_srvs_Trigger_Client;
    start : std_srvs_SetBool_Server;
    drive : example_interfaces_Fibonacci_ActionClient;
    cycle : example_interfaces_Fibonacci_ActionServer;
END_VAR
drive.goal.order := 7;
drive(sName := '/drive', xExecute := TRUE, tTimeout := T#1h);
cycle.feedback := drive.feedback;
cycle.result := drive.result;
cycle(sName := '/cycle', xAccept := cycle.xGoal, xSendFeedback := drive.xActive, xSucceed := drive.xDone);
pick(sName := '/close', sClient := 'pick', xExecute := TRUE);
start(sName := '/start', xReply := start.xRequest);
start.response.success := start.request.data;
start.response.message := pick.response.message;
END_PROGRAM
""" + PROGRAM[PROGRAM.index("CONFIGURATION") :]


@pytest.fixture
def project(tmp_path: Path, shm_namespace: Namespace) -> Project:
    """Give a configuration with a message that has every kind of field, both ways."""
    return load_project(kinds(tmp_path, shm_namespace, "there", "back"))


def kinds(tmp_path: Path, shm_namespace: Namespace, *topics: str) -> Path:
    """Write a configuration with topics, of which those that end with "back" go to ROS."""
    folder = tmp_path / "kinds" / "msg"
    folder.mkdir(parents=True)
    (folder / "Part.msg").write_text(PART)
    (folder / "All.msg").write_text(KINDS)
    (tmp_path / "kinds" / "package.xml").write_text("<package><name>kinds</name></package>")
    limits = "limits: {string: 20, sequence: 3, long: 200, 'longs[]': 150}"
    text = f"prefix: {shm_namespace.prefix}\ntypes: {{paths: [kinds]}}\ntopics:\n"
    for topic in topics:
        to = "ros" if topic.endswith("back") else "plc"
        text += f"  /{topic}: {{type: kinds/msg/All, to: {to}, {limits}}}\n"
    path = tmp_path / "rosplc.yaml"
    path.write_text(text)
    return path


def translated(program: str) -> str:
    """Return what STruC++ makes of a program, as far as the programs here need it."""
    declared, statements = re.fullmatch(
        r"PROGRAM \w+\nVAR\n(.*)END_VAR\n(.*)END_PROGRAM\n.*", program, re.S
    ).groups()  # type: ignore[union-attr]

    def capitals(text: str) -> str:
        text = re.sub(r"T#\d+h", "3600000000000", text.replace(" AND ", " && "))
        text = "".join(part if part[:1] == "'" else part.upper() for part in re.split(r"('[^']*')", text))
        return text.replace("'", '"').replace("TRUE", "true").replace("FALSE", "false")

    lines = ['#include "generated.hpp"']
    lines += [f"static strucpp::{capitals(line).replace(' : ', ' ', 1)}" for line in reordered(declared)]
    lines.append('extern "C" void scan()\n{')
    for line in statements.splitlines():
        called = re.fullmatch(r" *(\w+)\((.*)\);", line)
        if called:
            name = called[1].upper()
            arguments = [capitals(one).replace(" := ", " = ") for one in called[2].split(", ")]
            lines += [*(f"{name}.{one};" for one in arguments), f"{name}();"]
        else:
            line = capitals(line).replace(" := ", " = ")
            lines.append(re.sub(r"WHILE (.*) DO", r"while (\1) {", line).replace("END_WHILE;", "}"))
    return "\n".join([*lines, "}\n"])


def reordered(declared: str) -> list[str]:
    """Return declarations with the type first."""
    return re.sub(r" *(\w+) : (\w+);", r"\2 : \1;", declared).replace("BOOL :", "IEC_BOOL :").splitlines()


def by_stand_in(folder: Path, program: str) -> list[str]:
    """Write what STruC++ would make of rosplc.st, as far as the blocks need it; return an include folder."""
    text = (folder / "rosplc.st").read_text()
    parts = ['#pragma once\n#include "openplc_stand_in.hpp"\nnamespace strucpp {']
    bodies = ['#include "generated.hpp"\nnamespace strucpp {']
    for name, members in re.findall(r"^TYPE (\w+) : STRUCT\n(.*?)END_STRUCT;", text, re.S | re.M):
        parts += [f"struct {name.upper()} {{", *declared(members), "};"]
    for name, rest in re.findall(r"^FUNCTION_BLOCK (\w+)\n(.*?)END_FUNCTION_BLOCK", text, re.S | re.M):
        upper = name.upper()
        variables = "".join(re.findall(r"^VAR_\w+\n(.*?)END_VAR", rest, re.S | re.M))
        method = re.search(r"METHOD PUBLIC Next : BOOL\n\{external(.*?)\}\nEND_METHOD\n", rest, re.S)
        parts += [f"struct {upper} {{", *declared(variables), "void operator()();", "IEC_BOOL NEXT();", "};"]
        body = rest.rpartition("{external")[2].rpartition("}")[0]
        bodies.append(f"void {upper}::operator()() {{{body}}}")
        if method:
            returned = f"IEC_BOOL NEXT_result;{method[1]}return NEXT_result;"
            bodies.append(f"IEC_BOOL {upper}::NEXT() {{{returned}}}")
    (folder / "generated" / "generated.hpp").write_text("\n".join([*parts, "}\n"]))
    (folder / "generated" / "generated.cpp").write_text("\n".join([*bodies, "}\n"]) + translated(program))
    return [f"-I{HERE}"]


def declared(text: str) -> list[str]:
    """Return C++ members for declarations; initial values of numbers alone, as those of the blocks are."""
    found = []
    for name, declared_type, initial in re.findall(r"^ +(\w+) : ([^;:]+?)(?: := ([^;]+))?;$", text, re.M):
        start = f" = {initial.replace('16#', '0x')}" if initial else "{}"
        found.append(f"{type_of(declared_type)} {name.upper()}{start};")
    return found


def type_of(text: str) -> str:
    if array := re.fullmatch(r"ARRAY\[0\.\.(\d+)\] OF (.*)", text):
        element = "IECStringVar<254>" if array[2].startswith("STRING") else type_of(array[2])
        return f"Array1D<{element}, 0, {array[1]}>"
    if string := re.fullmatch(r"STRING\((\d+)\)", text):
        return f"IECStringVar<{string[1]}>"
    return f"IEC_{text}" if text.isupper() else text.upper()


def by_strucpp(folder: Path, program: str) -> list[str]:
    """Have STruC++ compile rosplc.st and the program; return an include folder."""
    strucpp = Path(os.environ["ROSPLC_STRUCPP"])
    (folder / "pass.st").write_text(program)
    output = folder / "generated" / "generated.cpp"
    sources = [str(folder / "rosplc.st"), str(folder / "pass.st")]
    command = ["node", str(strucpp / "dist/node/cli.js"), *sources, "-o", str(output)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (folder / "generated" / "run.cpp").write_text(RUN_BY_STRUCPP)
    return [f"-I{strucpp / 'src/runtime/include'}"]


def compiled(command: list[str], sources: Sequence[Path], target: Path) -> Path:
    """Return a shared library."""
    command = [*command, "-fPIC", "-shared", *map(str, sources), "-o", str(target)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return target


def in_cpp(make: Callable[[Path, str], list[str]]) -> By:
    """Return how STruC++'s side builds a shared library with the blocks and a function ``scan``."""

    def build(project: Project, folder: Path, program: str) -> Path:
        rosplc.generate(project, folder, plc="openplc")
        include = make(folder, program)
        generated = folder / "generated"
        command = ["g++", *FLAGS, f"-I{generated}", *include]
        return compiled(command, sorted(generated.glob("*.cpp")), folder / "program.so")

    return build


def for_matiec(project: Project, folder: Path, program: str) -> tuple[Path, str]:
    """Generate for matiec; return where C belongs, and the program without the method Next."""
    rosplc.generate(project, folder, plc="matiec")
    (folder / "c").mkdir()
    program = program.replace("xInOrder := TRUE", "xInOrder := TRUE, xNext := FALSE")
    return folder / "c", program.replace("more := there.Next()", "there(xNext := TRUE);\nmore := there.xNew")


def by_matiec(project: Project, folder: Path, program: str) -> Path:
    """Have matiec compile rosplc.st and the program, and C the result."""
    made, program = for_matiec(project, folder, program)
    matiec = Path(os.environ["ROSPLC_BEREMIZ"]) / "matiec"
    (folder / "all.st").write_text((folder / "rosplc.st").read_text() + program)
    command = [str(matiec / "iec2c"), "-I", str(matiec / "lib"), "-T", str(made), str(folder / "all.st")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (made / "run.c").write_text(RUN_BY_MATIEC)
    generated = folder / "generated"
    command = ["gcc", "-std=gnu11", "-O1", "-w", f"-I{made}", f"-I{generated}", f"-I{matiec / 'lib' / 'C'}"]
    sources = [*sorted(made.glob("[CRr]*.c")), generated / "rosplc_blocks.c"]
    return compiled(command, sources, folder / "program.so")


def by_matiec_stand_in(*compiler: str) -> By:
    """Return how what matiec would make of all Structured Text is built, as far as the blocks need it."""

    def build(project: Project, folder: Path, program: str) -> Path:
        made, program = for_matiec(project, folder, program)
        text = (folder / "rosplc.st").read_text()
        parts = ['#include "matiec_stand_in.h"']
        for name, members in re.findall(r"^TYPE (\w+) : STRUCT\n(.*?)END_STRUCT;", text, re.S | re.M):
            parts += ["typedef struct {", *in_c(members, "{0} {1}{2};"), f"}} {name.upper()};"]
            parts.append(f"DECLARE({name.upper()})")
        for name, rest in re.findall(r"^FUNCTION_BLOCK (\w+)\n(.*?)END_FUNCTION_BLOCK", text, re.S | re.M):
            variables = "".join(re.findall(r"^VAR_\w+\n(.*?)END_VAR", rest, re.S | re.M))
            members = in_c(variables, "__IEC_{0}_t {1};")
            parts += ["typedef struct {", *members, f"}} {name.upper()};"]
            assert f"rosplc_call_{name.upper()}(data__);" in rest
        (made / "POUS.h").write_text("\n".join([*parts, ""]))
        (made / "run.c").write_text(translated_to_c(program))
        generated = folder / "generated"
        command = [*compiler, *C_FLAGS, f"-I{made}", f"-I{generated}", f"-I{HERE}"]
        return compiled(command, [made / "run.c", generated / "rosplc_blocks.c"], folder / "program.so")

    return build


def in_c(text: str, form: str) -> list[str]:
    """Return members for declarations."""
    found = []
    for name, declared_type in re.findall(r"^ +(\w+) : ([^;:]+?)(?: := [^;]+)?;$", text, re.M):
        array = re.fullmatch(r"ARRAY\[([^]]*)\] OF (\w+)", declared_type)
        sizes = [int(one.split("..")[1]) + 1 for one in array[1].split(", ")] if array else []
        outer = "".join(f"[{size}]" for size in sizes)
        kind = (array[2] if array else declared_type).upper()
        kind = f"struct {{ {kind} table{outer}; }}" if array else kind
        found.append(form.format(kind, name.upper(), ""))
    return found


def translated_to_c(program: str) -> str:
    """Return C for a program, with matiec's conventions as far as the programs here need them."""
    declared_part, statements = re.fullmatch(
        r"PROGRAM \w+\nVAR\n(.*)END_VAR\n(.*)END_PROGRAM\n.*", program, re.S
    ).groups()  # type: ignore[union-attr]
    blocks = dict(re.findall(r"(\w+) : (\w+_\w+);", declared_part))
    lines = ['#include "POUS.h"', *["static BOOL MORE;"] * ("more : BOOL" in declared_part)]
    for name, block in blocks.items():
        lines.append(f"void rosplc_call_{block.upper()}({block.upper()} *);")
        lines.append(f"static {block.upper()} {name.upper()};")

    def value(text: str) -> str:
        text = re.sub(r"'([^']*)'", lambda found: f'text("{found[1]}")', text)
        text = re.sub(r"T#(\d+)h", lambda found: f"hours({found[1]})", text)
        return re.sub(
            r"\b(\w+)\.(\w+)", lambda f: f"{f[1]}.{f[2]}.value".upper().replace("VALUE", "value"), text
        )

    lines.append("EXTERN void scan(void);\nvoid scan(void)\n{")
    lines += [f"{name.upper()}.UIMAXPERSCAN.value = 8;" for name in blocks if blocks[name].endswith("_Read")]
    for line in statements.splitlines():
        line = line.strip()
        if called := re.fullmatch(r"(\w+)\((.*)\);", line):
            name = called[1]
            for one in called[2].split(", "):
                pin, _, given = one.partition(" := ")
                lines.append(f"{name.upper()}.{pin.upper()}.value = {value(given)};")
            lines.append(f"rosplc_call_{blocks[name].upper()}(&{name.upper()});")
        else:
            line = re.sub(r"\.value\.(\w+)", lambda f: f".value.{f[1].upper()}", value(line))
            line = line.replace(" := ", " = ").replace("more", "MORE").replace(" AND ", " && ")
            lines.append(re.sub(r"WHILE (.*) DO", r"while (\1) {", line).replace("END_WHILE;", "}"))
    return "\n".join([*lines, "}\n"])


EACH = pytest.mark.parametrize(
    "by",
    [
        pytest.param(in_cpp(by_stand_in), id="stand-in"),
        pytest.param(by_matiec_stand_in("gcc", "-std=gnu11"), id="stand-in for matiec"),
        pytest.param(by_matiec_stand_in("g++", "-std=gnu++11", "-xc++"), id="stand-in for OpenPLC v3"),
        pytest.param(in_cpp(by_strucpp), id="STruC++", marks=pytest.mark.needs(variable="ROSPLC_STRUCPP")),
        pytest.param(by_matiec, id="matiec", marks=pytest.mark.needs(variable="ROSPLC_BEREMIZ")),
    ],
)


@pytest.mark.timeout(300)
@EACH
def test_every_kind_of_field_crosses(
    by: By, project: Project, tmp_path: Path, shm_namespace: Namespace
) -> None:
    """Random messages come back equal and in order, and unloading the program gives back what it held."""
    library = ctypes.CDLL(str(by(project, tmp_path / "plc", PROGRAM)))
    ends: list[Any] = []
    channels = []
    for plan in project.topics:
        about = description_of(plan.layout, plan.topic, plan.direction, bridge="test")
        channel = OwnedChannel.open(shm_namespace, about, record_size=plan.layout.size, slots=16)
        channels.append(channel)
        ends.append(channel.writer() if plan.topic == "/there" else channel.reader())
    writer, reader = ends if project.topics[0].topic == "/there" else ends[::-1]
    there = channels[[plan.topic for plan in project.topics].index("/there")]
    back = channels[[plan.topic for plan in project.topics].index("/back")]
    layout = project.topics[0].layout
    codec = Codec(layout, Wire.CDR)

    def scan() -> None:
        writer.beat()
        reader.beat()
        library.scan()

    def held() -> tuple[bool, bool]:
        return any(line.claim for line in there.snapshot().readers), bool(back.snapshot().writer.epoch)

    try:
        wait_for(lambda: scan() or held() == (True, True), "both claims")
        draw = random.Random(15)
        for number in range(1, 101, 2):
            sent = [codec.encode(random_record(layout, draw)) for _ in range(2)]
            for wire in sent:
                writer.publish_wire(codec.plan, wire, stamp_ns=number << 33)
            library.scan()
            for wire in sent:
                taken = reader.next_wire(codec.plan)
                assert taken is not None and taken[0] == wire, number
                assert taken[1].stamp_ns == number << 33
        assert reader.lost == 0
        _ctypes.dlclose(library._handle)
        assert "program.so" not in Path("/proc/self/maps").read_text(), "a shared symbol keeps it loaded"
        assert held() == (False, False)
    finally:
        for channel in channels:
            channel.close()


def two_tasks(project: Project, folder: Path, right: str = "", wrong: str = "") -> Path:
    """Build the host with two tasks for ThreadSanitizer, with one text of the blocks' header for another."""
    rosplc.generate(project, folder, plc="openplc")
    by_stand_in(folder, PROGRAM)
    generated = folder / "generated"
    header = generated / "rosplc_openplc.hpp"
    assert right in header.read_text()
    if right:
        header.write_text(header.read_text().replace(right, wrong))
    # It knows no fences, which the channels' rules between processes need.
    options = [*FLAGS, "-g", "-fsanitize=thread", "-Wno-tsan", f"-I{generated}", f"-I{HERE}"]
    sources = [*sorted(generated.glob("*.cpp")), HERE / "openplc_tasks.cpp"]
    command = ["g++", *options, *map(str, sources), "-o", str(folder / "tasks")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / "tasks"


@pytest.mark.timeout(300)
def test_two_tasks_share_nothing_unguarded(tmp_path: Path, shm_namespace: Namespace) -> None:
    """ThreadSanitizer sees no race between two tasks that pass messages on with blocks of the same types."""
    project = load_project(kinds(tmp_path, shm_namespace, "there", "back", "slow_there", "slow_back"))
    program = two_tasks(project, tmp_path / "plc")
    codec = Codec(project.topics[0].layout, Wire.CDR)
    draw = random.Random(15)
    sent = [codec.encode(random_record(codec.layout, draw)) for _ in range(100)]
    with ExitStack() as stack:
        channels = {}
        for plan in project.topics:
            about = description_of(plan.layout, plan.topic, plan.direction, bridge="test")
            opened = OwnedChannel.open(shm_namespace, about, record_size=plan.layout.size, slots=128)
            channels[plan.topic] = stack.enter_context(closing(opened))
        ways = {
            way: (
                channels[f"/{way}there"],
                channels[f"/{way}there"].writer(),
                channels[f"/{way}back"].reader(),
            )
            for way in ("", "slow_")
        }
        child = subprocess.Popen([str(program), str(len(sent))], stderr=subprocess.PIPE, text=True)
        stack.callback(child.kill)
        for channel, _, _ in ways.values():
            wait_for(lambda channel=channel: any(r.claim for r in channel.snapshot().readers), "a claim")
        for wire in sent:
            for _, writer, _ in ways.values():
                writer.publish_wire(codec.plan, wire)
        for _, _, reader in ways.values():
            for wire in sent:
                assert wait_for(lambda reader=reader: reader.next_wire(codec.plan), "a message")[0] == wire
        _, told = child.communicate(timeout=200)
    assert (child.returncode, told) == (0, "")


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("thread_local rosplc_pace", "static rosplc_pace"),
        ("std::memory_order_release", "std::memory_order_relaxed"),
    ],
)
def test_a_race_of_two_tasks_is_seen(right: str, wrong: str, project: Project, tmp_path: Path) -> None:
    """So is what they would do wrong with one pace for both, or a list without order."""
    program = two_tasks(project, tmp_path / "plc", right, wrong)
    done = subprocess.run(
        [program, "1"],
        env={"TSAN_OPTIONS": "halt_on_error=1"},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode
    assert "ThreadSanitizer: data race" in done.stderr


@pytest.mark.timeout(300)
@EACH
def test_calls_cross(by: By, tmp_path: Path, shm_namespace: Namespace) -> None:
    """Requests, goals, feedback and what answers them have their fields, in both roles."""
    (tmp_path / "rosplc.yaml").write_text(f"prefix: {shm_namespace.prefix}\n{CALLED}")
    project = load_project(tmp_path / "rosplc.yaml")
    library = ctypes.CDLL(str(by(project, tmp_path / "plc", CALLS)))
    with CallEnds(project, shm_namespace, library.scan) as ends:
        ends.let_all_cross()
        _ctypes.dlclose(library._handle)
        assert "program.so" not in Path("/proc/self/maps").read_text(), "a shared symbol keeps it loaded"


def test_strings_too_long_for_matiec(tmp_path: Path) -> None:
    """They are arrays of bytes, also in a safe message; the name of a topic cannot be one."""
    (tmp_path / "rosplc.yaml").write_text(
        "topics:\n"
        "  /a: {type: std_msgs/msg/Header, to: plc, limits: {string: 127}, stale_after: 1s,"
        " on_stale: {value: {frame_id: hi}}}\n"
        "  /b: {type: std_msgs/msg/String, to: plc, limits: {string: 126}}\n"
    )
    rosplc.generate(tmp_path / "rosplc.yaml", tmp_path / "plc", plc="matiec")
    types = (tmp_path / "plc" / "rosplc.st").read_text()
    assert "    frame_id : ARRAY[0..127] OF BYTE;" in types
    assert "    data : STRING;" in types
    assert "METHOD" not in types
    program = (tmp_path / "plc" / "example.st").read_text()
    assert "a.stSafe.frame_id[0] := 104;\na.stSafe.frame_id[1] := 105;\n" in program
    name = "/" + "a" * 126
    (tmp_path / "rosplc.yaml").write_text(f"topics:\n  {name}: {{type: std_msgs/msg/Bool, to: plc}}\n")
    with pytest.raises(rosplc.GenerationError) as error:
        rosplc.generate(tmp_path / "rosplc.yaml", tmp_path / "plc", plc="matiec")
    assert (error.value.code, error.value.where) == ("PLC006", name)


@pytest.mark.needs(variable="ROSPLC_BEREMIZ")
@pytest.mark.timeout(900)
def test_every_type_for_matiec(tmp_path: Path) -> None:
    """No name of a field is a word of matiec's, or a macro of the headers that its C includes."""
    generate_types("jazzy", tmp_path, plc="matiec")
    matiec = Path(os.environ["ROSPLC_BEREMIZ"]) / "matiec"
    (tmp_path / "all.st").write_text(
        (tmp_path / "rosplc.st").read_text()
        + "PROGRAM Empty\nVAR x : BOOL; END_VAR\nx := TRUE;\nEND_PROGRAM\n"
    )
    command = [
        str(matiec / "iec2c"),
        "-I",
        str(matiec / "lib"),
        "-T",
        str(tmp_path),
        str(tmp_path / "all.st"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    paths = [tmp_path, tmp_path / "generated", matiec / "lib" / "C"]
    command = ["gcc", "-std=gnu11", "-w", "-fsyntax-only", *(f"-I{path}" for path in paths)]
    source = str(tmp_path / "generated" / "rosplc_blocks.c")
    done = subprocess.run([*command, source], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
