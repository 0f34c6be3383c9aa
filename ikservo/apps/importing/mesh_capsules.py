"""Fit capsules to a mesh: as few as possible that contain it and stay close to it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics.arrays import Matrix, Vector

Triangles = NDArray[np.float64]
"""Corners (n, 3, 3), metres."""

MAX_CAPSULES = 8
_EXCESS_M, _EXCESS_FRACTION = 0.010, 0.10
# Fractions of the size of a mesh:
_CELL_FRACTION = 1 / 200  # vertices that are closer are merged
_PIECE_FRACTION = 1 / 10  # length of the pieces that are tested against capsules of other meshes
_SAMPLES = 40  # sampled points of the surface are at most 1/40 of the size apart
_MAX_FITTED = 30_000  # triangles; a mesh with more is simplified
_MAX_PIECES = 100_000  # pieces of cut triangles; larger surfaces are sampled coarsely
_CUTS = (0.5, 0.35, 0.65)  # tried planes, as fractions of the extent of a part
_MAX_RATED = 6_000  # triangles that are cut to find the best plane
_CIRCLE_STEPS = 60
_DIRECTIONS = 192
_MAX_SEARCHED = 6_000  # points; if there are more, all are searched in few directions only
_BLOCK = 2048


@dataclass(frozen=True, slots=True, eq=False)
class FittedCapsule:
    """A capsule: both ends of its axis (3,) and its radius, metres."""

    start_m: Vector
    end_m: Vector
    radius_m: float

    @property
    def volume_m3(self) -> float:
        """Volume of the capsule."""
        length_m = float(np.linalg.norm(self.end_m - self.start_m))
        return math.pi * self.radius_m**2 * (length_m + 4.0 / 3.0 * self.radius_m)

    @property
    def area_m2(self) -> float:
        """Area of the surface."""
        length_m = float(np.linalg.norm(self.end_m - self.start_m))
        return math.tau * self.radius_m * (length_m + 2.0 * self.radius_m)

    def depth_m(self, points: Matrix) -> Vector:
        """Compute the depth (n,) of points (n, 3) below the surface; negative outside."""
        along = self.end_m - self.start_m
        squared = float(along @ along)
        s = np.clip((points - self.start_m) @ along / squared, 0.0, 1.0) if squared else 0.0
        nearest = self.start_m + np.multiply.outer(s, along)
        return self.radius_m - np.sqrt(_squares(points - nearest))


@dataclass(frozen=True, slots=True, eq=False)
class MeshFit:
    """Capsules that together contain a mesh.

    Attributes:
        capsules: The capsules, in the coordinates of the mesh.
        excess_m: The distance from the mesh to the farthest point of their common surface.
        allowed_m: The maximum acceptable value of that distance.
    """

    capsules: tuple[FittedCapsule, ...]
    excess_m: float
    allowed_m: float


def extent_m(triangles: Triangles) -> float:
    """Return the largest extent of triangles along an axis."""
    return float(np.ptp(triangles.reshape(-1, 3), axis=0).max())


def fit_capsules(
    triangles: Triangles, beside: Sequence[Triangles] = (), given: Sequence[FittedCapsule] = ()
) -> MeshFit:
    """Find few capsules that together contain a surface, and the solid inside if it is closed.

    The part whose capsule is farthest from the mesh is cut by a plane, until all capsules are
    close enough or there are eight. Each capsule contains the convex hull of its part, so cutting
    leaves no gap. Vertices are merged first; the capsules are made thicker by the distance that
    merging moved them.

    If a link has other meshes (``beside``, in the same coordinates), parts inside their capsules
    (``given``) need no capsule, and a capsule that is close to any of the meshes counts as close to
    the link.
    """
    size_m = extent_m(triangles)
    allowed_m = max(_EXCESS_M, _EXCESS_FRACTION * size_m)
    merged, moved_m = simplify(triangles, size_m * _CELL_FRACTION)
    outside = _outside(merged, given, moved_m, size_m * _PIECE_FRACTION)
    if not len(outside):
        return MeshFit((), 0.0, allowed_m)
    low = triangles.min(axis=(0, 1)) - 2.0 * allowed_m
    high = triangles.max(axis=(0, 1)) + 2.0 * allowed_m
    near = [
        each[((each.max(axis=1) >= low) & (each.min(axis=1) <= high)).all(axis=1)]
        for each in beside
    ]
    surface = _SampledSurface([merged, *filter(len, near)], max(size_m / _SAMPLES, 1e-6), given)
    parts = _cut_parts(_fit_parts([outside]), surface, allowed_m, moved_m, _COARSE)
    parts = _merge_parts(parts, surface, allowed_m, moved_m)
    parts = _cut_parts(parts, surface, allowed_m, moved_m, _FINE)  # finds larger distances
    excess_m = max(surface.excess_m(i, parts, moved_m, _FINE) for i in range(len(parts)))
    capsules = [FittedCapsule(p.fit.start_m, p.fit.end_m, p.fit.radius_m + moved_m) for p in parts]
    return MeshFit(tuple(capsules), excess_m, allowed_m)


def _cut_parts(
    parts: list[_Part],
    surface: _SampledSurface,
    allowed_m: float,
    moved_m: float,
    density: _Density,
) -> list[_Part]:
    """Cut the worst part until all parts are close enough or there are eight."""
    parts = list(parts)
    while len(parts) < MAX_CAPSULES:
        excesses = [surface.excess_m(i, parts, moved_m, density) for i in range(len(parts))]
        far = [i for i, excess_m in enumerate(excesses) if excess_m > allowed_m]
        for i in sorted(far, key=lambda i: -excesses[i]):
            halves = _best_cut(parts[i].triangles, surface, allowed_m)
            if halves is not None:
                parts[i : i + 1] = halves
                break
        else:
            break
    return parts


def _outside(
    triangles: Triangles, capsules: Sequence[FittedCapsule], moved_m: float, edge_m: float
) -> Triangles:
    """Cut triangles into pieces of about an edge length; return pieces outside all capsules."""
    kept: list[Triangles] = []
    edge_m = _affordable_m(triangles, edge_m, _MAX_FITTED)
    while len(triangles) and capsules:
        inside = np.zeros(len(triangles), dtype=np.bool_)
        for capsule in capsules:
            depths_m = capsule.depth_m(triangles.reshape(-1, 3)).reshape(-1, 3)
            inside |= depths_m.min(axis=1) >= moved_m
        triangles = triangles[~inside]
        is_short = _longest_edges(triangles) <= edge_m
        kept.append(triangles[is_short])
        triangles = _halves(triangles[~is_short])
    return np.concatenate([*kept, triangles])


def simplify(triangles: Triangles, cell_m: float) -> tuple[Triangles, float]:
    """Merge the vertices in each cell of a grid; enlarge the cells until few triangles are left.

    Returns:
        The remaining triangles, and the largest distance that a vertex was moved.
    """
    merged, moved_m = merge_vertices(triangles, cell_m)
    while len(merged) > _MAX_FITTED and cell_m > 0.0:
        cell_m *= 2.0 if len(merged) > 4 * _MAX_FITTED else 1.4
        merged, moved_m = merge_vertices(triangles, cell_m)
    return merged, moved_m


def merge_vertices(triangles: Triangles, cell_m: float) -> tuple[Triangles, float]:
    """Merge the vertices in each cell of a grid; drop duplicate triangles.

    Returns:
        The remaining triangles, and the largest distance that a vertex was moved.
    """
    points = triangles.reshape(-1, 3)
    if cell_m <= 0.0:
        return triangles, 0.0
    _, first, which = np.unique(_cell_keys(points, cell_m), return_index=True, return_inverse=True)
    kept = points[first]
    moved_m = math.sqrt(float(_squares(points - kept[which]).max()))
    corners = which.reshape(-1, 3)
    a, b, c = np.sort(corners, axis=1).T.astype(np.int64)
    rows = np.unique((a * len(kept) + b) * len(kept) + c, return_index=True)[1]
    return kept[corners[rows]], moved_m


def _sphere_directions(count: int) -> Matrix:
    i = np.arange(count) + 0.5
    turn, z = math.pi * (1.0 + math.sqrt(5.0)) * i, 1.0 - 2.0 * i / count
    around = np.sqrt(1.0 - z**2)
    return np.stack([around * np.cos(turn), around * np.sin(turn), z], axis=1)


_SPHERE = _sphere_directions(_DIRECTIONS)


@dataclass(frozen=True, slots=True, eq=False)
class _Density:
    """Sampling of a capsule: directions (n, 3) for its ends, rings, and points on each ring."""

    directions: Matrix
    rings: int
    around: int


_COARSE = _Density(_SPHERE, 9, 16)
_FINE = _Density(_sphere_directions(2000), 30, 60)
"""Sampling density for the final result."""


class _SampledSurface:
    """Points of a surface, from which the distance to capsules is measured."""

    def __init__(
        self, meshes: Sequence[Triangles], spacing_m: float, given: Sequence[FittedCapsule] = ()
    ) -> None:
        from scipy.spatial import cKDTree  # noqa: PLC0415  # slow to import

        self._given = given
        self._tree = cKDTree(np.concatenate([_sample_surface(m, spacing_m) for m in meshes]))

    def excess_m(
        self, index: int, parts: Sequence[_Part], moved_m: float = 0.0, density: _Density = _COARSE
    ) -> float:
        """Compute the largest distance from the mesh to a capsule's outer surface."""
        away_m = self._distances_m(index, parts, density)
        return float(away_m.max()) + moved_m if len(away_m) else 0.0

    def badness(self, parts: Sequence[_Part], allowed_m: float) -> float:
        """Rate the distance between the capsules and the mesh, weighted by area; 0 is best."""
        rated = 0.0
        for i, part in enumerate(parts):
            far_m = self._distances_m(i, parts, _COARSE)
            far_m = np.maximum(far_m - 0.5 * allowed_m, 0.0)
            rated += part.fit.area_m2 * float(far_m @ far_m)
        return rated

    def _distances_m(self, index: int, parts: Sequence[_Part], density: _Density) -> Vector:
        points = _capsule_points(parts[index].fit, density)
        for other, part in enumerate(parts):
            if other != index:
                points = points[part.fit.depth_m(points) < 0.0]
        for capsule in self._given:
            points = points[capsule.depth_m(points) < 0.0]
        return np.asarray(self._tree.query(points)[0])


def _sample_surface(triangles: Triangles, spacing_m: float) -> Matrix:
    """Sample points (n, 3) of a surface at about the given spacing.

    On a very large surface the spacing is larger, so distances from it come out too large.
    """
    done: list[Matrix] = []
    spacing_m = _affordable_m(triangles, spacing_m, _MAX_PIECES)
    while len(triangles):
        is_short = _longest_edges(triangles) <= spacing_m
        done.append(_thin_out(triangles[is_short].reshape(-1, 3), 0.3 * spacing_m))
        triangles = _halves(triangles[~is_short])
    return _thin_out(np.concatenate(done), 0.3 * spacing_m)


def _affordable_m(triangles: Triangles, edge_m: float, most: int) -> float:
    """Return the given edge length, enlarged until it yields at most `most` pieces."""
    longest_m = _longest_edges(triangles)
    a, b, c = triangles.transpose(1, 0, 2)
    height_m = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(longest_m, 1e-12)
    while True:
        cut = longest_m > edge_m
        pieces = np.ceil(longest_m[cut] / edge_m) * np.ceil(height_m[cut] / edge_m + 1e-9)
        if float(pieces.sum()) <= most:
            return edge_m
        edge_m *= 1.3


def _longest_edges(triangles: Triangles) -> Vector:
    """Compute the length (n,) of the longest edge of each triangle."""
    return np.sqrt(_squares(triangles - triangles[:, (2, 0, 1)]).max(axis=1, initial=0.0))


def _halves(triangles: Triangles) -> Triangles:
    """Cut each triangle in two through the middle of its longest edge."""
    longest = _squares(triangles - triangles[:, (1, 2, 0)]).argmax(axis=1)
    ordered = (longest[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(triangles, ordered[:, :, None], axis=1).transpose(1, 0, 2)
    middle = 0.5 * (a + b)
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def _thin_out(points: Matrix, cell_m: float) -> Matrix:
    """Return one of the points (n, 3) in each cell of a grid."""
    if not len(points):
        return points
    return points[np.unique(_cell_keys(points, cell_m), return_index=True)[1]]


def _cell_keys(points: Matrix, cell_m: float) -> NDArray[np.int64]:
    """Return the number (n,) of the grid cell that contains each point (n, 3)."""
    x, y, z = (((row - row.min()) / cell_m).astype(np.int64) for row in points.T.copy())
    return (x * (y.max() + 1) + y) * (z.max() + 1) + z


def _squares(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the squared lengths (…) of vectors (…, k)."""
    return np.einsum("...i,...i->...", vectors, vectors)


_THICKNESSES = np.array([1.0, 1.04, 1.1, 1.18, 1.28])
_HALF_TURN = np.stack([np.cos(np.arange(8) * math.pi / 8), np.sin(np.arange(8) * math.pi / 8)])


def _capsule_points(fit: FittedCapsule, density: _Density) -> Matrix:
    """Return points (n, 3) of a capsule's surface."""
    along, sphere = fit.end_m - fit.start_m, density.directions
    side = sphere @ along
    caps = np.where(side[:, None] > 0.0, fit.end_m, fit.start_m) + fit.radius_m * sphere
    if not along.any():
        return caps
    across = np.linalg.svd(along[None])[2][1:]
    turn = np.linspace(0.0, math.tau, density.around, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1) @ across * fit.radius_m
    rings = fit.start_m + np.multiply.outer(np.linspace(0.0, 1.0, density.rings), along)
    return np.concatenate([caps, (rings[:, None] + circle).reshape(-1, 3)])


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Some of the triangles, and the capsule around them."""

    triangles: Triangles
    fit: FittedCapsule


def _fit_parts(pieces: Sequence[Triangles]) -> list[_Part]:
    """Fit a capsule around each piece, along the best of six axes."""
    points = [piece.reshape(-1, 3) for piece in pieces]
    corners = np.stack([outermost(each) for each in points])
    axes = np.stack([np.concatenate([np.eye(3), _main_axes(each)]) for each in corners])
    across = np.linalg.svd(axes[..., None, :])[2][..., 1:, :]  # (pieces, axes, 2, 3)
    flat = np.einsum("pkaj,pnj->pkna", across, corners)
    centres = _enclosing_circle_centres(flat.reshape(-1, *flat.shape[2:])).reshape(
        *flat.shape[:2], 2
    )
    parts: list[_Part] = []
    for piece, own, around, axis, sides, centre in zip(
        pieces, points, corners, axes, across, centres, strict=True
    ):
        rated = [_best_thickness(axis[k], sides[k], centre[k], around) for k in range(len(axis))]
        best = min(range(len(axis)), key=lambda k: rated[k][0])
        best_axis, best_sides, best_centre = axis[best], sides[best], centre[best]
        along = own @ best_axis
        away_m = np.sqrt(_squares(own @ best_sides.T - best_centre))
        radius_m = float(away_m.max()) * rated[best][1] + 1e-9
        cap_m = np.sqrt(np.maximum(radius_m**2 - away_m**2, 0.0))
        start_m, end_m = float((along + cap_m).min()), float((along - cap_m).max())
        if start_m > end_m:  # a ball contains all points
            start_m = end_m = 0.5 * (start_m + end_m)
        middle_m = best_centre @ best_sides
        fit = FittedCapsule(middle_m + start_m * best_axis, middle_m + end_m * best_axis, radius_m)
        parts.append(_Part(piece, fit))
    return parts


def _best_thickness(
    axis: Vector, across: Matrix, centre: Vector, points: Matrix
) -> tuple[float, float]:
    """Find the best thickness of a capsule along an axis around points.

    The thinnest capsule ends a whole radius beyond a flat end; a thicker capsule ends closer.

    Returns:
        The approximate excess [m] of that capsule, and its radius as a multiple of the smallest.
    """
    along, flat = points @ axis, points @ across.T - centre
    away2 = _squares(flat)
    widths = flat @ _HALF_TURN
    half_m = 0.5 * float((widths.max(axis=0) - widths.min(axis=0)).min())
    radii_m = math.sqrt(float(away2.max())) * _THICKNESSES
    caps_m = np.sqrt(np.maximum(radii_m[:, None] ** 2 - away2, 0.0))
    starts, ends = (along + caps_m).min(axis=1), (along - caps_m).max(axis=1)
    middle = np.where(starts > ends, 0.5 * (starts + ends), 0.0)
    starts, ends = np.where(starts > ends, middle, starts), np.where(starts > ends, middle, ends)
    beyond_m = radii_m + np.maximum(along.min() - starts, ends - along.max())
    excess_m = np.maximum(beyond_m, radii_m - half_m)
    best = int(excess_m.argmin())
    return float(excess_m[best]), float(_THICKNESSES[best])


def outermost(points: Matrix) -> Matrix:
    """Return the points (k, 3) that are farthest along evenly spread directions."""
    if len(points) > _MAX_SEARCHED:
        some = points[:: math.ceil(len(points) / _MAX_SEARCHED)]
        points = np.concatenate([_farthest_along(_SPHERE[::8], points), some])
    return _farthest_along(_SPHERE, points)


def _farthest_along(directions: Matrix, points: Matrix) -> Matrix:
    """Return the farthest point (k, 3) along each direction (k, 3)."""
    most, which = np.full(len(directions), -np.inf), np.zeros(len(directions), dtype=np.intp)
    across, rows = directions.astype(np.float32), np.arange(len(directions))
    middle = points.mean(axis=0)
    for first in range(0, len(points), _BLOCK):  # blocks fit into a processor's cache
        near = (points[first : first + _BLOCK] - middle).astype(np.float32)
        x, y, z = near.T.copy()
        along = across[:, :1] * x + across[:, 1:2] * y + across[:, 2:] * z
        block = along.argmax(axis=1)
        farther = along[rows, block] > most
        which[farther] = first + block[farther]
        most[farther] = along[rows, block][farther]
    return points[which]


def _main_axes(points: Matrix) -> Matrix:
    """Compute the principal axes (3, 3) of points, one per row, the longest first."""
    return np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]


def _enclosing_circle_centres(flat: Matrix) -> Matrix:
    """Approximate the centres (m, 2) of the smallest circles around points (m, n, 2).

    The method of Badoiu and Clarkson takes ever smaller steps towards the farthest point.
    """
    centre = 0.5 * (flat.min(axis=1) + flat.max(axis=1))
    min_m = np.full(len(flat), np.inf)
    rows, best = np.arange(len(flat)), centre
    for i in range(_CIRCLE_STEPS):
        away_m = _squares(flat - centre[:, None])
        farthest = away_m.argmax(axis=1)
        nearer = away_m[rows, farthest] < min_m
        best: Matrix = np.where(nearer[:, None], centre, best)
        min_m = np.where(nearer, away_m[rows, farthest], min_m)
        centre = centre + (flat[rows, farthest] - centre) / (i + 2)
    return best


def _best_cut(
    triangles: Triangles, surface: _SampledSurface, allowed_m: float
) -> list[_Part] | None:
    """Cut a mesh in two where capsules fit the parts best; None if no plane divides the mesh.

    If there are very many triangles, the planes are rated on some of them; the best plane then
    divides the whole mesh.
    """
    points = triangles.reshape(-1, 3)
    some = triangles[:: math.ceil(len(triangles) / _MAX_RATED)]
    planes: list[tuple[Vector, float]] = []
    pieces: list[Triangles] = []
    for axis in (*np.eye(3), _main_axes(outermost(points))[0]):
        along = points @ axis
        low, high = float(along.min()), float(along.max())
        for fraction in _CUTS:
            plane = axis, low + fraction * (high - low)
            halves = _cut_by_plane(some, *plane)
            if all(len(half) for half in halves):
                planes.append(plane)
                pieces += halves
    if not pieces:
        return None
    parts = _fit_parts(pieces)
    pairs = [parts[i : i + 2] for i in range(0, len(parts), 2)]
    best = min(range(len(pairs)), key=lambda i: surface.badness(pairs[i], allowed_m))
    if len(some) == len(triangles):
        return pairs[best]
    return _fit_parts(_cut_by_plane(triangles, *planes[best]))


def _cut_by_plane(triangles: Triangles, axis: Vector, at_m: float) -> tuple[Triangles, Triangles]:
    """Divide triangles into two sets, one per side of a plane; cut crossing triangles in three."""
    side = triangles @ axis - at_m
    above, below = (side >= 0.0).all(axis=1), (side < 0.0).all(axis=1)
    crossing, side = triangles[~above & ~below], side[~above & ~below]
    lone_above = (side >= 0.0).sum(axis=1) == 1
    farthest: list[NDArray[np.intp]] = [side.argmin(axis=1), side.argmax(axis=1)]
    ordered = (np.choose(lone_above, farthest)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(crossing, ordered[:, :, None], axis=1).transpose(1, 0, 2)
    s_a, s_b, s_c = np.take_along_axis(side, ordered, axis=1).T[..., None]
    p, q = a + (b - a) * s_a / (s_a - s_b), a + (c - a) * s_a / (s_a - s_c)
    tips = np.stack([a, p, q], axis=1)
    feet = np.concatenate([np.stack([p, b, c], axis=1), np.stack([p, c, q], axis=1)])
    feet_above = np.tile(~lone_above, 2)
    return (
        np.concatenate([triangles[above], tips[lone_above], feet[feet_above]]),
        np.concatenate([triangles[below], tips[~lone_above], feet[~feet_above]]),
    )


def _merge_parts(
    parts: list[_Part], surface: _SampledSurface, allowed_m: float, moved_m: float
) -> list[_Part]:
    """Merge pairs of parts as long as one capsule around both is close enough."""
    worst_m = max(surface.excess_m(i, parts, moved_m) for i in range(len(parts)))
    limit_m, merging = max(allowed_m, worst_m), True
    while merging and len(parts) > 1:
        merging = False
        pairs = [(i, k) for i in range(len(parts)) for k in range(i)]
        pieces = [np.concatenate([parts[i].triangles, parts[k].triangles]) for i, k in pairs]
        together = _fit_parts(pieces)
        for n in sorted(range(len(together)), key=lambda n: together[n].fit.volume_m3):
            (i, k), both = pairs[n], together[n]
            rest = [part for at, part in enumerate(parts) if at not in (i, k)]
            merged = [both, *rest]
            away_m = [surface.excess_m(at, merged, moved_m) for at in range(len(merged))]
            if away_m[0] <= allowed_m and max(away_m) <= limit_m:
                parts, merging = [both, *rest], True
                break
    return parts
