"""What an object says of itself, from a topic's plan: for the bridge and the PLC generator alike."""

from __future__ import annotations

from rosplc.config.resolve import Project, TopicPlan
from rosplc.described import description_of
from rosplc.shm import Description
from rosplc.shm.header import Identity

__all__ = ["describe", "object_plan", "object_size"]


def describe(plan: TopicPlan, *, distro: str, bridge: str) -> Description:
    """Return the self-description of a topic's object (spec/shm-format.md, section 6)."""
    return description_of(plan.layout, plan.topic, plan.direction, bridge=bridge, distro=distro)


def object_plan(project: Project, plan: TopicPlan) -> Identity:
    """Return the geometry that the bridge's object for a topic will have; who made it is left open."""
    settings = project.config.settings
    description = describe(plan, distro=settings.ros.distro, bridge=settings.bridge)
    return Identity.plan(
        direction=plan.direction,
        slots=plan.slots,
        record_size=plan.layout.size,
        description_size=len(description.to_json()),
        layout_id=plan.layout.layout_id,
        generation=1,
        bridge_id=bytes(16),
    )


def object_size(project: Project, plan: TopicPlan) -> int:
    """Return the bytes that the bridge's object for a topic will have."""
    return object_plan(project, plan).object_size
