"""rosplc's channel with the PLC's half as generated Structured Text, compiled on this machine.

Only in a checkout of the sources, where the translator is: it needs blark, whose licence keeps it
out of what rosplc depends on.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from rosplc.bench.arrangements import CYCLIC, TWO_CORES
from rosplc.bench.compiling import compile_program
from rosplc.bench.contenders.base import CYCLE, SPINS, Contender, Place, start_pair
from rosplc.bench.contenders.native import objects
from rosplc.bench.contenders.registers import ANSWER, QUESTION, layout
from rosplc.bench.missing import Missing
from rosplc.bench.pair import Pair
from rosplc.demo.st.checkout import Translator, find_translator
from rosplc.errors import SetupError
from rosplc.plc.build import PlcTask, PlcTopic, build_project
from rosplc.plc.project import Dut, Gvl, Pou
from rosplc.plc.st_text import object_text

__all__ = ["ROSPLC_ST"]

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
    items: list[Dut | Gvl | Pou] = [*project.duts, *project.gvls, *project.pous]
    return {**{item.name: object_text(item) for item in items}, "PLC_PRG": _PROGRAM}


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


def _start(place: Place) -> Pair:
    try:
        translator = find_translator()
    except SetupError as error:
        remedy = "run `rosplc bench` from a checkout of the sources, after `make setup` there"
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
    {TWO_CORES.name: SPINS, **{each.name: CYCLE for each in CYCLIC}},
    _start,
)
