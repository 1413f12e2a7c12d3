"""Operators: arithmetic at the processor's width, comparisons, bits, times, pointers.

CODESYS computes intermediate results in registers: the difference of two UDINTs that wraps is
a large number on a 64-bit processor until a UDINT holds it. The C text does the same: operands
are widened to ``cpu_bits``, and only assignments, parameters and conversions cut them off.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from rosplc_st.translator import types as t
from rosplc_st.translator.conversions import Conversions
from rosplc_st.translator.types import ANY_INT, ANY_REAL, BOOL, Elementary, Pointer, String
from rosplc_st.translator.value import Value, c_string

__all__ = ["Operators"]

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
