"""Gravity on a tree of joints: torques at rest and the inertia of each joint."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import NamedTuple

import numpy as np

from servosim.urdf import Matrix, MovingJoint

GRAVITY_M_S2 = 9.81


class MimicDrive(NamedTuple):
    """Driver of a joint: `q = multiplier * positions[driver] + offset`; driver -1: none."""

    driver: int
    multiplier: float
    offset: float


class _JointRow(NamedTuple):
    """A joint as plain numbers: its frame in its parent's (rotation by rows), mass, centre."""

    parent: int
    driver: int
    multiplier: float
    offset: float
    sliding: bool
    xx: float
    xy: float
    xz: float
    yx: float
    yy: float
    yz: float
    zx: float
    zy: float
    zz: float
    px: float
    py: float
    pz: float
    mass_kg: float
    cx: float
    cy: float
    cz: float


# The x and y rows of a frame's rotation, then the x and y of its origin, all in the base.
_Frame = tuple[float, float, float, float, float, float, float, float]
BASE: _Frame = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


class MassTree:
    """Gravity along -z of the base on a tree of joints."""

    def __init__(
        self, joints: Sequence[MovingJoint], driven: Sequence[MimicDrive], count: int
    ) -> None:
        self._joints = joints
        self._driven = driven
        self._count = count
        self._rows = [_make_joint_row(joint, by) for joint, by in zip(joints, driven, strict=True)]
        self._below = np.zeros((len(joints), len(joints)))  # 1 where a body hangs on a joint
        for index in range(len(joints)):
            self._below[index, self._subtree_joints(index)] = 1.0
        self._masses_kg = np.array([joint.body.mass_kg for joint in joints])
        self._below_kg = [float(mass_kg) for mass_kg in self._below @ self._masses_kg]
        self._mounts = np.array([joint.T_parent_joint for joint in joints])
        self._at_zero = np.zeros((len(joints), 4, 4)) + np.eye(4)
        self._sliding = np.array([joint.sliding for joint in joints])
        self._centres_m = np.array([joint.body.com_m for joint in joints])
        self._tensors = np.array([joint.body.inertia_kg_m2 for joint in joints])

    def torques(self, positions: Sequence[float]) -> list[float]:
        """The negative gradient of the potential energy by each driven position.

        Under vertical gravity the torque depends on the horizontal position of the masses only, so
        the x and y rows of the frames are all that is computed.
        """
        frames: list[_Frame] = []
        moments: list[tuple[float, float]] = []
        for row in self._rows:
            frame = _advance_frame(row, frames[row[0]] if row[0] >= 0 else BASE, positions)
            frames.append(frame)
            moments.append(_first_moment(row, frame))
        return self._collect_torques(frames, moments)

    def _collect_torques(
        self, frames: list[_Frame], moments: list[tuple[float, float]]
    ) -> list[float]:
        loads = [0.0] * self._count
        for index in range(len(frames) - 1, -1, -1):
            parent, driver, multiplier, _, sliding = self._rows[index][:5]
            moment_x, moment_y = moments[index]
            if driver >= 0:
                a, b, c, d, e, f, x, y = frames[index]
                mass_kg = self._below_kg[index]
                if sliding:
                    slope = mass_kg * (a * e - b * d)
                else:
                    slope = c * (moment_y - mass_kg * y) - f * (moment_x - mass_kg * x)
                loads[driver] -= multiplier * GRAVITY_M_S2 * slope
            if parent >= 0:
                above_x, above_y = moments[parent]
                moments[parent] = above_x + moment_x, above_y + moment_y
        return loads

    def inertias(self, positions: Sequence[float]) -> list[float]:
        """The inertia along each driven position while all others are held [kg m² or kg]."""
        T = self.frames(positions)
        R, origins_m = T[:, :3, :3], T[:, :3, 3]
        centres_m = (R @ self._centres_m[:, :, None])[:, :, 0] + origins_m
        tensors = R @ self._tensors @ R.transpose(0, 2, 1)
        alone = self._inertias_about(R[:, :, 2], origins_m, centres_m, tensors)
        inertias = [0.0] * self._count
        for (driver, multiplier, _), inertia in zip(self._driven, alone, strict=True):
            if driver >= 0:
                inertias[driver] += multiplier**2 * float(inertia)
        return inertias

    def _inertias_about(
        self, axes: Matrix, origins_m: Matrix, centres_m: Matrix, tensors: Matrix
    ) -> Matrix:
        """Parallel axes: inertia behind each joint about its z axis; mass if it slides along it."""
        r = centres_m - origins_m[:, None]  # from each joint to each body
        along_m = (r @ axes[:, :, None])[:, :, 0]
        arms_m2 = (r * r).sum(axis=2) - along_m**2  # |axis × r|²
        below = self._below @ tensors.reshape(-1, 9)
        spins = (axes[:, None] @ below.reshape(-1, 3, 3) @ axes[:, :, None])[:, 0, 0]
        rotating = (self._below * self._masses_kg * arms_m2).sum(axis=1) + spins
        return np.where(self._sliding, self._below_kg, rotating)

    def _subtree_joints(self, index: int) -> list[int]:
        found = [index]
        for k in range(index + 1, len(self._joints)):
            if self._joints[k].parent in found:
                found.append(k)
        return found

    def frames(self, positions: Sequence[float]) -> Matrix:
        """The frame of each joint in the base (n, 4, 4)."""
        steps = self._mounts @ self._joint_motions(positions)
        frames = np.empty_like(steps)
        for index, joint in enumerate(self._joints):
            above = joint.parent
            frames[index] = steps[index] if above < 0 else frames[above] @ steps[index]
        return frames

    def _joint_motions(self, positions: Sequence[float]) -> Matrix:
        """The motion of each joint's own coordinate: rotation about z, or translation along it."""
        T = self._at_zero.copy()
        for index, (driver, multiplier, offset) in enumerate(self._driven):
            q = offset if driver < 0 else multiplier * positions[driver] + offset
            if self._joints[index].sliding:
                T[index, 2, 3] = q
            else:
                c, s = cos(q), sin(q)
                T[index, 0, 0], T[index, 0, 1], T[index, 1, 0], T[index, 1, 1] = c, -s, s, c
        return T


def _advance_frame(row: _JointRow, above: _Frame, positions: Sequence[float]) -> _Frame:
    """A joint's frame from its parent's."""
    _, driver, multiplier, offset, sliding, xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz = row[
        :17
    ]
    a, b, c, d, e, f, x, y = above
    q = offset if driver < 0 else multiplier * positions[driver] + offset
    x += a * px + b * py + c * pz
    y += d * px + e * py + f * pz
    i, j, k = a * xx + b * yx + c * zx, a * xy + b * yy + c * zy, a * xz + b * yz + c * zz
    m, n, o = d * xx + e * yx + f * zx, d * xy + e * yy + f * zy, d * xz + e * yz + f * zz
    if sliding:
        return i, j, k, m, n, o, x + q * k, y + q * o
    cq, sq = cos(q), sin(q)
    return i * cq + j * sq, j * cq - i * sq, k, m * cq + n * sq, n * cq - m * sq, o, x, y


def _first_moment(row: _JointRow, frame: _Frame) -> tuple[float, float]:
    mass_kg, cx, cy, cz = row[17:]
    a, b, c, d, e, f, x, y = frame
    return mass_kg * (x + a * cx + b * cy + c * cz), mass_kg * (y + d * cx + e * cy + f * cz)


def _make_joint_row(joint: MovingJoint, driven: MimicDrive) -> _JointRow:
    T, body = joint.T_parent_joint, joint.body
    numbers = [*T[:3, :3].ravel(), *T[:3, 3], body.mass_kg, *body.com_m]
    return _JointRow(joint.parent, *driven, joint.sliding, *(float(number) for number in numbers))
