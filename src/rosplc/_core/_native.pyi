"""The C core; one section per C file."""

from typing import Any, Literal, final

from _typeshed import ReadableBuffer, WriteableBuffer

from rosplc.errors import ChannelError

# ---- py_plan.c: wire bytes to record and back

class Fault(Exception):
    """A message or record was refused.

    ``args`` are four numbers: code (1 to 9: COD001 to COD009), op (index in the plan, 0xFFFFFFFF for
    the message as a whole), size and limit; ``rosplc.codec.Codec.explain`` turns them into words.
    """

    args: tuple[int, int, int, int]

@final
class Plan:
    """A plan that the C core has checked. ``blob`` is what ``rosplc.codec.compile_plan`` makes.

    Raises ValueError if the blob is not a sound plan.
    """

    def __new__(cls, blob: ReadableBuffer, /) -> Plan: ...
    @property
    def record_size(self) -> int:
        """Bytes of a record."""
    @property
    def encoded_bound(self) -> int:
        """The most bytes that a record can take on the wire."""
    def decode(self, data: ReadableBuffer, truncate: bool = False, /) -> tuple[bytes, int]:
        """Return the record and the slot's flags (2: something was cut off). Raises Fault."""
    def decode_into(self, data: ReadableBuffer, out: WriteableBuffer, truncate: bool = False, /) -> int:
        """Fill ``out``, a record, and return the slot's flags. Raises Fault; then ``out`` holds anything."""
    def encode(self, record: ReadableBuffer, /) -> bytes:
        """Return the record as a message. Raises Fault if the record has the wrong size."""
    def encode_into(self, record: ReadableBuffer, out: WriteableBuffer, /) -> int:
        """Write the message to ``out`` and return its size. Raises Fault if ``out`` is too small."""

# ---- py_channel.c, py_writer.c, py_reader.c: the channel of spec/shm-format.md
# Sequences, flags and counters are 32-bit words. ChannelError codes are those of section 9.

@final
class SlotInfo(tuple[int, int, int, int, int, int, int, bytes, int]):
    """What a slot says about its message; ``lost`` counts what was missed since the one before."""

    @property
    def sequence(self) -> int: ...
    @property
    def flags(self) -> int: ...
    @property
    def status(self) -> int: ...
    @property
    def stamp_ns(self) -> int: ...
    @property
    def stamp_clock(self) -> int: ...
    @property
    def correlation(self) -> int: ...
    @property
    def lost(self) -> int: ...
    @property
    def client(self) -> bytes: ...
    @property
    def reason(self) -> int: ...

@final
class Region:
    """A mapped object with a private copy of its geometry (M3).

    ``identity`` is a copy of the first 512 bytes; it is checked again, against the file's size.
    Raises ChannelError SHM103 to SHM111. After close(), everything raises ValueError.
    """

    def __new__(cls, fd: int, identity: bytes, writable: bool, path: str) -> Region: ...
    @property
    def record_size(self) -> int: ...
    @property
    def slot_count(self) -> int: ...
    @property
    def generation(self) -> int: ...
    @property
    def path(self) -> str: ...
    @property
    def writable(self) -> bool: ...
    @property
    def closed(self) -> bool: ...
    def word(self, offset: int, /) -> int:
        """Load one control word. Raises IndexError outside the object or off a multiple of four."""
    def words(self, offset: int, count: int, step: int = 1, /) -> tuple[int, ...]:
        """Load ``count`` control words, the first one of each ``step``, each with one access."""
    def store(self, offset: int, value: int, /) -> None:
        """Store one control word. Raises SHM122 if mapped read-only."""
    def read(self, offset: int, size: int, /) -> bytes:
        """Copy bytes of a constant part."""
    def held(
        self,
        path: bytes,
        lock: bytes,
        fd: int,
        device: int,
        inode: int,
        lock_device: int,
        lock_inode: int,
        identity: bytes,
        /,
    ) -> bool:
        """Note on a lock file that it is held; return whether names lead to it and to this object.

        ``path`` and ``lock`` are the names, ``fd`` is the open lock file, the numbers are those of object and
        lock file; the object has to begin with ``identity``. Raises OSError if the lock file takes no time.
        """
    def check(self) -> None:
        """Raise SHM111 or SHM112 if the object is no longer the one that was attached."""
    def close(self) -> None:
        """Unmap the object."""

@final
class Writer:
    """The writer of a channel; claims it from ``expected`` (0: free). Raises SHM114 or SHM122."""

    def __new__(cls, region: Region, expected: int, beat_ms: int) -> Writer: ...
    @property
    def head(self) -> int:
        """Sequence of the newest message, 0 none."""
    @property
    def epoch(self) -> int:
        """The claim."""
    def publish(
        self,
        record: ReadableBuffer,
        *,
        stamp_ns: int = 0,
        stamp_clock: int = 1,
        flags: int = 0,
        correlation: int = 0,
        status: int = 0,
        client: bytes = b"",
        reason: int = 0,
    ) -> int:
        """Publish a record of exactly ``record_size`` bytes and return its sequence.

        Raises SHM111, SHM112 (open the name again) or SHM115 (claim lost).
        """
    def publish_value(self, shape: Shape, value: object, stamp_ns: int | None, until: float, /) -> int:
        """Publish the record of a value, stamped (None: now); raises as publish() and Shape.pack().

        Returns 0, with nothing done, once the monotonic clock has reached ``until`` (s).
        """
    def publish_wire(
        self,
        plan: Plan,
        data: ReadableBuffer,
        *,
        truncate: bool = False,
        stamp_ns: int = 0,
        stamp_clock: int = 1,
        flags: int = 0,
        correlation: int = 0,
        status: int = 0,
        client: bytes = b"",
        reason: int = 0,
    ) -> tuple[int, int]:
        """Decode a message straight into its slot; return its sequence and the slot's flags from decoding.

        Raises Fault if the message is refused (then counted and not published), else as publish().
        """
    def beat(self) -> None:
        """Show that this writer lives. Publishing does so too."""
    def check(self) -> None:
        """Raise what publish() would raise."""
    def release(self) -> None:
        """Give the claim back. Later calls raise ValueError."""
    def refuse(self, error: int = 0, /) -> None:
        """Count a message that was not published, and show an error number."""
    def begun(self, first: int, /) -> bool:
        """Return whether the call whose first message has sequence ``first`` may have been begun (M26).

        To be asked after it was published again as withdrawn. False: it was not executed and never will be.
        """
    def set_sources(self, sources: int, /) -> None:
        """Say how many ROS publishers stand behind this writer; 0xFFFFFFFF unknown."""

@final
class Reader:
    """A reader that goes on after ``last`` (M14), an observer until claim() gives it a line.

    All taking raises SHM111 or SHM112 when the name must be opened again, and beats in passing.
    """

    def __new__(cls, region: Region, last: int) -> Reader: ...
    @property
    def last(self) -> int: ...
    @property
    def lost(self) -> int: ...
    @property
    def retries(self) -> int: ...
    @property
    def discontinuities(self) -> int: ...
    @property
    def line(self) -> int | None: ...
    def claim(self, index: int, expected: int, beat_ms: int, task: str, answer: bool = False) -> None:
        """Claim line ``index`` from ``expected`` (0: free). Raises SHM114 or SHM122.

        ``answer``: line 0, to act on calls; ``last`` becomes head, and the line's ``taken`` stays (M27).
        """
    def latest(self, out: WriteableBuffer, /) -> SlotInfo | None:
        """Copy the newest message to ``out`` if it is new; otherwise leave ``out`` as it is."""
    def update(self, out: WriteableBuffer, /) -> bool:
        """As latest(), and return only whether ``out`` was filled: cheaper where nobody asks for more."""
    def next(self, out: WriteableBuffer, /) -> SlotInfo | None:
        """Copy the message after the last one taken; otherwise leave ``out`` as it is."""
    def peek(self, out: WriteableBuffer, /) -> SlotInfo | None:
        """Copy the current message, new or not, without taking it."""
    def latest_record(self) -> tuple[bytes, SlotInfo] | None:
        """As latest(), as an object of its own: large records are copied once instead of twice."""
    def next_record(self) -> tuple[bytes, SlotInfo] | None:
        """As next(), as an object of its own."""
    def peek_record(self) -> tuple[bytes, SlotInfo] | None:
        """As peek(), as an object of its own."""
    def view(self, shape: Shape, mode: int, until: float, /) -> View | Literal[False] | None:
        """Return a view of a copy of the newest (mode 0), the next (1) or the current message (2).

        Returns False, with nothing taken, once the monotonic clock has reached ``until`` (s).
        """
    @property
    def info(self) -> SlotInfo | None:
        """What the slot says about the message that view() returned last."""
    def latest_wire(self, plan: Plan, /) -> tuple[bytes, SlotInfo] | None:
        """As latest(), encoded straight out of the slot. Raises Fault; the message counts as taken."""
    def next_wire(self, plan: Plan, /) -> tuple[bytes, SlotInfo] | None:
        """As next(), encoded straight out of the slot. Raises Fault; the message counts as taken."""
    def peek_wire(self, plan: Plan, /) -> tuple[bytes, SlotInfo] | None:
        """As peek(), encoded straight out of the slot. Raises Fault."""
    def begin(self) -> bool:
        """Return whether the call just taken may be acted on (M26); if not, take again."""
    def beat(self) -> None:
        """Show that this reader lives."""
    def release(self) -> None:
        """Give the line back and go on as an observer."""
    def set_sinks(self, sinks: int, /) -> None:
        """Say how many ROS subscribers stand behind this reader; 0xFFFFFFFF unknown."""
    def set_error(self, error: int, /) -> None:
        """Show an error number in the line; 0 none."""

def check_identity(first: ReadableBuffer, size: int, direction: int, kind: int = 1, /) -> int:
    """Return the first failing number of section 9 (103 to 111), or 0.

    ``direction`` 0 accepts both, ``kind`` 0 all of topics, services and actions.
    """

def distance(a: int, b: int, slot_count: int, /) -> int:
    """Return the messages from a to b (section 7.1)."""

def next_sequence(s: int, slot_count: int, /) -> int:
    """Return the sequence after s (section 7.1)."""

def beat(users: list[Reader | Writer | tuple[Reader | Writer, ...] | None], /) -> None:
    """Beat on all lines; closed readers and writers are left out. Raises TypeError for anything else."""

# ---- py_record.c: records as Python objects

class View:
    """A record's bytes; the base of ``rosplc.layout.RecordView``."""

    def __copy__(self) -> View: ...
    def __deepcopy__(self, memo: dict[int, Any], /) -> View: ...
    def __getattr__(self, name: str) -> Any: ...
    def _to_dict(self, elements: int = ..., excerpt: type[Any] = ..., /) -> dict[str, Any]:
        """Return the message as dicts and lists; an array that is longer as ``excerpt(start, length)``."""

@final
class Shape:
    """A struct of a layout: packs values and reads records.

    ``fields`` are tuples: name, another attribute that may hold the value (or None), kind (a primitive,
    "string" or a Shape), offset, bytes of an element, its number (-1: no array), the count's offset (-1:
    none). Views are instances of a subclass of ``base``. Raises ValueError if a field leaves the struct,
    LayoutError LAY006 if a default value does not fit.
    """

    def __new__(
        cls,
        type_name: str,
        size: int,
        fields: tuple[tuple[object, ...], ...],
        defaults: dict[str, Any],
        base: type[View],
        /,
    ) -> Shape: ...
    @property
    def initial(self) -> bytes:
        """The record of a message that nobody has filled."""
    def pack(self, value: object, /) -> bytearray:
        """Return the record of a message. Raises LayoutError LAY006 with the field's path."""
    def view(self, buffer: ReadableBuffer, /) -> View:
        """Return a view of the record at a buffer's start. Raises LayoutError LAY006: it is too small."""

# ---- py_sink.c: messages from another extension module

@final
class Sink:
    """Takes messages for a channel from another extension module, without the GIL; closed at first."""

    def __new__(cls) -> Sink: ...
    @property
    def capsule(self) -> object:
        """A rosplc_sink of sink.h."""
    @property
    def messages(self) -> int:
        """How many messages it has passed on."""
    @property
    def truncated(self) -> int:
        """How many of them were shortened."""
    @property
    def last_ns(self) -> int:
        """Monotonic time of the last one, or of open()."""
    def open(self, writer: Writer, plan: Plan, truncate: bool, limit_ns: int, /) -> None:
        """Pass messages on, until one cannot be, or comes after a longer silence (0: any)."""
    def close(self) -> None:
        """Pass nothing on any more: none is being passed on when this returns."""

# ---- py_group.c: one call per tick over all channels

@final
class Group:
    """The channels of one bridge. take() and wait() belong to one thread; the rest may be called from any.

    With ``predict``, wait() learns when channels are written, and looks then; the next tick is one later.
    """

    def __new__(cls, predict: bool = False) -> Group: ...
    def add_reader(self, reader: Reader, plan: Plan, mode: int = 0, limit: int = 64, /) -> int:
        """Add a reader and return its index; ``mode`` 0 newest only, 1 in order, ``limit`` a take().

        2: take() only reports (index, b"", head, 0, 0, 0); what is new is taken with the reader itself.
        """
    def remove(self, index: int, /) -> None:
        """Let go of a channel. Its index may be given out again. Raises IndexError."""
    def divert(self, index: int, capsule: object, /) -> None:
        """Have take() put a channel's messages into a sink, and return those that it does not take."""
    def wait(self, tick_ns: int, timeout_ns: int = -1, longest_ns: int = 0, /) -> int:
        """Sleep to the next tick of an absolute-time grid until a channel has news; return how many have.

        Returns 0 after wake() or the timeout (-1: none). ``tick_ns`` 0 polls without sleeping. A group that
        predicts sleeps until the writers beat, if they do so steadily, but no longer than ``longest_ns``.
        """
    def wake(self) -> None:
        """Make wait() return at its next tick."""
    def take(
        self,
    ) -> tuple[list[tuple[int, bytes, int, int, int, int]], list[tuple[int, Fault | ChannelError]]]:
        """Take what is new: (index, wire bytes, sequence, flags, stamp_ns, stamp_clock), and what failed.

        ``taken`` is stored for every message before this returns (M15). A Fault is a message that was
        taken and cannot be encoded; a ChannelError a channel that must be opened again: it is reported
        once and quiet until removed.
        """
