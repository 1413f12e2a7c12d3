"""Names of objects (section 8.1) and sequences near the wrap (section 7.1)."""

from __future__ import annotations

from typing import Any

__all__ = ["names", "sequences"]

TOP = 2**32 - 1


def _fnv1a(text: str) -> int:
    value = 2166136261
    for byte in text.encode():
        value = ((value ^ byte) * 16777619) % 2**32
    return value


def names() -> dict[str, Any]:
    """Return topics with the names of their files, and topics and prefixes that must be refused."""
    plain = {
        ("rosplc", "/cmd_vel"): "cmd_vel",
        ("rosplc", "/robot1/cmd_vel"): "robot1.cmd_vel",
        ("rosplc", "/a/b/c/d"): "a.b.c.d",
        ("rosplc", "/_private"): "_private",
        ("rosplc", "/Case/Kept"): "Case.Kept",
        ("rosplc", "/case/kept"): "case.kept",
        ("cell-2_B", "/joint_states"): "joint_states",
        ("x", "/x"): "x",
        ("p" * 32, "/tf"): "tf",
        ("rosplc", "/" + "a" * 71): "a" * 71,
    }
    valid = [
        {"prefix": prefix, "topic": topic, "object": f"{prefix}.t.{rest}", "lock": f"{prefix}.l.{rest}",
         "temporary": f"{prefix}.n.{rest}."}
        for (prefix, topic), rest in plain.items()
    ]  # fmt: skip
    long = [
        ("rosplc", "/" + "a" * 72),
        ("rosplc", "/" + "a" * 73),
        ("rosplc", "/" + "/".join(["level"] * 20)),
        ("rosplc", "/" + "/".join(["level"] * 19) + "/other"),
        ("p" * 32, "/plant/line_7/cell_12/robot_left/controller/joint_trajectory/state"),
    ]
    for prefix, topic in long:
        whole = f"{prefix}.t.{topic[1:].replace('/', '.')}"
        name = f"{whole[:71]}~{_fnv1a(whole):08x}"
        at = len(prefix) + 1
        other = {kind: name[:at] + kind + name[at + 1 :] for kind in "ln"}
        valid.append(
            {
                "prefix": prefix,
                "topic": topic,
                "object": name,
                "lock": other["l"],
                "temporary": other["n"] + ".",
            }
        )
    letters = {"request": "sq", "response": "sr", "goal": "ag", "result": "ar", "feedback": "af"}
    uses = [
        *(("rosplc", "/gripper/close", part, "") for part in letters),
        *(("cell-2_B", "/gripper/close", part, "left") for part in letters),
        ("rosplc", "/add", "request", "a" * 32),
        ("rosplc", "/" + "a" * 70, "request", ""),
        ("rosplc", "/" + "a" * 71, "request", ""),
        ("rosplc", "/" + "a" * 66, "request", "left"),
        ("rosplc", "/" + "/".join(["level"] * 20), "feedback", "left"),
        ("rosplc", "/" + "/".join(["level"] * 20), "feedback", "right"),
    ]
    calls = []
    for prefix, topic, part, client in uses:
        rest = topic[1:].replace("/", ".") + (f"-{client}" if client else "")
        name = f"{prefix}.{letters[part]}.{rest}"
        name = f"{name[:71]}~{_fnv1a(name):08x}" if len(name) > 80 else name
        behind = name[len(prefix) + 1 :]
        calls.append({"prefix": prefix, "topic": topic, "part": part, "client": client, "object": name,
                      "lock": f"{prefix}.l{behind}", "temporary": f"{prefix}.n{behind}."})  # fmt: skip
    return {
        "about": "spec/shm-format.md, sections 8.1 and 11.1; 'temporary' lacks its 8 random digits",
        "valid": valid,
        "calls": calls,
        "invalid_clients": ["1", "_a", "a-b", "a.b", "a b", "a" * 33, "ä", "a\n", "-"],
        "invalid_topics": [
            "", "/", "cmd_vel", "//cmd_vel", "/cmd_vel/", "/a//b", "/1a", "/a/1b", "/a.b", "/a-b", "/a b",
            "/~a", "/ä", "/a\n", "/a\0", "/../etc/passwd", "/{a}", "~/a", "/a/",
        ],
        "invalid_prefixes": ["", "1a", "_a", "-a", "a.b", "a/b", "a b", "ä", "p" * 33, "a\n", ".."],
        "fnv1a": [["", 0x811C9DC5], ["a", 0xE40C292C], ["foobar", 0xBF9CF968]],
    }  # fmt: skip


def sequences() -> dict[str, Any]:
    """Return sums and differences of sequences, written by hand."""
    return {
        "about": "spec/shm-format.md, section 7.1",
        "next": [
            {"sequence": s, "slots": n, "next": after}
            for s, n, after in [
                (0, 4, 1),
                (1, 4, 2),
                (3, 4, 4),
                (TOP - 2, 4, TOP - 1),
                (TOP - 1, 4, TOP),
                (TOP, 4, 4),
                (TOP, 8, 8),
                (TOP, 65536, 65536),
                (2**31 - 1, 4, 2**31),
            ]
        ],
        "distance": [
            {"from": a, "to": b, "slots": n, "distance": d}
            for a, b, n, d in [
                (0, 0, 4, 0),
                (0, 1, 4, 1),
                (5, 5, 4, 0),
                (5, 9, 4, 4),
                (TOP - 1, TOP, 4, 1),
                (TOP, 4, 4, 1),
                (TOP, 5, 4, 2),
                (TOP - 1, 4, 4, 2),
                (TOP - 3, 7, 4, 7),
                (TOP, 8, 8, 1),
                (TOP, 65536, 65536, 1),
                (TOP - 2, 65538, 65536, 5),
                (9, 8, 4, 4294967291),
                (9, 5, 4, 4294967288),
                (4, TOP, 4, 4294967291),
                (0, 2**31, 4, 2**31),
                (1, 2**31, 4, 2**31 - 1),
                (2**31, 4, 4, 2**31),
                (2**31 + 1, 4, 4, 2**31 - 1),
                (TOP, 3, 4, 0),
                (TOP, 0, 4, 4294967293),
                (TOP, TOP, 4, 0),
            ]
        ],
        "advance": [
            {"sequence": s, "count": k, "slots": n, "result": r}
            for s, k, n, r in [
                (0, 1, 4, 1),
                (7, 3, 4, 10),
                (TOP - 1, 1, 4, TOP),
                (TOP - 1, 2, 4, 4),
                (TOP, 1, 4, 4),
                (TOP, 5, 4, 8),
                (TOP, 1, 16, 16),
                (TOP - 9, 20, 8, 18),
                (5, 0, 4, 5),
                (TOP, 2**31 - 1, 4, 2**31 + 2),
            ]
        ],
    }
