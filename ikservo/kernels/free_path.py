"""Whether straight ways of the joints between postures are free, compiled; nothing is missed.

A posture is free by so much that every joint may move some way before anything can touch: the
distance of each pair, divided by how fast it can shrink. Two postures whose free ways meet have a
free way between them; else the middle of the rest is looked at. Only what could shorten the free
way found so far is computed exactly: balls around links and capsules decide the others.
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
from ikservo.kernels.compiled import entry
from ikservo.kinematics.arrays import IntVector, Matrix, Vector
from ikservo.kinematics.packed import CAPSULE_WIDTH, END, LINK, RADIUS, SHAPE_WIDTH, START

FREE = 2.0
"""What ``first_contact`` returns where there is none."""

# Where a ball differs from a capsule: it has no other end, but the capsules that are in it.
FIRST_CAPSULE, LAST_CAPSULE = END, END + 1  # the latter is the one behind them
_PLACED = 3  # entry of a centre: 1 where the capsules of the link are placed

_TOUCH_M = 1e-9
_UNSEEN_M = 0.001  # less than this a pair may come nearer unseen than is allowed
_SAME = 1e-12  # a shorter part of a motion is none
_STACK = 64
_MOST = 20000  # postures between two of a path: at a millimetre each, a way of 20 m


def path_fits(
    links: Matrix,
    capsules: Matrix,
    halves_m: Vector,
    balls: Matrix,
    pairs: Matrix,
    shapes: Matrix,
    floor_m: float,
    reach: Matrix,
    masses: Matrix,
    sag: Matrix,
    places: Matrix,
    ends: Matrix,
    centres: Matrix,
    postures: Matrix,
    rates: Vector,
    allowed: Matrix,
    load: float,
    path: Matrix,
) -> bool:
    """Check whether arrays have the shapes that ``first_contact`` needs, and indices exist."""
    dof, count = path.shape[1], len(links)
    between = allowed.shape[1] - count * (1 + len(shapes))
    if not is_tree(links, dof) or between < 0 or not _are_capsules(capsules, count):
        return False
    if len(balls) != count or not _are_capsules(balls, count) or pairs.shape[1] != 4:
        return False
    for i in range(count):
        first, last = balls[i, FIRST_CAPSULE], balls[i, LAST_CAPSULE]
        if not (first >= 0.0 and first <= last <= len(capsules)):
            return False
    for k in range(len(pairs)):
        first, second, column, after = pairs[k, 0], pairs[k, 1], pairs[k, 2], pairs[k, 3]
        if not (k < after <= len(pairs)):
            return False
        if not (0.0 <= first < len(capsules) and 0.0 <= second < len(capsules)):
            return False
        if not 0.0 <= column < between:
            return False
    return (
        len(halves_m) == len(capsules)
        and shapes.shape[1] == SHAPE_WIDTH
        and floor_m < math.inf
        and len(reach) == between + count
        and reach.shape[1] == dof
        and len(masses) == count
        and masses.shape[1] == 4
        and len(sag) == 3
        and sag.shape[1] == dof
        and len(places) == count
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
    links: Matrix,
    capsules: Matrix,
    halves_m: Vector,
    balls: Matrix,
    pairs: Matrix,
    shapes: Matrix,
    floor_m: float,
    reach: Matrix,
    masses: Matrix,
    sag: Matrix,
    places: Matrix,
    ends: Matrix,
    centres: Matrix,
    postures: Matrix,
    rates: Vector,
    allowed: Matrix,
    load: float,
    path: Matrix,
) -> float:
    """Find a contact on straight ways of the joints through postures (n, dof).

    Args:
        links: One row a link, parents first; see ``kinematics.packed``.
        capsules: One row each, those of a link together.
        halves_m: Half the length of each capsule.
        balls: (links, 8) a ball around the capsules of each link; see ``FIRST_CAPSULE``.
        pairs: (m, 4) rows of two capsules, their column, those of a column together, and the first
            row of the next column.
        shapes: (k, 17) rows of things.
        floor_m: The height of the table; minus infinity where there is none.
        reach: (pairs of links + links, dof) how far each pair comes nearer, at most, and each link
            moves, for each unit of a joint.
        masses: (links, 4) mass [kg] and centre in the link's frame [m].
        sag: (3, dof) how far a joint yields for the torque at 1 m/s², and between which ends.
        places: (links, 12), work array.
        ends: (capsules, 6), work array.
        centres: (links, 4), work array.
        postures: (3, dof), work array.
        rates: (pairs of links + links,), work array.
        allowed: (2, pairs of links + links * (1 + k)) least distances [m]; below, those from things
            of the arm that sags.
        load: Multiple of gravity under which the arm sags; 0 where that is not looked at.
        path: The postures.

    Returns:
        The fraction of the path where something is nearer than allowed, not always the first;
        ``FREE`` where nothing is by more than a millimetre. A way of more than tens of metres is
        not followed to its end, and not free.
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
                links, capsules, halves_m, balls, pairs, shapes, floor_m, masses, sag, places, ends,
                centres, postures, rates, allowed, load, 1.0,
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
                links, capsules, halves_m, balls, pairs, shapes, floor_m, masses, sag, places, ends,
                centres, postures, rates, allowed, load, 1.0,
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
    links: Matrix,
    capsules: Matrix,
    halves_m: Vector,
    balls: Matrix,
    pairs: Matrix,
    shapes: Matrix,
    floor_m: float,
    reach: Matrix,
    masses: Matrix,
    sag: Matrix,
    places: Matrix,
    ends: Matrix,
    centres: Matrix,
    postures: Matrix,
    rates: Vector,
    allowed: Matrix,
    load: float,
    path: Matrix,
    free: IntVector,
) -> bool:
    """Check whether arrays have the shapes that ``free_postures`` needs, and indices exist."""
    return len(free) == len(path) and path_fits(
        links, capsules, halves_m, balls, pairs, shapes, floor_m, reach, masses, sag, places, ends,
        centres, postures, rates, allowed, load, path,
    )  # fmt: skip


@entry(postures_fit)
def free_postures(
    links: Matrix,
    capsules: Matrix,
    halves_m: Vector,
    balls: Matrix,
    pairs: Matrix,
    shapes: Matrix,
    floor_m: float,
    reach: Matrix,
    masses: Matrix,
    sag: Matrix,
    places: Matrix,
    ends: Matrix,
    centres: Matrix,
    postures: Matrix,
    rates: Vector,
    allowed: Matrix,
    load: float,
    path: Matrix,
    free: IntVector,
) -> None:
    """Find which postures (n, dof) keep the allowed distances: 1 in ``free`` (n,), else 0.

    The other arguments are those of ``first_contact``.
    """
    for c in range(len(rates)):
        rates[c] = 0.0
    for n in range(len(path)):
        for j in range(path.shape[1]):
            postures[0, j] = path[n, j]
        found = free_fraction(
            links, capsules, halves_m, balls, pairs, shapes, floor_m, masses, sag, places, ends,
            centres, postures, rates, allowed, load, 0.0,
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
    links: Matrix,
    capsules: Matrix,
    halves_m: Vector,
    balls: Matrix,
    pairs: Matrix,
    shapes: Matrix,
    floor_m: float,
    masses: Matrix,
    sag: Matrix,
    places: Matrix,
    ends: Matrix,
    centres: Matrix,
    postures: Matrix,
    rates: Vector,
    allowed: Matrix,
    load: float,
    most: float,
) -> float:
    """Return which part of the way is free to both sides of the first posture, up to ``most``.

    Negative where something is nearer than allowed.
    """
    place_links(links, postures[0], places)
    _place_balls(balls, places, centres)
    count = len(links)
    between = allowed.shape[1] - count * (1 + len(shapes))
    free = _free_of_things(
        capsules, halves_m, balls, shapes, floor_m, places, ends, centres, rates, allowed, 0,
        between, count, most,
    )  # fmt: skip
    if free < 0.0:
        return free
    free = _free_of_itself(
        capsules, halves_m, balls, pairs, places, ends, centres, rates, allowed, free
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
        capsules, halves_m, balls, shapes, floor_m, places, ends, centres, rates, allowed, 1,
        between, count, free,
    )  # fmt: skip


def _free_of_things(
    capsules: Matrix,
    halves_m: Vector,
    balls: Matrix,
    shapes: Matrix,
    floor_m: float,
    places: Matrix,
    ends: Matrix,
    centres: Matrix,
    rates: Vector,
    allowed: Matrix,
    row: int,
    between: int,
    count: int,
    free: float,
) -> float:
    free = _free_of_floor(
        capsules, balls, floor_m, places, ends, centres, rates, allowed, row, between, free
    )
    if free < 0.0:
        return free
    x, y, z = _middle(balls, centres, 0), _middle(balls, centres, 1), _middle(balls, centres, 2)
    around_m, fastest = _radius_about(balls, centres, x, y, z), 0.0
    for link in range(count):
        fastest = max(fastest, rates[between + link])
    for b in range(len(shapes)):
        clear_m = point_shape_distance(x, y, z, shapes, b) - around_m
        clear_m -= free * fastest
        if clear_m > _largest(allowed, row, between + count * (1 + b), count):
            continue
        for link in range(count):
            if balls[link, RADIUS] <= 0.0:
                continue
            column, rate = between + count * (1 + b) + link, rates[between + link]
            slack_m = point_shape_distance(
                centres[link, 0], centres[link, 1], centres[link, 2], shapes, b
            )
            if not slack_m - balls[link, RADIUS] - allowed[row, column] < free * rate:
                continue
            _place_capsules(capsules, balls, places, ends, centres, link)
            for i in range(int(balls[link, FIRST_CAPSULE]), int(balls[link, LAST_CAPSULE])):
                rest_m = capsules[i, RADIUS] + allowed[row, column]
                slack_m = point_shape_distance(
                    0.5 * (ends[i, 0] + ends[i, 3]),
                    0.5 * (ends[i, 1] + ends[i, 4]),
                    0.5 * (ends[i, 2] + ends[i, 5]),
                    shapes,
                    b,
                )
                if slack_m - halves_m[i] - rest_m < free * rate:
                    if halves_m[i] > 0.0:
                        slack_m = segment_shape_distance(ends, i, shapes, b)
                    free = _shortened(free, slack_m - rest_m, rate)
                    if free < 0.0:
                        return free
    return free


def _free_of_floor(
    capsules: Matrix,
    balls: Matrix,
    floor_m: float,
    places: Matrix,
    ends: Matrix,
    centres: Matrix,
    rates: Vector,
    allowed: Matrix,
    row: int,
    between: int,
    free: float,
) -> float:
    for link in range(len(balls)):
        rate, radius = rates[between + link], balls[link, RADIUS]
        rest_m = floor_m + allowed[row, between + link]
        if radius <= 0.0 or not centres[link, 2] - radius - rest_m < free * rate:
            continue
        _place_capsules(capsules, balls, places, ends, centres, link)
        for i in range(int(balls[link, FIRST_CAPSULE]), int(balls[link, LAST_CAPSULE])):
            slack_m = min(ends[i, 2], ends[i, 5]) - capsules[i, RADIUS] - rest_m
            free = _shortened(free, slack_m, rate)
            if free < 0.0:
                return free
    return free


def _place_balls(balls: Matrix, places: Matrix, centres: Matrix) -> None:
    """Compute the centre of each link's ball; its capsules are placed where they are needed."""
    for i in range(len(balls)):
        for r in range(3):
            centres[i, r] = (
                places[i, 9 + r]
                + places[i, 3 * r] * balls[i, START]
                + places[i, 3 * r + 1] * balls[i, START + 1]
                + places[i, 3 * r + 2] * balls[i, START + 2]
            )
        centres[i, _PLACED] = 0.0


def _place_capsules(
    capsules: Matrix, balls: Matrix, places: Matrix, ends: Matrix, centres: Matrix, link: int
) -> None:
    """Compute the ends of a link's capsules, unless they are known."""
    if centres[link, _PLACED] == 0.0:
        centres[link, _PLACED] = 1.0
        for i in range(int(balls[link, FIRST_CAPSULE]), int(balls[link, LAST_CAPSULE])):
            place_capsule(capsules, i, places, ends)


def _middle(balls: Matrix, centres: Matrix, axis: int) -> float:
    """Return the middle of the links that have capsules, along an axis."""
    low, high = math.inf, -math.inf
    for i in range(len(balls)):
        if balls[i, RADIUS] > 0.0:
            low, high = min(low, centres[i, axis]), max(high, centres[i, axis])
    return 0.5 * (low + high)


def _radius_about(balls: Matrix, centres: Matrix, x: float, y: float, z: float) -> float:
    """Return the radius of the ball about a point that all links are in."""
    radius = 0.0
    for i in range(len(balls)):
        if balls[i, RADIUS] > 0.0:
            u, v, w = centres[i, 0] - x, centres[i, 1] - y, centres[i, 2] - z
            radius = max(radius, math.sqrt(u * u + v * v + w * w) + balls[i, RADIUS])
    return radius


def _largest(allowed: Matrix, row: int, first: int, count: int) -> float:
    """Return the largest distance that a link has to keep from one thing."""
    largest = -math.inf
    for i in range(count):
        largest = max(largest, allowed[row, first + i])
    return largest


def _free_of_itself(
    capsules: Matrix,
    halves_m: Vector,
    balls: Matrix,
    pairs: Matrix,
    places: Matrix,
    ends: Matrix,
    centres: Matrix,
    rates: Vector,
    allowed: Matrix,
    free: float,
) -> float:
    k, is_near = 0, False
    while k < len(pairs):
        column, after = int(pairs[k, 2]), int(pairs[k, 3])
        a, b = int(capsules[int(pairs[k, 0]), LINK]), int(capsules[int(pairs[k, 1]), LINK])
        near_m = balls[a, RADIUS] + balls[b, RADIUS] + allowed[0, column]
        near_m += free * rates[column]
        apart2 = 0.0
        for r in range(3):
            apart2 += (centres[a, r] - centres[b, r]) * (centres[a, r] - centres[b, r])
        if not (near_m > 0.0 and apart2 < near_m * near_m):
            k = after
            continue
        _place_capsules(capsules, balls, places, ends, centres, a)
        _place_capsules(capsules, balls, places, ends, centres, b)
        capsule = -1
        while k < after:
            i, j = int(pairs[k, 0]), int(pairs[k, 1])
            if i != capsule:  # one of the first link, and the ball of the other
                capsule = i
                near_m = capsules[i, RADIUS] + halves_m[i] + balls[b, RADIUS] + allowed[0, column]
                near_m += free * rates[column]
                apart2 = 0.0
                for r in range(3):
                    apart = 0.5 * (ends[i, r] + ends[i, 3 + r]) - centres[b, r]
                    apart2 += apart * apart
                is_near = near_m > 0.0 and apart2 < near_m * near_m
            k += 1
            if not is_near:
                continue
            touch_m = capsules[i, RADIUS] + capsules[j, RADIUS] + allowed[0, column]
            near_m = touch_m + halves_m[i] + halves_m[j] + free * rates[column]
            if near_m > 0.0 and _centre_distance2(ends, i, j) < near_m * near_m:
                gap_m = segment_distance(ends, i, j)
                free = _shortened(free, gap_m - touch_m, rates[column])
                if free < 0.0:
                    return free
    return free


def _centre_distance2(ends: Matrix, i: int, j: int) -> float:
    total = 0.0
    for k in range(3):
        apart = 0.5 * (ends[i, k] + ends[i, 3 + k] - ends[j, k] - ends[j, 3 + k])
        total += apart * apart
    return total


def _shortened(free: float, slack_m: float, rate: float) -> float:
    """Return a free part of the way, shortened to what one distance leaves; -1 in contact."""
    if slack_m < -_TOUCH_M:
        return -1.0
    if slack_m + _UNSEEN_M < free * rate:
        return (max(slack_m, 0.0) + _UNSEEN_M) / rate
    return free
