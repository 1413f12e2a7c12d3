"""The codec of one message type, wire bytes to record and back, and the plan that the C core executes for it.

A plan is lists of ops; the table of what each does heads ``_core/plan_ops.h``.

Neighbouring numbers become one COPY wherever their record offsets adjoin and the wire provably has no gap
between them. For CDR the wire position is tracked modulo the largest alignment since the last string or
sequence, whose length is not known before a message comes.
"""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rosplc._core import Fault, Plan
from rosplc.errors import CodecError, MessageTypeError
from rosplc.layout import Layout
from rosplc.layout.nodes import ArrayNode, Node, PaddingNode, ScalarNode, SequenceNode, StringNode, StructNode

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer


class Wire(enum.Enum):
    """The format of messages on the wire; a plan's head contains these values.

    ``CDR`` is the format of ROS 2: plain CDR version 1 after a 4-byte encapsulation header (OMG
    DDS-XTypes 1.3, section 7.4.1). Both byte orders are read; little-endian is written. ``ROS1``
    is the format of ROS 1: little-endian without alignment.
    """

    CDR = 0
    ROS1 = 1


MAX_LOOPS = 32  # Loops inside loops that the executor runs (`RP_MAX_DEPTH`).

SEQ_OF_BOOL = 1  # Flag of SEQ: the elements are bools.

_HEAD = struct.Struct("<6I")
_OP = struct.Struct("<4B8I")
_MAGIC = int.from_bytes(b"RPLN", "little")


class OpCode(enum.IntEnum):
    """What an op does."""

    COPY = 1
    SWAP = 2
    BOOLS = 3
    ZERO = 4
    SKIP = 5
    STRING = 6
    SEQ = 7
    LOOP = 8
    ARRAY = 9


@dataclass(slots=True)
class Op:
    """One op."""

    code: OpCode  # what it does
    path: str  # the field that it is about, for error messages; not part of the binary form
    at: int = 0  # record offset in bytes, from the start of the record or of the enclosing loop's element
    n: int = 0  # bytes, elements, or capacity, depending on the code
    align: int = 1  # alignment on the wire in bytes
    width: int = 1  # bytes of one number whose bytes are swapped; 1 for none
    flags: int = 0  # ``SEQ_OF_BOOL``
    count_at: int = 0  # record offset of a sequence's count
    stride: int = 0  # bytes from one element to the next
    room: int = 0  # bytes from ``at`` that the op fills, the padding behind it included
    bound: int = 0  # the definition's own bound; 0 for none
    # for loops the number of ops that follow and belong to it; for BOOLS how many bytes before the
    # wire position they begin
    body: int = 0

    def pack(self) -> bytes:
        """Return the op as the C core reads it."""
        return _OP.pack(
            self.code, self.align, self.width, self.flags,
            self.at, self.n, self.count_at, self.stride, self.room, self.bound, self.body, 0,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Flat:
    """A struct or number without gaps, whose wire bytes are its record bytes."""

    first: int  # alignment of its first number in bytes: where CDR starts it
    widest: int  # alignment that the whole needs to be free of gaps, in bytes
    uniform: bool  # all numbers have the same width (then swapping needs no structure)


def flat_form(node: Node) -> Flat | None:
    """Return how ``node`` is flat, or None if anything but numbers is in it.

    Not flat: bools, whose values are checked, and structs with padding, which CDR lacks at a struct's end.
    """
    if isinstance(node, ScalarNode):
        return None if node.kind == "bool" else Flat(node.size, node.size, True)
    if isinstance(node, ArrayNode):
        return flat_form(node.element) if node.capacity else None
    if not isinstance(node, StructNode) or not node.members:
        return None
    parts = [flat_form(member.node) for member in node.members]
    known = [part for part in parts if part is not None]
    if len(known) != len(parts) or any(member.count_of for member in node.members):
        return None
    widest = max(part.widest for part in known)
    uniform = all(part.uniform and part.widest == widest for part in known)
    return Flat(known[0].first, widest, uniform)


@dataclass(frozen=True, slots=True)
class CompiledPlan:
    """A plan before the C core has loaded it."""

    blob: bytes  # what ``_native.Plan`` takes
    # the little-endian list, then the list for big-endian input; a fault's ``op`` is an index into it
    ops: tuple[Op, ...]
    native_count: int  # number of ops in the little-endian list


def compile_plan(root: StructNode, wire: Wire) -> CompiledPlan:
    """Compile the plan for ``wire`` and ``root``, both ways. TYP007 if sequences and arrays nest too deep."""
    native = _OpList(wire, swapped=False)
    native.struct(root, 0, "")
    swapped = _OpList(wire, swapped=True)
    if wire is Wire.CDR:  # ROS 1 is little-endian only
        swapped.struct(root, 0, "")
    ops = (*native.ops, *swapped.ops)
    head = _HEAD.pack(_MAGIC, wire.value, root.size, len(native.ops), len(swapped.ops), 0)
    return CompiledPlan(head + b"".join(op.pack() for op in ops), ops, len(native.ops))


class _OpList:
    def __init__(self, wire: Wire, *, swapped: bool) -> None:
        self.ops: list[Op] = []
        self._cdr = wire is Wire.CDR
        self._swapped = swapped
        self._modulus = 8  # the wire position is known to be `_position` modulo this
        self._position = 0
        self._run: Op | None = None  # the last COPY or SWAP, as long as it can grow
        self._bools: list[tuple[Op, int]] = []  # BOOLS of the run, and where in it they begin
        self._filler: Op | None = None  # the last op, if it can take padding behind it along
        self._loops = 0

    def struct(self, node: StructNode, base: int, path: str) -> None:
        """Add the members of a struct that starts at record offset ``base``."""
        if node.empty:
            if self._cdr:
                # rosidl gives a message without fields one dummy byte; ROS 1 sends nothing
                self._add(Op(OpCode.SKIP, path, n=1))
                self._advance(1)
            self._padding(base, node.size, path)
            return
        counts: dict[str, int] = {}
        for member in node.members:
            at = base + member.offset
            if member.count_of is not None:
                counts[member.count_of] = at
                self._end_run()
                continue
            inner = f"{path}.{member.name}" if path else member.name
            count_at = counts.get(member.name, 0)
            self._node(member.node, at, count_at, inner)

    def _node(self, node: Node, at: int, count_at: int, path: str) -> None:
        if isinstance(node, ScalarNode):
            self._numbers(node.kind == "bool", Flat(node.size, node.size, True), at, node.size, path)
        elif isinstance(node, StringNode):
            bound = node.bound or 0
            self._add(Op(OpCode.STRING, path, at, node.capacity, room=node.size, bound=bound), fills=True)
            self._forget_position()
        elif isinstance(node, PaddingNode):
            self._padding(at, node.size, path)
        elif isinstance(node, StructNode):
            self.struct(node, at, path)
        elif isinstance(node, ArrayNode):
            self._array(node, at, path)
        else:
            self._sequence(node, at, count_at, path)

    def _array(self, node: ArrayNode, at: int, path: str) -> None:
        element = node.element
        flat = self._whole(element)
        if isinstance(element, ScalarNode) and element.kind == "bool":
            self._numbers(True, Flat(1, 1, True), at, node.size, path)
        elif flat is not None:
            self._numbers(False, flat, at, node.size, path)
        else:
            op = Op(OpCode.ARRAY, path, at, node.capacity, stride=node.stride, room=node.size)
            self._loop(op, element, path)

    def _sequence(self, node: SequenceNode, at: int, count_at: int, path: str) -> None:
        element = node.element
        is_bool = isinstance(element, ScalarNode) and element.kind == "bool"
        self._forget_position()  # an element's alignment must hold whatever comes before it
        flat = Flat(1, 1, True) if is_bool else self._whole(element)
        op = Op(
            OpCode.LOOP if flat is None else OpCode.SEQ, path, at, node.capacity,
            count_at=count_at, stride=node.stride, room=node.size, bound=node.bound or 0,
        )  # fmt: skip
        if flat is None:
            self._loop(op, element, path)
            return
        op.align = flat.first if self._cdr else 1
        op.width = flat.widest if self._swapped else 1
        op.flags = SEQ_OF_BOOL if is_bool else 0
        self._add(op, fills=True)
        self._forget_position()

    def _whole(self, element: Node) -> Flat | None:
        """Return the element's flat form if a row of such elements is one piece on this wire."""
        flat = flat_form(element)
        if flat is None or (self._swapped and not flat.uniform):
            return None
        if self._cdr and flat.first != flat.widest:
            known = self._modulus >= flat.widest and self._position % flat.widest == 0
            return flat if known else None
        return flat

    def _numbers(self, is_bool: bool, flat: Flat, at: int, size: int, path: str) -> None:
        """Add ``size`` bytes of numbers: to the run before them if both sides provably adjoin."""
        if size == 0:
            return
        adjoins = self._align(flat.first)
        run = self._run
        if self._swapped and flat.widest > 1:
            width = flat.widest
            grows = adjoins and run is not None and run.code is OpCode.SWAP and run.width == width
            if grows and run is not None and run.at + run.n * width == at:
                run.n += size // width
            else:
                self._add(Op(OpCode.SWAP, path, at, size // width, width=width))
                self._run = self.ops[-1]
            self._advance(size)
            return
        if adjoins and run and run.code is OpCode.COPY and run.at + run.n == at:
            run.n += size
            for op, start in self._bools:
                op.body = run.n - start
        else:
            run = Op(OpCode.COPY, path, at, size, align=flat.first if self._cdr else 1)
            self._add(run)
            self._run = run
        if is_bool:
            self.ops.append(Op(OpCode.BOOLS, path, n=size, body=size))
            self._bools.append((self.ops[-1], run.n - size))
        self._advance(size)

    def _loop(self, op: Op, element: Node, path: str) -> None:
        if self._loops == MAX_LOOPS:
            raise MessageTypeError("TYP007", f"sequences are nested more than {MAX_LOOPS} deep", where=path)
        self._add(op)
        start = len(self.ops)
        self._forget_position()
        self._loops += 1
        self._node(element, 0, 0, f"{path}[]")
        self._loops -= 1
        op.body = len(self.ops) - start
        self._end_run()
        self._forget_position()
        self._filler = op

    def _padding(self, at: int, size: int, path: str) -> None:
        filler = self._filler
        if filler is not None and filler.at + filler.room == at:
            filler.room += size
            filler.n += size if filler.code is OpCode.ZERO else 0
            return
        self.ops.append(Op(OpCode.ZERO, path, at, size, room=size))
        self._filler = self.ops[-1]

    def _add(self, op: Op, *, fills: bool = False) -> None:
        self._end_run()
        self.ops.append(op)
        self._filler = op if fills else None

    def _end_run(self) -> None:
        self._run = None
        self._bools = []
        self._filler = None

    def _align(self, width: int) -> bool:
        """Move to the next multiple of ``width``; return whether it is known that this skips nothing."""
        if not self._cdr:
            return True
        if self._modulus < width:
            self._modulus, self._position = width, 0
            return False
        gap = -self._position % width
        self._position = (self._position + gap) % self._modulus
        return gap == 0

    def _advance(self, size: int) -> None:
        self._position = (self._position + size) % self._modulus

    def _forget_position(self) -> None:
        self._modulus, self._position = 1, 0


TRUNCATED = 2  # Bit of the flags: something was cut off to fit (spec/shm-format.md, section 5).


class Codec:
    """Converts messages in one wire format to records of one layout, and back.

    By default, ``wire`` is the format of the layout's ROS version. ``plan`` is the plan that the C core
    executes. Raises MessageTypeError TYP007 if sequences are nested too deeply.
    """

    def __init__(self, layout: Layout, wire: Wire | None = None) -> None:
        wire = wire or (Wire.ROS1 if layout.store.ros_version == 1 else Wire.CDR)
        compiled = compile_plan(layout.root, wire)
        self.layout = layout
        self.wire = wire
        self.plan = Plan(compiled.blob)
        self._ops = compiled.ops

    def decode(self, data: ReadableBuffer, *, truncate: bool = False) -> bytes:
        """Return the record of a complete message; in CDR, the message includes its encapsulation header.

        With ``truncate``, strings and sequences that do not fit are truncated instead of refused. Raises
        CodecError COD001 to COD008, with the field's path, the size and the limit.
        """
        try:
            return self.plan.decode(data, truncate)[0]
        except Fault as fault:
            raise self.explain(fault) from None

    def decode_into(self, data: ReadableBuffer, out: WriteableBuffer, *, truncate: bool = False) -> int:
        """Write the record of a message to ``out`` and return its flags (``TRUNCATED`` or 0).

        Every byte of ``out`` is written; after an error, its contents are undefined. Raises the errors of
        :meth:`decode`, and COD009 if ``out`` is not the size of a record.
        """
        try:
            return self.plan.decode_into(data, out, truncate)
        except Fault as fault:
            raise self.explain(fault) from None

    def encode(self, record: ReadableBuffer) -> bytes:
        """Return the little-endian message of a record.

        A CDR message has a 4-byte encapsulation header and is padded to a multiple of 4 bytes, as
        DDS requires. Every record yields a message: a count above the capacity is read as the
        capacity, a string without NUL fills its capacity, and any bool other than 0 is 1.

        Raises CodecError: COD009 if ``record`` is not the size of a record.
        """
        try:
            return self.plan.encode(record)
        except Fault as fault:
            raise self.explain(fault) from None

    def explain(self, fault: Fault | tuple[int, int, int, int]) -> CodecError:
        """Return the error for a fault of this codec's plan, with the field's path, size and limit."""
        number, op, size, limit = fault.args if isinstance(fault, Fault) else fault
        path = self._ops[op].path if op < len(self._ops) else ""
        bound = bool(op < len(self._ops) and self._ops[op].bound and limit == self._ops[op].bound)
        what = _WHAT[number].format(size=size, limit=limit)
        remedy = ""
        if number == 4 and bound:
            what = f"string has {size} bytes, but the type itself allows at most {limit}"
            remedy = "The sender uses a different definition of the type; this bound cannot be raised."
        if number == 7 and limit == size - 1 and self.wire is Wire.CDR:
            what = f"string of {size} bytes does not end with a NUL"
        where = f"{self.layout.type_name}: {path}" if path else self.layout.type_name
        return CodecError(f"COD{number:03d}", what, where=where, remedy=remedy)


_WHAT = {
    1: "message ends too early: it has {limit} bytes, but needs at least {size}",
    2: "message has {size} bytes, but its content takes at most {limit}",
    3: "encapsulation 0x{size:04x} is neither 0x0000 nor 0x0001",
    4: "string has {size} bytes; the limit is {limit}",
    5: "sequence has {size} elements; the limit is {limit}",
    6: "bool has the value {size} instead of 0 or 1",
    7: "string of {size} bytes contains a NUL at byte {limit}",
    8: "sequence has {size} elements, but the type itself allows at most {limit}",
    9: "buffer has {size} bytes instead of {limit}",
}
