"""The bridge's own topics and services: log, ROS time, parameters and diagnostics."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any

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
_NOT_SERVED = "the node serves its own parameters, so the configured parameters are not visible in ROS"


class OwnTopics:
    """The bridge's own topics and services; ``stack`` closes them. Raises as the backend does, and CFG011.

    Attributes:
        ends: By topic, the ROS side of the stream between the bridge and the PLC.
        beats: Duties of the heartbeat.
        duties: Duties of the reporter, which may hang in the ROS side.
        parameters: The parameters that are variables of the PLC, if any.
        warnings: Warnings for the user.
    """

    def __init__(
        self,
        project: Project,
        ros: RosSide,
        backend: Backend,
        status: Callable[[], BridgeStatus],
        clock: Clock,
        stack: ExitStack,
        *,
        owned: bool,
    ) -> None:
        settings, store = project.config.settings, project.store
        self.ends: dict[str, OwnEnd] = {}
        self.beats: list[Duty] = []
        self.duties: list[Duty] = []
        self.warnings: tuple[str, ...] = ()
        own_log = settings.rosout.bridge and "--disable-rosout-logs" not in ros.arguments.others
        if own_log or settings.rosout.plc:
            lines = rosout.Rosout(project, backend, clock)
            stack.callback(lines.leave)
            self.duties.append(Duty("sending the log", rosout.PERIOD_NS, lines.send))
            if settings.rosout.plc:
                self.ends[rosout.TOPIC] = rosout.PlcLog(lines, project, clock)
            if own_log:
                logging.getLogger("rosplc").addHandler(lines)
        sim = Parameter("use_sim_time", "bool", settings.time.use_sim_time, take=lambda _: None)
        sim = replace(sim, value=ros.given([sim]).get(sim.name, sim.value))
        if settings.time.plc:
            time = ros_time.RosTime(project, backend, clock, sim.value)
            sim = replace(sim, take=time.use)
            stack.callback(time.leave)
            self.beats.append(Duty("sending the time", ros_time.PERIOD_NS, time.write))
            self.ends[ros_time.TOPIC] = time
        serve: Any = partial(ParameterServer, backend, store, clock=clock)
        declared = [sim, *shown_parameters(ros.shown())]
        if store.ros_version == 1:  # use_sim_time is no node's own there
            serve, declared = getattr(backend, "keep_parameters", None), [sim] * settings.time.plc
        self.parameters: PlcParameters | None = None
        if (asked := project.parameters) is not None:
            own = self.parameters = PlcParameters(asked, store, ros.given(asked.declared), clock)
            self.beats.append(Duty("checking parameters", _CHECK_NS, own.check))
            self.ends |= dict.fromkeys((WANTED, CURRENT), own)
            if serve is None or (backend.name == "rclpy" and not owned):
                self.warnings = (_NOT_SERVED,)
                log.warning("%s", _NOT_SERVED)
            else:
                stack.callback(own.serve(serve, declared).close)
        elif owned and serve is not None and declared:
            stack.callback(serve(declared).close)
        if settings.diagnostics.enabled:
            diagnostics = Diagnostics(store, backend, clock)
            stack.callback(diagnostics.close)
            period = settings.diagnostics.period_ns
            self.duties.append(Duty("diagnostics", period, lambda: diagnostics.publish(status()), period))

    def begin(self, streams: Iterable[Carried]) -> None:
        """Give the PLC its first values, after the streams have started."""
        if self.parameters is not None:
            found = (each for each in streams if isinstance(each, Stream) and each.plan.own == "parameters")
            self.parameters.begin(tuple(found))
