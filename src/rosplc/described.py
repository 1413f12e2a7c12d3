"""The layout that a channel's self-description gives, and the self-description of a layout.

A tool that knows only the object can decode it: the description carries the type, its
definition and the limits, and the layout computed from them must have the layout id that
the object states (``spec/shm-format.md``, section 6).
"""

from __future__ import annotations

import json
from functools import lru_cache

from rosplc.errors import ChannelError, RosplcError
from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.shm import Attached, Description, Direction, Part


def description_of(
    layout: Layout,
    topic: str,
    direction: Direction,
    *,
    bridge: str,
    distro: str = "",
    part: Part = Part.TOPIC,
    client: str = "",
) -> Description:
    """Return what an object for messages of a layout says of itself (``spec/shm-format.md``, section 6).

    ``topic`` is the full name of the topic, service or action; ``bridge`` that of its maker;
    ``distro`` that of the layout's types if empty; ``client`` names one of several uses.
    """
    return Description(
        topic=topic,
        type=layout.type_name,
        distro=distro or layout.store.distro,
        direction=direction,
        limits=layout.limits.to_dict(),
        layout_id=layout.layout_id,
        bridge=bridge,
        definition=layout.store.definition_text(layout.type_name),
        part=part,
        client=client,
    )


def described_layout(description: Description, *, where: str = "") -> Layout:
    """Compute the layout that an object's ``description``, which is not trusted, describes.

    Raises ChannelError SHM113, at ``where``, if the definition or the limits cannot be used, or lead to
    another layout id than the description states.
    """
    try:
        limits = json.dumps(dict(description.limits), sort_keys=True)
        layout = _layout(description.type, description.definition, limits, description.distro)
    except RosplcError as error:
        what = f"the description's type cannot be rebuilt: {error.what} [{error.code}]"
        raise ChannelError("SHM113", what, where=where) from error
    except (TypeError, ValueError, AttributeError, RecursionError) as error:
        raise ChannelError("SHM113", f"the limits cannot be used: {error}", where=where) from error
    if layout.layout_id != description.layout_id:
        what = f"the definition has layout id {layout.layout_id}, the description {description.layout_id}"
        raise ChannelError("SHM113", what, where=where)
    return layout


def layout_of(attached: Attached) -> Layout:
    """Return the layout of an attached object, its header and its description agreeing on it.

    Raises ChannelError: SHM113, as :func:`described_layout`, or because the two disagree.
    """
    identity = attached.identity
    layout = described_layout(attached.description, where=str(attached.path))
    if (layout.layout_id, layout.size) != (identity.layout_id, identity.record_size):
        what = f"the description has layout {layout.layout_id} ({layout.size} bytes), but the header has "
        what += f"{identity.layout_id} ({identity.record_size} bytes)"
        raise ChannelError("SHM113", what, where=str(attached.path))
    return layout


@lru_cache(maxsize=256)
def _layout(type_name: str, definition: str, limits: str, distro: str) -> Layout:
    # Re-opening after a bridge's restart happens in the middle of a scan, so a type that is
    # known already must cost nothing.
    found = TypeStore.from_definition(type_name, definition, distro=distro)
    # Read as its distribution writes it (ROS 1's byte is signed), and given in ROS 2's words.
    store = TypeStore("", {name: found[name] for name in found.names()})
    return compute_layout(store, type_name, Limits.from_dict(json.loads(limits)))
