"""Keys, tokens, QoS strings and attachments, as rmw_zenoh writes and reads them."""

from __future__ import annotations

import pytest

pytest.importorskip("zenoh")

from zenoh_ros2_sdk.attachment import Attachment as SdkAttachment
from zenoh_ros2_sdk.keyexpr import topic_keyexpr
from zenoh_ros2_sdk.qos import QosProfile

from rosplc.ros import LATCHED, SENSOR_DATA, Qos
from rosplc.ros.zenoh import keys as attachment
from rosplc.ros.zenoh.keys import (
    Entity,
    TokenTable,
    decode_qos,
    encode_qos,
    gid_of,
    parse_token,
    topic_key,
)

STRING = "std_msgs/msg/String"
HASH = "RIHS01_" + "ab" * 32
PUBLISHER = Entity(3, "1f2e", "0", "7", "MP", "/robot1", "cell", "/robot1/state", STRING, HASH, Qos())
TOKEN = (
    f"@ros2_lv/3/1f2e/0/7/MP/%/%robot1/cell/%robot1%state/std_msgs::msg::dds_::String_/{HASH}/::,10:,:,:,,"
)


@pytest.mark.parametrize(
    ("qos", "text"),
    [
        (Qos(), "::,10:,:,:,,"),
        (Qos(depth=42), "::,:,:,:,,"),
        (SENSOR_DATA, "2::,5:,:,:,,"),
        (LATCHED, ":1:,1000:,:,:,,"),
    ],
)
def test_qos_is_written_as_rmw_zenoh_does(qos: Qos, text: str) -> None:
    """What equals rmw_zenoh's default is left empty, and the string reads back as what was written."""
    assert encode_qos(qos) == text
    assert decode_qos(text) == qos


@pytest.mark.parametrize(
    ("text", "qos"),
    [
        ("1:2:1,10", Qos()),
        ("2:1:1,3", Qos("best_effort", "transient_local", 3)),
        ("1:2:1,10:9223372036,854775807:9223372036,854775807:1,9223372036,854775807", Qos()),
        ("2:2:2,0:,:,:,,", Qos("best_effort", "volatile", 1)),
    ],
)
def test_qos_of_both_forms_is_read(text: str, qos: Qos) -> None:
    """The short form of early releases and the long one with every number mean the same settings."""
    assert decode_qos(text) == qos


@pytest.mark.parametrize(
    "text", ["", ":", "::", "9::,1", "a:b:c,d", "::,-1:,:,:,,", "::,1:x,:,:,,", "::,²:,:,:,,"]
)
def test_qos_that_is_none_is_refused(text: str) -> None:
    """Anything else raises ValueError, whatever it is."""
    with pytest.raises(ValueError, match="QoS"):
        decode_qos(text)


def test_qos_is_read_by_the_sdk() -> None:
    """An independent implementation reads the settings that we write."""
    read = QosProfile.decode(encode_qos(Qos("best_effort", "transient_local", 7)))
    assert (read.reliability.name, read.durability.name, read.history_depth) == (
        "BEST_EFFORT",
        "TRANSIENT_LOCAL",
        7,
    )


def test_token_is_written_and_read() -> None:
    """A publisher's token has every part in rmw_zenoh's order, and reads back as what was written."""
    assert PUBLISHER.token == TOKEN
    assert parse_token(TOKEN) == PUBLISHER
    assert parse_token(TOKEN + "/more") == PUBLISHER  # as later releases may append


def test_node_token() -> None:
    """A node in the root namespace has a lone percent sign for it."""
    node = Entity(0, "1f2e", "0", "0", "NN", "/", "cell")
    assert node.token == "@ros2_lv/0/1f2e/0/0/NN/%/%/cell"
    assert parse_token(node.token) == node


def test_services_are_kept_apart() -> None:
    """Tokens of servers and clients are read as others are, and are no part of topics."""
    table, token = TokenTable(), TOKEN.replace("/MP/", "/SS/")
    assert table.appeared(token) == parse_token(TOKEN).topic
    assert [one.token for one in table.on(parse_token(token).topic, "SS")] == [token]
    assert table.on(parse_token(token).topic, "MP") == ()
    assert table.graph("").endpoints == ()


HOSTILE = [
    "",
    "@ros2_lv",
    "@ros2_lv/3/1f2e/0/7/MP/%/%robot1",
    TOKEN.replace("/3/", "/three/", 1),
    TOKEN.replace("/3/", "/" + "9" * 4000 + "/", 1),
    TOKEN.replace("/MP/", "/XX/"),
    TOKEN.replace("/cell/", "/no node/"),
    TOKEN.replace("%robot1%state", "**"),
    TOKEN.replace("%robot1%state", "%" + "x" * 5000),
    TOKEN.replace("%robot1/cell", "robot1/cell"),
    TOKEN.replace("std_msgs::msg::dds_::String_", "a b"),
    TOKEN.replace(HASH, "<script>"),
    TOKEN.replace("::,10:,:,:,,", "nonsense"),
    TOKEN[: TOKEN.index("std_msgs") - 1],
    TOKEN.replace("cell", "cell\n\x1b[31m"),
]


@pytest.mark.parametrize("token", HOSTILE, ids=range(len(HOSTILE)))
def test_hostile_token_is_refused_and_counted(token: str) -> None:
    """A token that no ROS node would write changes nothing but the count."""
    table = TokenTable()
    assert table.appeared(token) is None
    assert table.gone(token) is None
    assert table.malformed == 1
    assert table.graph("").nodes == ()


def test_gid_is_the_tokens_hash() -> None:
    """The id is XXH3's 128-bit hash, low word first; the value is xxHash's own for the empty text."""
    # XXH3_128bits of nothing: 99aa06d3014798d86001c324468d497f, high word first.
    assert gid_of("").hex() == bytes.fromhex("99aa06d3014798d86001c324468d497f")[::-1].hex()
    assert len(gid_of(TOKEN)) == 16


def test_attachment_is_understood_by_the_sdk() -> None:
    """33 bytes that an independent implementation reads, and we read its."""
    data = attachment.pack(5, 1_700_000_000_123_456_789, bytes(range(16)))
    assert len(data) == 33
    theirs = SdkAttachment.from_bytes(data)
    assert (theirs.sequence_id, theirs.timestamp_ns, theirs.gid) == (
        5,
        1_700_000_000_123_456_789,
        bytes(range(16)),
    )
    assert attachment.unpack(theirs.to_bytes()) == (5, 1_700_000_000_123_456_789, bytes(range(16)))


@pytest.mark.parametrize(
    "data", [b"", bytes(32), bytes(33), b"\xff" * 33, bytes(16) + b"\x0f" + bytes(16)], ids=range(5)
)
def test_malformed_attachment_is_refused(data: bytes) -> None:
    """Other lengths and negative numbers raise ValueError."""
    with pytest.raises(ValueError, match=r"attachment|id|negative"):
        attachment.unpack(data)


def test_topic_key() -> None:
    """The key is domain, topic, type and hash, as an independent implementation builds it."""
    ours = topic_key(3, "/robot1/state", STRING, HASH)
    assert ours == topic_keyexpr(3, "/robot1/state", "std_msgs::msg::dds_::String_", HASH)
