"""What a URDF may say but hardly means: degrees for radians, ignored limits, unreachable meshes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from ikservo.files.quoting import quoted
from ikservo.model.urdf.elements import Element
from ikservo.model.urdf.parts import JointKind, Mesh, UrdfJoint, UrdfLink

__all__ = ["find_slips"]

# A little more than a turn, since some arms round 2*pi up.
_TURN_RAD = 2 * math.pi + 1e-3


def find_slips(
    root: Element, links: Sequence[UrdfLink], joints: Sequence[UrdfJoint]
) -> tuple[str, ...]:
    """Return one line for each thing that is allowed but looks like a slip."""
    return (*_degrees(joints), *_ignored_limits(root), *_meshes_outside(links))


def _degrees(joints: Sequence[UrdfJoint]) -> Iterator[str]:
    for joint in joints:
        place = f"line {joint.line}: joint {quoted(joint.name)}"
        for side, value in (("lower", joint.lower), ("upper", joint.upper)):
            if joint.kind is JointKind.REVOLUTE and abs(value) > _TURN_RAD:
                yield f"{place} has {side} {value:g} rad, more than a turn; {_if_degrees(value)}"
        for value in joint.rpy_rad:
            if abs(value) > _TURN_RAD:
                yield f"{place} has {value:g} rad in its rpy; {_if_degrees(value)}"


def _if_degrees(value: float) -> str:
    return f"if these are degrees, write {math.radians(value):.6g}"


def _ignored_limits(root: Element) -> Iterator[str]:
    for joint in root.each("joint"):
        limit = joint.optional("limit")
        continuous = joint.text("type") == JointKind.CONTINUOUS.value
        if continuous and limit and {"lower", "upper"} & limit.attributes.keys():
            place = f"line {limit.line}: joint {quoted(joint.name())}"
            yield f'{place} is continuous and ignores its limits; type="revolute" keeps them'


def _meshes_outside(links: Sequence[UrdfLink]) -> Iterator[str]:
    shapes = [shape for link in links for shape in (*link.collisions, *link.visuals)]
    outside = [shape for shape in shapes if isinstance(shape, Mesh) and shape.path is None]
    if outside:
        first = quoted(outside[0].filename)
        yield f"meshes outside the model's folder cannot be used: {len(outside)}, first {first}"
