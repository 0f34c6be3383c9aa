"""URDF in, frozen dataclasses out: the subset an arm needs, with every trap named by its line."""

from __future__ import annotations

from ikservo.model.urdf.parts import (
    Box,
    Cylinder,
    JointKind,
    Mesh,
    Mimic,
    Shape,
    Sphere,
    Surface,
    Urdf,
    UrdfJoint,
    UrdfLink,
)
from ikservo.model.urdf.reader import read_urdf

__all__ = [
    "Box",
    "Cylinder",
    "JointKind",
    "Mesh",
    "Mimic",
    "Shape",
    "Sphere",
    "Surface",
    "Urdf",
    "UrdfJoint",
    "UrdfLink",
    "read_urdf",
]
