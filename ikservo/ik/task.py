"""What is wanted, as the lecture writes it: E = M - f(q), one long vector, and its Jacobian."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ikservo.ik.options import Tolerance
from ikservo.ik.target import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector, skew

__all__ = ["LEVER_M", "Local", "Task", "pressed"]

LEVER_M = 0.1
"""One radian weighs like this many metres, about half of a small arm."""


@dataclass(frozen=True, slots=True, eq=False)
class Local:
    """The error at one q, and how each joint changes it.

    Attributes:
        q: Joints (dof,), rad or m.
        E: What is left, M - f(q) (m,), metres.
        J: df/dq (m, dof), metres per rad or m (lecture L6).
        axes: What each joint turns the frame about (3, dof), rad per rad; 0 for a slide.
    """

    q: Vector
    E: Vector
    J: Matrix
    axes: Matrix

    @property
    def cost(self) -> float:
        """Return ``|E|²`` [m²], which every method brings down (lecture L13)."""
        return float(self.E @ self.E)


class Task:
    """A target, asked of a chain.

    f(q) stacks the point and, where a direction or an orientation is wanted, the tips of the
    tool's axes a lever's length away: one axis for a direction, all three for an orientation. So
    every row is in metres, and a position and an orientation can be weighed against each other.
    """

    def __init__(self, chain: Chain, target: Target) -> None:
        self.chain, self.target = chain, target
        self._axes_tool, wanted = _watched_axes(target)
        self._M = np.concatenate([target.position, wanted.ravel()])

    def at(self, q: Vector) -> Local:
        """Return the error and its derivatives at joints (dof,)."""
        T, J = self.chain.linearise(q, self.target.frame, self.target.offset_m)
        axes = self._axes_tool @ T[:3, :3].T
        f = np.concatenate([T[:3, 3], axes.ravel()])
        swings = [-skew(axis) @ J[3:] for axis in axes]  # ω × a = -a × ω
        return Local(q, self._M - f, np.vstack([J[:3], *swings]), J[3:])

    def met(self, here: Local, tolerance: Tolerance) -> bool:
        """Return whether what is left is at most half the tolerance.

        Half, so that no rounding between here and the answer makes a miss of it.
        """
        gap_m, turn_rad = _length(here.E[:3]), _length(here.E[3:]) / LEVER_M
        return gap_m <= 0.5 * tolerance.position_m and turn_rad <= 0.5 * tolerance.orientation_rad


def pressed(chain: Chain, q: Vector, tau: Vector) -> NDArray[np.bool_]:
    """Return the joints (dof,) that stand on a limit and that tau (dof,) pulls against it."""
    return ((q <= chain.lower_rad) & (tau < 0.0)) | ((q >= chain.upper_rad) & (tau > 0.0))


def _watched_axes(target: Target) -> tuple[Matrix, Matrix]:
    """Return the axes (k, 3) to watch, in the tool's coordinates, and where they shall point."""
    if target.rotation is not None:
        # A small turn moves two of three axes: each has its share of the weight.
        share_m = LEVER_M / math.sqrt(2.0)
        return share_m * np.eye(3), share_m * target.rotation.T
    if target.wanted_axis is not None:
        return LEVER_M * target.axis[None, :], LEVER_M * target.wanted_axis[None, :]
    return np.zeros((0, 3)), np.zeros((0, 3))


def _length(v: Vector) -> float:
    return math.sqrt(float(v @ v))
