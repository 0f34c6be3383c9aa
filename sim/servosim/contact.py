"""Contacts of an arm with torque off: table and links push back where shapes overlap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from servosim.mass_tree import MassTree, MimicDrive
from servosim.urdf import BoxShape, Matrix, MovingJoint

# Fractions of the impulses that would end an overlap, and its growth, in one interval. They make
# the contact soft.
_STIFFNESS, _DAMPING = 0.05, 1.0
# The force does not increase beyond this depth, because an arm that deep was placed there.
_MAX_DEPTH_M = 0.006
# Largest change of speed by a contact within an interval. Contradictory contacts, in a posture in
# which no arm can lie, would otherwise add energy to each other.
_MAX_PUSH_M_S = 1.0
# Joints without torque hardly end a contact this near their axes; this keeps the force finite.
_MIN_LEVER_M = 0.03
_HELD = 1e9  # inertia of a joint that a servo holds: kg m², or kg
_TABLE = -1
_BASE = np.eye(4)[None]


@dataclass(frozen=True, slots=True)
class _ContactPatch:
    """The contact of two bodies.

    Attributes:
        point_m: Centre of the overlap (3,), base frame.
        normal: Outward normal of the second body (3,).
        depth_m: Penetration depth of the first body.
    """

    point_m: Matrix
    normal: Matrix
    depth_m: float

    @classmethod
    def from_points(
        cls, points_m: Matrix, depths_m: Matrix, normal: Matrix
    ) -> _ContactPatch | None:
        """Return the contact of points (k, 3) at depths (k,) [m]; None if there are none."""
        if not len(points_m):
            return None
        middle_m = depths_m @ points_m / depths_m.sum()
        return cls(middle_m, normal, float(depths_m.max()))


class Contacts:
    """Contact forces where the shapes of an arm overlap, as torques on its joints.

    One force acts per pair of bodies, and per body on the table, at the centre of the overlap.
    Connected bodies, and bodies that overlap in one of the given postures, are left out, because
    shapes are simpler than the parts.

    Args:
        joints: The arm's moving joints.
        driven: The driver of each of these joints.
        shapes: See `read_shapes`.
        tree: The tree that computes their frames.
        floor_m: Height of the table in the base frame; None if there is no table.
        postures: Positions of the driven joints, free of contact.
    """

    def __init__(
        self,
        joints: Sequence[MovingJoint],
        driven: Sequence[MimicDrive],
        shapes: Sequence[BoxShape],
        tree: MassTree,
        floor_m: float | None,
        postures: Sequence[Sequence[float]],
    ) -> None:
        self._joints, self._driven, self._shapes, self._tree = joints, driven, list(shapes), tree
        self._floor_m = floor_m
        self._radii_m = np.array([float(np.linalg.norm(s.half_m)) for s in self._shapes])
        self._halves_m = np.array([shape.half_m for shape in self._shapes]).reshape(-1, 3)
        self._bodies = np.array([shape.body for shape in self._shapes], dtype=int)
        self._mounts = np.array([shape.T for shape in self._shapes]).reshape(-1, 4, 4)
        every = range(_TABLE, len(joints))
        self._shapes_of = {b: np.flatnonzero(self._bodies == b).tolist() for b in every}
        moving = [body for body in every if body >= 0 and self._shapes_of[body]]
        self._on_table = moving if floor_m is not None else []
        self._set_pairs([(a, b) for a in every for b in every if self._are_separable(a, b)])
        for posture in postures:
            touching = self._overlapping_pairs(posture)
            self._set_pairs([pair for pair in self._pairs if pair not in touching])

    def torques(
        self,
        positions: Sequence[float],
        velocities: Sequence[float],
        mass: Matrix,
        free: Matrix,
        loads: Sequence[float],
        interval_s: float,
    ) -> list[float]:
        """Compute the torques (forces) on the driven joints, including those of contacts.

        Args:
            positions: The positions of the driven joints [rad or m].
            velocities: Velocities of the driven joints [rad/s or m/s].
            mass: Mass matrix of the arm with its motors (n, n).
            free: The joints that no servo holds (n,); only these yield and are pushed.
            loads: The other torques (forces) (n,), which contacts support however light the joints
                are.
            interval_s: Time until the next evaluation.
        """
        places, frames = self._world_frames(positions)
        found = self._find_contacts(places, frames, len(positions))
        if not found:
            return list(loads)
        acting = np.array(loads)
        # Joints that do not yield get a huge inertia and no coupling to the others.
        held = np.where(free, 0.0, _HELD)
        light = np.linalg.inv(mass * np.outer(free, free) + np.diag(held))
        for contact, depth_m in found:
            slope = np.where(free, contact, 0.0)
            if not slope.any():
                continue
            lever = 1.0 + _MIN_LEVER_M**2 / float(slope @ slope)
            mobility = lever * float(slope @ light @ slope)
            leaving_m_s = float(contact @ np.asarray(velocities))
            gained_m_s = interval_s * float(slope @ light @ acting)
            pushed_m_s = (
                _STIFFNESS * min(depth_m, _MAX_DEPTH_M) / interval_s
                - _DAMPING * leaving_m_s
                - min(gained_m_s, 0.0)
            )
            acting += min(max(0.0, pushed_m_s), _MAX_PUSH_M_S) / (mobility * interval_s) * slope
        return acting.tolist()

    def _find_contacts(
        self, places: Matrix, frames: Matrix, count: int
    ) -> list[tuple[Matrix, float]]:
        """Return the Jacobian by driven joint and the depth [m] of each contact."""
        touches = [(body, _TABLE, self._table_contact(places, body)) for body in self._on_table]
        touches += [
            (a, b, self._body_contact(places, rows)) for (a, b), rows in self._nearby_pairs(places)
        ]
        return [
            (self._contact_jacobian(frames, touch, a, b, count), touch.depth_m)
            for a, b, touch in touches
            if touch is not None
        ]

    def _contact_jacobian(
        self, frames: Matrix, touch: _ContactPatch, a: int, b: int, count: int
    ) -> Matrix:
        """Compute the velocity at which bodies a and b separate, per driven joint."""
        slope = [0.0] * count
        point_m, normal = touch.point_m.tolist(), touch.normal.tolist()
        for sign, end in ((1.0, a), (-1.0, b)):
            for body in self._ancestors(end):
                driver, multiplier, _ = self._driven[body]
                if driver >= 0:
                    sliding = self._joints[body].sliding
                    pushed = _normal_velocity(frames[body].tolist(), point_m, normal, sliding)
                    slope[driver] += sign * multiplier * pushed
        return np.array(slope)

    def _ancestors(self, body: int) -> Iterator[int]:
        """Yield a body and its ancestors, without the base."""
        while body >= 0:
            yield body
            body = self._joints[body].parent

    def _table_contact(self, places: Matrix, body: int) -> _ContactPatch | None:
        """Return the contact of a body that is below the table."""
        floor_m = 0.0 if self._floor_m is None else self._floor_m
        below: list[Matrix] = []
        for i in self._shapes_of[body]:
            if places[i, 2, 3] - self._radii_m[i] < floor_m:
                points = self._shapes[i].points_m @ places[i, :3, :3].T + places[i, :3, 3]
                below.append(points[points[:, 2] < floor_m])
        points = np.concatenate([np.empty((0, 3)), *below])
        return _ContactPatch.from_points(points, floor_m - points[:, 2], np.array([0.0, 0.0, 1.0]))

    def _body_contact(self, places: Matrix, rows: Matrix) -> _ContactPatch | None:
        """Return the contact of two overlapping bodies, from the pairs of shapes that overlap."""
        found: list[tuple[float, Matrix, Matrix, Matrix]] = []
        pairs: list[tuple[int, int]] = rows.tolist()
        for i, j in pairs:
            T, into = places[i], places[j]
            points = self._shapes[i].points_m @ T[:3, :3].T + T[:3, 3]
            inner = (points - into[:3, 3]) @ into[:3, :3]
            margin = self._shapes[j].half_m - np.abs(inner)
            depths = np.minimum(np.minimum(margin[:, 0], margin[:, 1]), margin[:, 2])
            k = int(depths.argmax())
            if depths[k] > 0.0:
                inside = depths > 0.0
                side = int(np.argmin(margin[k]))
                normal = into[:3, side] * np.sign(inner[k, side])
                found.append((float(depths[k]), points[inside], depths[inside], normal))
        if not found:
            return None
        normal = max(found, key=lambda row: row[0])[3]
        points, depths = (np.concatenate(column) for column in list(zip(*found, strict=True))[1:3])
        return _ContactPatch.from_points(points, depths, normal)

    def _nearby_pairs(self, places: Matrix) -> list[tuple[tuple[int, int], Matrix]]:
        """Compute the pairs of bodies that may overlap, and their relevant shapes."""
        i, j = self._rows[:, 0], self._rows[:, 1]
        apart = places[i, :3, 3] - places[j, :3, 3]
        inner = np.abs(apart[:, None] @ places[j, :3, :3])[:, 0] - self._halves_m[j]
        near = (np.maximum(inner, 0.0) ** 2).sum(axis=1) < self._radii_m[i] ** 2
        rows, pairs = self._rows[near], self._pair_of[near]
        return [(self._pairs[k], rows[pairs == k]) for k in np.unique(pairs).tolist()]

    def _set_pairs(self, pairs: Sequence[tuple[int, int]]) -> None:
        """Set the pairs of bodies to check: points of the first in shapes of the second."""
        self._pairs = list(pairs)
        rows = [
            (i, j, k)
            for k, (a, b) in enumerate(self._pairs)
            for i in self._shapes_of[a]
            for j in self._shapes_of[b]
        ]
        table = np.array(rows, dtype=int).reshape(-1, 3)
        self._rows, self._pair_of = table[:, :2], table[:, 2]

    def _overlapping_pairs(self, posture: Sequence[float]) -> set[tuple[int, int]]:
        """Compute the pairs of bodies that overlap in a posture."""
        places, _ = self._world_frames(posture)
        near = self._nearby_pairs(places)
        found = {pair for pair, rows in near if self._body_contact(places, rows) is not None}
        return found | {(b, a) for a, b in found}

    def _world_frames(self, positions: Sequence[float]) -> tuple[Matrix, Matrix]:
        """Compute the frames of shapes (k, 4, 4) and joints (n, 4, 4) in the base."""
        frames = self._tree.frames(positions)
        above = np.concatenate((frames, _BASE))[self._bodies]  # -1 is the base
        return above @ self._mounts, frames

    def _are_separable(self, a: int, b: int) -> bool:
        """Check whether neither of two bodies is directly attached to the other."""
        parents = [self._joints[body].parent if body >= 0 else None for body in (a, b)]
        return a != b and parents[0] != b and parents[1] != a


def _normal_velocity(
    frame: list[list[float]], point_m: list[float], normal: list[float], sliding: bool
) -> float:
    """Compute the speed of a point along a normal per speed of a joint.

    It uses plain numbers, because arrays of three elements are slower.
    """
    (_, _, x, at_x), (_, _, y, at_y), (_, _, z, at_z), _ = frame
    if not sliding:
        px, py, pz = point_m[0] - at_x, point_m[1] - at_y, point_m[2] - at_z
        x, y, z = y * pz - z * py, z * px - x * pz, x * py - y * px
    return x * normal[0] + y * normal[1] + z * normal[2]
