"""The Structured Text for CODESYS, read by other compilers: what they report, CODESYS would report as well.

``ROSPLC_STRUCPP`` names a checkout of STruC++ that was built, ``ROSPLC_BEREMIZ`` a folder with
``matiec/iec2c`` and ``matiec/lib``; no registry has them. Both know less of the language than CODESYS
does. What they do not know is taken out before, mechanically, by rules that each say why.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from rosplc.config.resolve import load_project
from rosplc.plc.build import build_project, build_type_library, plc_project
from rosplc.plc.plan import PlcTask, ProjectOptions
from rosplc.plc.project import project_texts
from tests.verification.call_cell import calls
from tests.verification.plc_cell import store
from tests.verification.test_types import DISTROS, all_layouts

pytestmark = pytest.mark.verifies("compilers", real="STruC++, matiec (where available)")

Rule = tuple[str, str]

PRAGMAS: list[Rule] = [
    (r"(?ms)^ *\{IF defined[^}]*\}\n.*?^ *\{END_IF\}\n", ""),  # conditions are of CODESYS alone
    (r"(?m)^ *\{[^}]*\}\n", ""),  # attributes
    (r"\bEND_STRUCT\nEND_TYPE", "END_STRUCT;\nEND_TYPE"),  # the standard has a semicolon there
]
STRUCPP: list[Rule] = [
    *PRAGMAS,
    (r"\bL(TIME|DT)_TO_", "LINT_TO_"),  # it has no 64-bit times
    (r"_TO_L(TIME|DT)\b", "_TO_LINT"),
    (r": L(TIME|DT)\b", ": LINT"),
    (r"__UXINT\b|\bRTS_IEC_HANDLE\b", "ULINT"),  # CODESYS' integer of a pointer's size; its libraries' types
    (r"\bRTS_IEC_RESULT\b", "UDINT"),
    (r"\bRTS_INVALID_HANDLE\b", "16#FFFFFFFFFFFFFFFF"),
    (r"__UXINT_TO", "ULINT_TO"),
    (r"(?m)^\) U[DS]INT;", ");"),  # no base types of enumerations
    (r"(?m)^( +\w+ : \w+) := \(\w+ := .*\);", r"\1;"),  # no initial values of structures
    (r"\d+\([^()]*\)\]", "0]"),  # no repeated initial values
    (r"(?m)^( +\w+ : (?!W?STRING)\w+)\([^;]*\);", r"\1;"),  # no arguments of FB_Init
    # CODESYS converts between pointers, and from a number to an enumeration
    (r"(?m)^( *)(?:pst\w+ := (?:pb\w+|0)|eError := udiError|eReason := udiWhy);", r"\1;"),
]
MATIEC: list[Rule] = [
    *PRAGMAS,
    (r"//[^\n]*", ""),  # comments of the third edition
    (r"\bSTRING\(\d+\)", "STRING"),
    (r"POINTER TO \w+", "DWORD"),
]
LIBRARIES = """
FUNCTION SysSharedMemoryOpen2 : ULINT
VAR_INPUT pszName : STRING(80); ulAt : ULINT; pulSize : POINTER TO ULINT; pResult : POINTER TO UDINT; END_VAR
;
END_FUNCTION
FUNCTION SysSharedMemoryGetPointer : POINTER TO BYTE
VAR_INPUT hShm : ULINT; pResult : POINTER TO UDINT; END_VAR
;
END_FUNCTION
FUNCTION SysSharedMemoryClose : UDINT
VAR_INPUT hShm : ULINT; END_VAR
;
END_FUNCTION
FUNCTION SysMemSet : POINTER TO BYTE
VAR_INPUT pDest : POINTER TO BYTE; udiValue : UDINT; udiCount : ULINT; END_VAR
;
END_FUNCTION
"""

OWN = """
rosout: {plc: true}
time: {plc: true}
transforms: {tool: {target: base, source: tool, max_age: 1min}}
parameters:
  declare:
    speed: {type: double, value: 0.5, range: [0, 2]}
    serial: {type: string, value: "x'y$", read_only: true}
    arm.raw: {type: byte_array, value: [1, 255], capacity: 3}
    arm.flags: {type: bool_array, value: [true], capacity: 3}
    arm.names: {type: string_array, value: [a], capacity: 3, length: 4}
topics:
  /in: {type: std_msgs/msg/Int32, to: plc}
"""


def changed(text: str, rules: Sequence[Rule]) -> str:
    for pattern, replacement in rules:
        text = re.sub(pattern, replacement, text)
    return text


def in_order(texts: dict[str, str]) -> list[str]:
    """Return objects, each behind those that it names."""
    found: dict[str, str] = {}

    def add(name: str) -> None:
        if name in texts and name not in found:
            found[name] = ""
            for word in re.findall(r"\w+", texts[name]):
                add(word)
            found[name] = found.pop(name) or texts[name]

    for name in texts:
        add(name)
    return list(found.values())


def for_strucpp(texts: dict[str, str]) -> str:
    """Return the objects of a project as one text."""
    lists = [name for name, text in texts.items() if "VAR_GLOBAL" in text]
    found = {}
    for name, text in texts.items():
        text = changed(text, STRUCPP)
        text = re.sub(rf"\b({'|'.join(lists)})\.", r"\1_", text)  # its lists have no namespaces
        if name in lists:
            text = re.sub(r"(?m)^    (\w+ :)", rf"    {name}_\1", text)
        if block := re.match(
            r"(?s)(.*?\bEND_FUNCTION_BLOCK\n)(.*)", text
        ):  # its methods are inside the block
            head, methods = block.groups()
            declared, body = re.fullmatch(
                r"(?s)((?:.*END_VAR\n|.*?^FUNCTION_BLOCK [^\n]*\n(?!VAR)))(.*)", head, re.M
            ).groups()  # type: ignore[union-attr]
            text = declared + methods + body
        found[name] = text
    return LIBRARIES + "\n".join(in_order(found))


def strucpp(text: str, folder: Path) -> str:
    """Return what STruC++ reports; empty if it compiles the text."""
    (folder / "all.st").write_text(text)
    cli = Path(os.environ["ROSPLC_STRUCPP"]) / "dist/node/cli.js"
    command = ["node", str(cli), str(folder / "all.st"), "-o", str(folder / "all.cpp")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout + done.stderr if done.returncode else ""


def project_of_calls() -> dict[str, str]:
    return project_texts(build_project(store(), (), [PlcTask("Fast"), PlcTask("RosTask")], calls=calls()))


def project_of_own_topics(folder: Path, fenced: bool = True) -> dict[str, str]:
    (folder / "rosplc.yaml").write_text(OWN)
    project = load_project(folder / "rosplc.yaml")
    return project_texts(plc_project(project, ProjectOptions(fenced=fenced)))


@pytest.mark.needs(variable="ROSPLC_STRUCPP")
@pytest.mark.timeout(600)
@pytest.mark.parametrize("fenced", [True, False])
def test_log_time_transforms_and_parameters(fenced: bool, tmp_path: Path) -> None:
    texts = project_of_own_topics(tmp_path, fenced)
    assert {"RosPlc_Log", "RosPlc_Time", "RosPlc_Pose", "RosPlc_Parameters"} <= texts.keys()
    assert strucpp(for_strucpp(texts), tmp_path) == ""


@pytest.mark.needs(variable="ROSPLC_STRUCPP")
@pytest.mark.timeout(600)
def test_services_and_actions(tmp_path: Path) -> None:
    assert strucpp(for_strucpp(project_of_calls()), tmp_path) == ""


@pytest.mark.needs(variable="ROSPLC_STRUCPP")
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("distro", DISTROS)
def test_every_type(distro: str, tmp_path: Path) -> None:
    texts = project_texts(build_type_library(store(distro), all_layouts(distro)))
    assert strucpp(for_strucpp(texts), tmp_path) == ""


@pytest.mark.needs(variable="ROSPLC_STRUCPP")
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("right", "wrong", "told"),
    [
        ("xCallerGone := FALSE;", "xCallerGon := FALSE;", "Undeclared variable 'XCALLERGON'"),
        ("xCallerGone := FALSE;", "xCallerGone := 'no';", "Cannot assign STRING to BOOL"),
        ("END_IF;", "", "Expected `END_IF`"),
        (": RosPlc_Part;", ": RosPlc_Par;", "Undefined type 'ROSPLC_PAR'"),
    ],
)
def test_a_fault_is_reported(right: str, wrong: str, told: str, tmp_path: Path) -> None:
    text = for_strucpp(project_of_calls())
    assert told in strucpp(text.replace(right, wrong, 1), tmp_path)


@pytest.mark.needs(variable="ROSPLC_STRUCPP")
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("right", "wrong", "told"),
    [
        ("udiStill := 0;", "udiStil := 0;", "Undeclared variable 'UDISTIL'"),
        ("sFrame := '';", "sFrame := TRUE;", "Cannot assign BOOL to STRING"),
        ("uiWaiting := uiWaiting + 1;", "uiWaiting := 'no';", "Cannot assign STRING"),
        (".msg.number := uliNumber;", ".msg.number := 'no';", "Cannot assign STRING"),
    ],
)
def test_a_fault_of_the_bridges_own_blocks_is_reported(
    right: str, wrong: str, told: str, tmp_path: Path
) -> None:
    text = for_strucpp(project_of_own_topics(tmp_path))
    assert right in text
    assert told in strucpp(text.replace(right, wrong, 1), tmp_path)


@pytest.mark.needs(variable="ROSPLC_BEREMIZ")
@pytest.mark.timeout(600)
@pytest.mark.parametrize("of", [*DISTROS, "own"])
def test_data_types_by_matiec(of: str, tmp_path: Path) -> None:
    """The standard's second edition has the data types, but no strings of a length inside of them."""
    if of == "own":
        texts = project_of_own_topics(tmp_path)
    else:
        texts = project_texts(build_type_library(store(of), all_layouts(of)))
    types = {name: changed(text, MATIEC) for name, text in texts.items() if "END_STRUCT" in text}
    program = "PROGRAM Empty\nVAR x : BOOL; END_VAR\nx := TRUE;\nEND_PROGRAM\n"
    (tmp_path / "all.st").write_text("\n".join(in_order(types)) + program)
    matiec = Path(os.environ["ROSPLC_BEREMIZ"]) / "matiec"
    command = [
        str(matiec / "iec2c"),
        "-I",
        str(matiec / "lib"),
        "-T",
        str(tmp_path),
        str(tmp_path / "all.st"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
