"""The bounded solver: always inside the limits, with a true report of its error."""

import gc
import math
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ikservo.errors import BadValueError, UnknownNameError
from ikservo.ik import Solver, Target, solve
from tests.kinematics.chains import crane, planar

ARM = planar(0.3, 0.2, 0.1, limit_rad=2.5)
inside = st.floats(-2.5, 2.5)


@settings(max_examples=60, deadline=None)
@given(inside, inside, inside)
def test_solve_reaches_every_reachable_point(a, b, c):
    target = ARM.forward([a, b, c])[:3, 3]
    result = solve(ARM, Target(target))
    assert result.reached
    assert np.linalg.norm(ARM.forward(result.q)[:3, 3] - target) <= 1e-5


@settings(max_examples=60, deadline=None)
@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1))
def test_solution_is_always_inside_joint_limits(x, y, z):
    result = solve(ARM, Target((x, y, z)), restarts=4)
    assert (result.q >= ARM.lower_rad).all()
    assert (result.q <= ARM.upper_rad).all()


@settings(max_examples=40, deadline=None)
@given(st.floats(-1, 1), st.floats(-1, 1))
def test_reached_flag_agrees_with_forward_kinematics(x, y):
    result = solve(ARM, Target((x, y, 0.0)), restarts=4)
    error_m = float(np.linalg.norm(ARM.forward(result.q)[:3, 3] - (x, y, 0.0)))
    assert result.position_error_m == pytest.approx(error_m, abs=1e-12)
    assert result.reached == (error_m <= 1e-5)


def test_nearest_point_of_target_out_of_reach_is_on_circle():
    result = solve(ARM, Target((3.0, 4.0, 0.0)))
    assert not result.reached
    np.testing.assert_allclose(result.nearest_m, [0.36, 0.48, 0.0], atol=1e-6)
    assert result.position_error_m == pytest.approx(5.0 - 0.6)


def test_ik_result_names_limit_that_prevents_reaching():
    arm = planar(0.3, 0.2).with_limits([-math.pi, 0.5], [math.pi, 2.0])
    result = solve(arm, Target((0.5, 0.0, 0.0)))
    assert [str(b) for b in result.binding] == ["j2 at its lower limit"]


def test_nearest_point_at_limit_equals_dense_search():
    arm = planar(0.3, 0.2).with_limits([-0.4, 0.2], [0.9, 1.3])
    target = np.array([0.1, -0.3, 0.0])
    result = solve(arm, Target(target))
    grid = [arm.forward([a, b])[:3, 3] for a in np.linspace(-0.4, 0.9, 120)
            for b in np.linspace(0.2, 1.3, 120)]  # fmt: skip
    densest = min(float(np.linalg.norm(p - target)) for p in grid)
    assert result.position_error_m <= densest
    assert result.position_error_m == pytest.approx(densest, abs=1e-3)


def test_ik_start_outside_limits_is_accepted():
    result = solve(ARM, Target((0.4, 0.1, 0.0)), q0=[3.0, -3.0, 9.0])
    assert result.reached
    assert (np.abs(result.q) <= 2.5).all()


def test_ik_solution_near_start_is_preferred():
    up, down = planar(0.3, 0.2), Target((0.3, 0.1, 0.0))
    assert solve(up, down, q0=[0.5, -1.0]).q[1] < 0 < solve(up, down, q0=[-0.5, 1.0]).q[1]


def test_same_ik_problem_gives_same_solution():
    first, second = (solve(ARM, Target((0.2, -0.1, 0.0))) for _ in range(2))
    np.testing.assert_array_equal(first.q, second.q)


def test_solve_finds_position_of_prismatic_joint():
    result = solve(crane(), Target(crane().forward([1.1, 0.22])[:3, 3]))
    np.testing.assert_allclose(result.q, [1.1, 0.22], atol=1e-6)


def test_solve_reaches_with_point_of_any_link():
    wanted = ARM.forward([0.3, 0.8, 0.0], "l2", (0.15, 0.02, 0))[:3, 3]
    result = solve(ARM, Target(wanted, frame="l2", offset_m=(0.15, 0.02, 0)))
    assert result.reached
    np.testing.assert_allclose(ARM.forward(result.q, "l2", (0.15, 0.02, 0))[:3, 3], wanted,
                               atol=1e-5)  # fmt: skip


def test_direction_is_reached_by_arm_with_enough_joints():
    wanted = ARM.forward([0.4, -0.9, 1.3])
    result = solve(ARM, Target(wanted[:3, 3], direction=wanted[:3, 0], tool_axis=(1, 0, 0)))
    assert result.reached
    np.testing.assert_allclose(ARM.forward(result.q), wanted, atol=1e-4)


def test_unreachable_direction_does_not_increase_position_error():
    result = solve(ARM, Target((0.35, 0.1, 0.0), direction=(0, 0, 1), tool_axis=(1, 0, 0)))
    assert not result.reached
    assert result.position_error_m < 1e-5
    assert result.orientation_error_rad == pytest.approx(math.pi / 2, abs=1e-3)


@pytest.mark.parametrize("q0", [[0, 0], [0, 0, math.nan], "abc"])
def test_invalid_ik_start_is_refused(q0):
    with pytest.raises(BadValueError, match="q0"):
        solve(ARM, Target((0.3, 0, 0)), q0=q0)


def test_unknown_ik_method_error_lists_known_methods():
    with pytest.raises(UnknownNameError, match="Known: auto, bounded"):
        solve(ARM, Target((0.3, 0, 0)), method="magic")


def test_ik_solver_follows_line_without_jumps():
    solver, largest = Solver(ARM), 0.0
    q = solve(ARM, Target((0.35, 0.1, 0.0))).q
    for y in np.linspace(0.1, 0.3, 50):
        T = np.eye(4)
        T[:3, 3] = (0.35, y, 0.0)
        after, reached = solver(T, q)
        assert reached
        largest, q = max(largest, float(np.abs(after - q).max())), after
    assert largest < 0.05


def test_kinematic_chain_no_longer_used_is_freed():
    chain = ARM.with_limits(ARM.lower_rad / 2, ARM.upper_rad / 2)
    solve(chain, Target([0.3, 0.2, 0.0]), method="bounded")
    known = weakref.ref(chain)
    del chain
    gc.collect()
    assert known() is None


def test_ik_option_of_wrong_type_is_refused_even_if_equal():
    arm, target = planar(0.3, 0.2), Target((0.3, 0.2, 0.0))
    assert solve(arm, target, track=True).reached == solve(arm, target, track=True).reached
    with pytest.raises(BadValueError, match="track"):
        solve(arm, target, track=1)
    with pytest.raises(BadValueError, match="restarts"):
        solve(arm, target, restarts=[400])


def test_ik_result_is_not_changed_by_next_solve():
    arm, start = planar(0.3, 0.2), np.array([0.3, 0.5])
    first = solve(arm, Target((0.3, 0.2, 0.0)), start)
    q, point = first.q.copy(), first.nearest_m.copy()
    solve(arm, Target((0.1, -0.3, 0.0)), start)
    np.testing.assert_array_equal(first.q, q)
    np.testing.assert_array_equal(first.nearest_m, point)


def test_threads_solving_at_once_get_same_solutions():
    arm, angles = crane(), np.linspace(-0.6, 0.6, 200)
    targets = [Target((0.3 * math.cos(a), 0.3 * math.sin(a), 0.1)) for a in angles]
    alone = [solve(arm, target).q.tolist() for target in targets]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda target: solve(arm, target).q.tolist(), targets))
    assert together == alone
