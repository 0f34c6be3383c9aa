"""Convert foreign links: simple shapes for contact, and meshes for drawing only."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ikservo.apps.importing.mesh_capsules import (
    FittedCapsule,
    MeshFit,
    Triangles,
    extent_m,
    fit_capsules,
    merge_vertices,
    outermost,
    simplify,
)
from ikservo.apps.importing.meshes import mesh_triangles
from ikservo.apps.importing.stl import stl_bytes
from ikservo.errors import FileFormatError
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import rotation_rpy
from ikservo.model.urdf_types import (
    Box,
    Cylinder,
    Mesh,
    Shape,
    Sphere,
    Surface,
    Triple,
    Urdf,
    UrdfLink,
)

_MAX_SIZE_M = 5.0  # a larger mesh is probably in millimetres, and its scale is missing
_ROD_M = 0.015  # radius of the rod that replaces missing shapes of a link
MAX_PICTURE_TRIANGLES = 12_000
"""Largest number of triangles in a mesh for drawing; larger meshes are simplified."""


@dataclass(frozen=True, slots=True)
class ContactFit:
    """The result of fitting capsules to a mesh.

    Attributes:
        link: The link that owns the mesh.
        name: The name of the mesh in the description.
        triangles: The number of its triangles.
        capsules: The number of capsules around it.
        excess_m: The maximum distance from their surface to the mesh.
        allowed_m: The acceptable maximum of ``excess_m``.
    """

    link: str
    name: str
    triangles: int
    capsules: int
    excess_m: float
    allowed_m: float


@dataclass(frozen=True, slots=True)
class MeshStep:
    """The next mesh to fit: its name, the number of finished meshes, and the total."""

    name: str
    done: int
    count: int


@dataclass(slots=True)
class ShapeConversion:
    """The converted shapes of a tree.

    Attributes:
        urdf: The tree with simple shapes; its visual meshes are files of ``pictures``.
        fits: The capsules that were fitted to each mesh.
        pictures: The content of each mesh file, by its name in the arm's folder.
        notes: The parts that were left out, one sentence each.
        corners_m: Outermost points (n, 3) of each link's shapes, in link coordinates.
    """

    urdf: Urdf
    fits: list[ContactFit] = field(default_factory=list[ContactFit])
    pictures: dict[str, bytes] = field(default_factory=dict[str, bytes])
    notes: list[str] = field(default_factory=list[str])
    corners_m: dict[str, Matrix] = field(default_factory=dict[str, Matrix])


def convert_shapes(urdf: Urdf) -> Generator[MeshStep, object, ShapeConversion]:
    """Fit capsules to the meshes of a tree, and convert its visual meshes to files of one format.

    Yields before each mesh. A mesh that cannot be used is left out and noted. If a link has no
    usable collision shape, its visual shapes are used for contact.

    Raises:
        InputError: A reader of meshes is not installed.
    """
    converter = _ShapeConverter(urdf)
    meshes = [
        (link, shape) for link in urdf.links for shape in _meshes(link.collisions or link.visuals)
    ]
    for done, (link, shape) in enumerate(meshes):
        yield MeshStep(_name_of(shape), done, len(meshes))
        converter.fit_next(link.name, link.collisions or link.visuals)
    return converter.convert()


def _meshes(shapes: Sequence[Shape]) -> list[Mesh | Surface]:
    return [shape for shape in shapes if isinstance(shape, Mesh | Surface)]


@dataclass(slots=True)
class _LoadedMesh:
    """A mesh and the results of its conversion, cached because a file is often used repeatedly."""

    triangles: Triangles | None
    fit: MeshFit | None = None  # set if it is the only mesh of its link
    picture: str = ""

    @property
    def size_m(self) -> float:
        """Largest extent of the mesh."""
        return 0.0 if self.triangles is None else extent_m(self.triangles)


class _ShapeConverter:
    def __init__(self, urdf: Urdf) -> None:
        self._urdf, self._result = urdf, ShapeConversion(urdf)
        self._loaded: dict[object, _LoadedMesh] = {}
        self._capsules_m: dict[str, list[FittedCapsule]] = {}
        self._fitted: dict[str, set[int]] = {}

    def convert(self) -> ShapeConversion:
        """Convert each link."""
        links: list[UrdfLink] = []
        for link in self._urdf.links:
            contacts = self._contact_shapes(link.name, link.collisions)
            if not contacts:
                contacts = self._contact_shapes(link.name, link.visuals)
            if not contacts and (link.collisions or link.visuals):
                for joint in self._urdf.joints:
                    end_m = np.array(joint.xyz_m)
                    if joint.parent == link.name and float(np.linalg.norm(end_m)) > 2.0 * _ROD_M:
                        contacts += capsule_shapes(FittedCapsule(np.zeros(3), end_m, _ROD_M))
                instead = (
                    "a rod along it is used instead"
                    if contacts
                    else "its contacts are not detected"
                )
                self._result.notes.append(f"link {link.name} has no usable shape: {instead}.")
            visuals, colours = list[Shape](), list[Triple | None]()
            for i, shape in enumerate(link.visuals):
                drawn = self._picture(link.name, shape)
                if drawn is not None:
                    visuals.append(drawn)
                    colours.append(link.colours[i] if link.colours else None)
            links.append(
                replace(
                    link, collisions=tuple(contacts), visuals=tuple(visuals), colours=tuple(colours)
                )
            )
        self._result.urdf = replace(self._urdf, links=tuple(links))
        return self._result

    def _contact_shapes(self, link: str, shapes: Sequence[Shape]) -> list[Shape]:
        """Return the simple shapes of a link, and capsules around its meshes."""
        simple: list[Shape] = []
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        for shape in shapes:
            match shape:
                case Box():
                    half_m = 0.5 * np.array(shape.size_m)
                case Cylinder():
                    half_m = np.array([shape.radius_m, shape.radius_m, 0.5 * shape.length_m])
                case Sphere():
                    half_m = np.full(3, shape.radius_m)
                case Mesh() | Surface():
                    continue
            simple.append(shape)
            R = rotation_rpy(*shape.rpy_rad)
            self._note_corners(link, np.array(shape.xyz_m) + (signs * half_m) @ R.T)
        while self.fit_next(link, shapes):
            pass
        capsules = self._capsules_m.get(link, ())
        return [*simple, *(each for capsule in capsules for each in capsule_shapes(capsule))]

    def fit_next(self, link: str, shapes: Sequence[Shape]) -> bool:
        """Fit capsules to a link's smallest mesh without capsules; return False if there is none.

        The meshes of a link are fitted together, because a servo and its bracket have no outer
        surface at the place where they touch.
        """
        meshes, fitted = _meshes(shapes), self._fitted.setdefault(link, set())
        waiting = [shape for shape in meshes if id(shape) not in fitted]
        if not waiting:
            return False
        shape = min(waiting, key=lambda each: self._load(link, each).size_m)
        fitted.add(id(shape))
        loaded = self._load(link, shape)
        if loaded.triangles is None:
            return True
        R, origin_m = rotation_rpy(*shape.rpy_rad), np.array(shape.xyz_m)
        capsules = self._capsules_m.setdefault(link, [])
        beside = [(self._in_link(link, other) - origin_m) @ R for other in meshes
                  if other is not shape]  # fmt: skip
        if any(map(len, beside)):
            given = [_moved(each, R.T, -R.T @ origin_m) for each in capsules]
            fit = fit_capsules(loaded.triangles, beside, given)
        else:
            fit = loaded.fit = loaded.fit or fit_capsules(loaded.triangles)
        self._note_corners(link, outermost(loaded.triangles.reshape(-1, 3)) @ R.T + origin_m)
        count = len(loaded.triangles), len(fit.capsules)
        name = _name_of(shape)
        self._result.fits.append(ContactFit(link, name, *count, fit.excess_m, fit.allowed_m))
        capsules += [_moved(each, R, origin_m) for each in fit.capsules]
        return True

    def _in_link(self, link: str, shape: Mesh | Surface) -> Triangles:
        """Return the simplified triangles of a mesh, in link coordinates; none if unusable."""
        loaded = self._load(link, shape)
        if loaded.triangles is None:
            return np.zeros((0, 3, 3))
        merged, _ = simplify(loaded.triangles, loaded.size_m * _BESIDE_FRACTION)
        return merged @ rotation_rpy(*shape.rpy_rad).T + np.array(shape.xyz_m)

    def _note_corners(self, link: str, points_m: Matrix) -> None:
        before = self._result.corners_m.get(link, points_m[:0])
        self._result.corners_m[link] = np.concatenate([before, points_m])

    def _load(self, link: str, shape: Mesh | Surface) -> _LoadedMesh:
        key = (shape.path, shape.scale) if isinstance(shape, Mesh) else id(shape.triangles_m)
        if key not in self._loaded:
            triangles = None
            try:
                triangles = (
                    shape.triangles_m if isinstance(shape, Surface) else mesh_triangles(link, shape)
                )
                size_m = extent_m(triangles)
                if size_m > _MAX_SIZE_M:
                    self._result.notes.append(
                        f"mesh {_name_of(shape)} is left out, because it is {size_m:.0f} m large."
                    )
                    triangles = None
            except FileFormatError as error:
                self._result.notes.append(f"mesh {_name_of(shape)} is left out: {error.found}.")
            self._loaded[key] = _LoadedMesh(triangles)
        return self._loaded[key]

    def _picture(self, link: str, shape: Shape) -> Shape | None:
        """Return the shape to draw; None for a mesh that cannot be used."""
        if not isinstance(shape, Mesh | Surface):
            return shape
        loaded = self._load(link, shape)
        if loaded.triangles is None:
            return None
        if not loaded.picture:
            stem = _UNUSUAL.sub("_", Path(_name_of(shape)).stem) or link
            loaded.picture = f"meshes/{len(self._result.pictures) + 1:02}_{stem[:60]}.stl"
            self._result.pictures[loaded.picture] = stl_bytes(_coarser(loaded.triangles))
        return Mesh(loaded.picture, None, (1.0, 1.0, 1.0), shape.xyz_m, shape.rpy_rad)


_BESIDE_FRACTION = 1 / 100  # detail of the meshes next to the fitted one, as part of their size


def _moved(capsule: FittedCapsule, R: Matrix, origin_m: Vector) -> FittedCapsule:
    start_m, end_m = R @ capsule.start_m + origin_m, R @ capsule.end_m + origin_m
    return FittedCapsule(start_m, end_m, capsule.radius_m)


_UNUSUAL = re.compile(r"[^A-Za-z0-9_-]+")


def _name_of(shape: Mesh | Surface) -> str:
    return shape.filename if isinstance(shape, Mesh) else "of the MJCF"


def capsule_shapes(capsule: FittedCapsule) -> list[Shape]:
    """Return a capsule as the shapes of a URDF: a cylinder between two balls."""
    along = capsule.end_m - capsule.start_m
    length_m = float(np.linalg.norm(along))
    level = (0.0, 0.0, 0.0)
    radius_m = round(capsule.radius_m + 2 * _MIN_LENGTH_M, 6)
    ends = [Sphere(radius_m, _triple(capsule.end_m), level)]
    if length_m < _MIN_LENGTH_M:
        return [*ends]
    ends.append(Sphere(radius_m, _triple(capsule.start_m), level))
    x, y, z = along / length_m
    rpy_rad = (0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x))
    middle = _triple(0.5 * (capsule.start_m + capsule.end_m))
    return [Cylinder(radius_m, round(length_m, 6), middle, rpy_rad), *ends]


_MIN_LENGTH_M = 1e-6


def _triple(values: Vector) -> Triple:
    x, y, z = (round(float(value), 6) for value in values)
    return x, y, z


def _coarser(triangles: Triangles) -> Triangles:
    """Merge vertices until the mesh can be drawn quickly."""
    cell_m = extent_m(triangles) / 400
    while len(triangles) > MAX_PICTURE_TRIANGLES:
        triangles, _ = merge_vertices(triangles, cell_m)
        corners = triangles.transpose(1, 0, 2)
        areas2 = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]), axis=1)
        triangles = triangles[areas2 > 0.0]
        cell_m *= 2.0 if len(triangles) > 4 * MAX_PICTURE_TRIANGLES else 1.3
    return triangles
