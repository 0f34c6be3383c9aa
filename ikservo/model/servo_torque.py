"""Torque of the servos at their horns: stiffness, friction at rest, and that of the whole duty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

__all__ = ["SERVO_TORQUES", "ServoTorque", "find_servo_torque"]


@dataclass(frozen=True, slots=True)
class ServoTorque:
    """What a servo's motor and gears do at its horn.

    Attributes:
        stiffness_nm_rad: Torque of each rad between goal and horn, at the gains that the servo has
            while an arm moves: as delivered, XL330 as `control.servo_limits` raises them.
        full_duty_nm: Torque of the blocked motor for the whole duty, before friction.
        static_friction_nm: Torque that sets the resting shaft in motion.
    """

    stiffness_nm_rad: float
    full_duty_nm: float
    static_friction_nm: float

    @property
    def friction_rad(self) -> float:
        """How far from its goal friction keeps a horn without load, rad."""
        return self.static_friction_nm / self.stiffness_nm_rad

    @property
    def friction_share(self) -> float:
        """Share of the duty that friction takes."""
        return self.static_friction_nm / self.full_duty_nm


# Stiffness is the duty of a rad times the torque of the whole duty: 0.163 P for the STS,
# for Dynamixel P / 128 PWM steps of 885 for each tick, for the XL330 P / 256. Torque and friction
# of STS3215, STS3250 and XL330-M288 are fitted to logs of pendulums, others are scaled from those
# or from published fits: see docs/servosim-truth.md. The STS3215 is sold for 7.4 V and for 12 V.
SERVO_TORQUES: Mapping[tuple[str, float | None], ServoTorque] = MappingProxyType(
    {
        ("STS3215", None): ServoTorque(17.5, 3.35, 0.207),
        ("STS3215", 12.0): ServoTorque(35.9, 6.88, 0.207),
        ("STS3250", None): ServoTorque(52.5, 10.1, 0.094),
        ("SCS0009", None): ServoTorque(1.76, 0.338, 0.0102),
        ("SCS15", None): ServoTorque(11.5, 2.20, 0.0662),
        ("XL330-M288", None): ServoTorque(2.67, 0.619, 0.0039),
        ("XL330-M077", None): ServoTorque(1.11, 0.256, 0.0016),
        ("XL430-W250", None): ServoTorque(5.82, 1.58, 0.0279),
        ("XM430-W350", None): ServoTorque(19.9, 4.32, 0.0762),
        ("XM540-W270", None): ServoTorque(51.4, 11.2, 0.197),
        ("AX-12A", None): ServoTorque(2.7, 1.58, 0.0279),
        ("MX-28", None): ServoTorque(6.4, 2.64, 0.0465),
    }
)


def find_servo_torque(model: str, supply_v: float | None) -> ServoTorque | None:
    """Return the figures of a model at a supply voltage; None where they are unknown.

    Args:
        model: The servo's.
        supply_v: As the arm file says; None, and one without figures of its own, is the usual one.
    """
    return SERVO_TORQUES.get((model, supply_v)) or SERVO_TORQUES.get((model, None))
