"""Compiled computation of the joints' sag under the arm's own weight.

``kinematics.dynamics`` computes the same torques, and a test compares both; for the many postures
of a path, the kernel needs a fifth of the time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.kinematics.inertia import GRAVITY_M_S2, LinkMass
from ikservo.model.arm_model import Model, link_masses
from ikservo.model.joint_drive import joint_compliances

if TYPE_CHECKING:
    from ikservo.model.scene_file import KeepOutShape

Sag = Callable[[Matrix], Matrix]
"""Function that returns the displacement of joints (n, dof) from goals (n, dof) by gravity."""


@dataclass(frozen=True, slots=True, eq=False)
class Weight(FrozenArrays):
    """Masses of the links and compliance of the joints.

    Attributes:
        masses: The masses of the links.
        yields: Compliance of each joint (dof,), rad per N m (m per N).
        lower: The lower end stop of each joint (dof,), rad or m; -inf if there is none.
        upper: The upper end stop of each joint (dof,); inf if there is none.
    """

    masses: Sequence[LinkMass]
    yields: Vector
    lower: Vector
    upper: Vector


class GravitySag:
    """The sag of an arm's joints: the torque of gravity times their compliance.

    A joint does not sag past its end stops.

    Attributes:
        masses: Array (links, 4) of mass [kg] and centre in the link's frame [m].
        bounds: Array (3, dof): compliance for the torque at 1 m/s², lower ends, upper ends.
    """

    def __init__(self, body: CollisionBody, weight: Weight) -> None:
        self._body = packed = body.pack()
        self.masses = np.zeros((len(packed.names), 4))
        for mass in weight.masses:
            self.masses[packed.names.index(mass.link)] = (mass.mass_kg, *mass.centre_m)
        self.bounds = np.array([GRAVITY_M_S2 * weight.yields, weight.lower, weight.upper])

    def __call__(self, q: Matrix) -> Matrix:
        """Return the displacement of joints (n, dof) from goals (n, dof) by gravity, rad or m."""
        from ikservo.kernels.capsule_distances import gravity_torques_kernel  # noqa: PLC0415

        q = np.ascontiguousarray(q, dtype=np.float64)
        torque, places = np.zeros(q.shape), np.empty((len(self._body.names), 12))
        gravity_torques_kernel(self._body.links, self.masses, q, places, torque)
        yields, lower, upper = self.bounds
        return np.clip(q + torque * yields, np.minimum(lower, q), np.maximum(upper, q)) - q


def arm_sag(model: Model, body: CollisionBody, held: Sequence[KeepOutShape] = ()) -> GravitySag:
    """Return the sag of an arm and its gripper under their weight.

    The held things are assumed to weigh ``payload_kg`` together.
    """
    chain = body.chain
    masses = link_masses(model, chain)
    masses += [LinkMass(each.name, model.payload_kg / len(held), each.row[9:12]) for each in held]
    compliances = joint_compliances(model, chain)
    return GravitySag(body, Weight(masses, compliances, chain.lower_rad, chain.upper_rad))
