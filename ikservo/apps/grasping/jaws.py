"""Where the jaws of a gripper are: what is gripped is seldom at the tip of an arm."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ikservo.errors import IkservoError
from ikservo.kinematics.arrays import Matrix, Vector, freeze_arrays
from ikservo.kinematics.capsules import segment_distance
from ikservo.model import Model
from ikservo.model.collision_model import capsules_of, collision_body_with_gripper
from ikservo.model.tool import tool_frame

_POSITIONS = 41
_LINE_M = np.arange(-0.15, 0.1501, 0.001)  # places along the axis on which the jaws open
_DEPTHS_M = np.array([0.0, -0.005, -0.01])  # along the tool, at which the jaws are looked for
_FINGER_M = 0.015  # a finger ends at most this far from the tip, and moves further


@dataclass(frozen=True, slots=True, eq=False)
class Jaws:
    """The space between the jaws on the axis (3,) on which they open, in coordinates of the tip.

    Positions of the joint (k,) run from closed to open; ``low_m`` and ``high_m`` (k,) are the
    inner faces there, metres from the tip, infinite if a jaw does not reach down to it.
    """

    axis: Vector
    positions: Vector
    low_m: Vector
    high_m: Vector

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def most_m(self) -> float:
        """The largest width between the jaws."""
        return float(np.max(self.high_m - self.low_m, where=np.isfinite(self.high_m), initial=0.0))

    def at_width(self, width_m: float) -> tuple[float, Vector]:
        """Return the position of the joint at a width, and the middle of the jaws (3,) there."""
        at = int(np.argmax(self.high_m - self.low_m >= width_m))
        return float(self.positions[at]), (self.low_m[at] + width_m / 2.0) * self.axis


def find_jaws(model: Model) -> Jaws:
    """Find the jaws in the shapes of an arm's links; widths of the arm file are preferred.

    Raises:
        IkservoError: The arm has no gripper, or its width does not follow from arm file and shapes.
    """
    gripper, tool, hint = model.gripper, tool_frame(model), "Its arm file needs widths ([gripper])."
    if gripper is None:
        raise IkservoError(f"{model.name} has no gripper.", "It cannot pick up anything.")
    positions = np.linspace(gripper.closed, gripper.open, _POSITIONS)
    starts_m, ends_m, radii_m = _fingers(model, positions)
    points_m = np.concatenate([starts_m, ends_m], axis=1)
    ahead_m = points_m @ tool.approach_axis
    shift_m = (points_m - ahead_m[..., None] * tool.approach_axis)[[0, -1]]
    moved_m = np.linalg.norm(shift_m[1] - shift_m[0], axis=1) * (np.abs(ahead_m[0]) < _FINGER_M)
    best = int(np.argmax(moved_m))
    is_seen = moved_m[best] > _FINGER_M
    axis = (shift_m[1] - shift_m[0])[best] / moved_m[best] if is_seen else tool.left
    if gripper.widths:
        half_m = np.array([gripper.width_m(each) or 0.0 for each in positions]) / 2.0
        return Jaws(axis, positions, -half_m, half_m)
    if not is_seen:
        raise IkservoError(f"The width of the gripper of {model.name} is not known.", hint)
    line_m = _LINE_M[:, None, None] * axis + _DEPTHS_M[:, None] * tool.approach_axis
    line_m = line_m[:, :, None]
    away_m = [segment_distance(a, b, line_m, line_m) for a, b in zip(starts_m, ends_m, strict=True)]
    free = [((each - radii_m).min(axis=(1, 2)) > 0.0) for each in away_m]
    low_m, high_m = np.array([_free_part(each) for each in free]).T
    return Jaws(axis, positions, low_m, high_m)


def _fingers(model: Model, positions: Vector) -> tuple[Matrix, Matrix, Vector]:
    """Return ends (k, c, 3) and radii (c,) of the capsules behind the last joint, seen by the tip.

    There is one row per position (k,) of the gripper's joint.
    """
    chain, moving = collision_body_with_gripper(model).chain, set(model.chain.names)
    q = np.zeros((len(positions), chain.dof))
    if chain.dof > len(moving):
        q[:, -1] = positions
    poses, to_tip = chain.link_poses(q), np.linalg.inv(model.chain.forward(q[:, : len(moving)]))
    capsules = capsules_of(model)
    ours = [c for c in capsules if moving <= {s.joint.name for s in chain.joints_to(c.link)}]
    ends_m = np.array([each.ends(to_tip @ poses[each.link]) for each in ours])
    starts_m, ends_m = np.moveaxis(ends_m, (1, 2), (0, 1))
    return starts_m, ends_m, np.array([each.radius_m for each in ours])


def _free_part(is_free: Vector) -> tuple[float, float]:
    """Return the ends of the free part of the line that is nearest to the tip, metres."""
    free, blocked = np.flatnonzero(is_free), np.flatnonzero(is_free == 0)
    nearest = free[np.argmin(np.abs(_LINE_M[free]))]
    before, after = blocked[blocked < nearest], blocked[blocked > nearest]
    if not len(before) and len(after):  # behind a fixed jaw that the other one touches
        return 0.0, 0.0
    low_m = float(_LINE_M[before[-1]]) if len(before) else -math.inf
    return low_m, float(_LINE_M[after[0]]) if len(after) else math.inf
