"""Yaw and roll that bring a point and a direction into the arm's plane."""

import math

import numpy as np
import pytest

from ikservo.ik.subproblems import CircleTrace, refine_angle_pair, solve_yaw_roll


def across(a0, a1, a2):
    return CircleTrace(0j, 0j, 0j, a0, a1, a2)


def circles(seed):
    """Return four circles and a pair of angles (φ, ψ) at which they agree."""
    rng = np.random.default_rng(seed)
    phi, psi = rng.uniform(-math.pi, math.pi, 2)
    M, d, w, a = (across(0.0, *rng.uniform(-1.0, 1.0, 2)) for _ in range(4))
    w = across(M.normal_part(phi) - w.normal_part(psi), w.a1, w.a2)
    a = across(d.normal_part(phi) - a.normal_part(psi), a.a1, a.a2)
    return (M, w, d, a), (phi, psi)


@pytest.mark.parametrize("seed", range(20))
def test_yaw_and_roll_solver_finds_known_angle_pair(seed):
    orbits, hidden = circles(seed)
    found = list(solve_yaw_roll(*orbits, (0.0, 0.0)))
    assert any(
        all(abs(math.remainder(a - b, math.tau)) < 1e-6 for a, b in zip(pair, hidden, strict=True))
        for pair in found
    )


@pytest.mark.parametrize("seed", range(20))
def test_yaw_and_roll_solutions_satisfy_both_equations(seed):
    (M, w, d, a), _ = circles(seed)
    for phi, psi in solve_yaw_roll(M, w, d, a, (0.0, 0.0)):
        assert abs(M.normal_part(phi) - w.normal_part(psi)) < 1e-10
        assert abs(d.normal_part(phi) - a.normal_part(psi)) < 1e-10


@pytest.mark.parametrize("seed", range(20))
def test_yaw_and_roll_refinement_converges_to_known_pair(seed):
    orbits, (phi, psi) = circles(seed)
    pair = refine_angle_pair(*orbits, phi + 1e-4, psi - 2e-4)
    assert pair is not None
    np.testing.assert_allclose(pair, (phi, psi), atol=1e-8)


def test_yaw_and_roll_refinement_without_near_root_returns_none():
    orbits = across(0.0, 0.1, 0.0), across(5.0, 0.0, 0.1), across(0, 1, 0), across(0, 0, 1)
    assert refine_angle_pair(*orbits, 0.3, 0.4) is None
