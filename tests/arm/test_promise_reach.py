"""M4: a target out of reach is answered by joints inside the limits, and reported."""

import numpy as np
import pytest

from ikservo.ik import Target, Tolerance, solve
from ikservo.model import load_model
from tests.arm.seeds import campaign, log
from tests.oracle import ARMS, tip_from_joints

NEAR_M = Tolerance().position_m  # what a solver may call reached
A_HUNDRED = 100  # targets a seed


@pytest.mark.parametrize("name", ["so101", "planar2", "vx300s"])
def test_report_flags_target_that_was_not_reached(name, capsys):
    check_targets(name, range(1), capsys)


@pytest.mark.parametrize("seeds", [campaign(100)])
@pytest.mark.parametrize("name", ARMS)
def test_report_flags_every_unreached_target_of_10000_per_arm(name, seeds, capsys):
    check_targets(name, seeds, capsys)


def check_targets(name, seeds, capsys):
    """Solve targets, half of them random; Pinocchio computes where the answers are."""
    chain, count, missed = load_model(name).chain, 0, 0
    for seed in seeds:
        for target_m in targets(chain, np.random.default_rng(seed)):
            result = solve(chain, Target(target_m))
            assert (result.q >= chain.lower_rad).all(), (seed, target_m)
            assert (result.q <= chain.upper_rad).all(), (seed, target_m)
            tip_m = tip_from_joints(name, dict(zip(chain.names, result.q.tolist(), strict=True)))
            gap_m = np.linalg.norm(tip_m - target_m)
            assert result.reached == (gap_m <= NEAR_M), (seed, target_m, gap_m)
            assert result.position_error_m == pytest.approx(gap_m, abs=1e-9)
            count, missed = count + 1, missed + (not result.reached)
    assert 0.3 * count < missed < 0.9 * count
    log(capsys, f"{name}: {count} targets, {missed} out of reach, each of them flagged")


def targets(chain, random):
    """Return points (n, 3) [m]: of the arm's own postures, and of a box larger than its reach."""
    inside = random.uniform(chain.lower_rad, chain.upper_rad, (A_HUNDRED // 2, chain.dof))
    reached_m = chain.forward(inside)[:, :3, 3]
    most_m = np.abs(reached_m).max() * 1.3
    return np.vstack([reached_m, random.uniform(-most_m, most_m, reached_m.shape)])
