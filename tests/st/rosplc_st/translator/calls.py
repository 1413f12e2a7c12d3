"""Calls: operators written as functions, conversions, library, functions, methods, instances."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from rosplc_st.translator import types as t
from rosplc_st.translator.declarations import Callable_, Declared
from rosplc_st.translator.expressions import Expressions
from rosplc_st.translator.source import TranslationError
from rosplc_st.translator.types import (
    ALIASES,
    ANY_INT,
    ANY_REAL,
    BOOL,
    ELEMENTARY,
    LIBRARY,
    NANOSECONDS,
    Array,
    Block,
    Elementary,
    Pointer,
    String,
    Struct,
    Value,
)

__all__ = ["LIFECYCLE", "bind", "call", "call_statement", "store", "virtual_methods"]

LIFECYCLE = ("FB_INIT", "FB_EXIT", "FB_REINIT")
_CONVERSION = re.compile(r"(?:(?P<source>\w+?)_)?TO_(?P<target>\w+)\Z")
_MATH = {"SIN": "sin", "COS": "cos", "TAN": "tan", "ASIN": "asin", "ACOS": "acos", "ATAN": "atan",
         "SQRT": "sqrt", "EXP": "exp", "LN": "log", "LOG": "log10"}  # fmt: skip


def virtual_methods(e: Expressions, block: str) -> list[str]:
    """Return the names of methods that a derived block may override, the base's first."""
    names: list[str] = []
    for item in e.program.ancestry(block):
        for name, method in item.methods.items():
            if name not in names and name not in LIFECYCLE and method.access != "PRIVATE":
                names.append(name)
    return names


def bind(e: Expressions, name: str, parameters: Sequence[Declared], given: Sequence[Any]) -> dict[str, Any]:
    """Return the argument nodes by parameter name; refuse what fits no parameter."""
    names = [p.name for p in parameters]
    bound: dict[str, Any] = {}
    position = 0
    for argument in given:
        if argument.name is not None:
            key = str(argument.name.name).upper()
        else:
            if position >= len(names):
                raise e.here.error(f"{name}: too many arguments")
            key = names[position]
            position += 1
        declared = next((p for p in parameters if p.name == key), None)
        if declared is None:
            raise e.here.error(f"{name} has no parameter {key}")
        if (type(argument).__name__ == "OutputParameterAssignment") != (
            declared.kind == "out"
        ) and argument.name:
            raise e.here.error(f"{name}: {key} with the wrong arrow")
        if key in bound:
            raise e.here.error(f"{name}: {key} is given twice")
        bound[key] = argument.value
    return bound


def _reference(e: Expressions, value: Value, declared: Declared) -> str:
    """Return a pointer to a variable for VAR_IN_OUT or VAR_OUTPUT."""
    if isinstance(declared.type, String) and isinstance(value.type, String) and declared.constant:
        return value.code
    if not value.place or (value.readonly and not declared.constant):
        raise e.here.error(f"{declared.name} needs a variable")
    same = value.type == declared.type
    if isinstance(value.type, String) and isinstance(declared.type, String):
        same = value.type.length >= declared.type.length
    if not same:
        raise e.refuse(value.type, declared.type)
    if isinstance(declared.type, (String, Array)):
        return value.code
    return f"({t.c_declaration(declared.type, '*')})&({value.code})"


def _arguments(e: Expressions, name: str, target: Callable_, given: Sequence[Any]) -> list[str]:
    bound = bind(e, name, target.parameters, given)
    codes = []
    for declared in target.parameters:
        node = bound.get(declared.name)
        if node is None:
            if declared.kind == "out":
                codes.append("(void *)st_nowhere")
                continue
            if declared.kind == "in" and declared.initial is not None:
                node = declared.initial
            else:
                raise e.here.error(f"{name}: {declared.name} is missing")
        value = e.expression(node)
        if declared.kind == "in":
            codes.append(e.convert(value, declared.type))
        else:
            codes.append(_reference(e, value, declared))
    return codes


def _result(target: Callable_, function: str, first: list[str], arguments: list[str]) -> Value:
    hidden = []
    if isinstance(target.returns, String):
        hidden = [f"(char[{target.returns.length + 1}]){{0}}"]
    return Value(f"{function}({', '.join([*first, *hidden, *arguments])})", target.returns, calls=True)


def _method(
    e: Expressions, target: Callable_, me: str, virtual: bool, block: str, given: Sequence[Any]
) -> Value:
    if target.name in LIFECYCLE:
        raise e.here.error(f"a call of {target.name}")
    arguments = _arguments(e, target.name, target, given)
    function = f"M_{target.owner}_{target.name}"
    if virtual and target.access != "PRIVATE":
        slot = virtual_methods(e, block).index(target.name)
        function = f"((T_{target.owner}_{target.name})((struct B_{block} *){me})->vt[{slot}])"
    return _result(target, function, [me], arguments)


def _adr(e: Expressions, given: Sequence[Any]) -> Value:
    value = e.expression(given[0].value)
    if not value.place:
        raise e.here.error("ADR of something that is no variable")
    target = value.type if not isinstance(value.type, (String, Block)) else t.BYTE
    # STRING's address is used as POINTER TO BYTE and as POINTER TO STRING alike.
    pointer = Pointer(None) if isinstance(value.type, (String, Block)) else Pointer(target)
    return Value(f"((uint8_t *)&({value.code}))", pointer)


def _shift(e: Expressions, name: str, given: Sequence[Any]) -> Value:
    value, count = (e.expression(p.value) for p in given)
    type_ = value.type
    if not isinstance(type_, Elementary) or not type_.integral or type_ is ANY_INT:
        raise e.here.error(f"{name} on {e.name(type_)}")
    if not isinstance(count.type, Elementary) or not count.type.integral:
        raise e.here.error(f"{name} by {e.name(count.type)}")
    sign = "s" if type_.signed else "u"
    return Value(
        f"(({type_.c})st_{name.lower()}_{sign}"
        f"(({type_.c})({value.code}), (uint64_t)({count.code}), {type_.bits}))",
        type_,
        calls=value.calls or count.calls,
    )


def _convert(e: Expressions, source: str | None, target: str, given: Sequence[Any]) -> Value | None:
    def elementary(name: str) -> Elementary | None:
        if name in ALIASES:
            name = ALIASES[name][0 if e.program.cpu_bits == 64 else 1]
        return ELEMENTARY.get(name)

    to = elementary(target)
    origin = elementary(source) if source is not None else None
    if to is None or (source is not None and origin is None):
        return None
    if len(given) != 1:
        raise e.here.error(f"TO_{target} takes one argument")
    value = e.expression(given[0].value)
    if not isinstance(value.type, Elementary):
        raise e.here.error(f"TO_{target} of {e.name(value.type)}")
    if origin is None:
        origin = value.type
        code = value.code
        if origin is ANY_INT:
            origin = t.smallest(int(value.constant or 0))
        elif origin is ANY_REAL:
            origin = ELEMENTARY["LREAL"]
        elif origin.kind != "bool":
            code = f"(({origin.c})({code}))"
    else:
        code = e.convert(value, origin)
    return Value(_conversion(code, origin, to), to, calls=value.calls)


def _conversion(code: str, source: Elementary, to: Elementary) -> str:
    if to.kind == "bool":
        return f"(({code}) != 0)"
    if source.kind == "real" and to.kind != "real":
        # Rounded to the nearest, halves away from zero.
        return (
            f"(({to.c})(int64_t)st_round({code}))"
            if to.bits < 64 or to.signed
            else f"(({to.c})st_round({code}))"
        )
    if source.kind == "time" and to.kind == "time" and source.name != to.name:
        return f"(({to.c})((uint64_t)({code}) * {NANOSECONDS[source.name]}ULL / {NANOSECONDS[to.name]}ULL))"
    return f"(({to.c})({code}))"


def _select(e: Expressions, name: str, given: Sequence[Any]) -> Value:
    values = [e.expression(p.value) for p in given]
    if name == "ABS" and len(values) == 1 and isinstance(values[0].type, Elementary):
        type_ = values[0].type
        if type_.kind == "real":
            return Value(f"fabs({values[0].code})" if type_.bits == 64 else f"fabsf({values[0].code})", type_)
        if type_.kind == "int":
            return Value(
                f"({{ __auto_type st_v = ({e.width(type_)})({values[0].code}); st_v < 0 ? -st_v : st_v; }})",
                type_,
            )
    if name == "LIMIT" and len(values) == 3:
        low, value, high = values
        return _extreme(e, "MIN", _extreme(e, "MAX", value, low), high)
    if name in ("MIN", "MAX") and len(values) == 2:
        return _extreme(e, name, *values)
    if name == "SEL" and len(values) == 3 and values[0].type == BOOL and values[1].type == values[2].type:
        return Value(f"(({values[0].code}) ? ({values[2].code}) : ({values[1].code}))", values[1].type)
    raise e.here.error(f"{name} with these arguments")


def _extreme(e: Expressions, name: str, a: Value, b: Value) -> Value:
    kinds = e.kinds(a, b)
    type_: Any
    if "real" in kinds:
        typed = [v.type for v in (a, b) if isinstance(v.type, Elementary) and v.type.kind == "real"]
        type_ = next((x for x in typed if x is not ANY_REAL and x.bits == 64), typed[0])
    elif kinds <= {"int", "bit"}:
        type_, a, b = e.pair(a, b)
    elif a.type == b.type:
        type_ = a.type
    else:
        raise e.here.error(f"{name} of {e.name(a.type)} and {e.name(b.type)}")
    c = type_.c
    sign = "<" if name == "MIN" else ">"
    return Value(
        f"({{ {c} st_a = ({c})({a.code}), st_b = ({c})({b.code}); st_a {sign} st_b ? st_a : st_b; }})", type_
    )


def _strings(e: Expressions, name: str, given: Sequence[Any]) -> Value:
    values = [e.expression(p.value) for p in given]
    texts = {"CONCAT": 2, "LEN": 1, "LEFT": 1, "RIGHT": 1, "MID": 1, "FIND": 2}[name]
    numbers = {"LEFT": 1, "RIGHT": 1, "MID": 2}.get(name, 0)
    if len(values) != texts + numbers or not all(isinstance(v.type, String) for v in values[:texts]):
        raise e.here.error(f"{name} with these arguments")
    codes = [v.code for v in values[:texts]] + [e.convert(v, ELEMENTARY["INT"]) for v in values[texts:]]
    if name in ("LEN", "FIND"):
        return Value(f"st_{name.lower()}({', '.join(codes)})", ELEMENTARY["INT"])
    return Value(f"st_{name.lower()}((char[256]){{0}}, {', '.join(codes)})", String(255))


def _operator(e: Expressions, name: str, given: Sequence[Any]) -> Value | None:
    """Translate what is built into the language; None: it is not."""
    if any(type(p).__name__ != "InputParameterAssignment" for p in given):
        return None
    if name in ("ADR", "SIZEOF"):
        if len(given) != 1:
            raise e.here.error(f"{name} takes one argument")
        if name == "ADR":
            return _adr(e, given)
        value = e.variable(given[0].value)
        return Value(f"((uint32_t)sizeof({value.code}))", ELEMENTARY["UDINT"])
    if name in ("SHL", "SHR", "ROL", "ROR") and len(given) == 2:
        return _shift(e, name, given)
    if name in _MATH and len(given) == 1:
        value = e.expression(given[0].value)
        real = isinstance(value.type, Elementary) and value.type == ELEMENTARY["REAL"]
        if not isinstance(value.type, Elementary) or value.type.kind not in ("int", "real"):
            raise e.here.error(f"{name} of {e.name(value.type)}")
        result = ELEMENTARY["REAL" if real else "LREAL"]
        return Value(f"(({result.c}){_MATH[name]}({value.code}))", result)
    if name in ("TRUNC", "TRUNC_INT") and len(given) == 1:
        value = e.expression(given[0].value)
        result = ELEMENTARY["DINT" if name == "TRUNC" else "INT"]
        return Value(f"(({result.c})(int64_t)({value.code}))", result)
    if name in ("MIN", "MAX", "LIMIT", "SEL", "ABS"):
        return _select(e, name, given)
    if name in ("CONCAT", "LEN", "LEFT", "RIGHT", "MID", "FIND"):
        return _strings(e, name, given)
    match = _CONVERSION.match(name)
    return _convert(e, match["source"], match["target"], given) if match else None


def _library(e: Expressions, name: str, given: Sequence[Any]) -> Value:
    external = LIBRARY[name]
    if len(given) != len(external.parameters):
        raise e.here.error(f"{name} takes {len(external.parameters)} arguments")
    codes = []
    for argument, text in zip(given, external.parameters, strict=True):
        if argument.name is not None:
            raise e.here.error(f"{name}: arguments by position only")
        codes.append(e.convert(e.expression(argument.value), e.library_type(text)))
    return Value(f"{external.c}({', '.join(codes)})", e.library_type(external.returns), calls=True)


def call(e: Expressions, node: Any) -> Value:
    """Translate a call that yields a value, or a method without one."""
    e.at(node)
    name, given = node.name, node.parameters or []
    if node.dereferenced:
        raise e.here.error("^ on a call's result")
    if type(name).__name__ == "SimpleVariable":
        return _plain(e, str(name.name).upper(), bool(name.dereferenced), given)
    head, elements = name.name, name.elements
    first = str(head.name).upper()
    last = elements[-1]
    if type(last).__name__ != "FieldSelector" or type(last.field).__name__ != "SimpleVariable":
        raise e.here.error("a call of an array's element as a value")
    method = str(last.field.name).upper()
    if first == "SUPER" and head.dereferenced and len(elements) == 1:
        base = e.program.blocks[e.block].base if e.block else ""
        target = e.program.method(base, method) if base else None
        if target is None or target.access == "PRIVATE":
            raise e.here.error(f"SUPER^.{method}: no such method")
        return _method(e, target, "self", False, base, given)
    if f"{first}.{method}" in LIBRARY and len(elements) == 1:
        return _library(e, f"{first}.{method}", given)
    instance = e.variable(name, 1)
    if not isinstance(instance.type, Block):
        raise e.here.error(f"{e.name(instance.type)} has no method {method}")
    target = e.program.method(instance.type.name, method)
    if target is None:
        raise e.here.error(f"{instance.type.name} has no method {method}")
    if target.access != "PUBLIC":
        raise e.here.error(f"{target.owner}.{method} is {target.access}")
    return _method(e, target, f"(void *)&({instance.code})", instance.shared, instance.type.name, given)


def _plain(e: Expressions, name: str, dereferenced: bool, given: Sequence[Any]) -> Value:
    if dereferenced:
        raise e.here.error(f"{name}^ as a value")
    if e.block:
        # A private method belongs to its own block; the base's is another.
        own = e.program.blocks[e.block].methods.get(name)
        target = own or e.program.method(e.block, name)
        if target is not None:
            if target.access == "PRIVATE" and own is None:
                raise e.here.error(f"{target.owner}.{name} is PRIVATE")
            return _method(e, target, "self", True, e.block, given)
    if name in e.program.functions:
        function = e.program.functions[name]
        return _result(function, f"F_{name}", [], _arguments(e, name, function, given))
    if name in LIBRARY:
        return _library(e, name, given)
    value = _operator(e, name, given)
    if value is None:
        raise e.here.error(f"call of {name}, which is unknown")
    return value if value.calls else replace(value, calls=any(True for _ in given))


def call_statement(e: Expressions, node: Any) -> str:
    """Translate a call as a statement: of an instance, SUPER^, or a function or method."""
    e.at(node)
    name, given = node.name, node.parameters or []
    if type(name).__name__ == "SimpleVariable" and str(name.name).upper() == "SUPER":
        base = e.program.blocks[e.block].base if e.block else ""
        if not base or e.routine is not None or given or not name.dereferenced:
            raise e.here.error("SUPER^() outside the body of an extended block")
        return f"R_{base}(self);"
    instance: Value | None = None
    if type(name).__name__ == "SimpleVariable":
        instance = e.find(str(name.name).upper()) if not name.dereferenced else None
        if e.routine is not None and str(name.name).upper() == e.routine.name:
            instance = None
    elif str(name.name.name).upper() != "SUPER":
        try:
            instance = e.variable(name)
        except TranslationError:
            instance = None  # a method, or unknown: call() says which
    if instance is not None and isinstance(instance.type, Block):
        return _instance(e, instance, given)
    return call(e, node).code + ";"


def _instance(e: Expressions, instance: Value, given: Sequence[Any]) -> str:
    assert isinstance(instance.type, Block)
    block = instance.type.name
    parameters = [v for v in e.program.members(block) if v.kind in ("in", "out", "inout")]
    bound = bind(
        e, block, [p for p in parameters if p.kind == "in"] + [p for p in parameters if p.kind != "in"], given
    )
    before, after = [], []
    for declared in parameters:
        path = f"({instance.code}).f_{declared.name}"
        node = bound.get(declared.name)
        if node is None:
            if declared.kind == "inout":
                raise e.here.error(f"{block}: {declared.name} is missing")
            continue
        value = e.expression(node)
        if declared.kind == "in":
            before.append(store(e, Value(path, declared.type, place=True), value))
        elif declared.kind == "inout":
            before.append(f"{path} = {_reference(e, value, declared)};")
        else:
            after.append(store(e, value, Value(path, declared.type)))
    return " ".join([*before, f"R_{block}((void *)&({instance.code}));", *after])


def store(e: Expressions, target: Value, value: Value) -> str:
    """Return the statement that assigns a value to a variable."""
    if not target.place:
        raise e.here.error("assignment to something that is no variable")
    if target.readonly:
        raise e.here.error(f"assignment: {target.readonly}")
    if target.type is None or isinstance(target.type, Block):
        raise e.here.error(f"assignment to {e.name(target.type)}")
    code = e.convert(value, target.type)
    if isinstance(target.type, String):
        return f"st_assign({target.code}, {target.type.length}, {code});"
    if isinstance(target.type, Array):
        return f"memmove(&({target.code}), &({code}), sizeof({target.code}));"
    if isinstance(target.type, Struct) and value.type != target.type:
        raise e.refuse(value.type, target.type)
    return f"{target.code} = {code};"
