"""The cube of the accuracy test: its points, and whether the arms reach all of it."""

import numpy as np
import pytest

import ikservo
from ikservo.apps.lab.iso_cube import EDGES_M, IsoCube, place_cube
from ikservo.errors import RefusedError
from tests.oracle import ARMS


@pytest.mark.full
@pytest.mark.sample(2)
@pytest.mark.parametrize("name", ARMS)
def test_each_arm_has_free_iso_cube_with_reachable_poses(name):
    with ikservo.open_arm(name, port="sim:?pose=home") as arm:
        cube = place_cube(arm)
        assert cube.edge_m in EDGES_M
        for point in cube.poses_m.values():
            assert np.abs(point - cube.center_m).max() <= 0.4 * cube.edge_m + 1e-12
            assert ikservo.solve(arm.chain, ikservo.Target(point)).reached


def test_iso_9283_poses_are_a_tenth_from_ends_of_cube_diagonals():
    cube = IsoCube(np.array([0.2, 0.0, 0.1]), 0.1)
    p = cube.poses_m
    np.testing.assert_allclose(p["P2"], (0.24, 0.04, 0.14))
    np.testing.assert_allclose(p["P4"], (0.16, -0.04, 0.06))
    corner = cube.center_m + 0.05
    diagonal = np.linalg.norm(2 * (corner - cube.center_m))
    assert np.linalg.norm(corner - p["P2"]) == pytest.approx(0.1 * diagonal)
    for point in p.values():
        assert (point - cube.center_m) @ cube.normal == pytest.approx(0.0, abs=1e-12)
    assert cube.radius_m == pytest.approx(0.04)


def test_iso_cube_without_free_space_is_refused(monkeypatch):
    monkeypatch.setattr("ikservo.apps.lab.iso_cube._CLEARANCE_M", 5.0)
    monkeypatch.setattr("ikservo.apps.lab.iso_cube._OF_HOME", 50.0)
    with (
        ikservo.open_arm("planar2", port="sim:?pose=home") as arm,
        pytest.raises(RefusedError, match="No cube of 40 mm"),
    ):
        place_cube(arm)
