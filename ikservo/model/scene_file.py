"""Read and write scene files: things around an arm, and other arms, in the arm's base frame."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from ikservo.arguments import check_choice
from ikservo.errors import BadValueError, FileFormatError, RefusedError
from ikservo.files.reading import parse_path, read_toml
from ikservo.files.validation import StrictModel
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.packed import IS_CYLINDER, ROUNDING, rotation_z_to
from ikservo.kinematics.se3 import rotation_rpy
from ikservo.model.arm_model import Model, Obstacle
from ikservo.model.arm_schema import Text
from ikservo.model.collision_capsules import bounding_capsules
from ikservo.model.urdf_types import Box

_Z = np.array([0.0, 0.0, 1.0])
_FAR_M = 10.0  # half the edge of the box that represents a half-space

# Astronomically large numbers would make distances infinite.
_MOST = 1000.0
Number = Annotated[float, Field(ge=-_MOST, le=_MOST)]
Length = Annotated[float, Field(gt=0, le=_MOST)]
Triple = Annotated[tuple[Number, Number, Number], Field(strict=False)]
Sides = Annotated[tuple[Length, Length, Length], Field(strict=False)]


@dataclass(frozen=True, slots=True, eq=False)
class KeepOutShape:
    """A thing that the arm must not touch: a rotated box, a cylinder or a sphere.

    Attributes:
        name: Name for messages, such as ``the cup``.
        row: The thing (17,), metres, base frame; see ``kinematics.packed``.
    """

    name: str
    row: Vector

    def moved(self, T: Matrix) -> KeepOutShape:
        """Return the thing moved by a pose (4, 4)."""
        row = self.row.copy()
        row[:9] = (T[:3, :3] @ row[:9].reshape(3, 3)).ravel()
        row[9:12] = T[:3, :3] @ row[9:12] + T[:3, 3]
        return replace(self, row=row)

    def capsules(self, link: str) -> list[Capsule]:
        """Return capsules that cover the thing, whose row is in the coordinates of the link."""
        R, centre, half = self.row[:9].reshape(3, 3), self.row[9:12], self.row[12:15]
        if self.row[IS_CYLINDER]:
            covering = [Capsule(link, -half * _Z, half * _Z, float(half[0]))]
        else:
            box = Box(tuple((2.0 * half).tolist()), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
            covering = bounding_capsules(link, box)
        return [
            Capsule(
                link,
                R @ each.start_m + centre,
                R @ each.end_m + centre,
                each.radius_m + float(self.row[ROUNDING]),
            )
            for each in covering
        ]

    @property
    def half_size_m(self) -> Vector:
        """Half of its length, width and height (3,) [m], including the radius of its edges."""
        return self.row[12:15] + self.row[ROUNDING]

    @property
    def low_m(self) -> tuple[float, float, float]:
        """Lowest corner (3,) of the axis-aligned bounding box."""
        return self._corner(-1.0)

    @property
    def high_m(self) -> tuple[float, float, float]:
        """Highest corner (3,) of the axis-aligned bounding box."""
        return self._corner(1.0)

    def _corner(self, side: float) -> tuple[float, float, float]:
        R, centre, half = self.row[:9].reshape(3, 3), self.row[9:12], self.row[12:15]
        x, y, z = (centre + side * (np.abs(R) @ half + self.row[15])).tolist()
        return x, y, z


NEAREST_BASE_M, FURTHEST_BASE_M = 0.03, 10.0
"""Smallest and largest distance of the base of another arm on the same table [m]."""


@dataclass(frozen=True, slots=True)
class PlacedArm:
    """The place of another arm on the same table.

    Attributes:
        name: Name for messages; on the page, the name of the open arm.
        at_m: Origin (3,) of this arm's base frame in the base frame of the scene's arm, metres.
        rpy_deg: Roll, pitch and yaw (3,) of that base frame relative to the scene's arm, degrees.
        arm: The arm's name in the catalogue, or its file; if empty, ``name`` is used.
        port: The port of the arm; empty if it is not given.
    """

    name: str
    at_m: tuple[float, float, float]
    rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    arm: str = ""
    port: str = ""


def capsule_shape(name: str, capsule: Capsule, margin_m: float) -> KeepOutShape:
    """Convert a capsule, enlarged by a margin, to a thing."""
    along = capsule.end_m - capsule.start_m
    length_m = float(np.linalg.norm(along))
    R = rotation_z_to(along / length_m) if length_m > 0.0 else np.eye(3)
    middle_m, half_m = 0.5 * (capsule.start_m + capsule.end_m), (0.0, 0.0, 0.5 * length_m)
    row = [*R.ravel(), *middle_m, *half_m, capsule.radius_m + margin_m, 0.0]
    return KeepOutShape(name, np.array(row))


class _Thing(StrictModel):
    name: Text = Field(description="one line of text")


class _CenteredThing(_Thing):
    @model_validator(mode="before")
    @classmethod
    def _in_american(cls, given: dict[str, Any]) -> dict[str, Any]:
        """Also accept ``centre_m``, the British spelling."""
        if "centre_m" in given and "center_m" not in given:
            return {"center_m" if key == "centre_m" else key: given[key] for key in given}
        return given


class _SceneBox(_CenteredThing):
    center_m: Triple = Field(description="[x, y, z] in metres, at most ±1000")
    size_m: Sides = Field(description="[x, y, z] in metres, above 0, at most 1000")
    rpy_deg: Triple = Field(default=(0.0, 0.0, 0.0), description="[roll, pitch, yaw] in degrees")


class _SceneCylinder(_CenteredThing):
    center_m: Triple = Field(description="[x, y, z] in metres, at most ±1000")
    radius_m: Length = Field(description="metres above 0, at most 1000")
    height_m: Length = Field(description="metres above 0, at most 1000")
    axis: Triple = Field(
        default=(0.0, 0.0, 1.0), description="a direction [x, y, z], at most ±1000"
    )


class _SceneSphere(_CenteredThing):
    center_m: Triple = Field(description="[x, y, z] in metres, at most ±1000")
    radius_m: Length = Field(description="metres above 0, at most 1000")


class _SceneHalfSpace(_Thing):
    point_m: Triple = Field(
        description="a point [x, y, z] on its surface, in metres, at most ±1000"
    )
    normal: Triple = Field(description="the direction [x, y, z] of its free side, at most ±1000")


class _SceneArm(_Thing):
    at_m: Triple = Field(description="where its base is: [x, y, z] in metres, at most ±10")
    rpy_deg: Triple = Field(default=(0.0, 0.0, 0.0), description="[roll, pitch, yaw] in degrees")
    arm: Text | None = Field(
        default=None, description="the arm's model, if it differs from the name"
    )
    port: Text | None = Field(default=None, description="the port of the arm")


class _SceneFile(StrictModel):
    margin_m: Annotated[float, Field(ge=0, le=1)] = Field(default=0.0, description="0 to 1 metres")
    box: tuple[_SceneBox, ...] = Field(default=(), strict=False, description="tables [[box]]")
    cylinder: tuple[_SceneCylinder, ...] = Field(
        default=(), strict=False, description="tables [[cylinder]]"
    )
    sphere: tuple[_SceneSphere, ...] = Field(
        default=(), strict=False, description="tables [[sphere]]"
    )
    half_space: tuple[_SceneHalfSpace, ...] = Field(
        default=(), strict=False, description="tables [[half_space]]"
    )
    arm: tuple[_SceneArm, ...] = Field(default=(), strict=False, description="tables [[arm]]")


def read_scene(path: Path | str) -> tuple[KeepOutShape, ...]:
    """Read the things of a scene file that has no other arms.

    Raises:
        FileFormatError: The file cannot be read or is malformed; the key is named.
        BadValueError: A direction has no length.
        RefusedError: The file has another arm.
    """
    things, arms = read_scene_with_arms(path)
    _refuse_arms(path, arms)
    return things


def read_scene_with_arms(
    path: Path | str,
) -> tuple[tuple[KeepOutShape, ...], tuple[PlacedArm, ...]]:
    """Read the things of a scene file, and the places of other arms.

    Raises:
        FileFormatError: The file cannot be read or is malformed; the key is named.
        BadValueError: A direction has no length.
    """
    path = parse_path(path)
    scene = _SceneFile.from_tables(read_toml(path), path)
    things = tuple(_things(scene))
    arms = tuple(
        PlacedArm(each.name, each.at_m, each.rpy_deg, each.arm or "", each.port or "")
        for each in scene.arm
    )
    _check_names(path, (*things, *arms), ())
    for each in arms:
        if math.hypot(*each.at_m) < NEAREST_BASE_M or max(map(abs, each.at_m)) > FURTHEST_BASE_M:
            expected = f"{NEAREST_BASE_M} to {FURTHEST_BASE_M:.0f} m from the base of this arm"
            raise FileFormatError(path, f"at_m of {each.name}", f"is {list(each.at_m)}", expected)
    return things, arms


def _refuse_arms(path: Path | str, arms: Sequence[PlacedArm]) -> None:
    if arms:
        raise RefusedError(
            f"{path} has another arm, {arms[0].name}, which is not open in this program.",
            "Open both arms: on one page with ikservo view, or in a program with "
            "arm.scene.add_arm.",
        )


def make_shape(kind: str, name: str, sizes: dict[str, Any]) -> KeepOutShape:
    """Make a box, cylinder, sphere or half_space from the values that it has in a scene file.

    Raises:
        UnknownNameError: There is no such kind.
        FileFormatError: A value is missing, unknown or of the wrong type; the key is named.
        BadValueError: A direction has no length.
    """
    check_choice("kind of thing", kind, KINDS)
    values = {
        key: getattr(value, "tolist", lambda value=value: value)() for key, value in sizes.items()
    }
    tables = {kind: [{"name": name, **values}]}
    return next(_things(_SceneFile.from_tables(tables, Path(f"<{name}>"))))


def describe_thing(thing: Obstacle) -> tuple[str, dict[str, Any]]:
    """Return the kind of a thing, and the values that it has in a scene file, margins included.

    This is the inverse of ``make_shape``. A shape with round edges is described by a box around it.
    """
    R, centre, half = thing.row[:9].reshape(3, 3), thing.row[9:12], thing.row[12:15]
    grown = half + thing.row[ROUNDING]
    at = {"center_m": centre.tolist()}
    if thing.row[IS_CYLINDER]:
        sizes = {"radius_m": float(grown[0]), "height_m": float(2.0 * grown[2])}
        return "cylinder", {**at, **sizes, "axis": R[:, 2].tolist()}
    if not half.any():
        return "sphere", {**at, "radius_m": float(grown[0])}
    if half.min() >= _FAR_M:
        return "half_space", {
            "point_m": (centre + grown[2] * R[:, 2]).tolist(),
            "normal": R[:, 2].tolist(),
        }
    return "box", {**at, "size_m": (2.0 * grown).tolist(), "rpy_deg": list(turned_deg(R))}


def turned_deg(R: Matrix) -> tuple[float, float, float]:
    """Return roll, pitch and yaw (3,) of a rotation (3, 3), degrees."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415  # slow to import

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # at a pitch of 90°, roll and yaw are not unique
        roll, pitch, yaw = Rotation.from_matrix(R).as_euler("xyz", degrees=True).tolist()
    return roll, pitch, yaw


def scene_text(things: Sequence[Obstacle], arms: Sequence[PlacedArm] = ()) -> str:
    """Return the text of a scene file with the given things and other arms."""
    lines = list[str]()
    tables = [(thing.name, *describe_thing(thing)) for thing in things]
    for each in arms:
        given = {key: value for key, value in asdict(each).items() if value and key != "name"}
        tables.append((each.name, "arm", given))
    for name, kind, sizes in tables:
        lines += [f"[[{kind}]]", f"name = {json.dumps(name, ensure_ascii=False)}"]
        for key, value in sizes.items():
            # Metres, degrees and directions are rounded to six decimals.
            rounded = value if isinstance(value, str) else np.round(np.array(value), 6).tolist()
            lines.append(f"{key} = {json.dumps(rounded, ensure_ascii=False)}")
        lines.append("")
    return "\n".join(lines)


def with_scene(model: Model, path: Path | str) -> Model:
    """Return a model with the things of a scene file in addition to those of its arm file.

    Raises:
        FileFormatError: The file cannot be read or is malformed.
        BadValueError: A direction in it has no length.
        RefusedError: The file has another arm.
    """
    among, arms = with_scene_and_arms(model, path)
    _refuse_arms(path, arms)
    return among


def with_scene_and_arms(model: Model, path: Path | str) -> tuple[Model, tuple[PlacedArm, ...]]:
    """Return a model with the things of a scene file, and the places of the file's other arms.

    Raises:
        FileFormatError: The file cannot be read or is malformed.
        BadValueError: A direction in it has no length.
    """
    things, arms = read_scene_with_arms(path)
    taken = ("the table", *(each.name for each in model.keep_out), *model.chain.frames)
    _check_names(Path(path), (*things, *arms), taken)
    return replace(model, keep_out=(*model.keep_out, *things)), arms


def _check_names(
    path: Path, things: Sequence[KeepOutShape | PlacedArm], taken: Sequence[str]
) -> None:
    """Check that no two things or arms have the same name."""
    known = set(taken)
    for each in things:
        if each.name in known:
            raise FileFormatError(path, "name", f"repeats {each.name!r}", "a unique name")
        known.add(each.name)


KINDS = tuple(name for name in _SceneFile.model_fields if name not in ("margin_m", "arm"))
"""The kinds of things in a scene file."""


def _things(scene: _SceneFile) -> Iterator[KeepOutShape]:
    def shape(
        name: str, R: Matrix, centre: Vector, half: Vector, rounding: float = 0.0, kind: float = 0.0
    ) -> KeepOutShape:
        row = [*R.ravel(), *centre, *half, rounding + scene.margin_m, kind]
        return KeepOutShape(name, np.array(row, dtype=np.float64))

    for each in scene.box:
        R = rotation_rpy(*(math.radians(angle) for angle in each.rpy_deg))
        yield shape(each.name, R, np.array(each.center_m), 0.5 * np.array(each.size_m))
    for each in scene.cylinder:
        half = np.array([each.radius_m, each.radius_m, 0.5 * each.height_m])
        yield shape(
            each.name, _turned_to(each.name, each.axis), np.array(each.center_m), half, 0.0, 1.0
        )
    for each in scene.sphere:
        yield shape(each.name, np.eye(3), np.array(each.center_m), np.zeros(3), each.radius_m)
    for each in scene.half_space:
        R = _turned_to(each.name, each.normal)
        normal = R[:, 2]
        # The box covers the whole surface around the arm, wherever the given point is on it.
        centre = (np.array(each.point_m) @ normal - _FAR_M) * normal
        yield shape(each.name, R, centre, np.full(3, _FAR_M))


def _turned_to(name: str, axis: tuple[float, float, float]) -> Matrix:
    length = math.hypot(*axis)
    if not 0.0 < length < math.inf:
        raise BadValueError(f"The direction of {name}", list(axis), "finite numbers, not all zero")
    return rotation_z_to(np.array(axis) / length)
