"""The texts of the PLC project: what the generator writes, the PLC program, and a recorder.

The recorder keeps every message of a scan, so that each is counted and checked and not only
the one that ``msg`` holds in the end. It uses the blocks as any program does.
"""

from __future__ import annotations

import json
from pathlib import Path

from rosplc.demo.messages import robot_topics
from rosplc.demo.plan import Plan
from rosplc.plc.names import instance_names
from rosplc.plc.project import Gvl, PlcProject, Pou, Variable, project_texts

CONFIGURATION = "rosplc.yaml"
# The task's programs in the order of their calls.
READ, RECORDER, MAIN, WRITE = "SharedMemory_Read", "Demo_Recorder", "PLC_PRG", "SharedMemory_Write"
INBOX = "Demo_Inbox"


def write_configuration(folder: Path, plan: Plan) -> None:
    """Write the run's configuration, of which the generator makes the PLC project."""
    (folder / CONFIGURATION).write_text(json.dumps(plan.configuration(), indent=2), encoding="utf-8")


def write_texts(folder: Path, plan: Plan, project: PlcProject, programs: Path) -> None:
    """Write the whole PLC project into an empty folder, one ``.st`` file per object.

    ``project`` is what the generator makes of the run's configuration, ``programs`` the folder of the
    demonstration's own Structured Text.
    """
    texts = project_texts(project)
    texts |= {path.stem: path.read_text(encoding="utf-8") for path in sorted(programs.glob("*.st"))}
    texts |= _recorder(plan, project)
    for name, text in texts.items():
        (folder / f"{name}.st").write_text(text, encoding="utf-8")
    # The order in which objects depend on each other is the generator's.
    (folder / "objects.json").write_text(json.dumps(list(texts)), encoding="utf-8")


def read_texts(folder: Path) -> dict[str, str]:
    """Return what :func:`write_texts` wrote: text by object name."""
    names = json.loads((folder / "objects.json").read_text(encoding="utf-8"))
    return {name: (folder / f"{name}.st").read_text(encoding="utf-8") for name in names}


def _recorder(plan: Plan, project: PlcProject) -> dict[str, str]:
    names = instance_names(list(robot_topics(plan.topics)))
    duts = _message_types(project)
    inbox, body = [], []
    for name in names.values():
        inbox.append(f"    udi_{name} : UDINT; // messages of this scan")
        inbox.append(f"    ast_{name} : ARRAY[0..{plan.per_scan - 1}] OF {duts[name]};")
        body.append(
            f"""ROS_Read.{name}.uiMaxPerScan := {plan.per_scan};
{INBOX}.udi_{name} := 0;
xMore := ROS_Read.{name}.xNew;
WHILE xMore DO
    {INBOX}.ast_{name}[{INBOX}.udi_{name}] := ROS_Read.{name}.msg;
    {INBOX}.udi_{name} := {INBOX}.udi_{name} + 1;
    xMore := ROS_Read.{name}.Next();
END_WHILE;"""
        )
    gvl = ["// What came in this scan.", "{attribute 'qualified_only'}", "VAR_GLOBAL", *inbox, "END_VAR"]
    program = [
        "// Keeps every message of the scan for whoever counts and checks them.",
        f"PROGRAM {RECORDER}",
        "VAR",
        "    xMore : BOOL;",
        "END_VAR",
        *body,
        "END_PROGRAM",
    ]
    return {INBOX: "\n".join(gvl) + "\n", RECORDER: "\n".join(program) + "\n"}


def _message_types(project: PlcProject) -> dict[str, str]:
    """Return the type of ``msg`` of each instance in ROS_Read."""
    blocks = {pou.name: pou for pou in project.pous}
    (reads,) = (gvl for gvl in project.gvls if gvl.name == "ROS_Read")
    return {variable.name: _msg(blocks[variable.type]) for variable in _variables(reads)}


def _variables(gvl: Gvl) -> list[Variable]:
    return [variable for block in gvl.blocks for variable in block.variables]


def _msg(pou: Pou) -> str:
    return next(v.type for block in pou.blocks for v in block.variables if v.name == "msg")
