"""What other nodes say over Zenoh: liveliness tokens, quality of service in them, attachments, samples."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import zenoh

from rosplc.clock import SYSTEM
from rosplc.harmless import harmless
from rosplc.ros.backend import Qos
from rosplc.ros.zenoh import endpoint
from rosplc.ros.zenoh import keys as attachment
from rosplc.ros.zenoh.keys import (
    Entity,
    TokenTable,
    decode_qos,
    encode_qos,
    explain,
    gid_of,
    parse_token,
)
from tests.fuzz.choices import Choices

__all__ = ["check", "seeds"]

_LOGGER = logging.getLogger("rosplc.ros.zenoh")
_LOGGER.setLevel(logging.CRITICAL)  # it warns of what is fed here

_OURS = Entity(
    0, "s", "0", "1", "MS", "/", "rosplc", "/cmd_vel", "geometry_msgs/msg/Twist", "RIHS01_x", Qos(depth=5)
)


def _tokens(texts: list[str]) -> None:
    """Tokens appear and go; what the graph then shows has only names that ROS has."""
    table = TokenTable()
    for text in texts:
        table.appeared(text)
        try:
            entity = parse_token(text)
        except ValueError:
            continue
        if entity is None:
            continue
        assert len(gid_of(text)) == 16
        if entity.qos is not None and entity.type_name.count("/") == 2:  # a name that ROS 2 has
            again = parse_token(entity.token)
            assert again is not None
            assert (again.full_name, again.topic) == (entity.full_name, entity.topic)
        if entity.qos is not None:
            words = explain(_OURS, entity)
            assert words is None or len(words[1]) < 4000
            decode_qos(encode_qos(entity.qos))
    graph = table.graph("s")
    for name in (*graph.nodes, *graph.topics, *(info.node for info in graph.endpoints)):
        assert name.startswith("/")
        assert harmless(name) == name
        assert len(name) < 600
    for text in texts:
        table.gone(text)
    assert not table.graph("s").endpoints


class _Bytes:
    def __init__(self, data: bytes) -> None:
        self._data = data

    def to_bytes(self) -> bytes:
        return self._data


def _samples(choices: Choices) -> None:
    """Samples at a subscription: handed over, or refused and counted."""
    got: list[int] = []
    node = SimpleNamespace(
        clock=SYSTEM, wake=lambda _: None, diagnose=lambda _: ("", ""), others=lambda _: (), logger=_LOGGER
    )
    subscription = endpoint.ZenohSubscription(lambda payload, stamp: got.append(stamp), node, _OURS)
    tried = 0
    while choices:
        tried += 1
        with_attachment, size = choices.flag(), choices.byte()
        extra = _Bytes(choices.take(choices.byte() % 40)) if with_attachment else None
        kind = zenoh.SampleKind.DELETE if choices.below(8) == 7 else zenoh.SampleKind.PUT
        sample = SimpleNamespace(kind=kind, attachment=extra, payload=_Bytes(choices.take(size)))
        subscription.arrived(cast(Any, sample))
    subscription.deliver_next()
    status = subscription.status()
    assert status.dropped >= 0
    assert status.rejected <= tried


def check(data: bytes) -> None:
    """Whatever they say is refused with ValueError, or is what ROS could have said."""
    choices = Choices(data)
    how = choices.below(3)
    if how == 0:
        _tokens(choices.rest().decode("utf-8", "replace").split("\n")[:20])
    elif how == 1:
        _samples(choices)
    else:
        try:
            found = attachment.unpack(choices.rest())
        except ValueError:
            return
        assert attachment.unpack(attachment.pack(*found)) == found


def seeds() -> Iterator[bytes]:
    """Tokens of nodes and endpoints, attachments, samples."""
    node = Entity(0, "abc", "0", "0", "NN", "/robot1", "talker")
    kind = ("/cmd_vel", "geometry_msgs/msg/Twist", "RIHS01_" + "0" * 64)
    publisher = Entity(
        0, "abc", "0", "7", "MP", "/robot1", "talker", *kind, Qos("best_effort", "transient_local", 3)
    )
    yield b"\0" + node.token.encode()
    yield b"\0" + "\n".join((node.token, publisher.token)).encode()
    yield b"\0" + publisher.token.replace("::,", "2:1:2,9:1,2:3,4:1,5,6").encode()
    packed = attachment.pack(5, 1_700_000_000_000_000_000, bytes(range(16)))
    yield b"\2" + packed
    for sequence in (1, 2, 9, 2**62):
        packed = attachment.pack(sequence, 1, bytes(16))
        yield b"\1" + b"\1\x08" + bytes([len(packed)]) + packed + b"\0" + b"\0\1\0\0aaaa"
