"""The reach of a joint's motion: bounds that can be added up by hand."""

import math

import numpy as np
import pytest

from ikservo.kinematics import Chain, JointType, Mimic
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.collision_body import LinkTravelBounds
from tests.guard.test_collision_kernel import every_kind_of_joint
from tests.kinematics.chains import joint, planar


def capsule(link, *ends_m):
    start, end = (np.array([x, 0.0, 0.0]) for x in ends_m)
    return Capsule(link, start, end, 0.05)


def test_motion_bound_is_sum_of_link_lengths_from_axis():
    reach = LinkTravelBounds(
        planar(0.3, 0.2), [capsule("l2", 0.1, -0.25), capsule("l2", 0.0, 0.15)]
    )
    np.testing.assert_allclose(reach.bound_of("l2"), [0.3 + 0.25, 0.25])
    np.testing.assert_allclose(reach.bound_of("tip"), [0.3 + 0.2, 0.2])


def test_relative_motion_bound_counts_only_joints_between_links():
    chain = planar(0.3, 0.2, 0.1)
    reach = LinkTravelBounds(
        chain, [capsule(f"l{i}", 0.0, 0.1 * max(i, 5 - 5 * i)) for i in range(4)]
    )
    np.testing.assert_allclose(reach.relative_bound("l1", "l3"), [0.0, 0.3, 0.3])
    np.testing.assert_allclose(reach.relative_bound("l3", "l1"), reach.relative_bound("l1", "l3"))
    np.testing.assert_allclose(reach.relative_bound("l0", "l1"), [0.1, 0.0, 0.0])


def rail(multiplier=-0.5, shift=0.1, **limits):
    """Return a turning post, a slide on it and a second slide that follows the first."""
    joints = [
        joint("turn", JointType.REVOLUTE, "base", "post"),
        joint("slide", JointType.PRISMATIC, "post", "cart", (0, 0, 0.5), (1, 0, 0), **limits),
        joint("more", JointType.PRISMATIC, "cart", "tip", (0, 0.2, 0), (1, 0, 0),
              mimic=Mimic("slide", multiplier, shift)),
    ]  # fmt: skip
    return Chain.from_joints(joints, "base", "tip")


def test_prismatic_motion_bound_adds_share_of_its_mimic():
    reach = LinkTravelBounds(rail(lower=-0.3, upper=0.2), [capsule("tip", 0.0, 0.0)])
    assert reach.bound_of("cart")[1] == pytest.approx(1.0)
    assert reach.bound_of("tip")[1] == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("limits", "slide_m", "more_m"),
    [((-0.3, 0.2), 0.3, 0.25), ((-0.1, 0.4), 0.4, 0.15), ((0.1, 0.5), 0.5, 0.15)],
)
def test_motion_bound_includes_prismatic_travel(limits, slide_m, more_m):
    reach = LinkTravelBounds(rail(lower=limits[0], upper=limits[1]), [capsule("tip", 0.0, 0.07)])
    assert reach.bound_of("tip")[0] == pytest.approx(0.07 + 0.2 + more_m + 0.5 + slide_m)


def test_motion_bound_uses_position_of_fixed_prismatic_joint():
    joints = [
        joint("turn", JointType.REVOLUTE, "base", "hand"),
        joint("jaw", JointType.PRISMATIC, "hand", "finger", (0.1, 0, 0), (0, 1, 0),
              lower=-0.04, upper=-0.03),
    ]  # fmt: skip
    reach = LinkTravelBounds(
        Chain.from_joints(joints, "base", "hand"), [capsule("finger", 0.0, 0.01)]
    )
    np.testing.assert_allclose(reach.bound_of("finger"), [0.01 + 0.03 + 0.1])


def test_link_motion_never_exceeds_computed_bound():
    chain = rail(lower=-0.3, upper=0.2)
    reach = LinkTravelBounds(chain, [capsule("tip", -0.05, 0.07)]).bound_of("tip")
    rng, at = np.random.default_rng(3), (0.07, 0.0, 0.0)
    for slide_m in rng.uniform(-0.3, 0.2, 20):
        J = chain.jacobian([rng.uniform(-math.pi, math.pi), slide_m], "tip", at)[:3]
        assert (np.linalg.norm(J, axis=0) <= reach + 1e-12).all()


def test_relative_motion_bound_uses_link_that_moves_less():
    chain = planar(0.3, 0.2, 0.1)
    reach = LinkTravelBounds(chain, [capsule("l0", 0.0, 0.02), capsule("l3", 0.0, 0.4)])
    np.testing.assert_allclose(reach.relative_bound("l0", "l3")[:2], [0.02, 0.32])


def test_collision_distance_never_changes_faster_than_bound():
    body, rng = every_kind_of_joint(), np.random.default_rng(4)
    reach = body.pack().pair_reach_m
    q = rng.uniform(body.chain.lower_rad, body.chain.upper_rad, (500, body.chain.dof))
    step = 1e-3 * rng.uniform(-1.0, 1.0, q.shape)
    change_m = body.link_distances(q + step).gap_m - body.link_distances(q).gap_m
    assert (np.abs(change_m) <= np.abs(step) @ reach.T + 1e-9).all()
