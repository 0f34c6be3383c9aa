"""The motor behind each model's gears: figures of the datasheets, seen from the output shaft."""

from __future__ import annotations

import math
from dataclasses import dataclass

RAD_S_PER_RPM = 2.0 * math.pi / 60.0
STICTION = 1.2  # static over moving friction (e)
HEAT_J_GK = 0.8  # between plastic and copper (e)
# An STS3215 that held 15 kg cm rose by 23 K within ten minutes and stayed there for an hour
# (SO-ARM100 issue 134): 3.9 to 6.3 W in the winding. Scaled by the surface for other sizes.
COOLING_K_W = 4.0


@dataclass(frozen=True, slots=True)
class MotorParameters:
    """One model's motor and gears at the output shaft.

    Attributes:
        nominal_v: Supply voltage of the figures below.
        stall_torque_nm: Torque of the blocked shaft at full duty.
        stall_current_a: Current of the blocked shaft at full duty.
        no_load_speed_rad_s: Speed of the free shaft at full duty.
        no_load_current_a: Current of the free shaft at full duty: friction at the motor.
        gear_ratio: Revolutions of the motor for one of the shaft.
        coulomb_friction_nm: Friction of the moving shaft that does not depend on its speed.
        static_friction_nm: Torque that sets the resting shaft in motion.
        armature_kg_m2: Inertia of rotor and gears, at the shaft.
        backlash_rad: Free play of the gears, from one tooth face to the other.
        mass_kg: Mass of the whole servo.
        heat_capacity_j_k: Heat that warms the whole servo by one kelvin.
        thermal_resistance_k_w: Kelvin above ambient for each watt, at rest.
    """

    nominal_v: float
    stall_torque_nm: float
    stall_current_a: float
    no_load_speed_rad_s: float
    no_load_current_a: float
    gear_ratio: float
    coulomb_friction_nm: float
    static_friction_nm: float
    armature_kg_m2: float
    backlash_rad: float
    mass_kg: float
    heat_capacity_j_k: float
    thermal_resistance_k_w: float

    @property
    def torque_constant_nm_a(self) -> float:
        """Torque at the shaft for each ampere, gears included."""
        return self.stall_torque_nm / self.stall_current_a

    @property
    def resistance_ohm(self) -> float:
        """Resistance of winding and bridge."""
        return self.nominal_v / self.stall_current_a

    @property
    def damping_nm_s(self) -> float:
        """All torque that grows with speed, so that the free shaft runs at the no-load speed."""
        return (self.stall_torque_nm - self.coulomb_friction_nm) / self.no_load_speed_rad_s

    @property
    def viscous_damping_nm_s(self) -> float:
        """Friction of bearings and grease for each rad/s."""
        no_load_nm = self.torque_constant_nm_a * self.no_load_current_a
        return max(0.0, no_load_nm - self.coulomb_friction_nm) / self.no_load_speed_rad_s

    @property
    def back_emf_nm_s(self) -> float:
        """Torque that the back-EMF takes away for each rad/s."""
        return self.damping_nm_s - self.viscous_damping_nm_s


def _row(
    volts: float, stall_nm: float, stall_a: float, rpm: float, free_a: float, gears: float,
    friction_nm: float, armature: float, play_deg: float, mass_g: float,
) -> MotorParameters:  # fmt: skip
    return MotorParameters(
        nominal_v=volts,
        stall_torque_nm=stall_nm,
        stall_current_a=stall_a,
        no_load_speed_rad_s=rpm * RAD_S_PER_RPM,
        no_load_current_a=free_a,
        gear_ratio=gears,
        coulomb_friction_nm=friction_nm,
        static_friction_nm=STICTION * friction_nm,
        armature_kg_m2=armature,
        backlash_rad=math.radians(play_deg),
        mass_kg=mass_g / 1000.0,
        heat_capacity_j_k=HEAT_J_GK * mass_g,
        thermal_resistance_k_w=COOLING_K_W * (55.0 / mass_g) ** (2.0 / 3.0),
    )


# Volts, torque, currents, speed, gears, mass: the vendors' datasheets. The letters are the source
# of the other figures of a row:
# b  identified on a pendulum by Rhoban's BAM (Apache-2.0), params/feetech_sts3215_7_4V and
#    params/xl330, model m1. Its STS3215 is the one of the SO-101 MJCF: force 3.35, frictionloss
#    0.052, armature 0.028, damping 0.60 (back-EMF included), kp 17.8 at P = 32.
#    Its mx64 and mx106 (0.012, 0.027 kg m²; 0.090, 0.104 N m) are the measure for other rows.
# g  the row above, scaled by the gears.
# h  currents of the HLS3950, a sibling of equal torque and speed; no sheet gives STS3250's.
# e  friction (1.5 to 3 % of stall), armature and, for Dynamixel, free current estimated.
# x  all but the torque estimated.
# Play: Feetech promises at most 0.5°; 0.87° and 1° were measured on the STS3215 (SO-ARM100 issue
# 134), its MJCF has 1°. ROBOTIS gives 0.25° for XM540, 0.33° for MX-28, nothing for others.
# fmt: off
#                           V     N m     A    rpm  free A  gears friction armature play°  g
PARAMETERS: dict[str, MotorParameters] = {
    "STS3215":      _row( 7.4,  3.35,  2.77,  51.8, 0.15, 345.0, 0.052, 0.0284,  1.00,  55.0),  # b
    "STS3215-C018": _row(12.0,  2.94,  2.70,  45.0, 0.18, 345.0, 0.052, 0.0284,  1.00,  55.0),  # b
    "STS3250":      _row(12.0,  4.90,  2.40,  75.0, 0.33, 345.0, 0.080, 0.0300,  0.50,  74.5),  # he
    "SCS0009":      _row( 6.0,  0.226, 1.00, 100.0, 0.15, 416.0, 0.008, 0.0007,  0.50,  13.2),  # e
    "SCS15":        _row( 6.0,  1.47,  1.50,  62.5, 0.15, 200.0, 0.030, 0.0020,  0.50,  56.0),  # x
    "XL330-M288":   _row( 5.0,  0.52,  1.47, 103.0, 0.20, 288.4, 0.021, 0.0017,  0.25,  18.0),  # b
    "XL330-M077":   _row( 5.0,  0.215, 1.47, 383.0, 0.20,  77.5, 0.006, 0.00013, 0.25,  18.0),  # g
    "XL430-W250":   _row(12.0,  1.50,  1.40,  61.0, 0.10, 258.5, 0.040, 0.0053,  0.25,  57.2),  # e
    "XM430-W350":   _row(12.0,  4.10,  2.30,  46.0, 0.10, 353.5, 0.070, 0.0112,  0.25,  82.0),  # e
    "XM540-W270":   _row(12.0, 10.60,  4.40,  30.0, 0.15, 272.5, 0.150, 0.0260,  0.25, 165.0),  # e
    "AX-12A":       _row(12.0,  1.50,  1.50,  59.0, 0.14, 254.0, 0.040, 0.0032,  0.33,  54.6),  # e
    "MX-28":        _row(12.0,  2.50,  1.40,  55.0, 0.10, 193.0, 0.040, 0.0032,  0.33,  77.0),  # e
}
# fmt: on
