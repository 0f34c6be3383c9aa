"""Deflection behind the joint sensors of an arm: compliance and backlash, under gravity.

A sensor on a servo's shaft does not measure the horn, the screws and the printed link that the
shaft drives. These parts turn by ``compliance * torque``, and across their backlash to the side to
which gravity pulls. The torque depends on the posture of the links, so the link joints solve
``q_link = q - compliance g(q_link) - half_play side(g(q_link))``; the inverse is explicit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.kinematics.dynamics import Dynamics

# This torque presses a joint to one side of its backlash; below it the side is uncertain.
_SIDE_NM = 0.05
# Each step multiplies the error by compliance times stiffness of gravity, a tenth or less for most
# arms. Half steps help arms for which this factor is more than one.
_STEPS = 80  # maximum number of steps
_WHOLE_STEPS = 8  # number of whole steps; further steps are half steps
_ENOUGH_RAD = 1e-9  # a smaller change ends the steps
_DERIVATIVE_RAD = 1e-4  # offset of a joint to compute the stiffness of gravity


@dataclass(frozen=True, slots=True, eq=False)
class Bending(FrozenArrays):
    """Compliance and backlash behind the sensors of a chain's joints.

    Attributes:
        dynamics: The dynamics of the chain that does not bend, with the masses of its links.
        compliance: The compliance of each joint (dof,), rad per N m (m per N).
        half_play: Half the backlash of each joint (dof,), rad (m).
    """

    dynamics: Dynamics
    compliance: Vector
    half_play: Vector

    def deflection(self, q_link: ArrayLike) -> Vector:
        """Compute the deflection under gravity, (dof,) or (n, dof), shaped like ``q_link``."""
        torque = self.dynamics.gravity_torques(q_link)
        return -self.compliance * torque - self.half_play * self.side(torque)

    def link_joints(self, q: ArrayLike) -> Vector:
        """Compute the link joints from the sensor joints, (dof,) or (n, dof), rad or m."""
        sensed = np.asarray(q, dtype=np.float64)
        found = sensed
        for step in range(_STEPS):
            change = sensed + self.deflection(found) - found
            found = found + (change if step < _WHOLE_STEPS else 0.5 * change)
            if float(np.abs(change).max(initial=0.0)) < _ENOUGH_RAD:
                break
        return found

    @staticmethod
    def side(torque: Vector) -> Vector:
        """Return the side of the backlash, -1 to 1, to which a torque presses a joint."""
        return np.tanh(torque / _SIDE_NM)

    def derivatives(self, q_link: Matrix) -> tuple[Matrix, Matrix, Matrix]:
        """Compute derivatives of link joints with respect to sensors, compliances, half backlashes.

        Returns:
            The derivatives (n, dof, dof) with respect to each of these, column by column.
        """
        n, dof = q_link.shape
        steps = _DERIVATIVE_RAD * np.eye(dof)
        near = np.concatenate([q_link[:, None] + steps, q_link[:, None] - steps], axis=1)
        torques = self.dynamics.gravity_torques(near.reshape(-1, dof)).reshape(n, 2 * dof, dof)
        slope = (torques[:, :dof] - torques[:, dof:]).swapaxes(1, 2) / (2.0 * _DERIVATIVE_RAD)
        torque = self.dynamics.gravity_torques(q_link)
        side = self.side(torque)
        yields = self.compliance + self.half_play * (1.0 - side**2) / _SIDE_NM
        follow = np.linalg.inv(np.eye(dof) + yields[:, :, None] * slope).astype(np.float64)
        return follow, -follow * torque[:, None, :], -follow * side[:, None, :]
