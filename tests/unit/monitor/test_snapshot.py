"""Looking at objects without touching them."""

from __future__ import annotations

import os

import pytest

from rosplc.described import description_of
from rosplc.errors import ChannelError
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.monitor import find_objects
from rosplc.shm import Direction, Namespace, OwnedChannel

pytestmark = pytest.mark.verifies("views", own="simulation of every state")


@pytest.fixture
def channel(shm_namespace):
    store = TypeStore.bundled("jazzy")
    layout = compute_layout(store, "std_msgs/msg/Int32")
    description = description_of(layout, "/n", Direction.TO_PLC, bridge="cell")
    with OwnedChannel.open(shm_namespace, description, record_size=layout.size) as channel:
        yield channel


def test_an_object_is_described(channel, shm_namespace):
    """Type, sizes, bridge and counters come from the object alone."""
    writer = channel.writer()
    writer.publish(b"\1\0\0\0")
    writer.refuse()
    (state,) = find_objects(prefix=shm_namespace.prefix, seconds=0)
    assert (state.topic, state.type_name, state.bridge, state.slots) == (
        "/n",
        "std_msgs/msg/Int32",
        "cell",
        4,
    )
    assert (state.head, state.refused, state.record_size) == (1, 1, 4)
    assert state.to_dict()["path"] == str(channel.path)


def test_looking_changes_no_byte(channel, shm_namespace):
    """An object looks the same before and after."""
    before = channel.path.read_bytes()
    find_objects(prefix=shm_namespace.prefix, seconds=0.02)
    assert channel.path.read_bytes() == before


def test_lock_files_and_others_are_left_out(channel, shm_namespace):
    """Only t objects of the prefix are listed."""
    (shm_namespace.path("/x").parent / f"{shm_namespace.prefix}.other").write_bytes(b"")
    assert [state.topic for state in find_objects(prefix=shm_namespace.prefix, seconds=0)] == ["/n"]


def test_links_are_named_and_not_followed(channel, shm_namespace):
    """A link at an object's name is reported as SHM121."""
    os.symlink(channel.path, shm_namespace.path("/link"))
    states = {state.topic: state.code for state in find_objects(prefix=shm_namespace.prefix, seconds=0)}
    assert states == {"/n": "", "/link": "SHM121"}


def test_a_directory_that_cannot_be_listed_is_an_error(tmp_path):
    """SHM123 names the directory."""
    with pytest.raises(ChannelError, match="SHM123"):
        find_objects(str(tmp_path / "missing"))


def test_an_empty_directory_has_no_objects(tmp_path):
    """No objects is an empty list and no error."""
    assert find_objects(str(tmp_path)) == []
    assert Namespace("rosplc", tmp_path).topics() == []
