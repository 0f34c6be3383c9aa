"""The shapes of an arm's links as the page draws them in 3D.

Lengths are metres, poses T_link_shape (4, 4) row by row. Meshes travel as the corners of their
triangles, little-endian float32 in base64; a mesh that is missing or very fine is drawn as the
capsules around it.
"""

from __future__ import annotations

import base64
import contextlib
from collections.abc import Iterator

import numpy as np

from ikservo.errors import FileFormatError, InputError
from ikservo.kinematics.arrays import Matrix
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.se3 import make_pose, rotation_rpy
from ikservo.model import Model
from ikservo.model.collision_model import bounding_capsules
from ikservo.model.meshes import mesh_triangles
from ikservo.model.urdf_types import Box, Cylinder, Mesh, Shape, Sphere, Surface, Triple, UrdfLink

__all__ = ["Fields", "link_shapes", "row_major"]

Fields = dict[str, object]

_MAX_TRIANGLES = 15_000  # of one mesh: 0.7 MB in base64
_UNUSABLE = (FileFormatError, InputError)


def row_major(T: Matrix) -> list[float]:
    """Return a pose (4, 4) row by row (16,)."""
    return T.ravel().tolist()


def link_shapes(model: Model, name: str) -> list[Fields]:
    """Return the visual shapes of a link, or else its collision shapes, as far as usable."""
    link = next((each for each in model.urdf.links if each.name == name), None)
    if link is None:  # the tip of a tool
        return []
    with contextlib.suppress(*_UNUSABLE):
        return list(_visual_fields(link)) or _collision_fields(link)
    with contextlib.suppress(*_UNUSABLE):
        return _collision_fields(link)
    return []


def _visual_fields(link: UrdfLink) -> Iterator[Fields]:
    colours = link.colours or (None,) * len(link.visuals)
    for shape, colour in zip(link.visuals, colours, strict=True):
        yield from _shape_fields(link.name, shape, colour)


def _collision_fields(link: UrdfLink) -> list[Fields]:
    return [each for shape in link.collisions for each in _shape_fields(link.name, shape, None)]


def _shape_fields(link: str, shape: Shape, colour: Triple | None) -> list[Fields]:
    """Return a shape as one or more primitives of the page.

    Raises:
        FileFormatError: A mesh cannot be used.
        InputError: A mesh needs the extra ``mesh``, which is not installed.
    """
    T = make_pose(shape.xyz_m, rotation_rpy(*shape.rpy_rad))
    shared: Fields = {"pose": row_major(T), "colour": colour}
    match shape:
        case Box():
            return [{"shape": "box", "size": shape.size_m, **shared}]
        case Cylinder():
            return [{"shape": "cylinder", "size": [shape.radius_m, shape.length_m], **shared}]
        case Sphere():
            return [{"shape": "sphere", "size": [shape.radius_m], **shared}]
        case Mesh() | Surface():
            return _mesh_fields(link, shape, shared)


def _mesh_fields(link: str, mesh: Mesh | Surface, shared: Fields) -> list[Fields]:
    triangles = mesh.triangles_m if isinstance(mesh, Surface) else mesh_triangles(link, mesh)
    if len(triangles) > _MAX_TRIANGLES:
        return [_capsule_fields(each, shared) for each in bounding_capsules(link, mesh)]
    corners = base64.b64encode(np.ascontiguousarray(triangles, dtype="<f4").tobytes())
    return [{"shape": "mesh", "corners": corners.decode(), **shared}]


def _capsule_fields(capsule: Capsule, shared: Fields) -> Fields:
    """Return a capsule in link coordinates, along the y axis of its own frame."""
    along = capsule.end_m - capsule.start_m
    length_m = float(np.linalg.norm(along))
    y = along / length_m if length_m else np.array([0.0, 1.0, 0.0])
    x = np.cross(y, np.eye(3)[int(np.argmin(np.abs(y)))])
    x = x / np.linalg.norm(x)
    T = make_pose(0.5 * (capsule.start_m + capsule.end_m), np.column_stack([x, y, np.cross(x, y)]))
    size = [capsule.radius_m, length_m]
    return {**shared, "shape": "capsule", "size": size, "pose": row_major(T)}
