"""Conversions, literals and operators: what may be stored where, and arithmetic at the processor's width.

CODESYS computes intermediate results in registers: the difference of two UDINTs that wraps is
a large number on a 64-bit processor until a UDINT holds it. The C text does the same: operands
are widened to ``cpu_bits``, and only assignments, parameters and conversions cut them off.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from rosplc_st.translator import types as t
from rosplc_st.translator.declarations import Place, Program
from rosplc_st.translator.source import TranslationError
from rosplc_st.translator.types import (
    ANY_INT,
    ANY_REAL,
    BOOL,
    ELEMENTARY,
    NANOSECONDS,
    Array,
    Elementary,
    Pointer,
    String,
    Type,
    Value,
    c_string,
)


class Conversions:
    """Conversions at a place in a text; ``program`` knows the processor's width."""

    program: Program
    here: Place

    # ---- types of results

    def width(self, type_: Elementary) -> str:
        """Return the C type in which a value of a type is computed."""
        bits = max(type_.bits, self.program.cpu_bits)
        return f"{'' if type_.signed else 'u'}int{bits}_t"

    def common(self, a: Elementary, b: Elementary) -> Elementary:
        """Return the type in which two integers are computed."""
        if a.bits == b.bits:
            if a.signed != b.signed:
                raise self.here.error(f"{a.name} and {b.name} in one expression: the sign is ambiguous")
            return a if a.kind == "int" else b
        wide, narrow = (a, b) if a.bits > b.bits else (b, a)
        if narrow.signed and not wide.signed:
            raise self.here.error(f"{a.name} and {b.name} in one expression: the sign is ambiguous")
        return wide

    def pair(self, a: Value, b: Value) -> tuple[Elementary, Value, Value]:
        """Return the common integer type of two operands, literals adapted."""
        ta, tb = a.type, b.type
        assert isinstance(ta, Elementary) and isinstance(tb, Elementary)
        if ta is ANY_INT and tb is ANY_INT:
            return ANY_INT, a, b
        if ta is ANY_INT:
            ta, a = self.adapt(a, tb)
        elif tb is ANY_INT:
            tb, b = self.adapt(b, ta)
        return self.common(ta, tb), a, b

    def adapt(self, literal: Value, other: Elementary) -> tuple[Elementary, Value]:
        """Return the type and value of a literal beside an operand of another type."""
        assert isinstance(literal.constant, int)
        if t.fits(literal.constant, other):
            return other, self.number(literal.constant, other)
        type_ = t.smallest(literal.constant)
        if literal.constant >= 0 and other.signed:
            type_ = next(
                e for e in map(ELEMENTARY.__getitem__, ("INT", "DINT", "LINT")) if t.fits(literal.constant, e)
            )
        return type_, self.number(literal.constant, type_)

    @staticmethod
    def number(value: int, type_: Type | None = ANY_INT) -> Value:
        """Return an integer constant."""
        if value >= 1 << 63:
            code = f"{value}ULL"
        elif value == -(1 << 63):
            code = "(-9223372036854775807LL - 1)"
        else:
            code = f"({value}LL)" if value < 0 else f"{value}LL"
        return Value(code, type_, value)

    # ---- storing

    def convert(self, value: Value, target: Type) -> str:
        """Return C code of a value as it is stored in a variable of a type; refuse what CODESYS refuses."""
        source = value.type
        if isinstance(target, Elementary):
            if not isinstance(source, Elementary):
                raise self.refuse(source, target)
            return self._elementary(value, source, target)
        if isinstance(target, Pointer):
            if isinstance(source, Pointer):
                return value.code
            if isinstance(value.constant, int) and value.constant == 0:
                return "(uint8_t *)0"
            raise self.refuse(source, target)
        if isinstance(target, String) and isinstance(source, String):
            return value.code
        if source == target:
            return value.code
        raise self.refuse(source, target)

    def _elementary(self, value: Value, source: Elementary, target: Elementary) -> str:
        literal = value.constant is not None and isinstance(value.constant, int)
        if target.kind == "bool":
            if source.kind == "bool" or (source is ANY_INT and value.constant in (0, 1)):
                return value.code
            raise self.refuse(source, target)
        if target.kind == "real":
            if source.kind in ("int", "bit") or source is ANY_REAL:
                return f"(({target.c})({value.code}))"
            if source.kind == "real" and source.bits <= target.bits:
                return f"(({target.c})({value.code}))"
            raise self.refuse(source, target)
        if target.kind == "time":
            if source == target:
                return f"(({target.c})({value.code}))"
            if {source.name, target.name} == {"TIME", "LTIME"} and value.constant is not None:
                return self.number(
                    int(value.constant) * NANOSECONDS[source.name] // NANOSECONDS[target.name]
                ).code
            raise self.refuse(source, target)
        if not source.integral:
            raise self.refuse(source, target)
        if literal:
            number = int(value.constant or 0)
            if not t.fits(number, target):
                raise self.here.error(f"{number} does not fit into {target.name}")
            return self.number(number).code
        if source.bits > target.bits:
            raise self.refuse(source, target)
        return f"(({target.c})({value.code}))"

    def refuse(self, source: Type | None, target: Type) -> TranslationError:
        """Return the error of a conversion that CODESYS does not make by itself."""
        return self.here.error(f"cannot convert {self.name(source)} to {self.name(target)}")

    @staticmethod
    def name(type_: Type | None) -> str:
        """Return a type as a person writes it."""
        if type_ is None:
            return "nothing"
        if isinstance(type_, String):
            return f"STRING({type_.length})"
        if isinstance(type_, Pointer):
            return "POINTER"
        if isinstance(type_, Array):
            return f"ARRAY[{type_.low}..{type_.high}]"
        return type_.name


_ESCAPES = {"L": b"\n", "N": b"\n", "P": b"\f", "R": b"\r", "T": b"\t", "$": b"$", "'": b"'"}


def string_bytes(token: str, place: Place) -> bytes:
    """Return the bytes of a string literal, dollar escapes resolved."""
    text, out, index = token[1:-1], bytearray(), 0
    while index < len(text):
        char = text[index]
        if char != "$":
            out += char.encode("latin-1")
            index += 1
            continue
        two = text[index + 1 : index + 3]
        if two[:1].upper() in _ESCAPES:
            out += _ESCAPES[two[:1].upper()]
            index += 2
        elif re.fullmatch("[0-9A-Fa-f]{2}", two):
            out.append(int(two, 16))
            index += 3
        else:
            raise place.error(f"string escape ${two}")
    return bytes(out)


class Literals(Conversions):
    """Translates literals; the methods have the names of blark's nodes."""

    def _typed(self, value: int, node: Any) -> Value:
        if not node.type_name:
            return self.number(value)
        type_ = ELEMENTARY.get(str(node.type_name).upper())
        if type_ is None or not t.fits(value, type_):
            raise self.here.error(f"literal {node.type_name}#{value}")
        if type_.kind == "bool":
            return Value(str(value), BOOL, value)
        if type_.kind == "real":
            return Value(f"{value}.0", type_, float(value))
        return self.number(value, type_)

    def _Integer(self, node: Any) -> Value:
        return self._typed(int(str(node.value).replace("_", "")), node)

    def _based(self, node: Any, base: int) -> Value:
        text = str(node.value).replace("_", "")
        return self._typed(int(text.rpartition("#")[2], base), node)

    def _HexInteger(self, node: Any) -> Value:
        return self._based(node, 16)

    _HexBitString = _HexInteger

    def _BinaryInteger(self, node: Any) -> Value:
        return self._based(node, 2)

    _BinaryBitString = _BinaryInteger

    def _OctalInteger(self, node: Any) -> Value:
        return self._based(node, 8)

    _OctalBitString = _OctalInteger

    def _BitString(self, node: Any) -> Value:
        return self._typed(int(str(node.value).replace("_", "")), node)

    def _Real(self, node: Any) -> Value:
        number = float(str(node.value).replace("_", ""))
        type_ = ELEMENTARY[str(node.type_name).upper()] if node.type_name else ANY_REAL
        return Value(f"({number!r})" if number < 0 else repr(number), type_, number)

    def _Boolean(self, node: Any) -> Value:
        on = str(node.value).upper().rpartition("#")[2] in ("TRUE", "1")
        return Value("1" if on else "0", BOOL, int(on))

    def _String(self, node: Any) -> Value:
        token = str(node.value)
        if not token.startswith("'"):
            raise self.here.error("WSTRING literal")
        data = string_bytes(token, self.here)
        return Value(c_string(data), String(max(len(data), 1)))

    def _duration(self, node: Any, units: dict[str, int]) -> int:
        total = 0.0
        whole = 0
        for unit, factor in units.items():
            text = getattr(node, unit, None)
            if text is not None:
                number = str(text).replace("_", "")
                if "." in number:
                    total += float(number) * factor
                else:
                    whole += int(number) * factor
        total_ns = whole + round(total)
        if node.negative:
            raise self.here.error("negative duration")
        return total_ns

    def _Duration(self, node: Any) -> Value:
        units = {"days": 86400000, "hours": 3600000, "minutes": 60000, "seconds": 1000, "milliseconds": 1}
        ms = self._duration(node, units)
        if ms >= 1 << 32:
            raise self.here.error(f"T#{ms}ms does not fit into TIME")
        return self.number(ms, ELEMENTARY["TIME"])

    def _Lduration(self, node: Any) -> Value:
        ns = 1
        units = {"nanoseconds": ns, "microseconds": 1000, "milliseconds": 10**6, "seconds": 10**9}
        units |= {"minutes": 60 * 10**9, "hours": 3600 * 10**9, "days": 86400 * 10**9}
        return self.number(self._duration(node, units), ELEMENTARY["LTIME"])


_COMPARE = {"=": "==", "<>": "!=", "<": "<", ">": ">", "<=": "<=", ">=": ">="}
_BITS = {"AND": "&", "OR": "|", "XOR": "^"}


class Operators(Conversions):
    """Unary and binary operations."""

    def expression(self, node: Any) -> Value:
        """Translate an expression; the class that knows variables does."""
        raise NotImplementedError

    def _UnaryOperation(self, node: Any) -> Value:
        inner, op = self.expression(node.expr), str(node.op).upper()
        type_ = inner.type
        if not isinstance(type_, Elementary):
            raise self.here.error(f"{op} on {self.name(type_)}")
        if op == "NOT":
            if type_.kind == "bool":
                return Value(f"(!{inner.code})", BOOL, calls=inner.calls)
            if type_.integral and type_ is not ANY_INT:
                return Value(f"(({type_.c})~({inner.code}))", type_, calls=inner.calls)
        elif op in ("-", "+") and type_.kind in ("int", "real"):
            if isinstance(inner.constant, int):
                return self.number(-inner.constant if op == "-" else inner.constant, inner.type)
            if isinstance(inner.constant, float):
                number = -inner.constant if op == "-" else inner.constant
                return Value(f"({number!r})", type_, number)
            if type_.kind == "real":
                return Value(f"({op}{inner.code})", type_, calls=inner.calls)
            if not type_.signed:
                raise self.here.error(f"{op} on {type_.name}")
            return Value(f"({op}({self.width(type_)})({inner.code}))", type_, calls=inner.calls)
        raise self.here.error(f"{op} on {type_.name}")

    def _BinaryOperation(self, node: Any) -> Value:
        a, op = self.expression(node.left), str(node.op).upper()
        b = self.expression(node.right)
        value = self.operation(a, op, b)
        if b.calls and not value.constant:
            # C leaves the order open; CODESYS evaluates from left to right.
            value = self.operation(replace(a, code="st_left"), op, replace(b, code="st_right"))
            code = f"({{ __auto_type st_left = {a.code}; __auto_type st_right = {b.code}; {value.code}; }})"
            value = replace(value, code=code)
        return replace(value, calls=a.calls or b.calls)

    def operation(self, a: Value, op: str, b: Value) -> Value:
        """Translate a binary operation."""
        ta, tb = a.type, b.type
        if isinstance(ta, String) and isinstance(tb, String) and op in _COMPARE:
            return Value(f"(strcmp({a.code}, {b.code}) {_COMPARE[op]} 0)", BOOL)
        if isinstance(ta, Pointer) or isinstance(tb, Pointer):
            return self.pointers(a, op, b)
        if not isinstance(ta, Elementary) or not isinstance(tb, Elementary):
            raise self.here.error(f"{self.name(ta)} {op} {self.name(tb)}")
        if "bool" in (ta.kind, tb.kind):
            return self.bools(a, op, b)
        if "real" in (ta.kind, tb.kind):
            return self.reals(a, op, b)
        if "time" in (ta.kind, tb.kind):
            return self.times(a, op, b)
        type_, a, b = self.pair(a, b)
        if (
            isinstance(a.constant, int)
            and isinstance(b.constant, int)
            and type_ is ANY_INT
            and op not in _COMPARE
        ):
            return self.fold(a.constant, op, b.constant)
        return self.integers(a, op, b, type_)

    def integers(self, a: Value, op: str, b: Value, type_: Elementary) -> Value:
        """Translate an operation on two integers, computed in ``type_``."""
        c = self.width(type_)
        left, right = f"({c})({a.code})", f"({c})({b.code})"
        if op in _COMPARE:
            return Value(f"({left} {_COMPARE[op]} {right})", BOOL)
        if op in ("AND", "OR", "XOR"):
            if (
                type_.kind != "bit"
                and a.constant is None
                and b.constant is None
                and "bit" not in self.kinds(a, b)
            ):
                raise self.here.error(f"{op} on {type_.name}, which is no bit string")
            return Value(f"({left} {_BITS[op]} {right})", type_)
        if op in ("+", "-", "*"):
            return Value(f"({left} {op} {right})", type_)
        if op in ("/", "MOD"):
            checked = f"st_divisor({b.code}, {c_string(str(self.here.file).encode())}, {self.here.line})"
            right = right if b.constant else f"({c}){checked}"
            return Value(f"({left} {'/' if op == '/' else '%'} {right})", type_)
        raise self.here.error(f"operator {op}")

    @staticmethod
    def kinds(*values: Value) -> set[str]:
        """Return the kinds of the values' types."""
        return {v.type.kind for v in values if isinstance(v.type, Elementary)}

    def fold(self, a: int, op: str, b: int) -> Value:
        """Compute an operation on two literals."""
        if op in ("/", "MOD"):
            if b == 0:
                raise self.here.error("division by 0")
            quotient = abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)
            return self.number(quotient if op == "/" else a - b * quotient)
        results = {"+": a + b, "-": a - b, "*": a * b, "AND": a & b, "OR": a | b, "XOR": a ^ b}
        if op not in results:
            raise self.here.error(f"operator {op}")
        return self.number(results[op])

    def bools(self, a: Value, op: str, b: Value) -> Value:
        """Translate an operation on two BOOLs."""
        for value in (a, b):
            if value.type != BOOL and not (value.type is ANY_INT and value.constant in (0, 1)):
                raise self.here.error(f"{self.name(a.type)} {op} {self.name(b.type)}")
        signs = {"AND": "&", "OR": "|", "XOR": "^", "=": "==", "<>": "!="}
        if op not in signs:
            raise self.here.error(f"operator {op} on BOOL")
        return Value(f"(({a.code}) {signs[op]} ({b.code}))", BOOL)

    def reals(self, a: Value, op: str, b: Value) -> Value:
        """Translate an operation where one side is REAL or LREAL."""
        if not self.kinds(a, b) <= {"real", "int", "bit"}:
            raise self.here.error(f"{self.name(a.type)} {op} {self.name(b.type)}")
        typed = [
            v.type
            for v in (a, b)
            if isinstance(v.type, Elementary) and v.type.kind == "real" and v.type is not ANY_REAL
        ]
        type_ = max(typed, key=lambda e: e.bits) if typed else ANY_REAL
        left, right = f"({type_.c})({a.code})", f"({type_.c})({b.code})"
        if op in _COMPARE:
            return Value(f"({left} {_COMPARE[op]} {right})", BOOL)
        if op not in ("+", "-", "*", "/"):
            raise self.here.error(f"operator {op} on {type_.name}")
        return Value(f"({left} {op} {right})", type_)

    def times(self, a: Value, op: str, b: Value) -> Value:
        """Translate an operation where one side is a duration or date."""
        ta, tb = a.type, b.type
        assert isinstance(ta, Elementary) and isinstance(tb, Elementary)
        type_ = ta if ta.kind == "time" else tb
        c = self.width(type_)
        if ta == tb and op in _COMPARE:
            return Value(f"(({c})({a.code}) {_COMPARE[op]} ({c})({b.code}))", BOOL)
        duration = {ta.name, tb.name} <= {"TIME", "LTIME"}
        if ta == tb and op in ("+", "-") and duration:
            return Value(f"(({c})({a.code}) {op} ({c})({b.code}))", type_)
        if ta.name in ("TIME", "LTIME") and tb.integral and op in ("*", "/"):
            return Value(f"(({c})({a.code}) {op} ({c})({b.code}))", type_)
        if (ta.name, tb.name) in (("LDT", "LTIME"),) and op in ("+", "-"):
            return Value(f"(({c})({a.code}) {op} ({c})({b.code}))", type_)
        raise self.here.error(f"{ta.name} {op} {tb.name}")

    def pointers(self, a: Value, op: str, b: Value) -> Value:
        """Translate a comparison of pointers, or byte arithmetic on one."""
        if op in _COMPARE:
            for value in (a, b):
                if not isinstance(value.type, Pointer) and value.constant != 0:
                    raise self.here.error(f"{self.name(a.type)} {op} {self.name(b.type)}")
            return Value(f"((uintptr_t)({a.code}) {_COMPARE[op]} (uintptr_t)({b.code}))", BOOL)
        if (
            isinstance(a.type, Pointer)
            and isinstance(b.type, Elementary)
            and b.type.integral
            and op in ("+", "-")
        ):
            if a.type.target != t.BYTE:
                raise self.here.error("arithmetic on a pointer to something other than BYTE")
            return Value(f"({a.code} {op} (intptr_t)({b.code}))", a.type)
        raise self.here.error(f"{self.name(a.type)} {op} {self.name(b.type)}")
