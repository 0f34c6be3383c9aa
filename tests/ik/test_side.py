"""An arm pulled straight beyond its reach and released comes back on the same side."""

import numpy as np
import pytest

from ikservo.ik import Solver
from ikservo.model import load_model
from tests.kinematics.chains import planar


def there_and_back(chain, q0, way_m, steps=100):
    """Track a straight line (3,) from joints and back; return the joints at its end."""
    solver, T, q = Solver(chain), np.eye(4), np.asarray(q0, dtype=float)
    start_m = chain.forward(q)[:3, 3]
    shares = np.linspace(0.0, 1.0, steps)
    for share in [*shares, *shares[::-1]]:
        T[:3, 3] = start_m + share * np.asarray(way_m)
        q, reached = solver.track(T, q)
    assert reached
    return q


@pytest.mark.parametrize("elbow", [0.6, -0.6, 1.4, -1.4])
@pytest.mark.parametrize("beyond_m", [1e-7, 1e-3, 0.1])
def test_tracking_back_into_reach_keeps_elbow_configuration(elbow, beyond_m):
    arm = planar(0.3, 0.2)
    here_m = arm.forward([0.2, elbow])[:3, 3]
    out = here_m / np.linalg.norm(here_m)
    q = there_and_back(arm, [0.2, elbow], out * (0.5 + beyond_m - np.linalg.norm(here_m)))
    np.testing.assert_allclose(q, [0.2, elbow], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "q0"),
    [("koch", [-0.5, 0.67, 0.19, 0.84, -0.22]), ("wx250s", [0.1, 0.4, -0.3, 0.0, 0.4, 0.2])],
)
def test_redundant_arm_tracks_target_back_into_reach(name, q0):
    chain = load_model(name).chain
    there_and_back(chain, q0, 0.2 * np.array([0.53, 0.66, 0.53]))


def test_tracking_from_new_start_ignores_previous_path():
    arm, T = planar(0.3, 0.2), np.eye(4)
    solver = Solver(arm)
    T[:3, 3] = arm.forward([0.2, 0.6])[:3, 3]
    q, _ = solver.track(T, [0.2, 0.6])
    T[0, 3] = 0.7
    solver.track(T, q)
    T[:3, 3] = arm.forward([0.4, -0.9])[:3, 3]
    fresh = Solver(arm).track(T, [0.4, -0.8])[0]
    np.testing.assert_array_equal(solver.track(T, [0.4, -0.8])[0], fresh)
