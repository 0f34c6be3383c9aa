"""Straight lines with rounded corners: smooth, near every corner, inside the points' box."""

import math

import numpy as np
import pytest

from ikservo.errors import BadValueError
from ikservo.motion.path import BlendedPath

SQUARE = np.array([[0.0, 0, 0], [0.2, 0, 0], [0.2, 0.2, 0], [0, 0.2, 0.1]])


def curve_of(seed, blend=0.05):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.3, 0.3, (int(rng.integers(2, 7)), 3))
    return points, BlendedPath(points, [blend] * (len(points) - 2))


@pytest.mark.parametrize("seed", range(7))
def test_blended_path_derivatives_equal_finite_differences(seed):
    _, curve = curve_of(seed)
    h = 1e-6
    for s in np.linspace(2 * h, curve.length - 2 * h, 60):
        (p0, u0, _), (_, u1, b1), (p2, u2, _) = (curve.at(s + d) for d in (-h, 0.0, h))
        np.testing.assert_allclose((p2 - p0) / (2 * h), u1, atol=1e-4)
        np.testing.assert_allclose((u2 - u0) / (2 * h), b1, atol=0.02)


@pytest.mark.parametrize("seed", range(7))
def test_blended_path_maximum_derivatives_are_never_exceeded(seed):
    _, curve = curve_of(seed)
    begin, end = 0.3 * curve.length, 0.8 * curve.length
    slope, bend, _ = curve.max_derivatives(begin, end)
    for s in np.linspace(begin, end, 200):
        _, u, b = curve.at(s)
        assert (np.abs(u) <= slope + 1e-12).all()
        assert (np.abs(b) <= bend + 1e-9).all()


@pytest.mark.parametrize("seed", range(7))
def test_blended_corners_are_passed_within_0_375_of_blend_radius(seed):
    points, curve = curve_of(seed, 0.04)
    along = np.array([curve.at(s)[0] for s in np.linspace(0, curve.length, 4000)])
    for point in points[1:-1]:
        assert np.linalg.norm(along - point, axis=1).min() <= 0.375 * 0.04 + 1e-3
    np.testing.assert_allclose(along[[0, -1]], points[[0, -1]], atol=1e-12)


def test_blended_path_is_shorter_than_its_lines():
    curve = BlendedPath(SQUARE, [0.05, 0.05])
    lines = float(np.linalg.norm(np.diff(SQUARE, axis=0), axis=1).sum())
    assert lines - 0.1 < curve.path_length() < lines


def test_collinear_waypoint_of_blended_path_keeps_line_straight():
    curve = BlendedPath(np.array([[0.0, 0, 0], [0.1, 0, 0], [0.3, 0, 0]]), [0.05])
    assert curve.path_length() == pytest.approx(0.3)
    np.testing.assert_allclose(curve.at(0.1)[0], (0.1, 0, 0), atol=1e-12)


def test_blended_path_of_one_point_has_no_length():
    curve = BlendedPath(np.zeros((2, 3)), [])
    assert curve.length == 0.0
    np.testing.assert_array_equal(curve.at(0.0)[0], np.zeros(3))


@pytest.mark.parametrize("blend", [0.0, -0.1, math.nan, math.inf])
def test_blend_must_be_positive_and_finite(blend):
    with pytest.raises(BadValueError, match="blend"):
        BlendedPath(SQUARE, [blend, 0.05])
