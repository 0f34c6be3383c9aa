"""Find the jaws of a gripper, because a gripped thing is seldom exactly at the tip of the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ikservo.errors import IkservoError
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.capsules import segment_distance
from ikservo.model import Model
from ikservo.model.collision_capsules import capsules_of, collision_body_with_gripper
from ikservo.model.tool import tool_frame

_LINE_M = np.arange(-0.15, 0.1501, 0.001)  # places along the axis on which the jaws open
_DEPTHS_M = np.array([0.0, -0.005, -0.01])  # along the tool, at which the jaws are looked for
_FINGER_M = 0.02  # a finger ends at most this far from the tip, and moves further


@dataclass(frozen=True, slots=True, eq=False)
class Jaws:
    """Inner faces [m] of the jaws along an axis (3,) of the tip, at joint positions (k,).

    The positions run from closed to open. A face is infinite if its jaw does not reach the tip. In
    all positions the jaws reach beyond the tip by ``beyond_m``, along the tool.
    """

    axis: Vector
    positions: Vector
    low_m: Vector
    high_m: Vector
    beyond_m: float = 0.0

    @property
    def most_m(self) -> float:
        """The largest width between the jaws."""
        return float(np.max(self.high_m - self.low_m, where=np.isfinite(self.high_m), initial=0.0))

    @property
    def least_m(self) -> float:
        """The smallest width between the jaws."""
        return float(np.min(self.high_m - self.low_m))

    def at_width(self, width_m: float) -> tuple[float, Vector]:
        """Return the joint position for a width of the jaws, and the middle (3,) between them."""
        at = int(np.argmax(self.high_m - self.low_m >= width_m))
        return float(self.positions[at]), (self.low_m[at] + width_m / 2.0) * self.axis


def find_jaws(model: Model) -> Jaws:
    """Find the jaws from the shapes of an arm's links; widths in the arm file take precedence.

    Raises:
        IkservoError: The arm has no gripper, or neither its arm file nor its shapes give the width.
    """
    gripper, tool, moving = model.gripper, tool_frame(model), set(model.chain.names)
    if gripper is None:
        raise IkservoError(f"{model.name} has no gripper.", "It cannot pick up anything.")
    chain, positions = collision_body_with_gripper(model).chain, np.linspace(0.0, 1.0, 41)
    positions = gripper.closed + (gripper.open - gripper.closed) * positions
    q = np.zeros((len(positions), chain.dof))
    q[:, len(moving) :] = positions[:, None]
    poses, to_tip = chain.link_poses(q), np.linalg.inv(model.chain.forward(q[:, : len(moving)]))
    capsules = [
        each
        for each in capsules_of(model)
        if moving <= {step.joint.name for step in chain.joints_to(each.link)}
    ]
    radii_m = np.array([each.radius_m for each in capsules])
    ends_m = np.array([each.ends(to_tip @ poses[each.link]) for each in capsules])  # (c, 2, k, 3)
    ahead_m = ends_m @ tool.approach_axis
    aside_m = ends_m - ahead_m[..., None] * tool.approach_axis
    shift_m = (aside_m[:, :, -1] - aside_m[:, :, 0]).reshape(-1, 3)
    moved_m = np.linalg.norm(shift_m, axis=1) * (np.abs(ahead_m[:, :, 0]).ravel() < _FINGER_M)
    best = int(np.argmax(moved_m))
    is_seen = moved_m[best] > _FINGER_M
    beyond_m = max(float(ahead_m[best // 2].max(axis=0).min()), 0.0) if is_seen else 0.0
    axis = shift_m[best] / moved_m[best] if is_seen else tool.left
    if gripper.widths:
        half_m = np.array([gripper.width_m(each) or 0.0 for each in positions]) / 2.0
        return Jaws(axis, positions, -half_m, half_m, beyond_m)
    hint = "Give the widths in its arm file ([gripper])."
    unknown = IkservoError(f"The width of the gripper of {model.name} is not known.", hint)
    if not is_seen:
        raise unknown
    at_m = _LINE_M[:, None, None] * axis + _DEPTHS_M[:, None] * tool.approach_axis
    at_m, faces = at_m[:, :, None], np.zeros((len(positions), 2))
    for k in range(len(positions)):
        away_m = segment_distance(ends_m[:, 0, k], ends_m[:, 1, k], at_m, at_m) - radii_m
        is_free = away_m.min(axis=(1, 2)) > 0.0
        free, blocked = np.flatnonzero(is_free), np.flatnonzero(~is_free)
        if not len(free):
            raise unknown
        nearest = free[np.argmin(np.abs(_LINE_M[free]))]
        before, after = _LINE_M[blocked[blocked < nearest]], _LINE_M[blocked[blocked > nearest]]
        if len(before) or not len(after):  # otherwise it is behind a fixed jaw: they are closed
            faces[k] = before.max(initial=-np.inf), after.min(initial=np.inf)
    return Jaws(axis, positions, faces[:, 0], faces[:, 1], beyond_m)
