"""The masses of a tree of joints: mass matrix, velocity forces and gravity about a posture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin
from typing import NamedTuple

import numpy as np

from servosim.urdf import Mass, Matrix, MovingJoint

GRAVITY_M_S2 = 9.81
# Cross product with a vector as a matrix: v @ _CROSS holds the matrix of v, row by row.
_CROSS = np.zeros((3, 9))
_CROSS[0, [7, 5]] = _CROSS[1, [2, 6]] = _CROSS[2, [3, 1]] = 1.0, -1.0


class MimicDrive(NamedTuple):
    """The driver of a joint: `q = multiplier * positions[driver] + offset`; -1: no driver."""

    driver: int
    multiplier: float
    offset: float


@dataclass(frozen=True, slots=True)
class LocalDynamics:
    """The equations of motion of an arm near a posture q0: `M a = load + forces`.

    Kinetic and potential energy are expanded about q0, the mass matrix to the first and the
    potential to the second order. The equations are exactly those of the expanded energies, so that
    their motions conserve energy.

    Attributes:
        positions: q0 (n,) [rad or m].
        load: Gravity's torques (forces) at q0 (n,).
        load_slope: Derivative of the load with respect to the positions (n, n).
        mass: M at q0 (n, n).
        christoffel: Velocity forces are `-christoffel[i, j, k] v[j] v[k]` (n, n, n); the derivative
            of `M[i, j]` with respect to `q[k]` is `christoffel[i, j, k] + christoffel[j, i, k]`.
    """

    positions: Matrix
    load: Matrix
    load_slope: Matrix
    mass: Matrix
    christoffel: Matrix

    def load_at(self, positions: Matrix, velocities: Matrix) -> Matrix:
        """Compute the torques (forces) of gravity and of the velocities (n,)."""
        moved = self.load + self.load_slope @ (positions - self.positions)
        return moved - (self.christoffel @ velocities) @ velocities

    def mass_at(self, positions: Matrix) -> Matrix:
        """Return M (n, n)."""
        grown = self.christoffel @ (positions - self.positions)
        return self.mass + grown + grown.T


class MassTree:
    """A tree of joints with masses, gravity along -z of its base.

    With the motion `X_i` of joint i as a 4x4 twist in the base, a body at T with the second moments
    P (4x4, in its own frame) has the second moments `S = T P T'` in the base, and

        M[i, j] = sum tr(X_i S X_j'),   christoffel[i, j, k] = sum tr(X_i S (X_j X_k)')

    over the bodies that all of these joints carry, the joint nearer to the base first in `X_j X_k`
    (Uicker 1965, Kahn 1969; Paul, "Robot Manipulators", 1981).
    """

    def __init__(
        self, joints: Sequence[MovingJoint], driven: Sequence[MimicDrive], count: int
    ) -> None:
        self._joints = joints
        self._driven = driven
        self._mounts = np.array([joint.T_parent_joint for joint in joints])
        self._at_zero = np.zeros((len(joints), 4, 4)) + np.eye(4)
        self._sliding = np.array([joint.sliding for joint in joints])[:, None]
        self._moments = np.array([_second_moments(joint.body) for joint in joints])
        self._carries = np.zeros((len(joints), len(joints)))  # 1: the first carries the second
        for index in range(len(joints)):
            self._carries[index, self._subtree_joints(index)] = 1.0
        self._above = self._carries - np.eye(len(joints))
        carried = self._carries.T[None]  # [i, k, j]: j carries k
        self._last_deepest = self._carries[:, :, None] * carried
        self._first_deepest = self._above.T[:, :, None] * carried
        self._gears = np.zeros((len(joints), count))
        for index, (driver, multiplier, _) in enumerate(driven):
            if driver >= 0:
                self._gears[index, driver] = multiplier

    def expand(self, positions: Sequence[float]) -> LocalDynamics:
        """Return the dynamics near a posture, for the driven positions."""
        X, S = self._twists_and_moments(positions)
        count, stacked, gears = len(X), X.reshape(-1, 4), self._gears
        XS = (stacked @ S).reshape(count, count, 16)  # [k, i]: X_i S_k
        XX = (stacked @ X).reshape(count, count, 16)  # [k, j]: X_j X_k
        own = XS[range(count), range(count)]  # X_i S_i
        mass = self._carries * (XS @ X.reshape(count, 16, 1))[:, :, 0].T
        heights = self._carries * (X[:, 2] @ own[:, 3::4].T)  # [j, k] of X_j X_k S_k
        return LocalDynamics(
            np.array(positions, dtype=float),
            -GRAVITY_M_S2 * own[:, 11] @ gears,
            -GRAVITY_M_S2 * (gears.T @ self._mirrored(heights) @ gears),
            gears.T @ self._mirrored(mass) @ gears,
            self._christoffel(XS, XX, own),
        )

    def _christoffel(self, XS: Matrix, XX: Matrix, own: Matrix) -> Matrix:
        """Compute the velocity forces' coefficients for the driven positions."""
        count, gears = len(own), self._gears
        of_last = (XS @ XX.transpose(0, 2, 1)).transpose(1, 0, 2)  # [i, k, j]
        of_first = (own @ XX.reshape(-1, 16).T).reshape(count, count, count)
        C = self._last_deepest * of_last + self._first_deepest * of_first
        C = gears.T @ self._mirrored(C) @ gears
        return (gears.T @ C.reshape(count, -1)).reshape(-1, *C.shape[1:])

    def _mirrored(self, A: Matrix) -> Matrix:
        """Return symmetric matrices (..., n, n) from one given half."""
        return A + (A * (self._above + self._above.T)).swapaxes(-1, -2)

    def _twists_and_moments(self, positions: Sequence[float]) -> tuple[Matrix, Matrix]:
        """Compute each joint's motion, and the second moments of all that it carries (n, 4, 4)."""
        T = self.frames(positions)
        axes, origins_m = T[:, :3, 2], T[:, :3, 3]
        turned = (axes @ _CROSS).reshape(-1, 3, 3)
        X = np.zeros_like(T)
        X[:, :3, 3] = np.where(self._sliding, axes, -(turned @ origins_m[:, :, None])[:, :, 0])
        X[:, :3, :3] = np.where(self._sliding[:, None], 0.0, turned)
        bodies = T @ self._moments @ T.transpose(0, 2, 1)
        return X, (self._carries @ bodies.reshape(-1, 16)).reshape(-1, 4, 4)

    def _subtree_joints(self, index: int) -> list[int]:
        found = [index]
        for k in range(index + 1, len(self._joints)):
            if self._joints[k].parent in found:
                found.append(k)
        return found

    def frames(self, positions: Sequence[float]) -> Matrix:
        """Compute the frame of each joint in the base (n, 4, 4)."""
        steps = self._mounts @ self._joint_motions(positions)
        frames = np.empty_like(steps)
        for index, joint in enumerate(self._joints):
            above = joint.parent
            frames[index] = steps[index] if above < 0 else frames[above] @ steps[index]
        return frames

    def _joint_motions(self, positions: Sequence[float]) -> Matrix:
        """Compute each joint coordinate's motion: rotation about z, or translation along it."""
        T = self._at_zero.copy()
        for index, (driver, multiplier, offset) in enumerate(self._driven):
            q = offset if driver < 0 else multiplier * positions[driver] + offset
            if self._joints[index].sliding:
                T[index, 2, 3] = q
            else:
                c, s = cos(q), sin(q)
                T[index, 0, 0], T[index, 0, 1], T[index, 1, 0], T[index, 1, 1] = c, -s, s, c
        return T


def _second_moments(body: Mass) -> Matrix:
    """Compute the integral of `p p'` over a body's mass, p = (x, y, z, 1) in its frame (4, 4)."""
    tensor, c = body.inertia_kg_m2, body.com_m
    moments = np.empty((4, 4))
    moments[:3, :3] = np.trace(tensor) / 2.0 * np.eye(3) - tensor
    moments[:3, :3] += body.mass_kg * np.outer(c, c)
    moments[:3, 3] = moments[3, :3] = body.mass_kg * c
    moments[3, 3] = body.mass_kg
    return moments
