"""What the configuration decides about a classic topic: spec/classic-mode.md."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ClassicPlan", "classic_name"]


@dataclass(frozen=True)
class ClassicPlan:
    """A topic whose record stands alone at offset 0 of a shared memory, guarded by a semaphore.

    Attributes:
        name: The memory's name, without a slash: ``/dev/shm/NAME``.
        semaphore: The semaphore's name, ``/dev/shm/sem.NAME``; empty if nothing guards the memory.
        wait_ns: How long a side tries to get the lock before it leaves it for the next time.
        recover_after_ns: How long the lock must be held, without any sign of life, before its
            holder counts as dead.
        poll_ns: Towards ROS: time between two looks at the memory.
        retained: What is older than the attachment counts too: towards ROS the image that stands in
            the memory when the bridge starts is a message; towards the PLC the last message is written
            into a memory that took the other's place.
    """

    name: str
    semaphore: str
    wait_ns: int
    recover_after_ns: int
    poll_ns: int = 1_000_000
    retained: bool = False


def classic_name(topic: str) -> str:
    """Return the name that a topic's memory has by default: ``/robot1/cmd_vel`` is ``robot1.cmd_vel``.

    A topic without a namespace keeps its name, as existing projects have it. A name in shared
    memory has no slash, and a topic no dot, so no two topics get one name.
    """
    return topic[1:].replace("/", ".")
