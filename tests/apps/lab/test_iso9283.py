"""The formulas of ISO 9283 against values computed by hand."""

import math

import numpy as np
import pytest

from ikservo.apps.lab.iso9283 import (
    largest_drift,
    multidirectional_variation,
    path_accuracy,
    path_crossings,
    path_repeatability,
    pose_accuracy,
    pose_repeatability,
)
from ikservo.errors import BadValueError

# Barycentre (1, 2, 3); distances from it 1, 1, 2, 2.
POINTS = np.array([[2.0, 2, 3], [0.0, 2, 3], [1.0, 4, 3], [1.0, 0, 3]])
ASIDE = np.array([3.0, 4.0, 0.0])


def test_pose_accuracy_is_the_distance_of_the_barycentre():
    assert pose_accuracy(POINTS, (1.0, 2.0, 3.0)) == 0.0
    assert pose_accuracy(POINTS, (1.0, 5.0, 7.0)) == pytest.approx(5.0)


def test_pose_repeatability_is_mean_distance_plus_3_deviations():
    # mean 1.5; squares of differences 4 × 0.25, over n - 1 = 3
    assert pose_repeatability(POINTS) == pytest.approx(1.5 + 3.0 * math.sqrt(1.0 / 3.0))


def test_pose_repeatability_of_two_points_is_half_distance():
    assert pose_repeatability([[0.0, 0, 0], [0.0, 0, 4.0]]) == pytest.approx(2.0)


def test_pose_repeatability_does_not_depend_on_location():
    assert pose_repeatability(POINTS + 100.0) == pytest.approx(pose_repeatability(POINTS))


def test_multidirectional_variation_is_distance_of_means():
    found = multidirectional_variation([POINTS, POINTS + ASIDE, POINTS + 0.2 * ASIDE])
    assert found == pytest.approx(5.0)


def test_path_accuracy_is_worst_deviation_of_mean_path():
    commanded = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]])
    first = commanded + np.array([[0, 1, 0], [0, 1, 0], [0, 0, 0]])
    second = commanded + np.array([[0, -1, 0], [0, 2, 0], [0, 0, 1]])
    # means beside the path: 0, 1.5, 0.5
    assert path_accuracy([first, second], commanded) == pytest.approx(1.5)


def test_path_repeatability_is_worst_spread_of_paths():
    paths = np.zeros((4, 2, 3))
    paths[:, 1] = POINTS
    assert path_repeatability(paths) == pytest.approx(1.5 + 3.0 * math.sqrt(1.0 / 3.0))


def test_pose_drift_is_largest_change_since_start():
    assert largest_drift([0.3, 0.4, 0.1, 0.2]) == pytest.approx(0.2)


def test_iso_9283_path_points_are_interpolated_in_normal_planes():
    measured = np.array([[-1.0, 2.0, 0.0], [1.0, 4.0, 0.0], [3.0, 4.0, 0.0]])
    found = path_crossings(measured, [[0.0, 0, 0], [2.0, 0, 0]], [[1.0, 0, 0], [1.0, 0, 0]])
    np.testing.assert_allclose(found, [[0.0, 3.0, 0.0], [2.0, 4.0, 0.0]])


def test_nearest_of_several_path_crossings_is_used():
    angles = np.linspace(0.0, 4.0 * math.pi, 4001)
    circle = np.column_stack([1.1 * np.cos(angles), 1.1 * np.sin(angles), 0 * angles])
    found = path_crossings(circle, [[0.0, 1.0, 0.0]], [[-1.0, 0.0, 0.0]])
    np.testing.assert_allclose(found, [[0.0, 1.1, 0.0]], atol=1e-5)


def test_iso_9283_refuses_path_that_ends_early():
    with pytest.raises(BadValueError, match="crosses each plane"):
        path_crossings(POINTS, [[9.0, 0, 0]], [[1.0, 0, 0]])


@pytest.mark.parametrize(
    "call",
    [
        lambda: pose_accuracy(np.zeros((0, 3)), (0, 0, 0)),
        lambda: pose_accuracy(np.zeros((2, 2)), (0, 0, 0)),
        lambda: pose_repeatability(np.zeros((1, 3))),
        lambda: multidirectional_variation([POINTS]),
        lambda: path_accuracy(np.zeros((3, 3)), np.zeros((3, 3))),
        lambda: path_repeatability(np.zeros((1, 5, 3))),
    ],
)
def test_iso_9283_refuses_too_few_points_or_wrong_shape(call):
    with pytest.raises(BadValueError):
        call()
