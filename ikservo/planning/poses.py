"""Taught poses, a small file for each arm and adapter, and poses clamped to the limits.

``poses/so101-58FA083.toml`` in the user's configuration folder has the form of an arm file's poses,
degrees for revolute joints and metres for prismatic joints, and may be edited by hand::

    format = 1
    arm = "so101"

    [poses.cup]
    deg = { shoulder_pan = 12.3, … }
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, cast

import tomli_w
from pydantic import Field

from ikservo.arguments import check_callable
from ikservo.calibration.paths import calibration_path
from ikservo.errors import BadValueError, FileFormatError, UnknownNameError, shown
from ikservo.files.reading import config_dir, read_toml
from ikservo.files.validation import StrictModel
from ikservo.files.writing import exclusive_access, write_atomic
from ikservo.guard import DrivenJoint
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model
from ikservo.model.arm_schema import ArmPose
from ikservo.planning.context import ArmContext

_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")
_EXPECTED_NAME = "1 to 64 of the characters A-Z a-z 0-9 _ -"
_PLACES = 4  # decimal places of degrees; metres get more

Positions = Mapping[str, float]


class _PoseFile(StrictModel):
    format: Literal[1] = Field(description="1")
    arm: str = Field(description="the arm's name")
    poses: Mapping[Annotated[str, Field(pattern=rf"^{_NAME.pattern}$")], ArmPose] = Field(
        default={}, description=_EXPECTED_NAME
    )


class PoseLibrary:
    """The poses of one arm: those in its arm file, and taught poses."""

    def __init__(self, model: Model, usb_serial_number: str) -> None:
        self._model, self.path = model, pose_path(model.name, usb_serial_number)

    def __repr__(self) -> str:
        """Show the names of the poses in the arm file."""
        return f"Poses({', '.join(self._model.poses)}; taught ones: taught())"

    def get_pose(self, name: str) -> Positions:
        """Look up the joint positions of a pose, rad or m by joint.

        Raises:
            UnknownNameError: There is no such pose; the closest name is suggested.
            FileFormatError: The file of the taught poses is malformed.
        """
        if not isinstance(cast("object", name), str):
            raise UnknownNameError("pose", name, self._model.poses)
        if name in self._model.poses:
            return self._model.poses[name]
        known = self.all_poses()
        if name not in known:
            raise UnknownNameError("pose", name, known)
        return known[name]

    def all_poses(self) -> dict[str, Positions]:
        """Return all poses by name, those of the arm file first.

        Raises:
            FileFormatError: The file of the taught poses is malformed.
        """
        return {**self._model.poses, **self.user_poses()}

    def user_poses(self) -> dict[str, Positions]:
        """Return the taught poses by name.

        Raises:
            FileFormatError: The file is malformed, belongs to another arm, or does not fit the
                joints.
        """
        if not self.path.exists():
            return {}
        read = _PoseFile.from_tables(read_toml(self.path), self.path)
        if read.arm != self._model.name:
            raise FileFormatError(self.path, "arm", f'is "{read.arm}"', f'"{self._model.name}"')
        return {name: self._positions_of(name, pose) for name, pose in read.poses.items()}

    def check_name(self, name: str) -> str:
        """Check that a pose can be taught under a name; return the name.

        Raises:
            BadValueError: The name is malformed, or belongs to a pose in the arm file.
        """
        if not isinstance(cast("object", name), str) or not _NAME.fullmatch(name):
            raise BadValueError("The name of the pose", shown(name), _EXPECTED_NAME)
        if name in self._model.poses:
            raise BadValueError(
                "The name of the pose", f"{name}, a pose of the arm file", "another name"
            )
        return name

    def save(self, name: str, positions: Positions) -> Path:
        """Save all joints, rad or m, as a pose, replacing any pose with that name; return the file.

        Raises:
            BadValueError: The name cannot be used.
            FileFormatError: The file is malformed, and stays unchanged.
            FileWriteError: The disk is full or not writable; the file stays unchanged.
        """
        with exclusive_access(self.path):
            poses = {**self.user_poses(), self.check_name(name): positions}
            tables = {name: self._pose_tables(pose) for name, pose in sorted(poses.items())}
            text = tomli_w.dumps({"format": 1, "arm": self._model.name, "poses": tables})
            write_atomic(self.path, text, keep_old=True)
        return self.path

    def _pose_tables(self, positions: Positions) -> dict[str, dict[str, float]]:
        tables: dict[str, dict[str, float]] = {}
        for joint in self._model.joints:
            value = positions[joint.name]
            if joint.joint_map.unit == "m":
                tables.setdefault("m", {})[joint.name] = round(value, _PLACES + 3)
            else:
                tables.setdefault("deg", {})[joint.name] = round(math.degrees(value), _PLACES)
        return tables

    def _positions_of(self, name: str, pose: ArmPose) -> dict[str, float]:
        units = {joint.name: joint.joint_map.unit for joint in self._model.joints}
        wanted = {key: {j for j, unit in units.items() if (unit == "m") == (key == "m")}
                  for key in ("deg", "m")}  # fmt: skip
        for key, found in (("deg", set(pose.deg)), ("m", set(pose.m))):
            for joint in [*sorted(found - wanted[key]), *sorted(wanted[key] - found)]:
                what = "is not allowed here" if joint in found else "is missing"
                raise FileFormatError(self.path, f"poses.{name}.{key}.{joint}", what)
        return {j: math.radians(value) for j, value in pose.deg.items()} | dict(pose.m)


def teach(
    context: ArmContext,
    poses: PoseLibrary,
    name: str,
    until: Callable[[], object] | None,
    relax: Callable[[], object],
) -> dict[str, float]:
    """Save the measured joint positions as a pose; see ``Arm.teach``."""
    check_callable("until", until)
    poses.check_name(name)
    poses.user_poses()  # this finds a malformed file before the arm is moved by hand
    if until is not None:
        if any(state.torque for state in context.servos.read_states()):
            relax()
        until()
    positions = context.index.by_name(context.servos.measure_positions())
    poses.save(name, positions)
    return positions


def pose_path(arm: str, usb_serial_number: str) -> Path:
    """Return the path of an arm's taught poses, such as ``poses/so101-58FA083.toml``."""
    return config_dir() / "poses" / calibration_path(arm, usb_serial_number).name


def known_pose_names(model: Model) -> list[str]:
    """Return the names of an arm's poses on all adapters, for completion."""
    stems = [path.stem for path in pose_path(model.name, "").parent.glob("*.toml")]
    own = [stem for stem in stems if stem == model.name or stem.startswith(f"{model.name}-")]
    taught = [
        PoseLibrary(model, stem.removeprefix(model.name).removeprefix("-")).user_poses()
        for stem in own
    ]
    return sorted({*model.poses, *(name for poses in taught for name in poses)})


# A joint that was on its end stop when a pose was taught is at most this far beyond its limit.
_END_STOP_RAD = math.radians(6.0)


@dataclass(frozen=True, slots=True)
class PoseWithinLimits:
    """A pose clamped to the limits of an arm.

    Attributes:
        positions: The positions by joint, rad or m.
        changed: Descriptions of joints that stop at a limit short of the pose.
    """

    positions: dict[str, float]
    changed: tuple[str, ...]


def clamp_positions(
    positions: Mapping[str, float],
    driven_joints: Sequence[DrivenJoint],
    start: Vector,
    max_rad: float = _END_STOP_RAD,
) -> PoseWithinLimits:
    """Clamp joint positions that are slightly beyond the limits.

    A clamped joint stays inside its limit by the distance at which friction may stop it. Other
    joints keep their positions (rad or m), and a joint that is beyond its limit at ``start`` (n,)
    need not move inside. Joints that are further beyond a limit than ``max_rad``, as an angle of
    the horn, are not clamped; the guard refuses them.
    """
    clamped, changed = dict(positions), list[str]()
    for driven, at in zip(driven_joints, start.tolist(), strict=True):
        if driven.joint not in positions or driven.limits.contains(positions[driven.joint]):
            continue
        requested, (low, high) = positions[driven.joint], driven.position_range
        joint_map = driven.joint_map
        beyond = max(low - requested, requested - high)
        if beyond > joint_map.unit_per_tick:  # less is rounding
            low, high = driven.settled_range
        inside = min(max(requested, min(low, at)), max(high, at))
        beyond_rad = beyond / joint_map.unit_per_horn_rad
        if inside != requested and beyond_rad <= max_rad:
            clamped[driven.joint] = inside
            goes_to, asked = joint_map.format(inside), joint_map.format(requested)
            if goes_to != asked:  # a smaller change is rounding
                limit = driven.limits.upper if requested > inside else driven.limits.lower
                why = f"its limit is {joint_map.format(limit.value)} ({limit.source})"
                changed.append(f"{driven.joint} goes to {goes_to}, not to {asked}, because {why}")
    return PoseWithinLimits(clamped, tuple(changed))


def clamp_pose(
    name: str, pose: Mapping[str, float], driven_joints: Sequence[DrivenJoint], start: Vector
) -> PoseWithinLimits:
    """Clamp a named pose to the limits; see ``clamp_positions``.

    The rest pose is clamped however far outside the limits it is, because it must always be
    possible to lower an arm. Other poses may have joints on their end stops, just beyond a limit.
    """
    max_rad = math.inf if name == "rest" else _END_STOP_RAD
    return clamp_positions(pose, driven_joints, start, max_rad)
