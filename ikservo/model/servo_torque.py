"""Torque of the servos at their horns: stiffness, damping, friction, and that of the whole duty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

__all__ = ["SERVO_TORQUES", "GearFriction", "ServoTorque", "find_servo_torque"]


@dataclass(frozen=True, slots=True)
class GearFriction:
    """Dry friction of a servo's gears: grows with their load, and is greater in a slow shaft.

    ``|tau| <= coulomb + load g + exp(-|w| / slow_rad_s) (slow + slow_load g)`` with the load g of
    the gears, the difference of the motor's and the outer torque: model m4 of Duclusaud, Passault
    et al., "Extended Friction Models for the Physics Simulation of Servo Actuators" (2024).

    Attributes:
        coulomb_nm: Friction of the unloaded gears.
        slow_nm: What a slow shaft has besides.
        slow_rad_s: Velocity at which that has fallen to 37 %.
        load: Friction for each N m of load.
        slow_load: Likewise, what a slow shaft has besides.
    """

    coulomb_nm: float
    slow_nm: float
    slow_rad_s: float
    load: float
    slow_load: float

    @property
    def static_nm(self) -> float:
        """Outer torque that sets a resting shaft in motion whose motor is off."""
        return (self.coulomb_nm + self.slow_nm) / (1.0 - self.load - self.slow_load)


@dataclass(frozen=True, slots=True)
class ServoTorque:
    """What a servo's motor and gears do at its horn.

    Attributes:
        stiffness_nm_rad: Torque of each rad between goal and horn, at ``p_gain``.
        p_gain: Register value of the P gain that the servo has while an arm moves: as delivered,
            or as `control.servo_group` raises it.
        full_duty_nm: Torque of the blocked motor for the whole duty, before friction.
        damping_nm_s: Torque that back-EMF and viscous friction take for each rad/s.
        armature_kg_m2: Inertia of rotor and gears.
        friction: Of the gears.
        startup_duty: Duty that the firmware adds in the direction of an error.
    """

    stiffness_nm_rad: float
    p_gain: int
    full_duty_nm: float
    damping_nm_s: float
    armature_kg_m2: float
    friction: GearFriction
    startup_duty: float = 0.0

    @property
    def static_friction_nm(self) -> float:
        """Torque that sets the resting shaft in motion."""
        return self.friction.static_nm

    @property
    def friction_rad(self) -> float:
        """How far from its goal friction keeps a horn without load, rad."""
        return self.static_friction_nm / self.stiffness_nm_rad

    @property
    def friction_share(self) -> float:
        """Share of the duty that friction takes."""
        return self.static_friction_nm / self.full_duty_nm


# Friction: coulomb and slow [N m], slow below [rad/s], for each N m of load, that of a slow shaft.
_STS3215 = GearFriction(0.1175, 0.0522, 0.218, 0.110, 0.071)
_STS3250 = GearFriction(0.0468, 0.0331, 0.062, 0.121, 0.029)
_SCS0009 = GearFriction(0.00577, 0.00256, 0.443, 0.110, 0.071)
_SCS15 = GearFriction(0.0375, 0.0167, 0.277, 0.110, 0.071)
_XL330_M288 = GearFriction(0.0024, 0.0003, 0.436, 0.260, 0.042)
_XL330_M077 = GearFriction(0.000992, 0.000124, 1.35, 0.260, 0.042)
_XL430 = GearFriction(0.0154, 0.00598, 1.38, 0.0, 0.234)
_XM430 = GearFriction(0.0420, 0.0163, 1.04, 0.0, 0.234)
_XM540 = GearFriction(0.109, 0.0422, 0.680, 0.0, 0.234)
_AX_12 = GearFriction(0.0154, 0.00598, 1.34, 0.0, 0.234)
_MX_28 = GearFriction(0.0256, 0.00996, 1.25, 0.0, 0.234)

# Stiffness is the duty of a rad times the torque of the whole duty: 0.163 P for the STS,
# for Dynamixel P / 128 PWM steps of 885 for each tick, for the XL330 P / 256. Motors and friction
# of STS3215, STS3250 and XL330-M288 are fitted to logs of pendulums, others are scaled from those
# or from published fits: see docs/servosim-truth.md. The STS3215 is sold for 7.4 V and for 12 V.
# fmt: off
SERVO_TORQUES: Mapping[tuple[str, float | None], ServoTorque] = MappingProxyType(
    {   #                            N m/rad     P   N m    N m s    kg m²
        ("STS3215", None): ServoTorque(17.5, 32, 3.35, 0.578, 0.0216, _STS3215, 0.014),
        ("STS3215", 12.0): ServoTorque(35.9, 32, 6.88, 1.31, 0.0216, _STS3215, 0.014),
        ("STS3250", None): ServoTorque(52.5, 32, 10.1, 1.28, 0.0083, _STS3250, 0.004),
        ("SCS0009", None): ServoTorque(1.76, 32, 0.338, 0.0316, 0.0007, _SCS0009, 0.014),
        ("SCS15", None): ServoTorque(11.5, 32, 2.20, 0.328, 0.0020, _SCS15, 0.014),
        ("XL330-M288", None): ServoTorque(2.67, 1500, 0.619, 0.0473, 0.0020, _XL330_M288),
        ("XL330-M077", None): ServoTorque(1.11, 1500, 0.256, 0.00632, 0.00018, _XL330_M077),
        ("XL430-W250", None): ServoTorque(9.09, 1000, 1.58, 0.245, 0.0053, _XL430),
        ("XM430-W350", None): ServoTorque(19.9, 800, 4.32, 0.888, 0.0112, _XM430),
        ("XM540-W270", None): ServoTorque(51.4, 800, 11.2, 3.52, 0.0260, _XM540),
        ("AX-12A", None): ServoTorque(2.7, 32, 1.58, 0.253, 0.0032, _AX_12),
        ("MX-28", None): ServoTorque(6.4, 32, 2.64, 0.453, 0.0032, _MX_28),
    }
)
# fmt: on


def find_servo_torque(model: str, supply_v: float | None) -> ServoTorque | None:
    """Return the figures of a model at a supply voltage; None where they are unknown.

    Args:
        model: The servo's.
        supply_v: As the arm file says; None, and one without figures of its own, is the usual one.
    """
    return SERVO_TORQUES.get((model, supply_v)) or SERVO_TORQUES.get((model, None))
