"""What a bridge itself has in ROS and for the PLC: its log, ROS time, parameters, diagnostics."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import replace

from rosplc.bridge import ros_time, rosout
from rosplc.bridge.carrier import Carried, Duty
from rosplc.bridge.diagnostics import Diagnostics
from rosplc.bridge.parameters import PlcParameters
from rosplc.bridge.port import log
from rosplc.bridge.ros_side import RosSide
from rosplc.bridge.status import BridgeStatus
from rosplc.bridge.stream import OwnEnd, Stream
from rosplc.clock import Clock
from rosplc.config.parameters import CURRENT, WANTED
from rosplc.config.resolve import Project
from rosplc.ros import Backend
from rosplc.ros.parameters import Parameter, ParameterServer, shown_parameters

_CHECK_NS = 1_000_000_000
_NOT_SERVED = "the node serves its own parameters: those of the configuration are not seen in ROS"


class OwnTopics:
    """The bridge's own topics and services; ``stack`` closes them. Raises as the backend does, and CFG011.

    Attributes:
        ends: By topic, what the stream of a topic between the bridge and the PLC has as its ROS side.
        beats: Duties of the heartbeat.
        duties: Duties of the reporter, whose work may hang in the ROS side.
        parameters: Those that are variables of the PLC, if there are any.
    """

    def __init__(
        self,
        project: Project,
        ros: RosSide,
        backend: Backend,
        status: Callable[[], BridgeStatus],
        clock: Clock,
        stack: ExitStack,
    ) -> None:
        settings = project.config.settings
        self.ends: dict[str, OwnEnd] = {}
        self.beats: list[Duty] = []
        self.duties: list[Duty] = []
        self._project, self._ros, self._backend, self._clock, self._stack = (
            project,
            ros,
            backend,
            clock,
            stack,
        )
        own_log = settings.rosout.bridge and "--disable-rosout-logs" not in ros.arguments.others
        if own_log or settings.rosout.plc:
            lines = rosout.Rosout(project, backend, clock)
            stack.callback(lines.leave)
            self.duties.append(Duty("logging", rosout.PERIOD_NS, lines.send))
            if settings.rosout.plc:
                self.ends[rosout.TOPIC] = rosout.PlcLog(lines, project, clock)
            if own_log:
                logging.getLogger("rosplc").addHandler(lines)
        sim = Parameter("use_sim_time", "bool", settings.time.use_sim_time, take=lambda _: None)
        sim = self._sim = replace(sim, value=ros.given([sim]).get(sim.name, sim.value))
        if settings.time.plc:
            time = ros_time.RosTime(project, backend, clock, sim.value)
            self._sim = replace(sim, take=time.use)
            stack.callback(time.leave)
            self.beats.append(Duty("telling the time", ros_time.PERIOD_NS, time.write))
            self.ends[ros_time.TOPIC] = time
        self.parameters: PlcParameters | None = None
        if (asked := project.parameters) is not None:
            own = self.parameters = PlcParameters(asked, project.store, ros.given(asked.declared), clock)
            self.beats.append(Duty("checking parameters", _CHECK_NS, own.check))
            self.ends |= dict.fromkeys((WANTED, CURRENT), own)
        if settings.diagnostics.enabled:
            diagnostics = Diagnostics(project.store, backend, clock)
            stack.callback(diagnostics.close)
            period = settings.diagnostics.period_ns
            self.duties.append(Duty("reporting", period, lambda: diagnostics.publish(status()), period))

    def serve(self, streams: Iterable[Carried], *, owned: bool) -> tuple[str, ...]:
        """Serve the node's parameters unless it does; return what people should know of that.

        The ports of all streams are there, which are not connected. ``owned``: the node is this bridge's.
        """
        backend, store = self._backend, self._project.store
        declared = [self._sim, *shown_parameters(self._ros.shown())]
        if self.parameters is not None:
            if backend.name == "rclpy" and not owned:
                log.warning("%s", _NOT_SERVED)
                return (_NOT_SERVED,)
            inner = [each for each in streams if isinstance(each, Stream) and each.plan.of_parameters]
            self._stack.callback(self.parameters.serve(backend, declared, inner).close)
        elif owned and store.ros_version == 2:
            self._stack.callback(ParameterServer(backend, store, declared, clock=self._clock).close)
        return ()

    def begin(self) -> None:
        """Give the PLC its first values; the streams are carried."""
        if self.parameters is not None:
            self.parameters.begin()
