"""The translator from Structured Text to C on trial: cases computed by hand from CODESYS' help."""

# ruff: noqa: E501 (one case per line reads as a table)

from __future__ import annotations

import re
from typing import Any

import pytest

from rosplc_st.build import build
from rosplc_st.machine import LibraryMachine
from rosplc_st.translator import Options, TranslationError, translate

# name: (declarations, statements, {variable: value}); every variable gets the case's own prefix, for `_`.
CASES: dict[str, tuple[str, str, dict[str, Any]]] = {
    # Integer widths: a value is cut off where it is stored.
    "usint_wraps": ("_a : USINT := 250;", "_a := _a + 10;", {"_a": 4}),
    "sint_wraps": ("_a : SINT := 127;", "_a := _a + 1;", {"_a": -128}),
    "uint_wraps_down": ("_a : UINT;", "_a := _a - 1;", {"_a": 65535}),
    "udint_difference_wraps": (
        "_a : UDINT := 3; _b : UDINT := 4294967295; _c : UDINT;",
        "_c := _a - _b;",
        {"_c": 4},
    ),
    "difference_is_wide_before_it_is_stored": (
        # 3 - 4294967295 in a 64-bit register is far above 16#FFFFFFFF, and only a UDINT makes it 4.
        "_a : UDINT := 3; _b : UDINT := 4294967295; _w : BOOL;",
        "_w := (_a - _b) > 16#FFFFFFFF;",
        {"_w": True},
    ),
    "product_is_wide_before_it_is_divided": (
        "_a : UDINT := 4000000000; _c : UDINT;",
        "_c := _a * 2 / 2;",
        {"_c": 4000000000},
    ),
    "byte_times": ("_a : BYTE := 200; _b : UINT;", "_b := _a * 3;", {"_b": 600}),
    "dint_division_truncates": (
        "_a : DINT := -7; _b : DINT; _c : DINT;",
        "_b := _a / 2; _c := _a MOD 2;",
        {"_b": -3, "_c": -1},
    ),
    "int_to_sint": ("_a : SINT;", "_a := INT_TO_SINT(4223);", {"_a": 127}),  # CODESYS' help: 16#107F
    "udint_to_uint": ("_a : UDINT := 65537; _b : UINT;", "_b := UDINT_TO_UINT(_a);", {"_b": 1}),
    "sint_to_usint": ("_a : SINT := -1; _b : USINT;", "_b := SINT_TO_USINT(_a);", {"_b": 255}),
    "widening_keeps_the_sign": ("_a : SINT := -5; _b : LINT;", "_b := _a;", {"_b": -5}),
    "uxint_to_udint": ("_a : __UXINT := 7; _b : UDINT;", "_b := __UXINT_TO_UDINT(_a);", {"_b": 7}),
    "int_to_bool": (
        "_a : INT := 2; _b : BOOL; _c : INT;",
        "_b := INT_TO_BOOL(_a); _c := BOOL_TO_INT(_b);",
        {"_b": True, "_c": 1},
    ),
    "smallest_lint": ("_a : LINT := -9223372036854775807 - 1;", ";", {"_a": -(2**63)}),
    "largest_ulint": ("_a : ULINT := ULINT#18446744073709551615;", ";", {"_a": 2**64 - 1}),
    "literals": (
        "_a : UINT; _b : BYTE; _c : DINT;",
        "_a := 16#FF_FF; _b := 2#1010_1010; _c := 1_000;",
        {"_a": 65535, "_b": 170, "_c": 1000},
    ),
    # Bits.
    "shl_cuts_off": ("_a : BYTE := 16#F0; _b : BYTE;", "_b := SHL(_a, 4);", {"_b": 0}),
    "shr_of_dword": ("_a : DWORD := 16#80000000; _b : DWORD;", "_b := SHR(_a, 31);", {"_b": 1}),
    "shr_of_dint_keeps_the_sign": ("_a : DINT := -8; _b : DINT;", "_b := SHR(_a, 1);", {"_b": -4}),
    "shift_by_the_width": ("_a : DWORD := 1; _b : DWORD := 5;", "_b := SHL(_a, 32);", {"_b": 0}),
    "rol": ("_a : BYTE := 16#81; _b : BYTE;", "_b := ROL(_a, 1);", {"_b": 3}),
    "not_byte": ("_a : BYTE := 16#0F; _b : UINT;", "_b := NOT _a;", {"_b": 0xF0}),
    "xor_dword": ("_a : DWORD := 16#FFFF0000; _b : DWORD;", "_b := _a XOR 16#FF00FF00;", {"_b": 0x00FFFF00}),
    "fnv_step": ("_a : DWORD := 16#811C9DC5;", "_a := (_a XOR 97) * 16777619;", {"_a": 0xE40C292C}),
    # BOOL.
    "bool_operators": (
        "_a : BOOL; _b : BOOL; _c : BOOL;",
        "_a := TRUE AND NOT FALSE; _b := TRUE XOR TRUE; _c := FALSE OR (3 > 2);",
        {"_a": True, "_b": False, "_c": True},
    ),
    "both_operands_run": (
        "_n : INT; _x : BOOL; _y : BOOL;",
        "_x := FALSE AND Step(_n); _y := TRUE OR Step(_n);",
        {"_n": 2, "_y": True},
    ),
    "left_before_right": ("_n : INT; _r : INT;", "_r := Count(_n) - 10 * Count(_n);", {"_r": 1 - 20}),
    # REAL.
    "real_to_int_rounds": (
        "_a : INT; _b : INT; _c : INT; _d : INT;",
        "_a := REAL_TO_INT(1.5); _b := REAL_TO_INT(1.4); _c := REAL_TO_INT(-1.5); _d := REAL_TO_INT(-1.4);",
        {"_a": 2, "_b": 1, "_c": -2, "_d": -1},
    ),
    "trunc": ("_a : DINT; _b : DINT;", "_a := TRUNC(1.9); _b := TRUNC(-1.9);", {"_a": 1, "_b": -1}),
    "real_loses_digits": ("_a : REAL; _b : LREAL;", "_a := 0.1; _b := _a;", {"_b": 0.10000000149011612}),
    "lreal_to_real": (
        "_a : LREAL := 1.0E-3; _b : REAL;",
        "_b := LREAL_TO_REAL(_a);",
        {"_b": 0.0010000000474974513},
    ),
    "integers_divide_as_integers": ("_a : LREAL;", "_a := 7 / 2;", {"_a": 3.0}),
    "real_times_int": ("_a : INT := 3; _b : LREAL;", "_b := _a * 1.5;", {"_b": 4.5}),
    # TIME.
    "time_literal": ("_a : UDINT;", "_a := TIME_TO_UDINT(T#1m2s30ms);", {"_a": 62030}),
    "time_sum": (
        "_a : TIME := T#1s; _b : BOOL;",
        "_a := _a + T#500ms; _b := _a > T#1s499ms;",
        {"_a": 1500, "_b": True},
    ),
    "ltime_from_time": ("_a : LTIME;", "_a := TIME_TO_LTIME(T#5ms);", {"_a": 5_000_000}),
    # STRING.
    "string_truncates": ("_a : STRING(3);", "_a := 'abcdef';", {"_a": "abc"}),
    "string_escapes": (
        "_a : STRING(10); _l : INT;",
        "_a := '$$$'$41$L$R$T$00x'; _l := LEN('$0D$0A');",
        {"_a": "$'A\n\r\t", "_l": 2},
    ),
    "concat": ("_a : STRING(5); _b : STRING(9) := 'xyz';", "_a := CONCAT(_b, '-tail');", {"_a": "xyz-t"}),
    "parts": (
        "_a : STRING(5); _b : STRING(5); _c : STRING(5); _d : INT;",
        "_a := LEFT('hello', 2); _b := RIGHT('hello', 3); _c := MID('hello', 2, 2); _d := FIND('hello', 'l');",
        {"_a": "he", "_b": "llo", "_c": "el", "_d": 3},
    ),
    "string_equality": (
        "_a : STRING(5) := 'ab'; _b : BOOL; _c : BOOL;",
        "_b := _a = 'ab'; _c := _a < 'b';",
        {"_b": True, "_c": True},
    ),
    "bytes_behind_the_end_stay": (
        "_a : STRING(5) := 'abcde'; _p : POINTER TO BYTE; _b : BYTE;",
        "_a := 'x'; _p := ADR(_a); _p := _p + 3; _b := _p^;",
        {"_b": ord("d")},
    ),
    "string_parameter_is_cut": ("_a : INT;", "_a := Length('abcdefgh');", {"_a": 4}),
    "string_by_reference": ("_a : INT;", "_a := Whole('abcdefgh');", {"_a": 8}),
    "function_returns_string": ("_a : STRING(20);", "_a := CONCAT(Greet('you'), '!');", {"_a": "hi you!"}),
    # Initial values.
    "array_repetition": (
        "_a : ARRAY[0..5] OF INT := [1, 2(7), 3(0)]; _s : INT;",
        "_s := _a[0] + 10 * _a[1] + 100 * _a[2] + _a[3];",
        {"_s": 771},
    ),
    "array_from_another_bound": ("_a : ARRAY[-2..1] OF INT := [1, 2, 3, 4];", ";", {"_a[-2]": 1, "_a[1]": 4}),
    "array_rest_is_zero": ("_a : ARRAY[0..3] OF INT := [5];", ";", {"_a[0]": 5, "_a[3]": 0}),
    "struct_members": ("_a : Pair := (y := 9);", ";", {"_a.x": 4, "_a.y": 9}),
    "array_of_structs": (
        "_a : ARRAY[1..3] OF Pair := [(x := 1)];",
        ";",
        {"_a[1].x": 1, "_a[2].x": 4, "_a[3].y": 0},
    ),
    "nested_struct": ("_a : Outer;", ";", {"_a.inner.x": 4, "_a.names[1]": "b", "_a.names[2]": ""}),
    "two_dimensions": (
        "_a : ARRAY[0..1, 0..2] OF INT;",
        "_a[1, 2] := 5; _a[0, 1] := 3;",
        {"_a[1][2]": 5, "_a[0][1]": 3},
    ),
    # Assignment of wholes.
    "struct_copy": ("_a : Pair := (x := 7); _b : Pair;", "_b := _a; _a.x := 1;", {"_b.x": 7}),
    "array_copy": (
        "_a : ARRAY[0..2] OF INT := [1, 2, 3]; _b : ARRAY[0..2] OF INT;",
        "_b := _a;",
        {"_b[2]": 3},
    ),
    # Statements.
    "for_runs_to_its_end": (
        "_i : INT; _n : INT;",
        "FOR _i := 1 TO 5 DO _n := _n + _i; END_FOR;",
        {"_n": 15, "_i": 6},
    ),
    "for_by": (
        "_i : INT; _n : INT;",
        "FOR _i := 10 TO 1 BY -3 DO _n := _n + 1; END_FOR;",
        {"_n": 4, "_i": -2},
    ),
    "for_never": ("_i : UINT; _n : UINT;", "FOR _i := 5 TO 4 DO _n := 1; END_FOR;", {"_n": 0, "_i": 5}),
    "for_to_a_difference": (
        # 0 - 1 is wide and large: the loop must be left by hand, as on a real processor.
        "_i : UDINT; _e : UDINT; _n : UDINT;",
        "FOR _i := 0 TO _e - 1 DO _n := _n + 1; IF _n > 9 THEN EXIT; END_IF; END_FOR;",
        {"_n": 10},
    ),
    "exit_leaves_the_inner_loop": (
        "_i : INT; _j : INT; _n : INT;",
        "FOR _i := 0 TO 2 DO FOR _j := 0 TO 9 DO IF _j = 2 THEN EXIT; END_IF; _n := _n + 1; END_FOR; END_FOR;",
        {"_n": 6},
    ),
    "while": ("_n : INT;", "WHILE _n < 3 DO _n := _n + 1; END_WHILE;", {"_n": 3}),
    "repeat_runs_once": ("_n : INT;", "REPEAT _n := _n + 1; UNTIL TRUE END_REPEAT;", {"_n": 1}),
    "case_ranges": (
        "_i : INT; _n : DINT;",
        "FOR _i := -2 TO 7 DO CASE _i OF -1: _n := _n + 1; 1, 3..5: _n := _n + 10; 6: _n := _n + 100; ELSE _n := _n + 1000; END_CASE; END_FOR;",
        {"_n": 1 + 4 * 10 + 100 + 4 * 1000},
    ),
    "elsif": (
        "_a : INT := 2; _n : INT;",
        "IF _a = 1 THEN _n := 1; ELSIF _a = 2 THEN _n := 2; ELSE _n := 3; END_IF;",
        {"_n": 2},
    ),
    # Functions: locals start anew; parameters by name; in-outs by reference.
    "locals_start_anew": ("_a : INT; _b : INT;", "_a := Fresh(); _b := Fresh();", {"_a": 6, "_b": 6}),
    "named_parameters": ("_a : INT;", "_a := Minus(subtrahend := 3, minuend := 10);", {"_a": 7}),
    "in_out": ("_a : INT := 5; _b : INT := 6;", "Swap(_a, _b);", {"_a": 6, "_b": 5}),
    "out_parameter": ("_q : INT; _r : INT;", "_q := Divide(17, 5, rest => _r);", {"_q": 3, "_r": 2}),
    # Pointers count bytes.
    "pointer_bytes": (
        "_a : UDINT := 16#04030201; _p : POINTER TO BYTE; _b : BYTE;",
        "_p := ADR(_a); _p := _p + 2; _b := _p^;",
        {"_b": 3},
    ),
    "pointer_to_another_type": (
        "_a : ARRAY[0..7] OF BYTE := [1, 0, 0, 0, 2, 0, 0, 0]; _p : POINTER TO BYTE; _q : POINTER TO Words; _w : UDINT;",
        "_p := ADR(_a); _q := _p; _w := _q^.high; _q^.low := 258;",
        {"_w": 2, "_a[0]": 2, "_a[1]": 1},
    ),
    "pointer_walks_a_struct": (
        "_a : Words; _p : POINTER TO Words;",
        "_p := ADR(_a); _p^.high := 5; _p^.low := _p^.high + 1;",
        {"_a.low": 6},
    ),
    "sizeof": (
        "_a : Outer; _n : UDINT; _s : STRING(10); _m : UDINT;",
        "_n := SIZEOF(_a); _m := SIZEOF(_s);",
        {"_n": 10, "_m": 11},
    ),
    "xadd": ("_a : DINT := 5; _o : DINT;", "_o := __XADD(ADR(_a), 3);", {"_o": 5, "_a": 8}),
    "memset": ("_a : UDINT := 1;", "SysMemSet(ADR(_a), 255, SIZEOF(_a));", {"_a": 0xFFFFFFFF}),
    # Function blocks: inputs stay, EXTENDS, SUPER, methods found by the instance's own type.
    "inputs_stay": (
        "_f : Adder(100); _a : INT; _b : INT;",
        "_f(x := 5); _a := _f.sum; _f(); _b := _f.sum;",
        {"_a": 105, "_b": 110},
    ),
    "init_base_first": ("_f : Derived(3);", ";", {"_f.trace": 312, "_f.given": 3}),
    "override_is_found": (
        "_f : Derived(0); _b : Base(0); _m : INT; _n : INT;",
        "_m := _f.Ask(); _n := _b.Ask();",
        {"_m": 21, "_n": 1},
    ),
    "super_body": ("_f : Derived(0);", "_f(); _f();", {"_f.runs": 2, "_f.more": 4}),
    "instance_in_instance": ("_h : Holder; _a : INT;", "_h(v := 2); _a := _h.result;", {"_a": 42}),
    "in_out_of_a_block": ("_u : User; _v : INT := 1;", "_u(v := _v); _u(v := _v);", {"_v": 3}),
    "temp_starts_anew": ("_f : Temps; _a : INT;", "_f(); _f(); _a := _f.seen;", {"_a": 8}),
    "output_arrow": ("_f : Adder(1); _a : INT;", "_f(x := 1, sum => _a);", {"_a": 2}),
    # Variable lists.
    "constant_list": ("_a : INT;", "_a := Fixed.answer;", {"_a": 42}),
    "plain_list": ("_a : INT;", "shared := shared + 1; _a := Plain.shared;", {"_a": 8}),
}

OBJECTS = {
    "Pair": "TYPE Pair :\nSTRUCT\n    x : INT := 4;\n    y : INT;\nEND_STRUCT\nEND_TYPE\n",
    "Words": "{attribute 'pack_mode' := '8'}\nTYPE Words :\nSTRUCT\n    low : UDINT;\n    high : UDINT;\nEND_STRUCT\nEND_TYPE\n",
    "Outer": "TYPE Outer :\nSTRUCT\n    inner : Pair;\n    names : ARRAY[0..2] OF STRING(1) := ['a', 'b'];\nEND_STRUCT\nEND_TYPE\n",
    "Fixed": "{attribute 'qualified_only'}\nVAR_GLOBAL CONSTANT\n    answer : INT := 42;\nEND_VAR\n",
    "Plain": "VAR_GLOBAL\n    shared : INT := 7;\nEND_VAR\n",
    "Step": "FUNCTION Step : BOOL\nVAR_IN_OUT\n    n : INT;\nEND_VAR\nn := n + 1;\nStep := TRUE;\nEND_FUNCTION\n",
    "Count": "FUNCTION Count : INT\nVAR_IN_OUT\n    n : INT;\nEND_VAR\nn := n + 1;\nCount := n;\nEND_FUNCTION\n",
    "Length": "FUNCTION Length : INT\nVAR_INPUT\n    s : STRING(4);\nEND_VAR\nLength := LEN(s);\nEND_FUNCTION\n",
    "Whole": "FUNCTION Whole : INT\nVAR_IN_OUT CONSTANT\n    s : STRING(200);\nEND_VAR\nWhole := LEN(s);\nEND_FUNCTION\n",
    "Greet": "FUNCTION Greet : STRING(10)\nVAR_INPUT\n    s : STRING(4);\nEND_VAR\nGreet := CONCAT('hi ', s);\nEND_FUNCTION\n",
    "Fresh": "FUNCTION Fresh : INT\nVAR\n    n : INT := 5;\nEND_VAR\nn := n + 1;\nFresh := n;\nEND_FUNCTION\n",
    "Minus": "FUNCTION Minus : INT\nVAR_INPUT\n    minuend : INT;\n    subtrahend : INT;\nEND_VAR\n"
             "Minus := minuend - subtrahend;\nRETURN;\nMinus := 0;\nEND_FUNCTION\n",
    "Swap": "FUNCTION Swap : BOOL\nVAR_IN_OUT\n    a : INT;\n    b : INT;\nEND_VAR\nVAR\n    c : INT;\nEND_VAR\n"
            "c := a;\na := b;\nb := c;\nSwap := TRUE;\nEND_FUNCTION\n",
    "Divide": "FUNCTION Divide : INT\nVAR_INPUT\n    a : INT;\n    b : INT;\nEND_VAR\nVAR_OUTPUT\n    rest : INT;\nEND_VAR\n"
              "rest := a MOD b;\nDivide := a / b;\nEND_FUNCTION\n",
    "Adder": """FUNCTION_BLOCK Adder
VAR_INPUT
    x : INT;
END_VAR
VAR_OUTPUT
    sum : INT;
END_VAR
sum := sum + x;
END_FUNCTION_BLOCK
METHOD PUBLIC FB_Init : BOOL
VAR_INPUT
    bInitRetains : BOOL;
    bInCopyCode : BOOL;
    start : INT;
END_VAR
sum := start;
END_METHOD
""",
    "Base": """FUNCTION_BLOCK Base
VAR_OUTPUT
    trace : INT;
    given : INT;
    runs : INT;
END_VAR
VAR
    first : INT := 3;
END_VAR
runs := runs + 1;
END_FUNCTION_BLOCK
METHOD PUBLIC FB_Init : BOOL
VAR_INPUT
    bInitRetains : BOOL;
    bInCopyCode : BOOL;
    value : INT;
END_VAR
trace := first * 10 + 1;
given := value;
END_METHOD
METHOD PUBLIC Ask : INT
Ask := Inner();
END_METHOD
METHOD PROTECTED Inner : INT
Inner := 1;
END_METHOD
""",
    "Derived": """FUNCTION_BLOCK Derived EXTENDS Base
VAR_OUTPUT
    more : INT;
END_VAR
SUPER^();
more := more + runs;
IF more = 3 THEN
    more := more + 1;
END_IF;
END_FUNCTION_BLOCK
METHOD PUBLIC FB_Init : BOOL
VAR_INPUT
    bInitRetains : BOOL;
    bInCopyCode : BOOL;
    value : INT;
END_VAR
trace := trace * 10 + 2;
END_METHOD
METHOD PROTECTED Inner : INT
Inner := SUPER^.Inner() + 20;
END_METHOD
""",
    "Holder": """FUNCTION_BLOCK Holder
VAR_INPUT
    v : INT;
END_VAR
VAR_OUTPUT
    result : INT;
END_VAR
VAR
    part : Adder(40);
END_VAR
part(x := v);
result := part.sum;
END_FUNCTION_BLOCK
""",
    "User": "FUNCTION_BLOCK User\nVAR_IN_OUT\n    v : INT;\nEND_VAR\nv := v + 1;\nEND_FUNCTION_BLOCK\n",
    "Temps": "FUNCTION_BLOCK Temps\nVAR_OUTPUT\n    seen : INT;\nEND_VAR\nVAR_TEMP\n    t : INT := 3;\nEND_VAR\n"
             "t := t + 1;\nseen := seen + t;\nEND_FUNCTION_BLOCK\n",
}  # fmt: skip


def prefixed(text: str, case: str) -> str:
    """Replace the leading underscore of a case's variables by its name."""
    return re.sub(r"(?<![A-Za-z0-9_])_(?=[a-z])", f"{case}_", text)


def programs() -> dict[str, str]:
    texts = dict(OBJECTS)
    for name, (declarations, body, _) in CASES.items():
        lines = "\n".join(f"    {d.strip()};" for d in prefixed(declarations, name).split(";") if d.strip())
        statements = prefixed(body, name)
        texts[f"P_{name}"] = f"PROGRAM P_{name}\nVAR\n{lines}\nEND_VAR\n{statements}\nEND_PROGRAM\n"
    return texts


@pytest.fixture(scope="module")
def machine() -> LibraryMachine:
    plc = LibraryMachine(build(programs()))
    plc.start()
    return plc


@pytest.mark.parametrize("name", CASES)
def test_case(machine: LibraryMachine, name: str) -> None:
    """A small program gives the values that CODESYS' help gives."""
    machine.scan(f"P_{name}")
    for variable, value in CASES[name][2].items():
        assert machine.get(f"P_{name}.{prefixed(variable, name)}") == value, variable


REFUSED = {
    "narrowing": ("a : UDINT; b : UINT;", "b := a;", "cannot convert UDINT to UINT"),
    "real_to_integer": ("a : REAL; b : INT;", "b := a;", "cannot convert REAL to INT"),
    "lreal_to_real": ("a : LREAL; b : REAL;", "b := a;", "cannot convert LREAL to REAL"),
    "integer_to_bool": ("a : INT; b : BOOL;", "b := a;", "cannot convert INT to BOOL"),
    "literal_too_large": ("a : USINT;", "a := 256;", "256 does not fit into USINT"),
    "negative_to_unsigned": ("a : UINT;", "a := -1;", "-1 does not fit into UINT"),
    "uxint_to_udint": ("a : __UXINT; b : UDINT;", "b := a;", "cannot convert ULINT to UDINT"),
    "string_to_integer": ("a : INT;", "a := 'x';", "cannot convert STRING(1) to INT"),
    "unknown_variable": ("a : INT;", "a := b;", "unknown name B"),
    "unknown_type": ("a : Nothing;", ";", "unknown type NOTHING"),
    "unknown_function": ("a : INT;", "a := Nothing(1);", "call of NOTHING, which is unknown"),
    "unknown_member": ("a : Pair; b : INT;", "b := a.z;", "PAIR has no Z"),
    "condition": ("a : INT;", "IF a THEN ; END_IF;", "a condition of type INT"),
    "index": ("a : ARRAY[0..3] OF INT;", "a[4] := 1;", "index 4 of ARRAY[0..3]"),
    "bit_access": ("a : BYTE;", "a.7 := TRUE;", "bit access"),
    "continue": (
        "a : INT;",
        "WHILE a < 1 DO a := a + 1; CONTINUE; END_WHILE;",
        "statement ContinueStatement",
    ),
    "jump": ("a : INT;", "JMP there;", "statement JumpStatement"),
    "reference": ("a : REFERENCE TO INT;", ";", "REFERENCE TO"),
    "wstring": ("a : WSTRING(3);", ";", "WSTRING"),
    "power": ("a : LREAL;", "a := a ** 2;", "syntax"),
    "this": ("a : Adder(1);", "THIS^.a();", ""),
    "private_variable": ("a : Base(1); b : INT;", "b := a.first;", "BASE.FIRST is not visible from outside"),
    "protected_method": ("a : Base(1); b : INT;", "b := a.Inner();", "BASE.INNER is PROTECTED"),
    "output_assigned": ("a : Base(1);", "a.runs := 1;", "RUNS is an output"),
    "constant_assigned": ("a : INT;", "Fixed.answer := 1;", "ANSWER is a constant"),
    "missing_argument": ("a : Adder;", ";", "FB_Init's START is missing"),
    "argument_twice": ("a : INT;", "a := Minus(1, minuend := 2);", "given twice"),
    "unknown_parameter": ("a : Adder(1);", "a(z := 1);", "ADDER has no parameter Z"),
    "pointer_arithmetic": (
        "a : POINTER TO UDINT;",
        "a := a + 4;",
        "arithmetic on a pointer to something other",
    ),
    "mixed_sign": ("a : DINT; b : UDINT; c : BOOL;", "c := a < b;", "the sign is ambiguous"),
    "escape": ("a : STRING(3);", "a := '$G';", "syntax"),
    "symbolic_bound": ("a : ARRAY[0..Fixed.answer] OF INT;", ";", "not a literal"),
    "exit_outside": ("a : INT;", "EXIT;", "EXIT outside a loop"),
    "two_of_a_name": ("a : INT; A : INT;", ";", "A is declared twice"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name: str) -> None:
    """What is unknown, or what CODESYS would refuse, is an error with its name, file and line."""
    declarations, body, what = REFUSED[name]
    lines = "\n".join(f"    {d.strip()};" for d in declarations.split(";") if d.strip())
    text = f"PROGRAM Wrong\nVAR\n{lines}\nEND_VAR\n{body}\nEND_PROGRAM\n"
    with pytest.raises(TranslationError) as caught:
        translate({**OBJECTS, "Wrong": text})
    assert caught.value.file == "Wrong"
    assert 1 <= caught.value.line <= len(text.splitlines())
    assert what in caught.value.what


def test_32_bit_processor_wraps_earlier() -> None:
    """On a 32-bit processor the difference of two UDINTs wraps in the register already."""
    text = (
        "PROGRAM P\nVAR\n    a : UDINT := 3;\n    b : UDINT := 4294967295;\n    w : BOOL;\nEND_VAR\n"
        "w := (a - b) > 16#7FFFFFFF;\nEND_PROGRAM\n"
    )
    answers = []
    for bits in (32, 64):
        machine = LibraryMachine(build({"P": text}, Options(cpu_bits=bits)))
        machine.start()
        machine.scan("P")
        answers.append(machine.get("P.w"))
    assert answers == [False, True]


def test_conditional_pragma_takes_one_branch() -> None:
    """Of {IF defined} and {ELSE}, the one that the target decides is translated, the other is not."""
    text = (
        "PROGRAM P\nVAR\n    a : INT;\nEND_VAR\n{IF defined (pou: MemoryBarrier.MemoryBarrier)}\n"
        "a := 1;\n{ELSE}\na := 2;\n{END_IF}\nEND_PROGRAM\n"
    )
    for defined, expected in (((), 2), (("pou: MemoryBarrier.MemoryBarrier",), 1)):
        machine = LibraryMachine(build({"P": text}, Options(defined=defined)))
        machine.start()
        machine.scan("P")
        assert machine.get("P.a") == expected


def test_index_at_run_time_is_a_fault() -> None:
    """An index beyond its array is reported with file and line, not written to memory."""
    text = (
        "PROGRAM P\nVAR\n    i : INT := 4;\n    a : ARRAY[0..3] OF INT;\nEND_VAR\na[i] := 1;\nEND_PROGRAM\n"
    )
    machine = LibraryMachine(build({"P": text}))
    machine.start()
    with pytest.raises(AssertionError, match="P:6: index"):
        machine.scan("P")


LIFE = {
    "Log": "VAR_GLOBAL\n    calls : DINT;\nEND_VAR\n",
    "Inner": """FUNCTION_BLOCK Inner
VAR_OUTPUT
    n : INT := 1;
END_VAR
n := n + 1;
END_FUNCTION_BLOCK
METHOD PUBLIC FB_Init : BOOL
VAR_INPUT
    bInitRetains : BOOL;
    bInCopyCode : BOOL;
END_VAR
calls := calls * 10 + 1;
IF bInCopyCode THEN
    calls := calls + 1;
END_IF;
END_METHOD
METHOD PUBLIC FB_Exit : BOOL
VAR_INPUT
    bInCopyCode : BOOL;
END_VAR
calls := calls * 10 + 3;
IF bInCopyCode THEN
    calls := calls + 1;
END_IF;
END_METHOD
METHOD PUBLIC FB_Reinit : BOOL
calls := calls * 10 + 5;
END_METHOD
""",
    "Things": "VAR_GLOBAL\n    thing : Inner;\nEND_VAR\n",
    "P": "PROGRAM P\nthing();\nEND_PROGRAM\n",
}


def test_online_change_moves_instances() -> None:
    """An online change calls FB_Exit(TRUE), FB_Init(FALSE, TRUE), copies, then calls FB_Reinit."""
    machine = LibraryMachine(build(LIFE))
    machine.start()
    assert machine.get("Log.calls") == 1
    machine.scan("P", count=3)
    before = machine.find("Things.thing.n")[0]
    machine.online_change()
    assert machine.find("Things.thing.n")[0] != before
    assert machine.get("Things.thing.n") == 4
    assert str(machine.get("Log.calls")).endswith("5")
    machine.scan("P")
    assert machine.get("Things.thing.n") == 5
    machine.stop()
    assert str(machine.get("Log.calls")).endswith("3")
