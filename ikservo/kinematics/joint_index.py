"""Columns of a chain and its gripper in vectors of all joints of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ikservo.errors import UnknownNameError
from ikservo.kinematics.arrays import Matrix, Vector

_Columns = np.ndarray[tuple[int], np.dtype[np.intp]]


@dataclass(frozen=True, slots=True)
class JointIndex:
    """Meaning of each column in a vector of all joints (n,).

    Attributes:
        names: Names of all joints, in the order used in vectors (n,).
        chain: The columns of the chain's joints (dof,), base to tip.
        body: The columns that move the collision body: the chain's, then the gripper's if the body
            includes it.
    """

    names: tuple[str, ...]
    chain: tuple[int, ...]
    body: tuple[int, ...]
    # The same columns as arrays, because NumPy selects columns ten times as fast with arrays.
    _chain_columns: _Columns = field(init=False, repr=False, compare=False)
    _body_columns: _Columns = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_chain_columns", np.array(self.chain, dtype=np.intp))
        object.__setattr__(self, "_body_columns", np.array(self.body, dtype=np.intp))

    @classmethod
    def from_names(
        cls, names: Sequence[str], chain: Sequence[str], gripper: str | None = None
    ) -> JointIndex:
        """Return the index of a chain's joints, and of a gripper in the body, among all joints.

        Raises:
            ValueError: A joint of the chain is not among all joints.
        """
        names = tuple(names)
        columns = tuple(names.index(name) for name in chain)
        return cls(names, columns, columns if gripper is None else (*columns, names.index(gripper)))

    def column(self, joint: str) -> int:
        """Return the column of a joint.

        Raises:
            UnknownNameError: There is no such joint.
        """
        if joint not in self.names:
            raise UnknownNameError("joint", joint, self.names)
        return self.names.index(joint)

    def chain_joints(self, joints: Matrix) -> Matrix:
        """Return the chain's columns (…, dof) of vectors of all joints (…, n)."""
        return joints.take(self._chain_columns, axis=-1)

    def body_joints(self, joints: Matrix) -> Matrix:
        """Return the collision body's columns of vectors of all joints (…, n)."""
        return joints.take(self._body_columns, axis=-1)

    def with_chain(self, joints: Vector, q: Vector) -> Vector:
        """Return all joints (n,) with the chain's joints replaced by ``q`` (dof,)."""
        replaced = joints.copy()
        replaced[self._chain_columns] = q
        return replaced

    def with_position(self, joints: Vector, joint: str, position: float) -> Vector:
        """Return all joints (n,) with one joint at a different position.

        Raises:
            UnknownNameError: There is no such joint.
        """
        replaced = joints.copy()
        replaced[self.column(joint)] = position
        return replaced

    def by_name(self, joints: Vector) -> dict[str, float]:
        """Return the positions (n,) as a mapping by joint."""
        return dict(zip(self.names, joints.tolist(), strict=True))

    def outside_chain(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return a mask of the joints (n,) outside the chain."""
        return ~np.isin(np.arange(len(self.names)), self.chain)
