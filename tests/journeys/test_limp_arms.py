"""A limp arm stays limp: every command and every method on an arm of Feetech STS servos.

A goal switches the torque of such a servo on, so that each of these could make an arm jump. The
suite tries some of them, the campaign the others.
"""

import pytest

from tests.journeys import test_every_command, test_every_method
from tests.journeys.command_arguments import SERVERS, commands, lines_of
from tests.journeys.method_arguments import LISTENING, PLUGGED, methods
from tests.journeys.postures import FREQUENT
from tests.journeys.test_every_command import LONG

ARM, POSTURE = "so101", FREQUENT[0]
LINES = [
    pytest.param(line, marks=[pytest.mark.campaign] if line.startswith(LONG) else [])
    for command in commands() if command not in SERVERS
    for line in lines_of(command)
]  # fmt: skip
METHODS = [name for name in methods() if name not in LISTENING + PLUGGED]


@pytest.mark.sample(8)
@pytest.mark.parametrize("line", LINES, ids=test_every_command.name_of)
def test_no_command_makes_joints_of_limp_arm_jump(monkeypatch, tmp_path, line):
    test_every_command.judge(monkeypatch, tmp_path, ARM, line, POSTURE, "sim")


@pytest.mark.sample(8)
@pytest.mark.parametrize("method", METHODS)
def test_no_method_makes_joints_of_limp_arm_jump(monkeypatch, tmp_path, method):
    test_every_method.judge(monkeypatch, tmp_path, ARM, method, POSTURE, "sim")
