"""A block's way to its object: opened lazily, given up when it is retired, opened again.

The rules are those of a PLC (``spec/shm-format.md``, sections 8 and 9): never create,
delete or wait; compare state and layout id at every call; try to open at most once per
scan over all blocks, with back-off.
"""

from __future__ import annotations

from dataclasses import dataclass

from rosplc.described import described_layout, layout_of
from rosplc.errors import ChannelError
from rosplc.layout import Layout
from rosplc.shm import Attached, Direction, Namespace, attach
from rosplc.virtual_plc.scan import Scan

__all__ = ["Link", "error_number"]

_FIRST_DELAY_NS = 20_000_000
_LONGEST_DELAY_NS = 1_000_000_000


def error_number(error: ChannelError) -> int:
    """Return the number of spec/shm-format.md, section 9, that a function block shows."""
    return int(error.code.removeprefix("SHM"))


@dataclass(slots=True)
class _BackOff:
    delay_ns: int = 0
    due_ns: int = 0

    def failed(self, now_ns: int) -> None:
        self.delay_ns = min(_LONGEST_DELAY_NS, self.delay_ns * 2 or _FIRST_DELAY_NS)
        self.due_ns = now_ns + self.delay_ns

    def reset(self) -> None:
        self.delay_ns = self.due_ns = 0


class Link:
    """Leads one block to its object.

    Args:
        topic: The topic as ROS writes it.
        namespace: Where its objects stand.
        direction: What the block expects: TO_PLC to read, TO_ROS to write.
        layout: The compiled-in layout, as a PLC has it; None takes the object's own.
        write: Whether the block publishes.

    Attributes:
        attached: The open object, or None.
        layout: The layout in use; None until it is known.
        error: The number of the last failure (spec, section 9); 0 while the object is open.
        reason: The same failure in words.
        opened: Counts successful openings, so that a block notices a new object.
    """

    def __init__(
        self,
        topic: str,
        *,
        namespace: Namespace,
        direction: Direction,
        layout: Layout | None,
        write: bool = False,
    ) -> None:
        self.topic = topic
        self.namespace = namespace
        self.attached: Attached | None = None
        self.layout = layout
        self.error = 101
        self.reason = ""
        self.opened = 0
        self._compiled = layout
        self._direction = direction
        self._write = write
        self._map_writable = True
        self._back_off = _BackOff()

    def follow(self, scan: Scan) -> Attached | None:
        """Return the object if it is open and still valid; else try once to open it.

        Nothing is raised: what went wrong stands in :attr:`error` and :attr:`reason`.
        """
        if self.attached is not None:
            try:
                self.attached.valid()
            except ChannelError as error:
                self.drop(error)
                # Whoever retires an object puts the next one in its place: look at once.
                self._back_off.reset()
            else:
                return self.attached
        if scan.now_ns < self._back_off.due_ns or not scan.claim_open():
            return None
        try:
            self._open()
        except ChannelError as error:
            self.error, self.reason = error_number(error), str(error)
            self._back_off.failed(scan.now_ns)
            return None
        self.error, self.reason = 0, ""
        self.opened += 1
        self._back_off.reset()
        return self.attached

    def drop(self, error: ChannelError) -> None:
        """Give the object up because of ``error``; the next scans open it again."""
        self.close()
        self.error, self.reason = error_number(error), str(error)

    def look_for_another(self, scan: Scan) -> bool:
        """Open the name again beside a silent object; switch if it leads to another one.

        A bridge that finds its file removed makes a new object that the old one cannot
        tell of (spec, section 8.6). The old object is kept until then, so that a claim and
        the place in its stream survive a bridge that is only away for a while.

        Returns:
            Whether the link now leads to another object.
        """
        old = self.attached
        if old is None or scan.now_ns < self._back_off.due_ns or not scan.claim_open():
            return False
        try:
            if old.still_there():
                self._back_off.failed(scan.now_ns)
                return False
            self._open()
        except ChannelError as error:
            self.reason = str(error)
            self._back_off.failed(scan.now_ns)
            return False
        old.close()
        self.opened += 1
        self._back_off.reset()
        return True

    def close(self) -> None:
        """Let go of the object."""
        if self.attached is not None:
            self.attached.close()
            self.attached = None

    def _open(self) -> None:
        compiled = self._compiled
        try:
            attached = attach(self.namespace, self.topic, direction=self._direction, write=self._map_writable)
        except ChannelError as error:
            if error.code == "SHM102" and not self._write:
                # A reader needs no rights to write; without them it only has no reader line.
                self._map_writable = False
            raise
        try:
            if compiled is None:
                layout = layout_of(attached)
            else:
                layout = compiled
                self._compare(attached, compiled)
        except ChannelError:
            attached.close()
            raise
        self.attached, self.layout = attached, layout

    def _compare(self, attached: Attached, compiled: Layout) -> None:
        found = attached.identity.layout_id
        if found == compiled.layout_id and attached.identity.record_size == compiled.size:
            return
        made_for = f"layout {compiled.layout_id} of {compiled.type_name}"
        what = f"the program was made for {made_for}, the object has {found}"
        try:
            what += f": {compiled.difference(described_layout(attached.description, where=self.topic))}"
        except ChannelError as error:
            # That the ids differ is certain; what differs only the description could tell.
            what += f" (why cannot be said: {error.what})"
        raise ChannelError("SHM112", what, where=self.topic)
