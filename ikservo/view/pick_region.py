"""Links in a square of pixels, compiled and exact.

The lines of sight through a square of pixels are a pyramid (a prism without perspective). A link
falls in the square where a shape of it meets that body: nothing is sampled, so a wire thinner than
a pixel is found wherever it is. View coordinates are right, up and depth; an image point is
right and up over depth (right and up themselves without perspective), counted from the pointer.
"""

from __future__ import annotations

import math

import numpy as np

from ikservo.ik.kernel.compiled import entry
from ikservo.kinematics.arrays import IntMatrix, IntVector, Matrix, Vector
from ikservo.view.bvh import COUNT, FIRST, LEFT, ROW_WIDTH
from ikservo.view.bvh import RIGHT as RIGHT_CHILD
from ikservo.view.raycast import is_node

__all__ = ["AWAY", "DEPTH", "RIGHT", "ROW", "UP", "find_in_square"]

# What is found of a link: how far from the pointer, where in the image, how deep, which row.
AWAY, RIGHT, UP, DEPTH, ROW = 0, 1, 2, 3, 4

_MAX_STACK = 64
_NONE = math.inf
_MIN_DEPTH_M = 1e-3
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_NARROWING_STEPS = 1e-10
_DIAGONAL = math.sqrt(2.0)


def square_fits(
    T_view_link: Matrix,
    eye: Vector,
    half: float,
    roots: IntVector,
    boxes: Matrix,
    nodes: IntMatrix,
    rows: Matrix,
    found: Matrix,
) -> bool:
    """Return whether arrays have the shapes that ``find_in_square`` needs; half is no NaN."""
    return (
        len(T_view_link) == len(roots)
        and T_view_link.shape[1] == 12
        and len(eye) == 3
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
    eye: Vector,
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
        eye: Right and up of the pointer in the image, and 1 with perspective, 0 without (3,).
        half: Half the side of the square, in the image.
        roots: See ``bvh.BvhForest``, as the three that follow.
        boxes: (nodes, 6).
        nodes: (nodes, 4).
        rows: (n, WIDTH).
        found: (links, 5), filled: see ``AWAY`` and so on; ``AWAY`` is infinite for a link that is
            not in the square. It is half the side of the smallest square that the link falls in.

    Returns:
        How many shapes were looked at.
    """
    looked = 0
    stack = np.empty(_MAX_STACK, np.int64)
    points = np.empty((3, 3))
    best = np.empty(5)
    for link in range(len(roots)):
        best[AWAY], best[DEPTH], best[ROW] = half, _NONE, -1.0
        best[RIGHT], best[UP] = 0.0, 0.0
        top, stack[0] = 1, roots[link]
        while top > 0:
            top -= 1
            node = stack[top]
            if not is_node(nodes, node, rows):
                continue
            if not _may_contain(T_view_link[link], eye, best[AWAY], boxes[node]):
                continue
            if nodes[node, COUNT] == 0:
                if top < _MAX_STACK - 1:
                    stack[top], stack[top + 1] = nodes[node, LEFT], nodes[node, RIGHT_CHILD]
                    top += 2
                continue
            for row in range(nodes[node, FIRST], nodes[node, FIRST] + nodes[node, COUNT]):
                looked += 1
                _test_shape(T_view_link[link], eye, rows, row, points, best)
        for i in range(5):
            found[link, i] = best[i]
        if best[ROW] < 0.0:
            found[link, AWAY] = _NONE
    return looked


def _transform_point(T: Vector, x: float, y: float, z: float, at: Vector) -> None:
    """Take a point of a link into view coordinates."""
    for i in range(3):
        at[i] = T[3 * i] * x + T[3 * i + 1] * y + T[3 * i + 2] * z + T[9 + i]


def _may_contain(T: Vector, eye: Vector, half: float, box: Vector) -> bool:
    """Return whether the ball around a box may meet the square's lines of sight."""
    size2 = 0.0
    at = np.empty(3)
    for i in range(3):
        half_side = 0.5 * (box[3 + i] - box[i])
        size2 += half_side * half_side
    _transform_point(
        T, 0.5 * (box[0] + box[3]), 0.5 * (box[1] + box[4]), 0.5 * (box[2] + box[5]), at
    )
    radius = math.sqrt(size2)
    if at[2] + radius <= 0.0:
        return False
    if eye[2] == 0.0:
        return _hypot(at[0] - eye[0], at[1] - eye[1]) <= radius + _DIAGONAL * half
    # The pyramid is inside a cone about the pointer's line of sight that is as wide as its corner.
    across = _hypot(at[0] - eye[0] * at[2], at[1] - eye[1] * at[2])
    length = math.sqrt(1.0 + eye[0] * eye[0] + eye[1] * eye[1])
    return across <= length * radius + _DIAGONAL * half * (at[2] + radius)


def _hypot(a: float, b: float) -> float:
    """Return the length of (a, b); ``math.hypot`` rounds otherwise than the C library's."""
    return math.sqrt(a * a + b * b)


def _copy(source: Vector, to: Vector, count: int) -> None:
    for i in range(count):
        to[i] = source[i]


def _test_shape(
    T: Vector, eye: Vector, rows: Matrix, row: int, points: Matrix, best: Vector
) -> None:
    """Keep a shape where it is nearer to the pointer than what was found before."""
    _transform_point(T, rows[row, 1], rows[row, 2], rows[row, 3], points[0])
    _transform_point(T, rows[row, 4], rows[row, 5], rows[row, 6], points[1])
    seen = np.empty(4)
    if rows[row, 0] == 1.0:
        _transform_point(T, rows[row, 7], rows[row, 8], rows[row, 9], points[2])
        _test_triangle(eye, points, seen)
    else:
        _test_capsule(eye, points[0], points[1], rows[row, 7], seen)
    nearer = seen[AWAY] < best[AWAY] or (seen[AWAY] == best[AWAY] and seen[DEPTH] < best[DEPTH])
    if nearer:
        _copy(seen, best, 4)
        best[ROW] = row


# --- capsules: a ball that moves along a segment ---


def _test_capsule(eye: Vector, a: Vector, b: Vector, radius: float, seen: Vector) -> None:
    """Find the ball along a segment that is nearest to the pointer.

    The balls that a square reaches are one stretch of the segment, so that golden section finds
    the one that the smallest square reaches.
    """
    seen[AWAY] = _NONE
    low, high, nearest = 0.0, 1.0, _near_plane_m(eye)
    if max(a[2], b[2]) < nearest or (eye[2] != 0.0 and _contains_eye(a, b, radius)):
        return
    if min(a[2], b[2]) < nearest:  # what is beside or behind the eye is cut off
        cut = (nearest - a[2]) / (b[2] - a[2])
        if a[2] < b[2]:
            low = cut
        else:
            high = cut
    one = np.empty(4)
    other = np.empty(4)
    s, t = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    _test_sphere_along(eye, a, b, s, radius, one)
    _test_sphere_along(eye, a, b, t, radius, other)
    while high - low > _NARROWING_STEPS:
        if one[AWAY] <= other[AWAY]:
            high, t = t, s
            _copy(one, other, 4)
            s = high - _GOLDEN * (high - low)
            _test_sphere_along(eye, a, b, s, radius, one)
        else:
            low, s = s, t
            _copy(other, one, 4)
            t = low + _GOLDEN * (high - low)
            _test_sphere_along(eye, a, b, t, radius, other)
    _test_sphere_along(eye, a, b, low, radius, seen)
    if one[AWAY] < seen[AWAY]:
        _copy(one, seen, 4)
    _test_sphere_along(eye, a, b, high, radius, other)
    if other[AWAY] < seen[AWAY]:
        _copy(other, seen, 4)


def _near_plane_m(eye: Vector) -> float:
    return _MIN_DEPTH_M if eye[2] != 0.0 else 0.0


def _test_sphere_along(
    eye: Vector, a: Vector, b: Vector, share: float, radius: float, seen: Vector
) -> None:
    """Find the ball that has gone a share of the way from a to b; see ``_test_sphere``."""
    centre = np.empty(3)
    for i in range(3):
        centre[i] = a[i] + share * (b[i] - a[i])
    _test_sphere(eye, centre, radius, seen)


def _contains_eye(a: Vector, b: Vector, radius: float) -> bool:
    bb = ab = 0.0
    for i in range(3):
        way = b[i] - a[i]
        bb, ab = bb + way * way, ab - a[i] * way
    share = min(max(ab / bb, 0.0), 1.0) if bb > 0.0 else 0.0
    away2 = 0.0
    for i in range(3):
        at = a[i] + share * (b[i] - a[i])
        away2 += at * at
    return away2 <= radius * radius


def _test_sphere(eye: Vector, c: Vector, radius: float, seen: Vector) -> None:
    """Find the point of a ball's picture that is nearest to the pointer.

    The picture is an ellipse, M(u, v) = A u² + 2 B u v + C v² + 2 D u + 2 E v + F >= 0 with
    M = r² |d|² - |c x d|² and d the line of sight. The smallest square that reaches it touches it
    with a side or a corner; all of these are roots of quadratic equations.
    """
    m = np.empty(6)
    _sphere_conic(eye, c, radius, m)
    seen[AWAY] = _NONE
    if m[5] >= 0.0 and _keep_if_nearer(eye, c, m, 0.0, 0.0, seen):
        return
    for i in range(2):
        sign = 2.0 * i - 1.0
        _test_tangent_squares(eye, c, m, sign, seen)
        for j in range(2):
            other = 2.0 * j - 1.0
            square = m[0] + 2.0 * sign * other * m[1] + m[2]
            first, second = _quadratic_roots(square, sign * m[3] + other * m[4], m[5])
            _keep_if_nearer(eye, c, m, sign * first, other * first, seen)
            _keep_if_nearer(eye, c, m, sign * second, other * second, seen)


def _sphere_conic(eye: Vector, c: Vector, radius: float, m: Vector) -> None:
    """Write A to F of a ball's picture."""
    r2 = radius * radius
    if eye[2] == 0.0:
        x, y = c[0] - eye[0], c[1] - eye[1]
        m[0], m[1], m[2], m[3], m[4], m[5] = -1.0, 0.0, -1.0, x, y, r2 - x * x - y * y
        return
    px, py = c[1] - c[2] * eye[1], c[2] * eye[0] - c[0]  # c x d at the pointer
    pz = c[0] * eye[1] - c[1] * eye[0]
    m[0] = r2 - c[2] * c[2] - c[1] * c[1]
    m[1] = c[0] * c[1]
    m[2] = r2 - c[2] * c[2] - c[0] * c[0]
    m[3] = r2 * eye[0] - (py * c[2] - pz * c[1])
    m[4] = r2 * eye[1] - (pz * c[0] - px * c[2])
    m[5] = r2 * (eye[0] * eye[0] + eye[1] * eye[1] + 1.0) - (px * px + py * py + pz * pz)


def _test_tangent_squares(eye: Vector, c: Vector, m: Vector, sign: float, seen: Vector) -> None:
    """Look at the squares whose sides at u = sign h and at v = sign h touch the picture."""
    square = m[1] * m[1] - m[0] * m[2]
    if m[2] != 0.0:
        first, second = _quadratic_roots(
            square, sign * (m[1] * m[4] - m[2] * m[3]), m[4] * m[4] - m[2] * m[5]
        )
        for i in range(2):
            half = first if i == 0 else second
            across = -(m[1] * sign * half + m[4]) / m[2]
            if abs(across) <= half:
                _keep_if_nearer(eye, c, m, sign * half, across, seen)
    if m[0] != 0.0:
        first, second = _quadratic_roots(
            square, sign * (m[1] * m[3] - m[0] * m[4]), m[3] * m[3] - m[0] * m[5]
        )
        for i in range(2):
            half = first if i == 0 else second
            across = -(m[1] * sign * half + m[3]) / m[0]
            if abs(across) <= half:
                _keep_if_nearer(eye, c, m, across, sign * half, seen)


def _quadratic_roots(square: float, half_linear: float, constant: float) -> tuple[float, float]:
    """Return the roots of a x² + 2 b x + c = 0; infinite where there are none."""
    under = half_linear * half_linear - square * constant
    if under < 0.0:
        return _NONE, _NONE
    away = -half_linear - math.copysign(math.sqrt(under), half_linear)
    first = away / square if square != 0.0 else _NONE
    return first, (constant / away if away != 0.0 else first)


def _keep_if_nearer(eye: Vector, c: Vector, m: Vector, u: float, v: float, seen: Vector) -> bool:
    """Keep a point of the picture where it is nearer to the pointer, and before the eye."""
    away = max(abs(u), abs(v))
    if not away < seen[AWAY]:
        return False
    inside = m[0] * u * u + 2.0 * (m[1] * u * v + m[3] * u + m[4] * v) + m[2] * v * v + m[5]
    way, length2 = c[2], 1.0
    if eye[2] != 0.0:
        x, y = eye[0] + u, eye[1] + v
        way, length2 = c[0] * x + c[1] * y + c[2], x * x + y * y + 1.0
        if way <= 0.0:
            return False
    depth = max((way - math.sqrt(max(inside, 0.0))) / length2, 0.0)
    seen[AWAY], seen[RIGHT], seen[UP], seen[DEPTH] = away, u, v, depth
    return True


# --- triangles: a polygon in the image ---


def _test_triangle(eye: Vector, corners: Matrix, seen: Vector) -> None:
    """Find the point of a triangle's picture that is nearest to the pointer."""
    seen[AWAY] = _NONE
    ring = np.empty((4, 3))
    count = _clip_triangle(eye, corners, ring)
    if count == 0:
        return
    turns, against = False, False
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        turn = ring[i, 0] * ring[j, 1] - ring[i, 1] * ring[j, 0]
        turns, against = turns or turn > 0.0, against or turn < 0.0
    if turns != against:  # the pointer is on one side of every edge
        depth = _depth_under_pointer(eye, corners)
        if depth < _NONE:
            seen[AWAY], seen[RIGHT], seen[UP], seen[DEPTH] = 0.0, 0.0, 0.0, depth
            return
    for i in range(count):
        _test_edge(eye, ring[i], ring[i + 1 if i + 1 < count else 0], seen)


def _clip_triangle(eye: Vector, corners: Matrix, ring: Matrix) -> int:
    """Write the picture of a triangle and its depths (k, 3), cut off beside the eye; return k."""
    count, nearest = 0, _near_plane_m(eye)
    for i in range(3):
        a = corners[i]
        b = corners[(i + 1) % 3]
        if a[2] >= nearest:
            _project_point(eye, a[0], a[1], a[2], ring[count])
            count += 1
        if (a[2] >= nearest) != (b[2] >= nearest):
            s = (nearest - a[2]) / (b[2] - a[2])
            x, y = a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1])
            _project_point(eye, x, y, nearest, ring[count])
            count += 1
    return count


def _project_point(eye: Vector, x: float, y: float, z: float, at: Vector) -> None:
    scale = 1.0 / z if eye[2] != 0.0 else 1.0
    at[0], at[1], at[2] = x * scale - eye[0], y * scale - eye[1], z


def _depth_under_pointer(eye: Vector, corners: Matrix) -> float:
    """Return how deep the triangle's plane is under the pointer; infinite where it is edge-on."""
    a = corners[0]
    b = corners[1]
    c = corners[2]
    nx = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    ny = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    nz = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    way = nx * a[0] + ny * a[1] + nz * a[2]
    if eye[2] != 0.0:
        slope = nx * eye[0] + ny * eye[1] + nz
        return way / slope if slope != 0.0 else _NONE
    return (way - nx * eye[0] - ny * eye[1]) / nz if nz != 0.0 else _NONE


def _test_edge(eye: Vector, a: Vector, b: Vector, seen: Vector) -> None:
    """Look at an edge where max(|u|, |v|) may be least: its ends, its axes, its diagonals."""
    du, dv = b[0] - a[0], b[1] - a[1]
    _test_edge_point(eye, a, b, 0.0, seen)
    _test_edge_point(eye, a, b, 1.0, seen)
    if du != 0.0:
        _test_edge_point(eye, a, b, -a[0] / du, seen)
    if dv != 0.0:
        _test_edge_point(eye, a, b, -a[1] / dv, seen)
    if du != dv:
        _test_edge_point(eye, a, b, (a[1] - a[0]) / (du - dv), seen)
    if du != -dv:
        _test_edge_point(eye, a, b, -(a[0] + a[1]) / (du + dv), seen)


def _test_edge_point(eye: Vector, a: Vector, b: Vector, share: float, seen: Vector) -> None:
    if not 0.0 <= share <= 1.0:
        return
    u, v = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
    away = max(abs(u), abs(v))
    if away < seen[AWAY]:
        if eye[2] != 0.0:
            depth = 1.0 / ((1.0 - share) / a[2] + share / b[2])
        else:
            depth = a[2] + share * (b[2] - a[2])
        seen[AWAY], seen[RIGHT], seen[UP], seen[DEPTH] = away, u, v, depth
