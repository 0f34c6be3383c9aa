"""A motor follows what its firmware draws."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from servosim.control import ControlMode, DriveCommand
from servosim.motor import Motor
from servosim.parameters import PARAMETERS

DT_S = 0.001
MODELS = sorted(PARAMETERS)


def nominal(model: str) -> tuple[Motor, float]:
    return Motor(PARAMETERS[model]), PARAMETERS[model].nominal_v


def run(
    motor: Motor, drive: DriveCommand, seconds: float, supply_v: float, load_nm: float = 0.0
) -> None:
    for _ in range(round(seconds / DT_S)):
        motor.step(DT_S, load_nm, drive, supply_v)


def trapezoid_rad(goal: float, top: float, slope: float, time_s: float) -> float:
    """Closed form of a trapezoid from rest at zero that reaches its top speed."""
    ramp_s, total_s = top / slope, goal / top + top / slope
    if time_s < ramp_s:
        return slope * time_s**2 / 2.0
    if time_s < total_s - ramp_s:
        return top * (time_s - ramp_s / 2.0)
    return goal - slope * max(0.0, total_s - time_s) ** 2 / 2.0


@pytest.mark.parametrize("model", MODELS)
def test_an_unloaded_motor_follows_the_closed_form_trapezoid_within_one_percent(model: str) -> None:
    motor, supply_v = nominal(model)
    goal, top = math.pi / 2.0, 0.4 * motor.parameters.no_load_speed_rad_s
    slope = 4.0 * top**2 / goal
    drive = DriveCommand(True, goal_rad=goal, velocity_limit_rad_s=top, acceleration_rad_s2=slope)
    errors = []
    for k in range(1, 1 + round((goal / top + top / slope + 0.2) / DT_S)):
        motor.step(DT_S, 0.0, drive, supply_v)
        errors.append(motor.position_rad - trapezoid_rad(goal, top, slope, k * DT_S))
    assert max(map(abs, errors)) < 0.01 * goal


@pytest.mark.parametrize("model", ["XL330-M288", "XL430-W250", "XM430-W350"])
def test_a_time_based_profile_arrives_when_it_says(model: str) -> None:
    motor, supply_v = nominal(model)
    drive = DriveCommand(True, goal_rad=1.0, profile_time_s=2.0, acceleration_time_s=0.5)
    run(motor, drive, 1.0, supply_v)
    assert motor.position_rad == pytest.approx(0.5, abs=0.01)
    run(motor, drive, 1.0, supply_v)
    assert motor.position_rad == pytest.approx(1.0, abs=0.01)
    assert not motor.profile_running


@pytest.mark.parametrize("new_goal", [2.0, 0.4, -1.0])
def test_a_goal_changed_in_mid_profile_makes_no_jump_in_velocity(new_goal: float) -> None:
    motor, supply_v = nominal("STS3215")
    drive = DriveCommand(True, goal_rad=1.5, velocity_limit_rad_s=1.0, acceleration_rad_s2=3.0)
    run(motor, drive, 0.7, supply_v)
    drive.goal_rad = new_goal
    for _ in range(4000):
        before = motor.reference_velocity_rad_s
        motor.step(DT_S, 0.0, drive, supply_v)
        assert abs(motor.reference_velocity_rad_s - before) <= 3.0 * DT_S + 1e-9
    assert motor.position_rad == pytest.approx(new_goal, abs=0.005)


def test_a_changed_time_based_goal_makes_no_jump_in_velocity() -> None:
    motor, supply_v = nominal("XL330-M288")
    drive = DriveCommand(True, goal_rad=1.0, profile_time_s=1.0, acceleration_time_s=0.25)
    run(motor, drive, 0.5, supply_v)
    before = motor.reference_velocity_rad_s
    drive.goal_rad = 0.2
    motor.step(DT_S, 0.0, drive, supply_v)
    assert motor.reference_velocity_rad_s == pytest.approx(before, abs=0.02)


def test_torque_switched_on_starts_from_where_the_shaft_is() -> None:
    motor, supply_v = nominal("STS3215")
    drive = DriveCommand(goal_rad=1.0, velocity_limit_rad_s=1.0, acceleration_rad_s2=2.0)
    run(motor, drive, 0.1, supply_v)
    motor.place(0.6)
    drive.torque_on = True
    motor.step(DT_S, 0.0, drive, supply_v)
    assert motor.reference_rad == pytest.approx(0.6, abs=1e-4)


def test_a_motor_in_velocity_mode_settles_at_its_goal() -> None:
    motor, supply_v = nominal("XM430-W350")
    drive = DriveCommand(True, mode=ControlMode.VELOCITY, goal_velocity_rad_s=-2.0)
    run(motor, drive, 1.0, supply_v, load_nm=0.5)
    assert motor.velocity_rad_s == pytest.approx(-2.0, abs=0.01)


def test_velocity_mode_ramps_with_the_profile_acceleration() -> None:
    motor, supply_v = nominal("XM430-W350")
    drive = DriveCommand(
        True, mode=ControlMode.VELOCITY, goal_velocity_rad_s=2.0, acceleration_rad_s2=1.0
    )
    run(motor, drive, 1.0, supply_v)
    assert motor.velocity_rad_s == pytest.approx(1.0, abs=0.05)


def test_moving_is_true_from_the_first_step_of_a_profile_to_its_end() -> None:
    motor, supply_v = nominal("STS3215")
    drive = DriveCommand(True, goal_rad=0.5, velocity_limit_rad_s=1.0, acceleration_rad_s2=2.0)
    motor.step(DT_S, 0.0, drive, supply_v)
    assert motor.moving
    run(motor, drive, 2.0, supply_v)
    assert not motor.moving


def test_two_equal_runs_are_equal_to_the_last_bit() -> None:
    traces = []
    for _ in range(2):
        motor, supply_v = nominal("XL430-W250")
        drive = DriveCommand(True, goal_rad=1.0, velocity_limit_rad_s=2.0, acceleration_rad_s2=9.0)
        run(motor, drive, 0.8, supply_v, load_nm=-0.2)
        traces.append((motor.position_rad, motor.current_a, motor.temperature_c))
    assert traces[0] == traces[1]


@pytest.mark.parametrize("model", MODELS)
def test_the_stiffest_gains_stay_stable_at_steps_of_a_millisecond(model: str) -> None:
    motor, supply_v = nominal(model)
    full_duty_units, ticks_per_rad, largest = 885.0, 4096.0 / (2.0 * math.pi), 16383.0
    kp = largest / 128.0 * ticks_per_rad / full_duty_units
    kd = largest / 16.0 * ticks_per_rad / 1000.0 / full_duty_units
    drive = DriveCommand(True, goal_rad=0.5, kp=kp, kd=kd)
    run(motor, drive, 3.0, supply_v)
    assert motor.position_rad == pytest.approx(0.5, abs=0.01)
    assert motor.velocity_rad_s == 0.0


@pytest.mark.parametrize("load_nm", [0.3, -0.8])
def test_the_sag_under_a_load_is_torque_over_stiffness(load_nm: float) -> None:
    ideal = replace(PARAMETERS["STS3215"], coulomb_friction_nm=0.0, static_friction_nm=0.0)
    motor, drive = Motor(ideal), DriveCommand(True, goal_rad=0.2, kp=5.3)
    run(motor, drive, 3.0, ideal.nominal_v, load_nm)
    stiffness_nm_rad = drive.kp * ideal.stall_torque_nm
    assert motor.position_rad - 0.2 == pytest.approx(load_nm / stiffness_nm_rad, rel=1e-3)


@pytest.mark.parametrize("model", MODELS)
def test_dry_friction_moves_the_sag_by_no_more_than_itself(model: str) -> None:
    motor, supply_v = nominal(model)
    stall_nm, friction_nm = motor.parameters.stall_torque_nm, motor.parameters.static_friction_nm
    drive, load_nm = DriveCommand(True, kp=5.3), -0.2 * stall_nm
    run(motor, drive, 3.0, supply_v, load_nm)
    stiffness_nm_rad = drive.kp * stall_nm
    off_nm = motor.position_rad * stiffness_nm_rad - load_nm
    assert abs(off_nm) <= friction_nm + 1e-6


def test_an_integral_gain_removes_the_sag() -> None:
    motor, supply_v = nominal("XM430-W350")
    drive = DriveCommand(True, kp=4.6, ki=20.0)
    run(motor, drive, 5.0, supply_v, load_nm=-0.8)
    assert motor.position_rad == pytest.approx(0.0, abs=0.002)


def test_the_integral_waits_while_a_limit_cuts_the_duty() -> None:
    motor, supply_v = nominal("XM430-W350")
    motor.stuck = True
    drive = DriveCommand(True, goal_rad=0.3, kp=4.6, ki=20.0)
    run(motor, drive, 5.0, supply_v)
    motor.stuck = False
    run(motor, drive, 0.6, supply_v)
    assert motor.position_rad < 0.5


def test_an_error_inside_the_dead_zone_draws_no_current() -> None:
    motor, supply_v = nominal("STS3215")
    drive = DriveCommand(True, goal_rad=0.004, dead_zone_rad=0.005)
    run(motor, drive, 0.1, supply_v)
    assert motor.current_a == 0.0


def test_the_startup_force_breaks_small_errors_loose() -> None:
    motor, supply_v = nominal("STS3215")
    drive = DriveCommand(True, goal_rad=0.003, minimum_pwm=0.03)
    run(motor, drive, 0.3, supply_v)
    assert motor.position_rad == pytest.approx(0.003, abs=0.002)


def test_a_goal_already_reached_starts_no_profile() -> None:
    motor, supply_v = nominal("XL330-M288")
    motor.step(DT_S, 0.0, DriveCommand(True, profile_time_s=1.0, acceleration_time_s=0.2), supply_v)
    assert not motor.profile_running
