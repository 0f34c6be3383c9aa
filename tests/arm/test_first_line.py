"""The first line or arc of a limp arm follows its path, although the arm sags at first."""

import numpy as np
import pytest

import ikservo
from ikservo.planning.motions import MoveArc, MoveLine
from tests.arm.simulated import clock_of, line_of


def true_tip_m(arm):
    """Return the tip (3,) of the true joints, without sensor rounding."""
    chain, world = arm.model.chain, line_of(arm).world
    return chain.forward(np.array([world.joint(name).position for name in chain.names]))[:3, 3]


def planned_tips_m(arm, plan):
    index, joints = arm.context.index, plan.sample(0.01).positions
    return np.array([arm.model.chain.forward(index.chain_joints(q))[:3, 3] for q in joints])


VIA, END = np.array([0.02, 0.0, 0.03]), np.array([0.05, 0.0, 0.04])
UP_AHEAD, UP_LEFT = np.array([0.03, 0.0, 0.03]), np.array([0.0, 0.04, 0.03])
PATHS = [
    ("so101", lambda tip_m: MoveLine(tip_m + UP_LEFT)),
    ("koch", lambda tip_m: MoveLine(tip_m + UP_AHEAD)),
    ("so101", lambda tip_m: MoveArc(tip_m + VIA, tip_m + END)),
]


@pytest.mark.sample(1)
@pytest.mark.full
@pytest.mark.parametrize(("name", "motion_from"), PATHS, ids=["so101", "koch", "so101-arc"])
def test_first_path_of_limp_arm_is_followed_within_1_4_mm(name, motion_from):
    with ikservo.open_arm(name, port="sim") as arm:
        clock_of(arm).sleep_until(clock_of(arm).now_s() + 15.0)
        plan = arm.plan(motion_from(arm.where().tip_m))
        tips_m = []
        report = arm.execute(plan, on_progress=lambda _: tips_m.append(true_tip_m(arm)))
        path_m = planned_tips_m(arm, plan)
        apart_m = np.array([np.linalg.norm(path_m - tip_m, axis=1).min() for tip_m in tips_m])
        assert report.reached
        assert apart_m.max() < 0.0014
