"""The body of an arm: distances between its parts, compared with sums by hand."""

import numpy as np
import pytest

from ikservo.kinematics import Chain, JointType
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.collision_body import CollisionBody
from tests.kinematics.box_distance import box_distances
from tests.kinematics.chains import joint, planar


def ball(link, radius_m, at_m=(0.0, 0.0, 0.0)):
    return Capsule(link, np.array(at_m), np.array(at_m), radius_m)


def rail(*more, postures=()):
    """Return two slides along x, one on the other: balls of 10 cm and 20 cm, one 1 cm larger."""
    joints = [
        joint("one", JointType.PRISMATIC, "base", "cart", (0, 0, 1.0), (1, 0, 0)),
        joint("weld", JointType.FIXED, "cart", "plate", (0, 0, 0)),
        joint("two", JointType.PRISMATIC, "plate", "tip", (0, 0, 0), (1, 0, 0)),
    ]
    balls = [ball("tip", 0.2), ball("base", 0.1, (0, 0, 1.0)), ball("base", 0.01, (0, 3, 1.0))]
    return CollisionBody(Chain.from_joints(joints, "base", "tip"), [*balls, *more], postures)


Q = np.array([[0.5, 0.5], [2.0, 1.0]])


def test_collision_body_of_adjacent_links_has_no_pairs():
    ends = np.zeros(3), np.array([0.3, 0.0, 0.0])
    body = CollisionBody(planar(0.3, 0.2), [Capsule(link, *ends, 0.02) for link in ("l0", "l1")])
    gaps = body.link_distances(np.zeros((3, 2)))
    assert (gaps.pairs, gaps.gap_m.shape) == ((), (3, 0))


def test_collision_pairs_are_links_more_than_one_joint_apart():
    assert rail(ball("cart", 0.1), ball("plate", 0.1)).pairs == (("base", "tip"),)
    assert CollisionBody(planar(0.3, 0.2, 0.1), [ball(f"l{i}", 0.01) for i in range(4)]).pairs == (
        ("l0", "l2"), ("l0", "l3"), ("l1", "l3"),
    )  # fmt: skip


def test_distance_of_two_balls_is_centre_distance_minus_radii():
    gaps = rail().link_distances(Q)
    np.testing.assert_allclose(gaps.gap_m, [[1.0 - 0.3], [3.0 - 0.3]])


def test_distance_of_link_is_that_of_its_nearest_ball():
    near = rail(ball("base", 0.05, (0.6, 0, 1.0)))
    np.testing.assert_allclose(near.link_distances(Q).gap_m, [[0.4 - 0.25], [2.4 - 0.25]])


def test_overlap_of_known_free_posture_adds_4_mm_allowance():
    free = [[0.1, 0.15], [0.9, 0.9]]
    np.testing.assert_allclose(
        rail(postures=free).link_distances(Q).gap_m, [[0.7 + 0.054], [2.7 + 0.054]]
    )
    np.testing.assert_allclose(rail(postures=[[0.9, 0.9]]).link_distances(Q).gap_m, [[0.7], [2.7]])


def test_floor_distance_is_measured_from_lowest_point():
    gaps = rail().floor_distances(Q, 0.25)
    assert gaps.pairs == (("tip", "the table"),)
    np.testing.assert_allclose(gaps.gap_m, [[1.0 - 0.2 - 0.25]] * 2)


def test_box_distance_is_measured_from_box_surface():
    gaps = box_distances(rail(), Q, np.array([1.5, -1, 0]), np.array([2.5, 1, 2]), "the crate")
    assert gaps.pairs == (("tip", "the crate"),)
    np.testing.assert_allclose(gaps.gap_m, [[0.5 - 0.2], [0.5 - 0.2]], atol=1e-9)


@pytest.mark.parametrize("postures", [(), [[0.1, 0.15]]])
def test_packed_collision_body_lists_capsules_of_each_pair(postures):
    chain = planar(0.3, 0.2, 0.1)
    capsules = [ball("l0", 0.1), ball("l2", 0.2), ball("l3", 0.3), ball("l2", 0.4), ball("l1", 0.5)]
    packed = CollisionBody(chain, capsules).pack()
    radii = packed.capsules[:, 6]
    found = [
        (packed.pairs[int(pair)], radii[int(one)], radii[int(other)])
        for one, other, pair in packed.rows
    ]
    assert found == [
        (("l0", "l2"), 0.1, 0.2), (("l0", "l2"), 0.1, 0.4), (("l0", "l3"), 0.1, 0.3),
        (("l1", "l3"), 0.5, 0.3),
    ]  # fmt: skip
    assert (packed.base, packed.dof, packed.names) == ("l0", 3, chain.frames)
    np.testing.assert_allclose(rail(postures=postures).pack().overlap_m,
                               [0.054] if postures else [0.0])  # fmt: skip
    assert packed.reach_m.shape == (len(packed.names), 3)
    assert packed.pair_reach_m.shape == (3, 3)
