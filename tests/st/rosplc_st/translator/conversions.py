"""Types of results, and what may be stored where: CODESYS' rules for implicit conversion."""

from __future__ import annotations

from rosplc_st.translator import types as t
from rosplc_st.translator.declarations import Place, Program
from rosplc_st.translator.source import TranslationError
from rosplc_st.translator.types import (
    ANY_INT,
    ANY_REAL,
    ELEMENTARY,
    NANOSECONDS,
    Array,
    Elementary,
    Pointer,
    String,
    Type,
)
from rosplc_st.translator.value import Value

__all__ = ["Conversions"]


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
