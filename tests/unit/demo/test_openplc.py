"""The demonstration's parts for OpenPLC, as far as they need no installation of it."""

from __future__ import annotations

import ctypes
import re
import subprocess
from pathlib import Path

import pytest

import rosplc
from rosplc.demo.openplc import find_openplc, program_text
from rosplc.demo.outside import write_configuration
from rosplc.demo.plan import COMMAND, Plan, command, robot_topics
from rosplc.errors import SetupError

SEAL = """#include <cstdint>
#include <cstring>
template <class T> struct Var {
    T value;
    T get() const { return value; }
    void operator=(T given) { value = given; }
};
extern "C" uint32_t seal(uint32_t one, double forward, double turn)
{
    Var<uint32_t> UDINUMBER{one}, UDISEAL{};
    Var<double> LRFORWARD{forward}, LRTURN{turn};
    %s
    return UDISEAL.get();
}
"""


@pytest.fixture
def plan() -> Plan:
    return Plan(domain=1, rate=100.0, topics=5, prefix="demo-nobody")


@pytest.mark.parametrize("missing", ["ROSPLC_OPENPLC", "ROSPLC_STRUCPP"])
@pytest.mark.parametrize("named", [None, "", "elsewhere"])
def test_without_an_installation(
    missing: str, named: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error names the variable and what its folder lacks, and the page that says how to build it."""
    files = {"ROSPLC_OPENPLC": "build/plc_main", "ROSPLC_STRUCPP": "dist/index.js"}
    for variable, file in files.items():
        (tmp_path / variable / file).parent.mkdir(parents=True)
        (tmp_path / variable / file).touch()
        monkeypatch.setenv(variable, str(tmp_path / variable))
    if named is None:
        monkeypatch.delenv(missing)
    else:
        monkeypatch.setenv(missing, named)
    with pytest.raises(SetupError) as caught:
        find_openplc()
    error = caught.value
    assert (error.code, error.where) == ("SYS001", named or "")
    assert missing in error.what and files[missing] in error.what
    (page,) = re.findall(r"docs/\S+\.md", error.remedy)
    assert (Path(__file__).parents[3] / page).is_file()


def test_the_program_uses_what_is_generated(plan: Plan, tmp_path: Path) -> None:
    """Every block that it declares is generated, and is called for a topic of its type and direction."""
    project, program = write_configuration(tmp_path, plan), program_text(plan)
    rosplc.generate(project, tmp_path / "plc", plc="openplc")
    text = (tmp_path / "plc" / "rosplc.st").read_text() + program
    blocks = set(re.findall(r"^FUNCTION_BLOCK (\w+)", text, re.M))
    declared = program[program.index("PROGRAM Demo\n") : program.index("END_VAR\ndrive")]
    instances = dict(re.findall(r"^ +(\w+) : (\w+);$", declared, re.M))
    instances.pop("xMore")
    assert set(instances.values()) <= blocks
    calls = re.findall(r"^ *(\w+)\(\s*sTopic := '([^']*)'", program, re.M)
    directions = {plan.topic: plan.direction.name for plan in project.topics}
    called = dict(calls)
    for name, topic in called.items():
        way = {"Read": "TO_PLC", "Write": "TO_ROS"}[instances[name].rpartition("_")[2]]
        assert directions[topic] == way, topic
    assert set(called.values()) == set(directions)
    assert {*robot_topics(5), COMMAND[0]} < set(directions)
    assert "T#10ms" in program


def test_its_seal_is_that_of_the_python_program(plan: Plan, tmp_path: Path) -> None:
    """The robot would take any other for a torn command."""
    program = program_text(plan)
    body = re.search(r"FUNCTION_BLOCK Demo_Seal\n.*?\{external\n(.*?)\n\}\n", program, re.S)
    assert body is not None
    (tmp_path / "seal.cpp").write_text(SEAL % body[1])
    compiled = [
        "g++",
        "-std=c++17",
        "-shared",
        "-fPIC",
        str(tmp_path / "seal.cpp"),
        "-o",
        str(tmp_path / "seal.so"),
    ]
    subprocess.run(compiled, check=True)
    seal = ctypes.CDLL(str(tmp_path / "seal.so")).seal
    seal.restype = ctypes.c_uint32
    for number, forward, turn in ((1, 0.5, 0.0), (2, 0.25, -2.0), (4_000_000_000, 1e-9, 1.7)):
        wanted = command(number, forward, turn)["angular"]["x"]
        assert seal(number, ctypes.c_double(forward), ctypes.c_double(turn)) == wanted
