"""Cartesian trajectories: the tool along a line or curve, with its orientation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError, CartesianPathError
from ikservo.kinematics import Chain, finite_vector
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.se3 import log_so3
from ikservo.motion.path import ArmPlane, BlendedPath, OrientationInterpolation, SplinePath
from ikservo.motion.path_ik import track_path
from ikservo.motion.time_scaling import PathTrajectory
from ikservo.motion.trajectory import KinematicLimits

__all__ = [
    "ORIENTATION_TOLERANCE_RAD",
    "CartesianJointPath",
    "CartesianTrajectory",
    "LinearTrajectory",
    "solve_cartesian_path",
]


ORIENTATION_TOLERANCE_RAD = math.radians(0.5)
"""How far the tool may be from how it should stand and still stand so."""

_STEPS_M = (0.002, 0.001, 0.0005)
_STEP_RAD = 0.02
_MIN_POINTS = 5
# A turn in place has no length of its own; this is what a radian counts for, metres.
_LEVER_M = 0.1
# Half of what a line may stray, for the servos' ticks have their share.
_MAX_DEVIATION_M = 0.25e-3
_ROUNDING = 1e-9
_CHECKS_PER_POINT = 4


@dataclass(frozen=True, slots=True, eq=False)
class CartesianJointPath:
    """The way of the joints along a path of the tool.

    Attributes:
        spline: The joints (dof,) over a distance that is at least the path's.
        left_rad: How far the tool is from how it should stand, along the way (k,).
    """

    spline: SplinePath
    left_rad: Vector


def solve_cartesian_path(
    chain: Chain,
    start: Vector,
    path: BlendedPath,
    end: Vector | None = None,
    *,
    strict: bool = False,
) -> CartesianJointPath:
    """Find the joints along a path of the tool.

    The tool goes on to stand as it stands, against the plane of arms that have one, or is turned
    evenly to how it stands at ``end``. Where the arm cannot have that all along, it is turned
    evenly to what the arm has at the path's end; else as it comes.

    Args:
        chain: The arm.
        start: The joints where it begins (dof,).
        path: Where the tip goes, metres, base frame.
        end: Joints (dof,) with the orientation to turn to; None to keep the one at the start.
        strict: Whether the orientation shall be kept in the world, and nothing else will do.

    Raises:
        LineError: The path cannot be followed; says where, of the way that led furthest.
    """
    wish = _desired_orientation(chain, start, end, strict=strict)
    if strict:
        return _check_orientation_kept(chain, wish, path, _fit_spline(chain, start, path, wish))
    failed: list[CartesianPathError] = []
    found: list[CartesianJointPath] = []
    for turned in (_follow_orientation, _interpolate_to_reachable, _follow_position_only):
        try:
            spline = _fit_spline(chain, start, path, turned(chain, start, path, wish))
        except CartesianPathError as error:
            failed.append(error)
            continue
        found.append(_measure_curve(chain, wish, spline))
        # What goes as wished, though not quite, may do so with corners; an even turn has none.
        if (
            turned is not _follow_orientation
            or found[0].left_rad.max() <= ORIENTATION_TOLERANCE_RAD
        ):
            break
    if not found:
        raise max(failed, key=lambda error: error.along_m)
    return found[-1]


def _desired_orientation(
    chain: Chain, start: Vector, end: Vector | None, *, strict: bool
) -> OrientationInterpolation:
    last = start if end is None else end
    here, there = (chain.forward(q)[:3, :3] for q in (start, last))
    return OrientationInterpolation.between(
        ArmPlane(chain, in_world=strict), (here, start), (there, last)
    )


def _follow_orientation(
    chain: Chain, start: Vector, path: BlendedPath, wish: OrientationInterpolation
) -> OrientationInterpolation:
    _ = chain, start, path
    return wish


def _interpolate_to_reachable(
    chain: Chain, start: Vector, path: BlendedPath, wish: OrientationInterpolation
) -> OrientationInterpolation:
    """Return the even turn to what the arm has at the path's end, when it tries its best."""
    joints = track_path(chain, start, path, wish, _point_counts(path, wish)[0])
    here, there = (chain.forward(q)[:3, :3] for q in (start, joints[-1]))
    return OrientationInterpolation.between(wish.plane, (here, start), (there, joints[-1]))


def _follow_position_only(
    chain: Chain, start: Vector, path: BlendedPath, wish: OrientationInterpolation
) -> None:
    _ = chain, start, path, wish


def _fit_spline(
    chain: Chain, start: Vector, path: BlendedPath, turning: OrientationInterpolation | None
) -> SplinePath:
    """Return the spline through so many points that it stays on the path between them."""
    astray_m = 0.0
    turn_rad = 0.0 if turning is None else float(np.linalg.norm(turning.turn_rad))
    length = max(path.length, _LEVER_M * turn_rad, 1e-9)
    for count in _point_counts(path, turning):
        joints = track_path(chain, start, path, turning, count)
        spline = SplinePath(np.linspace(0.0, length, count), joints)
        strays_m = _path_deviations_m(chain, path, spline, _CHECKS_PER_POINT * (count - 1) + 1)
        if strays_m.max() <= _MAX_DEVIATION_M:
            return spline
        astray_m = float(strays_m.argmax()) / (len(strays_m) - 1) * path.length
    at_m = path.at(astray_m)[0].tolist()
    raise CartesianPathError(
        astray_m, at_m, at_m, ["the joints would have to turn too sharply (singularity)"]
    )


def _point_counts(path: BlendedPath, turning: OrientationInterpolation | None) -> list[int]:
    turn_rad = 0.0 if turning is None else float(np.linalg.norm(turning.turn_rad))
    return [
        max(_MIN_POINTS, 1 + math.ceil(max(path.length / step_m, turn_rad / _STEP_RAD)))
        for step_m in _STEPS_M
    ]


def _path_deviations_m(chain: Chain, path: BlendedPath, spline: SplinePath, looks: int) -> Vector:
    """Return how far the tip is from the path (looks,); infinite where a limit is left."""
    shares = np.linspace(0.0, 1.0, looks)
    q = spline.points(shares * spline.length)
    wanted = np.array([path.at(share * path.length)[0] for share in shares])
    strays: Vector = np.linalg.norm(chain.forward(q)[:, :3, 3] - wanted, axis=1)
    lower, upper = np.minimum(chain.lower_rad, q[0]), np.maximum(chain.upper_rad, q[0])
    outside = ((q < lower - _ROUNDING) | (q > upper + _ROUNDING)).any(axis=1)
    return np.where(outside, np.inf, strays)


def _measure_curve(
    chain: Chain, wish: OrientationInterpolation, spline: SplinePath
) -> CartesianJointPath:
    shares = np.linspace(0.0, 1.0, max(_MIN_POINTS, len(spline.distances)))
    joints = spline.points(shares * spline.length)
    rotations = chain.forward(joints)[:, :3, :3]
    return CartesianJointPath(spline, _orientation_errors(wish, shares.tolist(), joints, rotations))


def _orientation_errors(
    wish: OrientationInterpolation, shares: Sequence[float], joints: Vector, rotations: Vector
) -> Vector:
    turns = [
        log_so3(wish.at(share, q) @ R.T)
        for share, q, R in zip(shares, joints, rotations, strict=True)
    ]
    return np.linalg.norm(turns, axis=1)


def _check_orientation_kept(
    chain: Chain, wish: OrientationInterpolation, path: BlendedPath, spline: SplinePath
) -> CartesianJointPath:
    """Return the curve, if the tool stands as it should all along."""
    curve = _measure_curve(chain, wish, spline)
    wrong = np.flatnonzero(curve.left_rad > ORIENTATION_TOLERANCE_RAD)
    if not len(wrong):
        return curve
    along_m = float(wrong[0]) / (len(curve.left_rad) - 1) * path.length
    at_m = path.at(along_m)[0].tolist()
    turned = math.degrees(curve.left_rad.max())
    raise CartesianPathError(along_m, at_m, at_m, [f"the tool would turn by up to {turned:.1f}°"])


_BLEND_M = 0.02


class CartesianTrajectory(PathTrajectory):
    """A motion of a chain's joints that takes its tip along straight lines through points.

    It rests only at its end. At each point but the last it leaves the lines at the blend's
    distance, and passes the point at no more than 3/8 of it. On the lines it strays by less than
    half a millimetre.

    The tool's orientation is kept as well as the arm can: arms of four and five joints keep pitch
    and roll in the upright plane that their first joint turns, others the whole of it. With
    ``end`` the tool is turned evenly to how it stands there.

    Args:
        chain: The arm; ``start`` is inside its limits.
        start: The joints where it begins (dof,), rad or m.
        points_m: Where the tip goes (k, 3), metres, base frame.
        paces: The pace of each joint.
        speed_m_s: The fastest the tip may go.
        blend_m: How far from a point its two lines are left; half of a line at most.
        end: Joints (dof,) whose orientation the tool shall have at the end, as far as the arm can
            on its branch.
        strict: Whether the orientation shall be kept in the world, and nothing else will do.

    Attributes:
        length_m: The way of the tip.
        left_rad: How far the tool is from how it should stand, along the way (n,).

    Raises:
        LineError: Some point of the way is out of reach, or can only be reached by a jump of the
            joints; says which, how far along, and why.
        BadValueError: No finite numbers, or no positive speed or blend.
    """

    def __init__(
        self,
        chain: Chain,
        start: ArrayLike,
        points_m: Sequence[ArrayLike],
        paces: Sequence[KinematicLimits],
        *,
        speed_m_s: float = 0.25,
        blend_m: float = _BLEND_M,
        end: ArrayLike | None = None,
        strict: bool = False,
    ) -> None:
        if not 0.0 < speed_m_s < math.inf:
            raise BadValueError("The speed of the tool", speed_m_s, "a positive number of m/s")
        begin = finite_vector(start, chain.dof, "The start of the line")
        last = None if end is None else finite_vector(end, chain.dof, "The end of the line")
        corners = [finite_vector(point, 3, "The end of the line") for point in points_m]
        path = BlendedPath(
            np.array([chain.forward(begin)[:3, 3], *corners]), [blend_m] * (len(corners) - 1)
        )
        self.length_m = path.path_length()
        curve = solve_cartesian_path(chain, begin, path, last, strict=strict)
        self.left_rad = curve.left_rad
        stretch = curve.spline.length / max(path.length, 1e-9)
        marks = [mark * stretch for mark in path.breakpoints]
        super().__init__(curve.spline, paces, speed_m_s, marks)


class LinearTrajectory(CartesianTrajectory):
    """One straight line of the tip; see ``CartesianTrajectory``.

    Args:
        chain: The arm; ``start`` is inside its limits.
        start: The joints where the line begins (dof,), rad or m.
        goal_m: Where the tip goes (3,), metres, base frame.
        paces: The pace of each joint.
        speed_m_s: The fastest the tip may go.
        end: Joints (dof,) whose orientation the tool shall have at the end.
        strict: Whether the orientation shall be kept in the world, and nothing else will do.

    Raises:
        LineError: Some point of the line is out of reach, or can only be reached by a jump.
        BadValueError: No three finite numbers, or no positive speed.
    """

    def __init__(
        self,
        chain: Chain,
        start: ArrayLike,
        goal_m: ArrayLike,
        paces: Sequence[KinematicLimits],
        speed_m_s: float = 0.25,
        *,
        end: ArrayLike | None = None,
        strict: bool = False,
    ) -> None:
        super().__init__(chain, start, [goal_m], paces, speed_m_s=speed_m_s, end=end, strict=strict)
