"""No module is loaded while goals are streamed: no cycle may wait for it."""

import subprocess
import sys

import pytest

PROGRAM = """
import sys
import ikservo
from ikservo.control.loop import ControlLoop

def loaded():
    return {name for name in sys.modules if "encodings" not in name}

run, late = ControlLoop._run_loop, []

def watched(self, *words):
    modules = loaded()
    try:
        return run(self, *words)
    finally:
        late.extend(sorted(loaded() - modules))

ControlLoop._run_loop = watched
with ikservo.open_arm(ARM, port="sim") as arm:
    tip_m = arm.where().tip_m
    SKILL
print(*late, sep="\\n")
"""
SKILLS = {
    "follow": "arm.follow([tip_m + (0.0, 0.0, 0.01)] * 40)",
    "follow joints": "arm.follow([{arm.chain.names[0]: 0.1}] * 40)",
    "jog": "arm.jog('up', wanted=iter([True] * 20 + [False] * 99).__next__)",
    "jog a joint": "arm.jog(arm.chain.names[0], wanted=iter([True] * 20 + [False] * 99).__next__)",
    "move": "arm.pose('home')",
    "line": "arm.pose('home'); late.clear(); arm.move_line(arm.where().tip_m + (0, 0, 0.02))",
    "grip": "arm.gripper('open')",
    "relax": "arm.relax()",
}
FEW = ("follow",)


@pytest.mark.full
@pytest.mark.parametrize("name", ["so101", pytest.param("koch", marks=pytest.mark.campaign)])
@pytest.mark.parametrize(
    "skill", [pytest.param(s, marks=() if s in FEW else pytest.mark.campaign) for s in SKILLS]
)
def test_motion_imports_no_module_after_its_first_goal(name, skill):
    program = PROGRAM.replace("ARM", repr(name)).replace("SKILL", SKILLS[skill])
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert (done.stdout.split(), done.stderr, done.returncode) == ([], "", 0)
