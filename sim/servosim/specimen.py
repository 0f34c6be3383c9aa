"""One specimen of an arm: masses, payload and motors that differ from the model's."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from servosim.errors import ArmFileError, SimulatorError
from servosim.own_files import read_toml
from servosim.parameters import MotorParameters
from servosim.urdf import Mass, Matrix, MovingJoint

MAX_SCALE, MAX_PAYLOAD_KG, MAX_COMPLIANCE = 10.0, 20.0, 1.0

# Keys of a joint's table that are values of its motors, and the parameter of each.
_MOTOR_KEYS = MappingProxyType(
    {
        "coulomb_nm": "friction_nm",
        "viscous_nm_s": "viscous_nm_s",
        "slow_nm": "stribeck_nm",
        "slow_rad_s": "stribeck_rad_s",
        "load": "load_friction",
        "slow_load": "load_stribeck",
        "backlash_rad": "backlash_rad",
        "output_friction_nm": "output_friction_nm",
        "output_viscous_nm_s": "output_viscous_nm_s",
    }
)


@dataclass(frozen=True, slots=True)
class Specimen:
    """Differences of one arm from its files and from the models of its servos.

    Attributes:
        mass_scale: Factor of every mass.
        mass_scales: Further factor by joint, for the masses between this joint and the next ones.
        payload_kg: A point mass at the tip.
        motors: Values of the servos of a joint, by joint, with the keys of ``read_specimen``.
        compliances: The compliance behind the sensor of each joint, by name: rad per N m, m per N.
    """

    mass_scale: float = 1.0
    mass_scales: Mapping[str, float] = field(default_factory=dict[str, float])
    payload_kg: float = 0.0
    motors: Mapping[str, Mapping[str, float]] = field(
        default_factory=dict[str, Mapping[str, float]]
    )

    compliances: Mapping[str, float] = field(default_factory=dict[str, float])

    def __post_init__(self) -> None:
        for name, compliance in self.compliances.items():
            if not 0.0 <= compliance <= MAX_COMPLIANCE:
                most = f"0 to {MAX_COMPLIANCE:g} rad per N m"
                raise SimulatorError(f"the compliance of {name} must be {most}, not {compliance:g}")
        for scale in (self.mass_scale, *self.mass_scales.values()):
            if not 0.0 < scale <= MAX_SCALE:
                raise SimulatorError(f"a mass must be scaled by 0 to {MAX_SCALE:g}, not {scale:g}")
        if not 0.0 <= self.payload_kg <= MAX_PAYLOAD_KG:
            most = f"0 to {MAX_PAYLOAD_KG:g} kg"
            raise SimulatorError(f"a payload must be {most}, not {self.payload_kg:g} kg")

    @property
    def changes_masses(self) -> bool:
        """Whether the masses differ from those of the URDF."""
        scaled = any(scale != 1.0 for scale in (self.mass_scale, *self.mass_scales.values()))
        return scaled or self.payload_kg != 0.0

    def with_load(self, mass_scale: float | None, payload_g: float | None) -> Specimen:
        """Return the specimen with another scale of all masses, or another payload, if given."""
        scale = self.mass_scale if mass_scale is None else mass_scale
        payload_kg = self.payload_kg if payload_g is None else payload_g / 1000.0
        return replace(self, mass_scale=scale, payload_kg=payload_kg)

    def scaled_joints(
        self, joints: Sequence[MovingJoint], tip: tuple[int, Matrix] | None
    ) -> list[MovingJoint]:
        """Return moving joints with the masses of this specimen.

        Args:
            joints: The joints in the order of the URDF, parents first. A body on a joint without
                its own scale (the jaws) uses that of its parent.
            tip: The moving joint that carries the tip, and the tip's frame in that joint's frame.

        Raises:
            SimulatorError: There is a payload but no tip to hold it.
        """
        scales: list[float] = []
        scaled: list[MovingJoint] = []
        for joint in joints:
            above = scales[joint.parent] if joint.parent >= 0 else self.mass_scale
            own = self.mass_scales.get(joint.name)
            scale, body = above if own is None else self.mass_scale * own, joint.body
            scales.append(scale)
            mass = Mass(scale * body.mass_kg, np.array(body.com_m), scale * body.inertia_kg_m2)
            scaled.append(replace(joint, body=mass))
        if self.payload_kg:
            if tip is None or tip[0] < 0:
                raise SimulatorError("the arm has no tip that moves and could hold a payload")
            scaled[tip[0]].body.add_body(Mass(self.payload_kg), tip[1])
        return scaled

    def motor_parameters(self, joint: str, parameters: MotorParameters) -> MotorParameters:
        """Return the parameters of one of a joint's servos with the values of this specimen."""
        figures = self.motors.get(joint, {})
        changed = {to: figures[key] for key, to in _MOTOR_KEYS.items() if key in figures}
        kt, ohm = parameters.torque_constant_nm_a, parameters.resistance_ohm
        most_nm = kt * parameters.current_limit_a
        full_nm = figures.get("full_duty_nm", kt * parameters.nominal_v / ohm)
        brake_nm_s = figures.get("back_emf_nm_s", kt * kt / ohm)
        kt = brake_nm_s * parameters.nominal_v / full_nm
        ohm = kt * parameters.nominal_v / full_nm
        return replace(
            parameters,
            torque_constant_nm_a=kt,
            resistance_ohm=ohm,
            current_limit_a=most_nm / kt,
            **changed,
        )


def read_specimen(path: Path) -> Specimen:
    """Read the specimen that a TOML file describes.

    Each table ``[[joints]]`` has a ``name`` and, as far as known, the ``mass_scale`` of the masses
    that the joint carries and the values of each of its servos: ``full_duty_nm`` (torque of the
    blocked motor at full duty and nominal supply), ``back_emf_nm_s``, ``coulomb_nm``,
    ``viscous_nm_s``, ``slow_nm``, ``slow_rad_s``, ``load``, ``slow_load``, ``backlash_rad``,
    ``output_friction_nm``, ``output_viscous_nm_s``; and ``compliance``, rad per N m behind the
    sensor. Other keys are ignored.

    Raises:
        ArmFileError: The file is missing, not TOML, or a value cannot be used.
    """
    try:
        document = read_toml(path)
    except (OSError, ValueError) as error:
        raise ArmFileError(path, "", str(error)) from error
    try:
        tables = [(str(table["name"]), table) for table in document["joints"]]
        scales = {name: float(t["mass_scale"]) for name, t in tables if "mass_scale" in t}
        motors = {name: _motor_figures(table) for name, table in tables}
        yields = {name: float(t["compliance"]) for name, t in tables if "compliance" in t}
        return Specimen(mass_scales=scales, motors=motors, compliances=yields)
    except KeyError as error:
        raise ArmFileError(path, "", f"key {error} is missing") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise ArmFileError(path, "", f"a value cannot be used: {error}") from error


def _motor_figures(table: dict[str, Any]) -> dict[str, float]:
    keys = (*_MOTOR_KEYS, "full_duty_nm", "back_emf_nm_s")
    figures = {key: float(table[key]) for key in keys if key in table}
    for key, value in figures.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise ValueError(f"{key} = {value}")
    for key in ("full_duty_nm", "back_emf_nm_s", "slow_rad_s"):
        if figures.get(key, 1.0) <= 0.0:
            raise ValueError(f"{key} = {figures[key]}")
    for key in ("load", "slow_load"):
        if figures.get(key, 0.0) >= 0.5:
            raise ValueError(f"{key} = {figures[key]}")
    return figures
