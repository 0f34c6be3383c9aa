"""Cartesian trajectories: motions of the tool along a line or curve, with its orientation."""

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
from ikservo.motion.path import (
    ArmPlane,
    BlendedPath,
    OrientationInterpolation,
    SplinePath,
    ToolPath,
)
from ikservo.motion.path_ik import track_path
from ikservo.motion.time_scaling import PathTrajectory
from ikservo.motion.trajectory import KinematicLimits

ORIENTATION_TOLERANCE_RAD = math.radians(0.5)
"""Largest allowed angle between the tool's orientation and the desired orientation [rad]."""

_STEPS_M = (0.002, 0.001, 0.0005)  # spacing of solved points; finer if the tip leaves the path
_STEP_RAD = 0.02  # largest rotation of the tool between two solved points
_MIN_POINTS = 5  # fewest points of a path
# A rotation in place has no path length; this length is used per radian, metres.
_LEVER_M = 0.1
# Half of the allowed deviation from a line; the other half is for the servos' ticks.
_MAX_DEVIATION_M = 0.25e-3
_ROUNDING = 1e-9  # rounding of a joint at its limit, rad or m
_BLEND_M = 0.02  # default distance from a waypoint at which the blend begins
_CHECKS_PER_POINT = 4  # samples between two points, to measure the deviation


@dataclass(frozen=True, slots=True, eq=False)
class CartesianJointPath:
    """The joints along a Cartesian path of the tool.

    Attributes:
        spline: The joints (dof,) as a function of distance, which is at least the path length.
        orientation_error_rad: The orientation error along the path (k,).
    """

    spline: SplinePath
    orientation_error_rad: Vector


def solve_cartesian_path(
    chain: Chain, start: Vector, path: ToolPath, end: Vector | None = None, *, strict: bool = False
) -> CartesianJointPath:
    """Find the joint positions along a path of the tool from joints (dof,).

    The tool keeps its orientation, relative to the arm plane if the arm has one, or rotates
    uniformly to the orientation at ``end``, joints (dof,). If the arm cannot have this orientation
    everywhere, the tool rotates uniformly to the nearest possible orientation at the end of the
    path; if that fails, the orientation is free. With ``strict``, it must be kept exactly in the
    world frame.

    Raises:
        CartesianPathError: The path cannot be followed; the error names the furthest point reached.
    """
    final = start if end is None else end
    start_rotation, end_rotation = (chain.forward(q)[:3, :3] for q in (start, final))
    desired = OrientationInterpolation.between(
        ArmPlane(chain, in_world=strict), (start_rotation, start), (end_rotation, final)
    )
    if strict:
        return _check_orientation_kept(
            chain, desired, path, _fit_spline(chain, start, path, desired)
        )
    failed: list[CartesianPathError] = []
    found: list[CartesianJointPath] = []
    for orientation_of in (_follow_orientation, _interpolate_to_reachable, _follow_position_only):
        try:
            spline = _fit_spline(chain, start, path, orientation_of(chain, start, path, desired))
        except CartesianPathError as error:
            failed.append(error)
            continue
        found.append(_measure_curve(chain, desired, spline))
        # A path near the desired orientation may have corners; a uniform rotation does not.
        if (
            orientation_of is not _follow_orientation
            or found[0].orientation_error_rad.max() <= ORIENTATION_TOLERANCE_RAD
        ):
            break
    if not found:
        raise max(failed, key=lambda error: error.along_m)
    return found[-1]


def _follow_orientation(
    chain: Chain, start: Vector, path: ToolPath, desired: OrientationInterpolation
) -> OrientationInterpolation:
    _ = chain, start, path
    return desired


def _interpolate_to_reachable(
    chain: Chain, start: Vector, path: ToolPath, desired: OrientationInterpolation
) -> OrientationInterpolation:
    """Return the uniform rotation to the nearest possible orientation at the path's end."""
    joints = track_path(chain, start, path, desired, _point_counts(path, desired)[0])
    start_rotation, end_rotation = (chain.forward(q)[:3, :3] for q in (start, joints[-1]))
    return OrientationInterpolation.between(
        desired.plane, (start_rotation, start), (end_rotation, joints[-1])
    )


def _follow_position_only(
    chain: Chain, start: Vector, path: ToolPath, desired: OrientationInterpolation
) -> None:
    _ = chain, start, path, desired


def _fit_spline(
    chain: Chain, start: Vector, path: ToolPath, orientation: OrientationInterpolation | None
) -> SplinePath:
    """Fit the spline through enough points to stay on the path between them."""
    worst_m = 0.0
    rotation_rad = 0.0 if orientation is None else float(np.linalg.norm(orientation.rotation_rad))
    length = max(path.length, _LEVER_M * rotation_rad, 1e-9)
    for count in _point_counts(path, orientation):
        joints = track_path(chain, start, path, orientation, count)
        spline = SplinePath(np.linspace(0.0, length, count), joints)
        deviations_m = _path_deviations_m(chain, path, spline, _CHECKS_PER_POINT * (count - 1) + 1)
        if deviations_m.max() <= _MAX_DEVIATION_M:
            return spline
        worst_m = float(deviations_m.argmax()) / (len(deviations_m) - 1) * path.length
    at_m = path.at(worst_m)[0].tolist()
    why = ["the joints would have to turn too sharply (singularity)"]
    raise CartesianPathError(worst_m, at_m, at_m, why, shape=path.shape)


def _point_counts(path: ToolPath, orientation: OrientationInterpolation | None) -> list[int]:
    rotation_rad = 0.0 if orientation is None else float(np.linalg.norm(orientation.rotation_rad))
    return [
        max(_MIN_POINTS, 1 + math.ceil(max(path.length / step_m, rotation_rad / _STEP_RAD)))
        for step_m in _STEPS_M
    ]


def _path_deviations_m(chain: Chain, path: ToolPath, spline: SplinePath, count: int) -> Vector:
    """Compute the tip's distance from the path (count,); infinite outside joint limits."""
    fractions = np.linspace(0.0, 1.0, count)
    q = spline.points(fractions * spline.length)
    expected = np.array([path.at(fraction * path.length)[0] for fraction in fractions])
    deviations: Vector = np.linalg.norm(chain.forward(q)[:, :3, 3] - expected, axis=1)
    lower, upper = np.minimum(chain.lower_rad, q[0]), np.maximum(chain.upper_rad, q[0])
    outside = ((q < lower - _ROUNDING) | (q > upper + _ROUNDING)).any(axis=1)
    return np.where(outside, np.inf, deviations)


def _measure_curve(
    chain: Chain, desired: OrientationInterpolation, spline: SplinePath
) -> CartesianJointPath:
    fractions = np.linspace(0.0, 1.0, max(_MIN_POINTS, len(spline.distances)))
    joints = spline.points(fractions * spline.length)
    rotations = chain.forward(joints)[:, :3, :3]
    errors = [
        log_so3(desired.at(fraction, q) @ R.T)
        for fraction, q, R in zip(fractions.tolist(), joints, rotations, strict=True)
    ]
    return CartesianJointPath(spline, np.linalg.norm(errors, axis=1))


def _check_orientation_kept(
    chain: Chain, desired: OrientationInterpolation, path: ToolPath, spline: SplinePath
) -> CartesianJointPath:
    """Return the curve if the tool keeps the desired orientation everywhere."""
    curve = _measure_curve(chain, desired, spline)
    outside = np.flatnonzero(curve.orientation_error_rad > ORIENTATION_TOLERANCE_RAD)
    if not len(outside):
        return curve
    along_m = float(outside[0]) / (len(curve.orientation_error_rad) - 1) * path.length
    at_m = path.at(along_m)[0].tolist()
    rotation_deg = math.degrees(curve.orientation_error_rad.max())
    raise CartesianPathError(
        along_m, at_m, at_m, [f"the tool would turn by up to {rotation_deg:.1f}°"], shape=path.shape
    )


def straight_lines(
    start_m: Vector, points_m: Sequence[ArrayLike], blend_m: float = _BLEND_M
) -> BlendedPath:
    """Return straight lines from a start (3,) through points (k, 3) [m], with rounded corners.

    The curve leaves the lines at the blend's distance from each point except the last, but at most
    at half of a line, and passes the point within 3/8 of that distance.

    Raises:
        BadValueError: A number is not finite, or a blend is not positive.
    """
    corners = [finite_vector(point, 3, "The end of the line") for point in points_m]
    return BlendedPath(np.array([start_m, *corners]), [blend_m] * (len(corners) - 1))


class CartesianTrajectory(PathTrajectory):
    """A motion of a chain's joints that moves its tip along a path, from rest to rest.

    The tip deviates from the path by less than half a millimetre. The speed of the tip is constant
    except on its ramps, if the joint limits allow it; in a rounded corner it is lower.

    The tool's orientation is kept as well as the arm can: arms of four and five joints keep pitch
    and roll in the upright plane that their first joint rotates; other arms keep the complete
    orientation. With ``end``, the tool rotates uniformly to the orientation of these joints.

    Args:
        chain: The arm; ``start`` is inside its limits.
        start: The joints at the start (dof,), rad or m.
        path: The path of the tip from the start, metres, base frame.
        limits: The kinematic limits of each joint.
        speed_m_s: The maximum speed of the tip; a radian of the tool counts as 0.1 m.
        tool_speed_m_s: The speed of the tip alone, at most ``speed_m_s``; None means as fast as
            possible.
        end: Joints (dof,) with the final orientation of the tool, as far as the arm can reach it on
            its branch.
        strict: Whether the orientation must be kept exactly in the world frame.

    Attributes:
        length_m: The length of the tip's path.
        orientation_error_rad: The orientation error along the path (n,).

    Raises:
        CartesianPathError: A point of the path is out of reach, or can only be reached by a jump of
            the joints; the error names place and cause.
        BadValueError: A number is not finite, or a speed is not positive.
    """

    def __init__(
        self,
        chain: Chain,
        start: ArrayLike,
        path: ToolPath,
        limits: Sequence[KinematicLimits],
        *,
        speed_m_s: float = 0.25,
        tool_speed_m_s: float | None = None,
        end: ArrayLike | None = None,
        strict: bool = False,
    ) -> None:
        for speed in (speed_m_s, tool_speed_m_s):
            if speed is not None and not 0.0 < speed < math.inf:
                raise BadValueError("The speed of the tool", speed, "a positive number of m/s")
        begin = finite_vector(start, chain.dof, "The start of the line")
        final = None if end is None else finite_vector(end, chain.dof, "The end of the line")
        self.length_m = path.path_length()
        curve = solve_cartesian_path(chain, begin, path, final, strict=strict)
        self.orientation_error_rad = curve.orientation_error_rad
        stretch = curve.spline.length / max(path.length, 1e-9)
        marks = [mark * stretch for mark in path.breakpoints]
        if tool_speed_m_s is not None:
            speed_m_s = min(speed_m_s, tool_speed_m_s) * stretch
        super().__init__(curve.spline, limits, speed_m_s, marks)
