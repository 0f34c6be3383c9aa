"""Named poses brought inside the limits of the very arm that goes there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ikservo.guard import Fence
from ikservo.kinematics.se3 import Vector

__all__ = ["Inside", "brought_inside", "posed_inside"]

# A joint that hung on its end stop when a pose was taught stood this far beyond its limit at most.
_END_STOP_RAD = math.radians(6.0)


@dataclass(frozen=True, slots=True)
class Inside:
    """A pose as an arm can go to it.

    Attributes:
        positions: By joint, rad or m.
        changed: Which joints stop at a limit short of the pose, in words.
    """

    positions: dict[str, float]
    changed: tuple[str, ...]


def brought_inside(
    pose: Mapping[str, float],
    fences: Sequence[Fence],
    here: Vector,
    most_rad: float = _END_STOP_RAD,
) -> Inside:
    """Return a pose with joints beyond their limits brought to them.

    Args:
        pose: Positions by joint, rad or m; joints that are not named stay where they are.
        fences: The limits, in the order of ``here``.
        here: Where the joints are (n,). One that stands beyond its limit need not come inside.
        most_rad: A joint further beyond, at the horn, is left there for the guard to refuse.
    """
    positions, changed = dict(pose), list[str]()
    for fence, at in zip(fences, here.tolist(), strict=True):
        if fence.joint not in pose or fence.limits.holds(pose[fence.joint]):
            continue
        wanted, (low, high) = pose[fence.joint], fence.positions
        inside = min(max(wanted, min(low, at)), max(high, at))
        joint_map = fence.joint_map
        beyond_rad = (
            max(low - wanted, wanted - high) / joint_map.unit_per_tick * joint_map.horn_rad_per_tick
        )
        if inside != wanted and beyond_rad <= most_rad:
            positions[fence.joint] = inside
            if joint_map.say(inside) != joint_map.say(wanted):  # less is rounding, not news
                changed.append(_said(fence, wanted, inside))
    return Inside(positions, tuple(changed))


def posed_inside(
    name: str, pose: Mapping[str, float], fences: Sequence[Fence], here: Vector
) -> Inside:
    """Return a named pose as an arm goes to it; see ``brought_inside``.

    The rest pose is brought inside the limits whatever they are: an arm must always be able to
    come down. Another pose is where its joints lie on their end stops, just beyond a limit.
    """
    most_rad = math.inf if name == "rest" else _END_STOP_RAD
    return brought_inside(pose, fences, here, most_rad)


def _said(fence: Fence, wanted: float, inside: float) -> str:
    limits, say = fence.limits, fence.joint_map.say
    limit = limits.upper if wanted > inside else limits.lower
    return (
        f"{fence.joint} goes to {say(inside)}, not to {say(wanted)}: "
        f"its limit is {say(limit.value)} ({limit.source})"
    )
