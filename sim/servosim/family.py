"""A family of arms: differences between arms of the same kind, by a seed."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from servosim.parameters import MotorParameters, in_an_arm

FAMILY: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "backlash_deg": (0.2, 2.0),
        "output_friction_nm": (0.0, 0.05),
        "output_viscous_nm_s": (0.0, 0.01),
        "torque_constant": (0.9, 1.1),
        "friction": (0.7, 1.3),
        "armature": (0.9, 1.1),
        "mass": (0.85, 1.15),
        "supply": (0.9, 1.0),
        "d_gain_acts": (0.0, 1.0),
    }
)
"""Ranges of uniform distributions, for each joint and its servos; the last two for the arm.

Ranges without a unit are factors. The output's friction and damping are also limited to a part of
the servo's total (`parameters.in_an_arm`). The D gain of an STS acts in half of the arms, because
its unit is unknown. Backlash: Feetech specifies 0.5°, and 1° was measured on three STS3215.
Friction, torque constant and armature: published fits of the same model differ by as much.
The others are estimates.
"""


@dataclass(frozen=True, slots=True)
class FamilyMember:
    """One arm of the family; the same seed gives the same arm.

    Attributes:
        seed: The seed of the arm.
    """

    seed: int

    def drawn(self, what: str, joint: str = "") -> float:
        """Return the value of a key of `FAMILY` for a joint, or for the arm."""
        chance = random.Random(f"{self.seed} {what} {joint}")  # noqa: S311 - not a secret
        return chance.uniform(*FAMILY[what])

    @property
    def d_gain_acts(self) -> bool:
        """Whether the D gain of STS servos acts."""
        return self.drawn("d_gain_acts") < 0.5

    def motor_parameters(self, joint: str, model: MotorParameters) -> MotorParameters:
        """Return the parameters of a joint's servos, from those of their model."""
        friction, kt = self.drawn("friction", joint), self.drawn("torque_constant", joint)
        scaled = replace(
            model,
            torque_constant_nm_a=kt * model.torque_constant_nm_a,
            friction_nm=friction * model.friction_nm,
            viscous_nm_s=friction * model.viscous_nm_s,
            stribeck_nm=friction * model.stribeck_nm,
            load_friction=friction * model.load_friction,
            load_stribeck=friction * model.load_stribeck,
            load_square_per_nm=friction * model.load_square_per_nm,
            armature_kg_m2=self.drawn("armature", joint) * model.armature_kg_m2,
            backlash_rad=math.radians(self.drawn("backlash_deg", joint)),
        )
        output = self.drawn("output_friction_nm", joint), self.drawn("output_viscous_nm_s", joint)
        return in_an_arm(scaled, *output)
