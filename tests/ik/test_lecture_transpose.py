"""The Jacobian transpose: virtual work, best step length, monotonic descent (L11)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ikservo.ik import Target
from ikservo.ik.jacobian_methods import ResidualFunction, gradient_torque, step_length
from tests.ik.lecture import DOWNHILL, arm, costs, joints, questions, walk
from tests.kinematics.chains import planar

numbers = st.floats(-3, 3)


@pytest.mark.sample(1)
@pytest.mark.parametrize("method", DOWNHILL)
@settings(max_examples=30, deadline=None)
@given(question=questions())
def test_transpose_method_error_never_increases(method, question):
    chain, target, q0 = question
    left = costs(chain, target, walk(method, chain, target, q0, max_iterations=40).trace)
    assert (np.diff(left) <= 1e-15).all()


@settings(max_examples=50, deadline=None)
@given(
    joints(arm("planar")), st.tuples(numbers, numbers, numbers), arrays(float, 3, elements=numbers)
)
def test_transpose_torques_do_same_virtual_work_as_force(q, towards, motion):
    chain = planar(0.3, 0.2, 0.1)
    here = ResidualFunction(chain, Target(towards)).linearise(q)
    assert gradient_torque(here, chain) @ motion == pytest.approx(
        here.E @ (here.J @ motion), abs=1e-9
    )


@given(arrays(float, (3, 4), elements=numbers), arrays(float, 3, elements=numbers),
       st.floats(-1, 1))  # fmt: skip
def test_transpose_step_length_minimises_linearised_error(J, E, off):
    tau = J.T @ E
    alpha = step_length(J, E, tau)
    best = np.linalg.norm(E - alpha * J @ tau)
    assert best <= np.linalg.norm(E - (alpha + off) * J @ tau) + 1e-9


def test_transpose_step_length_without_effect_on_tip_is_zero():
    assert step_length(np.zeros((3, 2)), np.ones(3), np.zeros(2)) == 0.0


def test_transpose_step_keeps_joint_pushed_against_its_limit():
    chain = planar(0.3, 0.2).with_limits([-1.0, 0.5], [1.0, 2.0])
    here = ResidualFunction(chain, Target((0.5, 0.0, 0.0))).linearise(np.array([-0.2, 0.5]))
    assert (here.J.T @ here.E)[1] < 0
    assert gradient_torque(here, chain)[1] == 0.0


def test_transpose_step_moves_joint_away_from_its_limit():
    chain = planar(0.3, 0.2).with_limits([-1.0, 0.5], [1.0, 2.0])
    here = ResidualFunction(chain, Target((0.1, 0.1, 0.0))).linearise(np.array([-0.2, 0.5]))
    assert gradient_torque(here, chain)[1] > 0.0


def test_transpose_first_step_follows_negative_gradient():
    chain, q = planar(0.3, 0.2, 0.1), np.array([0.3, 0.5, 0.4])
    target = Target((0.2, 0.45, 0.0))
    first = walk("transpose", chain, target, q, max_iterations=1).trace[1] - q
    h = 1e-6
    down = [costs(chain, target, [q - h * unit, q + h * unit]) @ (1, -1) for unit in np.eye(3)]
    np.testing.assert_allclose(
        first / np.linalg.norm(first), down / np.linalg.norm(down), atol=1e-6
    )
