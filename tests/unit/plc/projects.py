"""Projects that several tests build, and how they look into them."""

from __future__ import annotations

from pathlib import Path

from rosplc.layout import Layout, Limits, compute_layout
from rosplc.model import TypeStore
from rosplc.plc.build import build_project
from rosplc.plc.plan import PlcTask, PlcTopic, ProjectOptions
from rosplc.plc.project import Dut, Gvl, PlcProject, Pou

STORE = TypeStore.bundled("jazzy")
POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/Twist"
JOINTS = "sensor_msgs/msg/JointState"


def layout(type_name: str, limits: Limits | None = None, store: TypeStore = STORE) -> Layout:
    return compute_layout(store, type_name, limits or Limits())


def read(
    topic: str, type_name: str = POSE, task: str = "Ros", limits: Limits | None = None, **more
) -> PlcTopic:
    return PlcTopic(topic, layout(type_name, limits), "read", task, **more)


def write(
    topic: str, type_name: str = TWIST, task: str = "Ros", limits: Limits | None = None, **more
) -> PlcTopic:
    return PlcTopic(topic, layout(type_name, limits), "write", task, **more)


def project(*topics: PlcTopic, tasks: tuple[PlcTask, ...] | None = None, **options) -> PlcProject:
    tasks = tasks or tuple(PlcTask(name) for name in dict.fromkeys(topic.task for topic in topics))
    return build_project(STORE, topics, tasks, ProjectOptions(**options))


def custom(folder: Path, **definitions: str) -> TypeStore:
    """Return a store with messages of the package ``cell_msgs`` beside the bundled ones."""
    target = folder / "cell_msgs" / "msg"
    target.mkdir(parents=True, exist_ok=True)
    for name, text in definitions.items():
        (target / f"{name}.msg").write_text(text)
    return STORE.with_paths([folder])


def named(items: tuple[Dut | Gvl | Pou, ...], name: str):
    """Return the object of that name."""
    (found,) = (item for item in items if item.name == name)
    return found


def members(dut: Dut) -> dict[str, str]:
    return {member.name: member.type for member in dut.members}
