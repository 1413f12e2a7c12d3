"""Initial values, and the life of instances: FB_Init, FB_Exit, FB_Reinit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rosplc_st.translator.calls import bind, store
from rosplc_st.translator.declarations import Declared, Program
from rosplc_st.translator.expressions import Expressions
from rosplc_st.translator.types import Array, Block, Struct, Type, Value

__all__ = ["instances", "set_initial"]


def set_initial(e: Expressions, path: str, declared: Declared, retains: str, copy: str) -> list[str]:
    """Return the statements that give a variable its initial value; its memory is zero already."""
    e.here = declared.place
    return _initial(e, path, declared.type, declared.initial, declared.arguments, retains, copy)


def _initial(
    e: Expressions, path: str, type_: Type, node: Any, arguments: tuple[Any, ...], retains: str, copy: str
) -> list[str]:
    if isinstance(type_, Block):
        if node is not None:
            raise e.here.error("initial values of a block's inputs")
        return [_make(e, path, type_.name, arguments, retains, copy)]
    if arguments:
        raise e.here.error("arguments of something that is no function block")
    if isinstance(type_, Struct):
        lines = []
        given = _fields(e, node) if node is not None else {}
        for member in e.program.duts[type_.name].members:
            inner = given.pop(member.name, member.initial)
            lines += _initial(
                e, f"{path}.f_{member.name}", member.type, inner, member.arguments, retains, copy
            )
        if given:
            raise e.here.error(f"{type_.name} has no {', '.join(given)}")
        return lines
    if isinstance(type_, Array):
        return _array(e, path, type_, node, retains, copy)
    if node is None:
        return []
    if type(node).__name__ == "Token":
        raise e.here.error("initial value of this form")
    return [store(e, Value(path, type_, place=True), e.expression(node))]


def _fields(e: Expressions, node: Any) -> dict[str, Any]:
    """Return the initial values of a structure's members by name."""
    node = _inside(node)
    kind = type(node).__name__
    if kind == "StructureInitialization":
        if any(item.name is None for item in node.elements):
            raise e.here.error("initial values of a structure without names")
        given = {}
        for item in node.elements:
            value, swallowed = _first(item.value)
            given[str(item.name).upper()] = value
            given.update(_member(e, pair) for pair in swallowed)
        return given
    if kind == "ParenthesizedExpression":
        return dict([_member(e, node.expr)])
    raise e.here.error(f"initial value {kind} of a structure")


def _member(e: Expressions, pair: Any) -> tuple[str, Any]:
    """Return name and value of a member that the parser took for an expression."""
    named = type(pair).__name__ == "BinaryOperation" and str(pair.op) == ":="
    if named and type(pair.left).__name__ == "SimpleVariable":
        return str(pair.left.name).upper(), pair.right
    raise e.here.error(f"initial value {type(pair).__name__} of a structure's member")


def _first(node: Any) -> tuple[Any, list[Any]]:
    """Return a member's value, and the members after it that the parser took for more of the same list."""
    if type(node).__name__ != "ArrayInitialization" or node.brackets or len(node.elements) < 2:
        return node, []
    first, *rest = _flat(node)
    return first, rest


def _flat(node: Any) -> Iterator[Any]:
    """Yield the elements of lists without square brackets, one inside the other."""
    for item in node.elements:
        if type(item.element).__name__ == "ArrayInitialization" and not item.element.brackets:
            yield from _flat(item.element)
        else:
            yield item.element


def _inside(node: Any) -> Any:
    """Return what is in round brackets, which the parser takes for a list of one."""
    while type(node).__name__ == "ArrayInitialization" and not node.brackets:
        if len(node.elements) != 1 or node.elements[0].count is not None:
            break
        node = node.elements[0].element
    return node


def _elements(e: Expressions, node: Any) -> Iterator[Any]:
    """Return an array's initial values, repetitions written out."""
    for item in node.elements:
        inner = item.element
        if type(inner).__name__ == "ArrayInitialization" and not inner.brackets:
            values = list(_elements(e, inner))
        else:
            values = [inner]
        count = 1
        if item.count is not None:
            if type(item.count).__name__ != "Integer":
                raise e.here.error("a repetition that is not a literal")
            count = int(str(item.count.value))
        yield from values * count


def _array(e: Expressions, path: str, type_: Array, node: Any, retains: str, copy: str) -> list[str]:
    length = type_.high - type_.low + 1
    given: list[Any] = []
    if node is not None:
        node = _inside(node)
        if type(node).__name__ != "ArrayInitialization":
            raise e.here.error(f"initial value {type(node).__name__} of an array")
        given = list(_elements(e, node))
        if len(given) > length:
            raise e.here.error(f"{len(given)} initial values of {length} elements")
    lines = []
    for index, item in enumerate(given):
        lines += _initial(e, f"{path}[{index}]", type_.element, item, (), retains, copy)
    if len(given) < length and _has_initial(e.program, type_.element):
        name = f"st_i{path.count('[')}"
        rest = _initial(e, f"{path}[{name}]", type_.element, None, (), retains, copy)
        if rest:
            lines += [f"for (int {name} = {len(given)}; {name} < {length}; {name}++) {{", *rest, "}"]
    return lines


def _has_initial(program: Program, type_: Type) -> bool:
    if isinstance(type_, Array):
        return _has_initial(program, type_.element)
    if isinstance(type_, Struct):
        return any(
            m.initial is not None or _has_initial(program, m.type) for m in program.duts[type_.name].members
        )
    return isinstance(type_, Block)


def _make(e: Expressions, path: str, block: str, arguments: tuple[Any, ...], retains: str, copy: str) -> str:
    parameters = init_parameters(e.program, block)
    bound = bind(e, block, parameters, arguments)
    codes = []
    for declared in parameters:
        if declared.name not in bound:
            raise e.here.error(f"{block}: FB_Init's {declared.name} is missing")
        codes.append(e.convert(e.expression(bound[declared.name]), declared.type))
    return f"make_{block}({', '.join([f'&({path})', retains, copy, *codes])});"


def init_parameters(program: Program, block: str) -> list[Declared]:
    """Return what FB_Init takes beyond its two flags: the block's own, or the nearest base's."""
    method = program.method(block, "FB_INIT")
    return [p for p in method.parameters if p.name not in ("BINITRETAINS", "BINCOPYCODE")] if method else []


def instances(program: Program, path: str, type_: Type) -> Iterator[tuple[str, str, list[str]]]:
    """Return (path, block, loop heads) of the instances inside a variable."""
    if isinstance(type_, Block):
        yield path, type_.name, []
    elif isinstance(type_, Struct):
        for member in program.duts[type_.name].members:
            yield from instances(program, f"{path}.f_{member.name}", member.type)
    elif isinstance(type_, Array):
        index = f"st_j{path.count('[')}"
        head = f"for (int {index} = 0; {index} < {type_.high - type_.low + 1}; {index}++)"
        for inner, block, heads in instances(program, f"{path}[{index}]", type_.element):
            yield inner, block, [head, *heads]
