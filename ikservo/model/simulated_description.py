"""The description that the simulator reads: what the kinematics read, of simple shapes only."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from platformdirs import user_cache_path

from ikservo.files.writing import write_atomic
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.capsules import Capsule
from ikservo.model.arm_file import read_arm_file
from ikservo.model.collision_model import bounding_capsules
from ikservo.model.model import Model
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
    UrdfLink,
)

__all__ = ["description_for_simulator", "plain_urdf"]


def description_for_simulator(model: Model, *, contacts: bool = True) -> Path | None:
    """Return a URDF of simple shapes for the simulator; None where the arm's own is one.

    The simulator reads URDFs and knows no meshes: a link of meshes would have no contact and fall
    through the table. The capsules that the collision check fits to them take their place.

    Args:
        model: The arm.
        contacts: False where contact is not checked either: meshes are left out, not read.

    Raises:
        FileFormatError: A mesh cannot be used; names the link.
        InputError: A mesh needs the extra ``mesh``, which is not installed.
        FileWriteError: The cache of the user cannot be written.
    """
    if model.path.suffix != ".toml" or _is_plain(model.urdf, read_arm_file(model.path).urdf_path):
        return None
    text = plain_urdf(model.urdf, contacts=contacts)
    name = f"{hashlib.sha256(text.encode()).hexdigest()}.urdf"
    path = user_cache_path("ikservo") / "simulated" / name
    if not path.is_file() or path.read_bytes() != text.encode():
        write_atomic(path, text)
    return path


def _is_plain(urdf: Urdf, path: Path) -> bool:
    return path.suffix == ".urdf" and all(
        (link.collisions or not link.visuals)
        and not any(isinstance(shape, Mesh) for shape in link.collisions)
        for link in urdf.links
    )


def plain_urdf(urdf: Urdf, *, contacts: bool = True) -> str:
    """Return a description as the text of a URDF without meshes.

    Raises:
        FileFormatError: A mesh cannot be used; names the link.
        InputError: A mesh needs the extra ``mesh``, which is not installed.
    """
    lines = [f"<robot name={quoteattr(urdf.name or 'arm')}>"]
    for link in urdf.links:
        lines += [f"<link name={quoteattr(link.name)}>", *_inertial(link)]
        for shape in link.collisions or link.visuals:
            lines += _collisions(link.name, shape, contacts=contacts)
        lines.append("</link>")
    for joint in urdf.joints:
        lines += _joint(joint)
    return "\n".join([*lines, "</robot>", ""])


def _numbers(values: Triple | Vector) -> str:
    return " ".join(repr(float(value)) for value in values)


def _origin(xyz_m: Triple | Vector, rpy_rad: Triple) -> str:
    return f'<origin xyz="{_numbers(xyz_m)}" rpy="{_numbers(rpy_rad)}"/>'


def _inertial(link: UrdfLink) -> Iterator[str]:
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    moments = " ".join(f'{n}="{v!r}"' for n, v in zip(names, link.inertia_kg_m2, strict=True))
    origin = _origin(link.com_m, link.inertia_rpy_rad)
    yield f'<inertial>{origin}<mass value="{link.mass_kg!r}"/><inertia {moments}/></inertial>'


def _collisions(link: str, shape: Shape, *, contacts: bool) -> Iterator[str]:
    if isinstance(shape, Mesh | Surface):
        for capsule in bounding_capsules(link, shape) if contacts else ():
            yield from _collisions(link, _cylinder_of(capsule), contacts=contacts)
        return
    match shape:
        case Box(size_m=size_m):
            geometry = f'<box size="{_numbers(size_m)}"/>'
        case Cylinder(radius_m=radius_m, length_m=length_m):
            geometry = f'<cylinder radius="{radius_m!r}" length="{length_m!r}"/>'
        case Sphere(radius_m=radius_m):
            geometry = f'<sphere radius="{radius_m!r}"/>'
    origin = _origin(shape.xyz_m, shape.rpy_rad)
    yield f"<collision>{origin}<geometry>{geometry}</geometry></collision>"


def _cylinder_of(capsule: Capsule) -> Cylinder:
    """Return a cylinder about the axis of a capsule, which ends half a radius inside its tips."""
    along = capsule.end_m - capsule.start_m
    length_m = float(np.linalg.norm(along))
    x, y, z = along / length_m if length_m > 0.0 else np.array([0.0, 0.0, 1.0])
    middle: tuple[float, ...] = tuple((0.5 * (capsule.start_m + capsule.end_m)).tolist())
    return Cylinder(
        capsule.radius_m,
        length_m + capsule.radius_m,
        (middle[0], middle[1], middle[2]),
        (0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x)),
    )


def _joint(joint: UrdfJoint) -> Iterator[str]:
    yield f'<joint name={quoteattr(joint.name)} type="{joint.kind.value}">'
    yield f"<parent link={quoteattr(joint.parent)}/><child link={quoteattr(joint.child)}/>"
    yield _origin(joint.xyz_m, joint.rpy_rad)
    yield f'<axis xyz="{_numbers(joint.axis)}"/>'
    if math.isfinite(joint.upper - joint.lower) and joint.kind.is_movable:
        effort, velocity = (
            "" if math.isinf(value) else f' {name}="{value!r}"'
            for name, value in (("effort", joint.effort), ("velocity", joint.velocity))
        )
        yield f'<limit lower="{joint.lower!r}" upper="{joint.upper!r}"{effort}{velocity}/>'
    if joint.mimic is not None:
        follows = joint.mimic
        values = f'multiplier="{follows.multiplier!r}" offset="{follows.offset!r}"'
        yield f"<mimic joint={quoteattr(follows.joint)} {values}/>"
    yield "</joint>"
