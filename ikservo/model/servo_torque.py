"""Torque figures of servos at their horns: stiffness, damping, friction, full duty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from types import MappingProxyType


@dataclass(frozen=True, slots=True)
class GearFriction:
    """Dry friction of a servo's gears, which grows with their load and is larger at low speed.

    ``|tau| <= coulomb + load g + square g^2 + exp(-|w| / slow_rad_s) (slow + slow_load g)`` with
    the load g on the gears, the difference between the motor's torque and the external torque. This
    is model m4 of Duclusaud, Passault et al., "Extended Friction Models for the Physics Simulation
    of Servo Actuators" (2024), plus a part that grows with the square of the load.

    Attributes:
        coulomb_nm: Friction of the unloaded gears.
        slow_nm: Additional friction at low speed.
        slow_rad_s: Velocity at which the additional friction has fallen to 37 %.
        load: Friction per N m of load.
        slow_load: Additional friction at low speed per N m of load.
        square_per_nm: Friction per square of the load.
    """

    coulomb_nm: float
    slow_nm: float
    slow_rad_s: float
    load: float
    slow_load: float
    square_per_nm: float = 0.0

    @property
    def static_nm(self) -> float:
        """External torque that starts to turn a resting shaft whose motor is off."""
        return self.static_load_nm(0.0)

    def static_load_nm(self, held_nm: float) -> float:
        """Compute the gear load at which a resting shaft starts to turn: g = held + friction(g).

        It is the smaller root of ``square g^2 - (1 - load - slow_load) g + held + dry = 0``. If
        there is no real root, the square root in its formula is taken as zero.

        Args:
            held_nm: Gear load without friction: zero if torque is off, twice the external torque
                if the motor overcomes that torque.
        """
        rest = 1.0 - self.load - self.slow_load
        dry_nm = held_nm + self.coulomb_nm + self.slow_nm
        root = sqrt(max(0.0, rest**2 - 4.0 * self.square_per_nm * dry_nm))
        return 2.0 * dry_nm / (rest + root)


@dataclass(frozen=True, slots=True)
class ServoTorque:
    """Behaviour of a servo's motor and gears at its horn.

    Attributes:
        stiffness_nm_rad: Torque per rad between goal and horn, at ``p_gain``.
        p_gain: Register value of the P gain while an arm moves: the default, or the value to which
            `control.servo_gains` raises it.
        full_duty_nm: Torque of the blocked motor at full duty, before friction.
        damping_nm_s: Torque of back-EMF and viscous friction per rad/s.
        armature_kg_m2: Inertia of rotor and gears.
        friction: The friction of the gears.
        startup_duty: Duty that the firmware adds in the direction of an error, minus the duty of
            its dead zone at ``p_gain``.
        sustained_duty: Duty that a blocked servo may apply for a long time, with a margin to its
            overload protection, which acts at 80 % according to Feetech's registers. Dynamixel
            publishes no value; the simulator uses 90 %.
    """

    stiffness_nm_rad: float
    p_gain: int
    full_duty_nm: float
    damping_nm_s: float
    armature_kg_m2: float
    friction: GearFriction
    startup_duty: float = 0.0
    sustained_duty: float = 0.85

    @property
    def sustained_nm(self) -> float:
        """Torque that a blocked servo may produce for a long time."""
        return (self.sustained_duty - self.startup_duty) * self.full_duty_nm

    def full_current_a(self, nominal_v: float) -> float:
        """Compute the current of the blocked motor at full duty and nominal supply."""
        return self.full_duty_nm**2 / (self.damping_nm_s * nominal_v)

    @property
    def static_friction_nm(self) -> float:
        """Torque that starts to turn the resting shaft."""
        return self.friction.static_nm

    @property
    def friction_rad(self) -> float:
        """Distance from the goal at which friction holds an unloaded horn, rad."""
        return self.static_friction_nm / self.stiffness_nm_rad

    @property
    def friction_share(self) -> float:
        """Static friction as a fraction of the torque at full duty."""
        return self.static_friction_nm / self.full_duty_nm


# Friction: coulomb and slow [N m], slow_rad_s, load, slow_load, square_per_nm.
_STS3215 = GearFriction(0.0450, 0.0200, 0.218, 0.042, 0.027)
_STS3215_12_V = GearFriction(0.1282, 0.0488, 0.135, 0.093, 0.097, 0.0187)
_STS3250 = GearFriction(0.0445, 0.0239, 0.082, 0.068, 0.088, 0.0278)
_SCS0009 = GearFriction(0.00577, 0.00256, 0.443, 0.110, 0.071)
_SCS15 = GearFriction(0.0375, 0.0167, 0.277, 0.110, 0.071)
_XL330_M288 = GearFriction(0.00077, 0.00423, 0.2518, 0.1543, 0.0875, 0.1724)
_XL330_M077 = GearFriction(0.000318, 0.00175, 0.850, 0.1543, 0.0875, 0.417)
_XL430 = GearFriction(0.0154, 0.00598, 1.38, 0.0, 0.234)
_XM430 = GearFriction(0.0420, 0.0163, 1.04, 0.0, 0.234)
_XM540 = GearFriction(0.109, 0.0422, 0.680, 0.0, 0.234)
_AX_12 = GearFriction(0.0154, 0.00598, 1.34, 0.0, 0.234)
_MX_28 = GearFriction(0.0256, 0.00996, 1.25, 0.0, 0.234)

# Stiffness is the duty per rad times the torque at full duty: 0.163 P for the STS, P / 128 PWM
# steps of 885 per tick for Dynamixel, P / 256 for the XL330. Motors and friction of STS3215,
# STS3250 and XL330-M288 are fitted to logs of pendulums; others are scaled from those or from
# published fits, see docs/lab/simulated-motors.md. The STS3215 is sold for 7.4 V and for 12 V.
# HLS3606M and SCS225 have no entry: neither the meaning of a P gain with a current loop nor the
# speed of the SCS225 is published. These get no feed-forward and no predicted sag.
# fmt: off
SERVO_TORQUES: Mapping[tuple[str, float | None], ServoTorque] = MappingProxyType(
    {   #                            N m/rad     P   N m    N m s    kg m²
        ("STS3215", None): ServoTorque(17.5, 32, 3.35, 0.599, 0.0216, _STS3215, 0.008, 0.75),
        ("STS3215", 12.0): ServoTorque(38.2, 32, 7.33, 1.40, 0.0215, _STS3215_12_V, 0.008, 0.75),
        ("STS3250", None): ServoTorque(55.8, 32, 10.7, 1.36, 0.0089, _STS3250, 0.0, 0.75),
        ("STS3235", None): ServoTorque(38.2, 32, 7.33, 1.40, 0.0215, _STS3215_12_V, 0.008, 0.75),
        ("SCS0009", None): ServoTorque(1.76, 32, 0.338, 0.0316, 0.0007, _SCS0009, 0.014, 0.75),
        ("SCS15", None): ServoTorque(11.5, 32, 2.20, 0.328, 0.0020, _SCS15, 0.014, 0.75),
        ("XL330-M288", None): ServoTorque(2.80, 1500, 0.648, 0.0540, 0.00156, _XL330_M288),
        ("XL330-M077", None): ServoTorque(1.16, 1500, 0.268, 0.00662, 0.00018, _XL330_M077),
        ("XL430-W250", None): ServoTorque(9.09, 1000, 1.58, 0.245, 0.0053, _XL430),
        ("XM430-W350", None): ServoTorque(19.9, 800, 4.32, 0.888, 0.0112, _XM430),
        ("XM540-W270", None): ServoTorque(51.4, 800, 11.2, 3.52, 0.0260, _XM540),
        ("XC330-M288", None): ServoTorque(3.67, 1100, 1.16, 0.135, 0.00156,
            GearFriction(0.00138, 0.00757, 0.18, 0.1543, 0.0875, 0.0964)),
        ("XC330-M181", None): ServoTorque(2.58, 1200, 0.747, 0.0548, 0.00061,
            GearFriction(0.000888, 0.00488, 0.286, 0.1543, 0.0875, 0.149)),
        ("XC330-T288", None): ServoTorque(3.23, 900, 1.25, 0.166, 0.00156,
            GearFriction(0.00148, 0.00813, 0.158, 0.1543, 0.0875, 0.0896)),
        ("XC330-T181", None): ServoTorque(2.58, 900, 0.996, 0.0834, 0.00061,
            GearFriction(0.00118, 0.00651, 0.251, 0.1543, 0.0875, 0.112)),
        ("2XL430-W250", None): ServoTorque(5.82, 640, 1.58, 0.245, 0.0053,
            GearFriction(0.0154, 0.00598, 1.38, 0.0, 0.234)),
        ("XC430-W240", None): ServoTorque(8.07, 700, 2, 0.271, 0.0048,
            GearFriction(0.0195, 0.00757, 1.59, 0.0, 0.234)),
        ("XC430-W150", None): ServoTorque(4.46, 460, 1.69, 0.15, 0.002,
            GearFriction(0.0164, 0.00637, 2.4, 0.0, 0.234)),
        ("2XC430-W250", None): ServoTorque(7.64, 700, 1.9, 0.28, 0.0053,
            GearFriction(0.0184, 0.00717, 1.45, 0.0, 0.234)),
        ("XM430-W210", None): ServoTorque(14.6, 800, 3.16, 0.388, 0.0041,
            GearFriction(0.0307, 0.012, 1.75, 0.0, 0.234)),
        ("XH430-W350", None): ServoTorque(18.6, 900, 3.58, 1.13, 0.0112,
            GearFriction(0.0348, 0.0135, 0.68, 0.0, 0.234)),
        ("XH430-W210", None): ServoTorque(13.6, 900, 2.63, 0.498, 0.0041,
            GearFriction(0.0256, 0.00996, 1.13, 0.0, 0.234)),
        ("XM540-W150", None): ServoTorque(35.4, 800, 7.69, 1.37, 0.0081,
            GearFriction(0.0748, 0.0291, 1.2, 0.0, 0.234)),
        ("XH540-W270", None): ServoTorque(48, 800, 10.4, 2.53, 0.026,
            GearFriction(0.101, 0.0394, 0.884, 0.0, 0.234)),
        ("XH540-W150", None): ServoTorque(34.4, 800, 7.48, 1.01, 0.0081,
            GearFriction(0.0728, 0.0283, 1.59, 0.0, 0.234)),
        ("XL-320", None): ServoTorque(2.97, 32, 0.486, 0.0403, 0.0011,
            GearFriction(0.000577, 0.00317, 0.253, 0.1543, 0.0875, 0.23)),
        ("AX-12A", None): ServoTorque(9.66, 32, 1.58, 0.253, 0.0032, _AX_12),
        ("MX-28", None): ServoTorque(16.1, 32, 2.64, 0.453, 0.0032, _MX_28),
    }
)
# fmt: on


GRIPPER_P_GAINS: Mapping[str, int] = MappingProxyType(
    {"XL330-M288": 800, "XL330-M077": 800, "XL430-W250": 640}
)
"""P gains of servos that are softer in a gripper than in the arm; the XL430 keeps its default."""


def find_servo_torque(model: str, supply_v: float | None) -> ServoTorque | None:
    """Return the torque figures of a model at a supply voltage; None if they are unknown.

    The model's usual voltage is assumed if the given voltage is None or has no figures of its own.
    """
    return SERVO_TORQUES.get((model, supply_v)) or SERVO_TORQUES.get((model, None))


_SUPPLY_V = MappingProxyType(
    {"STS3215": 7.4, "SCS225": 7.4, "XL-320": 7.4, "SCS0009": 6.0, "SCS15": 6.0, "HLS3606M": 6.0}
    | dict.fromkeys(("XL330-M288", "XL330-M077", "XC330-M288", "XC330-M181"), 5.0)
)
_USUAL_SUPPLY_V = 12.0


def nominal_supply_v(model: str, supply_v: float | None) -> float:
    """Return the supply voltage for which the figures of a model are valid."""
    if supply_v is not None and (model, supply_v) in SERVO_TORQUES:
        return supply_v
    return _SUPPLY_V.get(model, _USUAL_SUPPLY_V)
