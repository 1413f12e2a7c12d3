"""Identifiers: what a Structured Text compiler accepts, and that no two become one."""

from __future__ import annotations

import re
from importlib.resources import files

import pytest

from rosplc.plc.names import Scope, is_reserved, legal, type_prefix

IDENTIFIER = re.compile(r"(?:[A-Za-z]|_(?=[A-Za-z0-9]))(?:_?[A-Za-z0-9])*\Z")

# Keywords, operators and type names of CODESYS and of IEC 61131-3; written down here a second time,
# from CODESYS' help and the standard, so that a word lost from the list in use is noticed.
_WORDS = """
ABS ABSTRACT ACOS ACTION ADD ADR AND AND_THEN ANDN ANY ANY_BIT ANY_DATE ANY_INT ANY_NUM ANY_REAL ANY_STRING
ARRAY ASIN AT ATAN BIT BITADR BOOL BY BYTE CAL CALC CALCN CASE CONSTANT CONTINUE COS DATE DATE_AND_TIME DINT
DIV DO DT DWORD ELSE ELSIF END_ACTION END_CASE END_FOR END_FUNCTION END_FUNCTION_BLOCK END_IF END_INTERFACE
END_METHOD END_PROGRAM END_PROPERTY END_REPEAT END_STRUCT END_TYPE END_UNION END_VAR END_WHILE EQ EXIT EXP
EXPT EXTENDS FALSE FINAL FOR FUNCTION FUNCTION_BLOCK GE GT IF IMPLEMENTS INDEXOF INI INT INTERFACE INTERNAL
JMP JMPC JMPCN LD LDATE LDATE_AND_TIME LDN LDT LE LIMIT LINT LN LOG LREAL LT LTIME LTIME_OF_DAY LTOD LWORD
MAX METHOD MIN MOD MOVE MUL MUX NE NOT OF OR OR_ELSE ORN PARAMS PERSISTENT POINTER PRIVATE PROGRAM PROPERTY
PROTECTED PUBLIC R READ_ONLY READ_WRITE REAL REF REFERENCE REPEAT RET RETAIN RETC RETCN RETURN ROL ROR S SEL
SHL SHR SIN SINT SIZEOF SQRT ST STN STRING STRUCT SUB SUPER TAN TEST_AND_SET THEN THIS TIME TIME_OF_DAY TO
TOD TRUE TRUNC TRUNC_INT TYPE UDINT UINT ULINT UNION UNTIL USINT VAR VAR_ACCESS VAR_CONFIG VAR_EXTERNAL
VAR_GENERIC VAR_GLOBAL VAR_IN_OUT VAR_INPUT VAR_INST VAR_OUTPUT VAR_STAT VAR_TEMP WHILE WORD WSTRING XOR
XORN XSIZEOF
ACTIONS CLASS CONFIGURATION D DELETE DREF EN END_CLASS END_CONFIGURATION END_GET END_NAMESPACE END_RESOURCE
END_SET END_STEP END_TRANSITION ENDVAR ENO F_EDGE FROM GET INITIAL_STEP N NAMESPACE NON_RETAIN NULL ON
OVERLAP OVERRIDE P PRIORITY R_EDGE REF_TO RESOURCE SET SINGLE STEP TASK TRANSITION USING WITH INTERVAL L SD
ATAN2 TO_CHAR TO_WCHAR CHAR_TO WCHAR_TO LOWER_BOUND UPPER_BOUND
DS SL CHAR WCHAR ANY_ELEMENTARY ANY_DERIVED ANY_MAGNITUDE ANY_SIGNED ANY_UNSIGNED ANY_DURATION ANY_CHARS
"""
KEYWORDS = _WORDS.split()


@pytest.mark.parametrize("word", KEYWORDS)
def test_a_keyword_is_renamed_in_any_case(word):
    """A field with a keyword's name gets another one, whatever the case it is written in."""
    for written in (word, word.lower(), word.capitalize()):
        assert is_reserved(written)
        assert legal(written).upper() not in KEYWORDS
        assert IDENTIFIER.match(legal(written))


@pytest.mark.parametrize(
    "word",
    [
        "BOOL_TO_INT",
        "to_real",
        "LREAL_TO_STRING",
        "ulint_to_ltime",
        "BYTE_TO_BOOL",
        "to_char",
        "WCHAR_TO_INT",
    ],
)
def test_a_conversion_operator_is_reserved(word):
    """The names of conversion operators are keywords, too."""
    assert is_reserved(word)


@pytest.mark.parametrize("word", ["to_base", "base_to_tool", "timeout", "types", "int_value", "x", "data"])
def test_an_ordinary_field_name_stays(word):
    """Names that only resemble keywords are left alone."""
    assert not is_reserved(word)
    assert legal(word) == word


@pytest.mark.parametrize(
    ("ros", "plc"),
    [
        ("type", "_type"),
        ("a__b", "a_b"),
        ("data_", "data"),
        ("_x", "_x"),
        ("__x", "_x"),
        ("2d", "_2d"),
        ("_", "unnamed"),
        ("", "unnamed"),
        ("type_", "_type"),
        ("cmd-vel", "cmd_vel"),
        ("größe", "gr_e"),
        ("~private", "_private"),
    ],
)
def test_what_no_identifier_may_hold_is_replaced(ros, plc):
    """Double, trailing and foreign characters go by a fixed rule."""
    assert legal(ros) == plc


def test_names_that_differ_by_case_only_become_two():
    """IEC identifiers do not tell case apart, so the second of two gets a number."""
    scope = Scope()
    assert [scope.give(name) for name in ("points", "POINTS", "Points")] == ["points", "POINTS_2", "Points_3"]
    assert scope.renamed == [("POINTS", "POINTS_2"), ("Points", "Points_3")]


def test_names_that_collide_after_renaming_become_two():
    """A name that takes the place where another one would land does not meet it."""
    scope = Scope()
    assert [scope.give(name) for name in ("_type", "type", "TYPE")] == ["_type", "_type_2", "_TYPE_3"]


def test_legal_names_stay_whatever_stands_before_them():
    """A name that has to change never takes one that another has by right."""
    scope = Scope()
    given = scope.give_all(["type", "a__b", "_type", "a_b", "A_B"])
    assert given == ("_type_2", "a_b_3", "_type", "a_b", "A_B_2")


def test_a_number_does_not_run_into_the_digits_of_a_name():
    """``joint1`` becomes ``joint1_v2``: ``joint1_2`` would read as another joint."""
    scope = Scope(["JOINT1"])
    assert scope.give("joint1") == "joint1_v2"


def test_a_numbered_name_that_exists_is_passed_over():
    """Numbering goes on until a free name is found."""
    scope = Scope(["a", "a_2", "A_3"])
    assert scope.give("a") == "a_4"


def test_the_prefix_of_a_type_names_package_and_type():
    """Type names that are keywords (Bool, String, Time) are none with their package before them."""
    assert type_prefix("std_msgs/msg/Bool") == "std_msgs_Bool"
    assert type_prefix("std_msgs/String") == "std_msgs_String"


def test_the_list_in_use_holds_single_upper_case_words():
    """Every line of the list is one word or a comment, so that none is read over."""
    text = files("rosplc.plc").joinpath("templates/reserved_words.txt").read_text(encoding="ascii")
    for line in text.splitlines():
        assert line.startswith("#") or re.fullmatch(r"[A-Z_][A-Z0-9_]*|", line), line
