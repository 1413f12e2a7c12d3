"""The message types that the ROS side is given: those of the configuration that holds at present."""

from __future__ import annotations

from collections.abc import Iterable

from rosplc.config.resolve import TopicPlan
from rosplc.model import TypeStore
from rosplc.model.types import MessageType

__all__ = ["LiveTypes"]


class LiveTypes:
    """A :class:`~rosplc.ros.backend.TypeSource` whose store can be exchanged while a backend has it.

    Args:
        store: The types to begin with.

    Attributes:
        store: Where types are looked up.
        used: Definition by type name, of the topics' types that a backend has been given.
    """

    def __init__(self, store: TypeStore) -> None:
        self.store = store
        self.used: dict[str, str] = {}

    def use(self, plans: Iterable[TopicPlan]) -> None:
        """Remember the definitions of the types of these topics."""
        for plan in plans:
            if plan.type_name not in self.used:
                self.used[plan.type_name] = plan.layout.store.definition_text(plan.type_name)

    @property
    def distro(self) -> str:
        """The ROS distribution."""
        return self.store.distro

    def __getitem__(self, name: str) -> MessageType:
        """Return a type; TYP001 if it is unknown."""
        return self.store[name]

    def type_hash(self, name: str) -> str:
        """Return the ROS 2 type hash."""
        return self.store.type_hash(name)

    def md5(self, name: str) -> str:
        """Return the ROS 1 MD5 sum."""
        return self.store.md5(name)

    def definition_text(self, name: str) -> str:
        """Return the definition with every type it needs."""
        return self.store.definition_text(name)
