"""Transforms from /tf and /tf_static: poses as in tf2's BufferCore, at the latest common time."""

from __future__ import annotations

import math
import threading
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from operator import itemgetter
from struct import Struct
from typing import Any, NamedTuple, TypeAlias

from rosplc.bridge import hold
from rosplc.bridge.port import Context
from rosplc.bridge.stream import ToPlc
from rosplc.codec import Codec
from rosplc.config.resolve import TopicPlan
from rosplc.config.transforms import FRAME_BYTES, TF_MESSAGE, TransformError
from rosplc.errors import CodecError
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.ros import Backend, EndpointStatus, Qos, Subscription

KEEP_NS = 10_000_000_000  # how far the buffer reaches back, as tf2's by default
_QOS = {"/tf": Qos(depth=1000), "/tf_static": Qos(durability="transient_local", depth=1000)}
_MOST, _MOST_LINKS = 4096, 10_000  # transforms in a message, and frames; transforms of one frame
_LONGEST_FRAME = 255

Pose: TypeAlias = tuple[float, float, float, float, float, float, float]  # m, then quaternion x, y, z, w
_Link: TypeAlias = tuple[int, str, Pose]  # stamp in ns since 1970, parent, pose in it
_STAMP, _COUNT = itemgetter(0), Struct("=I")
_IDENTITY: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def compose(outer: Pose, inner: Pose) -> Pose:
    """Return the pose of a frame whose pose is ``inner`` in a frame with the pose ``outer``."""
    tx, ty, tz, ax, ay, az, aw = outer
    x, y, z, bx, by, bz, bw = inner
    scale, dot = 2 * aw * aw - 1, 2 * (ax * x + ay * y + az * z)
    return (
        tx + scale * x + dot * ax + 2 * aw * (ay * z - az * y),
        ty + scale * y + dot * ay + 2 * aw * (az * x - ax * z),
        tz + scale * z + dot * az + 2 * aw * (ax * y - ay * x),
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by + ay * bw + az * bx - ax * bz,
        aw * bz + az * bw + ax * by - ay * bx,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def inverse(pose: Pose) -> Pose:
    """Return the pose of the parent frame in the child frame."""
    x, y, z, qx, qy, qz, qw = pose
    return compose((0.0, 0.0, 0.0, -qx, -qy, -qz, qw), (-x, -y, -z, 0.0, 0.0, 0.0, 1.0))


def interpolate(one: Pose, other: Pose, ratio: float) -> Pose:
    """Interpolate at ``ratio`` between two poses: linearly, with the rotation along the shorter way."""
    dot = sum(a * b for a, b in zip(one[3:], other[3:], strict=True))
    angle, first, second = math.acos(min(1.0, abs(dot))), 1.0, 0.0
    if angle:
        first, second = (math.sin(part * angle) / math.sin(angle) for part in (1 - ratio, ratio))
    second = math.copysign(second, dot)
    x, y, z = (a + (b - a) * ratio for a, b in zip(one[:3], other[:3], strict=True))
    qx, qy, qz, qw = (a * first + b * second for a, b in zip(one[3:], other[3:], strict=True))
    return x, y, z, qx, qy, qz, qw


class Found(NamedTuple):
    """The result of a lookup."""

    error: TransformError
    frame: str  # what the error is about; without an error the frame whose transform is the oldest
    stamp_ns: int = 0  # the newest common time; 0 if the whole chain is static
    static: bool = False
    pose: Pose = _IDENTITY  # the source in the target


class Buffer:
    """The transforms of the last seconds; usable from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._links: dict[str, list[_Link]] = {}  # by child, the oldest first; of a static one the newest
        self._static: set[str] = set()
        self._frames: set[str] = set()

    def put(self, child: str, parent: str, stamp_ns: int, pose: Pose, *, static: bool = False) -> str:
        """Store a transform, or return why it is ignored. For equal stamps, the first counts, as in tf2."""
        x, y, z, qx, qy, qz, qw = pose
        square = qx * qx + qy * qy + qz * qz + qw * qw
        if not child or not parent or child == parent:
            return "a transform needs two different frames"
        if not (abs(square - 1) <= 0.01 and math.isfinite(x + y + z)):
            return f"{pose} is not a translation with a unit quaternion"
        scale = 1 / math.sqrt(square)
        link = stamp_ns, parent, (x, y, z, qx * scale, qy * scale, qz * scale, qw * scale)
        with self._lock:
            if len(self._frames) >= _MOST and not {child, parent} <= self._frames:
                return f"the limit of {_MOST} frames has been reached"
            self._frames |= {child, parent}
            links = self._links.setdefault(child, [])
            if static is not (child in self._static):
                links.clear()
                (self._static.add if static else self._static.discard)(child)
            if static:
                links[:] = [link]
            elif not links or stamp_ns > links[-1][0]:
                links.append(link)
                while links[0][0] < stamp_ns - KEEP_NS or len(links) > _MOST_LINKS:
                    del links[0]
            elif stamp_ns < links[-1][0] - KEEP_NS:
                return f"its stamp is {(links[-1][0] - stamp_ns) / 1e9:.0f} s older than the newest one"
            else:
                at = bisect_right(links, stamp_ns, key=_STAMP)
                if not at or links[at - 1][0] != stamp_ns:
                    links.insert(at, link)
        return ""

    def lookup(self, target: str, source: str) -> Found:
        """Return the pose of a frame in another one, at the latest time common to the chain between them."""
        with self._lock:
            for frame in (target, source):
                if frame not in self._frames:
                    return Found(TransformError.UNKNOWN_FRAME, frame)
            ups, downs = (list(dict(self._walk(frame, None))) for frame in (source, target))
            common = next((frame for frame in downs if frame in ups), None)
            if common is None:
                loop = next((ends[-1] for ends in (ups, downs) if ends[-1] in self._links), None)
                kind = TransformError.NOT_CONNECTED if loop is None else TransformError.LOOP
                return Found(kind, loop or ups[-1])
            chain = ups[: ups.index(common)] + downs[: downs.index(common)]
            moving = [frame for frame in chain if frame not in self._static]
            oldest = min(moving, key=lambda frame: self._links[frame][-1][0] or math.inf, default="")
            time = self._links[oldest][-1][0] if oldest else 0
            above, below = (dict(self._walk(frame, time)) for frame in (source, target))
            top = next((frame for frame in below if frame in above), None)
            if top is None:  # at that time the chain was another one, or is not known
                ends = [list(above)[-1], list(below)[-1]]
                unknown = next((frame for frame in ends if frame in self._links), None)
                kind = TransformError.NOT_CONNECTED if unknown is None else TransformError.NO_COMMON_TIME
                return Found(kind, unknown or ends[0])
            return Found(
                TransformError.NONE, oldest, time, not moving, compose(inverse(below[top]), above[top])
            )

    def _walk(self, frame: str, time_ns: int | None) -> Iterator[tuple[str, Pose]]:
        """Yield a frame and its ancestors, with the frame's pose in each; time None: the newest links."""
        pose, seen = _IDENTITY, set[str]()
        while frame not in seen:
            yield frame, pose
            seen.add(frame)
            if (link := self._at(frame, time_ns)) is None:
                return
            frame, pose = link[1], pose if time_ns is None else compose(link[2], pose)

    def _at(self, child: str, time_ns: int | None) -> _Link | None:
        links = self._links.get(child)
        if not links or not time_ns or child in self._static:
            return links[-1] if links else None
        at = bisect_left(links, time_ns, key=_STAMP)
        if at == len(links) or (not at and links[0][0] != time_ns):
            return None
        end, next_parent, after = links[at]
        start, parent, before = links[at - 1]
        if end == time_ns:
            return links[at]
        if parent == next_parent:
            before = interpolate(before, after, (time_ns - start) / (end - start))
        return time_ns, parent, before


def _reader(like: Layout, room: int) -> Callable[[bytes], Iterator[tuple[Any, ...]]]:
    """Return a function that yields stamp, parent, child, pose of up to ``room`` transforms."""
    layout = compute_layout(like.store, TF_MESSAGE, Limits(_LONGEST_FRAME, room, {}))
    fields = {path.removeprefix("transforms[]."): offset for path, offset, _ in layout.fields()}
    first, pose = fields["header.stamp.sec"], fields["transform.translation.x"]
    head = f"=iI{_LONGEST_FRAME + 1}s{_LONGEST_FRAME + 1}s"
    one, codec = Struct(f"{head}{pose - first - Struct(head).size}x7d"), Codec(layout)
    stride = (layout.size - fields["transforms"]) // room

    def read(data: bytes) -> Iterator[tuple[Any, ...]]:
        record = codec.decode(data)
        for at in range(first, first + stride * _COUNT.unpack_from(record)[0], stride):
            seconds, nanoseconds, *names, x, y, z, qx, qy, qz, qw = one.unpack_from(record, at)
            frames = [name.rstrip(b"\0").decode(errors="replace").removeprefix("/") for name in names]
            yield seconds * 10**9 + nanoseconds, *frames, (x, y, z, qx, qy, qz, qw)

    return read


class Transforms:
    """The subscriptions to transforms, open while an entry uses them; usable from any thread."""

    def __init__(self, context: Context) -> None:
        self.buffer = Buffer()
        self._context = context
        self._lock = threading.Lock()  # of the users and their subscriptions
        self._users: set[object] = set()
        self._subscriptions: list[Subscription] = []

    def join(self, user: object, backend: Backend, like: Codec) -> None:
        """Subscribe for the first user, with the wire format of a codec; raises as the backend does."""
        with self._lock:
            self._users.add(user)
            readers: dict[int, Any] = {}
            for topic, qos in _QOS.items() if not self._subscriptions else ():
                receive = partial(self._receive, topic, like, readers)
                self._subscriptions.append(backend.subscribe(topic, TF_MESSAGE, qos, receive))

    def leave(self, user: object) -> None:
        """Unsubscribe after the last user; a second call does nothing."""
        with self._lock:
            self._users.discard(user)
            while self._subscriptions and not self._users:
                self._subscriptions.pop().close()
                self.buffer = Buffer()

    def _receive(self, topic: str, like: Codec, readers: dict[int, Any], data: bytes, _: int) -> None:
        # Messages of each size have a codec with just enough room; no transform has less than 72 bytes.
        room = min(_MOST, 1 << (len(data) // 72).bit_length())
        read = readers.get(room) or readers.setdefault(room, _reader(like.layout, room))
        warn = partial(self._context.warnings.warn, now_ns=self._context.clock.monotonic_ns())
        try:
            for stamp_ns, parent, child, pose in read(data):
                if ignored := self.buffer.put(child, parent, stamp_ns, pose, static=topic == "/tf_static"):
                    warn((topic, child), text=f"{topic}: ignored {child!r} in {parent!r}: {ignored}")
        except CodecError as error:
            warn(topic, text=f"{topic}: message ignored: {error}")

    def status(self) -> EndpointStatus | None:
        """Return the state of the topic with a problem, otherwise of /tf; publishers are those of both."""
        found = [subscription.status() for subscription in tuple(self._subscriptions)]
        shown = next((each for each in found if each.code), found[0] if found else None)
        return shown and replace(shown, matched=sum(each.matched for each in found))


class TransformToPlc(ToPlc):
    """One configured transform: the carrier's thread looks up the pose at its rate and passes it on."""

    def __init__(self, transforms: Transforms, plan: TopicPlan, *arguments: Any) -> None:
        super().__init__(plan, *arguments)
        assert plan.transform is not None
        self._wanted, self._transforms = plan.transform, transforms
        self.hold.stages.append(hold.Samples(self._now(), plan.transform.rate_ns, self._sample))

    def _connect(self, backend: Backend) -> None:
        self._transforms.join(self, backend, self.codec)

    def disconnect(self) -> None:
        """Stop using the subscriptions; a second call does nothing."""
        self._transforms.leave(self)

    def endpoint(self) -> EndpointStatus | None:
        """Return the state of the subscriptions."""
        return self._transforms.status()

    def _sample(self, now_ns: int) -> hold.Item:
        wanted = self._wanted
        found = self._transforms.buffer.lookup(wanted.target, wanted.source)
        age = max(0, self.context.clock.time_ns() - found.stamp_ns) if found.stamp_ns else 0
        error = TransformError.TOO_OLD if 0 < wanted.max_age_ns < age else found.error
        if error:
            why = f"{error.name.lower().replace('_', ' ')}: {found.frame}"
            self.note(now_ns, f"{wanted.source} in {wanted.target}: {why}", "ROS023")
        parts = {"translation": ("xyz", found.pose[:3]), "rotation": ("xyzw", found.pose[3:])}
        value = {
            "transform": {name: dict(zip(*part, strict=True)) for name, part in parts.items()},
            "age_ms": min(age // 1_000_000, 2**32 - 1),
            "error": error,
            "is_static": found.static,
            "frame": found.frame.encode()[:FRAME_BYTES].decode(errors="ignore"),
        }
        self._came(now_ns)
        return self.codec.encode(self.plan.layout.pack(value)), max(0, found.stamp_ns)
