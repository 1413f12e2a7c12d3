"""The Read and the Write function block of a message type.

Both extend the hand-written base (``templates/base``), which opens, checks, watches and counts.
What needs the type stands here: the copy between slot and DUT, and the checks that make a
record safe to use (counts within their arrays, strings with an end).
"""

from __future__ import annotations

from dataclasses import dataclass

from rosplc.layout import Layout
from rosplc.layout.nodes import ArrayNode, Member, PaddingNode, SequenceNode, StringNode, StructNode
from rosplc.plc.names import Scope
from rosplc.plc.project import Method, Pou, VarBlock, Variable
from rosplc.plc.types import DutBuilder

__all__ = ["BlockNames", "degrade", "mend", "pin_inputs", "pins_of", "read_block", "write_block"]


@dataclass(frozen=True)
class BlockNames:
    """The names of a type's two function blocks."""

    read: str
    write: str


def read_block(layout: Layout, builder: DutBuilder, name: str, folder: str, *, pins: bool = False) -> Pou:
    """Return ``<Type>_Read``.

    Args:
        layout: The message's layout.
        builder: Has built, or builds, the DUTs.
        name: The block's name.
        folder: The object's folder in the project.
        pins: Add an output for each top-level field, for Ladder and Function Block Diagram.
    """
    dut = builder.add(layout)
    low, high = layout.layout_id_words
    pin_list = pins_of(layout, builder) if pins else []
    outputs = [Variable("msg", dut, None, "the message")]
    outputs += [Variable(pin, type_, None, f"msg.{field}") for pin, field, type_ in pin_list]
    assigns = "".join(f"\n{pin} := msg.{field};" for pin, field, _ in pin_list)
    body = f"""IF NOT Enter() THEN
    RETURN;
END_IF;
IF BeginRead(udiLayoutLo := 16#{low:08X}, udiLayoutHi := 16#{high:08X}, udiRecordSize := {layout.size}) THEN
    Receive();
END_IF;
EndRead();
Degrade();{assigns}"""
    methods = (
        Method(
            "Next",
            (),
            f"""Next := FALSE;
IF NOT Enter() THEN
    RETURN;
END_IF;
udiSilent := udiSilent + udiElapsed; // a call that watches no beat must not swallow its time
IF xInOrder AND xAttached AND (uiTaken < uiMaxPerScan) AND NOT xDelayed THEN
    xNew := FALSE;
    xRecovered := FALSE;
    IF Receive() THEN
        Next := xNew;
    END_IF;
END_IF;
EndRead();
Degrade();{assigns}""",
            "BOOL",
            comment="In order: the next message of this scan. FALSE: none left, uiMaxPerScan or xDelayed.",
        ),
        Method(
            "Receive",
            (
                VarBlock(
                    "VAR",
                    (Variable("pbRecord", "POINTER TO BYTE"), Variable("pstRecord", f"POINTER TO {dut}")),
                ),
            ),
            """Receive := FALSE;
IF Confirm() THEN
    Mend();
    msg := stShadow;
    Receive := TRUE;
END_IF;
pbRecord := Candidate();
WHILE pbRecord <> 0 DO
    pstRecord := pbRecord;
    stShadow := pstRecord^;
    pbRecord := 0;
    IF Accept() THEN
        Mend();
        msg := stShadow;
        Receive := TRUE;
    ELSIF NOT xPending THEN
        pbRecord := Candidate();
    END_IF;
END_WHILE;""",
            "BOOL",
            "PRIVATE",
            "Copies into the shadow, proves the copy, then moves it to msg.",
        ),
        degrade(),
        mend(layout, builder),
    )
    blocks = (
        VarBlock("VAR_INPUT", (Variable("stSafe", dut, None, "msg when stale, with uiOnStale = 2"),)),
        VarBlock("VAR_OUTPUT", tuple(outputs)),
        VarBlock("VAR", (Variable("stShadow", dut),)),
    )
    return Pou(
        name, "FUNCTION_BLOCK", blocks, body, methods, "RosPlc_Reader",
        comment=f"Reads {layout.type_name} from a topic of ROS. Layout {layout.layout_id}.", folder=folder,
    )  # fmt: skip


def write_block(layout: Layout, builder: DutBuilder, name: str, folder: str, *, pins: bool = False) -> Pou:
    """Return ``<Type>_Write``; arguments as of :func:`read_block`, ``pins`` adds inputs."""
    dut = builder.add(layout)
    low, high = layout.layout_id_words
    pin_list = pins_of(layout, builder) if pins else []
    inputs, use_pins = pin_inputs(dut, pin_list)
    body = f"""IF NOT Enter() THEN
    RETURN;
END_IF;{use_pins}
IF BeginWrite(udiLayoutLo := 16#{low:08X}, udiLayoutHi := 16#{high:08X}, udiRecordSize := {layout.size}) THEN
    PublishFilled();
    IF xEnable THEN
        pbRecord := OpenSlot();
        pstRecord := pbRecord;
        pstRecord^ := msg;
        CloseSlot();
    END_IF;
END_IF;
EndWrite();"""
    blocks = (
        VarBlock("VAR_INPUT", tuple(inputs)),
        VarBlock(
            "VAR", (Variable("pbRecord", "POINTER TO BYTE"), Variable("pstRecord", f"POINTER TO {dut}"))
        ),
    )
    return Pou(
        name, "FUNCTION_BLOCK", blocks, body, (), "RosPlc_Writer",
        comment=f"Writes {layout.type_name} to a topic of ROS. Layout {layout.layout_id}.", folder=folder,
    )  # fmt: skip


def degrade() -> Method:
    """Return the method that makes of a stale ``msg`` what was asked for."""
    return Method(
        "Degrade",
        (),
        """IF xStale AND (uiOnStale = 1) THEN
    SysMemSet(ADR(msg), 0, SIZEOF(msg));
    xSubstituted := TRUE;
ELSIF xStale AND (uiOnStale = 2) THEN
    msg := stSafe;
    xSubstituted := TRUE;
END_IF;
Degrade := xStale;""",
        "BOOL",
        "PRIVATE",
        "What msg is while it is stale: at every scan, so that a state found at the start does not show.",
    )


def pin_inputs(dut: str, pin_list: list[tuple[str, str, str]]) -> tuple[list[Variable], str]:
    """Return a Write block's inputs, msg and the pins, and the statements that use the pins."""
    inputs = [Variable("msg", dut, None, "the message")]
    inputs += [Variable(pin, type_, None, f"msg.{field}, with xUsePins") for pin, field, type_ in pin_list]
    if not pin_list:
        return inputs, ""
    inputs.append(Variable("xUsePins", "BOOL", None, "the pins are copied into msg at each call"))
    assigns = "".join(f"\n    msg.{field} := {pin};" for pin, field, _ in pin_list)
    return inputs, f"\nIF xUsePins THEN{assigns}\nEND_IF;"


def pins_of(layout: Layout, builder: DutBuilder) -> list[tuple[str, str, str]]:
    """Return (pin, member, type) for each top-level field; counts are fields too."""
    names = builder.struct(layout.root)
    types = {v.name: v.type for v in next(d for d in builder.duts if d.name == names.dut).members}
    scope = Scope()  # nothing in the base blocks begins with pin_
    result = []
    for name, member in zip(names.names, layout.root.members, strict=True):
        if not isinstance(member.node, PaddingNode):
            result.append((scope.give(f"pin_{name}"), name, types[name]))
    return result


def mend(layout: Layout, builder: DutBuilder) -> Method:
    """Return the method that clamps counts and ends strings, so that a faulty writer stays harmless."""
    lines: list[str] = []
    depth = _mend_struct(layout.root, "stShadow", builder, lines, 0)
    variables = tuple(Variable(f"udi{i}", "UDINT") for i in range(depth))
    pointers = (Variable("pbEnd", "POINTER TO BYTE"),) if any("pbEnd" in line for line in lines) else ()
    blocks = (VarBlock("VAR", pointers + variables),) if pointers + variables else ()
    comment = "Keeps counts within their arrays and gives every string an end, whatever the slot held."
    return Method("Mend", blocks, "\n".join([*lines, "Mend := TRUE;"]), "BOOL", "PRIVATE", comment)


def _mend_struct(node: StructNode, path: str, builder: DutBuilder, lines: list[str], depth: int) -> int:
    """Append the statements for a struct; return how many loop variables they need."""
    names = builder.struct(node)
    deepest = depth
    for member in node.members:
        deepest = max(
            deepest, _mend_member(node, member, f"{path}.{names.of(node, member)}", builder, lines, depth)
        )
    return deepest


def _mend_member(
    node: StructNode, member: Member, path: str, builder: DutBuilder, lines: list[str], depth: int
) -> int:
    indent = "    " * depth
    inner = member.node
    if member.count_of:
        sequence = next(m.node for m in node.members if m.name == member.count_of and not m.count_of)
        if isinstance(sequence, SequenceNode):
            lines.append(f"{indent}IF {path} > {sequence.capacity} THEN")
            lines.append(f"{indent}    {path} := {sequence.capacity};")
            lines.append(f"{indent}END_IF;")
        return depth
    if isinstance(inner, StringNode):
        _end_string(inner, path, lines, indent)
        return depth
    if isinstance(inner, StructNode):
        return _mend_struct(inner, path, builder, lines, depth)
    if isinstance(inner, (ArrayNode, SequenceNode)) and isinstance(inner.element, (StringNode, StructNode)):
        length = inner.length if isinstance(inner, ArrayNode) else inner.capacity
        body: list[str] = []
        element = f"{path}[udi{depth}]"
        if isinstance(inner.element, StringNode):
            _end_string(inner.element, element, body, indent + "    ")
            deepest = depth + 1
        else:
            deepest = _mend_struct(inner.element, element, builder, body, depth + 1)
        if body:
            lines += [f"{indent}FOR udi{depth} := 0 TO {length - 1} DO", *body, f"{indent}END_FOR;"]
            return deepest
    return depth


def _end_string(node: StringNode, path: str, lines: list[str], indent: str) -> None:
    lines.append(f"{indent}pbEnd := ADR({path});")
    lines.append(f"{indent}pbEnd := pbEnd + {node.capacity};")
    lines.append(f"{indent}pbEnd^ := 0;")
