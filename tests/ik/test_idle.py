"""Joints that do not affect the target stay where they were, with every method."""

import numpy as np
import pytest

from ikservo.ik import METHODS, Solver, Target, solve
from ikservo.ik.batch import solve_batch
from ikservo.ik.prepare import IdleJoint
from ikservo.kinematics.se3 import make_pose
from ikservo.model import load_model

ARMS = ("so101", "koch", "wx250s", "open_manipulator_x")
EVERY = ("auto", *METHODS)


def middle_of(name):
    """Return an arm, the link in the middle of it, and the number of joints that move it."""
    model = load_model(name)
    chain = model.chain
    joint = model.urdf.joints_to(chain.tip)
    moving = [j for j in joint if j.name in chain.names]
    return chain, moving[2].child, 3


def drawn(chain, rng):
    return rng.uniform(chain.lower_rad, chain.upper_rad)


@pytest.mark.sample(8)
@pytest.mark.parametrize("method", EVERY)
@pytest.mark.parametrize("name", ARMS)
def test_every_solver_keeps_joints_beyond_target_frame(name, method):
    chain, frame, count = middle_of(name)
    rng = np.random.default_rng(1)
    for k in range(8):
        q0, wanted = drawn(chain, rng), chain.forward(drawn(chain, rng), frame)[:3, 3]
        away = np.array([0.0, 0.0, 0.4]) if k % 2 else np.zeros(3)
        result = solve(chain, Target(wanted + away, frame=frame), q0, method)
        np.testing.assert_allclose(result.q[count:], q0[count:], atol=1e-12)


@pytest.mark.parametrize("method", EVERY)
def test_joints_beyond_link_stay_still_for_target_on_its_axis(method):
    model = load_model("so101")
    chain, frame, q0 = model.chain, middle_of("so101")[1], model.chain_pose("home")
    T = chain.forward(q0, frame)
    target = Target(T[:3, 3] + 0.03 * T[:3, 2], frame=frame)
    result = solve(chain, target, q0, method)
    np.testing.assert_allclose(result.q[2:], q0[2:], atol=1e-12)


def test_solver_leaves_saddle_and_keeps_joints_beyond_frame():
    chain = load_model("wx250s").chain
    frame, q0 = middle_of("wx250s")[1], np.zeros(6)
    T = chain.forward(q0, frame)
    result = solve(chain, Target(1.5 * T[:3, 3], frame=frame), q0, restarts=1)
    np.testing.assert_array_equal(result.q[3:], q0[3:])


@pytest.mark.parametrize("call", ["call", "track"])
def test_solver_object_keeps_joints_beyond_target_frame(call):
    chain, frame, count = middle_of("wx250s")
    solver, rng = Solver(chain, frame=frame), np.random.default_rng(2)
    for _ in range(20):
        q0, T = drawn(chain, rng), make_pose(chain.forward(drawn(chain, rng), frame)[:3, 3])
        q, _ = solver(T, q0) if call == "call" else solver.track(T, q0)
        np.testing.assert_array_equal(q[count:], q0[count:])
        np.testing.assert_array_equal(solver.result.q, q)


def test_batch_solver_keeps_joints_beyond_target_frame():
    chain, frame, count = middle_of("wx250s")
    rng = np.random.default_rng(3)
    q0s = rng.uniform(chain.lower_rad, chain.upper_rad, (50, chain.dof))
    points = chain.forward(q0s[::-1], frame)[:, :3, 3]
    found = solve_batch(chain, points, q0s, frame=frame)
    np.testing.assert_array_equal(found.q[:, count:], q0s[:, count:])


def test_tool_roll_changes_only_if_full_pose_is_requested():
    chain, rng = load_model("wx250s").chain, np.random.default_rng(4)
    q0, T = drawn(chain, rng), chain.forward(drawn(chain, rng))
    assert solve(chain, Target(T[:3, 3]), q0).q[5] == q0[5]
    pointed = Target(T[:3, 3], direction=T[:3, 0], tool_axis=(1, 0, 0))
    assert solve(chain, pointed, q0).q[5] == q0[5]
    whole = solve(chain, Target(T[:3, 3], orientation=T[:3, :3]), q0)
    assert whole.reached
    assert whole.q[5] != q0[5]


@pytest.mark.parametrize(
    ("start", "stays"), [(1.0, 1.0), (7.0, 7.0 - 2 * np.pi), (-4.0, 2 * np.pi - 4.0)]
)
def test_unused_joint_outside_limits_is_moved_by_full_turn(start, stays):
    assert IdleJoint(0, -3.1, 3.1, 2 * np.pi).resting_position(start) == pytest.approx(stays)


@pytest.mark.parametrize(("start", "stays"), [(4.0, 0.5), (-2.0, -0.5), (0.2, 0.2)])
def test_unused_joint_outside_limits_is_moved_to_limit(start, stays):
    assert IdleJoint(0, -0.5, 0.5, 2 * np.pi).resting_position(start) == stays
    assert IdleJoint(0, -0.5, 0.5, np.inf).resting_position(start) == stays
