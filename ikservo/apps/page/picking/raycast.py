"""Ray casting through bounding volumes and shapes, compiled."""

from __future__ import annotations

import math

import numpy as np

from ikservo.apps.page.picking.bvh import COUNT, FIRST, LEFT, RIGHT, ROW_WIDTH
from ikservo.kernels.compiled import entry
from ikservo.kinematics.arrays import IntMatrix, IntVector, Matrix, Vector

_MAX_STACK = 64
_MISS = math.inf
_MIN_DISTANCE_M = -1e-8  # a shape may touch the face of its box, where the ray meets it
_PARALLEL = 1e-12


def cast_fits(
    origins: Matrix,
    directions: Matrix,
    rotations: Matrix,
    link_origins: Matrix,
    link_boxes: Matrix,
    roots: IntVector,
    boxes: Matrix,
    nodes: IntMatrix,
    rows: Matrix,
    distances: Matrix,
    hit_rows: IntMatrix,
) -> bool:
    """Check whether arrays have the shapes that ``raycast`` needs; see ``is_node``, too."""
    rays, links = len(origins), len(roots)
    return (
        origins.shape[1] == 3
        and len(directions) == rays
        and directions.shape[1] == 3
        and len(rotations) == links
        and rotations.shape[1] == 9
        and len(link_origins) == links
        and link_origins.shape[1] == 3
        and len(link_boxes) == links
        and link_boxes.shape[1] == 6
        and len(boxes) == len(nodes)
        and boxes.shape[1] == 6
        and nodes.shape[1] == 4
        and rows.shape[1] == ROW_WIDTH
        and len(distances) == rays
        and distances.shape[1] == links
        and len(hit_rows) == rays
        and hit_rows.shape[1] == links
    )


def is_node(nodes: IntMatrix, node: int, rows: Matrix) -> bool:
    """Check whether a node exists, its children come after it, and its shapes exist.

    A tree is traversed only where a ray leads, so that is where it is checked.
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
    link_origins: Matrix,
    link_boxes: Matrix,
    roots: IntVector,
    boxes: Matrix,
    nodes: IntMatrix,
    rows: Matrix,
    distances: Matrix,
    hit_rows: IntMatrix,
) -> int:
    """Find the first shape of every link on every ray, down the trees of boxes.

    Args:
        origins: The starts of the rays (k, 3), world.
        directions: Unit vectors (k, 3), world.
        rotations: R_world_link of each link (links, 9), row by row.
        link_origins: Origins of the links (links, 3), world.
        link_boxes: The box (links, 6) of each link at its pose, world.
        roots: See ``bvh.BvhForest``, as the four that follow.
        boxes: (nodes, 6).
        nodes: (nodes, 4).
        rows: (n, WIDTH).
        distances: (k, links), filled: the distance along the ray, infinite where it misses.
        hit_rows: (k, links), filled: which row.

    Returns:
        How many shapes were tested.
    """
    tested = 0
    ray = np.empty(6)
    stack = np.empty(_MAX_STACK, np.int64)
    world_ray = np.empty(6)
    nearest = np.empty(2)
    for k in range(len(origins)):
        for i in range(3):
            world_ray[i], world_ray[3 + i] = origins[k, i], directions[k, i]
        for link in range(len(roots)):
            distances[k, link], hit_rows[k, link] = _MISS, -1
            entry_m = _intersect_box(world_ray, link_boxes, link, _MISS)
            if entry_m < _MISS:
                _transform_ray(world_ray, entry_m, rotations, link_origins, link, ray)
                tested += _traverse_tree(ray, roots[link], boxes, nodes, rows, stack, nearest)
                distances[k, link], hit_rows[k, link] = nearest[0] + entry_m, int(nearest[1])
    return tested


def brute_force_fits(origin: Vector, direction: Vector, rows: Matrix, nearest: Vector) -> bool:
    """Check whether arrays have the shapes that ``raycast_brute_force`` needs."""
    return (
        len(origin) == 3
        and len(direction) == 3
        and rows.shape[1] == ROW_WIDTH
        and len(nearest) == 2
    )


@entry(brute_force_fits)
def raycast_brute_force(origin: Vector, direction: Vector, rows: Matrix, nearest: Vector) -> int:
    """Test every shape, without boxes: the reference for ``raycast`` and its benchmark.

    Fills ``nearest`` (2,): the distance along the ray, and which row.
    """
    ray = np.empty(6)
    for i in range(3):
        ray[i], ray[3 + i] = origin[i], direction[i]
    nearest[0], nearest[1] = _MISS, -1.0
    for row in range(len(rows)):
        distance = _intersect_shape(ray, rows, row)
        if distance < nearest[0]:
            nearest[0], nearest[1] = distance, row
    return len(rows)


def _transform_ray(
    world_ray: Vector,
    entry_m: float,
    rotations: Matrix,
    link_origins: Matrix,
    link: int,
    ray: Vector,
) -> None:
    """Take a ray into link coordinates; it starts where the link's box is entered."""
    for i in range(3):
        origin, direction = 0.0, 0.0
        for j in range(3):
            R = rotations[link, 3 * j + i]
            origin += R * (world_ray[j] + entry_m * world_ray[3 + j] - link_origins[link, j])
            direction += R * world_ray[3 + j]
        ray[i], ray[3 + i] = origin, direction


def _traverse_tree(
    ray: Vector,
    root: int,
    boxes: Matrix,
    nodes: IntMatrix,
    rows: Matrix,
    stack: IntVector,
    nearest: Vector,
) -> int:
    """Find the first shape of one tree; boxes behind a shape found before are skipped."""
    nearest[0], nearest[1] = _MISS, -1.0
    tested, top = 0, 1
    stack[0] = root
    while top > 0:
        top -= 1
        node = stack[top]
        if not is_node(nodes, node, rows):
            continue
        if _intersect_box(ray, boxes, node, nearest[0]) == _MISS:
            continue
        if nodes[node, COUNT] > 0:
            for row in range(nodes[node, FIRST], nodes[node, FIRST] + nodes[node, COUNT]):
                tested += 1
                distance = _intersect_shape(ray, rows, row)
                if distance < nearest[0]:
                    nearest[0], nearest[1] = distance, row
        elif top < _MAX_STACK - 1:
            top = _push_children(ray, node, boxes, nodes, stack, top, nearest[0])
    return tested


def _push_children(
    ray: Vector,
    node: int,
    boxes: Matrix,
    nodes: IntMatrix,
    stack: IntVector,
    top: int,
    limit: float,
) -> int:
    """Push the children that the ray meets, the nearer one on top."""
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
    if max(to_left, to_right) < _MISS:
        stack[top] = first
        top += 1
    if min(to_left, to_right) < _MISS:
        stack[top] = second
        top += 1
    return top


def _intersect_box(ray: Vector, boxes: Matrix, node: int, limit: float) -> float:
    """Compute the distance at which a ray meets a box, 0 inside; infinite from ``limit`` on."""
    entry_m, exit_m = 0.0, limit
    for i in range(3):
        origin, direction = ray[i], ray[3 + i]
        low, high = boxes[node, i], boxes[node, 3 + i]
        if abs(direction) < _PARALLEL:
            if origin < low or origin > high:
                return _MISS
            continue
        one, other = (low - origin) / direction, (high - origin) / direction
        entry_m = max(entry_m, min(one, other))
        exit_m = min(exit_m, max(one, other))
    return entry_m if entry_m <= exit_m else _MISS


def _intersect_shape(ray: Vector, rows: Matrix, row: int) -> float:
    """Return the distance at which a ray meets the front of a shape; infinite if it misses."""
    if rows[row, 0] == 1.0:
        return _intersect_triangle(ray, rows, row)
    return _intersect_capsule(ray, rows, row)


def _intersect_capsule(ray: Vector, rows: Matrix, row: int) -> float:
    """Solve |o + t d - (a + s (b - a))| = r for the side first, then for the sphere at its end."""
    bb = bd = bo = do = oo = 0.0
    for i in range(3):
        a, d = rows[row, 1 + i], ray[3 + i]
        b, o = rows[row, 4 + i] - a, ray[i] - a
        bb, bd, bo = bb + b * b, bd + b * d, bo + b * o
        do, oo = do + d * o, oo + o * o
    r2 = rows[row, 7] * rows[row, 7]
    A = bb - bd * bd
    if _PARALLEL * bb >= A or bb == 0.0:  # a sphere, or a ray along the capsule's axis
        return min(
            _intersect_sphere(ray, rows, row, 1, r2), _intersect_sphere(ray, rows, row, 4, r2)
        )
    B = bb * do - bo * bd
    discriminant = B * B - A * (bb * oo - bo * bo - r2 * bb)
    if discriminant < 0.0:
        return _MISS
    distance = (-B - math.sqrt(discriminant)) / A
    along = bo + distance * bd
    if 0.0 < along < bb:
        return distance if distance >= _MIN_DISTANCE_M else _MISS
    return _intersect_sphere(ray, rows, row, 1 if along <= 0.0 else 4, r2)


def _intersect_sphere(ray: Vector, rows: Matrix, row: int, centre: int, r2: float) -> float:
    do = oo = 0.0
    for i in range(3):
        o = ray[i] - rows[row, centre + i]
        do, oo = do + ray[3 + i] * o, oo + o * o
    discriminant = do * do - oo + r2
    if discriminant < 0.0:
        return _MISS
    distance = -do - math.sqrt(discriminant)
    return distance if distance >= _MIN_DISTANCE_M else _MISS


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
        return _MISS
    u = (ox * px + oy * py + oz * pz) / volume
    qx, qy, qz = oy * ez - oz * ey, oz * ex - ox * ez, ox * ey - oy * ex
    v = (dx * qx + dy * qy + dz * qz) / volume
    if not (u >= 0.0 and v >= 0.0 and u + v <= 1.0):
        return _MISS
    distance = (fx * qx + fy * qy + fz * qz) / volume
    return distance if distance >= _MIN_DISTANCE_M else _MISS
