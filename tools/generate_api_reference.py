"""Write docs/reference/python-api.md from the docstrings; ``--verify`` only compares."""

from __future__ import annotations

import enum
import importlib
import inspect
from collections.abc import Iterator
from typing import Any

from docstrings import describe, markdown, signature
from generated_page import REFERENCE, filled, run
from rosplc.errors import RosplcError

PAGE = REFERENCE / "python-api.md"
ERRORS = """\
## Errors

All derive from `RosplcError` and have `code`, `what`, `where` and `remedy`. The meaning of each code is in
[error codes](errors.md).

| class | codes | raised for |
| --- | --- | --- |"""
# Package → the text before its names, and the names; none for all that it exports.
PACKAGES = {
    "rosplc": (
        "Channels for any program on the machine, without ROS or a configuration: an object in shared\n"
        "memory describes itself. Other functions load and check a configuration and generate PLC code.\n"
        "Importing rosplc loads no middleware.",
        "attach Channel topics ObjectState bind Binding bind_service bind_action load_project Project "
        "ConfigErrors check generate Delivery RecordView SlotInfo Direction include_dir",
    ),
    "rosplc.virtual_plc": (
        "A virtual PLC: scan cycles on the same objects as a PLC, for laptops and CI.",
        "",
    ),
    "rosplc.model": ("Message types, from a distribution's definitions or from `.msg` text.", "TypeStore"),
    "rosplc.layout": (
        "The layout of a type in memory: offsets, capacities, layout id.",
        "compute_layout Layout Limits",
    ),
    "rosplc.codec": ("Conversion between wire bytes and records.", "Codec Wire"),
    "rosplc.ros": (
        "The ROS side for programs without ROS: an independent node over any backend.",
        "open_backend Backend Endpoint Publisher Subscription Qos EndpointStatus",
    ),
}


def module(name: str) -> Iterator[str]:
    """Yield the section of one package."""
    text, names = PACKAGES[name]
    home = importlib.import_module(name)
    yield f"## {name}\n\n{text}\n"
    for each in names.split() or home.__all__:
        thing = getattr(home, each)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            yield f"### {each}\n"
            yield from entry(f"{name}.{each}", thing)


def entry(path: str, thing: Any) -> Iterator[str]:
    """Yield what is said about a function or a class."""
    if inspect.isfunction(thing):
        # `py`: it is highlighted as Python, and not run as the pages' programs are.
        yield f"```py\n{signature(path, thing)}\n```\n\n{describe(thing)}\n"
        return
    if issubclass(thing, enum.Enum):
        members = "\n".join(f"* `{thing.__name__}.{member.name}`: `{member.value!r}`" for member in thing)
        yield f"{describe(thing)}\n\n{members}\n"
        return
    if public(thing):
        yield f"```py\n{signature(path, thing)}\n```\n"
    # What classes share that are not on the page is said with each class that is.
    classes = [one for one in thing.__mro__ if one is thing or (one.__name__[0] == "_" and one.__doc__)]
    for one in classes:
        yield f"{describe(one)}\n"
    for name, member in [item for one in reversed(classes) for item in vars(one).items()]:
        if name.startswith("_") and name != "__call__":
            continue
        if isinstance(member, property) or inspect.ismemberdescriptor(member):
            kind = getattr(getattr(member, "fget", None), "__annotations__", {}).get("return", "")
            text = describe(member)
            if text or kind:
                yield f"**`{name}{f': {kind}' if kind else ''}`**\n\n{text}\n"
        elif isinstance(member, (classmethod, staticmethod)):
            shown = signature(f"{thing.__name__}.{name}", getattr(thing, name))
            yield f"**{code(shown)}**\n\n{describe(member.__func__)}\n"
        elif inspect.isfunction(member):
            shown = signature("" if name == "__call__" else name, member, bound=True)
            yield f"**{code(shown)}**\n\n{describe(member)}\n"


def public(thing: type) -> bool:
    """Return whether programs make such objects themselves."""
    made = {
        "Channel",
        "Binding",
        "ObjectState",
        "RecordView",
        "SlotInfo",
        "CycleStats",
        "EndpointStatus",
        "Layout",
    }
    return thing.__name__ not in made and not getattr(thing, "_is_protocol", False)


def code(text: str) -> str:
    """Return a signature as inline code, on one line."""
    return "`" + " ".join(text.replace("(\n", "(").replace(",\n)", ")").split()).replace("( ", "(") + "`"


def errors() -> str:
    """Return the table of the classes of errors."""
    classes = sorted(RosplcError.__subclasses__(), key=lambda cls: cls.__name__)
    rows = [
        f"| `{cls.__name__}` | `{cls.family}…` | {markdown((cls.__doc__ or '').splitlines()[0])} |"
        for cls in classes
    ]
    return "\n".join([ERRORS, *rows])


def parts() -> dict[str, str]:
    """Return the page's generated part."""
    found = [text for name in PACKAGES for text in module(name)]
    return {"names": "\n".join([*found, errors()])}


if __name__ == "__main__":
    raise SystemExit(run(__doc__, {PAGE: filled(PAGE, parts())}))
