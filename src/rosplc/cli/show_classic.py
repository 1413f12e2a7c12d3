"""``rosplc show --config``: classic topics, which only their configuration can tell."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from rosplc.cli.guard import finite, print_json
from rosplc.cli.text import columns, say, warn
from rosplc.errors import ChannelError

if TYPE_CHECKING:
    from rosplc.config.resolve import TopicPlan
    from rosplc.monitor.classic import ClassicState

__all__ = ["classic_facts", "classic_plans", "list_classic", "show_classic"]


def classic_plans(config: Path) -> list[TopicPlan]:
    """Return the classic topics of a configuration. Raises ConfigErrors."""
    from rosplc.config.resolve import load_project

    return [plan for plan in load_project(config).topics if plan.classic is not None]


def _look(plan: TopicPlan) -> ClassicState:
    from rosplc.monitor.classic import look_at

    assert plan.classic is not None
    return look_at(plan.classic.name, plan.classic.semaphore, plan.layout.size)


def classic_facts(plans: list[TopicPlan]) -> list[dict[str, Any]]:
    """Return the classic topics as plain data."""
    return [facts(plan, _look(plan)) for plan in plans]


def facts(plan: TopicPlan, state: ClassicState) -> dict[str, Any]:
    """Return a classic topic as plain data."""
    return {
        "topic": plan.topic,
        "type": plan.type_name,
        "direction": "to_plc" if plan.direction == 1 else "to_ros",
        "memory": state.name,
        "semaphore": state.semaphore,
        "record_bytes": plan.layout.size,
        "memory_bytes": state.size,
        "owner": state.owner,
        "lock": state.lock,
        "error": state.error,
        "code": state.code,
        "message": None if state.record is None else plan.layout.to_dict(state.record),
    }


def list_classic(plans: list[TopicPlan]) -> None:
    """Print one line per classic topic."""
    rows, errors = [], []
    for plan in plans:
        state = _look(plan)
        arrow = "→ PLC" if plan.direction == 1 else "→ ROS"
        sizes = f"{plan.layout.size} of {state.size}" if state.size else f"{plan.layout.size}"
        rows.append((plan.topic, arrow, plan.type_name, sizes, state.name, state.owner or "-", state.lock))
        if state.error:
            errors.append(f"{plan.topic}: {state.name}: {state.error} [{state.code}]")
    if rows:
        say()
        for line in columns(
            rows, header=("classic topic", "way", "type", "bytes", "memory", "owner", "lock")
        ):
            say(line)
    for text in errors:
        warn(text)


def show_classic(
    plan: TopicPlan, *, follow: bool, count: int | None, timeout: float | None, as_json: bool
) -> None:
    """Print what stands in a classic topic's memory; with ``follow`` or ``count`` each change seen."""
    state = _look(plan)
    if not follow and count is None:
        _print(plan, state, as_json=as_json, one_line=False)
        return
    printed, last, since = 0, state.record, time.monotonic()
    while count is None or printed < count:
        state = _look(plan)
        if state.record is not None and state.record != last:
            last, since = state.record, time.monotonic()
            _print(plan, state, as_json=as_json, one_line=True)
            printed += 1
        elif timeout is not None and time.monotonic() - since > timeout:
            break
        time.sleep(0.005)
    if count is not None and printed < count:
        warn(f"rosplc: {printed} of {count} changes came within the time")
        raise typer.Exit(1)


def _print(plan: TopicPlan, state: ClassicState, *, as_json: bool, one_line: bool) -> None:
    from rosplc.cli.show import lines_of

    document = facts(plan, state)
    if as_json and one_line:
        typer.echo(json.dumps(finite(document)))
        return
    if as_json:
        print_json(document)
        return
    if state.record is None:
        raise ChannelError(state.code, state.error, where=f"/dev/shm/{state.name}")
    say(f"{plan.topic}  {plan.type_name}  classic memory {state.name}, lock: {state.lock}")
    for line in lines_of(document["message"]):
        say("  " + line)
