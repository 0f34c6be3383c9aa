"""Properties of all methods of the lecture: small steps, limits, true reports (L5, L7, L9)."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ikservo.ik import Options, Target, Tolerance, solve
from ikservo.ik.jacobian_methods import scale_step
from ikservo.ik.solve import get_method
from ikservo.model import arm_names, load_model
from tests.ik.lecture import LECTURE, arm, near, questions, target_at, walk
from tests.kinematics.chains import crane, planar

EACH = pytest.mark.parametrize("method", LECTURE)
TWO_DEGREES = math.radians(2.0)


@pytest.mark.sample(1)
@EACH
@settings(max_examples=25, deadline=None)
@given(question=questions())
def test_iterative_solvers_never_leave_joint_limits(method, question):
    chain, target, q0 = question
    result = walk(method, chain, target, q0, max_iterations=40)
    for q in (*result.trace, result.q):
        assert (q >= chain.lower_rad).all()
        assert (q <= chain.upper_rad).all()


@pytest.mark.parametrize(
    ("method", "cap_deg"), [("pseudo_inverse", 2.0), ("transpose", 2.0), ("ccd", 5.0)]
)
@settings(max_examples=15, deadline=None)
@given(question=questions())
def test_solver_step_per_iteration_is_capped_in_every_joint(method, cap_deg, question):
    trace = np.array(walk(method, *question, max_iterations=30).trace)
    assert np.abs(np.diff(trace, axis=0)).max(initial=0.0) <= math.radians(cap_deg) + 1e-12


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=7).map(np.array))
def test_solver_step_is_scaled_down_to_2_degrees(step):
    scaled = scale_step(step)
    assert np.abs(scaled).max() <= TWO_DEGREES * (1 + 1e-15)
    np.testing.assert_allclose(scaled * np.abs(step).max(), step * np.abs(scaled).max())


def test_solver_step_below_2_degrees_is_not_scaled():
    step = np.array([0.01, -0.02])
    assert scale_step(step) is step


@EACH
@pytest.mark.parametrize("name", arm_names())
def test_iterative_solvers_reach_point_near_home_of_every_arm(method, name):
    model = load_model(name)
    home = model.chain_pose("home")
    target = Target(model.chain.forward(near(model.chain, home, 0.3))[:3, 3])
    result = walk(method, model.chain, target, home)
    assert result.reached
    tip = model.chain.forward(result.q)[:3, 3]
    assert float(np.linalg.norm(tip - target.position)) <= 1e-5


@EACH
@pytest.mark.parametrize("kind", ["direction", "pose"])
@pytest.mark.parametrize("name", ["planar", "wx250s"])
def test_iterative_solvers_reach_direction_or_orientation(method, kind, name):
    chain = arm(name)
    start = chain.clip(np.full(chain.dof, 0.4))
    T = chain.forward(near(chain, start, 0.15))
    result = walk(method, chain, target_at(T, kind), start, tolerance=Tolerance(1e-3, 1e-2))
    assert result.reached
    assert result.orientation_error_rad <= 1e-2


@EACH
def test_iterative_solvers_handle_prismatic_and_mimic_joints(method):
    target = Target(crane().forward([1.1, 0.35])[:3, 3])
    result = walk(method, crane(), target, [-0.5, 0.05])
    np.testing.assert_allclose(result.q, [1.1, 0.35], atol=1e-4)


@EACH
def test_iterative_solvers_reach_with_point_of_any_link(method):
    chain = planar(0.3, 0.2, 0.1)
    target = Target((0.25, 0.3, 0.02), frame="l2", offset_m=(0.15, 0.03, 0.02))
    result = walk(method, chain, target, [0.1, 0.2, 0.3])
    assert result.reached
    np.testing.assert_allclose(result.nearest_m, target.position, atol=1e-5)


@EACH
def test_iterative_solvers_keep_joints_beyond_target_link(method):
    target = Target((0.25, 0.2, 0.0), frame="l2", offset_m=(0.15, 0.0, 0.0))
    assert walk(method, planar(0.3, 0.2, 0.1), target, [0.1, 0.2, 0.3]).q[2] == 0.3


@EACH
def test_iterative_solvers_stretch_to_unreachable_target(method):
    result = walk(method, planar(0.3, 0.2, 0.1), Target((3.0, 4.0, 0.0)), [0.5, 0.5, 0.5])
    assert not result.reached
    np.testing.assert_allclose(result.nearest_m, [0.36, 0.48, 0.0], atol=3e-3)
    assert result.position_error_m == pytest.approx(4.4, abs=1e-4)


@EACH
def test_ik_result_names_limit_that_prevents_reaching(method):
    chain = planar(0.3, 0.2).with_limits([-math.pi, 0.5], [math.pi, 2.0])
    result = walk(method, chain, Target((0.5, 0.0, 0.0)), [0.0, 1.0])
    assert [str(limit) for limit in result.binding] == ["j2 at its lower limit"]


@EACH
def test_nearest_point_at_limit_equals_dense_search(method):
    chain = planar(0.3, 0.2).with_limits([-0.4, 0.2], [0.9, 1.3])
    target = np.array([0.35, -0.3, 0.0])
    grid = [chain.forward([a, b])[:3, 3] for a in np.linspace(-0.4, 0.9, 80)
            for b in np.linspace(0.2, 1.3, 80)]  # fmt: skip
    densest = min(float(np.linalg.norm(p - target)) for p in grid)
    result = walk(method, chain, Target(target), [0.3, 0.7])
    assert result.position_error_m == pytest.approx(densest, abs=1e-3)


@EACH
def test_solver_start_outside_limits_is_clipped_first(method):
    chain = planar(0.3, 0.2, 0.1, limit_rad=2.5)
    result = walk(method, chain, Target((0.1, 0.3, 0.0)), [9.0, -3.0, 0.5])
    assert result.trace[0].tolist() == [2.5, -2.5, 0.5]


@EACH
def test_solver_started_at_target_needs_no_iterations(method):
    chain = planar(0.3, 0.2)
    result = walk(method, chain, Target(chain.forward([0.4, 0.8])[:3, 3]), [0.4, 0.8])
    assert result.reached
    assert result.iterations == 0
    assert result.q.tolist() == [0.4, 0.8]


@EACH
def test_solver_trace_has_start_and_every_iteration(method):
    result = walk(method, planar(0.3, 0.2), Target((0.1, 0.3, 0.0)), [0.5, 0.5])
    assert len(result.trace) == result.iterations + 1
    assert result.trace[0].tolist() == [0.5, 0.5]
    assert result.trace[-1].tolist() == result.q.tolist()


@EACH
def test_solver_trace_is_empty_unless_requested(method):
    target = Target((0.1, 0.3, 0.0))
    assert get_method(method)(planar(0.3, 0.2), target, np.array([0.5, 0.5]), Options()).trace == ()


@EACH
def test_max_iterations_option_limits_iterations(method):
    result = walk(method, planar(0.3, 0.2), Target((-0.3, 0.1, 0.0)), [0.5, 0.5], max_iterations=3)
    assert result.iterations == 3
    assert not result.reached


@EACH
def test_coarse_ik_tolerance_needs_fewer_iterations(method):
    question = (planar(0.3, 0.2), Target((0.1, 0.3, 0.0)), [0.5, 0.5])
    coarse = walk(method, *question, tolerance=Tolerance(position_m=0.02))
    assert coarse.reached
    assert coarse.iterations < walk(method, *question).iterations


@EACH
def test_solver_method_is_selected_by_name(method):
    result = solve(planar(0.3, 0.2), Target((0.1, 0.3, 0.0)), [0.5, 0.5], method)
    assert result.method == method
    assert result.reached


@EACH
def test_same_ik_problem_gives_same_trace(method):
    first, second = (
        walk(method, arm("so101"), Target((0.2, 0.1, 0.1)), np.zeros(5)) for _ in range(2)
    )
    assert [q.tolist() for q in first.trace] == [q.tolist() for q in second.trace]
