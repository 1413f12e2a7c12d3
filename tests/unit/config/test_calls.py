"""The sections ``services`` and ``actions``: each use has a plan, and what is wrong is named."""

from __future__ import annotations

from typing import Any

import jsonschema
import pytest

from rosplc.config import ConfigErrors, json_schema, parse_config, resolve
from rosplc.config.resolve import Project, object_plans
from rosplc.ros import SERVICES

TRIGGER = "std_srvs/srv/Trigger"
SET_BOOL = "std_srvs/srv/SetBool"
FIBONACCI = "example_interfaces/action/Fibonacci"


def project(services: str, more: str = "") -> Project:
    return resolve(parse_config(f"{more}\nservices:\n{services}", name="c.yaml"))


def errors_of(entry: str, name: str = "/a", section: str = "services") -> list[tuple[str, str, str]]:
    """Return code, place and text of everything wrong."""
    with pytest.raises(ConfigErrors) as caught:
        resolve(parse_config(f"\n{section}:\n  {name}: {{{entry}}}\n", name="c.yaml"))
    return [(error.code, error.where, error.what) for error in caught.value.errors]


def test_a_service_of_the_plc() -> None:
    made = project(f"  /cell/start: {{type: {SET_BOOL}, server: plc}}\n")
    (plan,) = made.services
    assert (plan.service, plan.type_name, plan.server, plan.client) == ("/cell/start", SET_BOOL, "plc", "")
    assert (plan.request.type_name, plan.response.type_name) == (
        f"{SET_BOOL}_Request",
        f"{SET_BOOL}_Response",
    )
    assert (plan.task, plan.depth, plan.per_client) == ("RosTask", 16, 4)
    assert (plan.min_interval_ns, plan.expire_after_ns, plan.fallback) == (0, 5 * 10**9, None)
    assert (plan.truncate, plan.qos, plan.name) == (False, SERVICES, "service /cell/start")
    assert made.topics == ()


def test_all_keys_of_a_service_of_the_plc() -> None:
    (plan,) = project(
        "  /a: {type: std_srvs/SetBool, server: plc, task: Fast, depth: 3, rate_limit: 10ms,\n"
        "       expire_after: 200ms, on_overflow: truncate, fallback: {message: down}}\n",
        "tasks: {Slow: {}, Fast: {interval: 1ms}}",
    ).services
    assert (plan.type_name, plan.task, plan.depth, plan.per_client) == (SET_BOOL, "Fast", 3, 1)
    assert (plan.min_interval_ns, plan.expire_after_ns, plan.truncate) == (10_000_000, 200_000_000, True)
    assert plan.fallback is not None
    found = plan.response.to_dict(plan.fallback)
    assert found == {"success": False, "message": "down"}


def test_each_client_is_a_use_of_its_own() -> None:
    """A list of names, or names with a task; a topic may have the service's name."""
    made = project(
        f"  /grip: {{type: {TRIGGER}, server: ros, task: Fast, clients: [pick, place]}}\n"
        f"  /open: {{type: {TRIGGER}, server: ros, clients: {{left: {{task: Fast}}, right: {{}}}}}}\n"
        f"  /shut: {{type: {TRIGGER}, server: ros}}\n"
        "topics:\n  /grip: {type: std_msgs/msg/Bool, to: plc}\n",
        "tasks: {Slow: {}, Fast: {interval: 1ms}}",
    )
    assert [(plan.service, plan.client, plan.task) for plan in made.services] == [
        ("/grip", "pick", "Fast"),
        ("/grip", "place", "Fast"),
        ("/open", "left", "Fast"),
        ("/open", "right", "Slow"),
        ("/shut", "", "Slow"),
    ]
    assert made.services[0].name == "service /grip pick"


def test_actions() -> None:
    """An action may have a service's name; its objects have names of their own."""
    made = resolve(
        parse_config(
            f"services: {{/a: {{type: {TRIGGER}, server: plc}}}}\n"
            "actions:\n"
            f"  /a: {{type: {FIBONACCI}, server: plc}}\n"
            f"  /b: {{type: {FIBONACCI}, server: plc, on_new_goal: buffer, accept_within: 1s,\n"
            "        keep_result: 2s, limits: {result.sequence: 5, feedback.sequence: 3},\n"
            "        on_overflow: truncate}\n"
            f"  /c: {{type: {FIBONACCI}, server: ros, clients: [x, y], when_plc_down: keep}}\n"
        )
    )
    a, b, *both = made.actions
    assert (a.action, a.type_name, a.server, a.client) == ("/a", FIBONACCI, "plc", "")
    assert (a.on_new_goal, a.queue, a.accept_within_ns, a.keep_result_ns) == ("reject", 0, 5 * 10**9, 10**10)
    assert (b.on_new_goal, b.queue, b.accept_within_ns, b.keep_result_ns) == ("buffer", 4, 10**9, 2 * 10**9)
    assert (a.truncate, b.truncate, a.task, a.name) == (False, True, "RosTask", "action /a")
    assert [layout.type_name for layout in a.layouts] == [
        f"{FIBONACCI}_{part}" for part in ("Goal", "Result", "Feedback")
    ]
    capacities = [
        {path: node.capacity for path, _, node in layout.fields() if path == "sequence"}  # type: ignore[union-attr]
        for layout in (b.result, b.feedback)
    ]
    assert capacities == [{"sequence": 5}, {"sequence": 3}]
    assert [plan.name for plan in both] == ["action /c x", "action /c y"]
    assert {plan.when_plc_down for plan in both} == {"keep"}
    names = {plan.name: object_plans(made, plan) for plan in made.calls}
    assert [identity.kind for identity in names["action /b"].values()] == [0x0103, 0x0203, 0x0303]
    assert [identity.direction for identity in names["action /b"].values()] == [1, 2, 2]
    assert [identity.direction for identity in names["action /c x"].values()] == [2, 1, 1]


def test_limits_by_part() -> None:
    (plan,) = project(
        f"  /a: {{type: {SET_BOOL}, server: plc, limits: {{response.message: 12}}}}\n",
    ).services
    (other,) = project(f"  /a: {{type: {SET_BOOL}, server: plc, limits: {{string: 7}}}}\n").services
    capacities = [
        {path: node.capacity for path, _, node in layout.fields() if path == "message"}  # type: ignore[union-attr]
        for layout in (plan.response, other.response)
    ]
    assert capacities == [{"message": 12}, {"message": 7}]


@pytest.mark.parametrize(
    ("entry", "code", "place", "words"),
    [
        ("type: no_srvs/srv/None, server: ros", "TYP001", "services./a.type", "no_srvs"),
        ("type: 'std_srvs/srv/', server: ros", "CFG004", "services./a.type", "package/srv/Name"),
        ("type: {T}", "CFG005", "services./a.server", "'server' is missing"),
        ("server: plc", "CFG005", "services./a.type", "'type' is missing"),
        ("type: {T}, server: robot", "CFG004", "services./a.server", "'robot' is not valid"),
        ("type: {T}, server: plc, dept: 3", "CFG003", "services./a.dept", "did you mean 'depth'"),
        ("type: {T}, server: plc, depth: 0", "CFG004", "services./a.depth", "greater than or equal to 1"),
        (
            "type: {T}, server: plc, depth: 2, per_client: 3",
            "CFG004",
            "services./a.per_client",
            "exceeds depth",
        ),
        ("type: {T}, server: plc, expire_after: 2h", "CFG004", "services./a.expire_after", "not between"),
        ("type: {T}, server: plc, task: No", "CFG004", "services./a.task", "task 'No' is not defined"),
        ("type: {T}, server: plc, clients: [a]", "CFG004", "services./a.clients", "in ROS"),
        ("type: {T}, server: ros, depth: 3", "CFG004", "services./a.depth", "`server: plc`"),
        ("type: {T}, server: ros, rate_limit: 5Hz", "CFG004", "services./a.rate_limit", "`server: plc`"),
        ("type: {T}, server: ros, fallback: {}", "CFG004", "services./a.fallback", "`server: plc`"),
        ("type: {T}, server: ros, clients: [a, a]", "CFG004", "services./a.clients", "distinct names"),
        ("type: {T}, server: ros, clients: [a-b]", "CFG004", "services./a.clients", "a letter"),
        (
            "type: {T}, server: ros, clients: [a, A]",
            "CFG007",
            "services./a.clients.A",
            "same name in the PLC",
        ),
        (
            "type: {T}, server: ros, clients: {a: {task: No}}",
            "CFG004",
            "services./a.clients.a.task",
            "is not defined",
        ),
        (
            "type: {T}, server: plc, limits: {success: 3}",
            "CFG004",
            "services./a.limits.success",
            "not a field",
        ),
        (
            "type: {T}, server: plc, limits: {response.no: 3}",
            "LAY002",
            "services./a.limits.response.no",
            "no",
        ),
        ("type: {T}, server: plc, limits: {string: 0}", "LAY001", "services./a.limits.string", "0"),
        ("type: {T}, server: plc, fallback: {ok: true}", "CFG004", "services./a.fallback", "ok"),
        (
            "type: {T}, server: plc, limits: {string: 3}, fallback: {message: long}",
            "CFG004",
            "services./a.fallback.message",
            "4 bytes",
        ),
        ("type: {T}", "CFG005", "actions./a.server", "'server' is missing"),
        ("type: no_msgs/action/No, server: plc", "TYP001", "actions./a.type", "no_msgs"),
        (f"type: {TRIGGER}, server: plc", "CFG004", "actions./a.type", "package/action/Name"),
        ("type: {T}, server: plc, clients: [a]", "CFG004", "actions./a.clients", "in ROS"),
        ("type: {T}, server: plc, when_plc_down: keep", "CFG004", "actions./a.when_plc_down", "server: ros"),
        ("type: {T}, server: plc, on_new_goal: wait", "CFG004", "actions./a.on_new_goal", "'wait'"),
        (
            "type: {T}, server: plc, on_new_goal: abort, queue: 2",
            "CFG004",
            "actions./a.queue",
            "no effect with `on_new_goal: abort`",
        ),
        ("type: {T}, server: plc, accept_within: 0s", "CFG004", "actions./a.accept_within", "not between"),
        ("type: {T}, server: ros, queue: 2", "CFG004", "actions./a.queue", "`server: plc`"),
        ("type: {T}, server: ros, accept_within: 1s", "CFG004", "actions./a.accept_within", "`server: plc`"),
        ("type: {T}, server: ros, keep_result: 1s", "CFG004", "actions./a.keep_result", "`server: plc`"),
        ("type: {T}, server: ros, limits: {order: 1}", "CFG004", "actions./a.limits.order", "result or"),
        ("type: {T}, server: ros, limits: {goal.no: 1}", "LAY002", "actions./a.limits.goal.no", "no"),
    ],
)
def test_what_is_wrong_is_named_with_its_key(entry: str, code: str, place: str, words: str) -> None:
    section = place.partition(".")[0]
    kind = TRIGGER if section == "services" else FIBONACCI
    ((found, where, what),) = errors_of(entry.replace("{T}", kind), section=section)
    assert (found, where.rpartition(" ")[2]) == (code, place)
    assert where.startswith("c.yaml:3")
    assert words in what


@pytest.mark.parametrize(
    ("name", "section", "kind"),
    [
        ("/arm/_action/send_goal", "services", TRIGGER),
        ("/a/_service_event", "services", TRIGGER),
        ("/arm/_action/move", "actions", FIBONACCI),
    ],
)
def test_names_that_ros_makes_itself(name: str, section: str, kind: str) -> None:
    ((code, _, what),) = errors_of(f"type: {kind}, server: plc", name, section)
    assert code == "CFG004"
    assert "reserved by ROS" in what


@pytest.mark.parametrize(
    ("services", "valid"),
    [
        ({"/a": {"type": FIBONACCI, "server": "ros", "clients": ["x"], "when_plc_down": "keep"}}, True),
        ({"/a": {"type": FIBONACCI, "server": "plc", "clients": ["x-y"]}}, False),
        ({"/a": {"type": TRIGGER, "server": "ros", "clients": ["x", "y"]}}, True),
        ({"/a": {"type": TRIGGER, "server": "ros", "clients": {"x": {"task": "T"}}}}, True),
        ({"/a": {"type": TRIGGER, "server": "plc", "fallback": {"success": False}}}, True),
        (None, True),
        ({"/a": {"type": TRIGGER, "server": "ros", "clients": ["x-y"]}}, False),
        ({"/a": {"type": TRIGGER}}, False),
        ({"a": {"type": TRIGGER, "server": "ros"}}, False),
    ],
)
def test_schema(services: Any, valid: bool) -> None:
    check = jsonschema.Draft202012Validator(json_schema())
    section = "actions" if "/action/" in str(services) else "services"
    assert check.is_valid({section: services}) is valid
