"""The kinematic chain: links and joints from the base to the tool (lecture L1, L2, L6)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError, InputError, UnknownNameError
from ikservo.kinematics.se3 import Matrix, Vector, pose, skew

__all__ = ["Chain", "Joint", "JointKind", "Mimic"]


class JointKind(Enum):
    """How a joint moves its child link."""

    FIXED = "fixed"
    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint that follows another: ``q = multiplier * q[joint] + offset``."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint of the tree.

    Attributes:
        origin: T_parent_joint (4, 4) at ``q = 0``.
        axis: Unit axis (3,) in the joint's frame; unused by fixed joints.
        lower: Lower limit, rad or m; ``-inf`` where the joint turns freely.
        upper: Upper limit, rad or m.
    """

    name: str
    kind: JointKind
    parent: str
    child: str
    origin: Matrix
    axis: Vector
    lower: float = -math.inf
    upper: float = math.inf
    mimic: Mimic | None = None


@dataclass(frozen=True, slots=True)
class _Step:
    """One joint on the way to a frame: its value is ``scale * q[column] + shift``."""

    joint: Joint
    column: int
    scale: float
    shift: float

    def value(self, q: Vector) -> float:
        return self.scale * float(q[self.column]) + self.shift if self.scale else self.shift


@dataclass(frozen=True, eq=False)
class Chain:
    """The joints that move the tip, and every link that hangs on them (lecture L1).

    ``q`` is (dof,): rad for revolute joints, m for prismatic ones, ordered from base to tip.
    Joints beside the way to the tip (a gripper's jaw) stand at the value nearest zero inside
    their limits, so that every link of the arm is a frame that can be asked for.

    Attributes:
        base: The root link; world coordinates are its coordinates.
        tip: The link that ``forward`` and ``jacobian`` mean when no frame is named.
        names: Names of the moving joints, base to tip.
        lower_rad: Lower limits (dof,), rad (m for a prismatic joint).
        upper_rad: Upper limits (dof,).
    """

    base: str
    tip: str
    names: tuple[str, ...]
    lower_rad: Vector
    upper_rad: Vector
    kinds: tuple[JointKind, ...]
    _ways: Mapping[str, tuple[_Step, ...]] = field(repr=False)

    @classmethod
    def from_joints(cls, joints: Sequence[Joint], base: str, tip: str) -> Chain:
        """Build the chain of a tree of joints, in any order, from ``base`` to ``tip``.

        Raises:
            InputError: No joint on the way to the tip moves.
            UnknownNameError: ``tip`` is no link that hangs on ``base``.
        """
        ways = _joints_to_each_link(joints, base)
        if tip not in ways:
            raise UnknownNameError("link", tip, ways)
        moving = [j for j in ways[tip] if j.kind is not JointKind.FIXED and j.mimic is None]
        if not moving:
            raise InputError(f"No joint moves {tip!r} against {base!r}.", "Choose another tip.")
        columns = {joint.name: i for i, joint in enumerate(moving)}
        by_name = {joint.name: joint for joint in joints}
        return cls(
            base=base,
            tip=tip,
            names=tuple(columns),
            lower_rad=_frozen([j.lower for j in moving]),
            upper_rad=_frozen([j.upper for j in moving]),
            kinds=tuple(j.kind for j in moving),
            _ways={
                link: tuple(_step(joint, columns, by_name) for joint in way)
                for link, way in ways.items()
            },
        )

    @property
    def dof(self) -> int:
        """Return the number of joints that move the tip."""
        return len(self.names)

    @property
    def frames(self) -> tuple[str, ...]:
        """Return the names of all links; each can be the ``frame`` of a question."""
        return tuple(self._ways)

    def with_limits(self, lower: ArrayLike, upper: ArrayLike) -> Chain:
        """Return the same chain inside other limits, (dof,) each, rad or m.

        Raises:
            BadValueError: Not finite, wrong shape, or a lower limit above its upper one.
        """
        low, high = self._joint_vector(lower, "lower limits"), self._joint_vector(upper, "upper")
        for name, a, b in zip(self.names, low, high, strict=True):
            if a > b:
                raise BadValueError(f"The range of {name}", f"[{a:g}, {b:g}]", "lower <= upper")
        return replace(self, lower_rad=_frozen(low), upper_rad=_frozen(high))

    def clip(self, q: ArrayLike) -> Vector:
        """Return ``q`` (dof,) with every joint moved to the nearest value inside its limits."""
        clipped: Vector = np.clip(np.asarray(q, dtype=np.float64), self.lower_rad, self.upper_rad)
        return clipped

    def middle(self) -> Vector:
        """Return (dof,) the middle of every range; zero for joints that turn freely."""
        bounded = np.isfinite(self.lower_rad) & np.isfinite(self.upper_rad)
        middle = np.zeros(self.dof)
        middle[bounded] = 0.5 * (self.lower_rad[bounded] + self.upper_rad[bounded])
        return self.clip(middle)

    def forward(
        self, q: ArrayLike, frame: str | None = None, offset_m: ArrayLike | None = None
    ) -> Matrix:
        """Return the pose of a link, or of a point fixed to it (lecture L2).

        ``f(q) = O1 M1(q1) O2 M2(q2) … offset`` with the fixed origins O and joint motions M.

        Args:
            q: Joint vector (dof,), rad or m.
            frame: Name of a link; the tip if None.
            offset_m: A point (3,) in that link's coordinates, metres; its origin if None.

        Returns:
            T_world_frame (4, 4); the offset moves its origin and does not turn it.

        Raises:
            BadValueError: ``q`` or ``offset_m`` has a wrong shape or is not finite.
            UnknownNameError: No link is named ``frame``.
        """
        q = self._joint_vector(q, "q")
        T = np.eye(4)
        for step in self._way(frame):
            T = T @ step.joint.origin @ _motion(step, q)
        return T if offset_m is None else T @ pose(_point(offset_m))

    def jacobian(
        self, q: ArrayLike, frame: str | None = None, offset_m: ArrayLike | None = None
    ) -> Matrix:
        """Return how the point moves with each joint, in world coordinates (lecture L6).

        Column i of a revolute joint is ``(axis x (f(q) - pivot), axis)``, of a prismatic joint
        ``(axis, 0)``.

        Args:
            q: Joint vector (dof,), rad or m.
            frame: Name of a link; the tip if None.
            offset_m: A point (3,) in that link's coordinates, metres; its origin if None.

        Returns:
            J (6, dof): linear rows [m/rad or m/m] first, angular rows [rad/rad] second.

        Raises:
            BadValueError: ``q`` or ``offset_m`` has a wrong shape or is not finite.
            UnknownNameError: No link is named ``frame``.
        """
        return self.linearise(q, frame, offset_m)[1]

    def linearise(
        self, q: ArrayLike, frame: str | None = None, offset_m: ArrayLike | None = None
    ) -> tuple[Matrix, Matrix]:
        """Return ``forward`` (4, 4) and ``jacobian`` (6, dof) of one point in one pass."""
        q = self._joint_vector(q, "q")
        T = np.eye(4)
        passed: list[tuple[_Step, Matrix]] = []
        for step in self._way(frame):
            T_world_joint = T @ step.joint.origin
            passed.append((step, T_world_joint))
            T = T_world_joint @ _motion(step, q)
        if offset_m is not None:
            T = T @ pose(_point(offset_m))
        J = np.zeros((6, self.dof))
        for step, T_world_joint in passed:
            if step.scale:
                J[:, step.column] += step.scale * _column(step.joint, T_world_joint, T[:3, 3])
        return T, J

    def link_poses(self, q: ArrayLike) -> dict[str, Matrix]:
        """Return T_world_link (4, 4) of every link of the arm at ``q`` (dof,)."""
        return {frame: self.forward(q, frame) for frame in self._ways}

    def _way(self, frame: str | None) -> tuple[_Step, ...]:
        try:
            return self._ways[self.tip if frame is None else frame]
        except KeyError:
            raise UnknownNameError("link", str(frame), self._ways) from None

    def _joint_vector(self, q: ArrayLike, what: str) -> Vector:
        return finite_vector(q, self.dof, what)


def finite_vector(values: ArrayLike, size: int, what: str) -> Vector:
    """Return ``values`` as (size,) floats; see ``finite_array``."""
    return finite_array(values, (size,), what)


def finite_array(values: ArrayLike, shape: tuple[int, ...], what: str) -> Vector:
    """Return ``values`` as an array of floats of that shape.

    Raises:
        BadValueError: They are no numbers, not finite, or of another shape.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadValueError(what, repr(values), f"numbers of shape {shape}") from None
    if array.shape != shape:
        raise BadValueError(what, f"of shape {array.shape}", f"shape {shape}")
    if not np.isfinite(array).all():
        raise BadValueError(what, str(array.tolist()), "finite numbers")
    return array


def _point(offset_m: ArrayLike) -> Vector:
    return finite_vector(offset_m, 3, "offset_m")


def _frozen(values: ArrayLike) -> Vector:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def _joints_to_each_link(joints: Sequence[Joint], base: str) -> dict[str, tuple[Joint, ...]]:
    """Return the joints from the base to every link that hangs on it."""
    below: dict[str, list[Joint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)
    ways: dict[str, tuple[Joint, ...]] = {base: ()}
    waiting = [base]
    while waiting:
        link = waiting.pop()
        for joint in below.get(link, []):
            ways[joint.child] = (*ways[link], joint)
            waiting.append(joint.child)
    return ways


def _step(joint: Joint, columns: Mapping[str, int], by_name: Mapping[str, Joint]) -> _Step:
    """Say which entry of q moves the joint, following mimics; none where it is held."""
    scale, shift, leader = 1.0, 0.0, joint
    for _ in by_name:
        if leader.mimic is None:
            break
        shift += scale * leader.mimic.offset
        scale *= leader.mimic.multiplier
        leader = by_name[leader.mimic.joint]
    if leader.name in columns:
        return _Step(joint, columns[leader.name], scale, shift)
    held = 0.0 if joint.kind is JointKind.FIXED else scale * _nearest_zero(leader) + shift
    return _Step(joint, 0, 0.0, held)


def _nearest_zero(joint: Joint) -> float:
    return min(max(0.0, joint.lower), joint.upper)


def _motion(step: _Step, q: Vector) -> Matrix:
    """Return the joint's own motion (4, 4) at its value."""
    joint = step.joint
    if joint.kind is JointKind.FIXED:
        return _IDENTITY
    value = step.value(q)
    if joint.kind is JointKind.PRISMATIC:
        return pose(value * joint.axis)
    return pose(_ORIGIN, _turn(joint.axis, value))


def _turn(axis: Vector, angle_rad: float) -> Matrix:
    """Return the rotation (3, 3) about a unit axis: I + sin W + (1 - cos) W² (Rodrigues)."""
    W = skew(axis)
    return np.eye(3) + math.sin(angle_rad) * W + (1.0 - math.cos(angle_rad)) * (W @ W)


def _column(joint: Joint, T_world_joint: Matrix, point: Vector) -> Vector:
    axis = T_world_joint[:3, :3] @ joint.axis
    if joint.kind is JointKind.PRISMATIC:
        return np.concatenate([axis, _ORIGIN])
    return np.concatenate([skew(axis) @ (point - T_world_joint[:3, 3]), axis])


_IDENTITY = _frozen(np.eye(4))
_ORIGIN = _frozen(np.zeros(3))
