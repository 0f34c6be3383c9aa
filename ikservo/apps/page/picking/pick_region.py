"""Links in a square of pixels, compiled and exact.

The lines of sight through a square of pixels are a pyramid (a prism without perspective). A link
falls in the square where a shape of it meets that body: nothing is sampled, so a wire thinner than
a pixel is found wherever it is. View coordinates are right, up and depth; an image point is
right and up over depth (right and up themselves without perspective), counted from the pointer.
"""

from __future__ import annotations

import math

import numpy as np

from ikservo.apps.page.picking.bvh import COUNT, FIRST, LEFT, ROW_WIDTH
from ikservo.apps.page.picking.bvh import RIGHT as RIGHT_CHILD
from ikservo.apps.page.picking.raycast import is_node
from ikservo.kernels.compiled import entry
from ikservo.kinematics.arrays import IntMatrix, IntVector, Matrix, Vector

# A result: distance from the pointer (of the larger coordinate), place in the image, depth, row.
OFFSET, RIGHT, UP, DEPTH, ROW = 0, 1, 2, 3, 4

_MAX_STACK = 64
_MISS = math.inf
_MIN_DEPTH_M = 1e-3
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_SEARCH_TOLERANCE = 1e-10
_DIAGONAL = math.sqrt(2.0)


def square_fits(
    T_view_link: Matrix,
    pointer: Vector,
    half: float,
    roots: IntVector,
    boxes: Matrix,
    nodes: IntMatrix,
    rows: Matrix,
    found: Matrix,
) -> bool:
    """Check whether arrays have the shapes that ``find_in_square`` needs; half is not NaN."""
    return (
        len(T_view_link) == len(roots)
        and T_view_link.shape[1] == 12
        and len(pointer) == 3
        and half == half  # noqa: PLR0124  # no NaN
        and len(boxes) == len(nodes)
        and boxes.shape[1] == 6
        and nodes.shape[1] == 4
        and rows.shape[1] == ROW_WIDTH
        and len(found) == len(roots)
        and found.shape[1] == 5
    )


@entry(square_fits)
def find_in_square(
    T_view_link: Matrix,
    pointer: Vector,
    half: float,
    roots: IntVector,
    boxes: Matrix,
    nodes: IntMatrix,
    rows: Matrix,
    found: Matrix,
) -> int:
    """Find of every link the shape that is nearest to the pointer, inside the square about it.

    Args:
        T_view_link: Rotation, row by row, and origin of each link (links, 12), view coordinates.
        pointer: Right and up of the pointer in the image, and 1 with perspective, 0 without (3,).
        half: Half the side of the square, in the image.
        roots: See ``bvh.BvhForest``, as the three that follow.
        boxes: (nodes, 6).
        nodes: (nodes, 4).
        rows: (n, WIDTH).
        found: (links, 5), filled: see ``OFFSET`` and so on; ``OFFSET`` is half the side of the
            smallest square that the link falls in, infinite for a link that is not in ``half``.

    Returns:
        How many shapes were tested.
    """
    tested = 0
    stack = np.empty(_MAX_STACK, np.int64)
    points = np.empty((3, 3))
    best = np.empty(5)
    for link in range(len(roots)):
        best[OFFSET], best[DEPTH], best[ROW] = half, _MISS, -1.0
        best[RIGHT], best[UP] = 0.0, 0.0
        top, stack[0] = 1, roots[link]
        while top > 0:
            top -= 1
            node = stack[top]
            if not is_node(nodes, node, rows):
                continue
            if not _may_contain(T_view_link[link], pointer, best[OFFSET], boxes[node]):
                continue
            if nodes[node, COUNT] == 0:
                if top < _MAX_STACK - 1:
                    stack[top], stack[top + 1] = nodes[node, LEFT], nodes[node, RIGHT_CHILD]
                    top += 2
                continue
            for row in range(nodes[node, FIRST], nodes[node, FIRST] + nodes[node, COUNT]):
                tested += 1
                _test_shape(T_view_link[link], pointer, rows, row, points, best)
        for i in range(5):
            found[link, i] = best[i]
        if best[ROW] < 0.0:
            found[link, OFFSET] = _MISS
    return tested


def _transform_point(T: Vector, x: float, y: float, z: float, point: Vector) -> None:
    """Take a point of a link into view coordinates."""
    for i in range(3):
        point[i] = T[3 * i] * x + T[3 * i + 1] * y + T[3 * i + 2] * z + T[9 + i]


def _may_contain(T: Vector, pointer: Vector, half: float, box: Vector) -> bool:
    """Check whether the sphere around a box may meet the square's lines of sight."""
    size2 = 0.0
    centre = np.empty(3)
    for i in range(3):
        half_side = 0.5 * (box[3 + i] - box[i])
        size2 += half_side * half_side
    _transform_point(
        T, 0.5 * (box[0] + box[3]), 0.5 * (box[1] + box[4]), 0.5 * (box[2] + box[5]), centre
    )
    radius = math.sqrt(size2)
    if centre[2] + radius <= 0.0:
        return False
    if pointer[2] == 0.0:
        return _hypot(centre[0] - pointer[0], centre[1] - pointer[1]) <= radius + _DIAGONAL * half
    # The pyramid is inside a cone about the pointer's line of sight that is as wide as its corner.
    across = _hypot(centre[0] - pointer[0] * centre[2], centre[1] - pointer[1] * centre[2])
    length = math.sqrt(1.0 + pointer[0] * pointer[0] + pointer[1] * pointer[1])
    return across <= length * radius + _DIAGONAL * half * (centre[2] + radius)


def _hypot(a: float, b: float) -> float:
    """Compute the length of (a, b); ``math.hypot`` rounds otherwise than the C library's."""
    return math.sqrt(a * a + b * b)


def _copy(source: Vector, to: Vector, count: int) -> None:
    for i in range(count):
        to[i] = source[i]


def _test_shape(
    T: Vector, pointer: Vector, rows: Matrix, row: int, points: Matrix, best: Vector
) -> None:
    """Keep a shape where it is nearer to the pointer than what was found before."""
    _transform_point(T, rows[row, 1], rows[row, 2], rows[row, 3], points[0])
    _transform_point(T, rows[row, 4], rows[row, 5], rows[row, 6], points[1])
    candidate = np.empty(4)
    if rows[row, 0] == 1.0:
        _transform_point(T, rows[row, 7], rows[row, 8], rows[row, 9], points[2])
        _test_triangle(pointer, points, candidate)
    else:
        _test_capsule(pointer, points[0], points[1], rows[row, 7], candidate)
    nearer = candidate[OFFSET] < best[OFFSET] or (
        candidate[OFFSET] == best[OFFSET] and candidate[DEPTH] < best[DEPTH]
    )
    if nearer:
        _copy(candidate, best, 4)
        best[ROW] = row


# --- capsules: a sphere that moves along a segment ---


def _test_capsule(pointer: Vector, a: Vector, b: Vector, radius: float, candidate: Vector) -> None:
    """Find the sphere along a segment that is nearest to the pointer.

    The spheres that a square reaches are one part of the segment, so that golden section finds
    the one that the smallest square reaches.
    """
    candidate[OFFSET] = _MISS
    low, high, nearest = 0.0, 1.0, _near_plane_m(pointer)
    if max(a[2], b[2]) < nearest or (pointer[2] != 0.0 and _contains_camera(a, b, radius)):
        return
    if min(a[2], b[2]) < nearest:  # what is beside or behind the camera is cut off
        cut = (nearest - a[2]) / (b[2] - a[2])
        if a[2] < b[2]:
            low = cut
        else:
            high = cut
    one = np.empty(4)
    other = np.empty(4)
    s, t = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    _test_sphere_along(pointer, a, b, s, radius, one)
    _test_sphere_along(pointer, a, b, t, radius, other)
    while high - low > _SEARCH_TOLERANCE:
        if one[OFFSET] <= other[OFFSET]:
            high, t = t, s
            _copy(one, other, 4)
            s = high - _GOLDEN * (high - low)
            _test_sphere_along(pointer, a, b, s, radius, one)
        else:
            low, s = s, t
            _copy(other, one, 4)
            t = low + _GOLDEN * (high - low)
            _test_sphere_along(pointer, a, b, t, radius, other)
    _test_sphere_along(pointer, a, b, low, radius, candidate)
    if one[OFFSET] < candidate[OFFSET]:
        _copy(one, candidate, 4)
    _test_sphere_along(pointer, a, b, high, radius, other)
    if other[OFFSET] < candidate[OFFSET]:
        _copy(other, candidate, 4)


def _near_plane_m(pointer: Vector) -> float:
    return _MIN_DEPTH_M if pointer[2] != 0.0 else 0.0


def _test_sphere_along(
    pointer: Vector, a: Vector, b: Vector, fraction: float, radius: float, candidate: Vector
) -> None:
    """Test the sphere at a fraction of the segment from a to b; see ``_test_sphere``."""
    centre = np.empty(3)
    for i in range(3):
        centre[i] = a[i] + fraction * (b[i] - a[i])
    _test_sphere(pointer, centre, radius, candidate)


def _contains_camera(a: Vector, b: Vector, radius: float) -> bool:
    bb = ab = 0.0
    for i in range(3):
        delta = b[i] - a[i]
        bb, ab = bb + delta * delta, ab - a[i] * delta
    fraction = min(max(ab / bb, 0.0), 1.0) if bb > 0.0 else 0.0
    distance2 = 0.0
    for i in range(3):
        coordinate = a[i] + fraction * (b[i] - a[i])
        distance2 += coordinate * coordinate
    return distance2 <= radius * radius


def _test_sphere(pointer: Vector, c: Vector, radius: float, candidate: Vector) -> None:
    """Find the point of a sphere's projection that is nearest to the pointer.

    The projection is an ellipse, M(u, v) = A u² + 2 B u v + C v² + 2 D u + 2 E v + F >= 0 with
    M = r² |d|² - |c x d|² and d the line of sight. The smallest square that reaches it touches it
    with a side or a corner; all of these are roots of quadratic equations.
    """
    m = np.empty(6)
    _sphere_conic(pointer, c, radius, m)
    candidate[OFFSET] = _MISS
    if m[5] >= 0.0 and _keep_if_nearer(pointer, c, m, 0.0, 0.0, candidate):
        return
    for i in range(2):
        sign = 2.0 * i - 1.0
        _test_tangent_squares(pointer, c, m, sign, candidate)
        for j in range(2):
            other = 2.0 * j - 1.0
            square = m[0] + 2.0 * sign * other * m[1] + m[2]
            first, second = _quadratic_roots(square, sign * m[3] + other * m[4], m[5])
            _keep_if_nearer(pointer, c, m, sign * first, other * first, candidate)
            _keep_if_nearer(pointer, c, m, sign * second, other * second, candidate)


def _sphere_conic(pointer: Vector, c: Vector, radius: float, m: Vector) -> None:
    """Write A to F of a sphere's projection."""
    r2 = radius * radius
    if pointer[2] == 0.0:
        x, y = c[0] - pointer[0], c[1] - pointer[1]
        m[0], m[1], m[2], m[3], m[4], m[5] = -1.0, 0.0, -1.0, x, y, r2 - x * x - y * y
        return
    px, py = c[1] - c[2] * pointer[1], c[2] * pointer[0] - c[0]  # c x d at the pointer
    pz = c[0] * pointer[1] - c[1] * pointer[0]
    m[0] = r2 - c[2] * c[2] - c[1] * c[1]
    m[1] = c[0] * c[1]
    m[2] = r2 - c[2] * c[2] - c[0] * c[0]
    m[3] = r2 * pointer[0] - (py * c[2] - pz * c[1])
    m[4] = r2 * pointer[1] - (pz * c[0] - px * c[2])
    m[5] = r2 * (pointer[0] * pointer[0] + pointer[1] * pointer[1] + 1.0) - (
        px * px + py * py + pz * pz
    )


def _test_tangent_squares(
    pointer: Vector, c: Vector, m: Vector, sign: float, candidate: Vector
) -> None:
    """Test the squares whose sides at u = sign h and at v = sign h touch the projection."""
    square = m[1] * m[1] - m[0] * m[2]
    if m[2] != 0.0:
        first, second = _quadratic_roots(
            square, sign * (m[1] * m[4] - m[2] * m[3]), m[4] * m[4] - m[2] * m[5]
        )
        for i in range(2):
            half = first if i == 0 else second
            across = -(m[1] * sign * half + m[4]) / m[2]
            if abs(across) <= half:
                _keep_if_nearer(pointer, c, m, sign * half, across, candidate)
    if m[0] != 0.0:
        first, second = _quadratic_roots(
            square, sign * (m[1] * m[3] - m[0] * m[4]), m[3] * m[3] - m[0] * m[5]
        )
        for i in range(2):
            half = first if i == 0 else second
            across = -(m[1] * sign * half + m[3]) / m[0]
            if abs(across) <= half:
                _keep_if_nearer(pointer, c, m, across, sign * half, candidate)


def _quadratic_roots(square: float, half_linear: float, constant: float) -> tuple[float, float]:
    """Compute the roots of a x² + 2 b x + c = 0; infinite where there are none."""
    discriminant = half_linear * half_linear - square * constant
    if discriminant < 0.0:
        return _MISS, _MISS
    numerator = -half_linear - math.copysign(math.sqrt(discriminant), half_linear)
    first = numerator / square if square != 0.0 else _MISS
    return first, (constant / numerator if numerator != 0.0 else first)


def _keep_if_nearer(
    pointer: Vector, c: Vector, m: Vector, u: float, v: float, candidate: Vector
) -> bool:
    """Keep a point of the projection if it is nearer to the pointer and before the camera."""
    offset = max(abs(u), abs(v))
    if not offset < candidate[OFFSET]:
        return False
    inside = m[0] * u * u + 2.0 * (m[1] * u * v + m[3] * u + m[4] * v) + m[2] * v * v + m[5]
    along, length2 = c[2], 1.0
    if pointer[2] != 0.0:
        x, y = pointer[0] + u, pointer[1] + v
        along, length2 = c[0] * x + c[1] * y + c[2], x * x + y * y + 1.0
        if along <= 0.0:
            return False
    depth = max((along - math.sqrt(max(inside, 0.0))) / length2, 0.0)
    candidate[OFFSET], candidate[RIGHT], candidate[UP], candidate[DEPTH] = offset, u, v, depth
    return True


# --- triangles: a polygon in the image ---


def _test_triangle(pointer: Vector, corners: Matrix, candidate: Vector) -> None:
    """Find the point of a triangle's projection that is nearest to the pointer."""
    candidate[OFFSET] = _MISS
    polygon = np.empty((4, 3))
    count = _clip_triangle(pointer, corners, polygon)
    if count == 0:
        return
    is_left, is_right = False, False
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        cross = polygon[i, 0] * polygon[j, 1] - polygon[i, 1] * polygon[j, 0]
        is_left, is_right = is_left or cross > 0.0, is_right or cross < 0.0
    if is_left != is_right:  # the pointer is on one side of every edge
        depth = _depth_under_pointer(pointer, corners)
        if depth < _MISS:
            candidate[OFFSET] = candidate[RIGHT] = candidate[UP] = 0.0
            candidate[DEPTH] = depth
            return
    for i in range(count):
        _test_edge(pointer, polygon[i], polygon[i + 1 if i + 1 < count else 0], candidate)


def _clip_triangle(pointer: Vector, corners: Matrix, polygon: Matrix) -> int:
    """Write the projection of a triangle before the camera, and its depths (k, 3); return k."""
    count, nearest = 0, _near_plane_m(pointer)
    for i in range(3):
        a = corners[i]
        b = corners[(i + 1) % 3]
        if a[2] >= nearest:
            _project_point(pointer, a[0], a[1], a[2], polygon[count])
            count += 1
        if (a[2] >= nearest) != (b[2] >= nearest):
            s = (nearest - a[2]) / (b[2] - a[2])
            x, y = a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1])
            _project_point(pointer, x, y, nearest, polygon[count])
            count += 1
    return count


def _project_point(pointer: Vector, x: float, y: float, z: float, point: Vector) -> None:
    scale = 1.0 / z if pointer[2] != 0.0 else 1.0
    point[0], point[1], point[2] = x * scale - pointer[0], y * scale - pointer[1], z


def _depth_under_pointer(pointer: Vector, corners: Matrix) -> float:
    """Compute the depth of the triangle's plane at the pointer; infinite where it is edge-on."""
    a = corners[0]
    b = corners[1]
    c = corners[2]
    nx = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    ny = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    nz = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    plane = nx * a[0] + ny * a[1] + nz * a[2]
    if pointer[2] != 0.0:
        slope = nx * pointer[0] + ny * pointer[1] + nz
        return plane / slope if slope != 0.0 else _MISS
    return (plane - nx * pointer[0] - ny * pointer[1]) / nz if nz != 0.0 else _MISS


def _test_edge(pointer: Vector, a: Vector, b: Vector, candidate: Vector) -> None:
    """Test an edge where max(|u|, |v|) may be least: its ends, its axes, its diagonals."""
    du, dv = b[0] - a[0], b[1] - a[1]
    _test_edge_point(pointer, a, b, 0.0, candidate)
    _test_edge_point(pointer, a, b, 1.0, candidate)
    if du != 0.0:
        _test_edge_point(pointer, a, b, -a[0] / du, candidate)
    if dv != 0.0:
        _test_edge_point(pointer, a, b, -a[1] / dv, candidate)
    if du != dv:
        _test_edge_point(pointer, a, b, (a[1] - a[0]) / (du - dv), candidate)
    if du != -dv:
        _test_edge_point(pointer, a, b, -(a[0] + a[1]) / (du + dv), candidate)


def _test_edge_point(
    pointer: Vector, a: Vector, b: Vector, fraction: float, candidate: Vector
) -> None:
    if not 0.0 <= fraction <= 1.0:
        return
    u, v = a[0] + fraction * (b[0] - a[0]), a[1] + fraction * (b[1] - a[1])
    offset = max(abs(u), abs(v))
    if offset < candidate[OFFSET]:
        if pointer[2] != 0.0:
            depth = 1.0 / ((1.0 - fraction) / a[2] + fraction / b[2])
        else:
            depth = a[2] + fraction * (b[2] - a[2])
        candidate[OFFSET], candidate[RIGHT], candidate[UP], candidate[DEPTH] = offset, u, v, depth
