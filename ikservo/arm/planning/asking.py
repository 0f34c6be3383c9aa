"""Asks for one stance of the tool at one point, by every heading that may have it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ikservo.arm.planning.keeping import REACHED_M, ROUNDS, STANDS_RAD, Standing, kept
from ikservo.arm.planning.stance import Stance
from ikservo.errors import OrientationError
from ikservo.ik import Result, Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector, log_so3
from ikservo.model.tool import Tool, pointing
from ikservo.motion.tool_curve import KEPT_RAD

__all__ = ["Asker"]

# Few starts: most questions here have no exact answer, and each start is tried in vain.
_RESTARTS = 20
_NOWHERE_M, _UPRIGHT = 1e-6, 0.99
_POSE_DOF = 6  # so many joints it takes to have any orientation at a point


class Asker:
    """Asks for one stance at one point, from where the arm is."""

    def __init__(
        self, chain: Chain, tool: Tool, target: Target, stance: Stance, here: Vector
    ) -> None:
        self._chain, self._tool, self._target = chain, tool, target
        self._stance, self._here = stance, here
        self._first = chain.forward(here)[:3, :3]

    def answers(self, plain: Result) -> Iterator[Standing]:
        """Yield answers, those near the plain one first."""
        whole = self._target_rotation()
        if whole is not None:
            yield from self._solved(whole, plain.q)
        elif self._stance.pitch_rad is None and self._stance.direction is not None:
            yield from self._pointed(plain.q)
        else:
            pitch_rad = self._stance.pitch_rad
            if pitch_rad is None:
                level = kept(self._chain, self._target, self._here, plain).solution.q
                pitch_rad = self._tool.pitch_rad(self._rotation(level))
            outward = self._outward_rad(plain.q)
            for heading_rad in (outward, self._heading_rad(plain.q), outward + math.pi):
                yield from self._headed(heading_rad, pitch_rad, plain.q)

    def _target_rotation(self) -> Matrix | None:
        """Return the whole orientation (3, 3) that is asked for; None where a part of it is."""
        if self._stance.keep:
            return self._first
        return Target((0.0, 0.0, 0.0), orientation=self._stance.orientation).rotation

    def standing(self, solution: Result) -> Standing:
        """Return how the tool stands in a solution."""
        return Standing(solution, self._left_rad(solution.q))

    def check(self, standing: Standing) -> float:
        """Return what is left, if it is little.

        Raises:
            OrientationError: It is more than half a degree.
        """
        if standing.left_rad > KEPT_RAD:
            raise OrientationError(
                self._target.position.tolist(),
                str(self._stance),
                self._words(standing.solution.q),
                standing.left_rad,
                [str(limit) for limit in standing.solution.binding],
                self._freedom(),
            )
        return standing.left_rad

    def _freedom(self) -> str:
        """Say in words what the arm lacks for a whole orientation; nothing where it has it."""
        if self._target_rotation() is None or self._chain.dof >= _POSE_DOF:
            return ""
        return (
            f"{self._chain.dof} joints reach few orientations; a whole pose takes {_POSE_DOF}. "
            "Ask for a direction or a pitch instead."
        )

    def _words(self, q: Vector) -> str:
        """Say how the tool stands at joints, in the terms of what was asked."""
        R = self._rotation(q)
        roll_rad = self._tool.roll_rad(R, self._outward_rad(q))
        x, y, z = (R @ self._tool.ahead).tolist()
        words = [
            f"pitch {math.degrees(self._tool.pitch_rad(R)):z.1f}°",
            f"roll {math.degrees(roll_rad):z.1f}°",
            f"direction {x:z.3f},{y:z.3f},{z:z.3f}",
        ]
        return ", ".join(words)

    def _pointed(self, q: Vector) -> Iterator[Standing]:
        wanted = Target((0, 0, 0), direction=self._stance.direction).wanted_axis
        if wanted is None or self._stance.roll_rad is None:
            yield from self._solved(wanted, q)
            return
        upright = math.hypot(wanted[0], wanted[1]) < math.cos(math.radians(89.5))
        heading_rad = self._outward_rad(q) if upright else math.atan2(wanted[1], wanted[0])
        pitch_rad = math.asin(float(wanted[2]))
        R = self._tool.rotation(heading_rad, pitch_rad, self._stance.roll_rad)
        yield from self._solved(R, q)

    def _headed(self, heading_rad: float, pitch_rad: float, q: Vector) -> Iterator[Standing]:
        """Yield answers with a pitch, each with the heading that the arm had in the one before."""
        for _ in range(ROUNDS):
            if self._stance.roll_rad is None:
                wanted = pointing(heading_rad, pitch_rad)
            else:
                wanted = self._tool.rotation(heading_rad, pitch_rad, self._stance.roll_rad)
            found = list(self._solved(wanted, q))
            yield from found
            if not found or found[0].left_rad < STANDS_RAD:
                return
            q = found[0].solution.q
            before, heading_rad = heading_rad, self._heading_rad(q)
            if abs(math.remainder(heading_rad - before, math.tau)) < STANDS_RAD:
                return

    def _solved(self, wanted: Matrix | Vector | None, q: Vector) -> Iterator[Standing]:
        """Yield answers that have the point and an orientation (3, 3) or direction (3,)."""
        of_axis = wanted is None or wanted.ndim == 1
        target = Target(
            self._target.position,
            direction=wanted if of_axis else None,
            orientation=None if of_axis else wanted,
            tool_axis=self._tool.ahead,
        )
        for restarts in (1, _RESTARTS):
            result = solve(self._chain, target, q, position_first=True, restarts=restarts)
            if result.position_error_m <= REACHED_M:
                yield self.standing(replace(result, reached=True))

    def _left_rad(self, q: Vector) -> float:
        """Return how far the tool is from what was asked, at joints (dof,)."""
        R, stance, left = self._rotation(q), self._stance, [0.0]
        if stance.pitch_rad is not None:
            left.append(abs(self._tool.pitch_rad(R) - stance.pitch_rad))
        if stance.roll_rad is not None:
            roll_rad = self._tool.roll_rad(R, self._outward_rad(q))
            left.append(abs(math.remainder(roll_rad - stance.roll_rad, math.tau)))
        if stance.direction is not None:
            wanted = Target((0, 0, 0), direction=stance.direction, tool_axis=self._tool.ahead)
            left.append(float(np.linalg.norm(wanted.turn_left(R))))
        whole = self._target_rotation()
        if whole is not None:
            left.append(float(np.linalg.norm(log_so3(whole @ R.T))))
        return max(left)

    def _rotation(self, q: Vector) -> Matrix:
        return self._chain.forward(q)[:3, :3]

    def _heading_rad(self, q: Vector) -> float:
        own = self._tool.heading_rad(self._rotation(q))
        return self._outward_rad(q) if own is None else own

    def _outward_rad(self, q: Vector) -> float:
        """Return the heading from the axis of the first joint to the tip."""
        T, J = self._chain.linearise(q)
        away = np.cross(J[:3, 0], J[3:, 0])
        x, y = (away if abs(float(J[5, 0])) > _UPRIGHT else T[:3, 3])[:2].tolist()
        return 0.0 if math.hypot(x, y) < _NOWHERE_M else math.atan2(y, x)
