"""Describe an arm that was measured with a ruler: a column of joints, upright at zero."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ikservo.apps.importing.description_sources import Description
from ikservo.apps.importing.packages import PackageFolders
from ikservo.errors import BadValueError
from ikservo.model.urdf_types import (
    Cylinder,
    Shape,
    Triple,
    Urdf,
    UrdfJoint,
    UrdfJointType,
    UrdfLink,
)

AXES = {"z": (0.0, 0.0, 1.0), "y": (0.0, 1.0, 0.0), "x": (1.0, 0.0, 0.0)}
"""Axes of joints: z turns the upright arm, y bends it forwards, x bends it to the side."""

_RADIUS_M, _FOOT_M = 0.02, 0.05
_LIMIT_RAD = math.radians(90.0)
_MAX_LENGTH_M = 2.0


@dataclass(frozen=True, slots=True)
class RulerJoint:
    """A joint: its axis in the upright arm, and the length [m] to the next joint or the tip."""

    name: str
    axis: str
    length_m: float


def parse_measured(text: str) -> RulerJoint:
    """Parse ``NAME=AXIS:LENGTH``, such as ``shoulder=y:0.12``.

    Raises:
        BadValueError: The text has a different form.
    """
    name, _, rest = text.partition("=")
    axis, _, length = rest.partition(":")
    try:
        length_m = float(length)
    except ValueError:
        length_m = math.nan
    if not name or axis not in AXES or not 0.0 < length_m <= _MAX_LENGTH_M:
        raise BadValueError("The joint", text, "NAME=AXIS:METRES, such as shoulder=y:0.12")
    return RulerJoint(name, axis, length_m)


def describe_measured(name: str, joints: Sequence[RulerJoint]) -> Description:
    """Describe an arm of given joints, base first, upright at zero; joint 1 is at 0.05 m."""
    links, moving = [_part("base", _FOOT_M, 2.0 * _RADIUS_M)], list[UrdfJoint]()
    height_m = _FOOT_M
    for i, joint in enumerate(joints, start=1):
        links.append(_part(f"part_{i}", joint.length_m, _RADIUS_M))
        axis = AXES[joint.axis]
        moving.append(_joint(joint.name, links[i - 1].name, links[i].name, height_m, axis))
        height_m = joint.length_m
    links.append(_part("tip", 0.0, 0.0))
    moving.append(_joint("tip_mount", links[-2].name, "tip", height_m, None))
    urdf = Urdf(name, tuple(links), tuple(moving), "base")
    notes = ["The arm was measured: it stands upright at zero, and has no masses."]
    return Description(Path("a ruler"), urdf, PackageFolders(Path(name)), notes)


_ZERO: Triple = (0.0, 0.0, 0.0)


def _part(name: str, length_m: float, radius_m: float) -> UrdfLink:
    """Return a link that stands on its joint; its shape touches neither joint."""
    shapes: tuple[Shape, ...] = ()
    if radius_m and length_m:
        radius_m = min(radius_m, 0.4 * length_m)
        straight_m = max(length_m - 2.0 * radius_m, 0.1 * length_m)
        shapes = (Cylinder(radius_m, straight_m, (0.0, 0.0, 0.5 * length_m), _ZERO),)
    return UrdfLink(name, collisions=shapes, visuals=shapes)


def _joint(name: str, parent: str, child: str, height_m: float, axis: Triple | None) -> UrdfJoint:
    """Return a joint that turns about ``axis``, or a fixed joint if ``axis`` is None."""
    kind = UrdfJointType.FIXED if axis is None else UrdfJointType.REVOLUTE
    joint = UrdfJoint(name, kind, parent, child, (0.0, 0.0, height_m), _ZERO)
    return joint if axis is None else replace(joint, axis=axis, lower=-_LIMIT_RAD, upper=_LIMIT_RAD)
