"""Comparison of the configuration with the ROS graph: does each topic have matching nodes?

The doctor only reads what discovery shows. It subscribes to nothing, because some publishers start to work
when they have a subscriber, and publishes nothing, because a command topic must not get another publisher.
It uses a separate process, because a middleware may hang, crash or print to stdout.
"""

from __future__ import annotations

import base64
import difflib
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rosplc.bridge.ros_side import RosSide, choose_backend
from rosplc.config import Project, load_project
from rosplc.config.plans import CallPlan
from rosplc.config.resolve import TopicPlan
from rosplc.doctor.finding import Finding, Level
from rosplc.doctor.kinds import fine, found, judged
from rosplc.errors import BackendError, RosplcError
from rosplc.harmless import listed, plural
from rosplc.init.live import elsewhere
from rosplc.ros import ROS1, EndpointInfo, GraphInfo, incompatibility, open_backend, settled_graph
from rosplc.ros.names import join, resolve_topic
from rosplc.shm import Direction

_ANY = "*"  # the type in ROS 1's master where it is unknown


@dataclass(frozen=True)
class Graph:
    """The ROS graph as the doctor saw it through a backend, without its own nodes and endpoints.

    ``names`` maps each topic, service and action of the configuration to its name in ROS, after remapping;
    ``bridge`` is the full name of the configuration's own node, ``where`` the domain or master in words.
    """

    backend: str
    info: GraphInfo
    names: dict[str, str]
    bridge: str
    where: str


def judge_graph(
    graph: Graph,
    plans: Sequence[TopicPlan],
    type_hash: Callable[[str], str],
    calls: Sequence[CallPlan] = (),
    *,
    bridge_runs: bool,
) -> Iterator[Finding]:
    """Compare each topic, service and action with the graph.

    ``type_hash`` returns the hash that nodes of the configuration's distribution announce for a type, or an
    empty text; ``bridge_runs``: a bridge holds the configuration's objects.
    """
    others, info = [node for node in graph.info.nodes if node != graph.bridge], graph.info
    empty = not others and not info.endpoints
    if others or empty:
        what = (
            f"no other node was seen in {graph.where} (backend {graph.backend}){elsewhere(graph.where)}"
            if empty
            else ""
        )
        yield judged("DOC516", what, f"{plural(len(others), 'node')} in {graph.where}: {listed(others)}")
    if bridge_runs:
        what = f"a bridge is running, but its node {graph.bridge} is not in {graph.where}"
        well = f"the bridge's node {graph.bridge} is in the graph"
        yield judged("DOC517", "" if graph.bridge in info.nodes else what, well)
    for plan in plans:
        yield from _topic(graph, plan, type_hash(plan.type_name), quiet=empty)
    for call in {(call.kind, call.called): call for call in calls}.values():
        yield from _call(graph, call, quiet=empty)


def _call(graph: Graph, call: CallPlan, *, quiet: bool) -> Iterator[Finding]:
    name = service = graph.names.get(call.called, call.called)
    type_name, ends = call.type_name, graph.info.services
    if call.kind == "action" and graph.backend == "rospy":
        service, type_name, ends = f"{name}/goal", _ANY, graph.info.endpoints
    elif call.kind == "action":
        service, type_name = f"{name}/_action/send_goal", f"{type_name}_SendGoal"
    found_there = [end for end in ends if end.topic == service and end.node != graph.bridge]
    servers = [end.node or "a node without a name" for end in found_there if end.direction == "in"]
    most = 1 if call.server == "ros" else 0
    several = f"{listed(servers)} serve{'s' * (len(servers) == 1)} {name}" + (
        "" if most else ", which the PLC also serves"
    )
    yield judged(
        "DOC520", f"{several} [ROS022]" if len(servers) > most else "", f"{name} has no conflicting servers"
    )
    if call.server == "ros" and not (quiet and not servers):
        missing = "" if servers else f"no node serves the {call.kind} {name}, which the PLC calls"
        yield judged("DOC519", missing, f"{name} is served by {listed(servers)}")
    for end in found_there:
        does = f"node {end.node} {'serves' if end.direction == 'in' else 'calls'} {name}"
        if end.obstacles:
            yield found("DOC521", f"{does} {'; '.join(end.obstacles)} [ROS021]")
        if _ANY not in (end.type_name, type_name) and end.type_name != type_name:
            yield found("DOC512", f"{does} as {end.type_name}, but the local type is {type_name} [ROS003]")


def _topic(graph: Graph, plan: TopicPlan, ours: str, *, quiet: bool) -> Iterator[Finding]:
    name = graph.names.get(plan.topic, plan.topic)
    to_plc = plan.direction is Direction.TO_PLC
    wanted = "out" if to_plc else "in"
    ends = [
        end
        for end in graph.info.endpoints
        if end.topic == name and end.direction == wanted and end.node != graph.bridge
    ]
    if not ends:
        if not quiet:  # of an empty graph enough has been reported
            yield _nobody(graph, name, plan, to_plc=to_plc)
        return
    problems = [_problem(end, plan, ours, over_zenoh=graph.backend == "zenoh") for end in ends]
    yield from filter(None, problems)
    if not any(each is not None and each.level >= Level.WARNING for each in problems):
        does = "published" if to_plc else "subscribed to"
        who = listed(end.node or "a node without a name" for end in ends)
        yield fine("DOC511", f"{name} is {does} by {who}")


def _problem(end: EndpointInfo, plan: TopicPlan, ours: str, *, over_zenoh: bool) -> Finding | None:
    """Return why a peer and the bridge's endpoint do not match, in the words that the bridge uses."""
    verb = "publishes" if end.direction == "out" else "subscribes to"
    who = f"node {end.node}" if end.node else "a node without a name"
    does = f"{who} {verb} {end.topic} as {end.type_name}"
    if end.type_name == _ANY:
        return found("DOC518", f"{who} {verb} {end.topic}, whose type is unknown")
    if end.type_name != plan.type_name:
        remedy = f"Set `type: {end.type_name}` for {plan.topic}, or change the node."
        return found("DOC512", f"{does}, but the local type is {plan.type_name} [ROS003]", remedy)
    if ours and end.type_hash and ours != end.type_hash:
        there, here = end.type_hash[7:15], ours[7:15]
        what = f"{does} with a different definition (type hash {there}…, local {here}…) [ROS003]"
        return found("DOC513", what, command=f"ros2 interface show {end.type_name}")
    offered, requested = (end.qos, plan.qos) if end.direction == "out" else (plan.qos, end.qos)
    problem = incompatibility(offered, requested)
    if problem and over_zenoh:
        what = f"{does}, but {problem}; over Zenoh, messages are exchanged nevertheless"
        return found("DOC514", what, level=Level.NOTE)
    if obstacles := "; ".join([problem, *end.obstacles] if problem else end.obstacles):
        pairs = (
            ("reliability", end.qos.reliability, plan.qos.reliability),
            ("durability", end.qos.durability, plan.qos.durability),
        )
        settings = ", ".join(f"{key}: {theirs}" for key, theirs, own in pairs if theirs != own)
        remedy = "Change these settings of the node: the bridge does not support them."
        if problem:
            remedy = f"Set `qos: {{{settings}}}` for {plan.topic}."
        return found("DOC514", f"{does}, but {obstacles} [ROS004]", remedy)
    if not (ours and end.type_hash):
        return found("DOC518", f"{does}, but does not announce its definition")
    return None


def _nobody(graph: Graph, name: str, plan: TopicPlan, *, to_plc: bool) -> Finding:
    what = f"no node {'publishes' if to_plc else 'subscribes to'} {name}"
    if near := _similar(graph, name, plan.type_name):
        remedy = f"Correct the name, or set `ros: {{remap: {{{name}: {near}}}}}`."
        return found("DOC515", f"{what}; did you mean {near}?", remedy)
    if to_plc:
        return found("DOC511", what, command=f"ros2 topic info -v {name}")
    return found("DOC511", what, level=Level.NOTE)


def _similar(graph: Graph, name: str, type_name: str) -> str:
    """Return the topic of another node that was probably meant; empty if no name is similar."""
    info = graph.info
    own = {*graph.names.values(), *graph.names, name, "/diagnostics", "/rosout", "/parameter_events"}
    theirs = {end.topic for end in info.endpoints if end.node != graph.bridge}
    known = [topic for topic in info.topics if topic in theirs and topic not in own]
    last = name.rpartition("/")[2]
    namesakes = [topic for topic in known if topic.rpartition("/")[2] == last]
    same_type = [topic for topic in namesakes if type_name in info.topics[topic]]
    if same_type or namesakes:
        return (same_type or namesakes)[0]
    near = difflib.get_close_matches(name, known, 3, cutoff=0.75)
    return next((topic for topic in near if type_name in info.topics[topic]), near[0] if near else "")


NODE = "rosplc_doctor"
_PROGRAM = "from rosplc.doctor.graph import main; main()"
_START_S = 30.0  # how long the process may take beyond its look: imports, joining, leaving
_LONGEST_WORDS = 200


def see_graph(config: Path, seconds: float, variables: Mapping[str, str]) -> Graph:
    """Examine the ROS graph of a configuration in another process, for at most ``seconds``.

    Raises BackendError if the middleware or the backend fails; TimeoutError if the process does not end in
    time, and is killed.
    """
    command = [sys.executable, "-c", _PROGRAM, str(config), str(seconds)]
    own, most = dict(variables), seconds + _START_S
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, env=own, timeout=most, check=False
        )
    except subprocess.TimeoutExpired:
        raise TimeoutError(f"examining the graph did not finish within {most:g} s") from None
    lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
    words = lines[-1].strip()[:_LONGEST_WORDS] if lines else ""
    try:
        # Written by this module, in a process of our own; a library may have printed something before it.
        answer = pickle.loads(base64.b64decode(done.stdout.rpartition(b"\n")[2], validate=True))
    except (ValueError, EOFError, pickle.UnpicklingError):
        what = f"the process examining the graph exited with status {done.returncode}: {words or 'no output'}"
        raise BackendError("ROS002", what) from None
    if isinstance(answer, RosplcError):
        if words and answer.code == "ROS002":  # what the library wrote would be lost with the process
            what = f"{answer.what} (library output: {words})"
            answer = BackendError(answer.code, what, where=answer.where, remedy=answer.remedy)
        raise answer
    assert isinstance(answer, Graph)
    return answer


def _look(project: Project, seconds: float) -> Graph:
    side = RosSide(project.config)
    settings = project.config.settings.ros
    environment = side.environment()
    choice = choose_backend(project.config, environment)
    own, namespace, remap = side.names()
    backend = open_backend(
        choice.name,
        project.store,
        NODE,
        namespace,
        settings.domain,
        remap=remap,
        environment=environment,
        options=side.options(choice.name),
    )
    try:
        info = settled_graph(backend.graph, seconds)
    finally:
        backend.close()
    names = {
        name: resolve_topic(name, namespace=namespace, node_name=own, remap=remap)
        for name in (*(plan.topic for plan in project.topics), *(call.called for call in project.calls))
    }
    where = f"domain {environment.get('ROS_DOMAIN_ID') or 0 if settings.domain is None else settings.domain}"
    if settings.distro == ROS1:
        where = f"the graph of {environment.get('ROS_MASTER_URI') or 'http://localhost:11311'}"
    return Graph(choice.name, info, names, join(namespace, own), where)


def main() -> None:
    """Write the graph, or the error, to stdout."""
    # Libraries write to stdout as they like; the answer goes to where stdout was.
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        seen: Graph | RosplcError = _look(load_project(sys.argv[1]), float(sys.argv[2]))
    except RosplcError as error:
        seen = error
    answer.write(b"\n" + base64.b64encode(pickle.dumps(seen)))
    answer.flush()
    # Threads of a middleware may be in the way of an ordinary end.
    os._exit(0)
