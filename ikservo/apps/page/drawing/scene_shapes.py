"""Shapes of an arm's links, as the page draws them in 3D.

Lengths are metres, poses T_link_shape (4, 4) row by row. Meshes are sent as the corners of their
triangles, little-endian float32 in base64; if a mesh is missing, the shapes for contact are drawn.
"""

from __future__ import annotations

import base64
import contextlib

import numpy as np

from ikservo.apps.importing.stl import read_stl
from ikservo.errors import FileFormatError
from ikservo.kinematics.arrays import Matrix
from ikservo.kinematics.se3 import make_pose, rotation_rpy
from ikservo.model import Model
from ikservo.model.urdf_types import Box, Cylinder, Mesh, Shape, Sphere, Surface, Triple, UrdfLink

Fields = dict[str, object]


def row_major(T: Matrix) -> list[float]:
    """Return a pose (4, 4) row by row (16,)."""
    return T.ravel().tolist()


def link_shapes(model: Model, name: str) -> list[Fields]:
    """Return the usable visual shapes of a link, or else its collision shapes."""
    link = next((each for each in model.urdf.links if each.name == name), None)
    if link is None:  # the tip of a tool is not a link
        return []
    with contextlib.suppress(FileFormatError):
        pairs = zip(link.visuals, link.colours or (None,) * len(link.visuals), strict=True)
        shown = [each for pair in pairs for each in _shape_fields(link.name, *pair)]
        return shown or _collision_fields(link)
    with contextlib.suppress(FileFormatError):
        return _collision_fields(link)
    return []


def _collision_fields(link: UrdfLink) -> list[Fields]:
    return [each for shape in link.collisions for each in _shape_fields(link.name, shape, None)]


def _shape_fields(link: str, shape: Shape, colour: Triple | None) -> list[Fields]:
    """Return a shape as one or more primitives of the page."""
    T = make_pose(shape.xyz_m, rotation_rpy(*shape.rpy_rad))
    shared: Fields = {"pose": row_major(T), "colour": colour}
    match shape:
        case Box():
            return [{"shape": "box", "size": shape.size_m, **shared}]
        case Cylinder():
            return [{"shape": "cylinder", "size": [shape.radius_m, shape.length_m], **shared}]
        case Sphere():
            return [{"shape": "sphere", "size": [shape.radius_m], **shared}]
        case Mesh(filename=filename, path=path, scale=scale):
            if path is None:
                raise FileFormatError(filename, "", "is outside the arm's folder")
            corners = (read_stl(path) * np.array(scale)).astype("<f4")
            return [
                {"shape": "mesh", "corners": base64.b64encode(corners.tobytes()).decode(), **shared}
            ]
        case Surface():  # exists only while a description is converted
            return []
