"""Statements."""

from __future__ import annotations

from typing import Any

from rosplc_st.translator.calls import call_statement, store
from rosplc_st.translator.expressions import Expressions
from rosplc_st.translator.types import ANY_INT, BOOL, Elementary

__all__ = ["statements"]


def statements(e: Expressions, node: Any, loops: int = 0) -> list[str]:
    """Translate a list of statements; ``loops``: how many loops stand around it."""
    if node is None:
        return []
    return [line for item in node.statements for line in _statement(e, item, loops)]


def _statement(e: Expressions, node: Any, loops: int) -> list[str]:
    kind = type(node).__name__
    place = e.at(node)
    handler = _HANDLERS.get(kind)
    if handler is None:
        if kind in ("FunctionCallStatement", "FunctionCall"):
            return [call_statement(e, node)]
        raise place.error(f"statement {kind}")
    result: list[str] = handler(e, node, loops)
    return result


def _assignment(e: Expressions, node: Any, loops: int) -> list[str]:
    if len(node.variables) != 1:
        raise e.here.error("several assignments in one")
    value = e.expression(node.expression)
    target = e.variable(node.variables[0])
    return [store(e, target, value)]


def _if(e: Expressions, node: Any, loops: int) -> list[str]:
    lines = [f"if ({e.condition(node.if_expression)}) {{", *statements(e, node.statements, loops), "}"]
    depth = 0
    for clause in node.else_ifs or ():
        lines += ["else {", f"if ({e.condition(clause.if_expression)}) {{"]
        lines += [*statements(e, clause.statements, loops), "}"]
        depth += 1
    if node.else_clause is not None:
        lines += ["else {", *statements(e, node.else_clause.statements, loops), "}"]
    return lines + ["}"] * depth


def _case(e: Expressions, node: Any, loops: int) -> list[str]:
    selector = e.expression(node.expression)
    if not isinstance(selector.type, Elementary) or not selector.type.integral or selector.type is ANY_INT:
        raise e.here.error(f"CASE of {e.name(selector.type)}")
    type_ = selector.type
    lines = [f"{{ {type_.c} st_case = ({type_.c})({selector.code});"]
    seen: list[tuple[int, int]] = []
    for index, case in enumerate(node.cases):
        tests = []
        for match in case.matches:
            low, high = _label(e, match)
            if high < low or any(low <= b and a <= high for a, b in seen):
                raise e.here.error(f"CASE label {low}..{high} again or empty")
            for bound in (low, high):
                e.convert(e.number(bound), type_)
            seen.append((low, high))
            bounds = [e.number(low).code, e.number(high).code]
            if type_.bits == 64 and not type_.signed:
                bounds = [f"(uint64_t){b}" for b in bounds]
            elif type_.bits < 64:
                bounds = [f"(int64_t){b}" for b in bounds]
            subject = "st_case" if type_.bits == 64 else "(int64_t)st_case"
            tests.append(f"({subject} >= {bounds[0]} && {subject} <= {bounds[1]})")
        lines += [f"{'else ' if index else ''}if ({' || '.join(tests)}) {{"]
        lines += [*statements(e, case.statements, loops), "}"]
    if node.else_clause is not None:
        lines += ["else {" if node.cases else "{", *statements(e, node.else_clause.statements, loops), "}"]
    return [*lines, "}"]


def _label(e: Expressions, match: Any) -> tuple[int, int]:
    if type(match).__name__ == "PartialSubrange":
        return _number(e, match.start), _number(e, match.stop)
    number = _number(e, match)
    return number, number


def _number(e: Expressions, node: Any) -> int:
    if type(node).__name__ == "EnumeratedValue" or not hasattr(node, "meta"):
        raise e.here.error("a CASE label that is not a literal")
    value = e.expression(node)
    if not isinstance(value.constant, int):
        raise e.here.error("a CASE label that is not a literal")
    return value.constant


def _while(e: Expressions, node: Any, loops: int) -> list[str]:
    return [f"while ({e.condition(node.expression)}) {{", *statements(e, node.statements, loops + 1), "}"]


def _repeat(e: Expressions, node: Any, loops: int) -> list[str]:
    body = statements(e, node.statements, loops + 1)
    return ["do {", *body, f"}} while (!({e.condition(node.expression)}));"]


def _for(e: Expressions, node: Any, loops: int) -> list[str]:
    control = e.variable(node.control)
    type_ = control.type
    if not isinstance(type_, Elementary) or type_.kind != "int" or control.readonly:
        raise e.here.error(f"FOR with a variable of type {e.name(type_)}")
    start = store(e, control, e.expression(node.from_)).rstrip(";")
    limit = e.expression(node.to)
    if isinstance(limit.constant, int):
        e.convert(limit, type_)
    step = e.expression(node.step) if node.step is not None else e.number(1)
    if not isinstance(step.constant, int) or step.constant == 0:
        raise e.here.error("FOR BY something that is not a literal")
    test = e.operation(control, "<=" if step.constant > 0 else ">=", limit)
    if test.type != BOOL:
        raise e.here.error("FOR TO")
    # The variable counts in its own width: TO its type's largest value never ends, as documented.
    advance = f"{control.code} = ({type_.c})({control.code} + ({step.constant}LL))"
    return [f"for ({start}; {test.code}; {advance}) {{", *statements(e, node.statements, loops + 1), "}"]


def _exit(e: Expressions, node: Any, loops: int) -> list[str]:
    if not loops:
        raise e.here.error("EXIT outside a loop")
    return ["break;"]


def _return(e: Expressions, node: Any, loops: int) -> list[str]:
    return ["goto st_end;"]


def _nothing(e: Expressions, node: Any, loops: int) -> list[str]:
    variable = getattr(node, "variable", None)
    if variable is not None:
        raise e.here.error("a variable as a statement")
    return [";"]


_HANDLERS = {
    "AssignmentStatement": _assignment,
    "IfStatement": _if,
    "CaseStatement": _case,
    "WhileStatement": _while,
    "RepeatStatement": _repeat,
    "ForStatement": _for,
    "ExitStatement": _exit,
    "ReturnStatement": _return,
    "NoOpStatement": _nothing,
}
