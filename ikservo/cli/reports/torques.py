"""Torques of the joints that a force at the tip has (lecture L11)."""

from __future__ import annotations

from ikservo.kinematics import Chain, JointKind
from ikservo.kinematics.se3 import Vector

__all__ = ["torque_lines"]


def torque_lines(chain: Chain, torques: Vector) -> list[str]:
    """Return one line a joint: what a force at the tip turns or pushes it with (dof,)."""
    width = max(len(name) for name in chain.names)
    rows = zip(chain.names, chain.kinds, torques.tolist(), strict=True)
    return [
        "joint torques of the force, without the arm's own weight:",
        *(
            f"{name:<{width}}  {value:+.3f} {'N' if kind is JointKind.PRISMATIC else 'N m'}"
            for name, kind, value in rows
        ),
    ]
