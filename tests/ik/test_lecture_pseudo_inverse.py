"""The pseudo-inverse: Moore-Penrose, the active set of limits, the null space (L8, L9, L10)."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ikservo.errors import BadValueError
from ikservo.ik import Posture, Target
from ikservo.ik.jacobian_methods import (
    EPSILON,
    ResidualFunction,
    limited_step,
    nullspace_step,
    pinv,
)
from tests.ik.lecture import arm, joints, walk
from tests.kinematics.chains import planar

# Small whole numbers make singular and rectangular matrices often, and never nearly singular ones.
matrices = st.tuples(st.integers(1, 6), st.integers(1, 7)).flatmap(
    lambda shape: arrays(np.float64, shape, elements=st.integers(-3, 3).map(float))
)
whole = st.integers(-3, 3).map(float)
EXACT = 1e-9


def is_clear(J):
    """Return whether every singular value is either zero or well above the threshold."""
    s = np.linalg.svd(J, compute_uv=False)
    return not ((s > 1e-12) & (s <= 2 * EPSILON * s.max(initial=0.0))).any()


clear_matrices = matrices.filter(is_clear)


@given(matrices)
def test_pseudo_inverse_satisfies_j_jplus_j_equals_j(J):
    np.testing.assert_allclose(J @ pinv(J, EXACT) @ J, J, atol=1e-9)


@given(matrices)
def test_pseudo_inverse_satisfies_jplus_j_jplus_equals_jplus(J):
    J_plus = pinv(J, EXACT)
    np.testing.assert_allclose(J_plus @ J @ J_plus, J_plus, atol=1e-9)


@given(matrices)
def test_pseudo_inverse_products_are_symmetric(J):
    J_plus = pinv(J, EXACT)
    np.testing.assert_allclose(J @ J_plus, (J @ J_plus).T, atol=1e-9)
    np.testing.assert_allclose(J_plus @ J, (J_plus @ J).T, atol=1e-9)


@given(matrices, st.data())
def test_pseudo_inverse_leaves_only_irreducible_error(J, data):
    E = data.draw(arrays(np.float64, J.shape[0], elements=whole))
    left = E - J @ (pinv(J, EXACT) @ E)
    np.testing.assert_allclose(J.T @ left, 0.0, atol=1e-9)


@given(matrices, st.data())
def test_pseudo_inverse_step_is_shortest_of_equal_effect(J, data):
    E = data.draw(arrays(np.float64, J.shape[0], elements=whole))
    other = data.draw(arrays(np.float64, J.shape[1], elements=whole))
    step = pinv(J, EXACT) @ E
    idle = other - pinv(J, EXACT) @ (J @ other)
    assert np.linalg.norm(step + idle) >= np.linalg.norm(step) - 1e-9


def test_pseudo_inverse_drops_singular_values_below_epsilon():
    np.testing.assert_allclose(pinv(np.diag([2.0, 1e-3]), 1e-2), np.diag([0.5, 0.0]))
    np.testing.assert_allclose(pinv(np.diag([2.0, 1e-1]), 1e-2), np.diag([0.5, 10.0]))


def test_pseudo_inverse_of_zero_matrix_is_zero():
    assert not pinv(np.zeros((3, 2))).any()


def test_stretched_arm_pulled_outwards_does_not_move():
    chain = planar(0.3, 0.2)
    here = ResidualFunction(chain, Target((9.0, 0.0, 0.0))).linearise(np.zeros(2))
    np.testing.assert_allclose(limited_step(here, chain, np.zeros(2)), 0.0, atol=1e-15)


def test_short_pseudo_inverse_step_solves_linearised_problem():
    chain, q = planar(0.3, 0.2, 0.1), np.array([0.3, 0.5, 0.4])
    here = ResidualFunction(chain, Target(chain.forward(q)[:3, 3] + (1e-4, -2e-4, 0.0))).linearise(
        q
    )
    np.testing.assert_allclose(here.J @ limited_step(here, chain, np.zeros(3)), here.E, atol=1e-12)


def test_other_joints_compensate_for_joint_at_its_limit():
    q = np.array([0.3, 0.5, 0.4])
    chain = planar(0.3, 0.2, 0.1).with_limits([0.3, -1.0, -1.0], [2.0, 1.0, 1.0])
    here = ResidualFunction(chain, Target(chain.forward(q)[:3, 3] + (1e-4, -2e-4, 0.0))).linearise(
        q
    )
    step = limited_step(here, chain, np.zeros(3))
    assert step[0] == 0.0
    np.testing.assert_allclose(here.J @ step, here.E, atol=1e-12)


def test_pseudo_inverse_step_of_joint_ends_exactly_at_limit():
    q = np.array([0.3, 0.5, 0.4])
    chain = planar(0.3, 0.2, 0.1).with_limits([0.2999, -1.0, -1.0], [2.0, 1.0, 1.0])
    here = ResidualFunction(chain, Target(chain.forward(q)[:3, 3] + (1e-4, -2e-4, 0.0))).linearise(
        q
    )
    step = limited_step(here, chain, np.zeros(3))
    assert q[0] + step[0] == pytest.approx(0.2999, abs=1e-15)
    np.testing.assert_allclose(here.J @ step, here.E, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(
    joints(arm("narrow")), st.tuples(*[st.floats(-1, 1)] * 3), st.tuples(*[st.floats(-1, 1)] * 3)
)
def test_pseudo_inverse_step_never_exceeds_joint_limit(q, towards, C):
    chain = arm("narrow")
    step = limited_step(ResidualFunction(chain, Target(towards)).linearise(q), chain, np.array(C))
    assert (q + step >= chain.lower_rad - 1e-15).all()
    assert (q + step <= chain.upper_rad + 1e-15).all()


def test_joint_leaves_its_limit_when_target_moves_back():
    chain = planar(0.3, 0.2, 0.1).with_limits([-0.5, 0.0, -0.3], [2.5, 2.5, 0.3])
    result = walk("pseudo_inverse", chain, Target((-0.31, 0.49, 0.0)), [0.5, 0.4, 0.0])
    at_limit = [q[2] in (-0.3, 0.3) for q in result.trace]
    assert result.reached
    assert any(at_limit)
    assert not at_limit[-1]


@given(clear_matrices, st.data())
def test_null_space_step_does_not_move_tip(J, data):
    C = data.draw(arrays(np.float64, J.shape[1], elements=whole))
    np.testing.assert_allclose(J @ nullspace_step(J, np.zeros(J.shape[0]), C), 0.0, atol=1e-9)


@settings(deadline=None)
@given(joints(arm("planar")), arrays(np.float64, 3, elements=whole), st.floats(0.001, 0.05))
def test_null_space_step_moves_tip_only_in_second_order(q, C, size):
    chain = arm("planar")
    J = chain.jacobian(q)[:3]
    assume(np.linalg.svd(J, compute_uv=False)[1] > 0.02)
    step = size * nullspace_step(J, np.zeros(3), C)
    moved_m = np.linalg.norm((chain.forward(q + step) - chain.forward(q))[:3, 3])
    length_m, turned = 0.6, np.abs(step).sum()
    assert moved_m <= 0.5 * length_m * turned**2 + 1e-12  # the rest of Taylor's series


@given(clear_matrices, st.data())
def test_null_space_step_never_moves_away_from_preferred_posture(J, data):
    C = data.draw(arrays(np.float64, J.shape[1], elements=whole))
    assert nullspace_step(J, np.zeros(J.shape[0]), C) @ C <= 1e-9


LONG = planar(0.2, 0.2, 0.2, 0.2)
AHEAD = Target((0.3, 0.3, 0.0))
START = [0.2, 0.6, 0.6, 0.2]


def leaning(weights, preferred=(1.5, -1.0, -1.0, -1.0)):
    return walk("pseudo_inverse", LONG, AHEAD, START, posture=Posture(preferred, weights))


def test_preferred_posture_does_not_prevent_reaching_target():
    assert leaning([1.0, 1.0, 1.0, 1.0]).reached


def test_pseudo_inverse_ends_at_best_posture_in_null_space():
    result = leaning([0.5, 0.5, 0.5, 0.5])
    C = 0.5 * (result.q - (1.5, -1.0, -1.0, -1.0))
    rest = nullspace_step(LONG.jacobian(result.q)[:3], np.zeros(3), C)
    assert np.abs(C).max() > 0.1
    np.testing.assert_allclose(rest, 0.0, atol=1e-6)


def test_joint_with_more_weight_ends_nearer_preferred_angle():
    light, heavy = leaning([0.1, 0.1, 0.1, 0.1]), leaning([0.1, 0.1, 0.1, 1.0])
    assert abs(heavy.q[3] + 1.0) < abs(light.q[3] + 1.0) - 0.1


def test_zero_weights_ignore_preferred_posture():
    plain = walk("pseudo_inverse", LONG, AHEAD, START)
    np.testing.assert_allclose(leaning([0.0] * 4).q, plain.q, atol=1e-4)


def test_preferred_posture_weights_above_one_act_as_one():
    np.testing.assert_allclose(leaning([50.0] * 4).q, leaning([1.0] * 4).q, atol=1e-6)


@pytest.mark.parametrize(
    ("preferred", "weights", "what"),
    [
        ([0.0], [1.0] * 4, "The posture"),
        ([math.nan] * 4, [1.0] * 4, "The posture"),
        ([0.0] * 4, [1.0], "The vector of weights"),
        ([0.0] * 4, [1.0, 1.0, 1.0, -0.1], "A posture's weight is -0.1"),
    ],
)
def test_invalid_preferred_posture_is_refused(preferred, weights, what):
    with pytest.raises(BadValueError, match=what):
        leaning(weights, preferred)
