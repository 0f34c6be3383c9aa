"""Where a limp arm comes to rest there is a free path, or a refusal that names the contact.

An arm is dropped in a random posture and sinks onto its table and into itself. If a motion is
refused, a path is searched for again, for much longer than a user would wait.
"""

import numpy as np
import pytest

from ikservo.errors import CollisionError
from ikservo.planning import preflight_planner, ways_around
from ikservo.planning.motions import MovePose
from tests.apps.teaching.test_contact_at_start import (
    distances_m,
    measured_joints,
    open_limp,
    set_down,
)
from tests.arm.seeds import few_or_many, log

# Motions of which one search looks at most, more than a minute's, and from how many exits.
LONG, EXITS = 600_000, 8


def fall(arm, seed):
    """Drop a limp arm in a random posture that touches nothing."""
    lower, upper = arm.limits()
    postures = np.random.default_rng(1000 + seed).uniform(lower, upper, (500, len(lower)))
    joints = next(q for q in postures if distances_m(arm, q).min() > 0.0)
    set_down(arm, dict(zip(arm.joint_names, np.degrees(joints), strict=True)))


def refusal(arm, pose):
    """Return why a pose is refused; None if there is a path, which is checked."""
    try:
        plan = arm.plan(MovePose(pose))
    except CollisionError as error:
        return error
    lying_m = np.minimum(distances_m(arm, plan.start), 0.0)
    for joints in plan.sample(0.02).positions:
        assert (distances_m(arm, joints) >= lying_m - 0.0015).all()
    return None


@pytest.mark.sample(1)
@pytest.mark.full
@few_or_many(2, 100)
@pytest.mark.parametrize("name", ["so101", "koch", "open_manipulator_x", "wx250s"])
def test_folded_arm_finds_path_or_error_names_colliding_links(monkeypatch, capsys, name, seeds):
    refused, found_later, touching = 0, [], 0
    for seed in seeds:
        with open_limp(name) as arm:
            fall(arm, seed)
            touching += distances_m(arm, measured_joints(arm)).min() < 0.0
            for pose in ("rest", "home"):
                error = refusal(arm, pose)
                if error is None:
                    continue
                refused += 1
                assert all(thing in str(error) for thing in error.pair)
                with monkeypatch.context() as patient:
                    margins = ((0.01, LONG), (0.003, LONG), (0.0005, LONG))
                    patient.setattr(ways_around, "_MARGINS_M", margins)
                    patient.setattr(preflight_planner, "_EXITS", EXITS)
                    if refusal(arm, pose) is None:
                        found_later.append((seed, pose))
    log(capsys, f"{name}: {len(seeds)} postures, {touching} touch something, {refused} refused")
    assert not found_later
