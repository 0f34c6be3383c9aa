"""Cyclic coordinate descent: each joint's exact optimum, and no joint that spins (L12)."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ikservo.ik import Target
from ikservo.ik.ccd import MAX_STEP, best_rotation, best_translation, clamp_angle_to_range
from ikservo.ik.jacobian_methods import ResidualFunction
from ikservo.kinematics import Chain, JointType
from ikservo.kinematics.se3 import exp_so3
from tests.ik.lecture import costs, joints, questions, walk
from tests.kinematics.chains import joint, planar

coordinates = st.floats(-1, 1)
vectors = arrays(float, 3, elements=coordinates)
angles = st.floats(-math.pi, math.pi)


@settings(max_examples=80)
@given(vectors, arrays(float, (2, 3), elements=coordinates),
       arrays(float, (2, 3), elements=coordinates), angles)  # fmt: skip
def test_ccd_best_rotation_brings_points_nearest_to_targets(w, x, M, other):
    axis = exp_so3(w) @ (0.0, 0.0, 1.0)

    def left(angle):
        return np.sum((M - x @ exp_so3(angle * axis).T) ** 2)

    turn = best_rotation((M - x).ravel(), np.cross(axis, x).ravel(), axis)
    assert left(turn) <= left(other) + 1e-12


@given(vectors, vectors, st.floats(-5, 5))
def test_ccd_best_translation_brings_tip_nearest_to_target(E, v, other):
    if v @ v < 1e-6:
        return
    assert np.linalg.norm(E - best_translation(E, v) * v) <= np.linalg.norm(E - other * v) + 1e-12


@given(angles, st.floats(0, 3), st.floats(0, 3), st.floats(0, 1))
def test_angle_is_clamped_to_nearest_end_on_circle(requested, below, above, share):
    chosen = clamp_angle_to_range(requested, -below, above)
    other = -below + share * (above + below)
    assert -below <= chosen <= above
    assert math.cos(chosen - requested) >= math.cos(other - requested) - 1e-12


def test_angle_may_be_clamped_across_half_turn():
    assert clamp_angle_to_range(3.1, -2.5, 1.0) == -2.5


@settings(max_examples=40, deadline=None)
@given(questions(["planar", "narrow", "crane", "so101"]), st.floats(-1, 1))
def test_ccd_first_step_of_last_joint_is_optimal(question, share):
    chain, target, q0 = question
    first = walk("ccd", chain, target, q0, max_iterations=1).trace
    moved = q0.copy()
    moved[-1] = first[-1][-1]
    low, high = (
        max(chain.lower_rad[-1], q0[-1] - MAX_STEP),
        min(chain.upper_rad[-1], q0[-1] + MAX_STEP),
    )
    other = q0.copy()
    other[-1] = np.clip(q0[-1] + share * MAX_STEP, low, high)
    left = costs(chain, target, [moved, other])
    assert left[0] <= left[1] + 1e-12


def test_ccd_sweep_turns_last_joint_first():
    chain, q = planar(0.3, 0.2), np.array([0.0, 0.0])
    target = Target((0.3, 0.2 * math.sin(0.05), 0.0))
    swept = walk("ccd", chain, target, q, max_iterations=1).trace[1]
    alone = ResidualFunction(chain, target).linearise(q)
    turn = best_rotation(alone.E, alone.J[:, 1], alone.axes[:, 1])
    assert swept[1] == pytest.approx(min(turn, MAX_STEP))
    assert swept[0] != 0.0


def test_ccd_does_not_turn_roll_joint_through_tip():
    joints_ = [
        joint("turn", JointType.REVOLUTE, "base", "arm", lower=-2.0, upper=2.0),
        joint("roll", JointType.REVOLUTE, "arm", "hand", (0.2, 0, 0), (1, 0, 0),
              lower=-2.0, upper=2.0),
        joint("end", JointType.FIXED, "hand", "tip", (0.1, 0, 0)),
    ]  # fmt: skip
    chain = Chain.from_joints(joints_, "base", "tip")
    result = walk("ccd", chain, Target((0.0, 0.3, 0.0)), [0.123, 0.7])
    assert result.reached
    assert result.q[1] == 0.7


@settings(max_examples=25, deadline=None)
@given(joints(planar(0.3)))
def test_ccd_solves_single_joint_in_one_sweep(q):
    chain = planar(0.3)
    near = chain.clip(q + 0.9 * MAX_STEP)
    assert walk("ccd", chain, Target(chain.forward(near)[:3, 3]), q).iterations <= 1
