"""Mass and inertia of links, and the ten parameters of a rigid body.

The parameters of a body are its mass m [kg], its first moments ``h = m c`` [kg m] and the tensor I
[kg m²] about the origin of its frame, not about the centre of mass c, because forces are linear in
these (Atkeson, An, Hollerbach 1986). The pseudo-inertia matrix holds the same numbers::

    P = ∫ [x; 1] [x; 1]ᵀ dm = [[½ tr(I) 1 - I, h], [hᵀ, m]]

and is transformed from one frame to another by ``P_a = T_a_b P_b T_a_bᵀ`` (Wensing, Kim, Slotine,
"Linear matrix inequalities for physically-consistent inertial parameter identification", 2018).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ikservo.errors import BadValueError
from ikservo.kinematics.arrays import Matrix, Vector, finite_array, finite_vector, read_only

GRAVITY_M_S2 = 9.81

PARAMETERS = ("m", "mx", "my", "mz", "ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""The order of a body's parameters; the tensor in URDF's order."""

_SYMMETRY = 1e-9  # fraction of the largest entry


@dataclass(frozen=True, slots=True, eq=False)
class LinkMass:
    """The mass of a link, or of something fixed to it.

    Attributes:
        link: The link.
        mass_kg: The mass, zero or more.
        centre_m: The centre of mass (3,) in the link's frame.
        inertia_kg_m2: The inertia tensor (3, 3) about the centre of mass, in the link's axes; by
            default zero, as for a point mass.

    Raises:
        BadValueError: A mass is below zero, a number is not finite, a shape is wrong, or a tensor
            is not symmetric.
    """

    link: str
    mass_kg: float
    centre_m: Vector
    inertia_kg_m2: Matrix = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self) -> None:
        mass = finite_array(self.mass_kg, (), f"The mass of {self.link}")
        if mass < 0.0:
            raise BadValueError(f"The mass of {self.link}", f"{mass:g} kg", "zero or more")
        centre = finite_vector(self.centre_m, 3, f"The centre of mass of {self.link}")
        tensor = finite_array(self.inertia_kg_m2, (3, 3), f"The inertia tensor of {self.link}")
        skewness = (tensor - tensor.T).max()  # each difference occurs with both signs
        if skewness > _SYMMETRY * np.abs(tensor).max():
            raise BadValueError(
                f"The inertia tensor of {self.link}", str(tensor.tolist()), "a symmetric matrix"
            )
        object.__setattr__(self, "mass_kg", float(mass))
        object.__setattr__(self, "centre_m", read_only(centre))
        object.__setattr__(self, "inertia_kg_m2", read_only(tensor))


def pseudo_inertia(mass: LinkMass) -> Matrix:
    """Compute the pseudo-inertia matrix (4, 4) of a mass in the frame of its link."""
    h = mass.mass_kg * mass.centre_m
    tensor = mass.inertia_kg_m2
    P = np.empty((4, 4))
    P[:3, :3] = 0.5 * np.trace(tensor) * np.eye(3) - tensor + np.outer(h, mass.centre_m)
    P[:3, 3] = P[3, :3] = h
    P[3, 3] = mass.mass_kg
    return P


def parameters_of(P: Matrix) -> Vector:
    """Compute the ten parameters (10,) of a pseudo-inertia matrix (4, 4); see ``PARAMETERS``."""
    tensor = np.diag(P)[:3].sum() * np.eye(3) - P[:3, :3]
    return np.array([P[3, 3], *P[:3, 3], *tensor[np.triu_indices(3)]])


def pseudo_inertias(parameters: Vector) -> Matrix:
    """Compute the pseudo-inertia matrices (n, 4, 4) of the parameters (10 n,) of n bodies."""
    return np.tensordot(parameters.reshape(-1, len(PARAMETERS)), PSEUDO_INERTIA_BASIS, axes=1)


def _basis() -> Matrix:
    """Compute the pseudo-inertia matrix's derivatives (10, 4, 4) with respect to its parameters."""
    basis = np.zeros((10, 4, 4))
    basis[0, 3, 3] = 1.0
    for i in range(3):
        basis[1 + i, i, 3] = basis[1 + i, 3, i] = 1.0
    for k, (i, j) in enumerate(zip(*np.triu_indices(3), strict=True), start=4):
        basis[k, i, j] = basis[k, j, i] = -1.0
        if i == j:
            basis[k, :3, :3] += 0.5 * np.eye(3)
    return basis


PSEUDO_INERTIA_BASIS = read_only(_basis())
"""The derivatives (10, 4, 4) of a pseudo-inertia matrix with respect to the ten parameters."""
