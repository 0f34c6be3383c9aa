"""Dynamics of a chain: gravity torques, inverse dynamics, inertia matrix, regressor.

The equation of motion is ``tau = M(q) qdd + c(q, qd) + g(q)``; tau are the torques that the joints
apply. The recursive Newton-Euler algorithm (Featherstone, "Rigid Body Dynamics Algorithms", 2008,
section 5.3) is written with 4 x 4 matrices in the base frame, as in Legnani et al., "A homogeneous
matrix approach to 3D kinematics and dynamics", 1996: then the recursions over the bodies are sums,
and NumPy computes all bodies, and many samples, at once. With the pose T of a body, the twists D of
the joints and the pseudo-inertia matrix P of the body in its own frame (``kinematics.inertia``)::

    V_i = Σ_j D_j qd_j                            j: joint i and all that carry it
    A_i = Σ_j (D_j qdd_j + (V_j D_j - D_j V_j) qd_j) + V_i V_i - G
    F_i = Σ_k A_k T_k P_k T_kᵀ                    k: body i and all that it carries
    tau_i = tr(D_iᵀ F_i)

``V x`` is the velocity of a body's point x, ``A x`` its acceleration less that of gravity, whose
matrix G has the vector of gravity in the last column, and ``tr(D_iᵀ F_i)`` the work of all forces
``A x dm`` when joint i moves by one unit. A joint that follows others (mimic) has the rate
``scale * qd`` of its leader, which takes ``scale`` times its torque (virtual work).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError, UnknownNameError
from ikservo.kinematics.arrays import (
    Matrix,
    Vector,
    finite_array,
    finite_vector,
    finite_vectors,
    read_only,
)
from ikservo.kinematics.body_tree import BASE, BodyTree
from ikservo.kinematics.chain import Chain
from ikservo.kinematics.inertia import (
    GRAVITY_M_S2,
    PSEUDO_INERTIA_BASIS,
    LinkMass,
    parameters_of,
    pseudo_inertia,
    pseudo_inertias,
)


@dataclass(frozen=True, slots=True, eq=False)
class Dynamics:
    """The bodies that the joints of a chain move, with their masses.

    ``q`` is (dof,) as for the chain, in rad or in m for prismatic joints; ``qd`` and ``qdd`` are
    its time derivatives in rad/s and rad/s² (m/s, m/s²). Each method takes one sample (dof,) or
    many (n, dof). Torques are N m (N for prismatic joints), positive towards increasing q. Friction
    and the inertia of the servos' rotors are not included.

    Attributes:
        chain: The joints of q; a payload is fixed to its tip.
        parameters: Ten parameters of each body (10 bodies,), in its frame; see ``PARAMETERS``.
        gravity_m_s2: The acceleration of a falling body (3,), in the base frame.
    """

    chain: Chain
    parameters: Vector
    gravity_m_s2: Vector
    _tree: BodyTree = field(repr=False)
    _pseudo_inertias: Matrix = field(init=False, repr=False)

    def __post_init__(self) -> None:
        pseudo = pseudo_inertias(self.parameters)[:, None]
        object.__setattr__(self, "_pseudo_inertias", read_only(pseudo))

    @classmethod
    def from_masses(
        cls,
        chain: Chain,
        masses: Sequence[LinkMass],
        gravity_m_s2: ArrayLike = (0.0, 0.0, -GRAVITY_M_S2),
    ) -> Dynamics:
        """Build the dynamics of a chain.

        Args:
            chain: The joints.
            masses: The masses of the chain's links, in any order; several masses of one link add
                up.
            gravity_m_s2: Gravity (3,) in the base frame, downwards. It differs from (0, 0, -9.81)
                for an arm that is mounted on a wall or under a ceiling.

        Raises:
            UnknownNameError: The chain has no such link.
            BadValueError: The gravity is not a vector (3,) of finite numbers.
        """
        tree = BodyTree.of(chain)
        P = np.zeros((len(tree.names), 4, 4))
        for mass in masses:
            _add_mass(P, tree, mass)
        return cls(
            chain=chain,
            parameters=read_only(np.concatenate([parameters_of(each) for each in P])),
            gravity_m_s2=read_only(finite_vector(gravity_m_s2, 3, "The gravity")),
            _tree=tree,
        )

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the moving bodies: for each, the link whose frame is the frame of the body.

        Links that are fixed to a body, or that q does not move, are part of it.
        """
        return self._tree.names

    def with_parameters(self, parameters: ArrayLike) -> Dynamics:
        """Return the same arm with different, for example identified, parameters (10 bodies,).

        The parameters need not be possible for real bodies: base parameters alone give the right
        torques.

        Raises:
            BadValueError: The number of parameters is wrong, or a parameter is not finite.
        """
        values = finite_vector(parameters, len(self.parameters), "The vector of parameters")
        return replace(self, parameters=read_only(values))

    def with_payload(
        self,
        mass_kg: float,
        centre_m: ArrayLike = (0.0, 0.0, 0.0),
        inertia_kg_m2: ArrayLike | None = None,
    ) -> Dynamics:
        """Return the same arm with an additional mass fixed to the tip.

        Args:
            mass_kg: The mass.
            centre_m: The centre of mass (3,) in the tip's frame.
            inertia_kg_m2: The tensor (3, 3) about the centre of mass, in the tip's axes; None means
                a point mass.

        Raises:
            BadValueError: See ``LinkMass``.
        """
        centre = finite_vector(centre_m, 3, "The payload's centre of mass")
        tensor = np.zeros((3, 3)) if inertia_kg_m2 is None else inertia_kg_m2
        tensor = finite_array(tensor, (3, 3), "The payload's inertia tensor")
        P = pseudo_inertias(self.parameters)
        _add_mass(P, self._tree, LinkMass(self.chain.tip, mass_kg, centre, tensor))
        return self.with_parameters(np.concatenate([parameters_of(each) for each in P]))

    def gravity_torques(self, q: ArrayLike) -> Vector:
        """Compute the torques g(q) that hold the arm at rest.

        Args:
            q: Joints (dof,) or (n, dof).

        Returns:
            g, shaped as q.

        Raises:
            BadValueError: ``q`` has a wrong shape or is not finite.
        """
        q = self._check(q, "q")
        tree, samples = self._tree, np.atleast_2d(q)
        T = tree.poses(samples)
        moments = tree.sum_to_base(T @ self._pseudo_inertias[..., 3:])
        moved = (tree.twists(T)[..., :3, :] @ moments)[..., 0]
        return self._generalized(-moved @ self.gravity_m_s2, q)

    def inverse_dynamics(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Vector:
        """Compute the torques for given joint accelerations (recursive Newton-Euler).

        Args:
            q: Joints (dof,) or (n, dof).
            qd: The rates, shaped as q.
            qdd: The accelerations, shaped as q.

        Returns:
            tau, shaped as q.

        Raises:
            BadValueError: A shape is wrong or a number is not finite.
        """
        q, samples = self._check_motion(q, qd, qdd)
        T = self._tree.poses(samples[0])
        D = self._tree.twists(T)
        forces = self._accelerations(D, *samples[1:]) @ self._pseudo_inertias_at(T)
        torques = np.einsum("isab,isab->is", D, self._tree.sum_to_base(forces))
        return self._generalized(torques, q)

    def inertia_matrix(self, q: ArrayLike) -> Matrix:
        """Return the inertia matrix M(q) (Featherstone 2008, section 6.2).

        Args:
            q: Joints (dof,) or (n, dof).

        Returns:
            M (dof, dof) or (n, dof, dof), symmetric: kg m² (kg m, kg for prismatic joints).

        Raises:
            BadValueError: ``q`` has a wrong shape or is not finite.
        """
        q = self._check(q, "q")
        tree = self._tree
        T = tree.poses(np.atleast_2d(q))
        D = tree.twists(T)
        forces = D @ tree.sum_to_base(self._pseudo_inertias_at(T))
        lower = np.einsum("isab,jsab->sij", forces, D) * tree.carries
        M = lower + np.tril(lower, -1).swapaxes(-1, -2)
        M = tree.gears.T @ M @ tree.gears
        return M if q.ndim == 2 else M[0]

    def regressor(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Matrix:
        """Return the regressor Y with ``inverse_dynamics(q, qd, qdd) = Y @ parameters``.

        ``tau_i = Σ_k tr(D_iᵀ A_k T_k P_k T_kᵀ)`` is linear in the matrices P_k, and these in the
        parameters (Atkeson, An, Hollerbach, "Estimation of inertial parameters of manipulator
        loads and links", 1986; Khalil and Dombre, "Modeling, Identification and Control of
        Robots", 2002, chapter 12).

        Args:
            q: Joints (dof,) or (n, dof).
            qd: The rates, shaped as q.
            qdd: The accelerations, shaped as q.

        Returns:
            Y (dof, 10 bodies) or (n, dof, 10 bodies).

        Raises:
            BadValueError: A shape is wrong or a number is not finite.
        """
        q, samples = self._check_motion(q, qd, qdd)
        tree = self._tree
        T = tree.poses(samples[0])
        D = tree.twists(T)
        accelerated = self._accelerations(D, *samples[1:]) @ T
        moved = D[:, None] @ T  # (joint, body, sample, 4, 4)
        work = moved.swapaxes(-1, -2) @ accelerated
        Y = work.reshape(*work.shape[:-2], 16) @ PSEUDO_INERTIA_BASIS.reshape(-1, 16).T
        Y *= tree.carries.T[..., None, None]
        Y = np.tensordot(tree.gears.T, Y, axes=1).transpose(2, 0, 1, 3)
        Y = Y.reshape(len(samples[0]), self.chain.dof, len(self.parameters))
        return Y if q.ndim == 2 else Y[0]

    def _accelerations(self, D: Matrix, qd: Matrix, qdd: Matrix) -> Matrix:
        """Compute the matrices A (bodies, n, 4, 4) of the module's equations."""
        tree, rates = self._tree, self._tree.joint_rates(qd)
        V = tree.sum_to_tips(D * rates)
        A = tree.sum_to_tips(D * tree.joint_rates(qdd) + (V @ D - D @ V) * rates) + V @ V
        A[..., :3, 3] -= self.gravity_m_s2
        return A

    def _pseudo_inertias_at(self, T: Matrix) -> Matrix:
        """Compute the pseudo-inertia matrices (bodies, n, 4, 4) in the base frame."""
        return T @ self._pseudo_inertias @ T.swapaxes(-1, -2)

    def _generalized(self, torques: Matrix, q: Vector) -> Vector:
        """Convert the torques of all joints (bodies, n) to torques for q, shaped as q."""
        return (self._tree.gears.T @ torques).T.reshape(q.shape)

    def _check(self, values: ArrayLike, what: str) -> Vector:
        return finite_vectors(values, self.chain.dof, what)

    def _check_motion(self, *motion: ArrayLike) -> tuple[Vector, list[Matrix]]:
        """Return q in its given shape, and q, qd, qdd as (n, dof) each."""
        checked = [self._check(each, what) for each, what in zip(motion, _MOTION, strict=True)]
        for each, what in zip(checked, _MOTION, strict=True):
            if each.shape != checked[0].shape:
                raise BadValueError(
                    what, f"of shape {each.shape}", f"shape {checked[0].shape}, like q"
                )
        return checked[0], [np.atleast_2d(each) for each in checked]


_MOTION = ("q", "qd", "qdd")


def _add_mass(P: Matrix, tree: BodyTree, mass: LinkMass) -> None:
    """Add a mass to the pseudo-inertia matrices P (bodies, 4, 4), each in its body's frame."""
    if mass.link not in tree.links:
        raise UnknownNameError("link", mass.link, tree.links)
    body, T_body_link = tree.links[mass.link]
    if body != BASE:  # the base does not move
        P[body] += T_body_link @ pseudo_inertia(mass) @ T_body_link.T
