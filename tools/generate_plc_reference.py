"""Write plc-blocks.md, plc-calls.md and the pictures of their blocks; ``--verify`` only compares."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from draw_block import block_picture
from drawing import IMAGES
from generated_page import REFERENCE, filled, run
from rosplc.config import parse_config, resolve
from rosplc.config.plans import ClassicPlan
from rosplc.errors import CODES
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.plc.base import HELPER_NAMES, OWN_NAMES, base_objects, call_objects, classic_objects
from rosplc.plc.build import build_project, plc_project
from rosplc.plc.plan import PlcTask, PlcTopic, ProjectOptions
from rosplc.plc.project import Dut, Enumeration, Item, Pou, Variable

PAGE, CALLS_PAGE = REFERENCE / "plc-blocks.md", REFERENCE / "plc-calls.md"
CALLS = """
services:
  /called: {type: std_srvs/srv/Trigger, server: ros}
  /served: {type: std_srvs/srv/Trigger, server: plc}
actions:
  /called: {type: example_interfaces/action/Fibonacci, server: ros}
  /served: {type: example_interfaces/action/Fibonacci, server: plc}
"""
OWN_TOPICS = """
rosout: {plc: true}
time: {plc: true}
transforms: {tool: {target: base_link, source: tool0}}
"""
EXAMPLE, EXAMPLE_DUT = "geometry_msgs/msg/PoseStamped", "geometry_msgs_PoseStamped"
_pictures: dict[Path, str] = {}  # of the blocks on the pages, filled while those are written


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _table(variables: Iterable[Variable]) -> list[str]:
    lines = ["| name | type | initial | meaning |", "| --- | --- | --- | --- |"]
    for variable in variables:
        initial = f"`{variable.initial}`" if variable.initial is not None else ""
        kind = _of_users(variable.type)
        shown = f"the {kind}'s type" if kind else f"`{variable.type}`"
        lines.append(f"| `{variable.name}` | {shown} | {initial} | {_cell(variable.comment)} |")
    return [*lines, ""]


def _of_users(type_name: str) -> str:
    """Return of what kind a type is that depends on the user's message, service or action, or nothing."""
    kinds = {EXAMPLE_DUT: "message", "_Fibonacci": "action", "_Trigger": "service"}
    return next((kind for part, kind in kinds.items() if part in type_name), "")


def _picture(pou: Pou, chain: list[Pou], below: str = "") -> list[str]:
    """Draw a block, and return the line of the page that shows it."""
    inputs, outputs = (
        [
            (variable.name, f"‹{kind}›" if (kind := _of_users(variable.type)) else variable.type)
            for variable in of
        ]
        for of in (_of(chain, "VAR_INPUT"), _of(chain, "VAR_OUTPUT"))
    )
    path = IMAGES / "blocks" / f"{pou.name}.svg"
    _pictures[path] = block_picture(pou.name, below, inputs, outputs)
    return [f"![{pou.name}: inputs left, outputs right](../images/blocks/{path.name})", ""]


def _chain(pou: Pou, pous: dict[str, Pou]) -> list[Pou]:
    """Return a block and those that it extends, the base first."""
    above = _chain(pous[pou.extends], pous) if pou.extends else []
    return [*above, pou]


def _of(pous: Iterable[Pou], kind: str) -> list[Variable]:
    return [v for pou in pous for block in pou.blocks if block.kind == kind for v in block.variables]


def _block(title: str, pou: Pou, pous: dict[str, Pou]) -> list[str]:
    chain = _chain(pou, pous)
    lines = [f"## {title}", "", _sentence(chain[-2].comment), "", *_picture(pou, chain)]
    for kind, heading in (("VAR_INPUT", "Inputs"), ("VAR_OUTPUT", "Outputs")):
        lines += [f"### {heading} of {title}", "", *_table(_of(chain, kind))]
    public = [
        m for each in chain for m in each.methods if m.access == "PUBLIC" and not m.name.startswith("FB_")
    ]
    if public:
        lines += [f"### Methods of {title}", ""]
        lines += [
            f"* `{method.name}() : {method.return_type}` {_sentence(method.comment)}" for method in public
        ]
        lines.append("")
    return lines


def _sentence(text: str) -> str:
    return " ".join(text.split())


def _errors(errors: Enumeration) -> list[str]:
    lines = ["| number | name | meaning | what helps |", "| ---: | --- | --- | --- |"]
    for name, number in errors.values[1:]:
        info = CODES[f"SHM{number}"]
        link = f"[{number}](errors.md#shm{number})"
        lines.append(f"| {link} | `{name}` | {_cell(info.title)} | {_cell(info.remedy)} |")
    return [*lines, ""]


def _helper(item: Item) -> list[str]:
    lines = [f"### {item.name}", "", _sentence(item.comment), ""]
    if isinstance(item, Dut):
        return [*lines, *_table(item.members)]
    if isinstance(item, Enumeration):
        return [*lines, ", ".join(f"`{name}` {number}" for name, number in item.values), ""]
    assert isinstance(item, Pou)
    if item.kind == "FUNCTION_BLOCK":
        lines += _picture(item, [item], f"extends {item.extends}" if item.extends else "")
    blocks = item.blocks
    for kind, heading in (("VAR_INPUT", "Inputs"), ("VAR_OUTPUT", "Outputs")):
        variables = [v for block in blocks if block.kind == kind for v in block.variables]
        if variables:
            lines += [f"{heading}:", "", *_table(variables)]
    if item.return_type:
        lines += [f"Returns `{item.return_type}`.", ""]
    return lines


def parts() -> dict[str, str]:
    """Return the page's generated parts."""
    store = TypeStore.bundled("jazzy")
    layout = compute_layout(store, EXAMPLE)
    topics = [
        PlcTopic(f"/{way}{'_classic' if classic else ''}", layout, way, "RosTask", classic=classic)
        for way in ("read", "write")
        for classic in (None, ClassicPlan("pose", "pose"))
    ]
    project = build_project(store, topics, [PlcTask("RosTask")])
    pous = {pou.name: pou for pou in project.pous}
    helpers: dict[str, Item] = {item.name: item for item in (*project.duts, *project.pous)}
    of_bridge = plc_project(resolve(parse_config(OWN_TOPICS)), ProjectOptions())
    own: dict[str, Item] = {item.name: item for item in (*of_bridge.duts, *of_bridge.pous)}
    lists = [gvl for gvl in project.gvls if gvl.name in ("RosPlc_Settings", "RosPlc_State")]
    objects = [*base_objects("ROS/Base"), *classic_objects("ROS/Base")]

    def blocks(title: str, name: str) -> list[str]:
        ways = ("Read", "Write")
        return [line for way in ways for line in _block(title.format(way), pous[name.format(way)], pous)]

    found = {
        "blocks": blocks("{} blocks", f"{EXAMPLE_DUT}_{{}}"),
        "classic blocks": blocks("Classic {} blocks", f"{EXAMPLE_DUT}_Classic{{}}"),
        "errors": _errors(next(item for item in objects if isinstance(item, Enumeration))),
        "lists": [],
        "helpers": [line for name in HELPER_NAMES for line in _helper(helpers[name])],
        "own": [line for names in OWN_NAMES.values() for name in names for line in _helper(own[name])],
        "base": ["| object | what it is |", "| --- | --- |"],
    }
    for gvl in sorted(lists, key=lambda gvl: gvl.name):
        found["lists"] += [f"### {gvl.name}", "", _sentence(gvl.comment), ""]
        found["lists"] += _table(v for block in gvl.blocks for v in block.variables)
    found["base"] += [f"| `{item.name}` | {_cell(_sentence(item.comment))} |" for item in objects]
    return {name: "\n".join(lines) for name, lines in found.items()}


def call_parts() -> dict[str, str]:
    """Return the generated parts of the page about services and actions."""
    project = plc_project(resolve(parse_config(CALLS)), ProjectOptions())
    pous = {pou.name: pou for pou in project.pous}
    objects = call_objects("ROS/Base", actions=True)
    found: dict[str, list[str]] = {}
    for word in ("Client", "Server"):
        found[f"{word.lower()} blocks"] = [
            *_block(f"Service {word.lower()}s", pous[f"std_srvs_Trigger_{word}"], pous),
            *_block(f"Action {word.lower()}s", pous[f"example_interfaces_Fibonacci_Action{word}"], pous),
        ]
    reasons = next(item for item in objects if item.name == "RosPlc_Reason")
    assert isinstance(reasons, Enumeration)
    found["reasons"] = ["| number | name |", "| ---: | --- |"]
    found["reasons"] += [f"| {number} | `{name}` |" for name, number in reasons.values]
    found["base"] = ["| object | what it is |", "| --- | --- |"]
    found["base"] += [f"| `{item.name}` | {_cell(_sentence(item.comment))} |" for item in objects]
    return {name: "\n".join(lines) for name, lines in found.items()}


if __name__ == "__main__":
    texts = {PAGE: filled(PAGE, parts()), CALLS_PAGE: filled(CALLS_PAGE, call_parts())}
    raise SystemExit(run(__doc__, texts | _pictures))
