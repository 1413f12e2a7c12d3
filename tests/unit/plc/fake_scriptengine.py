"""A stand-in for the object model that CODESYS gives to scripts, as its help documents it.

Only what is documented exists here, so that a script which asks for more fails; known oddities
are kept: ``pous.remove`` does nothing, names are unique within an application and case does not
tell them apart, line ends may come back changed, create calls may return nothing, and a text
that replaces another one does not change the FB_Init arguments of an instance that was there.
Every change of the project is counted in :attr:`Project.changes`.
"""

from __future__ import annotations

import enum
import re
import sys
import types
from collections.abc import Iterator


class DutType(enum.Enum):
    Structure = 1
    Enumeration = 2


class PouType(enum.Enum):
    Program = 1
    FunctionBlock = 2
    Function = 3


class ImplementationLanguages:
    """The IDE's default may be another language than Structured Text: a script has to say which it means."""

    st = "Structured Text"


class KindOfTask(enum.Enum):
    Cyclic = 1
    Freewheeling = 2


class Aborted(BaseException):
    """The user pressed "cancel", or the IDE went away."""


class Project:
    """The open project: one application, and a count of what was changed in it.

    Args:
        returns: Whether create calls return what they made.
        line_end: The line end with which texts come back.
        abort_after: The number of changes after which the script is aborted.
    """

    def __init__(self, *, returns: bool = True, line_end: str = "\n", abort_after: int | None = None) -> None:
        self.returns, self.line_end, self.abort_after = returns, line_end, abort_after
        self.changes: list[str] = []
        self.active_application = Application(self)

    def changed(self, what: str) -> None:
        if self.abort_after is not None and len(self.changes) >= self.abort_after:
            raise Aborted(what)
        self.changes.append(what)

    def tree(self) -> dict[str, object]:
        """Return every object's content by its path."""
        return dict(self.active_application.walk(""))


class Document:
    def __init__(self, project: Project, owner: str, text: str) -> None:
        self._project, self._owner, self._text = project, owner, text
        self.arguments: dict[str, str] = {}

    @property
    def text(self) -> str:
        return self._text.replace("\n", self._project.line_end)

    def replace(self, new_text: str) -> None:
        assert isinstance(new_text, str)
        self._project.changed(f"replace {self._owner}")
        self._text = new_text.replace("\r\n", "\n")
        for name, arguments in re.findall(r"^ *(\w+) : \w+\((.*)\);", self._text, re.MULTILINE):
            self.arguments.setdefault(name, arguments)


class Item:
    """Any object of the tree."""

    is_folder = is_task_configuration = is_task = is_application = False
    has_textual_declaration = has_textual_implementation = False

    def __init__(self, project: Project, name: str) -> None:
        self._project, self._name = project, name
        self._children: list[Item] = []
        self._parent: Item | None = None

    def get_name(self, resolve_localized_display_name: bool = True) -> str:
        return self._name

    def get_children(self, recursive: bool = False) -> list[Item]:
        assert not recursive
        return list(self._children)

    def remove(self) -> None:
        assert self._parent is not None, f"{self._name} is gone already"
        self._project.changed(f"remove {self._name}")
        self._parent._children.remove(self)
        self._parent = None

    def _add(self, child: Item):
        self._project.changed(f"create {child._name}")
        child._parent = self
        self._children.append(child)
        return child if self._project.returns else None

    def content(self) -> object:
        return None

    def walk(self, path: str) -> Iterator[tuple[str, object]]:
        for child in self._children:
            yield f"{path}/{child._name}", child.content()
            yield from child.walk(f"{path}/{child._name}")


class Textual(Item):
    """A POU, DUT, GVL or method."""

    has_textual_declaration = True

    def __init__(self, project: Project, name: str, declaration: str, implementation: str | None) -> None:
        super().__init__(project, name)
        self.textual_declaration = Document(project, name, declaration)
        self.has_textual_implementation = implementation is not None
        if implementation is not None:
            self.textual_implementation = Document(project, name, implementation)

    def content(self) -> object:
        text = self.textual_declaration._text
        return (text, self.textual_implementation._text if self.has_textual_implementation else None)


class FunctionBlock(Textual):
    def create_method(self, name, return_type=None, language=None):
        assert language is ImplementationLanguages.st
        assert name.upper() not in {child._name.upper() for child in self._children}
        head = f"METHOD {name}" + (f" : {return_type}" if return_type else "")
        return self._add(Textual(self._project, name, f"{head}\nVAR_INPUT\nEND_VAR\n", ""))


class Container(Item):
    """What can hold folders and language objects."""

    def create_folder(self, foldername):
        assert foldername.upper() not in {c._name.upper() for c in self._children if c.is_folder}
        self._add(Folder(self._project, foldername))  # documented without a return value

    def create_dut(self, name, type=DutType.Structure, baseType=None):
        self._free(name)
        body = {DutType.Structure: "STRUCT\nEND_STRUCT", DutType.Enumeration: "(\n)"}[type]
        return self._add(Textual(self._project, name, f"TYPE {name} :\n{body}\nEND_TYPE\n", None))

    def create_gvl(self, name):
        self._free(name)
        return self._add(Textual(self._project, name, "VAR_GLOBAL\nEND_VAR\n", None))

    def create_pou(
        self,
        name,
        type=PouType.FunctionBlock,
        language=None,
        return_type=None,
        base_type=None,
        interfaces=None,
    ):
        assert isinstance(type, PouType)
        assert language is ImplementationLanguages.st
        assert (return_type is not None) == (type is PouType.Function)
        assert base_type is None or type is PouType.FunctionBlock
        self._free(name)
        if type is PouType.FunctionBlock:
            head = f"FUNCTION_BLOCK {name}" + (f" EXTENDS {base_type}" if base_type else "")
            return self._add(FunctionBlock(self._project, name, head + "\nVAR\nEND_VAR\n", ""))
        head = f"FUNCTION {name} : {return_type}" if type is PouType.Function else f"PROGRAM {name}"
        return self._add(Textual(self._project, name, head + "\nVAR\nEND_VAR\n", ""))

    def _free(self, name: str) -> None:
        top: Item = self
        while not top.is_application:
            assert top._parent is not None
            top = top._parent
        if [
            path
            for path, content in top.walk("")
            if path.rsplit("/", 1)[1].upper() == name.upper() and content
        ]:
            raise RuntimeError(f"an object {name} already exists within the same namespace")


class Folder(Container):
    is_folder = True


class Reference:
    def __init__(self, name: str) -> None:
        self.name = name


class LibraryManager(Item):
    def __init__(self, project: Project) -> None:
        super().__init__(project, "Library Manager")
        self.references = [Reference("#Standard"), Reference("IoStandard, 3.5.15.0 (System)")]
        self.missing: set[str] = set()

    def add_placeholder(self, name, default_resolution):
        if name in self.missing:
            raise RuntimeError(f"{name} is not installed")
        assert default_resolution == f"{name}, * (System)"
        assert name not in {r.name.lstrip("#").split(",")[0] for r in self.references}
        self._project.changed(f"library {name}")
        self.references.append(Reference(f"#{name}"))

    def content(self) -> object:
        return tuple(reference.name for reference in self.references)


class Watchdog:
    def __init__(self, task: Task) -> None:
        object.__setattr__(self, "_task", task)
        for name, value in (("enabled", False), ("time", ""), ("time_unit", "ms"), ("sensitivity", "1")):
            object.__setattr__(self, name, value)

    def __setattr__(self, name, value):
        assert name in ("enabled", "time", "time_unit", "sensitivity")
        assert isinstance(value, bool if name == "enabled" else str)
        self._task._project.changed(f"watchdog.{name} of {self._task._name}")
        object.__setattr__(self, name, value)


class Call:
    def __init__(self, name: str) -> None:
        self.name = name


class Calls(list):
    """The programs of a task."""

    def __init__(self, task: Task) -> None:
        super().__init__()
        self._task = task

    def add(self, pou_name, comment=None):
        self._task._project.changed(f"call {pou_name}")
        self.append(Call(pou_name))

    def remove(self, pou_name):
        """Do nothing, as the real one does."""


class Task(Item):
    is_task = True
    _SETTINGS = ("kind_of_task", "interval", "interval_unit", "priority")

    def __init__(self, project: Project, name: str) -> None:
        object.__setattr__(self, "kind_of_task", KindOfTask.Cyclic)
        object.__setattr__(self, "interval", "t#20ms")
        object.__setattr__(self, "interval_unit", "ms")
        object.__setattr__(self, "priority", "1")
        super().__init__(project, name)
        self.pous = Calls(self)
        self.watchdog = Watchdog(self)

    def __setattr__(self, name, value):
        if name in self._SETTINGS:
            assert isinstance(value, KindOfTask if name == "kind_of_task" else str)
            self._project.changed(f"{name} of {self._name}")
            if name == "interval":
                value = value.replace("T#", "t#")  # the IDE writes its own form
        object.__setattr__(self, name, value)

    def content(self) -> object:
        watchdog = (self.watchdog.time, self.watchdog.time_unit, self.watchdog.sensitivity)
        return {
            "kind": self.kind_of_task.name,
            "interval": (self.interval, self.interval_unit),
            "priority": self.priority,
            "watchdog": watchdog if self.watchdog.enabled else None,
            "calls": [call.name for call in self.pous],
        }


class TaskConfiguration(Item):
    is_task_configuration = True

    def create_task(self, name):
        assert name.upper() not in {child._name.upper() for child in self._children}
        return self._add(Task(self._project, name))


class Application(Container):
    is_application = True

    def __init__(self, project: Project) -> None:
        super().__init__(project, "Application")
        self.libraries = LibraryManager(project)
        self.libraries._parent = self
        self._children.append(self.libraries)

    def get_library_manager(self):
        return self.libraries

    def create_task_configuration(self):
        assert not [child for child in self._children if child.is_task_configuration]
        return self._add(TaskConfiguration(self._project, "Task Configuration"))


def run(script: str, project: Project | None) -> None:
    """Execute a script as the IDE does, with the project open."""
    module = types.ModuleType("scriptengine")
    module.projects = types.SimpleNamespace(primary=project)  # type: ignore[attr-defined]
    for name in (DutType, PouType, KindOfTask, ImplementationLanguages):
        setattr(module, name.__name__, name)
    before = sys.modules.get("scriptengine")
    sys.modules["scriptengine"] = module
    try:
        exec(compile(script, "rosplc_import.py", "exec"), {"__name__": "__main__"})
    finally:
        del sys.modules["scriptengine"]
        if before is not None:
            sys.modules["scriptengine"] = before
