"""Feed-forward: the lead that goals need so that joints follow a moving reference.

A position servo is like a spring to its goal: it produces torque only while its joint lags. The
torque that a motion needs is known from masses and motors, so goals lead the reference by the lag::

    L = tau(q, qd, qdd) + d                    gravity and inertia of the links, unmodelled load d
    M = L + J qdd + f                          motor torque, with rotor inertia J and friction f
    u = M + b qd                               duty as torque: b is back-EMF and viscous friction
    offset = sign(u) max(|u| - u0, 0) / k      u0: start-up force of the firmware, k: stiffness

Friction f acts against the motion: it has the sign of the reference's velocity, and grows with the
load of the gears ``|M + L|`` (``model.servo_torque.GearFriction``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics.arrays import Vector
from ikservo.model.joint_drive import ArmParameters, JointDrive
from ikservo.model.load_lag import lifting_torque_nm
from ikservo.model.servo_torque import GearFriction
from ikservo.motion import TrajectoryPoint

# Weight of more than this multiple of the dry friction presses the gears, although the masses and
# the output's part of friction are uncertain; twice this weight certainly does.
_PRESSING = 3.0
_TINY_NM = 1e-6  # smallest dry friction that is used, because weights are divided by it


class FeedForward:
    """Computation of the lead of goals over an arm's reference, without side effects.

    Args:
        parameters: The parameters of the arm; joints without a drive have no offset.
        columns: The columns of the chain's joints among all joints.

    Attributes:
        dry_lag: Lag of each joint (dof,) behind its goal due to dry friction, rad or m.
    """

    def __init__(self, parameters: ArmParameters, columns: Sequence[int]) -> None:
        self.parameters = parameters
        self.columns = tuple(columns)
        self._columns = list(columns)
        self._known = np.array([drive is not None for drive in parameters.drives])
        self._drives = [drive or _NO_DRIVE for drive in parameters.drives]
        self._stiffness = _column(self._drives, "stiffness_nm_rad")
        self._damping = _column(self._drives, "damping_nm_s")
        self._armature = _column(self._drives, "armature_kg_m2")
        self._startup = _column(self._drives, "startup_nm")
        self._delay_s = _column(self._drives, "delay_s")
        self._friction = _FrictionArrays(self._drives)
        dry = [drive.friction.coulomb_nm + drive.friction.slow_nm for drive in self._drives]
        self._dry_friction = np.maximum(dry, _TINY_NM)
        self.dry_lag = self._dry_friction / self._stiffness

    def with_gains(self, shares: Sequence[float]) -> FeedForward:
        """Return a copy with P gains scaled by ``shares`` (dof,) from those in ``parameters``."""
        pairs = zip(self.parameters.drives, shares, strict=True)
        drives = tuple(drive and drive.with_gain(share) for drive, share in pairs)
        return FeedForward(replace(self.parameters, drives=drives), self.columns)

    def inertia_s2(self, positions: Vector) -> Vector:
        """Compute the inertia of each joint and its motor, divided by its stiffness (dof,), s².

        The result is 0 if a motor is not known.

        Args:
            positions: The positions of all joints (n,), rad or m.
        """
        links = self.parameters.dynamics.inertia_matrix(positions[self._columns])
        inertia = np.diagonal(links) + self._armature
        return np.where(self._known, inertia / self._stiffness, 0.0)

    def pressed(self, positions: Vector) -> Vector:
        """Compute the certainty (dof,), 0 to 1, that weight keeps each joint's gears on one flank.

        Args:
            positions: The positions of all joints (n,), rad or m.
        """
        return np.clip(self.weight(positions) / _PRESSING - 1.0, 0.0, 1.0)

    def weight(self, positions: Vector) -> Vector:
        """Compute the weight of the links on each joint (dof,), as a multiple of its dry friction.

        Args:
            positions: The positions of all joints (n,), rad or m.
        """
        weight = np.abs(self.parameters.dynamics.gravity_torques(positions[self._columns]))
        return weight / self._dry_friction

    def overweight(self, positions: Vector) -> NDArray[np.bool_]:
        """Return a mask of the joints (n,) whose servos cannot lift their load for long.

        Args:
            positions: The positions of all joints (n,), rad or m.
        """
        loads_nm = np.abs(self.parameters.dynamics.gravity_torques(positions[self._columns]))
        weak = np.zeros(len(positions), dtype=bool)
        weak[self._columns] = self._known & [
            lifting_torque_nm(drive.friction, load_nm) > drive.sustained_nm
            for drive, load_nm in zip(self._drives, loads_nm.tolist(), strict=True)
        ]
        return weak

    def offsets(
        self,
        point: TrajectoryPoint,
        direction: Vector,
        held_s: float = 0.0,
        unmodelled: Vector | None = None,
    ) -> Vector:
        """Compute the lead of goals over the positions of a reference (n,), rad or m.

        Args:
            point: The reference: positions, velocities and accelerations (n,) of all joints.
            direction: The direction of the friction (n,), -1 to 1: the direction in which each
                joint moves, 0 at rest.
            held_s: Time for which a goal is held until the next one; twice the mean age of goals.
            unmodelled: Additional load of the joints (..., n), given as the lag, rad or m, that it
                would cause without friction; None means no load.

        Returns:
            The offsets (..., n), with the leading dimensions of the unmodelled load.
        """
        offsets = np.zeros_like(point.position) if unmodelled is None else unmodelled.copy()
        q, qd, qdd = (
            each[self._columns] for each in (point.position, point.velocity, point.acceleration)
        )
        links = self.parameters.dynamics.inverse_dynamics(q, qd, qdd)
        links = links + self._stiffness * offsets[..., self._columns]
        driven = links + self._armature * qdd
        friction = self._friction.torque(direction[self._columns], qd, driven + links)
        duty = driven + friction + self._damping * qd
        pressed = np.sign(duty) * np.maximum(np.abs(duty) - self._startup, 0.0)
        delay_s = self._delay_s + 0.5 * held_s
        ahead = delay_s * (qd + 0.5 * delay_s * qdd)
        leads = pressed / self._stiffness + ahead
        offsets[..., self._columns] = np.where(self._known, leads, offsets[..., self._columns])
        return offsets


class _FrictionArrays:
    """Friction parameters of all joints, as arrays."""

    def __init__(self, drives: Sequence[JointDrive]) -> None:
        gears = [drive.friction for drive in drives]
        self._coulomb = np.array([each.coulomb_nm for each in gears])
        self._slow = np.array([each.slow_nm for each in gears])
        self._slow_rad_s = np.array([each.slow_rad_s for each in gears])
        self._load = np.array([each.load for each in gears])
        self._slow_load = np.array([each.slow_load for each in gears])
        self._square = np.array([each.square_per_nm for each in gears])

    def torque(self, direction: Vector, qd: Vector, frictionless: Vector) -> Vector:
        """Compute the motor torque that overcomes friction (dof,), in the direction of the motion.

        The load g of the gears includes the friction itself: ``g = |a + d f|, f = c + l g + s g^2``
        with the load a without friction and the direction d.
        """
        slow = np.exp(-np.abs(qd) / self._slow_rad_s)
        coulomb = self._coulomb + slow * self._slow
        load = self._load + slow * self._slow_load
        side = np.sign(frictionless + direction * coulomb)
        along = side * direction  # 1 if friction adds to the load, -1 if it relieves it
        held, rest = side * frictionless + along * coulomb, 1.0 - along * load
        root = np.sqrt(np.maximum(rest**2 - 4.0 * along * self._square * held, 0.0))
        gears = 2.0 * held / (rest + root)
        return direction * (coulomb + (load + self._square * gears) * gears)


_NO_DRIVE = JointDrive(1.0, 0.0, 0.0, GearFriction(0.0, 0.0, 1.0, 0.0, 0.0))


def _column(drives: Sequence[JointDrive], name: str) -> Vector:
    return np.array([getattr(drive, name) for drive in drives])
