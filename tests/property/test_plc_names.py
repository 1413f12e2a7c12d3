"""Identifiers over all names that ROS allows, and over any text at all."""

from __future__ import annotations

import re
import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosplc.plc.names import Scope, is_reserved, legal, string_literal, type_prefix

pytestmark = pytest.mark.verifies("names", own="rosplc alone")

# A letter, or one underscore and more; single underscores; none at the end.
IDENTIFIER = re.compile(r"(?:[A-Za-z]|_(?=[A-Za-z0-9]))(?:_?[A-Za-z0-9])*\Z", re.ASCII)
LETTERS = string.ascii_letters + string.digits + "_"
ROS_NAMES = st.builds(
    lambda first, rest: first + rest,
    st.sampled_from(string.ascii_letters),
    st.text(LETTERS, max_size=254),
)
WORDS = st.sampled_from(
    ["type", "Type", "TYPE", "_type", "type_", "t__ype", "points", "POINTS", "a_2", "a", "A"]
)


@given(st.text(max_size=300))
def test_any_text_becomes_an_identifier(text):
    """Whatever the text, the result is an identifier, no keyword, and stays as it is a second time."""
    name = legal(text)
    assert IDENTIFIER.match(name)
    assert not is_reserved(name)
    assert legal(name) == name


@given(st.lists(ROS_NAMES | WORDS, max_size=40))
def test_names_of_a_scope_stay_apart(names):
    """No two names handed out are equal when case does not count, and each change is on record."""
    scope = Scope()
    given_names = [scope.give(name) for name in names]
    assert len({name.upper() for name in given_names}) == len(names)
    assert all(IDENTIFIER.match(name) and not is_reserved(name) for name in given_names)
    changed = [(a, b) for a, b in zip(names, given_names, strict=True) if a != b]
    assert scope.renamed == changed


@given(ROS_NAMES, ROS_NAMES)
def test_a_type_has_an_identifier(package, name):
    """A type's prefix is an identifier for names of any length that ROS allows."""
    assert IDENTIFIER.match(type_prefix(f"{package}/msg/{name}"))


@given(st.text(max_size=200))
def test_a_string_literal_says_the_same_text(text):
    """Read by the rules of Structured Text, the literal gives back the UTF-8 bytes of the text."""
    literal = string_literal(text)
    assert literal.isascii()
    assert literal.isprintable()
    assert read_string(literal) == text.encode()


def read_string(literal: str) -> bytes:
    """Read a literal by the rules of CODESYS' help: ``$`` and a letter, or two hexadecimal digits."""
    assert literal[0] == literal[-1] == "'"
    body, result = literal[1:-1], bytearray()
    while body:
        char, body = body[0], body[1:]
        assert char != "'"
        if char != "$":
            result += char.encode()
            continue
        code = body[0].upper()
        if code in "$'NRTPL":
            result += {"$": b"$", "'": b"'", "N": b"\n", "L": b"\n", "R": b"\r", "T": b"\t", "P": b"\f"}[code]
            body = body[1:]
        else:
            result.append(int(body[:2], 16))
            body = body[2:]
    return bytes(result)
