"""The posture that a person prefers where the target leaves freedom (lecture L10)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ikservo.errors import UnknownNameError
from ikservo.ik import Posture
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model

__all__ = ["HERE", "NONE", "Preference"]

NONE, HERE = "none", "here"
"""No posture; the one the arm has when it is chosen."""

_LEANING = ("auto", "pseudo_inverse")


@dataclass(frozen=True, slots=True)
class Preference:
    """A preferred pose and how strongly each joint leans towards it.

    Attributes:
        pose: ``none``, ``here`` or the name of a pose of the arm.
        weights: Of joints that do not lean with 1; 0 leaves a joint alone.
    """

    pose: str = NONE
    weights: Mapping[str, float] = field(default_factory=dict[str, float])

    def posture(self, model: Model, chain: Chain, here: Vector) -> Posture | None:
        """Return it in joints.

        Args:
            model: Has the poses.
            chain: The joints that lean.
            here: Where they are now (dof,).

        Raises:
            UnknownNameError: No such pose, or no such joint.
        """
        for name in self.weights:
            if name not in chain.names:
                raise UnknownNameError("joint", name, chain.names)
        if self.pose == NONE:
            return None
        q = here.copy() if self.pose == HERE else model.chain_pose(self.pose)
        return Posture(q, np.array([self.weights.get(name, 1.0) for name in chain.names]))

    def told(self, solver: str) -> dict[str, object]:
        """Return it for the page, and whether the chosen solver leans towards it at all."""
        idle = self.pose != NONE and solver not in _LEANING
        note = f"{solver} has no null space: it does not lean." if idle else ""
        return {"pose": self.pose, "weights": dict(self.weights), "note": note}
