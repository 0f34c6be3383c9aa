"""The other joints compensate for one that is held: pure functions, without servos."""

import numpy as np

import ikservo
from ikservo.settling.tick_rounding import compensate

CHAIN = ikservo.load_model("so101").chain
HOME = ikservo.load_model("so101").chain_pose("home")
ELBOW = CHAIN.names.index("elbow_flex")


def short_of_home(by_rad):
    q = HOME.copy()
    q[ELBOW] += by_rad
    return q


def test_other_joints_bring_tip_to_target_if_one_is_short():
    q, target_m = short_of_home(0.015), CHAIN.forward(HOME)[:3, 3]
    found = compensate(CHAIN, target_m, q, {"elbow_flex"})
    assert found[ELBOW] == q[ELBOW]
    assert np.linalg.norm(CHAIN.forward(found)[:3, 3] - target_m) < 5e-5


def test_tip_compensation_moves_joints_at_most_0_05_rad():
    q, target_m = short_of_home(0.2), CHAIN.forward(HOME)[:3, 3]
    found = compensate(CHAIN, target_m, q, {"elbow_flex"})
    assert found is None or np.abs(found - q).max() <= 0.05 + 1e-9


def test_tip_compensation_keeps_joints_inside_limits():
    q, target_m = short_of_home(0.015), CHAIN.forward(HOME)[:3, 3]
    tight = CHAIN.with_limits(q - 0.003, q + 0.003)
    found = compensate(tight, target_m, q, {"elbow_flex"})
    assert found is None or ((tight.lower_rad <= found) & (found <= tight.upper_rad)).all()


def test_tip_compensation_without_free_joints_returns_none():
    target_m = CHAIN.forward(short_of_home(0.3))[:3, 3]
    assert compensate(CHAIN, target_m, HOME, set(CHAIN.names)) is None
