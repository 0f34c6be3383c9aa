"""Write a tree of links and joints as the text of a URDF."""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.sax.saxutils import quoteattr

from ikservo.model.urdf_types import (
    Box,
    Cylinder,
    Mesh,
    Shape,
    Sphere,
    Surface,
    Triple,
    Urdf,
    UrdfJoint,
)

_UNLIMITED = 1e6  # N m or rad/s; some readers require both values in <limit>


def urdf_text(urdf: Urdf) -> str:
    """Return a tree as the text of a URDF, without surfaces that exist only in memory."""
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(urdf.name or 'arm')}>"]
    for link in urdf.links:
        body: list[str] = []
        if link.mass_kg > 0.0:
            names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
            values = zip(names, link.inertia_kg_m2, strict=True)
            moments = " ".join(f'{name}="{_number(value)}"' for name, value in values)
            origin = _origin(link.com_m, link.inertia_rpy_rad)
            mass = f'<mass value="{_number(link.mass_kg)}"/>'
            body.append(f"<inertial>{origin}{mass}<inertia {moments}/></inertial>")
        for shape in link.collisions:
            body += _shape("collision", shape, None)
        colours = link.colours or (None,) * len(link.visuals)
        for shape, colour in zip(link.visuals, colours, strict=True):
            body += _shape("visual", shape, colour)
        tag = f"  <link name={quoteattr(link.name)}"
        lines += (
            [f"{tag}>", *(f"    {line}" for line in body), "  </link>"] if body else [f"{tag}/>"]
        )
    for joint in urdf.joints:
        lines += _joint(joint)
    return "\n".join([*lines, "</robot>", ""])


def _number(value: float) -> str:
    """Format a number so that it is read back exactly."""
    return repr(float(value)).removesuffix(".0") if value else "0"


def _numbers(values: Triple) -> str:
    return " ".join(_number(value) for value in values)


def _origin(xyz_m: Triple, rpy_rad: Triple) -> str:
    return f'<origin xyz="{_numbers(xyz_m)}" rpy="{_numbers(rpy_rad)}"/>'


def _shape(tag: str, shape: Shape, colour: Triple | None) -> Iterator[str]:
    match shape:
        case Box(size_m=size_m):
            geometry = f'<box size="{_numbers(size_m)}"/>'
        case Cylinder(radius_m=radius_m, length_m=length_m):
            geometry = f'<cylinder radius="{_number(radius_m)}" length="{_number(length_m)}"/>'
        case Sphere(radius_m=radius_m):
            geometry = f'<sphere radius="{_number(radius_m)}"/>'
        case Mesh(filename=filename):
            geometry = f"<mesh filename={quoteattr(filename)}/>"
        case Surface():
            return
    material = ""
    if colour is not None:
        material = f'<material name=""><color rgba="{_numbers(colour)} 1"/></material>'
    origin = _origin(shape.xyz_m, shape.rpy_rad)
    yield f"<{tag}>{origin}<geometry>{geometry}</geometry>{material}</{tag}>"


def _joint(joint: UrdfJoint) -> Iterator[str]:
    yield f'  <joint name={quoteattr(joint.name)} type="{joint.kind.value}">'
    yield f"    <parent link={quoteattr(joint.parent)}/><child link={quoteattr(joint.child)}/>"
    yield f"    {_origin(joint.xyz_m, joint.rpy_rad)}"
    if joint.kind.is_movable:
        yield f'    <axis xyz="{_numbers(joint.axis)}"/>'
    if joint.kind.is_movable and math.isfinite(joint.upper - joint.lower):
        strengths = "".join(
            f' {name}="{_number(min(value, _UNLIMITED))}"'
            for name, value in (("effort", joint.effort), ("velocity", joint.velocity))
        )
        limits = f'lower="{_number(joint.lower)}" upper="{_number(joint.upper)}"'
        yield f"    <limit {limits}{strengths}/>"
    if joint.mimic is not None:
        follows = joint.mimic
        values = f'multiplier="{_number(follows.multiplier)}" offset="{_number(follows.offset)}"'
        yield f"    <mimic joint={quoteattr(follows.joint)} {values}/>"
    yield "  </joint>"
