"""Geoms of MuJoCo as simple shapes and surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np

from ikservo.kinematics.se3 import Matrix, Vector, pose
from ikservo.model.mjcf.turning import place_of, rpy_of, turned
from ikservo.model.urdf.parts import Box, Cylinder, Shape, Sphere, Surface

__all__ = ["shapes_of"]


def shapes_of(mujoco: Any, model: Any, body: int, shift_m: Vector) -> tuple[list[Shape], ...]:  # noqa: ANN401  # no types
    """Return the shapes of a body that collide, and those that are only drawn.

    Planes and height fields stand for the surroundings and are left out.

    Args:
        mujoco: The module.
        model: A compiled model.
        body: Its number.
        shift_m: Origin of the link's frame in the body's (3,).
    """
    collide, drawn = list[Shape](), list[Shape]()
    first = int(model.body_geomadr[body])
    for geom in range(first, first + int(model.body_geomnum[body])):
        T = pose(model.geom_pos[geom] - shift_m, turned(model.geom_quat[geom]))
        collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        (collide if collides else drawn).extend(_shapes(mujoco, model, geom, T))
    return collide, drawn


def _shapes(mujoco: Any, model: Any, geom: int, T: Matrix) -> list[Shape]:  # noqa: ANN401
    kinds, size = mujoco.mjtGeom, [float(x) for x in model.geom_size[geom]]
    at, rpy = place_of(T), rpy_of(T)
    match kinds(int(model.geom_type[geom])):
        case kinds.mjGEOM_SPHERE:
            return [Sphere(size[0], at, rpy)]
        case kinds.mjGEOM_CAPSULE:
            ends = (T @ pose((0.0, 0.0, side * size[1])) for side in (-1, 1))
            caps = [Sphere(size[0], place_of(end), rpy) for end in ends]
            return [Cylinder(size[0], 2 * size[1], at, rpy), *caps]
        case kinds.mjGEOM_CYLINDER:
            return [Cylinder(size[0], 2 * size[1], at, rpy)]
        case kinds.mjGEOM_BOX | kinds.mjGEOM_ELLIPSOID:
            return [Box((2 * size[0], 2 * size[1], 2 * size[2]), at, rpy)]
        case kinds.mjGEOM_MESH:
            return [Surface(_triangles(model, int(model.geom_dataid[geom])), at, rpy)]
        case _:
            return []


def _triangles(model: Any, mesh: int) -> Matrix:  # noqa: ANN401
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    corners = np.array(model.mesh_vert[first : first + count], dtype=np.float64)
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return corners[np.array(model.mesh_face[first : first + count])]
