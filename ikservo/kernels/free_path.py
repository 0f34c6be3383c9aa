"""Compiled check that straight joint paths between postures are free, also between samples.

Around a free posture every joint may move some distance before anything can touch: the distance of
each pair, divided by the rate at which it can shrink. Two postures whose free ranges meet have a
free path between them; otherwise the middle of the part between them is checked. Only distances
that could shorten the free path found so far are computed exactly: spheres around links and
capsules, and boxes around obstacles along the axes of the base, exclude the other distances.
"""

from __future__ import annotations

import math

import numpy as np

from ikservo.kernels.capsule_distances import (
    add_gravity_torques,
    is_tree,
    place_capsule,
    place_links,
    point_shape_distance,
    segment_distance,
    segment_shape_distance,
)
from ikservo.kernels.compiled import entry, vectorised
from ikservo.kinematics.arrays import IntMatrix, IntVector, Matrix, Vector
from ikservo.kinematics.packed import CAPSULE_WIDTH, END, LINK, RADIUS, SHAPE_WIDTH, START

FREE = 2.0
"""Result of ``first_contact`` if there is no contact."""

# A sphere does not have a second end; these entries hold the range of its capsules.
FIRST_CAPSULE, LAST_CAPSULE = END, END + 1  # this one is exclusive
_PLACED = 3  # entry of a centre: 1 if the link's capsule spheres are placed
_BALL = 3  # row of ``spheres`` with the radius; above it the centre, below it the placed centre
SPHERE_ROWS = 7

_TOUCH_M = 1e-9
_UNSEEN_M = 0.001  # a pair may be nearer than allowed by at most this
_SAME = 1e-12  # shorter parts of a motion count as zero
_STACK = 64
_MOST = 20000  # most checks between two postures: one per millimetre on 20 m


def path_fits(
    links: Matrix, capsules: Matrix, spheres: Matrix, balls: Matrix, pairs: IntMatrix,
    shapes: Matrix, boxes: Matrix, floor_m: float, reach: Matrix, masses: Matrix, sag: Matrix,
    places: Matrix, ends: Matrix, centres: Matrix, postures: Matrix, rates: Vector, allowed: Matrix,
    load: float, path: Matrix,
) -> bool:  # fmt: skip
    """Check whether arrays have the shapes that ``first_contact`` needs, and indices exist."""
    dof, count = path.shape[1], len(balls)
    between = allowed.shape[1] - count * (2 + len(shapes))
    if not is_tree(links, dof) or between < 0 or not _are_capsules(capsules, len(links)):
        return False
    if not _are_capsules(balls, len(links)) or pairs.shape[1] != 3:
        return False
    for i in range(count):
        first, last = balls[i, FIRST_CAPSULE], balls[i, LAST_CAPSULE]
        if not (first >= 0.0 and first <= last <= len(capsules)):
            return False
    for k in range(len(pairs)):
        first_link, second_link, column = pairs[k, 0], pairs[k, 1], pairs[k, 2]
        if not (0 <= first_link < count and 0 <= second_link < count and 0 <= column < between):
            return False
    return (
        len(spheres) == SPHERE_ROWS
        and spheres.shape[1] == len(capsules)
        and shapes.shape[1] == SHAPE_WIDTH
        and len(boxes) == 6
        and boxes.shape[1] == len(shapes)
        and floor_m < math.inf
        and len(reach) == between + count
        and reach.shape[1] == dof
        and len(masses) == len(links)
        and masses.shape[1] == 4
        and len(sag) == 3
        and sag.shape[1] == dof
        and len(places) == len(links)
        and places.shape[1] == 12
        and len(ends) == len(capsules)
        and ends.shape[1] == 6
        and len(centres) == count
        and centres.shape[1] == 4
        and len(postures) == 3
        and postures.shape[1] == dof
        and len(rates) == between + count
        and len(allowed) == 2
        and load < math.inf
    )


@entry(path_fits)
def first_contact(
    links: Matrix, capsules: Matrix, spheres: Matrix, balls: Matrix, pairs: IntMatrix,
    shapes: Matrix, boxes: Matrix, floor_m: float, reach: Matrix, masses: Matrix, sag: Matrix,
    places: Matrix, ends: Matrix, centres: Matrix, postures: Matrix, rates: Vector, allowed: Matrix,
    load: float, path: Matrix,
) -> float:  # fmt: skip
    """Find a contact on straight paths of the joints through postures (n, dof).

    Args:
        links: One row per rigid body, parents first; see ``kinematics.packed``.
        capsules: One row per capsule, with its rigid body; capsules of a link are adjacent.
        spheres: (7, capsules) sphere around each capsule: its centre in the link, its radius;
            the rest is a work array.
        balls: (links, 8) sphere around the capsules of each link, with its rigid body; see
            ``FIRST_CAPSULE``.
        pairs: (m, 3) two links to check, and the column of the two in ``allowed``.
        shapes: (k, 17) one row per obstacle other than the table; see ``kinematics.packed``.
        boxes: (6, k) box around each obstacle: its centre, and half of its size.
        floor_m: The height of the table; minus infinity if there is no table.
        reach: (pairs of links + links, dof) largest approach of each pair, and largest motion of
            each link, per unit of a joint.
        masses: (bodies, 4) mass [kg] and centre in the frame [m].
        sag: (3, dof) compliance of each joint for the torque at 1 m/s², lower and upper end stops.
        places: (bodies, 12), work array.
        ends: (capsules, 6), work array.
        centres: (links, 4), work array.
        postures: (3, dof), work array.
        rates: (pairs of links + links,), work array.
        allowed: (2, pairs of links + links * (2 + k)) smallest distances [m] of pairs of links,
            then of each link from the table and from each obstacle, and the largest of these;
            second row: distances of the sagging arm from obstacles.
        load: Multiple of gravity under which the arm sags; 0 ignores sag.
        path: The postures.

    Returns:
        The fraction of the path where something is nearer than allowed, not always the first;
        ``FREE`` if nothing is nearer than allowed by more than a millimetre. A path of more than
        tens of metres is not followed to its end, and counts as not free.
    """
    stack = np.empty((64, 4))
    for n in range(len(path) - 1):
        for c in range(len(rates)):
            rates[c] = 0.0
            for j in range(path.shape[1]):
                rates[c] += reach[c, j] * abs(path[n + 1, j] - path[n, j])
        for end in range(2):
            for j in range(path.shape[1]):
                postures[0, j] = path[n + end, j]
            stack[0, 1 + 2 * end] = free_fraction(
                links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, masses, sag, places,
                ends, centres, postures, rates, allowed, load, 1.0, -1,
            )  # fmt: skip
            stack[0, 2 * end] = 1.0 * end
            if stack[0, 1 + 2 * end] < 0.0:
                return (n + 1.0 * end) / (len(path) - 1.0)
        depth, seen = 1, 0
        while depth > 0:
            depth -= 1
            a, free_a, b, free_b = (
                stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3],
            )  # fmt: skip
            if not b - free_b - (a + free_a) > _SAME:
                continue
            middle = 0.5 * (a + free_a + b - free_b)
            for j in range(path.shape[1]):
                postures[0, j] = path[n, j] + middle * (path[n + 1, j] - path[n, j])
            free = free_fraction(
                links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, masses, sag, places,
                ends, centres, postures, rates, allowed, load, 1.0, -1,
            )  # fmt: skip
            seen += 1
            if free < 0.0 or depth > _STACK - 2 or seen > _MOST:
                return (n + middle) / (len(path) - 1.0)
            stack[depth, 0], stack[depth, 1] = a, free_a
            stack[depth, 2], stack[depth, 3] = middle, free
            stack[depth + 1, 0], stack[depth + 1, 1] = middle, free
            stack[depth + 1, 2], stack[depth + 1, 3] = b, free_b
            depth += 2
    return FREE


def postures_fit(
    links: Matrix, capsules: Matrix, spheres: Matrix, balls: Matrix, pairs: IntMatrix,
    shapes: Matrix, boxes: Matrix, floor_m: float, reach: Matrix, masses: Matrix, sag: Matrix,
    places: Matrix, ends: Matrix, centres: Matrix, postures: Matrix, rates: Vector, allowed: Matrix,
    load: float, path: Matrix, free: IntVector,
) -> bool:  # fmt: skip
    """Check whether arrays have the shapes that ``free_postures`` needs, and indices exist."""
    return len(free) == len(path) and path_fits(
        links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, reach, masses, sag, places,
        ends, centres, postures, rates, allowed, load, path,
    )  # fmt: skip


@entry(postures_fit)
def free_postures(
    links: Matrix, capsules: Matrix, spheres: Matrix, balls: Matrix, pairs: IntMatrix,
    shapes: Matrix, boxes: Matrix, floor_m: float, reach: Matrix, masses: Matrix, sag: Matrix,
    places: Matrix, ends: Matrix, centres: Matrix, postures: Matrix, rates: Vector, allowed: Matrix,
    load: float, path: Matrix, free: IntVector,
) -> None:  # fmt: skip
    """Set ``free`` (n,) to 1 for postures (n, dof) that keep the allowed distances, otherwise 0.

    The other arguments are those of ``first_contact``.
    """
    for c in range(len(rates)):
        rates[c] = 0.0
    for n in range(len(path)):
        for j in range(path.shape[1]):
            postures[0, j] = path[n, j]
        found = free_fraction(
            links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, masses, sag, places,
            ends, centres, postures, rates, allowed, load, 0.0, -1,
        )  # fmt: skip
        free[n] = 1 if found >= 0.0 else 0


def _are_capsules(rows: Matrix, links: int) -> bool:
    if rows.shape[1] != CAPSULE_WIDTH:
        return False
    for i in range(len(rows)):
        link = rows[i, LINK]
        if not 0.0 <= link < links:
            return False
    return True


def free_fraction(
    links: Matrix, capsules: Matrix, spheres: Matrix, balls: Matrix, pairs: IntMatrix,
    shapes: Matrix, boxes: Matrix, floor_m: float, masses: Matrix, sag: Matrix, places: Matrix,
    ends: Matrix, centres: Matrix, postures: Matrix, rates: Vector, allowed: Matrix, load: float,
    most: float, hit: int,
) -> float:  # fmt: skip
    """Return the fraction of the path that is free around the first posture, up to ``most``.

    If something is nearer than allowed, return -1 - ``hit``: ``hit`` is the row of ``pairs``, or
    the number of pairs plus the number of the link that is too near an obstacle. The given ``hit``
    is checked first.
    """
    place_links(links, postures[0], places)
    _place_balls(balls, places, centres)
    free, hits_itself = most, hit >= 0 and hit < len(pairs)
    if hits_itself:
        free = _free_of_itself(
            capsules, spheres, balls, pairs, places, ends, centres, rates, allowed, hit, free
        )
    if free >= 0.0:
        free = _free_of_things(
            capsules, spheres, balls, shapes, boxes, floor_m, pairs, places, ends, centres, rates,
            allowed, 0, hit, free,
        )  # fmt: skip
    if free >= 0.0 and not hits_itself:
        free = _free_of_itself(
            capsules, spheres, balls, pairs, places, ends, centres, rates, allowed, 0, free
        )
    if free < 0.0 or load <= 0.0:
        return free
    for j in range(postures.shape[1]):
        postures[1, j] = 0.0
    add_gravity_torques(links, masses, places, postures, 1)
    for j in range(postures.shape[1]):
        at = postures[0, j]
        pulled = at + sag[0, j] * postures[1, j]
        pulled = min(max(pulled, min(sag[1, j], at)), max(sag[2, j], at))
        postures[2, j] = at + load * (pulled - at)
    place_links(links, postures[2], places)
    _place_balls(balls, places, centres)
    return _free_of_things(
        capsules, spheres, balls, shapes, boxes, floor_m, pairs, places, ends, centres, rates,
        allowed, 1, hit, free,
    )  # fmt: skip


def _free_of_things(
    capsules: Matrix, spheres: Matrix, balls: Matrix, shapes: Matrix, boxes: Matrix, floor_m: float,
    pairs: IntMatrix, places: Matrix, ends: Matrix, centres: Matrix, rates: Vector, allowed: Matrix,
    row: int, hit: int, free: float,
) -> float:  # fmt: skip
    count = len(balls)
    between = int(allowed.shape[1]) - count * (2 + len(shapes))
    first = hit - len(pairs) if hit >= len(pairs) else count - 1
    for k in range(count):
        link = first - k if k <= first else first - k + count
        radius, rate = balls[link, RADIUS], rates[between + link]
        if radius <= 0.0:
            continue
        rest_m = floor_m + allowed[row, between + link]
        if centres[link, 2] - radius - rest_m < free * rate:
            _place_spheres(spheres, balls, places, centres, link)
            for i in range(int(balls[link, FIRST_CAPSULE]), int(balls[link, LAST_CAPSULE])):
                if spheres[_BALL + 3, i] - spheres[_BALL, i] - rest_m < free * rate:
                    place_capsule(capsules, i, places, ends)
                    slack_m = min(ends[i, 2], ends[i, 5]) - capsules[i, RADIUS] - rest_m
                    free = _shortened(free, slack_m, rate)
                    if free < 0.0:
                        return -1.0 - len(pairs) - link
        near_m = allowed[row, between + count * (1 + len(shapes)) + link] + radius + free * rate
        if near_m > 0.0 and _is_near_box(boxes, centres, link, near_m):
            free = _free_of_shapes(
                capsules, spheres, balls, shapes, boxes, places, ends, centres, allowed, row, link,
                rate, free,
            )  # fmt: skip
            if free < 0.0:
                return -1.0 - len(pairs) - link
    return free


@vectorised
def _is_near_box(boxes: Matrix, centres: Matrix, link: int, near_m: float) -> bool:
    """Check whether any box is within a distance of the centre of a link's sphere."""
    found, near2 = 0, near_m * near_m
    x, y, z = centres[link, 0], centres[link, 1], centres[link, 2]
    for b in range(boxes.shape[1]):
        u = max(abs(x - boxes[0, b]) - boxes[3, b], 0.0)
        v = max(abs(y - boxes[1, b]) - boxes[4, b], 0.0)
        w = max(abs(z - boxes[2, b]) - boxes[5, b], 0.0)
        found += 1 if u * u + v * v + w * w < near2 else 0
    return found > 0


def _free_of_shapes(
    capsules: Matrix, spheres: Matrix, balls: Matrix, shapes: Matrix, boxes: Matrix, places: Matrix,
    ends: Matrix, centres: Matrix, allowed: Matrix, row: int, link: int, rate: float, free: float,
) -> float:  # fmt: skip
    """Return the free fraction of the path, given the distances of one link from obstacles."""
    column = allowed.shape[1] - len(balls) * (1 + len(shapes)) + link
    for b in range(len(shapes)):
        near_m = allowed[row, column + b * len(balls)] + balls[link, RADIUS] + free * rate
        x, y, z = centres[link, 0], centres[link, 1], centres[link, 2]
        if not _box_distance2(boxes, b, x, y, z) < near_m * near_m or near_m <= 0.0:
            continue
        if not point_shape_distance(x, y, z, shapes, b) < near_m:
            continue
        _place_spheres(spheres, balls, places, centres, link)
        for i in range(int(balls[link, FIRST_CAPSULE]), int(balls[link, LAST_CAPSULE])):
            x, y, z = spheres[_BALL + 1, i], spheres[_BALL + 2, i], spheres[_BALL + 3, i]
            near_m = allowed[row, column + b * len(balls)] + spheres[_BALL, i] + free * rate
            if not _box_distance2(boxes, b, x, y, z) < near_m * near_m:
                continue
            slack_m = point_shape_distance(x, y, z, shapes, b)
            if slack_m < near_m:
                if spheres[_BALL, i] > capsules[i, RADIUS]:
                    place_capsule(capsules, i, places, ends)
                    slack_m = segment_shape_distance(ends, i, shapes, b)
                slack_m -= capsules[i, RADIUS] + allowed[row, column + b * len(balls)]
                free = _shortened(free, slack_m, rate)
                if free < 0.0:
                    return free
    return free


def _box_distance2(boxes: Matrix, b: int, x: float, y: float, z: float) -> float:
    """Compute the squared distance from a point to the box around an obstacle."""
    u = max(abs(x - boxes[0, b]) - boxes[3, b], 0.0)
    v = max(abs(y - boxes[1, b]) - boxes[4, b], 0.0)
    w = max(abs(z - boxes[2, b]) - boxes[5, b], 0.0)
    return u * u + v * v + w * w


def _place_balls(balls: Matrix, places: Matrix, centres: Matrix) -> None:
    """Compute the centre of each link's sphere; its capsules are placed when they are needed."""
    for i in range(len(balls)):
        at = int(balls[i, LINK])
        for r in range(3):
            centres[i, r] = (
                places[at, 9 + r]
                + places[at, 3 * r] * balls[i, START]
                + places[at, 3 * r + 1] * balls[i, START + 1]
                + places[at, 3 * r + 2] * balls[i, START + 2]
            )
        centres[i, _PLACED] = 0.0


def _place_spheres(
    spheres: Matrix, balls: Matrix, places: Matrix, centres: Matrix, link: int
) -> None:
    """Compute the centres of the spheres around a link's capsules, unless they are known."""
    if centres[link, _PLACED] == 0.0:
        centres[link, _PLACED] = 1.0
        at = int(balls[link, LINK])
        for r in range(3):
            x, y, z = places[at, 3 * r], places[at, 3 * r + 1], places[at, 3 * r + 2]
            for i in range(int(balls[link, FIRST_CAPSULE]), int(balls[link, LAST_CAPSULE])):
                along = x * spheres[0, i] + y * spheres[1, i] + z * spheres[2, i]
                spheres[_BALL + 1 + r, i] = places[at, 9 + r] + along


def _free_of_itself(
    capsules: Matrix, spheres: Matrix, balls: Matrix, pairs: IntMatrix, places: Matrix,
    ends: Matrix, centres: Matrix, rates: Vector, allowed: Matrix, hit: int, free: float,
) -> float:  # fmt: skip
    for i in range(len(pairs)):
        k = hit + i if hit + i < len(pairs) else hit + i - len(pairs)
        a, b, column = int(pairs[k, 0]), int(pairs[k, 1]), int(pairs[k, 2])
        near_m = balls[a, RADIUS] + balls[b, RADIUS] + allowed[0, column] + free * rates[column]
        if near_m > 0.0 and _distance2(
            centres[a, 0] - centres[b, 0], centres[a, 1] - centres[b, 1],
            centres[a, 2] - centres[b, 2],
        ) < near_m * near_m:  # fmt: skip
            _place_spheres(spheres, balls, places, centres, a)
            _place_spheres(spheres, balls, places, centres, b)
            free = _free_of_pair(
                capsules, spheres, balls, places, ends, centres, a, b, rates[column],
                allowed[0, column], free,
            )  # fmt: skip
            if free < 0.0:
                return -1.0 - k
    return free


def _free_of_pair(
    capsules: Matrix, spheres: Matrix, balls: Matrix, places: Matrix, ends: Matrix, centres: Matrix,
    a: int, b: int, rate: float, allowed_m: float, free: float,
) -> float:  # fmt: skip
    """Return the free fraction of the path, given the distance between two links."""
    for i in range(int(balls[a, FIRST_CAPSULE]), int(balls[a, LAST_CAPSULE])):
        x, y, z = spheres[_BALL + 1, i], spheres[_BALL + 2, i], spheres[_BALL + 3, i]
        near_m = spheres[_BALL, i] + allowed_m + free * rate
        ball_m = near_m + balls[b, RADIUS]
        apart2 = _distance2(x - centres[b, 0], y - centres[b, 1], z - centres[b, 2])
        if ball_m <= 0.0 or not apart2 < ball_m * ball_m:
            continue
        for j in range(int(balls[b, FIRST_CAPSULE]), int(balls[b, LAST_CAPSULE])):
            u, v, w = x - spheres[4, j], y - spheres[5, j], z - spheres[6, j]
            apart2, ball_m = u * u + v * v + w * w, near_m + spheres[_BALL, j]
            if not apart2 < ball_m * ball_m or ball_m <= 0.0:
                continue
            place_capsule(capsules, i, places, ends)
            place_capsule(capsules, j, places, ends)
            slack_m = segment_distance(ends, i, j) - allowed_m
            slack_m -= capsules[i, RADIUS] + capsules[j, RADIUS]
            free = _shortened(free, slack_m, rate)
            if free < 0.0:
                return free
            near_m = spheres[_BALL, i] + allowed_m + free * rate
    return free


def _distance2(x: float, y: float, z: float) -> float:
    return x * x + y * y + z * z


def _shortened(free: float, slack_m: float, rate: float) -> float:
    """Return the free fraction of the path, cut to what one distance allows; -1 in contact."""
    if slack_m < -_TOUCH_M:
        return -1.0
    if slack_m + _UNSEEN_M < free * rate:
        return (max(slack_m, 0.0) + _UNSEEN_M) / rate
    return free
