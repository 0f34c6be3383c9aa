"""The extent of a motion is exact, even if a joint reverses between its knots."""

import numpy as np
import pytest

from ikservo.motion import JointMove, KinematicLimits, TrajectoryPoint, stop_trajectory

SEEDS = range(12)


def motions(seed):
    """Return motions from states within and beyond the limits: to a goal, and to a stop."""
    rng = np.random.default_rng(seed)
    paces = [KinematicLimits(*(10 ** rng.uniform(-0.5, 0.5, 3) * [1, 5, 50])) for _ in range(3)]
    start = TrajectoryPoint(rng.uniform(-1, 1, 3), rng.uniform(-2, 2, 3), rng.uniform(-10, 10, 3))
    goal = rng.uniform(-1, 1, 3)
    return [
        JointMove(start, goal, paces),
        JointMove(start, goal, paces, together=False),
        stop_trajectory(start, paces),
    ]


@pytest.mark.parametrize("seed", SEEDS)
def test_motion_extent_equals_extremes_of_sampled_positions(seed):
    for motion in motions(seed):
        samples = np.array([motion.at(t) for t in np.linspace(0, motion.duration_s, 1500)])
        lowest, highest = motion.extent
        assert (samples >= lowest - 1e-9).all()
        assert (samples <= highest + 1e-9).all()
        np.testing.assert_allclose(samples.min(axis=0), lowest, atol=2e-4)
        np.testing.assert_allclose(samples.max(axis=0), highest, atol=2e-4)
