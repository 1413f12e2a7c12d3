"""The message packages of an installation: ``from std_msgs.msg import String`` finds a class.

Classes look as rosidl_generator_py makes them (resource/_msg.py.em): a metaclass with the type
support, and ``get_fields_and_field_types``. The definitions are a type store's; a test installs
another one, or takes a package away.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import sys
import types
from collections.abc import Iterable
from typing import Any

from rosplc.model import TypeStore
from rosplc.model.types import ArrayType, MessageType, NamedType, PrimitiveType, SequenceType, StringType


class _Installation(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def __init__(self) -> None:
        self.use(TypeStore.bundled("jazzy"), frozenset())

    def use(self, store: TypeStore, without: frozenset[str]) -> None:
        self.store, self.without = store, without
        names = (*store.names(), *store.services(), *store.actions())
        self.packages = {name.split("/")[0] for name in names} - without

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        package, _, rest = fullname.partition(".")
        if package in self.without:
            raise ModuleNotFoundError(f"No module named {package!r}", name=package)
        if package not in self.packages or rest not in ("", *_KINDS):
            return None
        return importlib.machinery.ModuleSpec(fullname, self, is_package=not rest)

    def create_module(self, spec: Any) -> types.ModuleType:
        return types.ModuleType(spec.name)

    def exec_module(self, module: types.ModuleType) -> None:
        package, _, rest = module.__name__.partition(".")
        module.__file__ = f"/opt/ros/double/{package}/{rest}"
        if rest:
            names, make = _KINDS[rest]
            for name in names(self.store):
                if name.startswith(f"{package}/{rest}/"):
                    setattr(module, name.rsplit("/", 1)[1], make(self.store, name))


_installation = _Installation()


def install() -> None:
    """Make the packages importable."""
    for name in [name for name in sys.modules if name.split(".")[0] in _installation.packages]:
        del sys.modules[name]  # ROS 1's, imported before by a process that this one was forked from
    if _installation not in sys.meta_path:
        sys.meta_path.insert(0, _installation)  # before ROS 1's packages, if this machine has them


def uninstall() -> None:
    """Take them away."""
    change(_installation.store)
    sys.meta_path.remove(_installation)


def change(store: TypeStore, without: Iterable[str] = ()) -> None:
    """Install other definitions, or no longer these packages."""
    for package in _installation.packages:
        for name in (package, *(f"{package}.{kind}" for kind in _KINDS)):
            if getattr(sys.modules.get(name), "__loader__", None) is _installation:
                del sys.modules[name]
    _installation.use(store, frozenset(without))


def _service(store: TypeStore, name: str) -> type:
    parts = {part: _make(store, store[f"{name}_{part}"]) for part in ("Request", "Response")}
    return type(name.rsplit("/", 1)[1], (), parts)


def _action(store: TypeStore, name: str) -> type:
    impl = {
        "SendGoalService": _service(store, f"{name}_SendGoal"),
        "GetResultService": _service(store, f"{name}_GetResult"),
        "FeedbackMessage": _make(store, store[f"{name}_FeedbackMessage"]),
    }
    parts = {part: _make(store, store[f"{name}_{part}"]) for part in ("Goal", "Result", "Feedback")}
    return type(name.rsplit("/", 1)[1], (), {**parts, "Impl": type("Impl", (), impl)})


def _make(store: TypeStore, message: MessageType) -> type:
    fields = {field.name: _text(field.type) for field in message.fields}
    defaults = {field.name: _default(field.type) for field in message.fields}

    class Metaclass(type):
        _TYPE_SUPPORT: Any = None

        @classmethod
        def __import_type_support__(cls) -> None:
            cls._TYPE_SUPPORT = object()

    def __init__(self: Any, **kwargs: Any) -> None:
        assert kwargs.keys() <= fields.keys(), f"Invalid arguments passed to constructor: {kwargs.keys()}"
        for name, default in defaults.items():
            setattr(self, name, kwargs.get(name, default))

    body = {constant.name: constant.value for constant in message.constants} | {
        "__init__": __init__,
        "get_fields_and_field_types": classmethod(lambda _: dict(fields)),
        "_double_name": message.name,
        "_double_hash": store.type_hash(message.name),
    }
    package, _, name = message.name.split("/")
    made = Metaclass(name, (), body)
    made.__module__ = f"{package}.msg"
    return made


def _text(kind: Any) -> str:
    """Write a type as the template does: prefix, name of the (nested) type, suffix."""
    inner = kind.element if isinstance(kind, ArrayType | SequenceType) else kind
    if isinstance(inner, PrimitiveType):
        # rosidl_adapter turns byte into octet, char into uint8, and the floats into IDL's names
        text = {
            "bool": "boolean",
            "byte": "octet",
            "char": "uint8",
            "float32": "float",
            "float64": "double",
        }.get(inner.name, inner.name)
    elif isinstance(inner, StringType):
        text = "string" + (f"<{inner.bound}>" if inner.bound else "")
    else:
        assert isinstance(inner, NamedType)
        package, _, name = inner.name.split("/")
        text = f"{package}/{name}"
    if isinstance(kind, SequenceType):
        return f"sequence<{text}" + (f", {kind.bound}" if kind.bound else "") + ">"
    return f"{text}[{kind.length}]" if isinstance(kind, ArrayType) else text


_KINDS: dict[str, tuple[Any, Any]] = {
    "msg": (TypeStore.names, lambda store, name: _make(store, store[name])),
    "srv": (TypeStore.services, _service),
    "action": (TypeStore.actions, _action),
}


def _default(kind: Any) -> Any:
    if isinstance(kind, StringType):
        return ""
    if isinstance(kind, PrimitiveType):
        return False if kind.name == "bool" else 0
    return None
