"""Structured Text, as CODESYS documents it, translated to C.

The subset is the one that the generator writes. Everything else is an error with its name,
file and line, so that no statement is skipped silently. Where CODESYS' compiler would refuse
a text (a narrowing assignment, a private method called from outside), so does this one.
"""

from __future__ import annotations

from rosplc_st.translator.emit import Options, Translation, translate
from rosplc_st.translator.source import TranslationError

__all__ = ["Options", "Translation", "TranslationError", "translate"]
