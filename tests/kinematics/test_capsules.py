"""Distances between capsules and boxes, compared with dense search and another library."""

import math

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ikservo.kinematics.capsules import Capsule, segment_distance
from tests.kinematics.box_distance import segment_box_distance

points = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)


@settings(max_examples=60, deadline=None)
@given(points, points, points, points)
def test_segment_distance_equals_dense_search(p1, q1, p2, q2):
    t = np.linspace(0, 1, 60)[:, None]
    first, second = p1 + t * (q1 - p1), p2 + t * (q2 - p2)
    densest = np.linalg.norm(first[:, None] - second[None], axis=2).min()
    assert segment_distance(p1, q1, p2, q2) <= densest + 1e-6
    assert segment_distance(p1, q1, p2, q2) >= densest - 0.06


@settings(max_examples=100, deadline=None)
@given(points, points, points, points)
def test_segment_distance_is_symmetric(p1, q1, p2, q2):
    forth, back = segment_distance(p1, q1, p2, q2), segment_distance(p2, q2, p1, q1)
    assert forth == pytest.approx(back, abs=1e-7)


@settings(max_examples=100, deadline=None)
@given(points, points, points, points, st.floats(0.01, 0.2), st.floats(0.01, 0.2))
def test_capsule_distance_equals_distance_by_coal_library(p1, q1, p2, q2, r1, r2):
    ours = segment_distance(p1, q1, p2, q2) - r1 - r2
    if ours < 0.01:  # coal measures penetration otherwise
        return
    theirs = coal.distance(*_coal(p1, q1, r1), *_coal(p2, q2, r2), coal.DistanceRequest(),
                           coal.DistanceResult())  # fmt: skip
    assert ours == pytest.approx(theirs, abs=1e-5)


@settings(max_examples=60, deadline=None)
@given(points, points)
def test_segment_box_distance_equals_dense_search(a, b):
    low, high = np.array([-0.2, -0.3, 0.0]), np.array([0.3, 0.1, 0.4])
    t = np.linspace(0, 1, 400)[:, None]
    along = a + t * (b - a)
    outside = np.maximum(np.maximum(low - along, along - high), 0)
    densest = np.linalg.norm(outside, axis=1).min()
    assert segment_box_distance(a, b, low, high) == pytest.approx(densest, abs=0.01)


def test_capsule_moves_with_its_link():
    T = np.eye(4)
    T[:3, 3] = (1.0, 2.0, 3.0)
    ends = Capsule("link", np.zeros(3), np.array([0, 0, 1.0]), 0.1).ends(T)
    np.testing.assert_array_equal(ends, [[1, 2, 3], [1, 2, 4]])


def _coal(p, q, radius_m):
    length = float(np.linalg.norm(q - p))
    z = (q - p) / length if length > 1e-12 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, [1.0, 0, 0] if abs(z[0]) < 0.9 else [0, 1.0, 0])
    x /= np.linalg.norm(x)
    R = np.column_stack([x, np.cross(z, x), z])
    return coal.Capsule(radius_m, length), coal.Transform3s(R, (p + q) / 2)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(points, points, points, points), min_size=1, max_size=5))
def test_batch_segment_distances_equal_single_distances(quadruples):
    together = segment_distance(*(np.array(ends) for ends in zip(*quadruples, strict=True)))
    alone = [float(segment_distance(*quadruple)) for quadruple in quadruples]
    np.testing.assert_allclose(together, alone, atol=1e-12)


def test_distance_to_point_equals_segment_of_zero_length():
    origin, one = np.zeros(3), np.array([1.0, 0, 0])
    assert segment_distance(origin, origin, one, one) == pytest.approx(1.0)
    assert segment_distance(origin, origin, one, -one) == pytest.approx(0.0)
    assert segment_distance(one, -one, origin, origin) == pytest.approx(0.0)


@given(points, points, points, st.floats(-1, 1), st.floats(-1, 1))
def test_distance_of_parallel_segments_equals_dense_search(p1, q1, p2, stretch, shift):
    along = q1 - p1
    p2 = p2 + shift * along
    q2 = p2 + stretch * along
    t = np.linspace(0, 1, 200)[:, None]
    first, second = p1 + t * along, p2 + t * (q2 - p2)
    densest = np.linalg.norm(first[:, None] - second[None], axis=2).min()
    assert densest - 0.02 <= segment_distance(p1, q1, p2, q2) <= densest + 1e-7


def test_batch_segment_box_distances_equal_single_distances():
    ends = np.random.default_rng(4).uniform(-1, 1, (2, 5, 4, 3))
    low, high = np.array([-0.2, -0.3, 0.0]), np.array([0.3, 0.1, 0.4])
    together = segment_box_distance(*ends, low, high)
    alone = [
        [segment_box_distance(a, b, low, high) for a, b in zip(*rows, strict=True)]
        for rows in zip(*ends, strict=True)
    ]
    np.testing.assert_allclose(together, alone, atol=1e-12)


@pytest.mark.parametrize(
    ("a", "b", "distance_m"),
    [
        ((0.5, 2.0, 0.5), (3.0, 2.0, 0.5), 1.0),
        ((2.0, 2.0, 0.5), (5.0, 2.0, 0.5), math.sqrt(2.0)),
        ((-1.0, 0.3, 0.5), (0.61, 1.91, 0.5), 0.3 / math.sqrt(2.0)),
    ],
)
def test_segment_box_distance_equals_hand_computed_value(a, b, distance_m):
    found = segment_box_distance(np.array(a), np.array(b), np.zeros(3), np.ones(3))
    assert found == pytest.approx(distance_m, abs=1e-9)
