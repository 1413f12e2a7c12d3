"""What a browser sends to ``rosplc web``: wishes, paths of fields, messages to write, headers."""

from __future__ import annotations

import json
from collections.abc import Iterator

from rosplc.errors import LayoutError, WebError
from rosplc.layout import Limits, compute_layout
from rosplc.layout.view import plain
from rosplc.model import TypeStore
from rosplc.web.access import same_token, wrong_host, wrong_origin
from rosplc.web.live import Wants, number_at, parse_path
from rosplc.web.write import form_of, from_form, shown
from tests.fuzz.choices import Choices
from tests.fuzz.oracle import refusals

__all__ = ["check", "seeds"]

_layouts = [
    compute_layout(TypeStore.bundled("jazzy"), name, Limits(9, 3))
    for name in (
        "geometry_msgs/msg/PoseArray",
        "sensor_msgs/msg/JointState",
        "diagnostic_msgs/msg/DiagnosticArray",
    )
]
_forms = [form_of(layout) for layout in _layouts]


def check(data: bytes) -> None:
    """Whatever the browser sends is refused with a code, or fits."""
    choices = Choices(data)
    how, number = choices.below(4), choices.below(len(_layouts))
    text = choices.rest().decode("utf-8", "replace")
    layout = _layouts[number]
    if how == 0:
        host, _, rest = text.partition("\n")
        wrong_host(host, ["robot1"])
        wrong_origin(rest, host)
        assert not same_token("0123456789abcdef", text) or text == "0123456789abcdef"
        return
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return  # the handlers answer this with WEB009
    with refusals(WebError, LayoutError):
        if how == 1:
            wants = Wants.of(value)
            message = plain(layout.view(layout.pack({})))
            for paths in wants.plots.values():
                for path in paths:
                    assert parse_path(path)
                    number_at(message, path)
        elif isinstance(value, dict):
            record = layout.pack(from_form(_forms[number], value))
            json.dumps(shown(plain(layout.view(record))), allow_nan=False)


def seeds() -> Iterator[bytes]:
    """What the page's own script sends."""
    yield b"\0\0localhost:8480\nhttp://localhost:8480"
    yield b"\0\0[::1]:80\nhttps://evil"
    yield b'\1\0{"messages": ["a:/b"], "plots": {"a:/b": ["header.stamp.sec", "poses[1].position.x"]}}'
    yield b'\2\0{"header": {"frame_id": "a"}, "poses": [{"position": {"x": "1e5", "y": NaN}}]}'
    yield b'\2\1{"name": ["a", "b"], "position": [1, 2.5, -Infinity], "effort": {"first": [1], "count": 9}}'
    yield b'\2\2{"status": [{"level": "1", "values": [{"key": "\\u0000", "value": "\\ud800"}]}]}'
