"""iceoryx2's Python package: publish and subscribe, or its blackboard; either with events to wake up by."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import iceoryx2 as iox2

from rosplc_bench.peers.exchange import COUNT, Transport, serve

_SIZE = 2 * COUNT


class _Key(ctypes.Structure):
    _fields_ = (("number", ctypes.c_uint32),)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and bool(self.number == other.number)

    __hash__ = None  # type: ignore[assignment]


class _Record(ctypes.Structure):
    _fields_ = (("values", ctypes.c_uint16 * COUNT),)


class _Iceoryx(Transport):
    """A node of this run's own, and an event service for each direction."""

    def __init__(self, side: str, root: Path, prefix: str) -> None:
        super().__init__()
        iox2.set_log_level(iox2.LogLevel.Error)
        config = iox2.config.default()
        # All files of iceoryx2 lie here or begin so, and can be removed with the run.
        config.global_cfg.prefix = iox2.FileName.new(prefix)
        config.global_cfg.root_path = iox2.Path.new(f"{root}/")
        self._node = iox2.NodeBuilder.new().config(config).create(iox2.ServiceType.Ipc)
        self._out, self._in = ("a", "b") if side == "A" else ("b", "a")
        self._address = ctypes.addressof(ctypes.c_char.from_buffer(self.record))
        events = {way: self._service(f"event-{way}").event().open_or_create() for way in "ab"}
        self._notifier = events[self._out].notifier_builder().create()
        self._listener = events[self._in].listener_builder().create()

    def _service(self, name: str) -> Any:
        return self._node.service_builder(iox2.ServiceName.new(name))

    def wake(self) -> None:
        """Notify the other side's listener."""
        self._notifier.notify()

    def wait(self) -> None:
        """Wait for a notification."""
        self._listener.blocking_wait()


class PublishSubscribe(_Iceoryx):
    """A service of 200 bytes for each direction, filled in place."""

    def __init__(self, side: str, root: Path, prefix: str) -> None:
        super().__init__(side, root, prefix)
        kind = iox2.Slice[ctypes.c_uint8]
        services = {
            way: self._service(f"bytes-{way}").publish_subscribe(kind).open_or_create() for way in "ab"
        }
        self._publisher = services[self._out].publisher_builder().initial_max_slice_len(_SIZE).create()
        self._subscriber = services[self._in].subscriber_builder().create()

    def send(self, record: bytearray) -> None:
        """Loan a sample, copy into it, send it."""
        sample = self._publisher.loan_slice_uninit(_SIZE)
        ctypes.memmove(sample.payload_ptr, self._address, _SIZE)
        sample.assume_init().send()

    def poll(self, record: bytearray) -> bool:
        """Copy out of the next sample if there is one."""
        sample = self._subscriber.receive()
        if sample is None:
            return False
        ctypes.memmove(self._address, sample.payload_ptr, _SIZE)
        sample.delete()
        return True


class Blackboard(_Iceoryx):
    """An entry of 200 bytes for each direction; its writer makes the service, its reader opens it."""

    def __init__(self, side: str, root: Path, prefix: str) -> None:
        super().__init__(side, root, prefix)
        key = _Key(0)
        creator = self._service(f"board-{self._out}").blackboard_creator(_Key)
        self._board = creator.add(key, _Record()).create()
        self._writer = self._board.writer_builder().create()
        self._entry_out = self._writer.entry(key, _Record)
        self._value = _Record.from_buffer(self.record)
        self._seen: Any = None
        self._entry_in: Any = None

    def begin(self) -> None:
        """Open the other side's entry, which is there by now."""
        if self._entry_in is not None:
            return
        key = _Key(0)
        self._other = self._service(f"board-{self._in}").blackboard_opener(_Key).open()
        self._reader = self._other.reader_builder().create()
        self._entry_in = self._reader.entry(key, _Record)
        self._seen = self._entry_in.get()

    def send(self, record: bytearray) -> None:
        """Update the entry."""
        self._entry_out.update_with_copy(self._value)

    def poll(self, record: bytearray) -> bool:
        """Copy the entry if it has changed."""
        if self._entry_in.is_up_to_date(self._seen):
            return False
        self._seen = self._entry_in.get()
        record[:] = self._seen.data
        return True


def main(side: str, arguments: list[str]) -> None:
    """Arguments: the folder for iceoryx2's files, how their names begin, ``bytes`` or ``blackboard``."""
    root, prefix, kind = arguments
    transport = Blackboard if kind == "blackboard" else PublishSubscribe
    serve(side, transport(side, Path(root), prefix))
