"""A motor follows the profile of its firmware."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from servosim.control import Controller, ControlMode, DriveCommand
from servosim.motor import Motor
from servosim.parameters import PARAMETERS, MotorParameters

DT_S = 0.001
MODELS = sorted(PARAMETERS)


def nominal(model: str) -> tuple[Motor, float]:
    return Motor(PARAMETERS[model]), PARAMETERS[model].nominal_v


def run(
    motor: Motor, drive: DriveCommand, seconds: float, supply_v: float, load_nm: float = 0.0
) -> None:
    for _ in range(round(seconds / DT_S)):
        motor.step(DT_S, load_nm, drive, supply_v)


def duty_at(motor: MotorParameters, velocity_rad_s: float) -> float:
    """Return the duty that an unloaded motor needs at a velocity, from its equations."""
    friction_nm = motor.friction_nm + motor.viscous_nm_s * velocity_rad_s
    slow = math.exp(-velocity_rad_s / motor.stribeck_rad_s)
    driven_nm = (friction_nm + slow * motor.stribeck_nm) / (
        1.0 - motor.load_friction - slow * motor.load_stribeck
    )
    return (driven_nm / motor.duty_torque_nm) + velocity_rad_s * (
        motor.torque_constant_nm_a / motor.nominal_v
    )


@pytest.mark.parametrize("model", MODELS)
def test_unloaded_motor_lags_profile_by_duty_over_gain(model: str) -> None:
    motor, supply_v = nominal(model)
    speed_rad_s = 0.4 * motor.parameters.no_load_speed_rad_s
    drive = DriveCommand(True, goal_rad=99.0, velocity_limit_rad_s=speed_rad_s, kp=5.3)
    run(motor, drive, 0.9, supply_v)
    lag_rad = motor.reference_rad - motor.position_rad
    needed = duty_at(motor.parameters, speed_rad_s)
    assert lag_rad == pytest.approx(needed / drive.kp, rel=0.02)


def test_velocity_feed_forward_removes_lag() -> None:
    motor, supply_v = nominal("XM430-W350")
    drive = DriveCommand(True, goal_rad=9.0, velocity_limit_rad_s=1.0)
    drive.velocity_feed_forward = duty_at(motor.parameters, 1.0)
    run(motor, drive, 2.0, supply_v)
    assert motor.reference_rad - motor.position_rad == pytest.approx(0.0, abs=0.002)


@pytest.mark.parametrize("model", ["XL330-M288", "XL430-W250", "XM430-W350"])
def test_time_based_profile_arrives_on_time(model: str) -> None:
    motor, supply_v = nominal(model)
    drive = DriveCommand(True, goal_rad=1.0, profile_time_s=2.0, acceleration_time_s=0.5)
    run(motor, drive, 1.0, supply_v)
    assert motor.reference_rad == pytest.approx(0.5, abs=0.001)
    run(motor, drive, 1.2, supply_v)
    assert motor.position_rad == pytest.approx(1.0, abs=0.02)
    assert not motor.profile_running


@pytest.mark.parametrize("new_goal", [2.0, 0.4, -1.0])
def test_new_goal_during_profile_causes_no_velocity_jump(new_goal: float) -> None:
    motor, supply_v = nominal("STS3215")
    drive = DriveCommand(True, goal_rad=1.5, velocity_limit_rad_s=1.0, acceleration_rad_s2=3.0)
    run(motor, drive, 0.7, supply_v)
    drive.goal_rad = new_goal
    for _ in range(4000):
        before = motor.reference_velocity_rad_s
        motor.step(DT_S, 0.0, drive, supply_v)
        assert abs(motor.reference_velocity_rad_s - before) <= 3.0 * DT_S + 1e-9
    assert motor.position_rad == pytest.approx(new_goal, abs=0.02)


def test_new_goal_of_timed_profile_causes_no_velocity_jump() -> None:
    motor, supply_v = nominal("XL330-M288")
    drive = DriveCommand(True, goal_rad=1.0, profile_time_s=1.0, acceleration_time_s=0.25)
    run(motor, drive, 0.5, supply_v)
    before = motor.reference_velocity_rad_s
    drive.goal_rad = 0.2
    motor.step(DT_S, 0.0, drive, supply_v)
    assert motor.reference_velocity_rad_s == pytest.approx(before, abs=0.02)


def test_torque_on_starts_profile_from_shaft_position() -> None:
    motor, supply_v = nominal("STS3215")
    drive = DriveCommand(goal_rad=1.0, velocity_limit_rad_s=1.0, acceleration_rad_s2=2.0)
    run(motor, drive, 0.1, supply_v)
    motor.place(0.6)
    drive.torque_on = True
    motor.step(DT_S, 0.0, drive, supply_v)
    assert motor.reference_rad == pytest.approx(0.6, abs=1e-4)


def test_velocity_mode_settles_at_goal_velocity() -> None:
    motor, supply_v = nominal("XM430-W350")
    drive = DriveCommand(True, mode=ControlMode.VELOCITY, goal_velocity_rad_s=-2.0)
    run(motor, drive, 2.0, supply_v, load_nm=0.5)
    assert motor.velocity_rad_s == pytest.approx(-2.0, abs=0.01)


def test_velocity_mode_ramps_with_profile_acceleration() -> None:
    motor, supply_v = nominal("XM430-W350")
    drive = DriveCommand(
        True, mode=ControlMode.VELOCITY, goal_velocity_rad_s=2.0, acceleration_rad_s2=1.0
    )
    run(motor, drive, 1.0, supply_v)
    assert motor.velocity_rad_s == pytest.approx(1.0, abs=0.15)


def test_moving_flag_is_set_from_start_to_end_of_profile() -> None:
    motor, supply_v = nominal("STS3215")
    drive = DriveCommand(True, goal_rad=0.5, velocity_limit_rad_s=1.0, acceleration_rad_s2=2.0)
    motor.step(DT_S, 0.0, drive, supply_v)
    assert motor.moving
    run(motor, drive, 2.0, supply_v)
    assert not motor.moving


def test_motor_simulation_is_deterministic() -> None:
    traces = []
    for _ in range(2):
        motor, supply_v = nominal("XL430-W250")
        drive = DriveCommand(True, goal_rad=1.0, velocity_limit_rad_s=2.0, acceleration_rad_s2=9.0)
        run(motor, drive, 0.8, supply_v, load_nm=-0.2)
        traces.append((motor.position_rad, motor.current_a, motor.temperature_c))
    assert traces[0] == traces[1]


@pytest.mark.parametrize("model", MODELS)
def test_motor_simulation_is_stable_with_highest_gains(model: str) -> None:
    supply_v = PARAMETERS[model].nominal_v
    motor = Motor(replace(PARAMETERS[model], backlash_rad=0.0))  # play swings by itself
    full_duty_units, ticks_per_rad, largest = 885.0, 4096.0 / (2.0 * math.pi), 16383.0
    kp = largest / 128.0 * ticks_per_rad / full_duty_units
    kd = largest / 16.0 * ticks_per_rad / 1000.0 / full_duty_units
    drive = DriveCommand(True, goal_rad=0.5, kp=kp, kd=kd)
    run(motor, drive, 3.0, supply_v)
    assert motor.position_rad == pytest.approx(0.5, abs=0.01)
    assert motor.velocity_rad_s == 0.0


@pytest.mark.parametrize("way_rad", [0.0011, 0.0028, 0.0049])
def test_d_gain_impulses_sum_to_gain_times_distance(way_rad: float) -> None:
    # a D gain acts on the change of the error, however the way falls into steps of the loop
    controller = Controller(0.0)
    drive = DriveCommand(True, velocity_limit_rad_s=1.25, kp=0.0, kd=0.18)
    controller.duty(DT_S, drive, 0.0, 0.0)
    drive.goal_rad = way_rad
    duties = [controller.duty(DT_S, drive, 0.0, 0.0) for _ in range(8)]
    assert max(duties) == pytest.approx(drive.kd * 1.25, rel=0.2)
    assert sum(duties) * DT_S == pytest.approx(drive.kd * way_rad)


@pytest.mark.parametrize("way_rad", [0.0011, 0.0028, 0.0049])
def test_velocity_feed_forward_sums_to_gain_times_distance(way_rad: float) -> None:
    controller = Controller(0.0)
    drive = DriveCommand(True, velocity_limit_rad_s=1.25, kp=0.0, velocity_feed_forward=0.2)
    controller.duty(DT_S, drive, 0.0, 0.0)
    drive.goal_rad = way_rad
    duties = [controller.duty(DT_S, drive, 0.0, 0.0) for _ in range(8)]
    assert sum(duties) * DT_S == pytest.approx(0.2 * way_rad)


def test_acceleration_feed_forward_brakes_as_much_as_it_drives() -> None:
    controller = Controller(0.0)
    drive = DriveCommand(
        True, velocity_limit_rad_s=1.0, acceleration_rad_s2=10.0, kp=0.0,
        acceleration_feed_forward=0.01,
    )  # fmt: skip
    controller.duty(DT_S, drive, 0.0, 0.0)
    drive.goal_rad = 0.5
    duties = [controller.duty(DT_S, drive, 0.0, 0.0) for _ in range(800)]
    assert max(duties) == pytest.approx(0.1)
    assert sum(duties) == pytest.approx(0.0, abs=0.11)


@pytest.mark.parametrize("load_nm", [0.3, -0.8])
def test_sag_without_friction_is_torque_over_stiffness(load_nm: float) -> None:
    dry = ("friction_nm", "stribeck_nm", "load_friction", "load_stribeck", "load_square_per_nm")
    ideal = replace(PARAMETERS["STS3215"], **dict.fromkeys(dry, 0.0))
    motor, drive = Motor(ideal), DriveCommand(True, goal_rad=0.2, kp=5.3)
    run(motor, drive, 3.0, ideal.nominal_v, load_nm)
    stiffness_nm_rad = drive.kp * ideal.duty_torque_nm
    assert motor.position_rad - 0.2 == pytest.approx(load_nm / stiffness_nm_rad, rel=1e-3)


@pytest.mark.parametrize("model", MODELS)
def test_dry_friction_changes_sag_by_at_most_its_torque(model: str) -> None:
    motor, supply_v = nominal(model)
    figures = motor.parameters
    drive, load_nm = DriveCommand(True, kp=5.3), -0.2 * figures.stall_torque_nm
    run(motor, drive, 3.0, supply_v, load_nm)
    held_nm = -motor.position_rad * drive.kp * figures.duty_torque_nm
    creep_nm = 1e-4 * figures.stall_torque_nm  # slower than what counts as a motion
    assert abs(held_nm + load_nm) <= bound_nm(figures, held_nm - load_nm) + creep_nm


def bound_nm(motor: MotorParameters, gear_nm: float) -> float:
    """Return the greatest dry friction at rest under a load of the gears."""
    load = motor.load_friction + motor.load_stribeck + motor.load_square_per_nm * abs(gear_nm)
    return motor.friction_nm + motor.stribeck_nm + load * abs(gear_nm)


def test_position_under_load_has_hysteresis_of_dry_friction() -> None:
    """The friction of a held load has hysteresis, because it grows with the load (K-Scale's logs).

    The load moves with the shaft as on the bench: it carries the shaft on before it sticks.
    """
    held_rad = []
    for start_rad in (0.3, -0.3):
        motor, supply_v = Motor(PARAMETERS["STS3215-C018"], start_rad), 12.0
        motor.load_inertia_kg_m2 = 0.011  # of 1.04 N m at 0.1 m
        run(motor, DriveCommand(True, kp=0.163 * 16), 3.0, supply_v, load_nm=-1.04)
        held_rad.append(math.degrees(motor.position_rad))
    above, below = held_rad
    assert above - below == pytest.approx(2.3, abs=0.9)
    assert (above + below) / 2.0 == pytest.approx(-2.6, abs=0.9)


def test_integral_gain_removes_sag() -> None:
    motor, supply_v = nominal("XM430-W350")
    drive = DriveCommand(True, kp=4.6, ki=20.0)
    run(motor, drive, 5.0, supply_v, load_nm=-0.8)
    assert motor.position_rad == pytest.approx(0.0, abs=0.01)


def test_integral_stops_growing_while_duty_is_limited() -> None:
    motor, supply_v = nominal("XM430-W350")
    motor.stuck = True
    drive = DriveCommand(True, goal_rad=0.3, kp=4.6, ki=20.0)
    run(motor, drive, 5.0, supply_v)
    motor.stuck = False
    run(motor, drive, 0.6, supply_v)
    assert motor.position_rad < 0.5


def test_error_inside_dead_zone_does_not_draw_current() -> None:
    motor, supply_v = nominal("STS3215")
    drive = DriveCommand(True, goal_rad=0.004, dead_zone_rad=0.005)
    run(motor, drive, 0.1, supply_v)
    assert motor.current_a == 0.0


@pytest.mark.parametrize(("error_rad", "duty"), [(0.01, 0.067), (-0.01, -0.067), (0.0, 0.0)])
def test_startup_force_is_added_to_gain_output(error_rad: float, duty: float) -> None:
    motor, supply_v = nominal("STS3215")
    motor.stuck = True
    motor.step(DT_S, 0.0, DriveCommand(True, goal_rad=error_rad, startup_pwm=0.014), supply_v)
    assert motor.pwm == pytest.approx(duty)


def test_error_beyond_protection_limits_duty_to_a_quarter() -> None:
    motor, supply_v = nominal("STS3215")
    motor.stuck = True
    drive = DriveCommand(True, goal_rad=1.8, kp=0.2, protected_error_rad=1.7)
    motor.step(DT_S, 0.0, drive, supply_v)
    assert motor.pwm == pytest.approx(0.2 * 1.8 / 4.0)


def test_servo_position_error_is_in_whole_ticks() -> None:
    motor, supply_v = nominal("STS3215")
    motor.stuck = True
    drive = DriveCommand(True, goal_rad=0.0026, tick_rad=0.001, kp=10.0)
    motor.step(DT_S, 0.0, drive, supply_v)
    assert motor.pwm == pytest.approx(10.0 * 0.003)


def test_goal_already_reached_starts_no_motion_profile() -> None:
    motor, supply_v = nominal("XL330-M288")
    motor.step(DT_S, 0.0, DriveCommand(True, profile_time_s=1.0, acceleration_time_s=0.2), supply_v)
    assert not motor.profile_running
