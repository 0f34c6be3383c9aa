"""Minimum distances, compiled, between the capsules of an arm and its surroundings.

Scalar arithmetic on preallocated arrays: one posture takes some hundredths of a millisecond, so a
stream of goals can be checked in real time. The distances equal those of
``kinematics.collision_body``; a test compares both.
"""

from __future__ import annotations

import math

import numpy as np

from ikservo.kernels.compiled import entry
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.packed import (
    AXIS,
    CAPSULE_WIDTH,
    CENTRE,
    END,
    HALF,
    IS_CYLINDER,
    IS_PRISMATIC,
    LINK,
    LINK_POSE,
    LINK_WIDTH,
    MIMIC_COLUMN,
    MIMIC_OFFSET,
    MIMIC_SCALE,
    ORIGIN,
    PARENT,
    RADIUS,
    ROUNDING,
    SHAPE_WIDTH,
    START,
)

_TINY = 1e-30
_HALVINGS = 30  # leaves 1 nm of a segment of one metre


def distances_fit(
    links: Matrix,
    capsules: Matrix,
    pairs: Matrix,
    floor_m: float,
    shapes: Matrix,
    postures: Matrix,
    places: Matrix,
    ends: Matrix,
    distances: Matrix,
) -> bool:
    """Check whether arrays have the shapes that ``min_distances`` needs, and indices exist."""
    if not is_tree(links, postures.shape[1]) or capsules.shape[1] != CAPSULE_WIDTH:
        return False
    between = distances.shape[1] - len(links) * (1 + len(shapes))
    for i in range(len(capsules)):
        link = capsules[i, LINK]
        if not 0.0 <= link < len(links):
            return False
    if len(pairs) > 0 and pairs.shape[1] != 3:
        return False
    for k in range(len(pairs)):
        first, second, column = pairs[k, 0], pairs[k, 1], pairs[k, 2]
        if not (0.0 <= first < len(capsules) and 0.0 <= second < len(capsules)):
            return False
        if not 0.0 <= column < between:
            return False
    return (
        between >= 0
        and shapes.shape[1] == SHAPE_WIDTH
        and len(places) == len(links)
        and places.shape[1] == 12
        and len(ends) == len(capsules)
        and ends.shape[1] == 6
        and len(distances) == len(postures)
        and floor_m < math.inf
    )


@entry(distances_fit)
def min_distances(
    links: Matrix,
    capsules: Matrix,
    pairs: Matrix,
    floor_m: float,
    shapes: Matrix,
    postures: Matrix,
    places: Matrix,
    ends: Matrix,
    distances: Matrix,
) -> None:
    """Compute the distances [m] of all pairs for every posture of a path.

    Args:
        links: One row per link, parents first; see ``kinematics.packed``.
        capsules: One row per capsule.
        pairs: (m, 3) rows of two capsules, and the column of ``distances`` for the two.
        floor_m: The height of the table; minus infinity if there is no table.
        shapes: (k, 17) rows; see ``kinematics.packed``.
        postures: Joint vectors (n, dof).
        places: (links, 12), work array: the pose of each link.
        ends: (capsules, 6), work array: the ends of the segments.
        distances: (n, pairs of links + links * (1 + k)), output; initialised to infinity.
    """
    between = distances.shape[1] - len(links) * (1 + len(shapes))
    for n in range(len(postures)):
        place_links(links, postures[n], places)
        place_capsules(capsules, places, ends)
        for k in range(len(pairs)):
            first, second, column = int(pairs[k, 0]), int(pairs[k, 1]), int(pairs[k, 2])
            gap_m = segment_distance(ends, first, second)
            gap_m -= capsules[first, RADIUS] + capsules[second, RADIUS]
            distances[n, column] = min(distances[n, column], gap_m)
        for i in range(len(capsules)):
            column = between + int(capsules[i, LINK])
            gap_m = min(ends[i, 2], ends[i, 5]) - capsules[i, RADIUS] - floor_m
            distances[n, column] = min(distances[n, column], gap_m)
            for b in range(len(shapes)):
                gap_m = segment_shape_distance(ends, i, shapes, b) - capsules[i, RADIUS]
                at = column + len(links) * (1 + b)
                distances[n, at] = min(distances[n, at], gap_m)


def torques_fit(
    links: Matrix, masses: Matrix, postures: Matrix, places: Matrix, torques: Matrix
) -> bool:
    """Check whether arrays have the shapes that ``gravity_torques_kernel`` needs."""
    return (
        is_tree(links, postures.shape[1])
        and len(masses) == len(links)
        and masses.shape[1] == 4
        and len(places) == len(links)
        and places.shape[1] == 12
        and len(torques) == len(postures)
        and torques.shape[1] == postures.shape[1]
    )


def is_tree(links: Matrix, dof: int) -> bool:
    """Check whether links come after their parents, and each joint's column of q exists."""
    if links.shape[1] != LINK_WIDTH:
        return False
    for i in range(len(links)):
        parent, column = links[i, PARENT], links[i, MIMIC_COLUMN]
        if not -1.0 <= parent < i:
            return False
        if parent >= 0.0 and not 0.0 <= column < dof:
            return False
    return True


@entry(torques_fit)
def gravity_torques_kernel(
    links: Matrix, masses: Matrix, postures: Matrix, places: Matrix, torques: Matrix
) -> None:
    """Compute the torques of gravity on the joints (n, dof) [N m], for g = 1 m/s².

    Args:
        links: One row per link, parents first; see ``kinematics.packed``.
        masses: (links, 4) mass [kg] and centre in the link's frame [m].
        postures: Joint vectors (n, dof).
        places: (links, 12), work array: the pose of each link.
        torques: (n, dof), output; initialised to zero.
    """
    for n in range(len(postures)):
        place_links(links, postures[n], places)
        add_gravity_torques(links, masses, places, torques, n)


def add_gravity_torques(
    links: Matrix, masses: Matrix, places: Matrix, torques: Matrix, n: int
) -> None:
    """Add the torques of gravity on placed links to row ``n``; see ``gravity_torques_kernel``."""
    for i in range(len(links)):
        if masses[i, 0] > 0.0:
            x, y = _mass_centre_xy(places, i, masses)
            j = i
            while links[j, PARENT] >= 0.0:
                if links[j, MIMIC_SCALE] != 0.0:
                    rise = (
                        masses[i, 0]
                        * links[j, MIMIC_SCALE]
                        * _height_derivative(links, places, j, x, y)
                    )
                    torques[n, int(links[j, MIMIC_COLUMN])] -= rise
                j = int(links[j, PARENT])


def _mass_centre_xy(places: Matrix, i: int, masses: Matrix) -> tuple[float, float]:
    """Return x and y of a link's centre of mass in the base frame."""
    x, y = places[i, 9], places[i, 10]
    for k in range(3):
        x += places[i, k] * masses[i, 1 + k]
        y += places[i, 3 + k] * masses[i, 1 + k]
    return x, y


def _height_derivative(links: Matrix, places: Matrix, j: int, x: float, y: float) -> float:
    """Compute the height change of a point per rad or m of the joint of link ``j``."""
    ax = ay = az = 0.0
    for k in range(3):
        ax += places[j, k] * links[j, AXIS + k]
        ay += places[j, 3 + k] * links[j, AXIS + k]
        az += places[j, 6 + k] * links[j, AXIS + k]
    if links[j, IS_PRISMATIC] == 1.0:
        return az
    return ax * (y - places[j, 10]) - ay * (x - places[j, 9])


def place_links(links: Matrix, q: Vector, places: Matrix) -> None:
    """Compute R_world_link row by row, then p, of each link: parent, origin, motion."""
    for i in range(len(links)):
        parent = int(links[i, PARENT])
        if parent < 0:
            for k in range(12):
                places[i, k] = 1.0 if k % 4 == 0 else 0.0
            continue
        _compose_pose(places, parent, links, i, places, i)
        value = links[i, MIMIC_SCALE] * q[int(links[i, MIMIC_COLUMN])] + links[i, MIMIC_OFFSET]
        if value != 0.0:  # zero for fixed joints
            _apply_joint_motion(places, i, links, value)


def _compose_pose(a: Matrix, i: int, links: Matrix, j: int, out: Matrix, k: int) -> None:
    """Write row ``i`` of ``a`` times the origin of link ``j`` to row ``k`` of ``out``."""
    for r in range(3):
        x, y, z = a[i, 3 * r], a[i, 3 * r + 1], a[i, 3 * r + 2]
        for c in range(3):
            out[k, 3 * r + c] = (
                x * links[j, ORIGIN + c]
                + y * links[j, ORIGIN + 3 + c]
                + z * links[j, ORIGIN + 6 + c]
            )
        out[k, 9 + r] = (
            a[i, 9 + r]
            + x * links[j, LINK_POSE]
            + y * links[j, LINK_POSE + 1]
            + z * links[j, LINK_POSE + 2]
        )


def _apply_joint_motion(places: Matrix, i: int, links: Matrix, value: float) -> None:
    """Rotate or translate row ``i`` by its joint's value, about its local axes (Rodrigues)."""
    ax, ay, az = links[i, AXIS], links[i, AXIS + 1], links[i, AXIS + 2]
    if links[i, IS_PRISMATIC] == 1.0:
        for r in range(3):
            along = places[i, 3 * r] * ax + places[i, 3 * r + 1] * ay + places[i, 3 * r + 2] * az
            places[i, 9 + r] += value * along
        return
    s, v = math.sin(value), 1.0 - math.cos(value)
    for r in range(3):
        x, y, z = places[i, 3 * r], places[i, 3 * r + 1], places[i, 3 * r + 2]
        along = x * ax + y * ay + z * az
        # row times (I + s W + v W²), with row W = row x axis and row W² = (row . a) a - row
        places[i, 3 * r] = x + s * (y * az - z * ay) + v * (along * ax - x)
        places[i, 3 * r + 1] = y + s * (z * ax - x * az) + v * (along * ay - y)
        places[i, 3 * r + 2] = z + s * (x * ay - y * ax) + v * (along * az - z)


def place_capsules(capsules: Matrix, places: Matrix, ends: Matrix) -> None:
    """Compute both ends of each capsule's segment from the places of the links."""
    for i in range(len(capsules)):
        place_capsule(capsules, i, places, ends)


def place_capsule(capsules: Matrix, i: int, places: Matrix, ends: Matrix) -> None:
    """Compute both ends of the segment of capsule ``i`` from the places of the links."""
    link = int(capsules[i, LINK])
    for r in range(3):
        x, y, z = places[link, 3 * r], places[link, 3 * r + 1], places[link, 3 * r + 2]
        for end in range(2):
            at = START + end * (END - START)
            ends[i, 3 * end + r] = (
                places[link, 9 + r]
                + x * capsules[i, at]
                + y * capsules[i, at + 1]
                + z * capsules[i, at + 2]
            )


def segment_distance(ends: Matrix, i: int, j: int) -> float:
    """Compute the distance between two segments; see ``kinematics.capsules.segment_distance``."""
    a = e = b = c = f = 0.0
    for k in range(3):
        d1, d2 = ends[i, 3 + k] - ends[i, k], ends[j, 3 + k] - ends[j, k]
        r = ends[i, k] - ends[j, k]
        a, e, b, c, f = a + d1 * d1, e + d2 * d2, b + d1 * d2, c + d1 * r, f + d2 * r
    # Parallel segments have no single closest pair, and a point has no direction: any s and t can
    # be the start. Then s is optimised for t, and t for s.
    s = _clamp_unit_interval((b * f - c * e) / max(a * e - b * b, _TINY))
    t = _clamp_unit_interval((b * s + f) / max(e, _TINY))
    s = _clamp_unit_interval((b * t - c) / max(a, _TINY))
    gap2 = 0.0
    for k in range(3):
        d1, d2 = ends[i, 3 + k] - ends[i, k], ends[j, 3 + k] - ends[j, k]
        gap = ends[i, k] - ends[j, k] + s * d1 - t * d2
        gap2 += gap * gap
    return math.sqrt(gap2)


def segment_shape_distance(ends: Matrix, i: int, shapes: Matrix, b: int) -> float:
    """Compute the distance from a segment to a shape; 0 or less if it enters the shape.

    The squared distance from a box is convex along the segment, and its slope is linear between the
    planes of the faces: the minimum is exact. The squared distance from a cylinder is convex, too.
    """
    line = np.empty(6)
    for k in range(3):
        line[k] = line[3 + k] = 0.0
        for r in range(3):
            line[k] += shapes[b, 3 * r + k] * (ends[i, r] - shapes[b, CENTRE + r])
            line[3 + k] += shapes[b, 3 * r + k] * (ends[i, 3 + r] - ends[i, r])
    if shapes[b, IS_CYLINDER] == 1.0:
        t = _nearest_to_cylinder(line, shapes, b)
    else:
        t = _nearest_to_box(line, shapes, b)
    x, y, z = line[0] + t * line[3], line[1] + t * line[4], line[2] + t * line[5]
    return math.sqrt(_local_distance2(x, y, z, shapes, b)) - shapes[b, ROUNDING]


def point_shape_distance(x: float, y: float, z: float, shapes: Matrix, b: int) -> float:
    """Compute the distance from a point (base frame) to a shape; 0 or less inside the shape."""
    x, y, z = x - shapes[b, CENTRE], y - shapes[b, CENTRE + 1], z - shapes[b, CENTRE + 2]
    u = x * shapes[b, 0] + y * shapes[b, 3] + z * shapes[b, 6]
    v = x * shapes[b, 1] + y * shapes[b, 4] + z * shapes[b, 7]
    w = x * shapes[b, 2] + y * shapes[b, 5] + z * shapes[b, 8]
    return math.sqrt(_local_distance2(u, v, w, shapes, b)) - shapes[b, ROUNDING]


def _local_distance2(x: float, y: float, z: float, shapes: Matrix, b: int) -> float:
    """Compute the squared distance of a point in the shape's frame, without its rounding."""
    w = max(abs(z) - shapes[b, HALF + 2], 0.0)
    if shapes[b, IS_CYLINDER] == 1.0:
        u, v = max(math.sqrt(x * x + y * y) - shapes[b, HALF], 0.0), 0.0
    else:
        u, v = max(abs(x) - shapes[b, HALF], 0.0), max(abs(y) - shapes[b, HALF + 1], 0.0)
    return u * u + v * v + w * w


def _nearest_to_box(line: Vector, shapes: Matrix, b: int) -> float:
    """Compute the fraction of a segment (start, step) at which it is nearest to a box."""
    low, high = 0.0, 1.0
    falls, rises = _box_slope(line, low, shapes, b), _box_slope(line, high, shapes, b)
    if falls >= 0.0:
        return low
    if rises <= 0.0:
        return high
    for face in range(6):
        k, side = face // 2, 1.0 if face % 2 == 0 else -1.0
        if line[3 + k] != 0.0:
            t = (side * shapes[b, HALF + k] - line[k]) / line[3 + k]
            if low < t < high:
                slope = _box_slope(line, t, shapes, b)
                if slope > 0.0:
                    high, rises = t, slope
                else:
                    low, falls = t, slope
    return low + (high - low) * falls / (falls - rises)


def _box_slope(line: Vector, t: float, shapes: Matrix, b: int) -> float:
    """Compute half of the slope of the squared distance from a box along a segment."""
    slope = 0.0
    for k in range(3):
        at = line[k] + t * line[3 + k]
        outside = max(abs(at) - shapes[b, HALF + k], 0.0)
        slope += math.copysign(outside, at) * line[3 + k]
    return slope


def _nearest_to_cylinder(line: Vector, shapes: Matrix, b: int) -> float:
    """Compute the fraction of a segment (start, step) at which it is nearest to a cylinder."""
    low, high = 0.0, 1.0
    if _cylinder_slope(line, low, shapes, b) >= 0.0:
        return low
    if _cylinder_slope(line, high, shapes, b) <= 0.0:
        return high
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _cylinder_slope(line, middle, shapes, b) > 0.0:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


def _cylinder_slope(line: Vector, t: float, shapes: Matrix, b: int) -> float:
    """Compute half of the slope of the squared distance from a cylinder along a segment."""
    x, y, z = line[0] + t * line[3], line[1] + t * line[4], line[2] + t * line[5]
    slope = math.copysign(max(abs(z) - shapes[b, HALF + 2], 0.0), z) * line[5]
    aside = math.sqrt(x * x + y * y)
    if aside > shapes[b, HALF]:
        slope += (1.0 - shapes[b, HALF] / aside) * (x * line[3] + y * line[4])
    return slope


def _clamp_unit_interval(x: float) -> float:
    return min(max(x, 0.0), 1.0)
