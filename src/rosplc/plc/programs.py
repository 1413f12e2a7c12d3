"""The generated programs: one that reads and one that writes per task, which call the instances."""

from __future__ import annotations

from collections.abc import Sequence

from rosplc.plc.classic import classic_wait
from rosplc.plc.literals import time_literal
from rosplc.plc.names import Scope
from rosplc.plc.plan import PlcTask, PlcTopic, ProjectOptions
from rosplc.plc.project import Pou, Task

__all__ = ["READ_GVL", "SAFE_GVL", "WRITE_GVL", "call", "programs"]

READ_GVL, WRITE_GVL = "ROS_Read", "ROS_Write"
"""The lists that hold the instances."""
SAFE_GVL = "ROS_Safe"
"""The list that holds what a message becomes when its source is silent."""
_ON_STALE = {"hold": 0, "zero": 1, "value": 2}


def call(name: str, topic: PlcTopic, task: int, cycle_ns: int) -> str:
    """Return the call of a topic's instance, with what the configuration says.

    Args:
        name: The instance's.
        topic: What it carries.
        task: The task's index.
        cycle_ns: The task's interval; 0 if it has none.
    """
    gvl = READ_GVL if topic.direction == "read" else WRITE_GVL
    arguments = [f"uiTask := {task}", f"udiMapSize := {topic.object_size}"]
    if topic.classic is not None:
        arguments[1] = f"tWait := {time_literal(classic_wait(topic.classic, cycle_ns) * 1_000_000)}"
    if topic.direction == "read":
        if topic.stale_after_ns:
            arguments.append(f"tStaleAfter := {time_literal(topic.stale_after_ns)}")
        if topic.on_stale != "hold":
            arguments.append(f"uiOnStale := {_ON_STALE[topic.on_stale]}")
        if topic.on_stale == "value" and topic.safe is not None:
            arguments.append(f"stSafe := {SAFE_GVL}.{name}")
        if topic.in_order:
            arguments.append("xInOrder := TRUE")
        if topic.latched:
            arguments.append("xLatched := TRUE")
    return f"{gvl}.{name}({', '.join(arguments)});"


def programs(
    tasks: Sequence[PlcTask],
    indices: dict[str, int],
    calls: dict[tuple[str, str], list[str]],
    options: ProjectOptions,
    scope: Scope,
) -> tuple[list[Pou], tuple[Task, ...]]:
    """Return a reading and a writing program per task that has topics, and the tasks."""
    programs: list[Pou] = []
    plc_tasks: list[Task] = []
    single = sum(1 for task in tasks if any((d, task.name) in calls for d in ("read", "write"))) == 1
    for task in tasks:
        names = []
        for direction in ("read", "write"):
            lines = calls.get((direction, task.name), [])
            if not lines and not (direction == "read" and ("write", task.name) in calls):
                continue
            wanted = f"{options.programs}_{direction.capitalize()}"
            name = scope.give(wanted if single else f"{wanted}_{task.name}")
            body = list(lines)
            if direction == "read":
                body.insert(
                    0, f"RosPlc_State.axMayOpen[{indices[task.name]}] := TRUE; // one open attempt per scan"
                )
            what = (
                "Takes what came from ROS; call it first"
                if direction == "read"
                else "Sends to ROS; call it last"
            )
            comment = f"{what} in task {task.name}."
            programs.append(Pou(name, "PROGRAM", (), "\n".join(body), comment=comment, folder=options.folder))
            names.append(name)
        if names:
            plc_tasks.append(
                Task(
                    task.name,
                    task.kind,
                    task.interval_ns // 1000 if task.kind == "cyclic" else 0,
                    task.priority,
                    task.watchdog_ns // 1000,
                    task.watchdog_sensitivity,
                    tuple(names),
                )
            )
    return programs, tuple(plc_tasks)
