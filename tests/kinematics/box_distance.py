"""Distances of capsules from upright boxes in NumPy: a reference for the compiled kernel."""

import numpy as np

_GOLDEN = (5**0.5 - 1) / 2


def segment_box_distance(a, b, low_m, high_m):
    """Compute the distances (…) from segments a b, each end (…, 3), to an upright box; 0 inside.

    The distance to a convex body is a convex function along the segment, so that golden section
    search finds its minimum.
    """
    low, high = np.zeros(()), np.ones(())
    for _ in range(60):
        s, t = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        nearer = _box_distance_at(a, b, s, low_m, high_m) <= _box_distance_at(
            a, b, t, low_m, high_m
        )
        low, high = np.where(nearer, low, s), np.where(nearer, t, high)
    return _box_distance_at(a, b, 0.5 * (low + high), low_m, high_m)


def _box_distance_at(a, b, fraction, low_m, high_m):
    point = a + fraction[..., None] * (b - a)
    outside = np.maximum(np.maximum(low_m - point, point - high_m), 0.0)
    return np.sqrt((outside * outside).sum(axis=-1))


def box_distances(body, q, low_m, high_m, name):
    """Return the distance of each link of a body from an upright box, for q (n, dof)."""
    starts, ends = body._capsule_ends(q)
    distances_m = segment_box_distance(starts, ends, low_m, high_m) - body._radii_m
    return body._min_by_link(distances_m, name)
