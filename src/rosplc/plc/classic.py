"""The blocks of classic topics: a bare record under a named semaphore, as the source thesis has it.

They stand beside the default blocks and are used like them, so that a program sees ``msg``,
``xValid``, ``xNew``, ``xStale`` or ``xEnable`` either way. ``FB_Init`` takes both names, opens
or makes memory and semaphore; ``MEM_Read`` and ``MEM_Write`` copy under the lock, and the block's
own call is what calls them. The hand-written rest stands in ``templates/classic``.
"""

from __future__ import annotations

from dataclasses import dataclass

from rosplc.errors import GenerationError
from rosplc.layout import Layout
from rosplc.plc.base import read_objects
from rosplc.plc.blocks import degrade, mend, pin_inputs, pins_of
from rosplc.plc.literals import string_literal
from rosplc.plc.project import Dut, Gvl, Method, Pou, VarBlock, Variable
from rosplc.plc.types import DutBuilder

__all__ = [
    "CLASSIC_NAMES", "LIBRARY", "LONGEST_NAME", "Classic", "check_classic", "classic_arguments",
    "classic_objects", "classic_read_block", "classic_wait", "classic_write_block",
]  # fmt: skip

CLASSIC_NAMES = ("RosPlc_ClassicState", "RosPlc_Classic", "RosPlc_ClassicReader", "RosPlc_ClassicWriter")
"""Names that no generated object may take, whether or not a project has classic topics."""

LIBRARY = "SysSemProcess"
LONGEST_NAME = 80  # characters: SysShm and SysSemProcess take a STRING


@dataclass(frozen=True)
class Classic:
    """Where a classic topic lies.

    Attributes:
        name: The shared memory's name, without a slash.
        semaphore: The semaphore's; empty if nothing guards the memory.
        wait_ns: How long an access waits for the lock at most.
    """

    name: str
    semaphore: str
    wait_ns: int = 2_000_000


def classic_objects(folder: str) -> tuple[Dut | Gvl | Pou, ...]:
    """Return the hand-written objects that classic blocks extend."""
    return read_objects("classic", CLASSIC_NAMES, folder)


def check_classic(topic: str, classic: Classic) -> None:
    """Raise what makes a name impossible: GenerationError PLC007."""
    for name in (classic.name, classic.semaphore):
        plain = all("!" <= char <= "~" and char != "/" for char in name)
        if len(name) > LONGEST_NAME or not plain or not classic.name:
            raise GenerationError("PLC007", f"{name!r} is none", where=topic)


def classic_arguments(classic: Classic) -> tuple[tuple[str, str], ...]:
    """Return FB_Init's arguments."""
    return (
        ("sMemory", string_literal(classic.name)),
        ("sSemaphore", string_literal(classic.semaphore)),
    )


def classic_wait(classic: Classic, cycle_ns: int) -> int:
    """Return how long a block may wait for the lock, in ms: never more than half of its task's cycle.

    Args:
        classic: The topic.
        cycle_ns: The task's interval; 0 if it has none.
    """
    wait = -(-classic.wait_ns // 1_000_000)
    return min(wait, cycle_ns // 2_000_000) if cycle_ns else wait


def classic_read_block(
    layout: Layout, builder: DutBuilder, name: str, folder: str, *, pins: bool = False
) -> Pou:
    """Return ``<Type>_ClassicRead``; arguments as of :func:`rosplc.plc.blocks.read_block`."""
    dut = builder.add(layout)
    pin_list = pins_of(layout, builder) if pins else []
    outputs = [Variable("msg", dut, None, "the message")]
    outputs += [Variable(pin, type_, None, f"msg.{field}") for pin, field, type_ in pin_list]
    assigns = "".join(f"\n{pin} := msg.{field};" for pin, field, _ in pin_list)
    body = f"""IF NOT Begin(udiRecordSize := {layout.size}) THEN
    RETURN;
END_IF;
xNew := FALSE;
MEM_Read();
EndRead();
Degrade();{assigns}"""
    methods = (
        _init(layout),
        Method(
            "MEM_Read",
            (_locals(dut, Variable("xChanged", "BOOL")),),
            f"""MEM_Read := FALSE;
IF NOT Lock() THEN
    RETURN;
END_IF;
pbRecord := pbMemory;
pstRecord := pbRecord;
stShadow := pstRecord^;
Unlock();
Mend();
xChanged := SysMemCmp(ADR(stShadow), ADR(stImage), {layout.size}) <> 0;
IF Take(pbRecord := ADR(stShadow), xChanged := xChanged) THEN
    msg := stShadow;
END_IF;
IF xChanged THEN
    stImage := stShadow;
END_IF;
MEM_Read := TRUE;""",
            "BOOL",
            comment="Copies the record under the lock; the block's own call does this. FALSE: msg is kept.",
        ),
        degrade(),
        mend(layout, builder),
    )
    blocks = (
        VarBlock("VAR_INPUT", (Variable("stSafe", dut, None, "msg when stale, with uiOnStale = 2"),)),
        VarBlock("VAR_OUTPUT", tuple(outputs)),
        VarBlock(
            "VAR",
            (
                Variable("stShadow", dut),
                Variable("stImage", dut, None, "the record as it was looked at last"),
            ),
        ),
    )
    comment = f"Reads {layout.type_name} from a classic memory of {layout.size} bytes."
    return Pou(
        name, "FUNCTION_BLOCK", blocks, body, methods, "RosPlc_ClassicReader", comment=comment, folder=folder
    )


def classic_write_block(
    layout: Layout, builder: DutBuilder, name: str, folder: str, *, pins: bool = False
) -> Pou:
    """Return ``<Type>_ClassicWrite``; arguments as of :func:`rosplc.plc.blocks.read_block`."""
    dut = builder.add(layout)
    pin_list = pins_of(layout, builder) if pins else []
    inputs, use_pins = pin_inputs(dut, pin_list)
    body = f"""IF NOT Begin(udiRecordSize := {layout.size}) THEN
    RETURN;
END_IF;{use_pins}
xDone := FALSE;
IF xEnable THEN
    xDone := MEM_Write();
END_IF;
EndWrite(xWritten := xDone);"""
    methods = (
        _init(layout),
        Method(
            "MEM_Write",
            (_locals(dut),),
            """MEM_Write := FALSE;
IF NOT Lock() THEN
    RETURN;
END_IF;
pbRecord := pbMemory;
pstRecord := pbRecord;
pstRecord^ := msg;
Unlock();
MEM_Write := TRUE;""",
            "BOOL",
            comment="Copies msg under the lock; the block's own call does this. FALSE: not now.",
        ),
    )
    blocks = (
        VarBlock("VAR_INPUT", tuple(inputs)),
        VarBlock("VAR", (Variable("xDone", "BOOL"),)),
    )
    comment = f"Writes {layout.type_name} to a classic memory of {layout.size} bytes."
    return Pou(
        name, "FUNCTION_BLOCK", blocks, body, methods, "RosPlc_ClassicWriter", comment=comment, folder=folder
    )


def _locals(dut: str, *more: Variable) -> VarBlock:
    pointers = (Variable("pbRecord", "POINTER TO BYTE"), Variable("pstRecord", f"POINTER TO {dut}"))
    return VarBlock("VAR", (*pointers, *more))


def _init(layout: Layout) -> Method:
    """Return the constructor: here and not in the base, which does not know the record's size."""
    inputs = VarBlock(
        "VAR_INPUT",
        (
            Variable("bInitRetains", "BOOL"),
            Variable("bInCopyCode", "BOOL"),
            Variable("sMemory", "STRING(80)"),
            Variable("sSemaphore", "STRING(80)"),
        ),
    )
    names = "sMemory := sMemory, sSemaphore := sSemaphore"
    code = f"""Prepare({names}, udiRecordSize := {layout.size}, xCopy := bInCopyCode);
FB_Init := TRUE;"""
    comment = (
        "The names of memory and semaphore, without a slash; '' as semaphore: nothing guards the memory."
    )
    return Method("FB_Init", (inputs,), code, "BOOL", comment=comment)
