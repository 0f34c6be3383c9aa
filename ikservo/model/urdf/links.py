"""``<link>`` elements become links with their mass and simple shapes."""

from __future__ import annotations

from pathlib import Path

from ikservo.files.quoting import quoted
from ikservo.model.urdf.elements import Element
from ikservo.model.urdf.mesh_paths import mesh_path
from ikservo.model.urdf.origins import read_origin
from ikservo.model.urdf.parts import Box, Cylinder, Mesh, Shape, Sphere, UrdfLink, Vector

__all__ = ["read_link"]

_SHAPES = ("box", "cylinder", "sphere", "mesh")
_NO_INERTIA = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def read_link(element: Element, folder: Path) -> UrdfLink:
    """Return one link; its meshes are files under a folder."""
    name = element.name()
    collisions = tuple(_read_shape(each, folder) for each in element.each("collision"))
    visuals = tuple(_read_shape(each, folder) for each in element.each("visual"))
    inertial = element.optional("inertial")
    if inertial is None:
        zero = (0.0, 0.0, 0.0)
        return UrdfLink(name, 0.0, zero, zero, _NO_INERTIA, collisions, visuals, element.line)
    com_m, rpy_rad = read_origin(inertial)
    mass_kg, inertia = _read_mass(inertial), _read_inertia(inertial)
    return UrdfLink(name, mass_kg, com_m, rpy_rad, inertia, collisions, visuals, element.line)


def _read_mass(inertial: Element) -> float:
    mass = inertial.required("mass")
    mass_kg = mass.number("value")
    if mass_kg < 0:
        raise mass.error(f"a mass of {mass_kg:g} kg", "zero or more")
    return mass_kg


def _read_inertia(inertial: Element) -> tuple[float, float, float, float, float, float]:
    inertia = inertial.optional("inertia")
    if inertia is None:
        return _NO_INERTIA
    ixx, ixy, ixz = (inertia.number(key, 0.0) for key in ("ixx", "ixy", "ixz"))
    iyy, iyz, izz = (inertia.number(key, 0.0) for key in ("iyy", "iyz", "izz"))
    return ixx, ixy, ixz, iyy, iyz, izz


def _read_shape(element: Element, folder: Path) -> Shape:
    xyz_m, rpy_rad = read_origin(element)
    geometry = element.required("geometry")
    shape = _only_shape(geometry)
    match shape.tag:
        case "box":
            size_m = _positive(shape, "size", shape.vector("size"))
            return Box(size_m, xyz_m, rpy_rad)
        case "cylinder":
            return Cylinder(_length(shape, "radius"), _length(shape, "length"), xyz_m, rpy_rad)
        case "sphere":
            return Sphere(_length(shape, "radius"), xyz_m, rpy_rad)
        case _:
            return _read_mesh(shape, folder, xyz_m, rpy_rad)


def _only_shape(geometry: Element) -> Element:
    if len(geometry.children) != 1 or geometry.children[0].tag not in _SHAPES:
        tags = ", ".join(f"<{child.tag}>" for child in geometry.children[:3]) or "nothing"
        raise geometry.error(f"<geometry> holds {tags}", f"one of {', '.join(_SHAPES)}")
    return geometry.children[0]


def _read_mesh(mesh: Element, folder: Path, xyz_m: Vector, rpy_rad: Vector) -> Mesh:
    filename = mesh.text("filename")
    path = mesh_path(filename, mesh.path, folder)
    return Mesh(filename, path, mesh.vector("scale", default=1.0), xyz_m, rpy_rad)


def _length(shape: Element, attribute: str) -> float:
    length_m = shape.number(attribute)
    _positive(shape, attribute, (length_m, 1.0, 1.0))
    return length_m


def _positive(shape: Element, attribute: str, size_m: Vector) -> Vector:
    if min(size_m) <= 0:
        found = f"<{shape.tag}> has {attribute}={quoted(shape.text(attribute))}"
        raise shape.error(found, "more than zero metres")
    return size_m
