"""Find the translator: ``rosplc_st``, a development package of the checkout, never installed with rosplc."""

from __future__ import annotations

import importlib.util
import shlex
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rosplc
from rosplc.errors import GenerationError, SetupError


@dataclass(frozen=True)
class Translator:
    """The translator of a checkout, whose top folder is ``root``."""

    root: Path

    @property
    def programs(self) -> Path:
        """The folder of the demonstration's own Structured Text."""
        return self.root / "examples" / "st"

    def build(self, texts: Mapping[str, str], on_parsed: Callable[[int, int], None] | None = None) -> Any:
        """Translate and compile texts by object name; those known from before come from ``.cache``.

        ``on_parsed`` is called with how many of the new texts are parsed, and of how many. Raises
        GenerationError PLC004, a text cannot be translated; SetupError SYS001, gcc does not compile it.
        """
        from rosplc_st.build import build
        from rosplc_st.translator.source import TranslationError

        try:
            return build(texts, progress=on_parsed)
        except TranslationError as error:
            where = f"{error.file}.st:{error.line}"
            raise GenerationError("PLC004", str(error.what), where=where) from error
        except RuntimeError as error:
            if type(error) is not RuntimeError:
                raise  # what ends a command line is a RuntimeError, too
            raise SetupError(
                "SYS001", str(error).strip(), remedy="sudo apt-get install gcc libc6-dev"
            ) from error

    def machine(self, built: Any) -> Any:
        """Load a built program into this process, by the machine's own clock."""
        from rosplc_st.machine import LibraryMachine

        machine = LibraryMachine(built)
        machine.option("real_clock")
        return machine


def find_translator() -> Translator:
    """Return the translator of the checkout that this package runs from.

    Raises SetupError SYS001, there is none, or what it needs is missing; the remedy says how to get it.
    """
    root = Path(rosplc.__file__).resolve().parents[2]
    if not (root / "tests" / "st" / "pyproject.toml").is_file():
        raise SetupError(
            "SYS001",
            "the translator for Structured Text is missing; it is no part of the installed package",
            where=str(root),
            remedy="Take a checkout of rosplc's sources, `make setup` there, and run "
            "`.venv/bin/rosplc demo --plc st`.",
        )
    if shutil.which("gcc") is None:
        raise SetupError("SYS001", "gcc is missing", remedy="sudo apt-get install gcc libc6-dev")
    if importlib.util.find_spec("rosplc_st") is None or importlib.util.find_spec("blark") is None:
        raise SetupError(
            "SYS001",
            "the Python package rosplc-st is missing, which translates Structured Text",
            remedy=f"pip install -e {shlex.quote(str(root / 'tests' / 'st'))}",
        )
    return Translator(root)
