"""Joints that do not influence a target keep their start position.

Joints behind the frame are such, and joints on whose axis the wanted point lies. A search that
starts elsewhere, or leaves a saddle, moves them with all others, and nothing leads them back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics import Chain, JointType
from ikservo.kinematics.arrays import Vector

__all__ = ["IdleJoint", "idle_joints"]

# A joint that moves the point this little [m/rad], or turns its axis, does nothing: the tip of an
# arm with a calibrated roll is further from the axis of that roll.
_NOTHING = 1e-9
_SAMPLES = 5
_IRRATIONAL = np.sqrt(np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0]))


@dataclass(frozen=True, slots=True)
class IdleJoint:
    """A joint that stays, and its range.

    Attributes:
        column: Its place in q.
        lower: Lower limit, rad or m.
        upper: Upper limit.
        period: A turn, after which it stands the same; infinite for a slide.
    """

    column: int
    lower: float
    upper: float
    period: float

    def resting_position(self, start: float) -> float:
        """Return the start, or the value inside the limits that is the same or the nearest."""
        if start > self.upper and math.isfinite(self.period):
            turned = start - self.period * math.ceil((start - self.upper) / self.period)
            return turned if turned >= self.lower else self.upper
        if start < self.lower and math.isfinite(self.period):
            turned = start + self.period * math.ceil((self.lower - start) / self.period)
            return turned if turned <= self.upper else self.lower
        return min(max(start, self.lower), self.upper)


def idle_joints(
    chain: Chain, frame: str | None, offset_m: Vector | None, axis: Vector | None, *, whole: bool
) -> tuple[IdleJoint, ...]:
    """Return the joints that move neither the point nor what else is wanted of it.

    Args:
        chain: The arm.
        frame: The link; the tip if None.
        offset_m: The point (3,) of it; its origin if None.
        axis: An axis (3,) of the link whose direction is wanted, or None.
        whole: Whether the whole orientation is wanted.
    """
    angles = 2.0 * math.pi * ((0.5 + np.outer(np.arange(1, _SAMPLES + 1), _IRRATIONAL)) % 1.0)
    T, J = chain.forward_and_jacobian(np.resize(angles, (_SAMPLES, chain.dof)), frame, offset_m)
    moving = _moving_joints(J[:, :3])
    if whole:
        moving |= _moving_joints(J[:, 3:])
    elif axis is not None:
        pointing = (T[:, :3, :3] @ axis)[:, :, None]
        moving |= _moving_joints(np.cross(J[:, 3:], pointing, axis=1))
    return tuple(_make_idle_joint(chain, int(i)) for i in np.flatnonzero(~moving))


def _moving_joints(rows: Vector) -> NDArray[np.bool_]:
    """Return which joints (dof,) do anything in rows (looks, 3, dof)."""
    return np.abs(rows).max(axis=(0, 1)) > _NOTHING


def _make_idle_joint(chain: Chain, column: int) -> IdleJoint:
    slides = chain.kinds[column] is JointType.PRISMATIC
    lower, upper = float(chain.lower_rad[column]), float(chain.upper_rad[column])
    return IdleJoint(column, lower, upper, math.inf if slides else math.tau)
