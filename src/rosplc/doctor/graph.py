"""The configuration against the ROS graph: who is at the other end of each topic, and does it fit?

The doctor only looks at what discovery shows. It subscribes to nothing and publishes nothing: a
subscriber more makes some publishers start their work, and a publisher more on a command topic is
nothing that a healthy robot should see.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from rosplc.config.resolve import TopicPlan
from rosplc.doctor.finding import Finding, Level
from rosplc.doctor.kinds import kind
from rosplc.doctor.words import listed
from rosplc.harmless import plural
from rosplc.init.domains import elsewhere
from rosplc.ros import EndpointInfo, GraphInfo, incompatibility
from rosplc.shm import Direction

__all__ = ["Graph", "judge_graph"]

_ANY = "*"
"""What ROS 1's master says where nobody has told the type."""


@dataclass(frozen=True)
class Graph:
    """What the doctor saw of the ROS graph.

    Attributes:
        backend: The backend that it looked through.
        info: Nodes and endpoints, the doctor's own left out.
        names: Topic of the configuration → its name in ROS, after remapping.
        bridge: The full name of the configuration's own node.
        where: The domain or master, in words.
    """

    backend: str
    info: GraphInfo
    names: dict[str, str]
    bridge: str
    where: str


def judge_graph(
    graph: Graph, plans: Sequence[TopicPlan], type_hash: Callable[[str], str], *, bridge_runs: bool
) -> Iterator[Finding]:
    """Compare each topic with what the graph has.

    Args:
        graph: What was seen.
        plans: The configuration's topics.
        type_hash: Returns what a node of the configuration's distribution announces for a type; empty
            if such nodes announce nothing.
        bridge_runs: Whether a bridge holds the configuration's objects.
    """
    others = [node for node in graph.info.nodes if node != graph.bridge]
    if others:
        yield kind("DOC516").fine(f"{plural(len(others), 'node')} in {graph.where}: {listed(others)}")
    elif not graph.info.endpoints:
        what = f"no other node was seen in {graph.where}, over {graph.backend}{elsewhere(graph.where)}"
        yield kind("DOC516").found(what)
    if bridge_runs and graph.bridge not in graph.info.nodes:
        yield kind("DOC517").found(f"a bridge runs, but {graph.bridge} is not in {graph.where}")
    elif bridge_runs:
        yield kind("DOC517").fine(f"the bridge's node {graph.bridge} is in the graph")
    for plan in plans:
        yield from _topic(
            graph, plan, type_hash(plan.type_name), quiet=not others and not graph.info.endpoints
        )


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
        if not quiet:  # of an empty graph enough has been said
            yield _nobody(graph, name, plan, to_plc=to_plc)
        return
    well = True
    for end in ends:
        finding = _problem(end, plan, ours, over_zenoh=graph.backend == "zenoh")
        if finding is not None:
            well = well and finding.level < Level.WARNING
            yield finding
    if well:
        does = "published" if to_plc else "subscribed to"
        yield kind("DOC511").fine(
            f"{name} is {does} by {listed(end.node or 'a nameless node' for end in ends)}"
        )


def _problem(end: EndpointInfo, plan: TopicPlan, ours: str, *, over_zenoh: bool) -> Finding | None:
    """Return what is wrong between a peer and the bridge's endpoint, in the bridge's own words."""
    verb = "publishes" if end.direction == "out" else "subscribes to"
    who = f"node {end.node}" if end.node else "a node without a name"
    does = f"{who} {verb} {end.topic} as {end.type_name}"
    if end.type_name == _ANY:
        return kind("DOC518").found(f"{who} {verb} {end.topic}, and nobody has told its type")
    if end.type_name != plan.type_name:
        remedy = f"Write `type: {end.type_name}` for {plan.topic}, or correct the node."
        return kind("DOC512").found(f"{does}, here it is {plan.type_name} [ROS003]", remedy)
    if ours and end.type_hash and ours != end.type_hash:
        there, here = end.type_hash[7:15], ours[7:15]
        what = f"{does} with another definition (type hash {there}… there, {here}… here) [ROS003]"
        return kind("DOC513").found(what, command=f"ros2 interface show {end.type_name}")
    offered, requested = (end.qos, plan.qos) if end.direction == "out" else (plan.qos, end.qos)
    problem = incompatibility(offered, requested)
    if problem and over_zenoh:
        what = f"{does}, but {problem}; over Zenoh messages are exchanged nevertheless"
        return kind("DOC514").found(what, level=Level.NOTE)
    if obstacles := "; ".join([problem, *end.obstacles] if problem else end.obstacles):
        remedy = _qos_remedy(end, plan) if problem else "Change these settings of the node: ROS has no such."
        return kind("DOC514").found(f"{does}, but {obstacles} [ROS004]", remedy)
    if not (ours and end.type_hash):
        return kind("DOC518").found(f"{does}, without its definition")
    return None


def _qos_remedy(end: EndpointInfo, plan: TopicPlan) -> str:
    theirs = end.qos
    settings = []
    if theirs.reliability != plan.qos.reliability:
        settings.append(f"reliability: {theirs.reliability}")
    if theirs.durability != plan.qos.durability:
        settings.append(f"durability: {theirs.durability}")
    return f"Write `qos: {{{', '.join(settings)}}}` for {plan.topic}."


def _nobody(graph: Graph, name: str, plan: TopicPlan, *, to_plc: bool) -> Finding:
    if near := _similar(graph, name, plan.type_name):
        what = f"nobody {'publishes' if to_plc else 'subscribes to'} {name}; did you mean {near}?"
        return kind("DOC515").found(what, f"Correct the name, or write `ros: {{remap: {{{name}: {near}}}}}`.")
    if to_plc:
        return kind("DOC511").found(f"nobody publishes {name}", command=f"ros2 topic info -v {name}")
    return kind("DOC511").found(f"nobody subscribes to {name}", level=Level.NOTE)


def _similar(graph: Graph, name: str, type_name: str) -> str:
    """Return the topic of another node that was probably meant; empty if none looks like it."""
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
