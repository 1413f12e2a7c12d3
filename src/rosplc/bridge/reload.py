"""Another configuration for a running bridge: all of it takes effect, or nothing does.

What can be wrong is found before anything is touched, as far as it can be known: the file, its types
and sizes, keys that cannot change. New topics are then opened beside those that run; only when they
stand are the others let go of. What fails later is undone: the topics are opened again as they were.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable

from rosplc.bridge.carriers import Carriers
from rosplc.bridge.changes import Changes
from rosplc.bridge.topic import Topic, log
from rosplc.config.resolve import TopicPlan
from rosplc.errors import BackendError, RosplcError
from rosplc.ros import Backend
from rosplc.shm import Namespace

__all__ = ["exchange"]


def exchange(
    changes: Changes,
    running: tuple[Topic, ...],
    *,
    carriers: Carriers,
    backend: Backend,
    namespace: Namespace,
    show: Callable[[tuple[Topic, ...]], None],
) -> tuple[Topic, ...]:
    """Carry other topics; those that are kept are not touched.

    Args:
        changes: What is to change.
        running: The topics that are carried.
        carriers: What carries them.
        backend: The ROS side.
        namespace: The names of the objects.
        show: Takes the topics that are open at each moment, so that they beat.

    Returns:
        The topics that are carried now.

    Raises:
        RosplcError: Something is in the way (SHM116, SHM117, ROS002 …); the topics from before are
            carried again.
    """
    return _Exchange(changes, running, carriers, backend, namespace, show).run()


class _Exchange:
    def __init__(
        self,
        changes: Changes,
        running: tuple[Topic, ...],
        carriers: Carriers,
        backend: Backend,
        namespace: Namespace,
        show: Callable[[tuple[Topic, ...]], None],
    ) -> None:
        self._changes = changes
        self._running = running
        self._carriers = carriers
        self._backend = backend
        self._namespace = namespace
        self._show = show
        # A channel that becomes classic leaves its object, like a topic that is no more.
        became = {
            was.topic for was, now in changes.changed if was.classic is None and now.classic is not None
        }
        self._retiring = {plan.topic for plan in changes.removed} | became
        left = self._retiring | {was.topic for was, _ in changes.changed}
        self._leaving = tuple(topic for topic in running if topic.plan.topic in left)
        self._kept = tuple(topic for topic in running if topic.plan.topic not in left)
        self._new: list[Topic] = []

    def run(self) -> tuple[Topic, ...]:
        taken = {self._name(topic.plan) for topic in self._leaving}
        first = [plan for plan in self._changes.added if self._name(plan) not in taken]
        rest = [plan for plan in self._changes.added if self._name(plan) in taken]
        rest += [now for _, now in self._changes.changed]
        needed = {self._name(plan) for plan in rest}
        try:
            self._open(first)
            self._replace(self._leaving, self._new)
        except BaseException:
            self._drop_new()
            self._show(self._running)
            raise
        begun = tuple(self._new)
        try:
            for topic in self._leaving:
                topic.leave()
                # A name that is given up stays held until all has succeeded, unless another needs it.
                if self._name(topic.plan) in needed or topic.plan.topic not in self._retiring:
                    topic.close()
            self._open(rest)
            self._replace((), self._new[len(begun) :])
        except BaseException:
            self._restore(begun)
            raise
        for topic in self._leaving:
            if topic.plan.topic in self._retiring:
                _retire(topic)
        return (*self._kept, *self._new)

    def _open(self, plans: Iterable[TopicPlan]) -> None:
        for plan in plans:
            topic = self._carriers.make(plan)
            topic.open()
            self._new.append(topic)
            topic.join(self._backend)
            self._show((*self._running, *self._new))

    def _replace(self, leaving: Collection[Topic], coming: Collection[Topic]) -> None:
        if not self._carriers.replace(leaving, coming):
            raise BackendError("ROS018", "the ROS side does not return from publishing")

    def _drop_new(self) -> None:
        """Let go of what was opened; an object that this made is nobody's."""
        adopted = {topic for topic in self._new if topic.channel is not None and topic.channel.adopted}
        for topic in self._new:
            topic.leave()
            if topic in adopted:
                topic.close()
            else:
                _retire(topic)

    def _restore(self, begun: tuple[Topic, ...]) -> None:
        """Carry what was carried before, after something went wrong half-way."""
        self._carriers.replace(begun, ())
        self._drop_new()
        again = []
        for topic in self._leaving:
            topic.close()
            old = self._carriers.make(topic.plan)
            try:
                old.open()
            except (RosplcError, OSError) as error:
                old.fail(time.monotonic_ns(), error)  # as after a removed object: the next check opens it
            try:
                old.join(self._backend)
            except RosplcError as error:
                log.error("%s: %s; restart the bridge", topic.plan.topic, error)
            again.append(old)
        self._carriers.replace((), again)
        order = [topic.plan.topic for topic in self._running]
        self._running = tuple(sorted((*self._kept, *again), key=lambda topic: order.index(topic.plan.topic)))
        self._show(self._running)

    def _name(self, plan: TopicPlan) -> str:
        if plan.classic is not None:
            return plan.classic.name
        return self._namespace.object_name(plan.topic)


def _retire(topic: Topic) -> None:
    try:
        topic.retire()
    except (RosplcError, OSError, ValueError) as error:
        log.warning("%s: its object could not be retired: %s", topic.plan.topic, error)
