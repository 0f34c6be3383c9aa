"""Each joint's range as an arc with a needle, or as a track where the joint slides."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ikservo.kinematics import Chain, JointKind, Step
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.view.camera.camera import Camera
from ikservo.view.scene.items import Item, circle, polyline

__all__ = ["AMBER_RAD", "RED_RAD", "Dial", "dials_of", "draw_dial", "nearness"]

Nearness = Literal["limit", "amber", "red"]

AMBER_RAD, RED_RAD = math.radians(5.0), math.radians(0.3)
"""How near to a limit a joint is said to be near, and at it; as many metres / 17 for a slide."""

_SLIDE_M_PER_RAD = 0.057  # 5 mm of a slide count like 5°
_RADIUS_PX, _HUB_PX = 26.0, 3.0
_STEP_RAD = math.radians(6.0)
_LEAST_ARM_M = 0.005
# An axis flatter to the screen than this shows its arc as a line: the dial is turned to the eye.
_EDGE_ON = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class Dial:
    """Where a joint is in the chain, and which way its needle points.

    Attributes:
        column: The joint's entry of q.
        step: The joint on its way to the tip.
        needle: A unit vector (3,) across the axis, in the child link's coordinates.
        side: The third one (3,), where the needle points after a quarter of a turn.
    """

    name: str
    column: int
    step: Step
    needle: Vector
    side: Vector

    @property
    def slides(self) -> bool:
        """Return whether the joint is a slide."""
        return self.step.joint.kind is JointKind.PRISMATIC

    def place(self, poses: Mapping[str, Matrix]) -> tuple[Vector, Vector]:
        """Return the pivot (3,) [m], of a slide its zero, and the axis (3,), world coordinates."""
        joint = self.step.joint
        T_world_joint = poses[joint.parent] @ joint.origin
        return T_world_joint[:3, 3], T_world_joint[:3, :3] @ joint.axis

    def hub(self, poses: Mapping[str, Matrix], q: Vector) -> Vector:
        """Return where the joint is (3,): its pivot, or how far it has slid."""
        pivot, axis = self.place(poses)
        return pivot + float(q[self.column]) * axis if self.slides else pivot


def dials_of(chain: Chain, q: Vector) -> tuple[Dial, ...]:
    """Return a dial for each joint that q (dof,) moves; needles point to the next joint."""
    moving = [step for step in chain.way() if step.joint.mimic is None and step.scale]
    poses = chain.link_poses(q)
    ends = [(poses[step.joint.parent] @ step.joint.origin)[:3, 3] for step in moving[1:]]
    ends.append(poses[chain.tip][:3, 3])
    return tuple(
        _dial(step, _needle(step, poses[step.joint.child], end))
        for step, end in zip(moving, ends, strict=True)
    )


def _dial(step: Step, needle: Vector) -> Dial:
    side = np.cross(step.joint.axis, needle)
    return Dial(step.joint.name, step.column, step, needle, side)


def nearness(chain: Chain, q: Vector, column: int) -> Nearness:
    """Return ``amber`` within 5° (5 mm) of a limit, ``red`` at it, else ``limit``."""
    room = min(q[column] - chain.lower_rad[column], chain.upper_rad[column] - q[column])
    if chain.kinds[column] is JointKind.PRISMATIC:
        room /= _SLIDE_M_PER_RAD
    return "red" if room <= RED_RAD else "amber" if room <= AMBER_RAD else "limit"


def draw_dial(
    dial: Dial, chain: Chain, q: Vector, poses: Mapping[str, Matrix], camera: Camera, style: str
) -> list[Item]:
    """Return arc, needle and hub of one joint; the arc in ``style``."""
    low, high, now = (float(v[dial.column]) for v in (chain.lower_rad, chain.upper_rad, q))
    pivot, axis = dial.place(poses)
    hub, _ = camera.project(dial.hub(poses, q))
    if dial.slides:
        ends = np.array([pivot + v * axis for v in (low, high)])
        lines = [polyline(style, camera.project(ends)[0], joint=dial.name)]
    else:
        arc = _arc(dial, (low, high, now), (pivot, axis), poses, camera)
        lines = [polyline(style, arc[:-1], joint=dial.name)]
        lines.append(polyline("needle", [hub, arc[-1]], joint=dial.name))
    return [*lines, circle("hub", hub, _HUB_PX, joint=dial.name)]


def _arc(
    dial: Dial,
    range_rad: tuple[float, float, float],
    line: tuple[Vector, Vector],
    poses: Mapping[str, Matrix],
    camera: Camera,
) -> Matrix:
    """Return the arc's pixels (k, 2), the needle's end last."""
    low, high, now = range_rad
    pivot, axis = line
    angles = _angles(low, high, now)
    R_world_child = poses[dial.step.joint.child][:3, :3]
    first, second = R_world_child @ dial.needle, R_world_child @ dial.side
    sight = pivot - camera.eye_m if camera.perspective else camera.forward
    if abs(float(axis @ sight)) < _EDGE_ON * math.sqrt(float(sight @ sight)):
        angles, first, second = angles + now, camera.up, camera.right
    radius_m = _RADIUS_PX / float(camera.pixels_per_metre(camera.depth_of(pivot)))
    across = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
    return camera.project(pivot + radius_m * across)[0]


def _angles(low: float, high: float, now: float) -> Vector:
    """Return the angles (k,) of the arc from the needle, and the needle's own, 0, last."""
    if not math.isfinite(high - low):
        low, high = now - math.pi, now + math.pi
    count = max(2, math.ceil((high - low) / _STEP_RAD) + 1)
    angles = np.empty(count + 1)
    angles[:-1] = (low - now) + np.arange(count) * ((high - low) / (count - 1))
    angles[-1] = 0.0
    return angles


def _needle(step: Step, T_world_child: Matrix, towards_m: Vector) -> Vector:
    """Return the direction (3,) across the axis to a point, in the child's coordinates."""
    axis = step.joint.axis
    way = T_world_child[:3, :3].T @ (towards_m - T_world_child[:3, 3])
    across = way - axis * float(axis @ way)
    if math.sqrt(float(across @ across)) < _LEAST_ARM_M:  # a roll: any direction will do
        helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
        across = helper - axis * float(axis @ helper)
    return across / math.sqrt(float(across @ across))
