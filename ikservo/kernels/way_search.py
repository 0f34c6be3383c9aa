"""Search for paths around obstacles, compiled: RRT-Connect, or CBiRRT for a constrained tool.

Two trees of straight motions grow, one from the start and one from the goals, until they meet
(Kuffner and LaValle 2000). If the tool is constrained, they grow in short steps, each of which is
projected back to the constraint (Berenson and others 2009). Motions are checked at samples;
``first_contact`` proves that the final motions are free.
"""

from __future__ import annotations

import math

import numpy as np

from ikservo.kernels.compiled import entry
from ikservo.kernels.free_path import free_fraction, path_fits
from ikservo.kernels.tool_limits import keeps_limits, limits_fit, project_tool
from ikservo.kinematics.arrays import IntMatrix, IntVector, Matrix, Vector

# The entries of ``state``: two random numbers, the sizes of both trees, the nodes of both trees at
# which they met (-1: not yet), the number of postures checked, and what the last blocked posture
# touched (see ``free_fraction``; -1: nothing yet), because the next postures often touch the same.
CHANCE, SIZES, MET, LOOKED, HIT, STATE_SIZE = 0, 2, 4, 6, 7, 8
# The rows of ``buffer``: the random target, the end of a motion, and a posture on it.
AIM, NEW, MIDDLE, BUFFER_ROWS = 0, 1, 2, 3

_REACH_RAD = 0.5  # length of one motion of a tree
# One projected step of a tree: its length; as multiples of this length, the smallest approach to
# the target and the largest displacement by the projection.
_STEP_RAD = 0.3
_NEARER = 0.1
_FURTHEST = 2.0
# Targets of such steps lie up to this fraction of the range beyond the limits, and are then
# clipped: many postures that keep a constraint have a joint at a limit.
_BEYOND = 0.3
_CUTS, _FAILED_CUTS = 60, 15  # shortcuts tried on a path; largest number of consecutive failures
_HALVED = 8  # fraction of the remaining corners left out of longer paths at once
_MOST_SAMPLES = 1e6  # samples of one motion
_TURN_RAD = 0.05  # largest turn between two samples with a constrained tool
# Two random number generators, which are combined (L'Ecuyer 1988).
_FACTOR_A, _MODULUS_A = 40014, 2147483563
_FACTOR_B, CHANCES = 40692, 2147483399  # the second one is the upper bound of seeds


def search_fits(
    links: Matrix, capsules: Matrix, spheres: Matrix, balls: Matrix, pairs: IntMatrix,
    shapes: Matrix, boxes: Matrix, floor_m: float, reach: Matrix, masses: Matrix, sag: Matrix,
    places: Matrix, ends: Matrix, centres: Matrix, postures: Matrix, rates: Vector, allowed: Matrix,
    load: float, body: Matrix, limits: Matrix, arm: Matrix, projected: Matrix, kept: Matrix,
    tool: Matrix, work: Matrix, joints: Vector, buffer: Matrix, nodes: Matrix, parents: IntVector,
    state: IntVector, step_m: float, most: int,
) -> bool:  # fmt: skip
    """Check whether arrays have the shapes that ``grow_trees`` needs, and their indices exist."""
    n, half = nodes.shape[1], len(nodes) // 2
    point = np.empty(3)
    if len(buffer) != BUFFER_ROWS or buffer.shape[1] != n or len(state) != STATE_SIZE:
        return False
    hit = state[HIT]
    if body.shape[1] != 3 or tool.shape[1] != 2 or kept.shape[1] != projected.shape[1]:
        return False
    for j in range(len(body)):
        column = body[j, 0]
        if not -1.0 <= column < n:
            return False
    for j in range(len(tool)):
        column = tool[j, 0]
        if not 0.0 <= column < n:
            return False
    for i in range(2):
        size, chance = state[SIZES + i], state[CHANCE + i]
        if not (size >= 1 and size <= half and chance >= 1 and chance < CHANCES):
            return False
    if len(projected) > 0 and not (
        len(joints) == len(tool)
        and len(kept) == len(projected)
        and limits_fit(arm, projected, work, point, False, joints)
    ):
        return False
    return (
        len(body) == postures.shape[1]
        and -1 <= hit < len(pairs) + len(balls)
        and len(limits) == 2
        and limits.shape[1] == n
        and len(parents) == len(nodes)
        and 1e-5 <= step_m < math.inf
        and path_fits(
            links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, reach, masses, sag,
            places, ends, centres, postures, rates, allowed, load, postures,
        )
    )  # fmt: skip


@entry(search_fits)
def grow_trees(
    links: Matrix, capsules: Matrix, spheres: Matrix, balls: Matrix, pairs: IntMatrix,
    shapes: Matrix, boxes: Matrix, floor_m: float, reach: Matrix, masses: Matrix, sag: Matrix,
    places: Matrix, ends: Matrix, centres: Matrix, postures: Matrix, rates: Vector, allowed: Matrix,
    load: float, body: Matrix, limits: Matrix, arm: Matrix, projected: Matrix, kept: Matrix,
    tool: Matrix, work: Matrix, joints: Vector, buffer: Matrix, nodes: Matrix, parents: IntVector,
    state: IntVector, step_m: float, most: int,
) -> bool:  # fmt: skip
    """Let two trees grow until they meet.

    The arguments up to ``load`` are those of ``first_contact``. The others:

    body: (dof, 3) for each joint of the body: its column in a posture, or -1 if it does not move;
    the unit of that column; its position if it does not move. limits: (2, n) lowest and highest
    postures of the search. arm: The packed chain of a constrained tool. projected: (k, 8) limits of
    the tool onto which postures are projected; no rows for a free tool. kept: (k, 8) limits of the
    tool that are checked on a motion. tool: (dof of the chain, 2) column and unit of the chain's
    joints. work: The work array of the chain. joints: (dof of the chain,), work array. buffer: (3,
    n), work array. nodes: (2 m, n) the postures of the first tree, and from row m on those of the
    second. parents: (2 m,) the row of the node from which each node was reached; -1 for a root.
    state: (8,) state of the search, see above, from which it continues. step_m: Largest motion of
    any point of the arm between two samples of a motion. most: Number of checked postures after
    which the search pauses, at the end of a step.

    Returns:
        Whether the trees met; also False if a tree is full.
    """
    for c in range(len(rates)):
        rates[c] = 0.0
    aim, half = buffer[AIM], len(nodes) // 2
    wide = _BEYOND if len(projected) > 0 else 0.0
    while state[MET] < 0 and state[LOOKED] < most:
        if max(state[SIZES], state[SIZES + 1]) >= half:
            return False
        for j in range(nodes.shape[1]):
            part = _chance(state)
            low, high = limits[0, j], limits[1, j]
            aim[j] = min(max(low + (part * (1.0 + 2.0 * wide) - wide) * (high - low), low), high)
        one = 0 if state[SIZES] <= state[SIZES + 1] else 1  # the smaller tree is next
        reached = _grow(
            links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, reach, masses, sag,
            places, ends, centres, postures, rates, allowed, load, body, limits, arm, projected,
            kept, tool, work, joints, buffer, nodes, parents, state, step_m, most, one,
        )  # fmt: skip
        for j in range(nodes.shape[1]):
            aim[j] = nodes[reached, j]
        met = _grow(
            links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, reach, masses, sag,
            places, ends, centres, postures, rates, allowed, load, body, limits, arm, projected,
            kept, tool, work, joints, buffer, nodes, parents, state, step_m, most, 1 - one,
        )  # fmt: skip
        if _distance(nodes[met], aim) == 0.0:
            state[MET + one], state[MET + 1 - one] = reached, met
    return state[MET] >= 0


def _grow(
    links: Matrix, capsules: Matrix, spheres: Matrix, balls: Matrix, pairs: IntMatrix,
    shapes: Matrix, boxes: Matrix, floor_m: float, reach: Matrix, masses: Matrix, sag: Matrix,
    places: Matrix, ends: Matrix, centres: Matrix, postures: Matrix, rates: Vector, allowed: Matrix,
    load: float, body: Matrix, limits: Matrix, arm: Matrix, projected: Matrix, kept: Matrix,
    tool: Matrix, work: Matrix, joints: Vector, buffer: Matrix, nodes: Matrix, parents: IntVector,
    state: IntVector, step_m: float, most: int, tree: int,
) -> int:  # fmt: skip
    """Grow a tree towards the target as far as motions are free; return the node where it ends."""
    aim, new, half = buffer[AIM], buffer[NEW], len(nodes) // 2
    first = tree * half
    at, nearest = first, math.inf
    for i in range(first, first + state[SIZES + tree]):
        apart = 0.0
        for j in range(nodes.shape[1]):
            apart += (nodes[i, j] - aim[j]) * (nodes[i, j] - aim[j])
        if apart < nearest:
            at, nearest = i, apart
    left = math.sqrt(nearest)
    while left > 0.0 and state[SIZES + tree] < half:
        start = nodes[at]
        longest = _STEP_RAD if len(projected) > 0 else _REACH_RAD
        part = 1.0 if left <= longest else longest / left
        for j in range(nodes.shape[1]):
            new[j] = aim[j] if part == 1.0 else start[j] + part * (aim[j] - start[j])
        if part < 1.0 and len(projected) > 0:
            state[LOOKED] += 1
            if not _project(arm, projected, tool, work, joints, new):
                break
            if _distance(new, aim) > left - _NEARER * longest:
                break
            if _distance(new, start) >= _FURTHEST * longest:
                break
        if not _is_motion_free(
            links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, reach, masses, sag,
            places, ends, centres, postures, rates, allowed, load, body, limits, arm, projected,
            kept, tool, work, joints, buffer, nodes, parents, state, step_m, most, start, new,
        ):  # fmt: skip
            break
        row = first + state[SIZES + tree]
        for j in range(nodes.shape[1]):
            nodes[row, j] = new[j]
        parents[row] = at
        state[SIZES + tree] += 1
        at, left = row, _distance(new, aim)
    return at


@entry(search_fits)
def shorten_way(
    links: Matrix, capsules: Matrix, spheres: Matrix, balls: Matrix, pairs: IntMatrix,
    shapes: Matrix, boxes: Matrix, floor_m: float, reach: Matrix, masses: Matrix, sag: Matrix,
    places: Matrix, ends: Matrix, centres: Matrix, postures: Matrix, rates: Vector, allowed: Matrix,
    load: float, body: Matrix, limits: Matrix, arm: Matrix, projected: Matrix, kept: Matrix,
    tool: Matrix, work: Matrix, joints: Vector, buffer: Matrix, nodes: Matrix, parents: IntVector,
    state: IntVector, step_m: float, most: int,
) -> bool:  # fmt: skip
    """Shorten a path by straight motions between its corners, and between random points on it.

    The path is in the first rows of ``nodes``, as many as the size of the first tree; the shortened
    path replaces it. The other arguments are those of ``grow_trees``. Always returns True.
    """
    for c in range(len(rates)):
        rates[c] = 0.0
    _cut_corners(
        links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, reach, masses, sag, places,
        ends, centres, postures, rates, allowed, load, body, limits, arm, projected, kept, tool,
        work, joints, buffer, nodes, parents, state, step_m, most,
    )  # fmt: skip
    one, other, failed = buffer[AIM], buffer[NEW], 0
    for _ in range(_CUTS):
        if state[SIZES] == 2 or failed == _FAILED_CUTS:
            break
        total = 0.0
        for i in range(state[SIZES] - 1):
            total += _distance(nodes[i], nodes[i + 1])
        first = _chance(state)
        second = _chance(state)
        i = _point_along(nodes, total * min(first, second), one)
        k = _point_along(nodes, total * max(first, second), other)
        failed += 1
        if i < k and state[SIZES] < len(nodes) and _is_motion_free(
            links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, reach, masses, sag,
            places, ends, centres, postures, rates, allowed, load, body, limits, arm, projected,
            kept, tool, work, joints, buffer, nodes, parents, state, step_m, most, one, other,
        ):  # fmt: skip
            failed = 0
            _move_rows(nodes, state, k + 1, i + 3)
            for j in range(nodes.shape[1]):
                nodes[i + 1, j], nodes[i + 2, j] = one[j], other[j]
    _cut_corners(
        links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, reach, masses, sag, places,
        ends, centres, postures, rates, allowed, load, body, limits, arm, projected, kept, tool,
        work, joints, buffer, nodes, parents, state, step_m, most,
    )  # fmt: skip
    return True


def _cut_corners(
    links: Matrix, capsules: Matrix, spheres: Matrix, balls: Matrix, pairs: IntMatrix,
    shapes: Matrix, boxes: Matrix, floor_m: float, reach: Matrix, masses: Matrix, sag: Matrix,
    places: Matrix, ends: Matrix, centres: Matrix, postures: Matrix, rates: Vector, allowed: Matrix,
    load: float, body: Matrix, limits: Matrix, arm: Matrix, projected: Matrix, kept: Matrix,
    tool: Matrix, work: Matrix, joints: Vector, buffer: Matrix, nodes: Matrix, parents: IntVector,
    state: IntVector, step_m: float, most: int,
) -> None:  # fmt: skip
    """Remove the corners of a path that straight motions can bypass."""
    i = 0
    while i < state[SIZES] - 2:
        k = state[SIZES] - 1
        while k > i + 1:
            one, other = nodes[i], nodes[k]
            if _is_motion_free(
                links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, reach, masses, sag,
                places, ends, centres, postures, rates, allowed, load, body, limits, arm, projected,
                kept, tool, work, joints, buffer, nodes, parents, state, step_m, most, one, other,
            ):  # fmt: skip
                break
            k -= max(1, (k - i) // _HALVED)
        _move_rows(nodes, state, k, i + 1)
        i += 1


def _point_along(nodes: Matrix, distance: float, point: Vector) -> int:
    """Fill in the point at a distance along a path; return the row before it."""
    i, length = 0, _distance(nodes[0], nodes[1])
    while distance > length and i < len(nodes) - 2:
        distance -= length
        i += 1
        length = _distance(nodes[i], nodes[i + 1])
    part = min(distance / length, 1.0) if length > 0.0 else 0.0
    for j in range(nodes.shape[1]):
        point[j] = nodes[i, j] + part * (nodes[i + 1, j] - nodes[i, j])
    return i


def _move_rows(nodes: Matrix, state: IntVector, first: int, to: int) -> None:
    """Move the rows of a path from ``first`` on so that they begin at another row."""
    count = state[SIZES] - first
    for k in range(count):
        i = k if to < first else count - 1 - k
        for j in range(nodes.shape[1]):
            nodes[to + i, j] = nodes[first + i, j]
    state[SIZES] += to - first


def _is_motion_free(
    links: Matrix, capsules: Matrix, spheres: Matrix, balls: Matrix, pairs: IntMatrix,
    shapes: Matrix, boxes: Matrix, floor_m: float, reach: Matrix, masses: Matrix, sag: Matrix,
    places: Matrix, ends: Matrix, centres: Matrix, postures: Matrix, rates: Vector, allowed: Matrix,
    load: float, body: Matrix, limits: Matrix, arm: Matrix, projected: Matrix, kept: Matrix,
    tool: Matrix, work: Matrix, joints: Vector, buffer: Matrix, nodes: Matrix, parents: IntVector,
    state: IntVector, step_m: float, most: int, start: Vector, end: Vector,
) -> bool:  # fmt: skip
    """Check whether a straight motion is free: at its end, its middle, its quarters and so on."""
    count, gap = _sample_count(links, reach, body, projected, step_m, start, end), 2
    while gap < 2 * count:
        gap *= 2
    at, past = count, count + 1
    middle = buffer[MIDDLE]
    while gap > 1:
        while at < past:
            for j in range(nodes.shape[1]):
                middle[j] = start[j] + at / count * (end[j] - start[j])
            state[LOOKED] += 1
            if len(projected) > 0 and not _keeps_tool(arm, kept, tool, work, joints, middle):
                return False
            for j in range(len(body)):
                moves = body[j, 0] >= 0.0
                postures[0, j] = body[j, 1] * middle[int(body[j, 0])] if moves else body[j, 2]
            free = free_fraction(
                links, capsules, spheres, balls, pairs, shapes, boxes, floor_m, masses, sag, places,
                ends, centres, postures, rates, allowed, load, 0.0, int(state[HIT]),
            )  # fmt: skip
            if free < 0.0:
                state[HIT] = int(-1.0 - free)
                return False
            at += gap
        gap = gap // 2
        at, past = gap // 2, count
    return True


def _sample_count(
    links: Matrix, reach: Matrix, body: Matrix, projected: Matrix, step_m: float, start: Vector,
    end: Vector,
) -> int:  # fmt: skip
    """Return the number of steps into which a motion is divided."""
    farthest_m, turned_rad = 0.0, 0.0
    for i in range(len(reach) - len(links), len(reach)):
        moved_m = 0.0
        for j in range(len(body)):
            if body[j, 0] >= 0.0:
                k = int(body[j, 0])
                moved_m += reach[i, j] * abs(body[j, 1] * (end[k] - start[k]))
        farthest_m = max(farthest_m, moved_m)
    if len(projected) > 0:
        for j in range(len(start)):
            turned_rad = max(turned_rad, abs(end[j] - start[j]))
    return 1 + int(min(max(farthest_m / step_m, turned_rad / _TURN_RAD), _MOST_SAMPLES))


def _project(
    arm: Matrix, projected: Matrix, tool: Matrix, work: Matrix, joints: Vector, q: Vector
) -> bool:
    """Move a posture to where the tool keeps its constraint; return whether that succeeds."""
    point = np.empty(3)
    for k in range(3):
        point[k] = 0.0
    for i in range(len(tool)):
        joints[i] = tool[i, 1] * q[int(tool[i, 0])]
    found = project_tool(arm, projected, work, point, False, joints)
    for i in range(len(tool)):
        q[int(tool[i, 0])] = joints[i] / tool[i, 1]
    return found


def _keeps_tool(
    arm: Matrix, kept: Matrix, tool: Matrix, work: Matrix, joints: Vector, q: Vector
) -> bool:
    for i in range(len(tool)):
        joints[i] = tool[i, 1] * q[int(tool[i, 0])]
    return keeps_limits(arm, kept, work, joints)


def _distance(a: Vector, b: Vector) -> float:
    total = 0.0
    for j in range(len(a)):
        total += (a[j] - b[j]) * (a[j] - b[j])
    return math.sqrt(total)


def _chance(state: IntVector) -> float:
    """Return the next random number between 0 and 1."""
    state[CHANCE] = _FACTOR_A * state[CHANCE] % _MODULUS_A
    state[CHANCE + 1] = _FACTOR_B * state[CHANCE + 1] % CHANCES
    drawn = state[CHANCE] - state[CHANCE + 1]
    return (drawn if drawn > 0 else drawn + _MODULUS_A - 1) / _MODULUS_A
