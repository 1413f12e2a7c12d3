"""Writing definitions that came from elsewhere as ``.msg`` files, to be read again by the folder reader."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from rosplc.errors import MessageTypeError
from rosplc.model.parse import full_name

if TYPE_CHECKING:
    from collections.abc import Mapping


_SEPARATOR = re.compile(r"^={80}\s*\nMSG:\s*(\S+)\s*\n", re.MULTILINE)


def split_definition(type_name: str, text: str) -> dict[str, str]:
    """Return the parts of a definition text by full type name, the text's own type first.

    Args:
        type_name: The type that the text defines first.
        text: The ``.msg`` text, other types after lines of 80 ``=``; one that parses.
    """
    first, *others = _SEPARATOR.split(text.replace("\r\n", "\n"))
    parts = {full_name(type_name): first.strip("\n") + "\n"}
    for name, part in zip(others[::2], others[1::2], strict=True):
        parts.setdefault(full_name(name), part.strip("\n") + "\n")
    return parts


def save_definitions(texts: Mapping[str, str], folder: Path) -> tuple[Path, ...]:
    """Write ``package/msg/Name.msg`` below a folder for each text; return the files.

    A file that says the same already is left as it is.

    Args:
        texts: Definition by full type name.
        folder: Where the packages stand; made if it is not there.

    Raises:
        MessageTypeError: TYP001 if a name is none; TYP009 if a file of that name says something else,
            or cannot be written. Nothing is written in the first two cases.
    """
    wanted = {}
    for name, text in texts.items():
        package, _, base = full_name(name).split("/")
        wanted[folder / package / "msg" / f"{base}.msg"] = text
    for file, text in wanted.items():  # all or nothing
        _check(file, text)
    for file, text in wanted.items():
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        except OSError as error:
            raise MessageTypeError(
                "TYP009", f"cannot be written: {error.strerror}", where=str(file)
            ) from None
    return tuple(wanted)


def _check(file: Path, text: str) -> None:
    try:
        if file.read_text(encoding="utf-8") != text:
            raise MessageTypeError("TYP009", "holds another definition", where=str(file))
    except FileNotFoundError:
        pass
    except (OSError, UnicodeDecodeError) as error:
        what = getattr(error, "strerror", None) or "is not UTF-8 text"
        raise MessageTypeError("TYP009", f"is in the way: {what}", where=str(file)) from None
