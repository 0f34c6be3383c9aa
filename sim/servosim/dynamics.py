"""The body that the servos move: free joints, or an arm under gravity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from servosim.contact import Contacts
from servosim.errors import ArmFileError
from servosim.gravity import MassTree, MimicDrive
from servosim.tip import Tip
from servosim.urdf import MovingJoint, read_joints, read_link_frame, read_shapes


class Dynamics(Protocol):
    """Joints with limits, the torque that the world puts on them, and their inertia.

    Positions are in the joints' own units: rad and N m, on sliding joints m and N.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """The joints, in the order of every list below."""
        ...

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Lower and upper limit of each joint."""
        ...

    def load_nm(self, positions: Sequence[float], velocities: Sequence[float]) -> list[float]:
        """Outer torque (force) on each joint; positive turns it forward."""
        ...

    def inertia(self, positions: Sequence[float]) -> list[float]:
        """What each joint alone would have to accelerate [kg m², on sliding joints kg]."""
        ...


class FreeBody:
    """Joints with nothing on them: servos on a desk."""

    def __init__(
        self, names: Sequence[str], limits: Sequence[tuple[float, float]] | None = None
    ) -> None:
        self.names = tuple(names)
        self.limits = tuple(limits or [(-math.inf, math.inf)] * len(self.names))
        self._nothing = [0.0] * len(self.names)

    def load_nm(self, positions: Sequence[float], velocities: Sequence[float]) -> list[float]:
        """Nothing pulls."""
        return self._nothing

    def inertia(self, positions: Sequence[float]) -> list[float]:
        """Nothing hangs."""
        return self._nothing


class GravityBody:
    """An arm read from its URDF, its base on a level table, each joint for itself.

    Gravity is exact for any tree of turning and sliding joints, mimic joints included; velocity
    forces and the pull of one joint's acceleration on another are left out.

    Args:
        urdf_path: The arm.
        joint_names: The joints that servos move; others rest at zero, or at the nearest limit.

    Raises:
        ArmFileError: The file is no usable URDF, or lacks one of the joints.
    """

    def __init__(self, urdf_path: str | Path, joint_names: Sequence[str]) -> None:
        self.names = tuple(joint_names)
        joints = read_joints(Path(urdf_path))
        by_name = {joint.name: joint for joint in joints}
        for name in self.names:
            if name not in by_name:
                known = ", ".join(by_name)
                raise ArmFileError(Path(urdf_path), "", f"no moving joint {name!r}; has: {known}")
        self.limits = tuple((by_name[name].lower, by_name[name].upper) for name in self.names)
        self._joints, self._path = joints, Path(urdf_path)
        self._drivers = [self._make_mimic_drive(joint) for joint in joints]
        self._tree = MassTree(joints, self._drivers, len(self.names))

    def load_nm(self, positions: Sequence[float], velocities: Sequence[float]) -> list[float]:
        """Gravity's torque (force) on each joint."""
        return self._tree.torques(positions)

    def inertia(self, positions: Sequence[float]) -> list[float]:
        """The diagonal of the arm's mass matrix."""
        return self._tree.inertias(positions)

    def contacts(self, floor_m: float | None, postures: Sequence[Sequence[float]]) -> Contacts:
        """Return what the arm lies on where no servo holds it; see `Contacts`.

        Args:
            floor_m: Height of the table in the base frame; None for none.
            postures: Positions that are free of contact.
        """
        shapes = read_shapes(self._path)
        return Contacts(self._joints, self._drivers, shapes, self._tree, floor_m, postures)

    def tip(self, link: str) -> Tip:
        """Return the tip, which is the origin of a link.

        Raises:
            ArmFileError: There is no such link.
        """
        parent, T = read_link_frame(self._path, link)
        return Tip(self._joints, self._drivers, self._tree, parent, T[:3, 3], self.limits)

    def _make_mimic_drive(self, joint: MovingJoint) -> MimicDrive:
        if joint.name in self.names:
            return MimicDrive(self.names.index(joint.name), 1.0, 0.0)
        if joint.mimic in self.names:
            return MimicDrive(self.names.index(joint.mimic), joint.multiplier, joint.offset)
        return MimicDrive(-1, 0.0, min(joint.upper, max(joint.lower, 0.0)))
