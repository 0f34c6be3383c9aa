"""Constraints on the tool during a whole motion: its tilt and the position of the tip."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ikservo.arguments import parse_number
from ikservo.errors import BadValueError, ConstraintError, format_point
from ikservo.guard import refine_path
from ikservo.kernels.layout import work_shape
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector, finite_vector, read_only
from ikservo.kinematics.joints import JointType
from ikservo.kinematics.packed import pack_chain

Point = tuple[float, float, float]

_UP = read_only(np.array([0.0, 0.0, 1.0]))
_BROKEN = 1e-4  # rad or m: a larger excess violates a constraint; solved joints are exact to 1e-5
_UNSEEN = 1e-3  # rad or m: this much excess may go unnoticed between two samples of a path
# Paths are searched this far inside a constraint, so that their corners can be rounded.
_INSIDE_M = 0.002
_INSIDE_RAD = math.radians(1.0)
_INSIDE_FRACTION = 0.15  # the margin is at most this fraction of the width of a narrow constraint


@dataclass(frozen=True, slots=True)
class PathConstraint:
    """Constraints on the tool from the start of a motion to its end; none by default.

    Attributes:
        upright_rad: The maximum tilt of the gripper axis that points up at the start, such as the
            axis of a cup. Rotation about the vertical is free.
        axis: A direction (3,), base frame, near which the tool axis stays.
        axis_rad: The maximum angle between ``axis`` and the tool axis.
        low_m: The lowest corner (3,) of a box in which the tip stays.
        high_m: The highest corner (3,) of the box.
        above_m: A point (3,) of a plane above which the tip stays.
        normal: The direction (3,) that counts as above the plane.

    Raises:
        BadValueError: A number is out of its range, or a part of a constraint is missing.
    """

    upright_rad: float | None = None
    axis: ArrayLike | None = None
    axis_rad: float = math.radians(10.0)
    low_m: ArrayLike | None = None
    high_m: ArrayLike | None = None
    above_m: ArrayLike | None = None
    normal: ArrayLike = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        upright_rad = math.pi if self.upright_rad is None else self.upright_rad
        for what, angle in (("tilt", upright_rad), ("angle of the tool axis", self.axis_rad)):
            if not 0.0 < parse_number(f"The largest {what}", angle) <= math.pi:
                raise BadValueError(
                    f"The largest {what}", f"{math.degrees(angle):g}°", "more than 0, at most 180°"
                )
        for name, what in (("axis", "direction"), ("normal", "normal of the plane")):
            if getattr(self, name) is not None:
                length = math.hypot(*self._set_vector(name, f"The {what}"))
                if not 1e-6 <= length <= 1e6:
                    raise BadValueError(f"The length of the {what}", f"{length:g}", "1e-6 to 1e6")
        if self.above_m is not None:
            self._set_vector("above_m", "The point of the plane")
        if (self.low_m is None) != (self.high_m is None):
            raise BadValueError("The box of the tip", "given by only one corner", "both corners")
        if self.low_m is not None:
            low, high = (self._set_vector(n, "A corner of the box") for n in ("low_m", "high_m"))
            if not (low < high).all():
                raise BadValueError(
                    "The box of the tip",
                    f"{format_point(low)} to {format_point(high)}",
                    "a lower corner, then a higher one",
                )

    def _set_vector(self, name: str, what: str) -> Vector:
        vector = finite_vector(getattr(self, name), 3, what)
        object.__setattr__(self, name, tuple(vector.tolist()))
        return vector

    @property
    def constrains(self) -> bool:
        """Whether there is a constraint."""
        parts = (self.upright_rad, self.axis, self.low_m, self.above_m)
        return any(part is not None for part in parts)


UNCONSTRAINED = PathConstraint()
"""A constraint that allows everything."""


@dataclass(frozen=True, slots=True)
class _ToolLimit:
    """A limit on one angle [rad] or distance [m], and the text for its violation."""

    words: str
    unit: str
    most: float
    inside: float
    body: Vector  # angle: an axis of the tool (3,); distance: the outward normal
    world: Vector  # angle: the direction (3,); distance: a point of the plane

    def row(self, excess: float) -> Vector:
        """Return the limit, relaxed by an excess, as a row (8,); see ``tool_limits``."""
        most = self.most + excess
        if self.unit == "°":
            return np.array([1.0, 2.0 * math.sin(0.5 * most), *self.body, *self.world])
        return np.array([0.0, most, *self.body, *self.world])

    def describe(self, excess: float) -> str:
        if self.unit == "°":
            most, allowed = math.degrees(self.most + excess), math.degrees(self.most)
            return f"{self.words}: {most:.1f}° of at most {allowed:.1f}°"
        return f"the tip: {-1e3 * excess:z.0f} mm inside the {self.words}"


class ConstrainedTool:
    """Measure of how far the tool of an arm is from violating a constraint.

    Args:
        constraint: The constraint.
        chain: The arm.
        approach_axis: The tool axis (3,) in the coordinates of the tip.
        start: Joints (dof,) that define the constraint.

    Attributes:
        arm: The packed chain.
        projected: The limits (limits, 8) that ``project`` satisfies; see ``tool_limits``.
    """

    def __init__(
        self, constraint: PathConstraint, chain: Chain, approach_axis: Vector, start: Vector
    ) -> None:
        from ikservo.kernels import tool_limits  # noqa: PLC0415  # loads the compiled kernels

        self._kernel, T = tool_limits, chain.forward(start)
        self._bends = chain.link_joints
        self._limits = tuple(_limits_of(constraint, approach_axis, T[:3, :3].T @ _UP))
        self._inside = np.array([limit.inside for limit in self._limits])
        self._allowed, self.arm = -0.5 * self._inside, pack_chain(chain)
        self.projected = self._limit_rows(-self._inside)
        self._work = np.zeros(work_shape(chain.dof, 1))
        self.admit(start[None])
        self._turns, self._travels = _rates(chain)

    @property
    def kept(self) -> Matrix:
        """The limits (limits, 8) that ``keeps`` checks; see ``tool_limits``."""
        return self._limit_rows(self._allowed)

    def _limit_rows(self, excess: Vector) -> Matrix:
        return np.array([limit.row(each) for limit, each in zip(self._limits, excess, strict=True)])

    def excess(self, joints: Matrix) -> Matrix:
        """Compute the excess over each limit (n, limits) at joints (n, dof), rad or m."""
        if self._bends is not None:
            joints = self._bends(joints)
        poses = np.empty((len(joints), 12))
        self._kernel.tool_poses(self.arm, self._work, np.ascontiguousarray(joints), poses)
        R, tips_m = poses[:, :9].reshape(-1, 3, 3), poses[:, 9:]
        found = np.empty((len(joints), len(self._limits)))
        for i, limit in enumerate(self._limits):
            if limit.unit == "°":
                chords = np.linalg.norm(R @ limit.body - limit.world, axis=1)
                found[:, i] = 2.0 * np.arcsin(np.minimum(0.5 * chords, 1.0)) - limit.most
            else:
                found[:, i] = (tips_m - limit.world) @ limit.body
        return found

    def check(self, path: Matrix) -> tuple[str, ...]:
        """Check joints (n, dof) along a path that is straight between samples.

        Returns:
            The part of each limit that is used, as text.

        Raises:
            ConstraintError: A limit is exceeded; the message says by how much and where.
        """
        fractions, excess = refine_path(path, self.excess, self._unresolved_intervals)
        at, worst = np.unravel_index(np.argmax(excess), excess.shape)
        if excess[at, worst] > _BROKEN:
            limit, beyond = self._limits[int(worst)], float(excess[at, worst])
            raise ConstraintError(limit.words, limit.most, beyond, limit.unit, float(fractions[at]))
        pairs = zip(excess.max(axis=0).tolist(), self._limits, strict=True)
        nearest = sorted(pairs, key=lambda pair: -pair[0])  # an error names one side of a box
        said = {limit.words: limit.describe(most) for most, limit in reversed(nearest)}
        return tuple(said[words] for words in dict.fromkeys(each.words for each in self._limits))

    def admit(self, ends: Matrix) -> None:
        """Let ``keeps`` also accept these joints (n, dof), even if only just inside the limits."""
        near = self.excess(ends)
        near = near[(near <= _BROKEN).all(axis=1)].max(axis=0, initial=-math.inf)
        self._allowed = np.maximum(self._allowed, near)

    def keeps(self, joints: Matrix) -> NDArray[np.bool_]:
        """Check which joint vectors (n, dof) are well inside the limits; return a mask (n,)."""
        return np.all(self.excess(joints) <= self._allowed, axis=1)

    def project(self, joints: Vector, target_m: Vector | None = None) -> Vector | None:
        """Find joints (dof,) near the given joints, well inside the limits; None if not found.

        The tip is at ``target_m`` (3,) if it is given, otherwise free.
        """
        q, point_m = joints.copy(), np.zeros(3) if target_m is None else target_m
        aims = target_m is not None
        found = self._kernel.project_tool(self.arm, self.projected, self._work, point_m, aims, q)
        return q if found else None

    def _unresolved_intervals(self, path: Matrix, excess: Matrix) -> NDArray[np.intp]:
        """Find the intervals in which a limit may be exceeded; return their first samples."""
        most = excess[:-1] + excess[1:] + self._changes(path)
        near = (most > 2.0 * _UNSEEN) & (excess[:-1] <= _BROKEN) & (excess[1:] <= _BROKEN)
        return np.flatnonzero(near.any(axis=1))

    def _changes(self, path: Matrix) -> Matrix:
        """Compute the largest change of each excess between two samples (n - 1, limits)."""
        moved = np.abs(np.diff(path, axis=0))
        rates = [self._turns if each.unit == "°" else self._travels for each in self._limits]
        return moved @ np.array(rates).T


def _limits_of(
    constraint: PathConstraint, approach_axis: Vector, up: Vector
) -> Iterator[_ToolLimit]:
    def angle(words: str, most: float, body: Vector, world: Vector) -> _ToolLimit:
        return _ToolLimit(words, "°", most, min(_INSIDE_RAD, _INSIDE_FRACTION * most), body, world)

    if constraint.upright_rad is not None:
        yield angle("the tilt of the tool", constraint.upright_rad, up, _UP)
    if constraint.axis is not None:
        world = np.array(constraint.axis)
        unit = world / np.linalg.norm(world)
        yield angle("the angle of the tool axis", constraint.axis_rad, approach_axis, unit)
    if constraint.low_m is not None:
        low, high = np.array(constraint.low_m), np.array(constraint.high_m)
        inside = np.minimum(_INSIDE_M, _INSIDE_FRACTION * (high - low))
        for axis, side in enumerate(np.eye(3)):
            for corner, outward in ((low, -side), (high, side)):
                yield _ToolLimit("allowed box", "mm", 0.0, float(inside[axis]), outward, corner)
    if constraint.above_m is not None:
        normal = np.array(constraint.normal) / np.linalg.norm(np.array(constraint.normal))
        point = np.array(constraint.above_m)
        yield _ToolLimit("allowed half-space", "mm", 0.0, _INSIDE_M, -normal, point)


def _rates(chain: Chain) -> tuple[Vector, Vector]:
    """Compute the largest rotation and travel of the tip per unit of each joint (dof,)."""
    turns, travels, beyond_m = np.zeros(chain.dof), np.zeros(chain.dof), 0.0
    for step in reversed(chain.joints_to()):
        if step.joint.kind is JointType.PRISMATIC:
            beyond_m += abs(step.shift)
            if step.scale:
                ends = (chain.lower_rad[step.column], chain.upper_rad[step.column])
                beyond_m += max(abs(step.scale * end) for end in ends)
                travels[step.column] += abs(step.scale)
        elif step.joint.kind is JointType.REVOLUTE and step.scale:
            turns[step.column] += abs(step.scale)
            travels[step.column] += abs(step.scale) * beyond_m
        beyond_m += float(np.linalg.norm(step.joint.origin[:3, 3]))
    return turns, travels
