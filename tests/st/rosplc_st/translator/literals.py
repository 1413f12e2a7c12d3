"""Literals: numbers in any base, strings with dollar escapes, durations."""

from __future__ import annotations

import re
from typing import Any

from rosplc_st.translator import types as t
from rosplc_st.translator.conversions import Conversions
from rosplc_st.translator.declarations import Place
from rosplc_st.translator.types import ANY_REAL, BOOL, ELEMENTARY, String
from rosplc_st.translator.value import Value, c_string

__all__ = ["Literals", "string_bytes"]

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
