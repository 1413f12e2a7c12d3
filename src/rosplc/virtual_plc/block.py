"""What Read and Write blocks share: their task, their object, the other side, and their error.

A block finds its object as a PLC does (``spec/shm-format.md``, sections 8 and 9): it never creates, deletes
or waits, compares state and layout id at every call, and opens at most once per scan over all blocks, with
back-off.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager

from rosplc.described import described_layout, layout_of
from rosplc.errors import ChannelError
from rosplc.layout import Layout
from rosplc.shm import Attached, Direction, Namespace, Part, Peer, attach
from rosplc.shm.constants import ErrorNumber
from rosplc.virtual_plc.task import Scan, current_scan

_FIRST_DELAY_NS = 20_000_000
_LONGEST_DELAY_NS = 1_000_000_000


def error_number(error: ChannelError) -> int:
    """Return the number of spec/shm-format.md, section 9, that a function block shows."""
    return int(error.code.removeprefix("SHM"))


class _Instance(ABC):
    """An instance of a block, which belongs to the task that calls it first.

    Attributes:
        udiReentries: Calls that were turned away, because another task owns the instance or was inside.
    """

    def __init__(self) -> None:
        self.udiError = self.udiReentries = 0
        self.reason = ""
        self._task = ""
        self._busy = threading.Lock()

    @property
    def xError(self) -> bool:
        """Whether ``udiError`` is not 0."""
        return self.udiError != 0

    @property
    def eError(self) -> ErrorNumber | None:
        """``udiError`` by its name; None while it is 0."""
        return ErrorNumber(self.udiError) if self.udiError else None

    @contextmanager
    def _entered(self) -> Iterator[Scan | None]:
        """Give the scan that the call belongs to; None if another task owns the instance or is inside."""
        scan = current_scan()
        if not self._busy.acquire(blocking=False):
            self.udiReentries += 1
            yield None
            return
        try:
            self._task = self._task or scan.task
            foreign = bool(scan.task) and self._task != scan.task
            self.udiReentries += foreign
            yield None if foreign else scan
        finally:
            self._busy.release()

    def __call__(self) -> bool:
        """Run the block once.

        Return ``xNew`` or ``xPublished``; of a client ``xDone``, of a server whether it has a call in hand.

        Raises:
            LayoutError: LAY006, if a value to be sent does not fit its field; nothing is sent.
        """
        with self._entered() as scan:
            if scan is not None:
                return self._run(scan)
            self.udiError, self.reason = ErrorNumber.REENTERED.value, "the instance belongs to another task"
            return False

    @abstractmethod
    def _run(self, scan: Scan) -> bool: ...


class Block(_Instance):
    """A block on one topic.

    Attributes:
        layout: The layout of ``msg``, or None before it is known.
    """

    def __init__(
        self, topic: str, namespace: Namespace, direction: Direction, layout: Layout | None, beat_ms: int
    ) -> None:
        super().__init__()
        self.topic = topic
        self.xAttached = self.xPeerAlive = False
        self.udiSequence = 0
        self.layout = self._compiled = layout
        self._namespace, self._direction = namespace, direction
        self._part, self._client = Part.TOPIC, ""
        self._attached: Attached | None = None
        self._failure: tuple[int, str] = (ErrorNumber.NO_OBJECT.value, "")  # 0 while the object is open
        self._opened_times = 0
        self._map_writable = True
        self._delay_ns = self._due_ns = 0  # of the next attempt to open
        self._beat_ms = beat_ms
        self._opened = 0
        self._peer = Peer()

    def _report_silence(self) -> None:
        if self.udiError == 0 and self._peer.silent:
            self.udiError, self.reason = ErrorNumber.PEER_SILENT.value, "the bridge does not beat"

    # -- the way to the object

    def _follow(self, scan: Scan) -> Attached | None:
        """Return the object if it is open and still valid; else try once to open it. Nothing is raised."""
        if self._attached is not None:
            try:
                self._attached.valid()
            except ChannelError as error:
                self._drop(error)
                # An object is retired when the next one takes its place: look at once.
                self._delay_ns = self._due_ns = 0
            else:
                return self._attached
        if scan.now_ns < self._due_ns or not scan.claim_open():
            return None
        try:
            self._open()
        except ChannelError as error:
            self._failure = error_number(error), str(error)
            self._back_off(scan)
            return None
        self._failure = 0, ""
        return self._attached

    def _drop(self, error: ChannelError) -> None:
        """Give the object up because of ``error``; the next scans open it again."""
        self._detach()
        self._failure = error_number(error), str(error)

    def _look_for_another(self, scan: Scan) -> None:
        """Open the name again beside a silent object; switch if it leads to another one.

        A bridge that finds its file removed makes a new object that the old one cannot
        tell of (spec, section 8.6). The old object is kept until then, so that a claim and
        the place in its stream survive a bridge that is only away for a while.
        """
        old = self._attached
        if old is None or scan.now_ns < self._due_ns or not scan.claim_open():
            return
        try:
            if old.still_there():
                self._back_off(scan)
                return
            self._open()
        except ChannelError as error:
            self._failure = self._failure[0], str(error)
            self._back_off(scan)
            return
        old.close()

    def _detach(self) -> None:
        if self._attached is not None:
            self._attached.close()
            self._attached = None

    def close(self) -> None:
        """Let go of the object; the next call opens it again."""
        self._detach()

    def _back_off(self, scan: Scan) -> None:
        self._delay_ns = min(_LONGEST_DELAY_NS, self._delay_ns * 2 or _FIRST_DELAY_NS)
        self._due_ns = scan.now_ns + self._delay_ns

    def _open(self) -> None:
        compiled = self._compiled
        try:
            attached = attach(
                self._namespace,
                self.topic,
                direction=self._direction,
                write=self._map_writable,
                part=self._part,
                client=self._client,
            )
        except ChannelError as error:
            if error.code == "SHM102" and self._direction is Direction.TO_PLC:
                # A reader needs no rights to write; without them it only has no reader line.
                self._map_writable = False
            raise
        try:
            if compiled is None:
                self.layout = layout_of(attached)
            else:
                self._compare(attached, compiled)
        except ChannelError:
            attached.close()
            raise
        self._attached = attached
        self._opened_times += 1
        self._delay_ns = self._due_ns = 0

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
