"""A node's parameters on the parameter server of the ROS 1 master, below the node's name.

The server has no types and refuses nothing: an invalid value is reset on the server, and this is logged.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import closing, suppress
from typing import Any
from xmlrpc.client import Binary

from rosplc.ros.parameters import Apply, Parameter
from rosplc.ros.rospy.master import Master, UnreachableError

_logger = logging.getLogger("rosplc.ros.rospy")
_PERIOD_NS = 1_000_000_000
# XML has no such characters, and reads a carriage return as a new line.
_NOT_IN_XML = re.compile("[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class MasterParameters:
    """Keeps parameters on the master's server; ``apply`` puts values that are set there into effect.

    Parameters with ``take`` are global: they are read, but never set. The others are not used before
    :meth:`begin`, or before :meth:`changed` has set the values in effect. ``look`` is for the thread that
    maintains the node's registration; the other methods may be called from any thread.
    """

    def __init__(self, node: Any, declared: Sequence[Parameter], apply: Apply) -> None:
        self._own = [each for each in declared if each.take is None]
        self._global = [each for each in declared if each.take is not None]
        self.values = {each.name: each.value for each in declared}
        self._node, self._apply, self._place = node, apply, node.node
        self._shown: dict[str, str] = {}  # by name, what the server was last seen to have
        self._asked: set[str] = set()  # names of what ``apply`` was asked for
        self._known = self._ours = False  # what holds; that what is set from now on is asked for
        self._told = False  # the master tells of sets
        self._due_ns = 0

    def begin(self, names: Collection[str]) -> Mapping[str, Any]:
        """Return earlier values of these parameters on the server; they take effect."""
        found: Mapping[str, Any] = {}
        master = Master(self._node.master_uri, self._place, clock=self._node.clock)
        with closing(master), suppress(UnreachableError):
            found = self._wanted(master.setting(self._place), names)
        self.changed(found)
        self._ours = True
        return found

    def changed(self, values: Mapping[str, Any]) -> None:
        """Note values that are in effect now; the server gets them within a second."""
        self.values, self._known = {**self.values, **values}, True

    def notice(self) -> None:
        """Note that the values on the server may have changed."""
        self._due_ns = 0
        self._node.wake()

    def close(self) -> None:
        """Stop checking the server; its values stay."""
        self._node.parameters = None

    def look(self, master: Master) -> None:
        """Compare the values with those on the server, once per second. Raises as :meth:`Master.call`."""
        now = self._node.clock.monotonic_ns()
        if now < self._due_ns:
            return
        self._due_ns = now + _PERIOD_NS
        for each in self._global:
            found = master.setting(f"/{each.name}")
            if self._news(each.name, found) and isinstance(found, bool) and each.take is not None:
                each.take(found)
        if not self._own or not self._known:
            return
        tree = master.setting(self._place) if self._told else None
        if tree is None:  # nothing is there, as on a master that has begun
            tree = master.call("subscribeParam", self._node.uri, self._place)
            self._told = True
        if wanted := self._wanted(tree):
            self._ask(wanted)
        self._ours = True
        for each in self._own:
            form = _form(self.values[each.name])
            if each.name not in self._asked and _text(form) != self._shown[each.name]:
                master.call("setParam", self._path(each.name), form)
                self._shown[each.name] = _text(form)

    def _path(self, name: str) -> str:
        return f"{self._place}/{name.replace('.', '/')}"

    def _news(self, name: str, found: Any) -> bool:
        """Note the server's value, None if there is none; return whether another node has set it."""
        before, self._shown[name] = self._shown.get(name), _text(found)
        return found is not None and self._shown[name] != before

    def _wanted(self, tree: Any, preset: Collection[str] | None = None) -> dict[str, Any]:
        """Return the values that were set on the server and are valid; others are logged."""
        wanted = {}
        for each in self._own:
            found = tree
            for part in each.name.split("."):
                found = found.get(part) if isinstance(found, dict) else None
            if not self._news(each.name, found):
                continue
            try:
                value = _fitting(each, found)
            except (ValueError, RecursionError) as error:
                self._refused(each.name, str(error))
                continue
            if value == self.values[each.name] and each.name not in self._asked:
                continue
            if preset is not None and each.name not in preset:
                self._refused(each.name, "the command line sets it")
            elif each.read_only and preset is None:
                self._refused(each.name, "it is read-only")
            elif preset is None and not self._ours:
                self._refused(each.name, "the bridge started with the PLC's value")
            else:
                wanted[each.name] = value
        return wanted

    def _refused(self, name: str, why: str) -> None:
        text = "%s is reset to %s on the parameter server: %s"
        _logger.warning(text, self._path(name), self.values[name], why)

    def _ask(self, wanted: Mapping[str, Any]) -> None:
        def done(why: str) -> None:
            for name in wanted if why else ():
                self._refused(name, why)
            self._asked.difference_update(wanted)
            self.notice()

        self._asked.update(wanted)
        self._apply(wanted, done)


def _text(value: Any) -> str:
    """Return a text that distinguishes values, also by type; NaN equals NaN."""
    try:
        return repr(value)
    except RecursionError:  # lists in lists in lists
        return "too deep"


def _form(value: Any) -> Any:
    """Convert a value for XML-RPC: integers of more than 32 bits become doubles, bytes a list."""
    if isinstance(value, bytes | list):
        return [_form(each) for each in value]
    if isinstance(value, str):
        return _NOT_IN_XML.sub("\ufffd", value)
    return float(value) if isinstance(value, int) and not -(2**31) <= value < 2**31 else value


def _fitting(parameter: Parameter, found: Any) -> Any:
    """Convert a value on the server to a parameter's value; ValueError with the reason if not possible."""
    found = list(found.data) if isinstance(found, Binary) else found
    return parameter.fitting(_whole(found) if parameter.kind.startswith("integer") else found)


def _whole(found: Any) -> Any:
    if isinstance(found, list):
        return [_whole(each) for each in found]
    return int(found) if isinstance(found, float) and found.is_integer() else found
