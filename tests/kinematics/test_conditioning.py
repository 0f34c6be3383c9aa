"""How freely a posture moves, and how far the next singular one is."""

import math

import numpy as np
import pytest

from ikservo.errors import BadValueError, UnknownNameError
from ikservo.kinematics import conditioning, manipulability, nearest_singularity
from ikservo.model import load_model
from tests.kinematics.chains import crane, planar


def test_a_planar_arm_has_two_ways_to_move_and_its_third_joint_one_to_turn():
    found = conditioning(planar(0.3, 0.2, 0.1), [0.3, 0.8, -0.5])
    assert (len(found.moves_m_rad), len(found.turns_rad_rad)) == (2, 1)


def test_manipulability_is_the_product_of_what_the_linear_rows_can_do():
    chain = load_model("wx250s").chain
    q = load_model("wx250s").chain_pose("home") + 0.3
    J = chain.jacobian(q)
    assert conditioning(chain, q).manipulability == pytest.approx(float(manipulability(J[:3])))


def test_the_slowest_direction_of_two_links_at_right_angles_is_known():
    # J = [[-b, -b], [a, 0]] for lengths a and b with the elbow at 90°
    a, b = 0.3, 0.2
    found = conditioning(planar(a, b), [0.0, math.pi / 2])
    trace, det = a * a + 2 * b * b, (a * b) ** 2
    slowest = math.sqrt(0.5 * (trace - math.sqrt(trace * trace - 4 * det)))
    assert found.slowest_m_rad == pytest.approx(slowest)


def test_stretched_links_have_lost_the_way_outwards():
    assert conditioning(planar(0.3, 0.2), [0.4, 0.0]).slowest_m_rad < 1e-12


def test_without_a_joint_to_spare_nothing_turns_while_the_point_stays():
    found = conditioning(planar(0.3, 0.2), [0.4, 0.6])
    assert found.slowest_rotation_rad_rad == math.inf


def test_units_are_kept_apart_an_arm_twice_as_large_moves_twice_as_far_and_turns_as_well():
    q = [0.3, 0.8, -0.5]
    small, large = conditioning(planar(0.3, 0.2, 0.1), q), conditioning(planar(0.6, 0.4, 0.2), q)
    np.testing.assert_allclose(large.moves_m_rad, 2.0 * small.moves_m_rad)
    np.testing.assert_allclose(large.turns_rad_rad, small.turns_rad_rad)


@pytest.mark.parametrize("elbow_rad", [0.2, 0.9, -0.5])
def test_two_links_are_singular_where_the_elbow_is_straight(elbow_rad):
    found = nearest_singularity(planar(0.3, 0.2), [0.7, elbow_rad])
    assert found is not None
    assert found.distance_rad == pytest.approx(abs(elbow_rad), abs=1e-3)
    assert found.joint == "j2"


def test_a_limit_may_keep_an_arm_from_every_singular_posture():
    chain = planar(0.3, 0.2).with_limits([-1.0, 0.4], [1.0, 2.0])
    assert nearest_singularity(chain, [0.0, 1.0]) is None


@pytest.mark.parametrize("angle_rad", [0.35, -0.6])
def test_a_wrist_of_six_joints_is_singular_where_its_outer_axes_line_up(angle_rad):
    model = load_model("wx250s")
    q = model.chain_pose("home").copy()
    q[1:3] = 0.3, 0.4  # far from every posture in which the point itself is held up
    q[4] = angle_rad
    found = nearest_singularity(model.chain, q, rotation=True)
    assert found is not None
    assert found.joint == model.chain.names[4]
    assert found.distance_rad == pytest.approx(abs(angle_rad), rel=0.02)


@pytest.mark.parametrize("name", ["px100", "open_manipulator_x", "vx300s"])
@pytest.mark.parametrize("turning", [False, True])
def test_what_is_called_singular_is_and_inside_the_limits(name, turning):
    chain = load_model(name).chain
    rng = np.random.default_rng(3)
    for q in rng.uniform(chain.lower_rad, chain.upper_rad, (3, chain.dof)):
        found = nearest_singularity(chain, q, rotation=turning)
        if found is not None:
            there = conditioning(chain, found.q)
            values = [there.slowest_m_rad, there.slowest_rotation_rad_rad if turning else 1.0]
            assert min(values) < 1e-5
            assert np.array_equal(found.q, chain.clip(found.q))


def test_a_point_that_no_joint_moves_has_no_ways_and_no_singular_posture():
    chain = planar(0.3, 0.2)
    assert conditioning(chain, [0.1, 0.2], frame="l0").moves_m_rad.size == 0
    assert nearest_singularity(chain, [0.1, 0.2], frame="l0", rotation=True) is None


def test_a_slide_counts_a_metre_as_a_radian():
    found = conditioning(crane(), [0.0, 0.2])
    assert found.moves_m_rad[0] == pytest.approx(math.hypot(1.0, 0.5))


def test_bad_questions_are_refused():
    chain = planar(0.3, 0.2)
    with pytest.raises(BadValueError):
        conditioning(chain, [0.1])
    with pytest.raises(BadValueError):
        nearest_singularity(chain, [0.1, math.nan])
    with pytest.raises(UnknownNameError):
        conditioning(chain, [0.1, 0.2], frame="hand")
