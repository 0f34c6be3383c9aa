"""Yaw and roll that put a point and a direction across the arm's plane."""

import math

import numpy as np
import pytest

from ikservo.ik.closed_form.orbits import Orbit
from ikservo.ik.closed_form.yaw_and_roll import sharpened, yaw_and_roll


def across(a0, a1, a2):
    return Orbit(0j, 0j, 0j, a0, a1, a2)


def circles(seed):
    """Return four circles and a pair of angles (φ, ψ) at which they agree."""
    rng = np.random.default_rng(seed)
    phi, psi = rng.uniform(-math.pi, math.pi, 2)
    M, d, w, a = (across(0.0, *rng.uniform(-1.0, 1.0, 2)) for _ in range(4))
    w = across(M.across(phi) - w.across(psi), w.a1, w.a2)
    a = across(d.across(phi) - a.across(psi), a.a1, a.a2)
    return (M, w, d, a), (phi, psi)


@pytest.mark.parametrize("seed", range(20))
def test_a_pair_of_angles_that_was_hidden_in_the_circles_is_found(seed):
    orbits, hidden = circles(seed)
    found = list(yaw_and_roll(*orbits, (0.0, 0.0)))
    assert any(
        all(abs(math.remainder(a - b, math.tau)) < 1e-6 for a, b in zip(pair, hidden, strict=True))
        for pair in found
    )


@pytest.mark.parametrize("seed", range(20))
def test_both_equations_hold_for_every_pair(seed):
    (M, w, d, a), _ = circles(seed)
    for phi, psi in yaw_and_roll(M, w, d, a, (0.0, 0.0)):
        assert abs(M.across(phi) - w.across(psi)) < 1e-10
        assert abs(d.across(phi) - a.across(psi)) < 1e-10


@pytest.mark.parametrize("seed", range(20))
def test_newton_steps_lead_back_from_a_hundredth_of_a_degree_aside(seed):
    orbits, (phi, psi) = circles(seed)
    pair = sharpened(*orbits, phi + 1e-4, psi - 2e-4)
    assert pair is not None
    np.testing.assert_allclose(pair, (phi, psi), atol=1e-8)


def test_circles_that_meet_nowhere_near_give_no_pair():
    orbits = across(0.0, 0.1, 0.0), across(5.0, 0.0, 0.1), across(0, 1, 0), across(0, 0, 1)
    assert sharpened(*orbits, 0.3, 0.4) is None
