"""Targets of compliant arms: the sagging tip reaches them, and no joint leaves its limits."""

import numpy as np
import pytest

from ikservo.ik import Solver, Target, solve
from ikservo.ik.sight import solve_sight
from tests.kinematics.test_bending import bent_chain, random_joints


@pytest.fixture(params=["so101", "koch"])
def chain(request):
    return bent_chain(request.param, half_play=0.003)


def test_sag_aware_solution_puts_sagging_tip_on_target(chain):
    for q in random_joints(chain, 20):
        T = chain.forward(0.8 * q)
        result = solve(chain, Target(T[:3, 3]), 0.7 * q)
        assert result.reached
        np.testing.assert_allclose(chain.forward(result.q)[:3, 3], T[:3, 3], atol=2e-6)
        np.testing.assert_allclose(result.nearest_m, T[:3, 3], atol=2e-6)
        assert (result.q >= chain.lower_rad).all()
        assert (result.q <= chain.upper_rad).all()


def test_sag_aware_solution_gives_sagging_tool_right_direction(chain):
    for q in random_joints(chain, 10):
        T = chain.forward(0.7 * q)
        result = solve(chain, Target(T[:3, 3], direction=T[:3, 2]), 0.6 * q)
        assert result.reached
        np.testing.assert_allclose(chain.forward(result.q)[:3, 2], T[:3, 2], atol=1e-3)


def test_sag_aware_solver_tracks_a_line(chain):
    solver, q = Solver(chain), chain.mid_range()
    start = chain.forward(q)
    for k in range(1, 30):
        T = start.copy()
        T[:3, 3] += [-0.001 * k, 0.0005 * k, 0.0]
        q, reached = solver.track(T, q)
        assert reached
        np.testing.assert_allclose(chain.forward(q)[:3, 3], T[:3, 3], atol=2e-6)
        np.testing.assert_allclose(solver.result.nearest_m, T[:3, 3], atol=2e-6)


def test_sag_aware_solution_out_of_reach_is_nearest_point(chain):
    result = solve(chain, Target((1.0, 0.0, 0.1)))
    assert not result.reached
    np.testing.assert_allclose(chain.forward(result.q)[:3, 3], result.nearest_m, atol=1e-6)


def test_sag_aware_look_at_points_sagging_axis_at_point(chain):
    sight = solve_sight(chain, (0.3, 0.1, 0.0), chain.mid_range(), (0.0, 0.0, 1.0))
    assert not sight.reached or sight.error_rad < 1e-3
    assert sight.error_rad < 0.1
