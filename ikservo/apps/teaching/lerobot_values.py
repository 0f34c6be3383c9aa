"""Joints in LeRobot's format: ``<joint>.pos`` in degrees, the gripper in percent."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model.arm_model import Model


@dataclass(frozen=True, slots=True)
class JointValue:
    """The linear map of one joint: ``value = (position - zero) * factor``.

    Attributes:
        name: The joint.
        zero: The position at value 0, rad or m.
        factor: Degrees per radian, millimetres per metre, or percent per radian or metre.
    """

    name: str
    zero: float
    factor: float

    @property
    def key(self) -> str:
        """Return LeRobot's name for the value."""
        return f"{self.name}.pos"


class JointValues:
    """The values of all joints of an arm, base to tip, the gripper last.

    The zeros are those of the URDF. A gripper is at 0 if its jaws meet and at 100 if they are
    fully open; the value of a prismatic joint is in millimetres.
    """

    def __init__(self, model: Model) -> None:
        joints: list[JointValue] = []
        for joint in model.joints:
            zero, factor = 0.0, 1000.0 if joint.joint_map.unit == "m" else math.degrees(1.0)
            gripper = model.gripper
            if gripper is not None and gripper.joint == joint.name:
                zero, factor = gripper.closed, 100.0 / (gripper.open - gripper.closed)
            joints.append(JointValue(joint.name, zero, factor))
        self._joints = tuple(joints)
        self._zeros = np.array([joint.zero for joint in self._joints])
        self._factors = np.array([joint.factor for joint in self._joints])

    @property
    def names(self) -> tuple[str, ...]:
        """The joints, in the order used in the vectors."""
        return tuple(joint.name for joint in self._joints)

    @property
    def features(self) -> dict[str, type]:
        """Return LeRobot's description of the values."""
        return {joint.key: float for joint in self._joints}

    def from_positions(self, positions: Vector) -> dict[str, float]:
        """Compute the values for positions (n,), rad or m."""
        values = (positions - self._zeros) * self._factors
        return dict(zip(self.features, values.tolist(), strict=True))

    def rows_from_positions(self, positions: Matrix) -> Matrix:
        """Compute the values (k, n) for positions (k, n), rad or m."""
        return (positions - self._zeros) * self._factors

    def rows_to_positions(self, values: Matrix) -> Matrix:
        """Compute the positions (k, n), rad or m, for values (k, n)."""
        return self._zeros + values / self._factors

    def to_positions(self, values: Mapping[str, Any], last: Vector) -> Vector:
        """Compute positions (n,), rad or m; joints without a value keep their ``last``.

        Raises:
            KeyError: A value belongs to no joint.
        """
        known = [i for i, joint in enumerate(self._joints) if joint.key in values]
        if not known:
            raise KeyError(next(iter(self.features)))
        positions = last.copy()
        for i in known:
            joint = self._joints[i]
            positions[i] = joint.zero + float(values[joint.key]) / joint.factor
        return positions
