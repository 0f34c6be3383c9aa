"""The motor behind each model's gears: fits to measurements, and values scaled from them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

RAD_S_PER_RPM = 2.0 * math.pi / 60.0
HEAT_J_GK = 0.8  # heat capacity between plastic and copper (estimate)
# Surface cooling: an STS3215 that held 15 kg cm warmed by 23 K within ten minutes and stayed there
# for an hour (SO-ARM100 issue 134). Scaled by the surface for other sizes.
COOLING_K_W = 10.0
# Friction on the output side of the backlash. Pendulums on bare servos swing across it at rest as
# if nothing braked them there (tools/bench/limit_cycle.py). At most 0.003 N m agrees with that on
# the STS3215, a hundredth of its dry friction. An arm adds a second bearing and cables. Their
# friction is unknown (0 to 0.05 N m and 0 to 0.01 N m s) and part of the total, which stays as
# fitted.
BARE_SHARE = 0.01
OUTPUT_FRICTION_NM, MOST_OF_FRICTION = 0.03, 0.75
OUTPUT_VISCOUS_NM_S, MOST_OF_VISCOUS = 0.005, 0.5


@dataclass(frozen=True, slots=True)
class MotorParameters:
    """One model's motor and gears at the output shaft; equations in `servosim.motor.Motor`.

    Attributes:
        nominal_v: Supply voltage of the model.
        torque_constant_nm_a: kt: torque at the shaft per ampere, gears included, before friction;
            also the back-EMF per rad/s.
        resistance_ohm: R: resistance of winding and bridge.
        current_limit_a: Limit of the winding's current, by the firmware or the bridge.
        friction_nm: kc: dry friction of the unloaded gears.
        viscous_nm_s: kv: friction per rad/s.
        stribeck_nm: ks: additional dry friction of a slow shaft.
        stribeck_rad_s: ws: velocity at which that has fallen to 37 %.
        load_friction: kl: dry friction per N m of load in the gears.
        load_stribeck: kls: the same, additional for a slow shaft.
        load_square_per_nm: kq: dry friction per square of that load.
        armature_kg_m2: Inertia of rotor and gears, at the shaft.
        gear_ratio: Revolutions of the motor per revolution of the shaft.
        backlash_rad: Free play of the gears, from one tooth face to the other.
        output_friction_nm: The part of the dry friction on the output side of the backlash.
        output_viscous_nm_s: The corresponding part of kv, which brakes the output inside the
            backlash.
        mass_kg: Mass of the whole servo.
        heat_capacity_j_k: Heat that warms the whole servo by one kelvin.
        thermal_resistance_k_w: Kelvin above ambient per watt, at rest.
    """

    nominal_v: float
    torque_constant_nm_a: float
    resistance_ohm: float
    current_limit_a: float
    friction_nm: float
    viscous_nm_s: float
    stribeck_nm: float
    stribeck_rad_s: float
    load_friction: float
    load_stribeck: float
    load_square_per_nm: float
    armature_kg_m2: float
    gear_ratio: float
    backlash_rad: float
    output_friction_nm: float
    output_viscous_nm_s: float
    mass_kg: float
    heat_capacity_j_k: float
    thermal_resistance_k_w: float

    @property
    def duty_torque_nm(self) -> float:
        """The torque of the motor at the blocked shaft at full duty, without any limit."""
        return self.torque_constant_nm_a * self.nominal_v / self.resistance_ohm

    @property
    def stall_current_a(self) -> float:
        """The current of the blocked shaft at full duty."""
        return min(self.nominal_v / self.resistance_ohm, self.current_limit_a)

    @property
    def stall_torque_nm(self) -> float:
        """The torque of the motor at the blocked shaft at full duty, before friction."""
        return self.torque_constant_nm_a * self.stall_current_a

    @property
    def no_load_speed_rad_s(self) -> float:
        """The no-load speed of the shaft at full duty; kq has no effect at so little load."""
        kt, full_a = self.torque_constant_nm_a, self.nominal_v / self.resistance_ohm
        driven_nm = kt * full_a * (1.0 - self.load_friction) - self.friction_nm
        braked_nm_s = kt * kt / self.resistance_ohm * (1.0 - self.load_friction)
        return driven_nm / (braked_nm_s + self.viscous_nm_s)

    @property
    def static_friction_nm(self) -> float:
        """The external torque that starts to turn the resting, limp shaft."""
        rest = 1.0 - self.load_friction - self.load_stribeck
        dry_nm = self.friction_nm + self.stribeck_nm
        # The smaller root of kq x^2 - rest x + dry = 0, in a form without cancellation.
        return 2.0 * dry_nm / (rest + math.sqrt(rest**2 - 4.0 * self.load_square_per_nm * dry_nm))


def _row(figures: tuple[float, ...], build: tuple[float, ...]) -> MotorParameters:
    """Return a row: electrical values, torque limit and friction, then construction."""
    volts, kt, ohm, most_nm, friction_nm, viscous, stribeck, slow, load, load_slow, square = figures
    armature, gears, play_deg, mass_g = build
    return MotorParameters(
        nominal_v=volts,
        torque_constant_nm_a=kt,
        resistance_ohm=ohm,
        current_limit_a=most_nm / kt,
        friction_nm=friction_nm,
        viscous_nm_s=viscous,
        stribeck_nm=stribeck,
        stribeck_rad_s=slow,
        load_friction=load,
        load_stribeck=load_slow,
        load_square_per_nm=square,
        armature_kg_m2=armature,
        gear_ratio=gears,
        backlash_rad=math.radians(play_deg),
        output_friction_nm=BARE_SHARE * (friction_nm + stribeck),
        output_viscous_nm_s=0.0,
        mass_kg=mass_g / 1000.0,
        heat_capacity_j_k=HEAT_J_GK * mass_g,
        thermal_resistance_k_w=COOLING_K_W * (55.0 / mass_g) ** (2.0 / 3.0),
    )


def in_an_arm(
    parameters: MotorParameters,
    output_friction_nm: float = OUTPUT_FRICTION_NM,
    output_viscous_nm_s: float = OUTPUT_VISCOUS_NM_S,
) -> MotorParameters:
    """Return the parameters of a servo that moves an arm's joint: more friction on the output."""
    dry_nm = parameters.friction_nm + parameters.stribeck_nm
    return replace(
        parameters,
        output_friction_nm=min(output_friction_nm, MOST_OF_FRICTION * dry_nm),
        output_viscous_nm_s=min(output_viscous_nm_s, MOST_OF_VISCOUS * parameters.viscous_nm_s),
    )


# Motors, fitted by tools/identify_motor.py to logs of pendulums (mass 0.5 to 1.2 kg at 0.1 to
# 0.15 m): STS3215-C018 and STS3250 on 240 logs of K-Scale Labs (kscalelabs/sysid, commit d66b22c)
# each and validated on 240 others, XL330-M288 on 8 logs of Rhoban's BAM (commit af22604).
# Only kt/R and kt*kt/R are known: torque per volt, brake per rad/s. The XL330 needs no torque
# limit, because its friction grows with the square of the load.
# Torque limits: a 12 V STS3215 also pressed 3.4 N m on a scale (SO-ARM100 issue 134).
# STS3215 (7.4 V): kt, R and kv of BAM (params/feetech_sts3215_7_4V, model m1: commits 1b5a1ce and
# 6d2ada2 have kv = 0.059 and 0.045, dry friction of 0.052 and 0.068 N m), and 0.38 of the dry
# friction of _GEAR, 0.065 N m of an unloaded slow shaft. _GEAR is an earlier fit of the 12 V one,
# without kq, with 7 % less friction. The SCS are also scaled from it.
# Other rows are scaled, from the relative that `_scaled` names, to the torque and speed of the
# makers' sheets. MX64 is BAM's fit (params/mx64, model m4). No sheet gives an armature: unless it
# was measured, a servo has the rotor of its relative in the same case.
# Backlash: Feetech specifies at most 0.5°; 0.87° and 1° were measured on the STS3215 (SO-ARM100
# issue 134), its MJCF has 1°, and 1° makes the logs' pendulums swing as they do at rest; 0.4° does
# so for the STS3250.
# ROBOTIS says 0.25° for XM540, 0.33° for MX-28, nothing for others.
# fmt: off
#               V     kt     ohm    N m   kc      kv      ks      ws     kl     kls    kq
_C018 = _row((12.0, 2.244, 3.675, 3.27, 0.1282, 0.0254, 0.0488, 0.135, 0.093, 0.097, 0.0187),
             (0.0215, 345.0, 1.00, 55.0))  # armature, gears, play °, g
_GEAR = _row((12.0, 2.230, 3.892, 3.26, 0.1175, 0.0288, 0.0522, 0.218, 0.110, 0.071, 0.0000),
             (0.0216, 345.0, 0.50, 55.0))
_C001 = _row(( 7.4, 1.212, 2.676, 2.50, 0.0450, 0.0500, 0.0200, 0.218, 0.042, 0.027, 0.0000),
             (0.0216, 345.0, 1.00, 55.0))
_3250 = _row((12.0, 1.461, 1.638, 3.61, 0.0445, 0.0529, 0.0239, 0.082, 0.068, 0.088, 0.0278),
             (0.0089, 345.0, 0.40, 74.5))
_M288 = _row(( 5.0, 0.3993, 3.083, math.inf, 0.00077, 0.00231, 0.00423, 0.2518, 0.1543, 0.0875,
               0.1724), (0.00156, 288.4, 0.25, 18.0))
_MX64 = _row((12.0, 1.663, 3.156, 6.32, 0.0615, 0.0148, 0.0239, 1.521, 0.000, 0.234, 0.000),
             (0.0110, 200.0, 0.33, 135.0))
# fmt: on
_SHEET_STALL_NM = {_GEAR: 4.6, _M288: 0.52, _MX64: 6.0}  # first: at the shaft, no limit


def _scaled(
    relative: MotorParameters, volts: float, stall_nm: float, rpm: float, armature: float,
    gears: float, play_deg: float, mass_g: float,
) -> MotorParameters:  # fmt: skip
    """Return a row with the friction of a related motor, scaled by torque and speed.

    Args:
        relative: A fitted motor with gears of the same kind.
        volts: Supply voltage of the values.
        stall_nm: Torque of the blocked shaft at full duty.
        rpm: Speed of the free shaft at full duty.
        armature: Inertia at the shaft [kg m²].
        gears: Revolutions of the motor per revolution of the shaft.
        play_deg: Backlash.
        mass_g: Mass.
    """
    slower = relative.no_load_speed_rad_s / (rpm * RAD_S_PER_RPM)
    kt = slower * relative.torque_constant_nm_a * volts / relative.nominal_v
    share = stall_nm / _SHEET_STALL_NM[relative]
    full_nm = share * relative.duty_torque_nm
    figures = (
        volts, kt, kt * volts / full_nm, math.inf, share * relative.friction_nm,
        share * slower * relative.viscous_nm_s, share * relative.stribeck_nm,
        relative.stribeck_rad_s / slower, relative.load_friction, relative.load_stribeck,
        relative.load_square_per_nm / share,
    )  # fmt: skip
    return _row(figures, (armature, gears, play_deg, mass_g))


# fmt: off
PARAMETERS: dict[str, MotorParameters] = {
    "STS3215": _C001,
    "STS3215-C018": _C018,
    "STS3250": _3250,
    "STS3235": _row((12.0, 2.244, 3.675, 3.27, 0.1282, 0.0254, 0.0488, 0.135, 0.093, 0.097, 0.0187),
                    (0.0215, 345.0, 0.50, 70.5)),  # the motor of the C018, in another case
    #                              V     N m    rpm   armature  gears  play°    g
    "SCS0009":    _scaled(_GEAR,  6.0,  0.226, 100.0, 0.0007,  416.0, 0.50,  13.2),
    "HLS3606M":   _scaled(_GEAR,  6.0,  0.59,  111.0, 0.00079, 205.0, 0.50,  20.6),
    "SCS225":     _scaled(_GEAR,  7.4,  2.45,   62.5, 0.0020,  200.0, 0.50,  56.0),  # least known
    "SCS15":      _scaled(_GEAR,  6.0,  1.47,   62.5, 0.0020,  200.0, 0.50,  56.0),
    "XL330-M288": _M288,
    "XL330-M077": _scaled(_M288,  5.0,  0.215, 383.0, 0.00018,  77.5, 0.25,  18.0),
    "XC330-M288": _scaled(_M288,  5.0,  0.93,   81.0, 0.00156, 288.4, 0.25,  23.0),
    "XC330-M181": _scaled(_M288,  5.0,  0.60,  129.0, 0.00061, 180.6, 0.25,  23.0),
    "XC330-T288": _scaled(_M288, 12.0,  1.00,   71.0, 0.00156, 288.4, 0.25,  23.0),
    "XC330-T181": _scaled(_M288, 12.0,  0.80,  113.0, 0.00061, 180.6, 0.25,  23.0),
    "XL430-W250": _scaled(_MX64, 12.0,  1.50,   61.0, 0.0053,  258.5, 0.25,  57.2),
    "2XL430-W250": _scaled(_MX64, 12.0, 1.50,   61.0, 0.0053,  257.4, 0.25,  49.1),  # per shaft
    "XC430-W240": _scaled(_MX64, 12.0,  1.90,   70.0, 0.0048,  245.2, 0.25,  65.0),
    "XC430-W150": _scaled(_MX64, 12.0,  1.60,  106.0, 0.0020,  159.6, 0.25,  65.0),
    "2XC430-W250": _scaled(_MX64, 12.0, 1.80,   64.0, 0.0053,  257.4, 0.25,  51.0),
    "XM430-W350": _scaled(_MX64, 12.0,  4.10,   46.0, 0.0112,  353.5, 0.25,  82.0),
    "XM430-W210": _scaled(_MX64, 12.0,  3.00,   77.0, 0.0041,  212.6, 0.25,  82.0),
    "XH430-W350": _scaled(_MX64, 12.0,  3.40,   30.0, 0.0112,  353.5, 0.25,  82.0),
    "XH430-W210": _scaled(_MX64, 12.0,  2.50,   50.0, 0.0041,  212.6, 0.25,  82.0),
    "XM540-W270": _scaled(_MX64, 12.0, 10.60,   30.0, 0.0260,  272.5, 0.25, 165.0),
    "XM540-W150": _scaled(_MX64, 12.0,  7.30,   53.0, 0.0081,  152.3, 0.25, 165.0),
    "XH540-W270": _scaled(_MX64, 12.0,  9.90,   39.0, 0.0260,  272.5, 0.25, 165.0),
    "XH540-W150": _scaled(_MX64, 12.0,  7.10,   70.0, 0.0081,  152.3, 0.25, 165.0),
    "XL-320":     _scaled(_M288,  7.4,  0.39,  114.0, 0.0011,  238.0, 0.25,  16.7),
    "AX-12A":     _scaled(_MX64, 12.0,  1.50,   59.0, 0.0032,  254.0, 0.33,  54.6),
    "MX-28":      _scaled(_MX64, 12.0,  2.50,   55.0, 0.0032,  193.0, 0.33,  77.0),
}
# fmt: on
