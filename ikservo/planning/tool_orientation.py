"""The tool orientation of a motion, and joint solutions that have it at a point."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arguments import check_flag, parse_number
from ikservo.errors import BadValueError, InputError, OrientationError, shown
from ikservo.ik import Options, Posture, Result, Solver, Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import exp_so3, log_so3, make_pose
from ikservo.model.tool import ToolFrame, direction_from_angles
from ikservo.motion.cartesian import ORIENTATION_TOLERANCE_RAD
from ikservo.motion.path import ArmPlane


@dataclass(frozen=True, slots=True)
class ToolOrientation:
    """A constraint on the tool's orientation; none by default.

    Without a constraint, the tool keeps its orientation as well as the arm can: arms with six
    joints keep the complete orientation; arms with four or five joints keep pitch, then roll, in
    the plane that their first joint rotates. A constraint must be met within half a degree, or
    within ``within_rad``; the arm uses this tolerance only if something is in the way.

    Attributes:
        pitch_rad: The angle of the tool axis above the horizontal: -π/2 is straight down.
        roll_rad: The rotation about the tool axis, clockwise as seen from behind the tool; 0 is
            level.
        direction: The direction of the tool axis (3,), base frame, of any length.
        keep: Whether the complete orientation of the start is kept in the base frame.
        posture: Preferred joint positions instead, used if the point leaves a choice (lecture L10).
        orientation: The complete orientation R_base_tip (3, 3). An arm with fewer than six joints
            reaches it at only a few points.
        within_rad: The maximum deviation of the tool from the pitch, roll, direction or
            orientation.

    Raises:
        InputError: Values contradict each other, or are not finite numbers.
    """

    pitch_rad: float | None = None
    roll_rad: float | None = None
    direction: ArrayLike | None = None
    keep: bool = False
    posture: Posture | None = None
    orientation: ArrayLike | None = None
    within_rad: float | None = None

    def __post_init__(self) -> None:
        if self.within_rad is not None:
            within_rad = parse_number("The tolerance of the tool orientation", self.within_rad)
            if not ORIENTATION_TOLERANCE_RAD <= within_rad <= math.pi:
                given, expected = f"{math.degrees(within_rad):g}°", "an angle from 0.5° to 180°"
                raise BadValueError("The tolerance of the tool orientation", given, expected)
            if not self.constrains_more_than_keep:
                raise InputError(
                    "The tolerance has no tool orientation to apply to.",
                    "Add a pitch, roll, direction or orientation.",
                )
        for name, angle, most in (
            ("pitch", self.pitch_rad, math.pi / 2),
            ("roll", self.roll_rad, math.tau),
        ):
            if angle is not None and not abs(parse_number(f"The {name}", angle)) <= most + 1e-9:
                raise BadValueError(
                    f"The {name}",
                    f"{math.degrees(angle):g}°",
                    f"at most ±{math.degrees(most):.0f}°",
                )
        check_flag("keep", self.keep)
        Target((0.0, 0.0, 0.0), direction=self.direction)
        Target((0.0, 0.0, 0.0), orientation=self.orientation)
        if self.direction is not None:  # tuples can be compared
            object.__setattr__(self, "direction", tuple(np.asarray(self.direction).tolist()))
        if self.orientation is not None:
            rows: list[list[float]] = np.asarray(self.orientation).tolist()
            object.__setattr__(self, "orientation", tuple(tuple(row) for row in rows))
        if (
            self.orientation is not None
            and replace(self, orientation=None, within_rad=None).is_constrained
        ):
            raise BadValueError(
                "The tool orientation", "given twice", "either an orientation or its parts"
            )
        if self.keep and self.constrains_more_than_keep:
            raise BadValueError("The tool orientation", "given twice", "keep or an orientation")
        if self.direction is not None and self.pitch_rad is not None:
            raise BadValueError("The tool orientation", "given twice", "a direction or a pitch")
        if self.posture is not None and self.is_constrained:
            raise BadValueError(
                "The tool orientation", "given twice", "either a posture or an orientation"
            )

    @property
    def constrains_more_than_keep(self) -> bool:
        """Whether there is a constraint other than ``keep``."""
        parts = (self.pitch_rad, self.roll_rad, self.direction, self.orientation)
        return any(part is not None for part in parts)

    @property
    def is_constrained(self) -> bool:
        """Whether there is a constraint."""
        return self.keep or self.constrains_more_than_keep

    @property
    def tolerance_rad(self) -> float:
        """The maximum accepted deviation of the tool from the requested orientation."""
        return ORIENTATION_TOLERANCE_RAD if self.within_rad is None else self.within_rad

    def varied(self, random: np.random.Generator) -> ToolOrientation:
        """Return a random orientation within the tolerance; this one if there is no tolerance."""
        if self.within_rad is None:
            return self
        most, axis = self.within_rad, random.normal(size=3)
        R = exp_so3(axis / np.linalg.norm(axis) * random.uniform(0.0, most))
        pitch_rad, roll_rad = self.pitch_rad, self.roll_rad
        if pitch_rad is not None:
            turned = pitch_rad + random.uniform(-most, most)
            pitch_rad = min(max(turned, -math.pi / 2), math.pi / 2)
        if roll_rad is not None:
            roll_rad = math.remainder(roll_rad + random.uniform(-most, most), math.tau)
        direction = None if self.direction is None else R @ np.asarray(self.direction)
        orientation = None if self.orientation is None else R @ np.asarray(self.orientation)
        return ToolOrientation(pitch_rad, roll_rad, direction, orientation=orientation)

    def __str__(self) -> str:
        """Describe the constraint."""
        parts = [
            f"pitch {math.degrees(self.pitch_rad):.1f}°" if self.pitch_rad is not None else "",
            f"roll {math.degrees(self.roll_rad):.1f}°" if self.roll_rad is not None else "",
            "direction " + ",".join(f"{x:g}" for x in np.ravel(self.direction))
            if self.direction is not None
            else "",
            "the present orientation" if self.keep else "",
            "the given orientation" if self.orientation is not None else "",
        ]
        within = "" if self.within_rad is None else f" within {math.degrees(self.within_rad):.1f}°"
        return " and ".join(part for part in parts if part) + within


KEEP_BEST_EFFORT = ToolOrientation()
"""No constraint: the arm keeps the tool's orientation as well as it can."""


def check_orientation(stance: object, orientation: ArrayLike | None = None) -> ToolOrientation:
    """Check and return the constraint; it may be given as a complete orientation (3, 3).

    Raises:
        BadValueError: The value is not a ``ToolOrientation``, or two constraints are given.
    """
    if not isinstance(stance, ToolOrientation):
        raise BadValueError(
            "The stance", shown(stance), "a ToolOrientation, such as ToolOrientation(pitch_rad=0.0)"
        )
    return stance if orientation is None else replace(stance, orientation=orientation)


MAX_HEADING_ITERATIONS = 6
"""Number of times that the tool's heading is updated from the solution."""

KEPT_ORIENTATION_TOLERANCE_RAD = 3e-4  # below it, the error or change of the heading has converged
POSITION_TOLERANCE_M = 1e-5  # a larger error of the tip means that the point is out of reach


def keep_orientation(chain: Chain, target: Target, start: Vector, plain: Result) -> Result:
    """Return the joints near an unconstrained solution that best keep the tool's orientation."""
    plane = ArmPlane(chain)
    first = plane.rotation(start).T @ chain.forward(start)[:3, :3]
    solver = Solver(chain, "pose", options=Options(position_first=True))
    q, desired = plain.q, first
    for _ in range(MAX_HEADING_ITERATIONS):
        before, desired = plane.angle_rad(q), plane.rotation(q) @ first
        found, _ = solver.track(make_pose(target.position, desired), q)
        if solver.result.position_error_m > POSITION_TOLERANCE_M:
            break
        q = found
        if abs(plane.angle_rad(q) - before) < KEPT_ORIENTATION_TOLERANCE_RAD:
            break
    T = chain.forward(q)
    gap_m = float(np.linalg.norm(T[:3, 3] - target.position))
    turned_rad = float(np.linalg.norm(log_so3(desired @ T[:3, :3].T)))
    return replace(
        plain,
        q=q,
        nearest_m=T[:3, 3],
        position_error_m=gap_m,
        orientation_error_rad=turned_rad,
    )


# Few restarts: most of these problems have no exact solution, and each restart fails.
_RESTARTS = 20
_NOWHERE_M = 1e-6  # a direction nearer to the base axis has no heading
_UPRIGHT = 0.99  # cosine: a first joint this close to vertical turns the heading
_POSE_DOF = 6  # number of joints that an arm needs for any orientation at a point


class OrientationSolver:
    """Solver for joints with one tool orientation at one point, from the start joints."""

    def __init__(
        self, chain: Chain, tool: ToolFrame, target: Target, stance: ToolOrientation, start: Vector
    ) -> None:
        self._chain, self._tool, self._target = chain, tool, target
        self._stance, self._start = stance, start
        self._first = chain.forward(start)[:3, :3]

    def candidates(self, plain: Result) -> Iterator[Result]:
        """Yield solutions, beginning with those near the unconstrained solution."""
        whole = self._target_rotation()
        if whole is not None:
            yield from self._solve_target(whole, plain.q)
        elif self._stance.pitch_rad is None and self._stance.direction is not None:
            yield from self._solve_direction(plain.q)
        else:
            pitch_rad = self._stance.pitch_rad
            if pitch_rad is None:
                level = keep_orientation(self._chain, self._target, self._start, plain).q
                pitch_rad = self._tool.pitch_rad(self._tool_rotation(level))
            outward = self._outward_rad(plain.q)
            for heading_rad in (outward, self._heading_rad(plain.q), outward + math.pi):
                yield from self._solve_pitch(heading_rad, pitch_rad, plain.q)

    def _target_rotation(self) -> Matrix | None:
        """Return the requested orientation (3, 3); None if only a part of it is constrained."""
        if self._stance.keep:
            return self._first
        return Target((0.0, 0.0, 0.0), orientation=self._stance.orientation).rotation

    def evaluate(self, solution: Result) -> Result:
        """Return a solution whose error is the largest angle from the requested orientation."""
        R, stance, errors = self._tool_rotation(solution.q), self._stance, [0.0]
        if stance.pitch_rad is not None:
            errors.append(abs(self._tool.pitch_rad(R) - stance.pitch_rad))
        if stance.roll_rad is not None:
            roll_rad = self._tool.roll_rad(R, self._outward_rad(solution.q))
            errors.append(abs(math.remainder(roll_rad - stance.roll_rad, math.tau)))
        if stance.direction is not None:
            desired = Target(
                (0, 0, 0), direction=stance.direction, tool_axis=self._tool.approach_axis
            )
            errors.append(float(np.linalg.norm(desired.orientation_error(R))))
        whole = self._target_rotation()
        if whole is not None:
            errors.append(float(np.linalg.norm(log_so3(whole @ R.T))))
        return replace(solution, orientation_error_rad=max(errors))

    def check_error(self, solved: Result) -> None:
        """Check that the orientation error is within the tolerance.

        Raises:
            OrientationError: The error is larger than the tolerance.
        """
        if solved.orientation_error_rad <= self._stance.tolerance_rad:
            return
        missing = ""
        if self._target_rotation() is not None and self._chain.dof < _POSE_DOF:
            missing = (
                f"{self._chain.dof} joints reach few orientations; a full pose needs {_POSE_DOF}. "
                "Ask for a direction or a pitch instead."
            )
        raise OrientationError(
            self._target.position.tolist(),
            str(self._stance),
            self._describe_orientation(solved.q),
            solved.orientation_error_rad,
            [str(limit) for limit in solved.binding],
            missing,
        )

    def _describe_orientation(self, q: Vector) -> str:
        """Describe the tool's orientation at joints (dof,) in terms of the constraint."""
        R = self._tool_rotation(q)
        roll_rad = self._tool.roll_rad(R, self._outward_rad(q))
        x, y, z = (R @ self._tool.approach_axis).tolist()
        parts = [
            f"pitch {math.degrees(self._tool.pitch_rad(R)):z.1f}°",
            f"roll {math.degrees(roll_rad):z.1f}°",
            f"direction {x:z.3f},{y:z.3f},{z:z.3f}",
        ]
        return ", ".join(parts)

    def _solve_direction(self, q: Vector) -> Iterator[Result]:
        desired = Target((0, 0, 0), direction=self._stance.direction).target_axis
        if desired is None or self._stance.roll_rad is None:
            yield from self._solve_target(desired, q)
            return
        upright = math.hypot(desired[0], desired[1]) < math.cos(math.radians(89.5))
        heading_rad = self._outward_rad(q) if upright else math.atan2(desired[1], desired[0])
        pitch_rad = math.asin(float(desired[2]))
        R = self._tool.rotation(heading_rad, pitch_rad, self._stance.roll_rad)
        yield from self._solve_target(R, q)

    def _solve_pitch(self, heading_rad: float, pitch_rad: float, q: Vector) -> Iterator[Result]:
        """Yield solutions with a pitch, each with the heading of the previous solution."""
        for _ in range(MAX_HEADING_ITERATIONS):
            if self._stance.roll_rad is None:
                desired = direction_from_angles(heading_rad, pitch_rad)
            else:
                desired = self._tool.rotation(heading_rad, pitch_rad, self._stance.roll_rad)
            found = list(self._solve_target(desired, q))
            yield from found
            if not found or found[0].orientation_error_rad < KEPT_ORIENTATION_TOLERANCE_RAD:
                return
            q = found[0].q
            before, heading_rad = heading_rad, self._heading_rad(q)
            if abs(math.remainder(heading_rad - before, math.tau)) < KEPT_ORIENTATION_TOLERANCE_RAD:
                return

    def _solve_target(self, desired: Matrix | Vector | None, q: Vector) -> Iterator[Result]:
        """Yield solutions that reach the point with an orientation (3, 3) or direction (3,)."""
        of_axis = desired is None or desired.ndim == 1
        target = Target(
            self._target.position,
            direction=desired if of_axis else None,
            orientation=None if of_axis else desired,
            tool_axis=self._tool.approach_axis,
        )
        for restarts in (1, _RESTARTS):
            result = solve(self._chain, target, q, position_first=True, restarts=restarts)
            if result.position_error_m <= POSITION_TOLERANCE_M:
                yield self.evaluate(replace(result, reached=True))

    def _tool_rotation(self, q: Vector) -> Matrix:
        return self._chain.forward(q)[:3, :3]

    def _heading_rad(self, q: Vector) -> float:
        own = self._tool.heading_rad(self._tool_rotation(q))
        return self._outward_rad(q) if own is None else own

    def _outward_rad(self, q: Vector) -> float:
        """Compute the heading from the axis of the first joint to the tip."""
        T, J = self._chain.forward_and_jacobian(q)
        away = np.cross(J[:3, 0], J[3:, 0])
        x, y = (away if abs(float(J[5, 0])) > _UPRIGHT else T[:3, 3])[:2].tolist()
        return 0.0 if math.hypot(x, y) < _NOWHERE_M else math.atan2(y, x)


def solve_with_orientation(
    chain: Chain, tool: ToolFrame, target: Target, stance: ToolOrientation, start: Vector
) -> Result:
    """Solve for the joints at a point: position exactly, then orientation as well as possible.

    The present joints (dof,) define the start and the orientation to keep.

    Returns:
        The solution; its orientation error is that of the tool, and ``reached`` refers to the
        point.

    Raises:
        OrientationError: The error of a requested orientation exceeds its tolerance.
    """
    plain = solve(chain, target, start, posture=stance.posture)
    if not plain.reached or stance.posture is not None:
        return plain
    if not stance.is_constrained:
        return keep_orientation(chain, target, start, plain)
    solver = OrientationSolver(chain, tool, target, stance, start)
    best = solver.evaluate(plain)
    for candidate in solver.candidates(plain):
        best = min(best, candidate, key=lambda each: each.orientation_error_rad)
        if best.orientation_error_rad < KEPT_ORIENTATION_TOLERANCE_RAD:
            break
    solver.check_error(best)
    return best


def check_orientation_error(
    chain: Chain, tool: ToolFrame, target: Target, stance: ToolOrientation, solution: Result
) -> Result:
    """Return a solution with the orientation error of the tool.

    Raises:
        OrientationError: The error is larger than the tolerance.
    """
    solver = OrientationSolver(chain, tool, target, stance, solution.q)
    solved = solver.evaluate(solution)
    solver.check_error(solved)
    return solved
