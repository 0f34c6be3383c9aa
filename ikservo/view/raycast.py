"""Ray casting through bounding volumes and shapes, compiled."""

from __future__ import annotations

import math

import numpy as np

from ikservo.ik.kernel.compiled import entry
from ikservo.kinematics.arrays import IntMatrix, IntVector, Matrix, Vector
from ikservo.view.bvh import COUNT, FIRST, LEFT, RIGHT, ROW_WIDTH

__all__ = ["is_node", "raycast", "raycast_brute_force"]

_MAX_STACK = 64
_NONE = math.inf
_BEFORE_M = -1e-8  # a shape may touch the face of its box, where the ray enters it
_PARALLEL = 1e-12


def cast_fits(
    origins: Matrix,
    directions: Matrix,
    rotations: Matrix,
    places: Matrix,
    around: Matrix,
    roots: IntVector,
    boxes: Matrix,
    nodes: IntMatrix,
    rows: Matrix,
    ways: Matrix,
    hit: IntMatrix,
) -> bool:
    """Return whether arrays have the shapes that ``raycast`` needs; see ``is_node``, too."""
    rays, links = len(origins), len(roots)
    return (
        origins.shape[1] == 3
        and len(directions) == rays
        and directions.shape[1] == 3
        and len(rotations) == links
        and rotations.shape[1] == 9
        and len(places) == links
        and places.shape[1] == 3
        and len(around) == links
        and around.shape[1] == 6
        and len(boxes) == len(nodes)
        and boxes.shape[1] == 6
        and nodes.shape[1] == 4
        and rows.shape[1] == ROW_WIDTH
        and len(ways) == rays
        and ways.shape[1] == links
        and len(hit) == rays
        and hit.shape[1] == links
    )


def is_node(nodes: IntMatrix, node: int, rows: Matrix) -> bool:
    """Return whether a node exists, its children come after it, and its shapes exist.

    A tree is only looked at where a ray leads, so that is where it is checked.
    """
    if not 0 <= node < len(nodes):
        return False
    first, count = nodes[node, FIRST], nodes[node, COUNT]
    if count > 0:
        return first >= 0 and first <= len(rows) and count <= len(rows) - first
    return nodes[node, LEFT] > node and nodes[node, RIGHT] > node


@entry(cast_fits)
def raycast(
    origins: Matrix,
    directions: Matrix,
    rotations: Matrix,
    places: Matrix,
    around: Matrix,
    roots: IntVector,
    boxes: Matrix,
    nodes: IntMatrix,
    rows: Matrix,
    ways: Matrix,
    hit: IntMatrix,
) -> int:
    """Find the first shape of every link on every ray, down the trees of boxes.

    Args:
        origins: Where the rays start (k, 3), world.
        directions: Unit vectors (k, 3), world.
        rotations: R_world_link of each link (links, 9), row by row.
        places: Origins of the links (links, 3), world.
        around: The box (links, 6) around each link where it is now, world.
        roots: See ``bvh.BvhForest``, as the four that follow.
        boxes: (nodes, 6).
        nodes: (nodes, 4).
        rows: (n, WIDTH).
        ways: (k, links), filled: how far along the ray, infinite where it misses.
        hit: (k, links), filled: which row.

    Returns:
        How many shapes were looked at.
    """
    looked = 0
    ray = np.empty(6)
    stack = np.empty(_MAX_STACK, np.int64)
    far = np.empty(6)
    near = np.empty(2)
    for k in range(len(origins)):
        for i in range(3):
            far[i], far[3 + i] = origins[k, i], directions[k, i]
        for link in range(len(roots)):
            ways[k, link], hit[k, link] = _NONE, -1
            enter = _intersect_box(far, around, link, _NONE)
            if enter < _NONE:
                _transform_ray(far, enter, rotations, places, link, ray)
                looked += _traverse_tree(ray, roots[link], boxes, nodes, rows, stack, near)
                ways[k, link], hit[k, link] = near[0] + enter, int(near[1])
    return looked


def brute_force_fits(origin: Vector, direction: Vector, rows: Matrix, nearest: Vector) -> bool:
    """Return whether arrays have the shapes that ``raycast_brute_force`` needs."""
    return (
        len(origin) == 3
        and len(direction) == 3
        and rows.shape[1] == ROW_WIDTH
        and len(nearest) == 2
    )


@entry(brute_force_fits)
def raycast_brute_force(origin: Vector, direction: Vector, rows: Matrix, nearest: Vector) -> int:
    """Look at every shape in turn, without boxes: the reference for ``raycast`` and its benchmark.

    Fills ``nearest`` (2,): how far along the ray, and which row.
    """
    ray = np.empty(6)
    for i in range(3):
        ray[i], ray[3 + i] = origin[i], direction[i]
    nearest[0], nearest[1] = _NONE, -1.0
    for row in range(len(rows)):
        way = _intersect_shape(ray, rows, row)
        if way < nearest[0]:
            nearest[0], nearest[1] = way, row
    return len(rows)


def _transform_ray(
    far: Vector, enter: float, rotations: Matrix, places: Matrix, link: int, ray: Vector
) -> None:
    """Take a ray into link coordinates; it starts where it enters the link's box."""
    for i in range(3):
        start, way = 0.0, 0.0
        for j in range(3):
            R = rotations[link, 3 * j + i]
            start += R * (far[j] + enter * far[3 + j] - places[link, j])
            way += R * far[3 + j]
        ray[i], ray[3 + i] = start, way


def _traverse_tree(
    ray: Vector,
    root: int,
    boxes: Matrix,
    nodes: IntMatrix,
    rows: Matrix,
    stack: IntVector,
    near: Vector,
) -> int:
    """Find the first shape of one tree; boxes behind what is found already are left out."""
    near[0], near[1] = _NONE, -1.0
    looked, top = 0, 1
    stack[0] = root
    while top > 0:
        top -= 1
        node = stack[top]
        if not is_node(nodes, node, rows):
            continue
        if _intersect_box(ray, boxes, node, near[0]) == _NONE:
            continue
        if nodes[node, COUNT] > 0:
            for row in range(nodes[node, FIRST], nodes[node, FIRST] + nodes[node, COUNT]):
                looked += 1
                way = _intersect_shape(ray, rows, row)
                if way < near[0]:
                    near[0], near[1] = way, row
        elif top < _MAX_STACK - 1:
            top = _push_children(ray, node, boxes, nodes, stack, top, near[0])
    return looked


def _push_children(
    ray: Vector,
    node: int,
    boxes: Matrix,
    nodes: IntMatrix,
    stack: IntVector,
    top: int,
    limit: float,
) -> int:
    """Put the children that are met on the stack, the nearer one on top."""
    left, right = nodes[node, LEFT], nodes[node, RIGHT]
    if left >= len(nodes) or right >= len(nodes):
        return top
    to_left, to_right = (
        _intersect_box(ray, boxes, left, limit),
        _intersect_box(ray, boxes, right, limit),
    )
    first, second = right, left
    if to_left > to_right:
        first, second = left, right
    if max(to_left, to_right) < _NONE:
        stack[top] = first
        top += 1
    if min(to_left, to_right) < _NONE:
        stack[top] = second
        top += 1
    return top


def _intersect_box(ray: Vector, boxes: Matrix, node: int, limit: float) -> float:
    """Return how far along a ray it enters a box, 0 inside; infinite if not before ``limit``."""
    enter, leave = 0.0, limit
    for i in range(3):
        start, way = ray[i], ray[3 + i]
        low, high = boxes[node, i], boxes[node, 3 + i]
        if abs(way) < _PARALLEL:
            if start < low or start > high:
                return _NONE
            continue
        one, other = (low - start) / way, (high - start) / way
        enter = max(enter, min(one, other))
        leave = min(leave, max(one, other))
    return enter if enter <= leave else _NONE


def _intersect_shape(ray: Vector, rows: Matrix, row: int) -> float:
    """Return how far along a ray it meets the near side of a shape; infinite if it does not."""
    if rows[row, 0] == 1.0:
        return _intersect_triangle(ray, rows, row)
    return _intersect_capsule(ray, rows, row)


def _intersect_capsule(ray: Vector, rows: Matrix, row: int) -> float:
    """Solve |o + t d - (a + s (b - a))| = r for the side first, then for the ball it leads to."""
    bb = bd = bo = do = oo = 0.0
    for i in range(3):
        a, d = rows[row, 1 + i], ray[3 + i]
        b, o = rows[row, 4 + i] - a, ray[i] - a
        bb, bd, bo = bb + b * b, bd + b * d, bo + b * o
        do, oo = do + d * o, oo + o * o
    r2 = rows[row, 7] * rows[row, 7]
    A = bb - bd * bd
    if _PARALLEL * bb >= A or bb == 0.0:  # a ball, or a ray along the capsule's axis
        return min(
            _intersect_sphere(ray, rows, row, 1, r2), _intersect_sphere(ray, rows, row, 4, r2)
        )
    B = bb * do - bo * bd
    under = B * B - A * (bb * oo - bo * bo - r2 * bb)
    if under < 0.0:
        return _NONE
    way = (-B - math.sqrt(under)) / A
    along = bo + way * bd
    if 0.0 < along < bb:
        return way if way >= _BEFORE_M else _NONE
    return _intersect_sphere(ray, rows, row, 1 if along <= 0.0 else 4, r2)


def _intersect_sphere(ray: Vector, rows: Matrix, row: int, centre: int, r2: float) -> float:
    do = oo = 0.0
    for i in range(3):
        o = ray[i] - rows[row, centre + i]
        do, oo = do + ray[3 + i] * o, oo + o * o
    under = do * do - oo + r2
    if under < 0.0:
        return _NONE
    way = -do - math.sqrt(under)
    return way if way >= _BEFORE_M else _NONE


def _intersect_triangle(ray: Vector, rows: Matrix, row: int) -> float:
    """Solve o + t d = a + u e + v f (Möller and Trumbore, 1997); either side counts."""
    ox, oy, oz = ray[0] - rows[row, 1], ray[1] - rows[row, 2], ray[2] - rows[row, 3]
    dx, dy, dz = ray[3], ray[4], ray[5]
    ex, ey, ez = (
        rows[row, 4] - rows[row, 1], rows[row, 5] - rows[row, 2], rows[row, 6] - rows[row, 3],
    )  # fmt: skip
    fx, fy, fz = (
        rows[row, 7] - rows[row, 1], rows[row, 8] - rows[row, 2], rows[row, 9] - rows[row, 3],
    )  # fmt: skip
    px, py, pz = dy * fz - dz * fy, dz * fx - dx * fz, dx * fy - dy * fx
    volume = ex * px + ey * py + ez * pz
    if volume == 0.0:
        return _NONE
    u = (ox * px + oy * py + oz * pz) / volume
    qx, qy, qz = oy * ez - oz * ey, oz * ex - ox * ez, ox * ey - oy * ex
    v = (dx * qx + dy * qy + dz * qz) / volume
    if not (u >= 0.0 and v >= 0.0 and u + v <= 1.0):
        return _NONE
    way = (fx * qx + fy * qy + fz * qz) / volume
    return way if way >= _BEFORE_M else _NONE
