"""Expressions in the scope of a body: variables, access paths, and what they are made of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from rosplc_st.translator import types as t
from rosplc_st.translator.declarations import Callable_, Declared, Place, Program
from rosplc_st.translator.operators import Literals, Operators
from rosplc_st.translator.types import (
    BOOL,
    Array,
    Block,
    Elementary,
    List,
    Pointer,
    String,
    Struct,
    Type,
    Value,
    alias,
    c_string,
    constant,
)

__all__ = ["Expressions"]


class Expressions(Literals, Operators):
    """Translates expressions in the scope of a body.

    Attributes:
        block: The block whose members are visible, or "".
        routine: The function or method whose variables are visible, or None.
        temporaries: VAR_TEMP variables of a block's body.
    """

    def __init__(
        self, program: Program, place: Place, base_line: int, block: str = "",
        routine: Callable_ | None = None, bounds: bool = True,
    ) -> None:  # fmt: skip
        self.program, self.here, self.base_line = program, place, base_line
        self.block, self.routine, self.bounds = block, routine, bounds
        self.members = {v.name: v for v in program.members(block)} if block else {}
        self.temporaries = (
            {v.name: v for v in program.blocks[block].variables if v.kind == "temp"}
            if block and routine is None
            else {}
        )
        self.locals = {v.name: v for v in routine.variables} if routine else self.temporaries

    def at(self, node: Any) -> Place:
        """Remember where translation stands; return the place."""
        self.here = self.here.at(node, self.base_line)
        return self.here

    # ---- expressions

    def expression(self, node: Any) -> Value:
        """Translate an expression."""
        kind = type(node).__name__
        self.at(node)
        handler = getattr(self, f"_{kind}", None)
        if handler is None:
            raise self.here.error(f"expression {kind}")
        result: Value = handler(node)
        return result

    def condition(self, node: Any) -> str:
        """Translate what must be a BOOL."""
        value = self.expression(node)
        if value.type != BOOL:
            raise self.here.error(f"a condition of type {self.name(value.type)}")
        return value.code

    def _ParenthesizedExpression(self, node: Any) -> Value:
        inner = self.expression(node.expr)
        return replace(inner, code=f"({inner.code})", place=False)

    # ---- variables

    def _SimpleVariable(self, node: Any) -> Value:
        return self.variable(node)

    _MultiElementVariable = _SimpleVariable

    def variable(self, node: Any, leave: int = 0) -> Value:
        """Translate an access path, without its last ``leave`` elements."""
        self.at(node)
        if type(node).__name__ == "SimpleVariable":
            head, elements = node, []
        elif type(node).__name__ == "MultiElementVariable":
            head, elements = node.name, list(node.elements)
            if leave:
                elements = elements[:-leave]
        else:
            raise self.here.error(f"variable {type(node).__name__}")
        value = self.head(str(head.name).upper())
        if head.dereferenced:
            value = self.dereference(value)
        for element in elements:
            value = self.element(value, element)
        return value

    def head(self, name: str) -> Value:
        """Return the variable that an access path begins with."""
        found = self.find(name)
        if found is None:
            raise self.here.error(f"unknown name {name}")
        return found

    def find(self, name: str) -> Value | None:
        """Return the variable that a name means here."""
        if name in self.locals:
            declared = self.locals[name]
            if declared.kind in ("out", "inout"):
                by_reference = isinstance(declared.type, String | Array)
                return self.place(f"l_{name}" if by_reference else f"(*l_{name})", declared)
            return self.place(f"l_{name}", declared)
        if self.routine is not None and name == self.routine.name:
            if self.routine.returns is None:
                raise self.here.error(f"{name} returns nothing")
            return Value("st_return", self.routine.returns, place=True)
        if name in self.members:
            return self.member("self->", self.members[name], inside=True)
        for item in self.program.lists.values():
            if not item.qualified:
                for declared in item.variables:
                    if declared.name == name:
                        return self.place(f"g_{item.name}->f_{name}", declared)
        if name in self.program.lists:
            return Value(f"(*g_{name})", List(name))
        if name in self.program.enumerations:
            return Value("", List(name))
        if name in self.program.blocks and self.program.blocks[name].is_program:
            return Value(f"(*p_{name})", Block(name))
        library = constant(name, self.program.cpu_bits)
        return self.number(library[1], library[0]) if library else None

    def member(self, prefix: str, declared: Declared, inside: bool) -> Value:
        """Return a block's variable, as seen from inside or outside."""
        code = f"{prefix}f_{declared.name}"
        if declared.kind == "inout":
            code = f"(*{code})"
        value = self.place(code, declared)
        if not inside and declared.kind == "out":
            value = replace(value, readonly=f"{declared.name} is an output")
        return value

    @staticmethod
    def place(code: str, declared: Declared) -> Value:
        """Return a declared variable that C reaches by ``code``."""
        return Value(
            code, declared.type, place=True,
            readonly=f"{declared.name} is a constant" if declared.constant else "",
        )  # fmt: skip

    def dereference(self, value: Value) -> Value:
        """Return what a pointer points to."""
        if not isinstance(value.type, Pointer) or value.type.target is None:
            raise self.here.error(f"^ on {self.name(value.type)}")
        target = value.type.target
        code = f"(*({t.c_declaration(target, '(*)')})({value.code}))" if isinstance(target, Array) else ""
        if isinstance(target, String):
            code = f"((char *)({value.code}))"
        elif isinstance(target, Elementary):
            code = f"(*(volatile {target.c} *)({value.code}))"
        elif isinstance(target, Pointer):
            code = f"(*(uint8_t **)({value.code}))"
        elif not code:
            code = f"(*({t.c_declaration(target, '')}*)({value.code}))"
        return Value(code, target, place=True, shared=True)

    def element(self, value: Value, element: Any) -> Value:
        """Return a member or element of a value."""
        if type(element).__name__ == "FieldSelector":
            field = element.field
            if type(field).__name__ != "SimpleVariable":
                raise self.here.error("bit access")
            if element.dereferenced:
                value = self.dereference(value)  # "^.name" as one token: before the member
            value = self.field(value, str(field.name).upper())
            return self.dereference(value) if field.dereferenced else value
        if type(element).__name__ != "SubscriptList":
            raise self.here.error(f"element {type(element).__name__}")
        for subscript in element.subscripts:
            value = self.index(value, subscript)
        return self.dereference(value) if element.dereferenced else value

    def index(self, value: Value, subscript: Any) -> Value:
        """Return an element of an array, its index checked."""
        if not isinstance(value.type, Array):
            raise self.here.error(f"[] on {self.name(value.type)}")
        number = self.expression(subscript)
        if not isinstance(number.type, Elementary) or not number.type.integral:
            raise self.here.error(f"an index of type {self.name(number.type)}")
        low, high = value.type.low, value.type.high
        if isinstance(number.constant, int):
            if not low <= number.constant <= high:
                raise self.here.error(f"index {number.constant} of ARRAY[{low}..{high}]")
            at = str(number.constant - low)
        elif self.bounds:
            file = c_string(self.here.file.encode())
            at = f"st_index((int64_t)({number.code}), {low}, {high}, {file}, {self.here.line})"
        else:
            at = f"((intptr_t)({number.code}) - {low})"
        return self.access(
            replace(value, calls=value.calls or number.calls), f"{value.code}[{at}]", value.type.element
        )

    def field(self, value: Value, name: str) -> Value:
        """Return a member of a structure, block or variable list."""
        if isinstance(value.type, Struct):
            for declared in self.program.duts[value.type.name].members:
                if declared.name == name:
                    return self.access(value, f"{value.code}.f_{name}", declared.type)
        elif isinstance(value.type, List) and value.type.name in self.program.enumerations:
            base, values = self.program.enumerations[value.type.name]
            if name in values:
                return self.number(values[name], base)
        elif isinstance(value.type, List):
            for declared in self.program.lists[value.type.name].variables:
                if declared.name == name:
                    return self.place(f"{value.code}.f_{name}", declared)
        elif isinstance(value.type, Block):
            for declared in self.program.members(value.type.name):
                if declared.name == name:
                    if declared.kind in ("var", "inout"):
                        raise self.here.error(f"{value.type.name}.{name} is not visible from outside")
                    found = self.member(f"{value.code}.", declared, inside=False)
                    return replace(found, shared=value.shared)
        raise self.here.error(f"{self.name(value.type)} has no {name}")

    @staticmethod
    def access(value: Value, code: str, type_: Type) -> Value:
        """Return a part of a value; what was reached through a pointer is accessed as written."""
        if value.shared and isinstance(type_, Elementary):
            code = f"(*(volatile {type_.c} *)&({code}))"
        return replace(value, code=code, type=type_, place=True)

    # ---- calls

    def _FunctionCall(self, node: Any) -> Value:
        from rosplc_st.translator.calls import call

        return call(self, node)

    def library_type(self, text: str) -> Type:
        """Return the type that a library's declaration names."""
        return alias(text, self.program.cpu_bits)
