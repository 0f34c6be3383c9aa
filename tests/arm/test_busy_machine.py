"""Moves, lines and following at 60 Hz on a busy machine succeed.

``tools/load_campaign.py`` is the long form, in real time on a pseudo-terminal.
"""

import numpy as np
import pytest

import ikservo
from tests.arm.audit import Auditor
from tests.arm.line_tracing import PausedLines
from tests.arm.random_faults import seeded
from tests.arm.simulated import clock_of, context_of

PAUSED = 1e-5  # s for each line that is run: each cycle takes two or three times as long
MEAN_S = 0.008


def aside(arm):
    return arm.where().tip_m + np.array([0.0, 0.02, 0.0])


def move(arm):
    return arm.move_to(aside(arm)).reached


def line(arm):
    return arm.move_line(aside(arm)).reached


def follow(arm):
    goal = aside(arm)
    return arm.follow([goal] * 60).ended == "end of the targets"


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("task", [move, line, follow])
@pytest.mark.parametrize("name", ["so101", pytest.param("koch", marks=pytest.mark.campaign)])
def test_motion_on_busy_machine_ends_without_faults(name, task):
    dice = seeded(3)

    def busy(_place, _count):
        return dice.expovariate(1.0 / MEAN_S) if dice.random() < PAUSED / MEAN_S else 0.0

    with ikservo.open_arm(name, port="sim:?pose=home", collisions=False) as arm:
        arm.move_joints({"shoulder_pan": 0.05})
        context_of(arm).warm_up()
        auditor = Auditor(arm, punctual=False)
        with PausedLines(clock_of(arm), busy) as traced:
            traced.begin()
            assert task(arm)
        assert traced.pauses > 10
        assert auditor.faults() == []
