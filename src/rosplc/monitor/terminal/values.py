"""A message as a tree whose values are live."""

from __future__ import annotations

import math
from typing import Any

from rich.text import Text
from textual.widgets import Tree
from textual.widgets.tree import TreeNode

from rosplc.harmless import one_line
from rosplc.layout.view import Excerpt

__all__ = ["ELEMENTS", "ValueTree"]

ELEMENTS = 64
"""So many elements of an array are shown."""

_PREVIEW = 12
_TEXT = 300


class ValueTree(Tree[str]):
    """Shows nested values; a node's data is its path, ``pose.position.x`` or ``ranges[3]``.

    Labels change in place, so that what is open stays open and the cursor stays where it is.
    """

    def __init__(self) -> None:
        super().__init__("", data="")
        self.show_root = False
        self.guide_depth = 2
        self._known: dict[str, TreeNode[str]] = {}
        self._labels: dict[str, str] = {}
        self._shape: object = None
        self._values: dict[str, Any] = {}

    def show(self, values: dict[str, Any], shape: object) -> None:
        """Show values.

        Args:
            values: A message's values.
            shape: Tells types apart; where it differs from the last one, the tree is made anew.
        """
        if shape != self._shape:
            self._shape = shape
            self.clear()
            self.root.expand()
            self._known = {"": self.root}
            self._labels.clear()
        self._values = values
        self._update(self.root, "", values)

    def on_tree_node_expanded(self, event: Tree.NodeExpanded[str]) -> None:
        """Fill what was opened."""
        path = event.node.data or ""
        value = self._at(path)
        if value is not None:
            self._update(event.node, path, value)

    def _at(self, path: str) -> Any:
        found: Any = self._values
        for part in path.replace("[", ".[").split("."):
            try:
                if part.startswith("["):
                    found = found[int(part[1:-1])]
                elif part:
                    found = found[part]
            except (KeyError, IndexError, TypeError, ValueError):
                return None
        return found

    def _update(self, node: TreeNode[str], path: str, value: Any) -> None:
        if not node.is_expanded:
            return
        items = _items(path, value)
        for child in list(node.children):
            if child.data not in items:
                self._forget(child.data or "")
                child.remove()
        for child_path, (name, item) in items.items():
            inner = isinstance(item, (dict, list)) and bool(item)
            known = self._known.get(child_path)
            if known is not None and known.allow_expand != inner:
                self._forget(child_path)
                known.remove()
                known = None
            if known is None:
                # A message's own structs open by themselves; arrays may be long.
                opened = isinstance(item, dict) and path.count(".") < 2
                known = node.add("", data=child_path, expand=opened and inner, allow_expand=inner)
                self._known[child_path] = known
            label = f"{name}\0{_shown(item)}"
            if self._labels.get(child_path) != label:
                self._labels[child_path] = label
                known.set_label(_label(name, _shown(item)))
            if inner:
                self._update(known, child_path, item)

    def _forget(self, path: str) -> None:
        for known in [
            known for known in self._known if known == path or known.startswith((path + ".", path + "["))
        ]:
            del self._known[known]
            self._labels.pop(known, None)


def _items(path: str, value: Any) -> dict[str, tuple[str, Any]]:
    """Return the path, name and value of each child."""
    if isinstance(value, dict):
        return {f"{path}.{name}" if path else name: (name, item) for name, item in value.items()}
    if isinstance(value, list):
        return {f"{path}[{index}]": (f"[{index}]", item) for index, item in enumerate(value[:ELEMENTS])}
    return {}


def _label(name: str, shown: str) -> Text:
    return Text.assemble((name, "bold"), " ", shown, no_wrap=True, end="")


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return ""
    if isinstance(value, list):
        length = value.length if isinstance(value, Excerpt) else len(value)
        if value and isinstance(value[0], (dict, list)):
            return f"({length})"
        words = ", ".join(_shown(item) for item in value[:_PREVIEW])
        return f"({length}) {words}" + (", …" if length > _PREVIEW else "")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else str(value)
    if isinstance(value, str):
        return one_line(repr(value if len(value) <= _TEXT else value[:_TEXT] + "…"))
    return str(value)
