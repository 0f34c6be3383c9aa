"""Rotor and output are two bodies, which meet at the flanks of the backlash."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import pytest

from servosim import open_port
from servosim.control import ControlMode, DriveCommand
from servosim.family import FAMILY, FamilyMember
from servosim.motor import Motor
from servosim.parameters import PARAMETERS, in_an_arm

CONFIGS = Path(__file__).parents[2] / "configs"
STS = PARAMETERS["STS3215-C018"]
DT_S = 0.001
FRICTIONS = ("friction_nm", "viscous_nm_s", "stribeck_nm", "load_friction", "load_stribeck",
             "load_square_per_nm", "output_friction_nm", "output_viscous_nm_s")  # fmt: skip
HALF_RAD = math.radians(0.5)
LIMP = DriveCommand()
HOLDING = DriveCommand(True, tick_rad=0.00153, dead_zone_rad=0.00153)


def pwm(duty: float) -> DriveCommand:
    return DriveCommand(True, mode=ControlMode.PWM, goal_pwm=duty)


def loaded(inertia: float = 0.01, **changes: float) -> Motor:
    figures = {"backlash_rad": 2.0 * HALF_RAD} | changes
    motor = Motor(replace(STS, **figures))
    motor.load_inertia_kg_m2 = inertia
    return motor


def rotor_rad(motor: Motor) -> float:
    return motor.position_rad - motor.lash_rad


def test_output_pushed_within_backlash_leaves_rotor_at_rest() -> None:
    motor = loaded()
    for _ in range(30):
        motor.step(DT_S, 0.1, LIMP, 12.0)
        assert motor.rotor_rad_s == rotor_rad(motor) == 0.0
    assert 0.0 < motor.position_rad < HALF_RAD


def test_rotor_driven_within_backlash_leaves_output_at_rest() -> None:
    motor = loaded()
    for _ in range(20):
        motor.step(DT_S, 0.0, pwm(0.1), 12.0)
        assert motor.velocity_rad_s == motor.position_rad == motor.encoder_rad == 0.0
    assert 0.0 < rotor_rad(motor) < HALF_RAD


@pytest.mark.parametrize("load_nm", [1.0, -1.0])
def test_load_rests_on_gear_flank_that_it_presses(load_nm: float) -> None:
    motor = loaded()
    for _ in range(1000):
        motor.step(DT_S, load_nm, HOLDING, 12.0)
    assert motor.lash_rad == math.copysign(HALF_RAD, load_nm)
    assert motor.velocity_rad_s == motor.rotor_rad_s == 0.0
    assert motor.is_on_flank


@pytest.mark.parametrize(
    ("inertia", "output_rad_s", "rotor_rad_s"),
    list(itertools.product([1e-5, 0.01, 0.3], [-3.0, 0.2, 3.0], [-2.0, 0.0, 2.5])),
)
def test_gear_flank_impact_loses_energy_and_keeps_momentum(
    inertia: float, output_rad_s: float, rotor_rad_s: float
) -> None:
    motor = loaded(inertia, **dict.fromkeys(FRICTIONS, 0.0))
    motor.set_state(0.0, output_rad_s, 0.0, rotor_rad_s)
    armature = motor.parameters.armature_kg_m2 - 1e-6
    carried = inertia + 1e-6

    def momentum() -> float:
        return armature * motor.rotor_rad_s + carried * motor.velocity_rad_s

    def energy_j() -> float:
        return (armature * motor.rotor_rad_s**2 + carried * motor.velocity_rad_s**2) / 2.0

    before, energies = momentum(), [energy_j()]
    for _ in range(100):
        motor.step(DT_S, 0.0, LIMP, 12.0)
        energies.append(energy_j())
        assert abs(motor.lash_rad) <= HALF_RAD
        assert momentum() == pytest.approx(before, abs=1e-9)
    assert all(after <= ahead + 1e-12 for ahead, after in itertools.pairwise(energies))
    assert motor.velocity_rad_s == pytest.approx(motor.rotor_rad_s)


def test_rotor_and_output_in_contact_move_as_one_body() -> None:
    playing, one = loaded(), loaded(backlash_rad=0.0)
    playing.set_state(0.0, 0.0, -HALF_RAD, 0.0)
    for _ in range(300):
        for motor in (playing, one):
            motor.step(DT_S, -0.3, pwm(0.3), 12.0)
        assert playing.lash_rad == -HALF_RAD
        assert playing.position_rad == pytest.approx(one.position_rad, rel=1e-9)


def test_output_friction_is_part_of_total_friction() -> None:
    """A limp joint that slides down sinks at the same speed, wherever its friction acts."""
    speeds: list[float] = []
    for output_nm in (0.0, 0.05):
        motor = loaded(output_friction_nm=output_nm)
        for _ in range(2000):
            motor.step(DT_S, 0.5, LIMP, 12.0)
        speeds.append(motor.velocity_rad_s)
    assert speeds[0] > 0.5
    assert speeds[1] == pytest.approx(speeds[0], rel=0.002)  # one crosses the play later


def swing_rad(output_nm: float, play_rad: float = 2.0 * HALF_RAD) -> float:
    """Return the peak-to-peak swing of an output, a second after a motion to its hanging position.

    Gains of an STS with P = 32, a pendulum of 0.7 kg at 0.1 m.
    """
    motor = loaded(0.008, output_friction_nm=output_nm, backlash_rad=play_rad)
    drive = replace(HOLDING, goal_rad=0.3, kp=0.163 * 32, startup_pwm=0.016)
    drive.velocity_limit_rad_s = 5.0
    seen: list[float] = []
    for k in range(4000):
        drive.goal_rad = 0.3 if k < 1000 else 0.0
        motor.step(DT_S, -0.7 * math.sin(motor.position_rad), drive, 12.0)
        seen.append(motor.position_rad)
    return max(seen[-1000:]) - min(seen[-1000:])


def test_frictionless_hanging_load_swings_across_backlash() -> None:
    # Logs of STS3215: 1.2° in 14 of 15 steps at P = 32.
    assert math.degrees(swing_rad(0.0)) == pytest.approx(1.23, rel=0.3)
    assert swing_rad(0.03) < 1e-3
    assert swing_rad(0.0, play_rad=0.0) < 1e-3


def parameters_of(query: str) -> list[object]:
    world = open_port(f"sim:{CONFIGS}/so101/arm.toml{query}").line.world
    mass = world.body.mass_matrix([0.0] * len(world.joints))
    rails = {volts: supply.open_v for volts, supply in world.rails.items()}
    return [[s.motor.parameters for s in world.servos], mass, rails]


def test_simulator_seed_varies_servos_and_no_seed_is_nominal() -> None:
    assert parameters_of("?seed=5") == parameters_of("?seed=5")
    assert parameters_of("?seed=5") != parameters_of("?seed=6")
    motors, _, rails = parameters_of("")
    assert motors == [in_an_arm(PARAMETERS["STS3215"])] * 6
    assert rails == {7.4: 7.4}


def test_simulator_seeds_cover_whole_range_of_parameters() -> None:
    members = [FamilyMember(seed) for seed in range(200)]
    for what, (low, high) in FAMILY.items():
        drawn = [member.drawn(what, "elbow") for member in members]
        assert low <= min(drawn) < max(drawn) <= high
        assert max(drawn) - min(drawn) > 0.9 * (high - low)
    for member in members:
        own = member.motor_parameters("elbow", STS)
        assert own.output_friction_nm < own.friction_nm + own.stribeck_nm
        assert own.output_viscous_nm_s < own.viscous_nm_s


def test_given_backlash_applies_to_all_servos_with_any_seed() -> None:
    motors, *_ = parameters_of("?seed=5&backlash_deg=0.3")
    assert {motor.backlash_rad for motor in motors} == {math.radians(0.3)}


def test_simulator_seed_decides_if_sts_d_gain_has_effect() -> None:
    for seed in range(20):
        port = open_port(f"sim:{CONFIGS}/so101/arm.toml?seed={seed}")
        acts = [servo.drive.kd > 0.0 for servo in port.line.world.servos]
        assert acts == [FamilyMember(seed).d_gain_acts] * 6
