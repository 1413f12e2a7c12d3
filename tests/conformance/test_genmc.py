"""The C headers themselves under GenMC, an exhaustive checker of C memory models, under RC11 and IMM.

``ROSPLC_GENMC`` names its program; no registry has it. A row is a scene of genmc/channel_model.c, or, with
SCENE, of genmc/call_model.c. Those in which something is taken out are controls: there a violation must be
found.
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

import rosplc

pytestmark = pytest.mark.verifies("torn", real="GenMC")

MODELS = Path(__file__).with_name("genmc")
WITHDRAWN, CLAIMED, BOTH = range(1, 4)
FENCES, DELAYED, HANDED_OVER, HANDED_BACK = range(1, 5)

HOLDS = {
    "fences, the newest": {"WRITER": FENCES, "MESSAGES": 2, "BEHIND": 0},
    "fences, a message behind": {"WRITER": FENCES, "MESSAGES": 3, "BEHIND": 1},
    "fences, two messages behind": {"WRITER": FENCES, "MESSAGES": 4},
    "fences, three messages behind": {"WRITER": FENCES, "MESSAGES": 3, "BEHIND": 3},
    "fences, two attempts": {"WRITER": FENCES, "MESSAGES": 2, "ATTEMPTS": 2},
    "fences, over the wrap": {"WRITER": FENCES, "MESSAGES": 3, "START": "4294967294u"},
    "fences, head scribbled over": {"WRITER": FENCES, "MESSAGES": 2, "SCRIBBLE": 6},
    "delayed rule": {"WRITER": DELAYED, "MESSAGES": 4},
    "delayed rule, over the wrap": {"WRITER": DELAYED, "MESSAGES": 4, "START": "4294967294u"},
    "handed over to the delayed rule": {"WRITER": HANDED_OVER, "MESSAGES": 4},
    "handed over, over the wrap": {"WRITER": HANDED_OVER, "MESSAGES": 4, "START": "4294967294u"},
    "handed back to fences": {"WRITER": HANDED_BACK, "MESSAGES": 3},
    # Second nets: the seal's fence orders what F1 does, the sequence's fence what F2 does.
    "without F1 alone": {"WRITER": FENCES, "MESSAGES": 3, "WITHOUT_F1": 1},
    "without F2 alone": {"WRITER": FENCES, "MESSAGES": 2, "BEHIND": 0, "WITHOUT_F2": 1},
    "a call is withdrawn": {"SCENE": WITHDRAWN},
    "an answerer claims": {"SCENE": CLAIMED},
    "an answerer claims while another takes": {"SCENE": BOTH},
}
FAILS = {
    "without F1 and F5": {"WRITER": FENCES, "MESSAGES": 4, "WITHOUT_F1": 1, "WITHOUT_F5": 1},
    "without F2 and F6": {"WRITER": FENCES, "MESSAGES": 2, "BEHIND": 0, "WITHOUT_F2": 1, "WITHOUT_F6": 1},
    "without F3": {"WRITER": FENCES, "MESSAGES": 3, "WITHOUT_F3": 1},
    "without F4": {"WRITER": FENCES, "MESSAGES": 3, "WITHOUT_F4": 1},
    "head scribbled over, without F5": {"WRITER": FENCES, "MESSAGES": 3, "SCRIBBLE": 6, "WITHOUT_F5": 1},
    "head scribbled over, without F6": {
        "WRITER": FENCES, "MESSAGES": 1, "BEHIND": 0, "SCRIBBLE": 6, "WITHOUT_F6": 1,
    },
    "handed over, the rule loaded once": {"WRITER": HANDED_OVER, "MESSAGES": 3, "ONE_LOOK": 1},
    "a call is withdrawn, without F7": {"SCENE": WITHDRAWN, "WITHOUT_F7": 1},
    "a call is withdrawn, without F8": {"SCENE": WITHDRAWN, "WITHOUT_F8": 1},
    "a call is withdrawn, no second look": {"SCENE": WITHDRAWN, "ONE_LOOK": 1},
    "an answerer claims, without F7": {"SCENE": CLAIMED, "WITHOUT_F7": 1},
    "an answerer claims, without F8": {"SCENE": CLAIMED, "WITHOUT_F8": 1},
    "an answerer claims, the call is not withdrawn": {"SCENE": CLAIMED, "KEPT": 1},
    "an answerer claims while another takes, no second look": {"SCENE": BOTH, "ONE_LOOK": 1},
}  # fmt: skip


def explore(scene: dict[str, object], memory: str) -> tuple[bool, int]:
    """Return whether GenMC found a violation, and the executions that it explored."""
    include = Path(rosplc.__file__).parent / "include"
    options = [f"-D{name}={value}" for name, value in scene.items()]
    command = [os.environ["ROSPLC_GENMC"], "--disable-estimation", memory, "--", f"-I{include}", *options]
    model = MODELS / ("call_model.c" if "SCENE" in scene else "channel_model.c")
    done = subprocess.run([*command, model], capture_output=True, text=True, check=False)
    output = done.stdout + done.stderr
    explored = re.search(r"complete executions explored: (\d+)", output)
    violated = "Assertion violation" in output
    assert explored and (violated or "No errors were detected" in output), output
    return violated, int(explored[1])


@pytest.mark.needs(variable="ROSPLC_GENMC")
@pytest.mark.parametrize("memory", ["--rc11", "--imm"])
@pytest.mark.parametrize("name", HOLDS)
def test_no_execution_breaks_a_rule(name: str, memory: str) -> None:
    """Every execution that the memory model allows was explored, and none breaks an assertion."""
    violated, executions = explore(HOLDS[name], memory)
    print(f"{name}, {memory[2:]}: {executions} executions")
    assert not violated
    assert executions > 1


@pytest.mark.needs(variable="ROSPLC_GENMC")
@pytest.mark.parametrize("name", FAILS)
def test_what_is_taken_out_is_missed(name: str) -> None:
    """Without a fence or a look that a rule depends on, an execution is found that breaks it."""
    assert explore(FAILS[name], "--rc11")[0]
