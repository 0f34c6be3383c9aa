"""Capsules inside another one of the same link are left out; no others are."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ikservo.kinematics.capsules import Capsule, segment_distance
from ikservo.model.collision_capsules import _without_contained

NUMBERS = st.floats(-0.1, 0.1)
POINTS = st.tuples(NUMBERS, NUMBERS, NUMBERS).map(np.array)
CAPSULES = st.builds(Capsule, st.just("link"), POINTS, POINTS, st.floats(0.005, 0.1))


def depth_m(capsule, points):
    return capsule.radius_m - segment_distance(capsule.start_m, capsule.end_m, points, points)


@given(st.lists(CAPSULES, max_size=6), st.integers(0, 100))
def test_remaining_capsules_contain_removed_ones(capsules, seed):
    kept = _without_contained(capsules)
    assert all(any(each is capsule for capsule in capsules) for each in kept)
    rng = np.random.default_rng(seed)
    for capsule in capsules:
        along = capsule.start_m + rng.random((50, 1)) * (capsule.end_m - capsule.start_m)
        away = rng.normal(size=(50, 3))
        points = along + capsule.radius_m * away / np.linalg.norm(away, axis=1, keepdims=True)
        assert np.max([depth_m(each, points) for each in kept], axis=0).min() >= -1e-5


def test_redundant_end_balls_of_cylinder_are_removed():
    a, b = np.zeros(3), np.array([0.0, 0.0, 0.1])
    capsules = [Capsule("x", a, a, 0.02), Capsule("x", a, b, 0.02), Capsule("x", b, b, 0.02)]
    assert _without_contained(capsules) == [capsules[1]]
    assert len(_without_contained([capsules[0], capsules[2]])) == 2
